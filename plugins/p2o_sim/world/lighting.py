"""Light of a scene apart from the sun: lamps, ambient light inside a building, and the sky."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

Triple = tuple[float, float, float]


def triple(values: Iterable[float]) -> Triple:
    """Return three numbers, such as a colour, as a tuple of floats."""
    x, y, z = values
    return (float(x), float(y), float(z))


@dataclass(frozen=True)
class Lamp:
    """A lamp at `place` (3,) in m in the world frame that casts shadows.

    `colour` is the linear RGB light on a white surface that faces it from 1 m; it decreases with the square of the
    distance, softened by the size `size_m`. `aim` (3,) is the direction of the beam, whose light decreases as
    cos(angle)^`sharpness`; None radiates equally in all directions. Objects nearer than `clear_m` (its shade) cast no
    shadow. `daylight` marks light from outside.
    """

    place: Triple
    colour: Triple
    size_m: float = 0.3
    aim: Triple | None = None
    sharpness: float = 1.0
    clear_m: float = 0.1
    daylight: bool = False


@dataclass(frozen=True)
class Inside:
    """The interior of a building, the box from corner `low` to `high` (3,) in m, with `ambient` linear RGB light.

    Surfaces that face along `lean` (3,) are brighter by this share, opposite ones darker; corners are darker.
    """

    low: Triple
    high: Triple
    ambient: Triple
    lean: Triple = (0.08, 0.05, 0.12)


@dataclass(frozen=True)
class Lighting:
    """The light of a scene: shares of sun and, by colour, of the sky (1 in daylight), interior, and lamps.

    `overcast` in 0..1 is the opacity of an even grey layer in front of blue sky and clouds; `haze_m` metres of air
    reduce the contrast of a surface to 1/e. If `wet`, the ground reflects objects on it.
    """

    sun: float = 1.0
    sky: Triple = (1.0, 1.0, 1.0)
    overcast: float = 0.0
    inside: Inside | None = None
    lamps: tuple[Lamp, ...] = ()
    haze_m: float = 1500.0
    wet: bool = False


DAY = Lighting()
"""Outdoor daylight."""
