"""A road with vehicles, walls, plants and posts close to the rig, in any combination, for training."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from p2o_sim.places import highway, suburb, town, woods
from p2o_sim.places.yard import stock
from p2o_sim.things.furniture import barrier, clutter, fence, gantry, guard_rail, lamp, noise_wall, pole, sign, wires
from p2o_sim.things.people import cyclist, pedestrian
from p2o_sim.things.plants import bush, hedge, thicket, tree
from p2o_sim.things.vehicles import any_vehicle, bus, truck, van
from p2o_sim.world.place import Layout, Plan, Thing, on_side, placed

_FREE_M = 2.4
"""Half the width of the lane of the rig, which stays free."""


def layout(plan: Plan) -> Layout:
    """Return one of the roads with vehicles close by, long things along it, and small things at any density."""
    rng = plan.rng
    layouts = (town.layout, suburb.layout, highway.layout, woods.layout)
    road = layouts[rng.integers(4)](plan)
    things = road.things
    end = plan.travel_m + 90.0
    for side in (-1, 1):
        if rng.random() < 0.6:
            things += _along(plan, side, side * rng.uniform(3.6, 12.0), end)
        if rng.random() < 0.5:
            things += _vehicles(plan, side, end)
        things += _scattered(plan, side, float(np.exp(rng.uniform(np.log(2.0), np.log(14.0)))), end)
    for _ in range(rng.integers(0, 4)):
        things.append(placed(wires(end + 100.0, rng.uniform(-14.0, 14.0), rng.uniform(5.0, 9.0)), -20.0, 0.0))
    if rng.random() < 0.15:
        things.append(placed(gantry(rng, 8.0, -8.0), rng.uniform(15.0, 60.0), 0.0))
    return road


def _along(plan: Plan, side: int, y: float, end: float) -> list[Thing]:
    """Return one long thing in pieces of 6 m, with gaps: a fence, a wall, a rail, a hedge or a thicket."""
    rng = plan.rng
    height = rng.uniform(2.0, 8.0)
    makers: tuple[Callable[[float], Thing], ...] = (
        lambda sight: fence(rng, 6.0),
        lambda sight: noise_wall(rng, 6.0),
        lambda sight: guard_rail(6.0),
        lambda sight: hedge(rng, 6.0, sight),
        lambda sight: thicket(rng, 6.0, 2.0, height, sight),
    )
    make = makers[rng.integers(len(makers))]
    places = (x for x in np.arange(-30.0, end, 6.0) if rng.random() > 0.15)
    return [on_side(make(plan.sight_m(x + 3.0, y)), side, x, y, 6.0, 0.05) for x in places]


def _vehicles(plan: Plan, side: int, end: float) -> list[Thing]:
    """Return a row of vehicles close to the rig, parked along the road or across it."""
    rng, out = plan.rng, []
    heavy, yaw = rng.uniform(0.0, 0.6), float(rng.choice([0.0, 0.0, 90.0, 60.0]))
    makers = (truck, bus, van)
    y = side * (_FREE_M + (1.3 if yaw == 0.0 else 3.0) + rng.uniform(0.0, 3.0))
    for x in plan.along(-25.0, end, (6.0, 22.0)):
        thing = makers[rng.integers(3)](rng) if rng.random() < heavy else any_vehicle(rng, 0.05)
        out.append(placed(thing, x, y, yaw_deg=yaw + rng.uniform(-4.0, 4.0) + (180.0 if rng.random() < 0.3 else 0.0)))
    return out


def _scattered(plan: Plan, side: int, gap_m: float, end: float) -> list[Thing]:
    """Return single things beside the lane, some `gap_m` from each other."""
    rng, out = plan.rng, []
    makers: tuple[Callable[[float], Thing], ...] = (
        lambda sight: pole(rng),
        lambda sight: sign(rng),
        lambda sight: lamp(rng, high=rng.uniform(4.0, 9.0)),
        lambda sight: pedestrian(rng),
        lambda sight: cyclist(rng),
        lambda sight: barrier(rng),
        lambda sight: clutter(rng),
        lambda sight: bush(rng, sight),
        lambda sight: tree(rng, sight),
        lambda sight: stock(rng, vehicles=False),
    )
    likely = rng.dirichlet(np.full(len(makers), 0.6))
    for x in plan.along(-20.0, end, (0.5 * gap_m, 1.5 * gap_m)):
        y = side * (_FREE_M + 0.8 + rng.exponential(4.0))
        thing = makers[rng.choice(len(makers), p=likely)](plan.sight_m(x, y))
        out.append(placed(thing, x, y, 0.05, yaw_deg=rng.uniform(0.0, 360.0)))
    return out
