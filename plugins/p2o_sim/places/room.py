"""A room: an office, a living room or a laboratory, lit by lamps and through its windows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from p2o_sim.places.building_shell import FloorPlan, Hall, Opening, daylight, outside, plinth, slab, wall
from p2o_sim.things import fittings
from p2o_sim.things.fittings import Item, Items, Style, coat_rack, floor_lamp, pendant, plant, strip_light, window_frame
from p2o_sim.things.people import pedestrian
from p2o_sim.world.lighting import Lamp, triple
from p2o_sim.world.mesh import boxes, tubes
from p2o_sim.world.palette import FRAME, STEEL, WOOD, pick
from p2o_sim.world.place import Layout, Plan, Thing, placed
from p2o_sim.world.scene import Class, Material, Part

_FLOORS = (
    ((0.36, 0.23, 0.13), 0.5, "streaks"), ((0.3, 0.3, 0.29), 0.35, "slabs"), ((0.12, 0.13, 0.16), 0.4, "rough"),
    ((0.42, 0.4, 0.36), 0.2, "plain"), ((0.2, 0.1, 0.07), 0.4, "rough"),
)  # fmt: skip
_TINTS = ((1.0, 0.98, 0.94), (1.0, 0.86, 0.66), (0.92, 1.0, 1.02))
"""Colours of lamps: neutral, warm, cold."""


def layout(plan: Plan) -> Layout:
    """Return a room about the rig, with a free metre to either side of its path."""
    rng = plan.rng
    kind = ("office", "office", "living", "laboratory")[rng.integers(4)]
    back, end, right, left = rng.uniform((1.8, 3.6, 1.7, 1.7), (4.5, 10.0, 4.6, 4.6)).tolist()
    hall = Hall(-back, plan.travel_m + end, -right, left, height=rng.uniform(2.4, 3.3))
    style, floor = Style(rng), FloorPlan(hall, plan.travel_m)
    openings = _openings(rng, hall)
    things: list[Thing] = [_shell(rng, hall, style, openings)]
    for name, holes in openings.items():
        things += _filled(rng, hall, style, name, holes)
        for hole in holes:
            if hole.low == 0.0:  # doorways stay free
                floor.take_before(name, (hole.start + hole.stop) / 2, hole.stop - hole.start, 0.9)
    things += _along_walls(rng, hall, floor, style, kind, openings)
    things += _in_the_middle(rng, floor, style, kind)
    lamps, lamp_things = _lamps(rng, hall)
    things += lamp_things + _below_ceiling(rng, hall) + outside(plan, hall)
    day = rng.uniform(0.1, 0.5)
    lamps += [daylight(hall, name, hole, day) for name, holes in openings.items() for hole in holes if hole.low > 0]
    ambient = rng.uniform(0.1, 0.28) * np.array([1.0, 0.97, 0.92]) * rng.uniform(0.94, 1.06, 3)
    lean = rng.uniform(-0.14, 0.14, 3) + [0.0, 0.0, 0.12]
    return Layout(things, [], [], (0.0, 0.0), hall.lighting(ambient, lean, lamps[:7]))


def _openings(rng: np.random.Generator, hall: Hall) -> dict[str, list[Opening]]:
    """Return the doorways and windows of each wall; windows are in one or two of them."""
    names = list(hall.walls)
    bright = set(rng.choice(names, size=rng.integers(1, 3), replace=False))
    out: dict[str, list[Opening]] = {name: [] for name in names}
    for name in names:
        length, at = hall.walls[name][3], rng.uniform(0.4, 1.2)
        low, high = rng.uniform(0.75, 1.1), hall.height - rng.uniform(0.15, 0.4)
        wide = rng.uniform(0.8, 2.0)
        door = rng.random() < 0.6
        while at + 0.95 < length - 0.3:
            if door and rng.random() < 0.4:
                out[name].append(Opening(at, at + 0.95, 0.0, min(2.05, hall.height - 0.2)))
                at, door = at + 0.95 + rng.uniform(0.5, 2.0), False
            elif name in bright and at + wide < length - 0.3:
                out[name].append(Opening(at, at + wide, low, high))
                at += wide + rng.uniform(0.3, 1.2)
            else:
                at += rng.uniform(0.8, 1.8)
    return out


def _shell(rng: np.random.Generator, hall: Hall, style: Style, openings: dict[str, list[Opening]]) -> Thing:
    """Return floor, ceiling, walls, one of them perhaps in another colour, and skirting boards."""
    colour, contrast, pattern = _FLOORS[rng.integers(len(_FLOORS))]
    ground = Material("floor", pick(rng, (colour,)), contrast, rng.uniform(0.2, 0.5), rng.choice([0.0, 0.06]), pattern)
    top = Material("ceiling", (0.66, 0.65, 0.63), 0.12, 0.6, pattern=("plain", "slabs")[rng.integers(2)])
    parts = [slab(hall, -0.25, 0.0, ground, Class.ROAD)]
    parts.append(slab(hall, hall.height, hall.height + 0.3, top, Class.BUILDING))
    accent = rng.choice(list(hall.walls)) if rng.random() < 0.35 else ""
    other = Material("accent wall", pick(rng, ((0.45, 0.2, 0.12), (0.1, 0.2, 0.3), (0.3, 0.36, 0.22))), 0.12, 0.5)
    skirting = style.metal() if rng.random() < 0.3 else FRAME
    for name, (_, _, _, length) in hall.walls.items():
        holes = openings[name]
        paint = other if name == accent else style.wall
        board = plinth(length, holes, skirting, deep=0.015, high=0.08)
        parts += hall.on_wall(name, [wall(length, hall.height, holes, paint), board], 0.0)
    return parts


def _filled(rng: np.random.Generator, hall: Hall, style: Style, name: str, holes: list[Opening]) -> list[Thing]:
    """Return frames, doors and blinds of the openings of a wall, and the corridors behind doorways."""
    out, rim = [], FRAME if rng.random() < 0.6 else WOOD
    for hole in holes:
        wide, high = hole.stop - hole.start, hole.high - hole.low
        if hole.low > 0:
            frame = window_frame(wide, high, 0.2, max(1, round(wide / 0.8)), rim, bool(rng.random() < 0.15))
            out.append(hall.on_wall(name, frame, hole.start, z=hole.low))
            if rng.random() < 0.4:
                out.append(hall.on_wall(name, fittings.blind(rng, wide, high), hole.start, z=hole.low))
            continue
        case = boxes(
            [[-0.07, -0.02, 0.0], [wide, -0.02, 0.0], [-0.07, -0.02, high]],
            [[0.0, 0.24, high], [wide + 0.07, 0.24, high], [wide + 0.07, 0.24, high + 0.07]],
        )
        leaf = Part(boxes([[0.0, 0.0, 0.01]], [[wide, 0.04, high]]), style.surface(), kind=Class.BUILDING)
        knob = Part(boxes([[wide - 0.1, -0.06, 1.0]], [[wide - 0.05, 0.1, 1.03]]), STEEL, kind=Class.BUILDING)
        # Hinged at its start and open into the next room: a corridor with a wall of its own.
        turn = 0.0 if rng.random() < 0.45 else rng.uniform(20.0, 100.0)
        door = [part.moved(yaw_deg=turn).moved(0.0, 0.05) for part in (leaf, knob)]
        out.append(hall.on_wall(name, [Part(case, rim, kind=Class.BUILDING), *door], hole.start))
        out.append(hall.on_wall(name, _corridor(rng, hall, style, wide), hole.start))
    return out


def _corridor(rng: np.random.Generator, hall: Hall, style: Style, wide: float) -> Thing:
    """Return a closed corridor behind a doorway from x = 0 to `wide`: floor, ceiling, walls."""
    deep, side = rng.uniform(1.4, 3.5), rng.uniform(0.5, 2.0)
    a, b, high = -side, wide + side, hall.height
    low = [[a, deep, 0.0], [a - 0.1, 0.22, 0.0], [b, 0.22, 0.0]]
    top = [[b, deep + 0.1, high], [a, deep + 0.1, high], [b + 0.1, deep + 0.1, high]]
    lid = boxes([[a, 0.2, high]], [[b, deep, high + 0.1]])
    ground = Material("corridor floor", pick(rng, ((0.25, 0.24, 0.22),)), 0.3, 0.3, pattern="slabs")
    base = Part(boxes([[a, 0.2, -0.1]], [[b, deep, 0.0]]), ground, kind=Class.ROAD)
    return [*(Part(mesh, style.wall, kind=Class.WALL) for mesh in (boxes(low, top), lid)), base]


def _along_walls(
    rng: np.random.Generator, hall: Hall, floor: FloorPlan, style: Style, kind: str, openings: dict[str, list[Opening]]
) -> list[Thing]:
    """Return furniture along the walls, low pieces only below windows, and wall prints above it."""
    out: list[Thing] = []
    for name, (_, _, _, length) in hall.walls.items():
        at = rng.uniform(0.05, 0.6)
        while at < length - 0.4:
            thing, wide, deep = _drawn(rng, fittings.WALL_ITEMS[kind])(style)
            middle = at + wide / 2
            high = max(float(part.mesh.vertices[:, 2].max()) for part in thing)
            hidden = [h for h in openings[name] if h.start < at + wide and at < h.stop]
            if any(h.low == 0 for h in hidden) or (hidden and high > max(h.low for h in hidden) + 0.45):
                at += 0.4
            elif middle + wide / 2 <= length and floor.take_before(name, middle, wide, deep):
                out.append(hall.on_wall(name, thing, middle, 0.02))
                if high < 1.3 and not hidden and rng.random() < 0.6:
                    out.append(hall.on_wall(name, fittings.wall_print(style), middle, z=1.65))
                at += wide + rng.choice([0.01, 0.05, 0.3, 0.8])
            else:
                at += 0.3
    return out


def _drawn(rng: np.random.Generator, items: Items) -> Callable[[Style], Item]:
    shares = np.array([share for _, share in items])
    return items[rng.choice(len(items), p=shares / shares.sum())][0]


def _in_the_middle(rng: np.random.Generator, floor: FloorPlan, style: Style, kind: str) -> list[Thing]:
    """Return tables, desks, people and plants on the free floor."""
    out: list[Thing] = []
    for number, (x, y) in enumerate(floor.spots(rng, int(rng.integers(20, 70)))):
        draw = rng.random()
        if draw < 0.5 or number < 4:
            thing, wide, deep = _drawn(rng, fittings.FLOOR_ITEMS[kind])(style)
        else:
            maker = (pedestrian, plant, floor_lamp, coat_rack, pedestrian)[rng.integers(5)]
            thing, wide, deep = maker(rng), 0.75, 0.75
        turn = 90.0 * rng.integers(4) + (rng.uniform(-12.0, 12.0) if wide < 1.0 else 0.0)
        if floor.take_turned(x, y, wide, deep, turn):
            out.append(placed(thing, x, y, yaw_deg=turn))
    return out


def _lamps(rng: np.random.Generator, hall: Hall) -> tuple[list[Lamp], list[Thing]]:
    """Return two to four lamps in a row below the ceiling, and their things; in a few rooms they are off."""
    on = rng.random() < 0.85
    tint = np.array(_TINTS[rng.integers(3)])
    count, hanging = int(rng.integers(2, 5)), rng.random() < 0.5
    drop = rng.uniform(0.35, 0.9) if hanging else 0.0
    strength = rng.uniform(0.5, 1.6) * hall.height / count
    y, lamps, things = rng.uniform(0.35, 0.65) * (hall.left - hall.right) + hall.right, [], []
    round_ones = rng.random() < 0.5
    for x in np.linspace(hall.back, hall.end, 2 * count + 1)[1::2]:
        low = hall.height - drop
        if hanging:
            # Not directly in front of the sensors.
            low = max(low, 2.0 if abs(y) < 1.2 else 1.5)
        if round_ones and hanging:
            things.append(placed(pendant(rng, hall.height, low, 8.0 if on else 0.0), x, y))
        else:
            lamp = strip_light(rng.uniform(0.6, 1.6), rng.uniform(0.12, 0.6), hall.height, hall.height - low, 6.0 * on)
            things.append(placed(lamp, x, y, yaw_deg=rng.choice([0.0, 90.0])))
        if on:
            colour = triple(tint * strength * 2.0)
            lamps.append(Lamp((float(x), float(y), low - 0.1), colour, 0.5, (0.0, 0.0, -1.0), 1.0, 0.15))
    return lamps, things


def _below_ceiling(rng: np.random.Generator, hall: Hall) -> list[Thing]:
    """Return beams, ducts and pipes below the ceiling of some rooms."""
    out: list[Thing] = []
    grey = Material("duct", (0.42, 0.43, 0.44), 0.15, 0.5, 0.1, "plain")
    if rng.random() < 0.35:
        deep, wide = rng.uniform(0.12, 0.35), rng.uniform(0.15, 0.3)
        for x in np.arange(hall.back + rng.uniform(0.5, 2.0), hall.end, rng.uniform(1.6, 3.0)):
            beam = boxes([[x, hall.right, hall.height - deep]], [[x + wide, hall.left, hall.height + 0.05]])
            out.append([Part(beam, WOOD if wide < 0.2 else grey, kind=Class.BUILDING)])
    if rng.random() < 0.4:
        y, radius = rng.uniform(hall.right + 0.3, hall.left - 0.3), rng.uniform(0.05, 0.16)
        z = hall.height - radius - rng.uniform(0.02, 0.15)
        pipe = tubes([[hall.back, y, z]], [[hall.end, y, z]], [radius], sides=12)
        out.append([Part(pipe, grey, kind=Class.BUILDING)])
    return out
