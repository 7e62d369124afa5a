"""A country road between trees, bushes and banks, as in difficult real frames."""

from __future__ import annotations

import numpy as np

from p2o_sim.things.furniture import guard_rail, lamp, marker_post, pole, sign
from p2o_sim.things.ground import bank_height, dashes, land, stations, strips
from p2o_sim.things.people import cyclist, pedestrian
from p2o_sim.things.plants import bush, hedge, thicket, tree, tufts
from p2o_sim.things.vehicles import any_vehicle, traffic
from p2o_sim.world.palette import ASPHALT, GRASS, SOIL
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, on_side, placed
from p2o_sim.world.scene import Class


def layout(plan: Plan) -> Layout:
    """Return a road of two lanes with trees, thickets or banks on both sides."""
    rng = plan.rng
    right, left = -rng.uniform(2.0, 2.8), rng.uniform(4.8, 5.8)
    x = stations(BEHIND_M, plan.far_m)
    ground = strips(
        [(left + 1.2, 0.06), (left, 0.0), (right, 0.0), (right - 1.2, 0.06)],
        [(GRASS, Class.TERRAIN), (ASPHALT, Class.ROAD), (GRASS, Class.TERRAIN)],
        x,
    )
    rises = rng.choice([0.0, 0.8, 2.5], size=2) * rng.uniform(0.6, 1.4, 2)
    over = rng.uniform(5.0, 9.0)
    soil = [SOIL if rng.random() < 0.4 else GRASS for _ in range(2)]
    for y, out, rise, material in ((left + 1.2, 1, rises[1], soil[1]), (right - 1.2, -1, rises[0], soil[0])):
        ground.append(land(rng, x, y, 0.06, out, rise=rise, over=over, rough=0.12, material=material))
    end = plan.far_m - 10
    ground += [dashes(BEHIND_M, end, y, length=4.0, period=4.0, width=0.11) for y in (right + 0.2, left - 0.2)]
    if rng.random() < 0.7:
        ground.append(dashes(BEHIND_M, end, (right + left) / 2, length=3.0, period=7.5))
    things: list[Thing] = [ground, *backdrop(plan, high=(8.0, 16.0), sides_m=60.0)]
    things += _side(plan, -1, right - 1.2, rises[0], over) + _side(plan, 1, left + 1.2, rises[1], over)
    posts = [(at, right - 0.7) for at in plan.along(6.0, plan.travel_m + 110.0, (20.0, 30.0))]
    posts += [(at, left + 0.7) for at in plan.along(12.0, plan.travel_m + 110.0, (20.0, 30.0))]
    things += [placed(marker_post(), at, y, 0.03) for at, y in posts]
    for at in plan.along(12.0, plan.travel_m + 90.0, (14.0, 32.0)):
        right_hand = rng.random() < 0.6
        y, turn = (right - 1.3, 0.0) if right_hand else (left + 1.3, 180.0)
        make = (sign, sign, pole, lamp)[rng.integers(4)]
        things.append(placed(make(rng), at, y, 0.05, yaw_deg=turn))
    for at in plan.along(10.0, plan.travel_m + 60.0, (25.0, 60.0)):
        walker = cyclist(rng) if rng.random() < 0.5 else pedestrian(rng)
        y = right + 0.1 if rng.random() < 0.5 else right - 0.8
        things.append(placed(walker, at, y, 0.03, yaw_deg=rng.choice([0, 180])))
    if rng.random() < 0.5:
        for at in plan.along(10.0, plan.travel_m + 50.0, (12.0, 30.0)):  # parked on the verge
            things.append(placed(any_vehicle(rng, 0.1), at, right - 1.3, 0.03, yaw_deg=rng.uniform(-3, 3)))
    if rng.random() < 0.35:
        start = rng.uniform(4.0, 30.0)
        rails = (placed(guard_rail(8.0), start + 8 * i + 8, right - 1.0, yaw_deg=180.0) for i in range(5))
        things.append([part for rail in rails for part in rail])
    middle = (right + left) / 2
    oncoming = traffic(plan, 0.15, middle + 1.75, 14.0, 100.0 + plan.travel_m, (20.0, 60.0), yaw_deg=180.0)
    ahead = traffic(plan, 0.15, 0.0, rng.uniform(12.0, 30.0), 80.0, (25.0, 60.0))
    return Layout(things, oncoming, ahead, (-0.007, 0.007))


def _side(plan: Plan, side: int, edge: float, rise: float, over: float) -> list[Thing]:
    """Return one side of the road: a wood, an avenue, or a bank with bushes and hedges; long grass before it."""
    rng, out = plan.rng, []
    stop = plan.travel_m + 120.0
    kind = rng.random()

    def height(off: float) -> float:
        return bank_height(rise, over, off) - 0.1

    if kind < 0.5:  # a wood: trunks in front, a dark mass behind
        depth = rng.uniform(5.0, 8.0)
        for x in np.arange(BEHIND_M, stop + 20, 14.0):
            y = edge + side * depth
            wood = thicket(rng, 15.0, 3.0, rng.uniform(6.0, 14.0), plan.sight_m(x + 7, y))
            out.append(on_side(wood, side, x, y, 15, height(depth)))
        for x in plan.along(-25.0, stop, (2.5, 8.0)):
            off = rng.uniform(0.8, depth)
            y = edge + side * off
            stem = tree(rng, plan.sight_m(x, y), height=rng.uniform(8.0, 15.0), forest=True)
            out.append(placed(stem, x, y, height(off)))
    elif kind < 0.75:  # an avenue before open land
        off = rng.uniform(1.0, 3.0)
        for x in plan.along(-25.0, stop, (6.0, 14.0)):
            y = edge + side * (off + rng.uniform(-0.3, 0.3))
            out.append(placed(tree(rng, plan.sight_m(x, y), height=rng.uniform(6.0, 11.0)), x, y, height(off)))
    else:  # a hedge of many kinds
        off = rng.uniform(1.0, 2.5)
        for x in np.arange(BEHIND_M, stop, 9.0):
            row = hedge(rng, 9.0, plan.sight_m(x + 5, edge), height=rng.uniform(1.2, 3.0))
            out.append(placed(row, x, edge + side * off, height(off)))
    for x in plan.along(-15.0, stop, (2.5, 8.0)):
        off = rng.uniform(0.9, over + 3)
        y = edge + side * off
        seen = plan.sight_m(x, y)
        plant = bush(rng, seen) if rng.random() < 0.7 else tree(rng, seen, height=rng.uniform(3.0, 7.0))
        out.append(placed(plant, x, y, height(off)))
    count = 3000
    spread = rng.uniform(-0.5, 3.0, count)
    low = np.array([height(max(s, 0.0)) + 0.1 for s in spread])
    blades = np.column_stack([rng.uniform(-2, plan.travel_m + 35, count), edge + side * spread, low])
    return [*out, tufts(rng, blades, rng.uniform(0.2, 0.55))]
