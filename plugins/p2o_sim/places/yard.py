"""A yard for calibration with boards: walls and halls around an open floor, with clutter along them."""

from __future__ import annotations

import numpy as np

from p2o_sim.things.buildings import block
from p2o_sim.things.furniture import barrier, clutter, lamp, noise_wall, pole, sign
from p2o_sim.things.ground import dashes, land, stations, strips
from p2o_sim.things.vehicles import any_vehicle
from p2o_sim.world.mesh import boxes, cylinder, join, sized
from p2o_sim.world.palette import ASPHALT, CONCRETE, DARK_STEEL, PAVING, SIGNS, WALLS, WOOD, pick
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, placed
from p2o_sim.world.scene import Class, Material, Part


def layout(plan: Plan) -> Layout:
    """Return a straight yard whose centre, 3.5 m to either side of the rig's path, is free."""
    rng = plan.rng
    right, left = -rng.uniform(7.0, 10.0), rng.uniform(7.0, 10.0)
    back, end = -rng.uniform(12.0, 18.0), plan.travel_m + rng.uniform(13.0, 20.0)
    floor = (ASPHALT, CONCRETE, PAVING)[rng.integers(3)]
    x = stations(BEHIND_M, plan.far_m)
    ground = strips([(left + 30.0, 0.0), (right - 30.0, 0.0)], [(floor, Class.ROAD)], x)
    ground += [land(rng, x, side + 30.0 * out, 0.0, out, rough=0.06) for side, out in ((left, 1), (right, -1))]
    ground += [dashes(back + 1.0, end - 2.0, y, period=6.0, length=4.0) for y in (right + 3.0, left - 3.0)]
    things: list[Thing] = [ground, *backdrop(plan)]
    for side, line in ((-1, right), (1, left)):
        things.append(_side_wall(rng, side, line, back, end))
        things += [
            placed(stock(rng), at, line - side * rng.uniform(1.1, 2.2), yaw_deg=rng.uniform(-15.0, 15.0))
            for at in plan.along(back + 2.0, end - 3.0, (3.0, 6.0))
        ]
    things.append(placed(block(rng, left - right + 8.0), end, left + 4.0, yaw_deg=-90.0))
    things.append(placed(block(rng, left - right + 8.0), back, right - 4.0, yaw_deg=90.0))
    things += [
        placed(stock(rng), end - rng.uniform(1.2, 2.6), y, yaw_deg=rng.uniform(0.0, 360.0))
        for y in plan.along(right + 1.0, left - 1.0, (1.8, 3.8))
    ]
    return Layout(things, [], [], (0.0, 0.0))


def _side_wall(rng: np.random.Generator, side: int, line: float, back: float, end: float) -> Thing:
    """Return the boundary of one side: a wall of panels, or a hall."""
    length = end - back
    thing = noise_wall(rng, length) if rng.random() < 0.5 else block(rng, length)
    return placed(thing, back, line) if side > 0 else placed(thing, end, line, yaw_deg=180.0)


def stock(rng: np.random.Generator, *, vehicles: bool = True) -> Thing:
    """Return a typical object of yards, at most 2.4 m wide."""
    kind = rng.integers(8 if vehicles else 4)
    if kind == 0:  # a container
        paint = Material("container", pick(rng, SIGNS), 0.3, 0.45, 0.05, "tiles")
        low = np.array([[-1.5, -1.1, 0.12]])
        return [Part(sized(low, [3.0, 2.2, 2.5]), paint)]
    if kind == 1:  # drums
        paint = Material("drum", pick(rng, WALLS), 0.25, 0.4, 0.05, "plain")
        places = rng.uniform(-0.7, 0.7, (3, 2)) + [[-0.8, 0.0], [0.0, 0.6], [0.8, -0.2]]
        return [Part(join([cylinder(0.29, 0.0, 0.88).moved(*at) for at in places]), paint)]
    if kind == 2:  # crates on pallets
        step = np.arange(rng.integers(2, 5))
        shift = rng.uniform(-0.06, 0.06, (len(step), 2))
        low = np.column_stack([shift - 0.5, 0.02 + 0.62 * step])
        slats = sized(low, [1.0, 1.0, 0.1])
        crates = boxes(low + [0.04, 0.04, 0.1], low + [0.96, 0.96, 0.6])
        card = Material("crate", pick(rng, WALLS), 0.35, 0.5, pattern="plain")
        return [Part(slats, WOOD), Part(crates, card)]
    if kind == 3:  # a rack with boxes
        posts = np.array([[x, y, 0.0] for x in (-0.4, 0.34) for y in (-1.0, 0.94)])
        boards = np.array([[-0.4, -1.0, z] for z in (0.2, 0.95, 1.7)])
        low = np.array([[-0.3, y, z + 0.05] for z in (0.2, 0.95, 1.7) for y in (-0.9, -0.2, 0.4)])[rng.random(9) < 0.7]
        card = Material("box", pick(rng, WALLS), 0.35, 0.5, pattern="plain")
        rack = join([sized(posts, [0.06, 0.06, 2.3]), sized(boards, [0.8, 2.0, 0.05])])
        load = [Part(sized(low, [0.5, 0.45, 0.4]), card)] if len(low) else []
        return [Part(rack, DARK_STEEL), *load]
    if kind == 4:
        return any_vehicle(rng, 0.0)
    return (clutter, barrier, (pole, lamp, sign)[rng.integers(3)])[kind - 5](rng)
