"""Roads on which a calibration may have no right result: repeated structures, nothing at all, or traffic alone."""

from __future__ import annotations

import numpy as np

from p2o_sim.things.buildings import town_house
from p2o_sim.things.furniture import fence, lamp
from p2o_sim.things.ground import dashes, stations, strips
from p2o_sim.things.vehicles import car, traffic, van
from p2o_sim.world.palette import ASPHALT
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, on_side, placed
from p2o_sim.world.scene import Class

_BAY_M = 2.6


def repeated(plan: Plan) -> Layout:
    """Return a straight road between rows of equal houses, fences or parked cars, on which several poses fit."""
    rng = plan.rng
    things: list[Thing] = [[*open_ground(plan)], *backdrop(plan)]
    end, offset = plan.travel_m + 80.0, rng.uniform(5.5, 8.0)
    kind = rng.integers(3)
    if kind == 0:  # equal houses
        length = rng.uniform(5.0, 9.0)
        thing = town_house(rng, length)
    elif kind == 1:  # a fence with lamps
        length = rng.uniform(4.0, 8.0)
        thing = [*fence(rng, length), *lamp(rng)]
    else:  # cars in parking bays
        length = _BAY_M
        thing = placed((car if rng.random() < 0.8 else van)(rng), 0.5 * length, 3.0, yaw_deg=-90.0)
    for side in (-1, 1):
        things += [on_side(thing, side, x, side * offset, length) for x in np.arange(BEHIND_M, end, length)]
    return Layout(things, [], [], (0.0, 0.0))


def open_ground(plan: Plan) -> Thing:
    """Return a flat surface with a dashed line beside the path of the rig."""
    x = stations(BEHIND_M, plan.far_m)
    ground = strips([(100.0, 0.0), (-100.0, 0.0)], [(ASPHALT, Class.ROAD)], x)
    return [*ground, dashes(BEHIND_M, plan.far_m, 1.75)]


def empty(plan: Plan) -> Layout:
    """Return a road to the horizon, with distant woods around."""
    return Layout([open_ground(plan), *backdrop(plan)], [], [], (0.0, 0.0))


def traffic_alone(plan: Plan) -> Layout:
    """Return the road with traffic on four lanes; nothing else is above the ground."""
    bare, far = empty(plan), plan.travel_m + 90.0
    oncoming = [
        thing for y in (3.5, 7.0) for thing in traffic(plan, 0.2, y, 10.0, far + 80.0, (9.0, 25.0), yaw_deg=180.0)
    ]
    ahead = traffic(plan, 0.2, 0.0, 14.0, far, (14.0, 30.0)) + traffic(plan, 0.2, -3.5, 7.0, far, (9.0, 25.0))
    return Layout(bare.things, oncoming, ahead, bare.curvature)
