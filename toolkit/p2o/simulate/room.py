"""A room: an office, a living room or a laboratory, lit by lamps and by what falls in through its windows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from p2o.simulate.building_shell import (
    FloorPlan,
    Hall,
    Opening,
    daylight,
    outside,
    painted,
    slab,
    wall,
)
from p2o.simulate.classes import Class
from p2o.simulate.fittings import (
    FLOOR_ITEMS,
    WALL_ITEMS,
    Item,
    Style,
    blind,
    coat_rack,
    floor_lamp,
    pendant,
    picture,
    plant,
    strip_light,
    window_frame,
)
from p2o.simulate.lighting import Inside, Lamp, Lighting
from p2o.simulate.mesh import boxes, tubes
from p2o.simulate.palette import FRAME, STEEL, WOOD, pick
from p2o.simulate.people import pedestrian
from p2o.simulate.place import Layout, Plan, Thing, placed
from p2o.simulate.scene import Material, Part

_FLOORS = (
    ((0.36, 0.23, 0.13), 0.5, "streaks"),
    ((0.3, 0.3, 0.29), 0.35, "slabs"),
    ((0.12, 0.13, 0.16), 0.4, "rough"),
    ((0.42, 0.4, 0.36), 0.2, "plain"),
    ((0.2, 0.1, 0.07), 0.4, "rough"),
)
_TINTS = ((1.0, 0.98, 0.94), (1.0, 0.86, 0.66), (0.92, 1.0, 1.02))
"""Colours of lamps: neutral, warm, cold."""


def layout(plan: Plan) -> Layout:
    """Return a room about the rig, which has a metre to either side of its way."""
    rng = plan.rng
    kind = ("office", "office", "living", "laboratory")[rng.integers(4)]
    hall = Hall(
        back=-rng.uniform(1.8, 4.5),
        end=plan.travel_m + rng.uniform(3.6, 10.0),
        right=-rng.uniform(1.7, 4.6),
        left=rng.uniform(1.7, 4.6),
        height=rng.uniform(2.4, 3.3),
    )
    style, floor = Style(rng), FloorPlan(hall, plan.travel_m)
    openings = _openings(rng, hall)
    things: list[Thing] = [_shell(rng, hall, style, openings)]
    for name, holes in openings.items():
        things += _filled(rng, hall, style, name, holes)
        for hole in holes:
            if hole.low == 0.0:  # nothing stands in a doorway
                floor.take_before(name, (hole.start + hole.stop) / 2, hole.stop - hole.start, 0.9)
    things += _along_walls(rng, hall, floor, style, kind, openings)
    things += _in_the_middle(rng, floor, style, kind)
    lamps, lamp_things = _lamps(rng, hall)
    things += lamp_things + _below_ceiling(rng, hall) + outside(plan, hall)
    day = rng.uniform(0.1, 0.5)
    lamps += [daylight(hall, name, hole, day) for name, holes in openings.items() for hole in holes if hole.low > 0]
    ambient = rng.uniform(0.1, 0.28) * np.array([1.0, 0.97, 0.92]) * rng.uniform(0.94, 1.06, 3)
    lean = rng.uniform(-0.14, 0.14, 3) + [0.0, 0.0, 0.12]
    inside = Inside((hall.back, hall.right, 0.0), (hall.end, hall.left, hall.height), _triple(ambient), _triple(lean))
    lighting = Lighting(inside=inside, lamps=tuple(lamps[:7]))
    return Layout(things, [], [], (0.0, 0.0), lighting)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


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
    parts = [
        slab(hall, -0.25, 0.0, ground, Class.ROAD),
        slab(hall, hall.height, hall.height + 0.3, top, Class.BUILDING),
    ]
    accent = rng.choice(list(hall.walls)) if rng.random() < 0.35 else ""
    other = Material("accent wall", pick(rng, ((0.45, 0.2, 0.12), (0.1, 0.2, 0.3), (0.3, 0.36, 0.22))), 0.12, 0.5)
    skirting = style.metal() if rng.random() < 0.3 else FRAME
    for name, (_, _, _, length) in hall.walls.items():
        holes = openings[name]
        paint = other if name == accent else style.wall
        parts += hall.on_wall(name, painted(wall(length, hall.height, holes), paint), 0.0)
        stops = [0.0, *(edge for hole in holes if hole.low == 0 for edge in (hole.start, hole.stop)), length]
        low = np.array([[a, -0.015, 0.0] for a in stops[::2]])
        high = np.array([[b, 0.0, 0.08] for b in stops[1::2]])
        parts += hall.on_wall(name, [Part(boxes(low, high), skirting, kind=Class.WALL)], 0.0)
    return parts


def _filled(rng: np.random.Generator, hall: Hall, style: Style, name: str, holes: list[Opening]) -> list[Thing]:
    """Return frames, doors and blinds of the openings of a wall, and what lies behind doorways."""
    out = []
    rim = FRAME if rng.random() < 0.6 else WOOD
    for hole in holes:
        wide, high = hole.stop - hole.start, hole.high - hole.low
        if hole.low > 0:
            frame = window_frame(wide, high, 0.2, max(1, round(wide / 0.8)), rim, bool(rng.random() < 0.15))
            out.append(hall.on_wall(name, frame, hole.start, z=hole.low))
            if rng.random() < 0.4:
                out.append(hall.on_wall(name, blind(rng, wide, high), hole.start, z=hole.low))
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
        corridor = _corridor(rng, hall, style, wide)
        out.append(hall.on_wall(name, corridor, hole.start))
    return out


def _corridor(rng: np.random.Generator, hall: Hall, style: Style, wide: float) -> Thing:
    """Return a closed corridor behind a doorway from x = 0 to `wide`: floor, ceiling, walls."""
    deep, side = rng.uniform(1.4, 3.5), rng.uniform(0.5, 2.0)
    a, b, high = -side, wide + side, hall.height
    low = [[a, deep, 0.0], [a - 0.1, 0.22, 0.0], [b, 0.22, 0.0]]
    top = [[b, deep + 0.1, high], [a, deep + 0.1, high], [b + 0.1, deep + 0.1, high]]
    walls = Part(boxes(low, top), style.wall, kind=Class.WALL)
    lid = Part(boxes([[a, 0.2, high]], [[b, deep, high + 0.1]]), style.wall, kind=Class.WALL)
    ground = Material("corridor floor", pick(rng, ((0.25, 0.24, 0.22),)), 0.3, 0.3, pattern="slabs")
    base = Part(boxes([[a, 0.2, -0.1]], [[b, deep, 0.0]]), ground, kind=Class.ROAD)
    return [walls, lid, base]


def _along_walls(
    rng: np.random.Generator,
    hall: Hall,
    floor: FloorPlan,
    style: Style,
    kind: str,
    openings: dict[str, list[Opening]],
) -> list[Thing]:
    """Return furniture with its back to the walls, low pieces only below windows, and pictures above it."""
    out: list[Thing] = []
    for name, (_, _, _, length) in hall.walls.items():
        at = rng.uniform(0.05, 0.6)
        while at < length - 0.4:
            thing, wide, deep = _drawn(rng, WALL_ITEMS[kind])(style)
            middle = at + wide / 2
            high = max(float(part.mesh.vertices[:, 2].max()) for part in thing)
            hidden = [h for h in openings[name] if h.start < at + wide and at < h.stop]
            if any(h.low == 0 for h in hidden) or (hidden and high > max(h.low for h in hidden) + 0.45):
                at += 0.4
            elif middle + wide / 2 <= length and floor.take_before(name, middle, wide, deep):
                out.append(hall.on_wall(name, thing, middle, 0.02))
                if high < 1.3 and not hidden and rng.random() < 0.6:
                    out.append(hall.on_wall(name, picture(style), middle, z=1.65))
                at += wide + rng.choice([0.01, 0.05, 0.3, 0.8])
            else:
                at += 0.3
    return out


def _drawn(
    rng: np.random.Generator, items: tuple[tuple[Callable[[Style], Item], float], ...]
) -> Callable[[Style], Item]:
    shares = np.array([share for _, share in items])
    return items[rng.choice(len(items), p=shares / shares.sum())][0]


def _in_the_middle(rng: np.random.Generator, floor: FloorPlan, style: Style, kind: str) -> list[Thing]:
    """Return tables, desks, people and plants on the free floor."""
    out: list[Thing] = []
    tries = int(rng.integers(20, 70))
    for number, (x, y) in enumerate(floor.spots(rng, tries)):
        draw = rng.random()
        if draw < 0.5 or number < 4:
            thing, wide, deep = _drawn(rng, FLOOR_ITEMS[kind])(style)
        else:
            maker = (pedestrian, plant, floor_lamp, coat_rack, pedestrian)[rng.integers(5)]
            thing, wide, deep = maker(rng), 0.75, 0.75
        turn = 90.0 * rng.integers(4) + (rng.uniform(-12.0, 12.0) if wide < 1.0 else 0.0)
        half = (wide / 2, deep / 2) if round(turn / 90.0) % 2 == 0 else (deep / 2, wide / 2)
        if floor.take(x, y, *half):
            out.append(placed(thing, x, y, yaw_deg=turn))
    return out


def _lamps(rng: np.random.Generator, hall: Hall) -> tuple[list[Lamp], list[Thing]]:
    """Return two to four lamps in a row below the ceiling, and what they look like; a few rooms have theirs off."""
    on = rng.random() < 0.85
    tint = np.array(_TINTS[rng.integers(3)])
    count = int(rng.integers(2, 5))
    hanging = rng.random() < 0.5
    drop = rng.uniform(0.35, 0.9) if hanging else 0.0
    strength = rng.uniform(0.5, 1.6) * hall.height / count
    y, lamps, things = rng.uniform(0.35, 0.65) * (hall.left - hall.right) + hall.right, [], []
    round_ones = rng.random() < 0.5
    for x in np.linspace(hall.back, hall.end, 2 * count + 1)[1::2]:
        low = hall.height - drop
        if hanging:
            # Not before the sensors' noses.
            low = max(low, 2.0 if abs(y) < 1.2 else 1.5)
        if round_ones and hanging:
            things.append(placed(pendant(rng, hall.height, low, 8.0 if on else 0.0), x, y))
        else:
            lamp = strip_light(rng.uniform(0.6, 1.6), rng.uniform(0.12, 0.6), hall.height, hall.height - low, 6.0 * on)
            things.append(placed(lamp, x, y, yaw_deg=rng.choice([0.0, 90.0])))
        if on:
            lamps.append(
                Lamp((float(x), float(y), low - 0.1), _triple(tint * strength * 2.0), 0.5, (0.0, 0.0, -1.0), 1.0, 0.15)
            )
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
        out.append(
            [Part(tubes([[hall.back, y, z]], [[hall.end, y, z]], [radius], sides=12), grey, kind=Class.BUILDING)]
        )
    return out
