"""A hall: a warehouse or a factory with pillars, trusses, racks, machines and lamps under its roof."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from p2o.simulate.building_shell import (
    RIG_ROOM_M,
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
from p2o.simulate.fittings import Style, carton, pendant, picture, strip_light, trolley
from p2o.simulate.furniture import barrier, sign
from p2o.simulate.lighting import Inside, Lamp, Lighting
from p2o.simulate.mesh import Mesh, boxes, cylinder, join, loft, rectangle, tubes, wheel
from p2o.simulate.palette import (
    CONCRETE,
    DARK_STEEL,
    PAINT,
    SIGNS,
    STEEL,
    TRIM,
    TYRE,
    WALLS,
    WOOD,
    pick,
)
from p2o.simulate.people import pedestrian
from p2o.simulate.place import Layout, Plan, Thing, placed
from p2o.simulate.scene import Material, Part
from p2o.simulate.vehicles import car, van
from p2o.simulate.yard import stock

Item = tuple[Thing, float, float]
_PAINTS = ((0.03, 0.14, 0.36), (0.55, 0.16, 0.02), (0.6, 0.45, 0.03), (0.05, 0.2, 0.12), (0.35, 0.36, 0.37))
_LIGHTS = np.array([[1.0, 0.97, 0.9], [0.9, 1.0, 1.03], [1.0, 0.8, 0.55]])


def layout(plan: Plan) -> Layout:
    """Return a hall about the rig, which follows an aisle."""
    rng = plan.rng
    hall = Hall(
        back=-rng.uniform(5.0, 16.0),
        end=plan.travel_m + rng.uniform(12.0, 45.0),
        right=-rng.uniform(3.5, 16.0),
        left=rng.uniform(3.5, 16.0),
        height=rng.uniform(4.5, 10.0),
    )
    floor = FloorPlan(hall, plan.travel_m)
    openings = _openings(rng, hall)
    things: list[Thing] = [_shell(rng, hall, openings), *_marks(rng, hall)]
    for name, holes in openings.items():
        for hole in holes:
            if hole.low == 0.0:
                floor.take_before(name, (hole.start + hole.stop) / 2, hole.stop - hole.start, 2.5)
            things += _gate_or_window(rng, hall, name, hole)
    things += _frame(rng, hall, floor)
    if rng.random() < 0.65:
        things += _racks(rng, hall, floor, plan.travel_m)
    things += _on_the_floor(rng, floor)
    things += _on_the_walls(rng, hall, floor, openings)
    lamps, hung = _overhead(rng, hall)
    things += hung + outside(plan, hall)
    day = rng.uniform(0.2, 0.8)
    bright = [daylight(hall, name, hole, day) for name, holes in openings.items() for hole in holes]
    bright.sort(key=lambda lamp: -max(lamp.colour))
    ambient = rng.uniform(0.08, 0.22) * np.array([1.0, 0.98, 0.95]) * rng.uniform(0.95, 1.05, 3)
    lean = rng.uniform(-0.12, 0.12, 3) + [0.0, 0.0, 0.15]
    inside = Inside((hall.back, hall.right, 0.0), (hall.end, hall.left, hall.height), _triple(ambient), _triple(lean))
    lighting = Lighting(inside=inside, lamps=(*lamps[:6], *bright[:2]))
    return Layout(things, [], [], (0.0, 0.0), lighting)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _openings(rng: np.random.Generator, hall: Hall) -> dict[str, list[Opening]]:
    """Return gates in some walls, and high bands of windows in others."""
    out: dict[str, list[Opening]] = {}
    for name, (_, _, _, length) in hall.walls.items():
        holes, at = [], rng.uniform(1.0, 4.0)
        banded = rng.random() < 0.5
        low, high = 0.62 * hall.height, hall.height - 0.6
        while at + 4.5 < length - 0.5:
            if rng.random() < 0.22:
                wide = rng.uniform(2.8, 4.2)
                holes.append(Opening(at, at + wide, 0.0, min(rng.uniform(2.8, 4.2), hall.height - 0.6)))
                at += wide + rng.uniform(0.8, 3.0)
            elif banded:
                holes.append(Opening(at, at + 3.0, low, high))
                at += 3.0 + rng.uniform(0.5, 3.0)
            else:
                at += rng.uniform(2.0, 6.0)
        out[name] = holes
    return out


def _shell(rng: np.random.Generator, hall: Hall, openings: dict[str, list[Opening]]) -> Thing:
    """Return floor, roof and walls of panels, with a plinth."""
    tone = rng.uniform(0.7, 1.3)
    ground = Material("hall floor", _triple(np.array([0.27, 0.265, 0.25]) * tone), 0.35, rng.uniform(0.2, 0.45),
                      rng.choice([0.0, 0.08]), ("rough", "slabs", "asphalt")[rng.integers(3)])  # fmt: skip
    pattern = ("plain", "tiles", "brick", "rough")[rng.integers(4)]
    side = Material("hall wall", pick(rng, WALLS), 0.12 if pattern != "brick" else 0.4, 0.5, pattern=pattern)
    roof = Material("roof sheet", pick(rng, ((0.5, 0.5, 0.48), (0.25, 0.26, 0.27))), 0.2, 0.45, pattern="tiles")
    parts = [
        slab(hall, -0.25, 0.0, ground, Class.ROAD),
        slab(hall, hall.height, hall.height + 0.25, roof, Class.BUILDING),
    ]
    for name in hall.walls:
        parts += hall.on_wall(name, painted(wall(hall.walls[name][3], hall.height, openings[name]), side), 0.0)
    for name, (_, _, _, length) in hall.walls.items():
        gates = [hole for hole in openings[name] if hole.low == 0]
        stops = [0.0, *(edge for hole in gates for edge in (hole.start, hole.stop)), length]
        low = np.array([[a, -0.06, 0.0] for a in stops[::2]])
        high = np.array([[b, 0.0, 0.5] for b in stops[1::2]])
        parts += hall.on_wall(name, [Part(boxes(low, high), CONCRETE, kind=Class.WALL)], 0.0)
    return parts


def _marks(rng: np.random.Generator, hall: Hall) -> list[Thing]:
    """Return lines on the floor along the aisle."""
    yellow = Material("floor mark", (0.6, 0.42, 0.03), 0.4, 0.6, pattern="asphalt") if rng.random() < 0.7 else PAINT
    out = []
    for y in (-rng.uniform(1.3, 2.2), rng.uniform(1.3, 2.2)):
        line = boxes([[hall.back, y - 0.05, -0.01]], [[hall.end, y + 0.05, 0.002]])
        out.append([Part(line, yellow, kind=Class.ROAD)])
    return out


def _gate_or_window(rng: np.random.Generator, hall: Hall, name: str, hole: Opening) -> list[Thing]:
    """Return the frame of a window, or a gate let down as far as it is."""
    wide, high = hole.stop - hole.start, hole.high - hole.low
    if hole.low > 0:
        bars = [[x, 0.08, 0.0] for x in np.linspace(0.0, wide - 0.06, 4)]
        mesh = join(
            [
                boxes(bars, np.array(bars) + [0.06, 0.06, high]),
                boxes([[0.0, 0.08, 0.48 * high]], [[wide, 0.14, 0.52 * high]]),
            ]
        )
        return [hall.on_wall(name, [Part(mesh, STEEL, kind=Class.BUILDING)], hole.start, z=hole.low)]
    bottom = rng.choice([0.0, 0.0, 0.5, 0.9]) * high
    slats = np.arange(bottom, high, 0.12)
    low = np.column_stack([np.zeros(len(slats)), np.full(len(slats), 0.06), slats])
    paint = Material("gate", pick(rng, (*WALLS, *_PAINTS)), 0.2, 0.5, 0.05, "tiles")
    rails = boxes([[-0.1, -0.04, 0.0], [wide, -0.04, 0.0]], [[0.0, 0.1, high], [wide + 0.1, 0.1, high]])
    drum = tubes([[-0.1, -0.2, high + 0.2]], [[wide + 0.1, -0.2, high + 0.2]], [0.2], sides=12)
    gate = [
        Part(boxes(low, low + [wide, 0.03, 0.113]), paint, kind=Class.BUILDING),
        Part(join([rails, drum]), DARK_STEEL, kind=Class.BUILDING),
    ]
    return [hall.on_wall(name, gate, hole.start)]


def _frame(rng: np.random.Generator, hall: Hall, floor: FloorPlan) -> list[Thing]:
    """Return pillars, and trusses or beams across the hall on top of them."""
    out: list[Thing] = []
    steel = Material("frame", pick(rng, (*_PAINTS, (0.45, 0.45, 0.43))), 0.15, 0.45, 0.05, "plain")
    body = steel if rng.random() < 0.6 else CONCRETE
    step, deep = rng.uniform(4.0, 7.0), rng.uniform(0.6, 1.2)
    lower = hall.height - deep
    half = rng.uniform(0.12, 0.28)
    rows = [hall.right + 0.35, hall.left - 0.35]
    if hall.left - hall.right > 12.0:
        rows += [sign * rng.uniform(2.2, 5.5) for sign in (-1, 1) if rng.random() < 0.75]
    truss = rng.random() < 0.65
    for x in np.arange(hall.back + rng.uniform(0.8, 3.0), hall.end - 0.4, step):
        for y in rows:
            if not floor.take(x, y, half, half):
                continue
            if body is CONCRETE or rng.random() < 0.3:
                column = boxes([[x - half, y - half, 0.0]], [[x + half, y + half, lower]])
            else:  # an I-beam: two flanges and a web
                column = boxes(
                    [[x - half, y - half, 0.0], [x - half, y + half - 0.02, 0.0], [x - 0.01, y - half, 0.0]],
                    [[x + half, y - half + 0.02, lower], [x + half, y + half, lower], [x + 0.01, y + half, lower]],
                )
            thing = [Part(column, body, kind=Class.POLE)]
            if rng.random() < 0.3:
                guard = boxes([[x - half - 0.06, y - half - 0.06, 0.0]], [[x + half + 0.06, y + half + 0.06, 1.1]])
                yellow = Material("guard", (0.6, 0.42, 0.03), 0.4, 0.7, pattern="tiles")
                thing.append(Part(guard, yellow, kind=Class.FURNITURE))
            out.append(thing)
        out.append([Part(_truss(hall, float(x), lower) if truss else _beam(hall, float(x), lower), body,
                         kind=Class.BUILDING)])  # fmt: skip
    across = np.arange(hall.right + 1.0, hall.left, rng.uniform(1.5, 3.0))
    low = np.array([[hall.back, y, hall.height - 0.16] for y in across])
    out.append([Part(boxes(low, low + [hall.end - hall.back, 0.07, 0.17]), body, kind=Class.BUILDING)])
    return out


def _truss(hall: Hall, x: float, lower: float) -> Mesh:
    """Return a truss across the hall: two chords and diagonals between them."""
    upper = hall.height - 0.2
    y = np.linspace(hall.right + 0.1, hall.left - 0.1, 2 * max(3, round((hall.left - hall.right) / 2.4)) + 1)
    z = np.where(np.arange(len(y)) % 2 == 0, lower + 0.1, upper)
    points = np.column_stack([np.full(len(y), x), y, z])
    chords = [[x, hall.right, lower + 0.1], [x, hall.right, upper]]
    ends = [[x, hall.left, lower + 0.1], [x, hall.left, upper]]
    return join([tubes(chords, ends, 0.06, sides=6), tubes(points[:-1], points[1:], 0.035, sides=5)])


def _beam(hall: Hall, x: float, lower: float) -> Mesh:
    """Return a solid beam across the hall."""
    return boxes([[x - 0.1, hall.right, lower]], [[x + 0.1, hall.left, hall.height]])


def rack(rng: np.random.Generator, length: float, deep: float, high: float) -> Thing:
    """Return a rack along x from 0 to `length`, about y = 0: posts, beams, pallets with boxes, many places empty."""
    blue, orange = (Material("rack", pick(rng, _PAINTS), 0.2, 0.4, 0.05, "plain") for _ in range(2))
    bays = max(1, round(length / 2.7))
    x = np.linspace(0.0, length - 0.1, bays + 1)
    a, b = -deep / 2, deep / 2
    posts = np.array([[at, y, 0.0] for at in x for y in (a, b - 0.09)])
    floors = np.arange(0.0, high - 0.7, rng.uniform(1.2, 1.9))
    rails = np.array([[0.0, y, z] for z in floors[1:] for y in (a, b - 0.05)]).reshape(-1, 3)
    braces = [
        tubes([[at + 0.05, a, z]], [[at + 0.05, b, z + 0.9]], [0.02], sides=4)
        for at in x
        for z in np.arange(0.2, high - 1, 1.0)
    ]
    parts = [Part(join([boxes(posts, posts + [0.1, 0.09, high]), *braces]), blue, kind=Class.FURNITURE)]
    if len(rails):
        parts.append(Part(boxes(rails, rails + [length, 0.05, 0.12]), orange, kind=Class.FURNITURE))
    slats: list[np.ndarray] = []
    for z in floors + 0.12 * (floors > 0):
        for start, stop in pairwise(x):
            for at in np.arange(start + 0.15, stop - 0.85, 0.95):
                if rng.random() < 0.28:
                    continue
                slats.append(np.array([at, a + 0.08, z]))
                parts += _load(rng, at, a + 0.1, float(z) + 0.14, 0.8, deep - 0.2)
    if slats:
        low = np.array(slats)
        parts.append(Part(boxes(low, low + [0.82, deep - 0.16, 0.13]), WOOD, kind=Class.FURNITURE))
    return parts


def _load(rng: np.random.Generator, x: float, y: float, z: float, wide: float, deep: float) -> Thing:
    """Return what lies on a pallet: one large box, rows of small ones, or drums."""
    draw, high = rng.random(), rng.uniform(0.3, 0.95)
    paint = Material("goods", pick(rng, (*WALLS, (0.36, 0.25, 0.15), (0.4, 0.3, 0.2), *SIGNS)), 0.2, 0.5,
                     pattern="plain")  # fmt: skip
    if draw < 0.5:
        low = np.array([[x + rng.uniform(0, 0.08), y + rng.uniform(0, 0.15), z]])
        return [Part(boxes(low, low + [wide - 0.1, deep - 0.2, high]), paint, kind=Class.FURNITURE)]
    if draw < 0.85:
        rows = max(1, int(high / 0.28))
        low = np.array([[x + 0.4 * i, y + 0.42 * j, z + 0.28 * k] for i in (0, 1) for j in (0, 1) for k in range(rows)])
        low = low[(rng.random(len(low)) < 0.85) | (low[:, 2] < z + 0.01)]
        low[:, :2] += rng.uniform(-0.02, 0.02, (len(low), 2))
        return [Part(boxes(low, low + [0.37, 0.39, 0.27]), paint, kind=Class.FURNITURE)]
    drums = join([cylinder(0.19, z, z + 0.6, sides=12).moved(x + i, y + j) for i in (0.2, 0.6) for j in (0.25, 0.65)])
    return [Part(drums, paint, kind=Class.FURNITURE)]


def _racks(rng: np.random.Generator, hall: Hall, floor: FloorPlan, travel_m: float) -> list[Thing]:
    """Return racks along the aisle, on one side or both, with gaps between them, and behind each other."""
    out: list[Thing] = []
    for side in (-1, 1):
        if rng.random() < 0.2:
            continue
        edge = hall.left if side > 0 else -hall.right
        y = RIG_ROOM_M + rng.uniform(0.8, 1.8)
        while y + 0.6 < edge - 0.7:
            high = min(hall.height - rng.uniform(1.3, 2.2), rng.uniform(2.2, 7.0))
            x = hall.back + rng.uniform(0.8, 3.0)
            while x < min(hall.end - 3.5, travel_m + 32.0):
                length = 2.7 * rng.integers(1, 4)
                if floor.take(x + length / 2, side * (y + 0.55), length / 2, 0.55):
                    out.append(placed(rack(rng, length, 1.1, high), x, side * (y + 0.55)))
                x += length + rng.choice([0.15, 1.5, 3.5])
            y += 1.1 + rng.uniform(2.4, 3.6)
    return out


def machine(rng: np.random.Generator) -> Item:
    """Return a machine: a base, housings, a cylinder or two, pipes, a cabinet with a panel."""
    paint = Material("machine", pick(rng, _PAINTS), 0.15, 0.45, 0.06, "plain")
    other = Material("housing", pick(rng, (*WALLS, *_PAINTS)), 0.15, 0.45, 0.04, "plain")
    wide, deep, high = rng.uniform((1.2, 0.9, 1.0), (3.2, 2.0, 2.6))
    a, b = wide / 2, deep / 2
    cut = rng.uniform(-0.3, 0.3) * wide
    parts = [
        Part(boxes([[-a, -b, 0.0]], [[a, b, 0.35 * high]]), paint, kind=Class.FURNITURE),
        Part(boxes([[-a, -0.8 * b, 0.35 * high]], [[cut, 0.9 * b, high]]), other, kind=Class.FURNITURE),
    ]
    hood = loft([rectangle(0.9 * (a - cut), 1.2 * b, 0.35 * high), rectangle(0.5 * (a - cut), 0.7 * b, 0.8 * high)])
    parts.append(Part(hood.moved((a + cut) / 2), paint, kind=Class.FURNITURE))
    pipes = tubes(
        [[cut, 0.5 * b, 0.9 * high], [a - 0.1, 0.5 * b, 0.9 * high], [-a + 0.2, 0.0, high]],
        [[a - 0.1, 0.5 * b, 0.9 * high], [a - 0.1, 0.5 * b, 0.3 * high], [-a + 0.2, 0.0, high + 0.7]],
        [0.05, 0.05, 0.09],
        sides=8,
    )
    parts.append(Part(pipes, STEEL, kind=Class.FURNITURE))
    at = -b - 0.35
    cabinet = boxes([[-0.3 * a, at, 0.0]], [[-0.3 * a + 0.5, at + 0.3, 1.4]])
    panel = Material("panel", (0.05, 0.12, 0.16), 0.7, 0.1, 0.1, "slabs", glow=rng.choice([0.0, 0.8]))
    face = boxes([[-0.3 * a + 0.06, at - 0.006, 0.95]], [[-0.3 * a + 0.44, at + 0.01, 1.3]])
    rail = tubes([[-a, b + 0.4, 1.05], [-a, b + 0.4, 0.0], [a, b + 0.4, 0.0]],
                 [[a, b + 0.4, 1.05], [-a, b + 0.4, 1.05], [a, b + 0.4, 1.05]], 0.025, sides=6)  # fmt: skip
    yellow = Material("rail", (0.6, 0.42, 0.03), 0.2, 0.6, pattern="plain")
    parts += [Part(cabinet, other, kind=Class.FURNITURE), Part(face, panel, kind=Class.FURNITURE)]
    if rng.random() < 0.5:
        parts.append(Part(rail, yellow, kind=Class.FENCE))
    return parts, float(wide), float(deep + 0.9)


def fork_lift(rng: np.random.Generator) -> Item:
    """Return a fork lift that looks along +x, its forks somewhat raised, some with a pallet."""
    paint = Material("fork lift", pick(rng, _PAINTS), 0.15, 0.5, 0.15, "plain")
    body = loft(
        [rectangle(1.5, 1.05, 0.15, x=-0.1), rectangle(1.6, 1.1, 0.6, x=-0.15), rectangle(0.8, 1.0, 0.95, x=-0.5)]
    )
    corners = np.array([[x, y, 0.6] for x in (-0.75, 0.4) for y in (-0.5, 0.44)])
    tops = corners + [0.0, 0.0, 1.5] + np.where(corners[:, :1] > 0, [-0.25, 0.0, 0.0], 0.0)
    cage = join([tubes(corners, tops, 0.035, sides=6), boxes([[-0.8, -0.54, 2.08]], [[0.2, 0.48, 2.13]])])
    z = rng.uniform(0.05, 1.2)
    mast = boxes(
        [[0.72, -0.4, 0.08], [0.72, 0.32, 0.08], [0.72, -0.4, 1.9], [0.8, -0.45, z + 0.3]],
        [[0.82, -0.32, 2.0], [0.82, 0.4, 2.0], [0.8, 0.4, 2.0], [0.85, 0.45, z + 0.38]],
    )
    forks = boxes([[0.82, y, z] for y in (-0.3, 0.2)], [[1.9, y + 0.1, z + 0.04] for y in (-0.3, 0.2)])
    shanks = boxes([[0.82, y, z] for y in (-0.3, 0.2)], [[0.86, y + 0.1, z + 0.5] for y in (-0.3, 0.2)])
    wheels = [wheel(0.28, 0.2).moved(0.5, y, 0.28) for y in (-0.5, 0.5)]
    wheels += [wheel(0.22, 0.18).moved(-0.65, y, 0.22) for y in (-0.45, 0.45)]
    seat = boxes([[-0.5, -0.25, 0.9], [-0.6, -0.25, 0.95]], [[0.0, 0.25, 1.05], [-0.48, 0.25, 1.5]])
    parts = [
        Part(body, paint, kind=Class.VAN),
        Part(join([cage, mast, forks, shanks]), DARK_STEEL, kind=Class.VAN),
        Part(join(wheels), TYRE, kind=Class.VAN),
        Part(seat, TRIM, kind=Class.VAN),
    ]
    if rng.random() < 0.5:
        parts.append(Part(boxes([[0.9, -0.5, z + 0.04]], [[1.8, 0.5, z + 0.17]]), WOOD, kind=Class.VAN))
        parts += _load(rng, 0.95, -0.42, float(z) + 0.17, 0.8, 0.85)
    return parts, 3.9, 1.4


def pallets(rng: np.random.Generator) -> Item:
    """Return pallets on top of each other, or one with a load."""
    parts: Thing = []
    count = int(rng.integers(1, 8)) if rng.random() < 0.5 else 1
    for number in range(count):
        z, x, y = 0.145 * number, *rng.uniform(-0.03, 0.03, 2)
        decks = np.array([[x - 0.6, y - 0.4 + 0.16 * i, z + 0.115] for i in range(5)])
        blocks = np.array([[x - 0.6 + 0.52 * i, y - 0.4 + 0.33 * j, z + 0.02] for i in range(3) for j in range(3)])
        feet = np.array([[x - 0.6, y - 0.4 + 0.33 * j, z] for j in range(3)])
        mesh = join(
            [
                boxes(decks, decks + [1.2, 0.13, 0.025]),
                boxes(blocks, blocks + [0.14, 0.13, 0.1]),
                boxes(feet, feet + [1.2, 0.13, 0.022]),
            ]
        )
        parts.append(Part(mesh, WOOD, kind=Class.FURNITURE))
    if count == 1 or rng.random() < 0.2:
        for half in (-0.58, 0.02):
            parts += _load(rng, half, -0.4, 0.145 * count, 0.6, 0.85)
    return parts, 1.3, 0.95


def _on_the_floor(rng: np.random.Generator, floor: FloorPlan) -> list[Thing]:
    """Return machines, pallets, vehicles, people and clutter on the free floor."""
    out: list[Thing] = []
    tries = int(rng.integers(50, 130))
    vehicles = 0
    for x, y in floor.spots(rng, tries):
        draw = rng.random()
        if draw < 0.2:
            thing, wide, deep = machine(rng)
        elif draw < 0.3 and vehicles < 3:
            vehicles += 1
            if rng.random() < 0.6:
                thing, wide, deep = fork_lift(rng)
            else:
                thing, wide, deep = (van if rng.random() < 0.7 else car)(rng), 5.8, 2.3
        elif draw < 0.5:
            thing, wide, deep = pallets(rng)
        elif draw < 0.66:
            thing, wide, deep = pedestrian(rng), 0.8, 0.8
        elif draw < 0.76:
            thing, wide, deep = trolley(Style(rng))
        elif draw < 0.8:
            thing, wide, deep = barrier(rng), 0.3, 2.4
        elif draw < 0.84:
            thing, wide, deep = sign(rng), 0.7, 0.9
        elif draw < 0.9:
            thing, wide, deep = carton(rng), 0.8, 0.8
        else:
            thing, wide, deep = stock(rng, vehicles=False), 3.1, 2.5
        turn = 90.0 * rng.integers(4) + (rng.uniform(-15.0, 15.0) if wide < 1.4 else rng.uniform(-3.0, 3.0))
        half = (wide / 2, deep / 2) if round(turn / 90.0) % 2 == 0 else (deep / 2, wide / 2)
        if floor.take(x, y, *half, gap=0.15):
            out.append(placed(thing, x, y, yaw_deg=turn))
    return out


def _on_the_walls(
    rng: np.random.Generator, hall: Hall, floor: FloorPlan, openings: dict[str, list[Opening]]
) -> list[Thing]:
    """Return cupboards, boards, pipes and signs on the walls."""
    out: list[Thing] = []
    style = Style(rng)
    for name, (_, _, _, length) in hall.walls.items():
        at = rng.uniform(0.8, 3.0)
        while at < length - 1.5:
            free = not any(hole.start - 0.6 < at < hole.stop + 0.6 for hole in openings[name])
            if free and rng.random() < 0.5:
                out.append(hall.on_wall(name, picture(style), at, z=rng.uniform(1.4, 2.4)))
            elif free and floor.take_before(name, at, 0.9, 0.4):
                box = boxes([[-0.4, -0.35, 0.0]], [[0.4, -0.01, rng.uniform(1.2, 2.1)]])
                out.append(hall.on_wall(name, [Part(box, style.surface(), kind=Class.FURNITURE)], at))
            at += rng.uniform(1.2, 4.0)
        if rng.random() < 0.6:
            z = rng.uniform(0.45, 0.58) * hall.height
            pipes = [[0.1, -0.12 - 0.16 * i, z + 0.1 * i] for i in range(rng.integers(1, 4))]
            ends = [[length - 0.1, y, up] for _, y, up in pipes]
            out.append(hall.on_wall(name, [Part(tubes(pipes, ends, 0.05, sides=8), STEEL, kind=Class.BUILDING)], 0.0))
    return out


def _overhead(rng: np.random.Generator, hall: Hall) -> tuple[list[Lamp], list[Thing]]:
    """Return the light of the lamps, and what hangs below the roof: lamps, cable trays, ducts, a crane."""
    out: list[Thing] = []
    lamps: list[Lamp] = []
    tint = _LIGHTS[rng.integers(3)]
    on = rng.random() < 0.85
    low = hall.height - rng.uniform(0.9, 2.0)
    rows = np.linspace(hall.right, hall.left, 2 * int(rng.integers(1, 4)) + 1)[1::2]
    step = rng.uniform(4.0, 8.0)
    high_bay = rng.random() < 0.5
    for x in np.arange(hall.back + 0.4 * step, hall.end, step):
        for y in rows:
            if high_bay:
                out.append(placed(pendant(rng, hall.height, low, 8.0 * on), x, y))
            else:
                out.append(placed(strip_light(1.5, 0.16, hall.height, hall.height - low, 7.0 * on), x, y))
    # What lights the hall are a few strong ones in place of these many: each casts shadows, which takes time.
    for x in np.linspace(max(hall.back, -6.0), min(hall.end, 26.0), 4)[:-1] + 4.0:
        for y in (rows[0], rows[-1]) if len(rows) > 1 else rows:
            strength = rng.uniform(0.35, 0.6) * low**2
            lamps.append(Lamp((float(x), float(y), low - 0.15), _triple(tint * strength), 1.0, (0, 0, -1), 1.0, 0.3))
    lamps = lamps if on else []
    tray = Material("tray", pick(rng, ((0.4, 0.41, 0.42), (0.1, 0.1, 0.1))), 0.2, 0.45, 0.1, "plain")
    for _ in range(rng.integers(0, 4)):
        y, z = rng.uniform(hall.right + 0.6, hall.left - 0.6), hall.height - rng.uniform(1.0, 1.9)
        wide = rng.uniform(0.2, 0.5)
        sides = y + wide
        bed = boxes(
            [[hall.back, y, z], [hall.back, y, z], [hall.back, sides, z]],
            [[hall.end, sides, z + 0.02], [hall.end, y + 0.01, z + 0.1], [hall.end, sides + 0.01, z + 0.1]],
        )
        x = np.arange(hall.back + 0.7, hall.end, 2.0)
        wires = join([cylinder(0.01, z, hall.height + 0.01, sides=4).moved(at, y + wide / 2) for at in x])
        cables = tubes([[hall.back, y + 0.1, z + 0.04]], [[hall.end, y + 0.1, z + 0.04]], [0.03], sides=5)
        out.append([Part(join([bed, wires]), tray, kind=Class.POLE), Part(cables, TRIM, kind=Class.POLE)])
    if rng.random() < 0.5:
        y, radius = rng.uniform(hall.right + 1.0, hall.left - 1.0), rng.uniform(0.2, 0.45)
        z = hall.height - 1.1 - radius
        duct = Material("duct", (0.45, 0.46, 0.47), 0.2, 0.5, 0.15, "plain")
        out.append(
            [Part(tubes([[hall.back, y, z]], [[hall.end, y, z]], [radius], sides=14), duct, kind=Class.BUILDING)]
        )
    if rng.random() < 0.45 and low > 4.0:
        out.append(_crane(rng, hall, low))
    return lamps, out


def _crane(rng: np.random.Generator, hall: Hall, low: float) -> Thing:
    """Return a bridge crane across the hall with a hook that hangs down."""
    x, z = rng.uniform(5.0, max(6.0, min(hall.end - 2.0, 22.0))), low - 0.9
    yellow = Material("crane", (0.6, 0.42, 0.03), 0.15, 0.5, 0.1, "plain")
    y = rng.choice([-1.0, 1.0]) * rng.uniform(1.5, max(2.0, 0.8 * min(hall.left, -hall.right)))
    body = boxes(
        [[x - 0.25, hall.right, z], [x - 0.5, y - 0.4, z - 0.35]],
        [[x + 0.25, hall.left, z + 0.5], [x + 0.5, y + 0.4, z]],
    )
    bottom = max(1.9, z - rng.uniform(0.8, 2.5))
    rope = cylinder(0.03, bottom, z, sides=6).moved(x, y)
    hook = loft([rectangle(0.12, 0.3, bottom - 0.35), rectangle(0.2, 0.3, bottom)])
    return [
        Part(body, yellow, kind=Class.BUILDING),
        Part(join([rope, hook.moved(x, y)]), DARK_STEEL, kind=Class.FURNITURE),
    ]
