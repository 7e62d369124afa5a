"""A dual carriageway: guard rails, banks with bushes, sign bridges, noise barriers, trucks."""

from __future__ import annotations

import numpy as np

from p2o_sim.things.furniture import gantry, guard_rail, lamp, marker_post, noise_wall, sign
from p2o_sim.things.ground import bank_height, dashes, land, stations, strips
from p2o_sim.things.plants import bush, thicket, tree, tufts
from p2o_sim.things.vehicles import any_vehicle, traffic, truck
from p2o_sim.world.mesh import stacked
from p2o_sim.world.palette import ASPHALT, GRASS, KERB
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, on_side, placed
from p2o_sim.world.scene import Class

_LANE_M = 3.6
_PIECE_M = 8.0


def layout(plan: Plan) -> Layout:
    """Return two lanes each way with a green strip between them."""
    rng = plan.rng
    lane = rng.integers(2)  # 0: the rig is in the right lane
    right = -_LANE_M / 2 - lane * _LANE_M - rng.uniform(1.0, 3.0)
    left = right + rng.uniform(1.0, 3.0) + 2 * _LANE_M + 1.0
    gap = rng.uniform(3.0, 5.0)
    other_right, other_left = left + gap, left + gap + 2 * _LANE_M + 3.0
    x = stations(BEHIND_M, plan.far_m)
    ground = strips(
        [(other_left, 0.0), (other_right, 0.0), (other_right - 0.2, 0.1), (left + 0.2, 0.1), (left, 0.0), (right, 0.0)],
        [(ASPHALT, Class.ROAD), (KERB, Class.TERRAIN), (GRASS, Class.TERRAIN), (KERB, Class.TERRAIN),
         (ASPHALT, Class.ROAD)],
        x,
    )  # fmt: skip
    rises = rng.choice([0.0, 0.0, 2.5, 5.0], size=2) * rng.uniform(0.6, 1.3, 2)
    bank = rng.uniform(7.0, 12.0)
    ground.append(land(rng, x, other_left, 0.0, 1, rise=rises[1], over=bank))
    ground.append(land(rng, x, right, 0.0, -1, rise=rises[0], over=bank))
    end = plan.far_m - 10.0
    first = -_LANE_M / 2 - lane * _LANE_M
    marks = [first, first + 2 * _LANE_M, other_right + 1.0, other_right + 1.0 + 2 * _LANE_M]
    ground += [dashes(BEHIND_M, end, y, length=4.0, period=4.0) for y in marks]
    middles = (first + _LANE_M, other_right + 1.0 + _LANE_M)
    ground += [dashes(BEHIND_M, end, y, length=6.0, period=18.0) for y in middles]
    things: list[Thing] = [ground, *backdrop(plan, high=(5.0, 11.0))]
    things += _rails(plan, right - 0.6, left + 0.4 * gap, left + 0.6 * gap, other_left + 0.6)
    things += _bank(plan, -1, right, rises[0], bank) + _bank(plan, 1, other_left, rises[1], bank)
    for at in plan.along(20.0, plan.travel_m + 150.0, (50.0, 120.0)):
        if rng.random() < 0.5:
            things.append(placed(gantry(rng, left + gap / 2, right - 1.2), at, 0.0))
        else:
            things.append(placed(sign(rng), at, right - 1.6, 0.0))
    lamps = np.arange(12.0, plan.travel_m + 160.0, 35.0) if rises[0] == 0.0 else ()
    things += [placed(lamp(rng, high=10.0), x, left + gap / 2, yaw_deg=turn) for x in lamps for turn in (0.0, 180.0)]
    blades = rng.uniform(0, plan.travel_m + 40, 900), rng.uniform(left + 0.3, left + gap - 0.3, 900)
    things.append(tufts(rng, stacked(*blades, 0.08), 0.4))
    oncoming = [
        placed(any_vehicle(rng, 0.3), at, other_right + 1.0 + (0.5 + rng.integers(2)) * _LANE_M, yaw_deg=180.0)
        for at in plan.along(10.0, 170.0 + 2 * plan.travel_m, (14.0, 40.0))
    ]
    beside = _LANE_M if lane == 0 else -_LANE_M
    ahead = traffic(plan, 0.25, 0.0, rng.uniform(12.0, 30.0), 130.0, (18.0, 50.0))
    ahead += traffic(plan, 0.3, beside, 6.0, 120.0, (14.0, 45.0))
    if rng.random() < 0.4:
        ahead.append(placed(truck(rng), -14.0, beside))
    return Layout(things, oncoming, ahead, (-0.002, 0.002))


def _rails(plan: Plan, *lines: float) -> list[Thing]:
    """Return guard rails along the lines y, in pieces so that they follow a bend."""
    pieces = np.arange(BEHIND_M, plan.travel_m + 150.0, _PIECE_M)
    out: list[Thing] = []
    for number, y in enumerate(lines):
        if number in (0, 3) and plan.rng.random() < 0.4:
            out += [placed(marker_post(), at, y) for at in np.arange(5.0, plan.travel_m + 100.0, 25.0)]
            continue
        # The beam faces the traffic: -y of the rail's own frame.
        facing = 180.0 if number in (0, 2) else 0.0
        shift = _PIECE_M if facing else 0.0
        rails = (placed(guard_rail(_PIECE_M), at + shift, y, yaw_deg=facing) for at in pieces)
        out.append([part for rail in rails for part in rail])
    return out


def _bank(plan: Plan, side: int, edge: float, rise: float, over: float) -> list[Thing]:
    """Return the roadside: bushes, trees, the edge of a wood, or a wall."""
    rng, out = plan.rng, []
    kind = rng.random()
    stop = plan.travel_m + 140.0
    if kind < 0.25:
        y = edge + side * rng.uniform(2.5, 4.0)
        height = bank_height(rise, over, abs(y - edge))
        out += [placed(noise_wall(rng, 12.0), x, y, height) for x in np.arange(BEHIND_M, stop, 12.0)]
    elif kind < 0.55:
        y = edge + side * (over + 1.0)
        for x in np.arange(BEHIND_M, stop, 14.0):
            wood = thicket(rng, 15.0, 4.0, rng.uniform(5.0, 11.0), plan.sight_m(x + 7, y))
            out.append(on_side(wood, side, x, y, 15, rise))
    for x in plan.along(-10.0, stop, (3.0, 9.0)):
        off = rng.uniform(2.0, over + 4.0)
        y, z = edge + side * off, bank_height(rise, over, off) - 0.1
        seen = plan.sight_m(x, y)
        out.append(placed(bush(rng, seen) if rng.random() < 0.75 else tree(rng, seen), x, y, z))
    spread = rng.uniform(0.8, 3.0, 1500)
    high = [bank_height(rise, over, s) for s in spread]
    blades = np.column_stack([rng.uniform(0, plan.travel_m + 40, 1500), edge + side * spread, high])
    return [*out, tufts(rng, blades, 0.45)]
