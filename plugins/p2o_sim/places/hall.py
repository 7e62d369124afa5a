"""A hall: a warehouse or a factory with pillars, trusses, racks, machines and lamps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from p2o_sim.places.building_shell import RIG_ROOM_M, FloorPlan, Hall, Opening, daylight, outside, plinth, slab, wall
from p2o_sim.places.yard import stock
from p2o_sim.things.fittings import Item, Style, carton, pendant, strip_light, trolley, wall_print
from p2o_sim.things.furniture import barrier, sign
from p2o_sim.things.people import pedestrian
from p2o_sim.things.vehicles import car, van
from p2o_sim.world.lighting import Lamp, triple
from p2o_sim.world.mesh import Mesh, boxes, cylinder, join, loft, rectangle, sized, stacked, tubes, wheel
from p2o_sim.world.palette import CONCRETE, DARK_STEEL, PAINT, SIGNS, STEEL, TRIM, TYRE, WALLS, WOOD, pick
from p2o_sim.world.place import Layout, Plan, Thing, placed
from p2o_sim.world.scene import Class, Material, Part, built

_PAINTS = ((0.03, 0.14, 0.36), (0.55, 0.16, 0.02), (0.6, 0.45, 0.03), (0.05, 0.2, 0.12), (0.35, 0.36, 0.37))
_LIGHTS = np.array([[1.0, 0.97, 0.9], [0.9, 1.0, 1.03], [1.0, 0.8, 0.55]])


def layout(plan: Plan) -> Layout:
    """Return a hall about the rig, which follows an aisle."""
    rng = plan.rng
    back, end, right, left = rng.uniform((5.0, 12.0, 3.5, 3.5), (16.0, 45.0, 16.0, 16.0)).tolist()
    hall = Hall(-back, plan.travel_m + end, -right, left, height=rng.uniform(4.5, 10.0))
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
    return Layout(things, [], [], (0.0, 0.0), hall.lighting(ambient, lean, [*lamps[:6], *bright[:2]]))


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
    tone, reflectance, gloss = rng.uniform(0.7, 1.3), rng.uniform(0.2, 0.45), rng.choice([0.0, 0.08])
    surface = ("rough", "slabs", "asphalt")[rng.integers(3)]
    ground = Material("hall floor", triple(np.array([0.27, 0.265, 0.25]) * tone), 0.35, reflectance, gloss, surface)
    pattern = ("plain", "tiles", "brick", "rough")[rng.integers(4)]
    side = Material("hall wall", pick(rng, WALLS), 0.12 if pattern != "brick" else 0.4, 0.5, pattern=pattern)
    roof = Material("roof sheet", pick(rng, ((0.5, 0.5, 0.48), (0.25, 0.26, 0.27))), 0.2, 0.45, pattern="tiles")
    parts = [slab(hall, -0.25, 0.0, ground, Class.ROAD)]
    parts.append(slab(hall, hall.height, hall.height + 0.25, roof, Class.BUILDING))
    for name, (_, _, _, length) in hall.walls.items():
        parts += hall.on_wall(name, [wall(length, hall.height, openings[name], side)], 0.0)
    for name, (_, _, _, length) in hall.walls.items():
        parts += hall.on_wall(name, [plinth(length, openings[name], CONCRETE, deep=0.06, high=0.5)], 0.0)
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
    """Return the frame of a window, or a partly lowered gate."""
    wide, high = hole.stop - hole.start, hole.high - hole.low
    if hole.low > 0:
        mesh = sized([[x, 0.08, 0.0] for x in np.linspace(0.0, wide - 0.06, 4)], [0.06, 0.06, high])
        mesh += boxes([[0.0, 0.08, 0.48 * high]], [[wide, 0.14, 0.52 * high]])
        return [hall.on_wall(name, [Part(mesh, STEEL, kind=Class.BUILDING)], hole.start, z=hole.low)]
    bottom = rng.choice([0.0, 0.0, 0.5, 0.9]) * high
    low = stacked(0.0, 0.06, np.arange(bottom, high, 0.12))
    paint = Material("gate", pick(rng, (*WALLS, *_PAINTS)), 0.2, 0.5, 0.05, "tiles")
    rails = boxes([[-0.1, -0.04, 0.0], [wide, -0.04, 0.0]], [[0.0, 0.1, high], [wide + 0.1, 0.1, high]])
    drum = tubes([[-0.1, -0.2, high + 0.2]], [[wide + 0.1, -0.2, high + 0.2]], [0.2], sides=12)
    solids = ((sized(low, [wide, 0.03, 0.113]), paint), (rails + drum, DARK_STEEL))
    return [hall.on_wall(name, built(Class.BUILDING, *solids), hole.start)]


def _frame(rng: np.random.Generator, hall: Hall, floor: FloorPlan) -> list[Thing]:
    """Return pillars, and trusses or beams across the hall on top of them."""
    out: list[Thing] = []
    steel = Material("frame", pick(rng, (*_PAINTS, (0.45, 0.45, 0.43))), 0.15, 0.45, 0.05, "plain")
    body = steel if rng.random() < 0.6 else CONCRETE
    step, lower, half = rng.uniform(4.0, 7.0), hall.height - rng.uniform(0.6, 1.2), rng.uniform(0.12, 0.28)
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
                thing.append(Part(guard, yellow))
            out.append(thing)
        across = boxes([[x - 0.1, hall.right, lower]], [[x + 0.1, hall.left, hall.height]])
        out.append([Part(_truss(hall, float(x), lower) if truss else across, body, kind=Class.BUILDING)])
    low = [[hall.back, y, hall.height - 0.16] for y in np.arange(hall.right + 1.0, hall.left, rng.uniform(1.5, 3.0))]
    out.append([Part(sized(low, [hall.end - hall.back, 0.07, 0.17]), body, kind=Class.BUILDING)])
    return out


def _truss(hall: Hall, x: float, lower: float) -> Mesh:
    """Return a truss across the hall: two chords and diagonals between them."""
    upper = hall.height - 0.2
    y = np.linspace(hall.right + 0.1, hall.left - 0.1, 2 * max(3, round((hall.left - hall.right) / 2.4)) + 1)
    z = np.where(np.arange(len(y)) % 2 == 0, lower + 0.1, upper)
    points = stacked(x, y, z)
    chords = [[x, hall.right, lower + 0.1], [x, hall.right, upper]]
    ends = [[x, hall.left, lower + 0.1], [x, hall.left, upper]]
    return tubes(chords, ends, 0.06, sides=6) + tubes(points[:-1], points[1:], 0.035, sides=5)


def rack(rng: np.random.Generator, length: float, deep: float, high: float) -> Thing:
    """Return a rack along x from 0 to `length`, about y = 0: posts, beams, pallets with boxes, many places empty."""
    blue, orange = (Material("rack", pick(rng, _PAINTS), 0.2, 0.4, 0.05, "plain") for _ in range(2))
    bays = max(1, round(length / 2.7))
    x = np.linspace(0.0, length - 0.1, bays + 1)
    a, b = -deep / 2, deep / 2
    posts = np.array([[at, y, 0.0] for at in x for y in (a, b - 0.09)])
    floors = np.arange(0.0, high - 0.7, rng.uniform(1.2, 1.9))
    rails = np.array([[0.0, y, z] for z in floors[1:] for y in (a, b - 0.05)]).reshape(-1, 3)
    feet = [(at + 0.05, z) for at in x for z in np.arange(0.2, high - 1, 1.0)]
    braces = [tubes([[at, a, z]], [[at, b, z + 0.9]], [0.02], sides=4) for at, z in feet]
    parts = [Part(join([sized(posts, [0.1, 0.09, high]), *braces]), blue)]
    if len(rails):
        parts.append(Part(sized(rails, [length, 0.05, 0.12]), orange))
    slats = []
    for z in floors + 0.12 * (floors > 0):
        for start, stop in pairwise(x):
            for at in np.arange(start + 0.15, stop - 0.85, 0.95):
                if rng.random() < 0.28:
                    continue
                slats.append([at, a + 0.08, z])
                parts += _load(rng, at, a + 0.1, float(z) + 0.14, 0.8, deep - 0.2)
    if slats:
        parts.append(Part(sized(slats, [0.82, deep - 0.16, 0.13]), WOOD))
    return parts


def _load(rng: np.random.Generator, x: float, y: float, z: float, wide: float, deep: float) -> Thing:
    """Return the load of a pallet: one large box, rows of small ones, or drums."""
    draw, high = rng.random(), rng.uniform(0.3, 0.95)
    colour = pick(rng, (*WALLS, (0.36, 0.25, 0.15), (0.4, 0.3, 0.2), *SIGNS))
    paint = Material("goods", colour, 0.2, 0.5, pattern="plain")
    if draw < 0.5:
        low = np.array([[x + rng.uniform(0, 0.08), y + rng.uniform(0, 0.15), z]])
        return [Part(sized(low, [wide - 0.1, deep - 0.2, high]), paint)]
    if draw < 0.85:
        rows = max(1, int(high / 0.28))
        low = np.array([[x + 0.4 * i, y + 0.42 * j, z + 0.28 * k] for i in (0, 1) for j in (0, 1) for k in range(rows)])
        low = low[(rng.random(len(low)) < 0.85) | (low[:, 2] < z + 0.01)]
        low[:, :2] += rng.uniform(-0.02, 0.02, (len(low), 2))
        return [Part(sized(low, [0.37, 0.39, 0.27]), paint)]
    drums = join([cylinder(0.19, z, z + 0.6, sides=12).moved(x + i, y + j) for i in (0.2, 0.6) for j in (0.25, 0.65)])
    return [Part(drums, paint)]


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
    hood = loft([rectangle(0.9 * (a - cut), 1.2 * b, 0.35 * high), rectangle(0.5 * (a - cut), 0.7 * b, 0.8 * high)])
    pipes = tubes(
        [[cut, 0.5 * b, 0.9 * high], [a - 0.1, 0.5 * b, 0.9 * high], [-a + 0.2, 0.0, high]],
        [[a - 0.1, 0.5 * b, 0.9 * high], [a - 0.1, 0.5 * b, 0.3 * high], [-a + 0.2, 0.0, high + 0.7]],
        [0.05, 0.05, 0.09],
        sides=8,
    )
    at = -b - 0.35
    cabinet = boxes([[-0.3 * a, at, 0.0]], [[-0.3 * a + 0.5, at + 0.3, 1.4]])
    panel = Material("panel", (0.05, 0.12, 0.16), 0.7, 0.1, 0.1, "slabs", glow=rng.choice([0.0, 0.8]))
    face = boxes([[-0.3 * a + 0.06, at - 0.006, 0.95]], [[-0.3 * a + 0.44, at + 0.01, 1.3]])
    rail = tubes([[-a, b + 0.4, 1.05], [-a, b + 0.4, 0.0], [a, b + 0.4, 0.0]],
                 [[a, b + 0.4, 1.05], [-a, b + 0.4, 1.05], [a, b + 0.4, 1.05]], 0.025, sides=6)  # fmt: skip
    yellow = Material("rail", (0.6, 0.42, 0.03), 0.2, 0.6, pattern="plain")
    parts = [
        Part(boxes([[-a, -b, 0.0]], [[a, b, 0.35 * high]]), paint),
        Part(boxes([[-a, -0.8 * b, 0.35 * high]], [[cut, 0.9 * b, high]]), other),
        Part(hood.moved((a + cut) / 2), paint),
        *built(Class.FURNITURE, (pipes, STEEL), (cabinet, other), (face, panel)),
    ]
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
    cage = tubes(corners, tops, 0.035, sides=6) + boxes([[-0.8, -0.54, 2.08]], [[0.2, 0.48, 2.13]])
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
    steel = cage + mast + forks + shanks
    parts = built(Class.VAN, (body, paint), (steel, DARK_STEEL), (join(wheels), TYRE), (seat, TRIM))
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
        decks = sized([[x - 0.6, y - 0.4 + 0.16 * i, z + 0.115] for i in range(5)], [1.2, 0.13, 0.025])
        blocks = [[x - 0.6 + 0.52 * i, y - 0.4 + 0.33 * j, z + 0.02] for i in range(3) for j in range(3)]
        feet = sized([[x - 0.6, y - 0.4 + 0.33 * j, z] for j in range(3)], [1.2, 0.13, 0.022])
        parts.append(Part(decks + sized(blocks, [0.14, 0.13, 0.1]) + feet, WOOD))
    if count == 1 or rng.random() < 0.2:
        for half in (-0.58, 0.02):
            parts += _load(rng, half, -0.4, 0.145 * count, 0.6, 0.85)
    return parts, 1.3, 0.95


def _vehicle(rng: np.random.Generator) -> Item:
    if rng.random() < 0.6:
        return fork_lift(rng)
    return (van if rng.random() < 0.7 else car)(rng), 5.8, 2.3


_FLOOR_ITEMS: tuple[tuple[float, Callable[[np.random.Generator], Item]], ...] = (
    (0.2, machine),
    (0.3, _vehicle),
    (0.5, pallets),
    (0.66, lambda rng: (pedestrian(rng), 0.8, 0.8)),
    (0.76, lambda rng: trolley(Style(rng))),
    (0.8, lambda rng: (barrier(rng), 0.3, 2.4)),
    (0.84, lambda rng: (sign(rng), 0.7, 0.9)),
    (0.9, lambda rng: (carton(rng), 0.8, 0.8)),
    (1.0, lambda rng: (stock(rng, vehicles=False), 3.1, 2.5)),
)
"""Things on the floor with their width and depth, and cumulative frequencies."""
_MOST_VEHICLES = 3


def _on_the_floor(rng: np.random.Generator, floor: FloorPlan) -> list[Thing]:
    """Return machines, pallets, vehicles, people and clutter on the free floor."""
    out: list[Thing] = []
    vehicles = 0
    for x, y in floor.spots(rng, int(rng.integers(50, 130))):
        draw = rng.random()
        make = next(m for share, m in _FLOOR_ITEMS if draw < share and (m is not _vehicle or vehicles < _MOST_VEHICLES))
        vehicles += make is _vehicle
        thing, wide, deep = make(rng)
        turn = 90.0 * rng.integers(4) + (rng.uniform(-15.0, 15.0) if wide < 1.4 else rng.uniform(-3.0, 3.0))
        if floor.take_turned(x, y, wide, deep, turn, gap=0.15):
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
                out.append(hall.on_wall(name, wall_print(style), at, z=rng.uniform(1.4, 2.4)))
            elif free and floor.take_before(name, at, 0.9, 0.4):
                box = boxes([[-0.4, -0.35, 0.0]], [[0.4, -0.01, rng.uniform(1.2, 2.1)]])
                out.append(hall.on_wall(name, [Part(box, style.surface())], at))
            at += rng.uniform(1.2, 4.0)
        if rng.random() < 0.6:
            z = rng.uniform(0.45, 0.58) * hall.height
            pipes = [[0.1, -0.12 - 0.16 * i, z + 0.1 * i] for i in range(rng.integers(1, 4))]
            tube = tubes(pipes, [[length - 0.1, y, up] for _, y, up in pipes], 0.05, sides=8)
            out.append(hall.on_wall(name, [Part(tube, STEEL, kind=Class.BUILDING)], 0.0))
    return out


def _overhead(rng: np.random.Generator, hall: Hall) -> tuple[list[Lamp], list[Thing]]:
    """Return the light of the lamps, and things below the roof: lamps, cable trays, ducts, a crane."""
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
            strip = strip_light(1.5, 0.16, hall.height, hall.height - low, 7.0 * on)
            out.append(placed(pendant(rng, hall.height, low, 8.0 * on) if high_bay else strip, x, y))
    # Few strong lamps illuminate the hall instead of many weak ones, because shadows of each are expensive.
    for x in np.linspace(max(hall.back, -6.0), min(hall.end, 26.0), 4)[:-1] + 4.0:
        for y in (rows[0], rows[-1]) if len(rows) > 1 else rows:
            strength = rng.uniform(0.35, 0.6) * low**2
            lamps.append(Lamp((float(x), float(y), low - 0.15), triple(tint * strength), 1.0, (0, 0, -1), 1.0, 0.3))
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
        out.append([Part(bed + wires, tray, kind=Class.POLE), Part(cables, TRIM, kind=Class.POLE)])
    if rng.random() < 0.5:
        y, radius = rng.uniform(hall.right + 1.0, hall.left - 1.0), rng.uniform(0.2, 0.45)
        z = hall.height - 1.1 - radius
        duct = tubes([[hall.back, y, z]], [[hall.end, y, z]], [radius], sides=14)
        out.append([Part(duct, Material("duct", (0.45, 0.46, 0.47), 0.2, 0.5, 0.15, "plain"), kind=Class.BUILDING)])
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
    return [Part(body, yellow, kind=Class.BUILDING), Part(join([rope, hook.moved(x, y)]), DARK_STEEL)]
