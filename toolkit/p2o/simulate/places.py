"""Kinds of places, and the seeded drawing of one: `scene_of`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from p2o.arrays import Float
from p2o.errors import UnknownNameError
from p2o.simulate import hall, highway, room, suburb, town, woods, yard
from p2o.simulate.place import Layout, Plan, Thing, land_behind
from p2o.simulate.scene import Mover, Part, Scene

SHARES: Mapping[str, float] = MappingProxyType({"street": 0.27, "suburb": 0.23, "highway": 0.17, "trees": 0.33})
"""How often `mixed` draws each kind: a third are trees and banks, as on real drives."""
INDOORS = ("hall", "room")
"""Kinds of places inside of buildings."""
PLACES = (*SHARES, "yard", *INDOORS)
"""Names of the kinds of places; `mixed` draws those of SHARES only, `anywhere` all."""
_ANYWHERE: Mapping[str, float] = MappingProxyType(
    {"street": 0.16, "suburb": 0.14, "highway": 0.1, "trees": 0.14, "yard": 0.08, "hall": 0.18, "room": 0.2}
)


def place_of(place: str, rng: np.random.Generator) -> str:
    """Return a kind of place: that of the name or, for `mixed` and `anywhere`, a drawn one.

    Raises UnknownNameError for another name.
    """
    drawn: Mapping[str, Mapping[str, float]] = {"mixed": SHARES, "anywhere": _ANYWHERE}
    if place not in PLACES and place not in drawn:
        raise UnknownNameError("place", place, [*drawn, *PLACES])
    shares = drawn.get(place)
    return place if shares is None else str(rng.choice(list(shares), p=list(shares.values())))


def scene_of(
    place: str, rng: np.random.Generator, *, speed_m_s: float = 0.0, travel_m: float = 0.0, around: bool = False
) -> tuple[Scene, Float]:
    """Return a scene of a kind of place and the velocity (6,) in rad/s and m/s of a rig that follows its road.

    `place` is one of PLACES, or `mixed` or `anywhere`, which draw one. The rig starts at the origin, along x, and keeps
    on the road for `travel_m` metres; the road may bend. Other traffic drives too, unless the rig stands still. Where
    its cameras look `around`, what is beside and behind them is as fine as what is ahead.

    Raises UnknownNameError for another kind of place.
    """
    makers: Mapping[str, Callable[[Plan], Layout]] = {
        "street": town.layout, "suburb": suburb.layout, "highway": highway.layout, "trees": woods.layout,
        "yard": yard.layout, "hall": hall.layout, "room": room.layout,
    }  # fmt: skip
    maker = makers[place_of(place, rng)]
    plan = Plan(rng, travel_m, around)
    layout = maker(plan)
    if around and layout.lighting.inside is None:
        layout.things.extend(land_behind(plan))
    curvature = float(rng.uniform(*layout.curvature)) if rng.random() < 0.6 else 0.0
    elevation, turn = np.radians(rng.uniform(16.0, 62.0)), rng.uniform(0, 2 * np.pi)
    to_sun = (
        float(np.cos(elevation) * np.cos(turn)),
        float(np.cos(elevation) * np.sin(turn)),
        float(np.sin(elevation)),
    )

    numbers = iter(range(10_000_000))

    def numbered(things: list[Thing]) -> tuple[Part, ...]:
        out = []
        for thing in things:
            number = next(numbers)
            out += [replace(part, mesh=part.mesh.bent(curvature), thing=number) for part in thing]
        return tuple(out)

    unit = np.array([0.0, 0.0, curvature, 1.0, 0.0, 0.0])
    still, movers = numbered(layout.things), []
    for things, factor in ((layout.oncoming, -rng.uniform(0.8, 1.2)), (layout.ahead, rng.uniform(0.9, 1.1))):
        if things:
            movers.append(Mover(numbered(things), unit * factor * speed_m_s))
    cloudiness = float(rng.choice([0.15, 0.35, 0.5, 0.75]))
    scene = Scene(still, to_sun, tuple(movers), cloudiness=cloudiness, lighting=layout.lighting)
    return scene, unit * speed_m_s


def street(rng: np.random.Generator) -> Scene:
    """Return a street with a rig's place at the origin; the same generator state gives the same street."""
    return scene_of("street", rng)[0]
