"""Kinds of scenes, and `scene_of`, which draws one from a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import count

import numpy as np
from p2o import Float, UnknownNameError

from p2o_sim.places import difficult, hall, highway, room, suburb, town, varied, woods, yard
from p2o_sim.world.lighting import triple
from p2o_sim.world.place import Layout, Plan, Thing, land_behind
from p2o_sim.world.scene import Mover, Part, Scene

SHARES: Mapping[str, float] = {"street": 0.27, "suburb": 0.23, "highway": 0.17, "trees": 0.33}
"""Frequencies of the kinds in `mixed`: a third are trees and banks, as on real drives."""
INDOORS = ("hall", "room")
"""Kinds of places inside buildings."""
DIFFICULT = ("repeated", "empty", "traffic")
"""Kinds of places in which a calibration may have no right result."""
PLACES = (*SHARES, "varied", "yard", *INDOORS, *DIFFICULT)
"""Names of the kinds of places; `mixed` draws from SHARES, `anywhere` from all but `varied` and DIFFICULT."""
_ANYWHERE: Mapping[str, float] = {
    "street": 0.16, "suburb": 0.14, "highway": 0.1, "trees": 0.14, "yard": 0.08, "hall": 0.18, "room": 0.2
}  # fmt: skip


def place_of(place: str, rng: np.random.Generator) -> str:
    """Return a kind of place: the named one or, for `mixed` and `anywhere`, a random one.

    Raises UnknownNameError for an unknown name.
    """
    if place in PLACES:
        return place
    drawn: Mapping[str, Mapping[str, float]] = {"mixed": SHARES, "anywhere": _ANYWHERE}
    if place not in drawn:
        raise UnknownNameError("place", place, [*drawn, *PLACES])
    return str(rng.choice(list(drawn[place]), p=list(drawn[place].values())))


def scene_of(
    place: str, rng: np.random.Generator, *, speed_m_s: float = 0.0, travel_m: float = 0.0, around: bool = False
) -> tuple[Scene, Float]:
    """Return a scene and the velocity (6,) in rad/s and m/s of a rig that follows its road.

    `place` is one of PLACES, or `mixed` or `anywhere`, which draw one. The rig starts at the origin, along x, and
    stays on the road for `travel_m` metres; the road may bend. There is other traffic unless the rig is static. With
    `around`, the surroundings beside and behind the rig are as detailed as those ahead.

    Raises UnknownNameError for an unknown kind of place.
    """
    makers: Mapping[str, Callable[[Plan], Layout]] = {
        "street": town.layout, "suburb": suburb.layout, "highway": highway.layout, "trees": woods.layout,
        "varied": varied.layout, "yard": yard.layout, "hall": hall.layout, "room": room.layout,
        "repeated": difficult.repeated, "empty": difficult.empty, "traffic": difficult.traffic_alone,
    }  # fmt: skip
    maker, plan = makers[place_of(place, rng)], Plan(rng, travel_m, around)
    layout = maker(plan)
    if around and layout.lighting.inside is None:
        layout.things.extend(land_behind(plan))
    curvature = float(rng.uniform(*layout.curvature)) if rng.random() < 0.6 else 0.0
    elevation, turn = np.radians(rng.uniform(16.0, 62.0)), rng.uniform(0, 2 * np.pi)
    to_sun = (np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation))
    numbers = count()

    def numbered(things: list[Thing]) -> tuple[Part, ...]:
        pairs = zip(things, numbers, strict=False)
        return tuple(replace(part, mesh=part.mesh.bent(curvature), thing=n) for thing, n in pairs for part in thing)

    unit = np.array([0.0, 0.0, curvature, 1.0, 0.0, 0.0])
    still, movers = numbered(layout.things), []
    for things, factor in ((layout.oncoming, -rng.uniform(0.8, 1.2)), (layout.ahead, rng.uniform(0.9, 1.1))):
        if things:
            movers.append(Mover(numbered(things), unit * factor * speed_m_s))
    cloudiness = float(rng.choice([0.15, 0.35, 0.5, 0.75]))
    scene = Scene(still, triple(to_sun), tuple(movers), cloudiness=cloudiness, lighting=layout.lighting)
    return scene, unit * speed_m_s
