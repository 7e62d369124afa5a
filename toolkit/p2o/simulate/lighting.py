"""What lights a scene beside the sun: lamps, the light inside of a building, and how much of the sky is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Lamp:
    """A lamp at `place` (3,) m in the world frame that casts shadows.

    `colour` is the linear RGB light on a white surface that faces it from 1 m; it falls with the square of its
    distance, softened by its size `size_m`. `aim` (3,) is where it shines to: cos(angle)^`sharpness` of its light
    goes elsewhere; None shines everywhere. What is nearer to it than `clear_m` (its own shade) hides nothing.
    `daylight` is light that falls in from outside.
    """

    place: Triple
    colour: Triple
    size_m: float = 0.3
    aim: Triple | None = None
    sharpness: float = 1.0
    clear_m: float = 0.1
    daylight: bool = False

    def times(self, factor: float) -> Lamp:
        """Return the lamp with `factor` times the light."""
        red, green, blue = self.colour
        return replace(self, colour=(factor * red, factor * green, factor * blue))


@dataclass(frozen=True)
class Inside:
    """The inside of a building, the box from corner `low` to `high` (3,) m, lit evenly by `ambient` linear RGB.

    Surfaces that face along `lean` (3,) get so much more of it, those of the other direction less; where two meet, and
    near the floor, it is darker.
    """

    low: Triple
    high: Triple
    ambient: Triple
    lean: Triple = (0.08, 0.05, 0.12)


@dataclass(frozen=True)
class Lighting:
    """The light of a scene: shares of the sun and, by colour, of the sky (1 is a day), an inside, and lamps.

    `overcast` in 0..1 is how far an even grey covers blue and clouds alike; after `haze_m` metres of air a surface has
    lost all but 1/e of its contrast. Where it is `wet`, the ground mirrors what stands on it.
    """

    sun: float = 1.0
    sky: Triple = (1.0, 1.0, 1.0)
    overcast: float = 0.0
    inside: Inside | None = None
    lamps: tuple[Lamp, ...] = ()
    haze_m: float = 1500.0
    wet: bool = False


DAY = Lighting()
"""A day outdoors."""
