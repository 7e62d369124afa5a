"""Roadside objects: poles, lamps, signs, traffic lights, fences, guard rails, shelters, barriers, clutter."""

from __future__ import annotations

import numpy as np

from p2o_sim.world.mesh import boxes, cylinder, join, sized, stacked, tubes, wheel
from p2o_sim.world.palette import CLOTH, CONCRETE, DARK_STEEL, GLASS, SIGN_BACK, SIGNS, STEEL, TRIM, WOOD, pick
from p2o_sim.world.scene import Class, Material, Part, built


def lamp(rng: np.random.Generator, *, high: float = 0.0) -> list[Part]:
    """Return a street lamp whose arm reaches along +y, over the road."""
    tall, arm = high or rng.uniform(5.0, 9.0), rng.uniform(0.8, 2.0)
    start, end = [[0, 0, -0.2], [0, 0, tall * 0.95]], [[0, 0, tall], [0, arm, tall + 0.15]]
    mast = tubes(start, end, [[0.09, 0.06], [0.05, 0.04]], sides=10)
    head = boxes([[-0.12, arm - 0.1, tall + 0.05]], [[0.12, arm + 0.6, tall + 0.2]])
    return [Part(mast, STEEL, kind=Class.POLE), Part(head, SIGN_BACK, kind=Class.POLE)]


def pole(rng: np.random.Generator) -> list[Part]:
    """Return a bare pole, thick or thin."""
    tall, thick = rng.uniform(2.5, 8.0), rng.uniform(0.03, 0.12)
    material = (STEEL, DARK_STEEL, WOOD)[rng.integers(3)]
    return [Part(tubes([[0, 0, -0.2]], [[0, 0, tall]], [[thick, 0.8 * thick]], sides=10), material, kind=Class.POLE)]


def sign(rng: np.random.Generator) -> list[Part]:
    """Return one or two plates on a thin pole that look towards -x: round, square, or a board with a rim."""
    high, half = rng.uniform(1.9, 2.6), rng.uniform(0.28, 0.42)
    parts = [Part(tubes([[0, 0, -0.2]], [[0, 0, high + half + 0.1]], 0.035, sides=8), STEEL, kind=Class.POLE)]
    for plate in range(1 + (rng.random() < 0.35)):
        z = high - plate * (2 * half + 0.08)
        rim, face = (Material("sign", pick(rng, SIGNS), 0.15, 0.97, pattern="plain") for _ in range(2))
        if rng.random() < 0.5:
            discs = wheel(half, 0.02, 24), wheel(0.72 * half, 0.03, 20)
            board, inner = (disc.moved(yaw_deg=90.0).moved(-0.05, 0, z) for disc in discs)
        else:
            board = boxes([[-0.06, -half, z - half]], [[-0.04, half, z + half]])
            inner = boxes([[-0.066, -0.7 * half, z - 0.7 * half]], [[-0.045, 0.7 * half, z + 0.7 * half]])
        parts += [Part(board, rim, kind=Class.SIGN), Part(inner, face, kind=Class.SIGN)]
    return parts


def gantry(rng: np.random.Generator, left: float, right: float) -> list[Part]:
    """Return a sign bridge across the road from y = `right` to `left`, with boards that look towards -x."""
    tall = rng.uniform(6.2, 7.0)
    beams = tubes(
        [[0, left, -0.3], [0, right, -0.3], [0, left, tall], [0, left, tall + 0.8]],
        [[0, left, tall + 0.8], [0, right, tall + 0.8], [0, right, tall], [0, right, tall + 0.8]],
        [[0.18, 0.16], [0.18, 0.16], [0.1, 0.1], [0.1, 0.1]],
        sides=8,
    )
    blue = Material("board", (0.02, 0.09, 0.35), 0.15, 0.95, pattern="plain")
    white = Material("letters", (0.75, 0.75, 0.74), 0.1, 0.95, pattern="plain")
    middle = np.linspace(right, left, 5)[1:4:2] + rng.uniform(-0.8, 0.8, 2)
    boards = sized([[-0.25, y - 1.8, tall - 0.7] for y in middle], [0.08, 3.6, 2.2])
    marks = [[-0.262, y - 1.2, tall + 0.2 * i] for y in middle for i in range(0, 6, 2)]
    letters = Part(sized(marks, [0.02, rng.uniform(1.2, 2.2), 0.18]), white, kind=Class.SIGN)
    return [Part(beams, STEEL, kind=Class.POLE), Part(boards, blue, kind=Class.SIGN), letters]


def traffic_light(rng: np.random.Generator) -> list[Part]:
    """Return a traffic light on a mast that looks towards -x, some with a second one on an arm over the road (+y)."""
    places, masts = [(0.0, rng.uniform(2.2, 2.6))], [([0, 0, -0.2], [0, 0, 3.4], 0.07)]
    if rng.random() < 0.5:
        arm = rng.uniform(2.5, 4.0)
        masts = [([0, 0, -0.2], [0, 0, 5.6], 0.09), ([0, 0, 5.4], [0, arm, 5.6], 0.05)]
        places.append((arm, 4.9))
    start, end, thick = (np.array(v) for v in zip(*masts, strict=True))
    housing = sized([[-0.3, y - 0.16, z] for y, z in places], [0.22, 0.32, 0.95])
    visors = sized([[-0.42, y - 0.1, z + 0.24 + 0.3 * i] for y, z in places for i in range(3)], [0.14, 0.2, 0.02])
    parts = [Part(tubes(start, end, thick, sides=10), STEEL, kind=Class.POLE)]
    parts.append(Part(housing + visors, TRIM, kind=Class.TRAFFIC_LIGHT))
    lit = rng.integers(3)
    for i, (red, green, blue) in enumerate(((0.02, 0.25, 0.06), (0.3, 0.2, 0.02), (0.35, 0.02, 0.02))):
        bright = (min(3 * red, 1.0), min(3 * green, 1.0), min(3 * blue, 1.0)) if i == lit else (red, green, blue)
        lens = [wheel(0.1, 0.03, 12).moved(yaw_deg=90.0).moved(-0.31, y, z + 0.17 + 0.3 * i) for y, z in places]
        parts.append(Part(join(lens), Material("lens", bright, 0.1, 0.4, 0.1, "plain"), kind=Class.TRAFFIC_LIGHT))
    return parts


def guard_rail(length: float) -> list[Part]:
    """Return a guard rail along x from 0 to `length`: a beam with two ribs on posts, facing -y."""
    stakes = sized(stacked(np.arange(0.5, length, 2.0), 0.0, -0.2), [0.06, 0.1, 0.92])
    beam = boxes(
        [[0, -0.06, 0.46], [0, -0.03, 0.55], [0, -0.06, 0.63]],
        [[length, -0.02, 0.55], [length, -0.01, 0.63], [length, -0.02, 0.74]],
    )
    return [Part(stakes + beam, STEEL, kind=Class.GUARD_RAIL)]


def fence(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a fence along x from 0 to `length`: pickets, metal bars or a solid wall."""
    high, kind = rng.uniform(0.9, 1.7), rng.integers(3)
    if kind == 2:
        wall = Material("garden wall", pick(rng, ((0.4, 0.38, 0.34), (0.3, 0.14, 0.1))), 0.5, 0.4, pattern="brick")
        return [Part(boxes([[0, -0.12, -0.3]], [[length, 0.12, 0.7 * high]]), wall, kind=Class.WALL)]
    gap, wide, material = ((0.14, 0.09, WOOD), (0.13, 0.02, DARK_STEEL))[kind]
    bars = sized(stacked(np.arange(0.0, length - wide, gap), -0.012, 0.06), [wide, 0.024, high - 0.06])
    stakes = sized(stacked(np.arange(0.0, length, 2.4), -0.04, -0.2), [0.08, 0.08, high + 0.25])
    rails = boxes([[0, 0.015, 0.2], [0, 0.015, high - 0.2]], [[length, 0.04, 0.28], [length, 0.04, high - 0.12]])
    return [Part(bars + stakes + rails, material, kind=Class.FENCE)]


def noise_wall(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a noise barrier along x from 0 to `length`, panels between posts."""
    high = rng.uniform(2.4, 4.0)
    colour = pick(rng, ((0.3, 0.33, 0.26), (0.36, 0.34, 0.3), (0.2, 0.26, 0.2)))
    panels = boxes([[0, -0.08, -0.5]], [[length, 0.08, high]])
    posts = sized(stacked(np.arange(0.0, length, 4.0), -0.14, -0.5), [0.2, 0.28, high + 0.6])
    return built(Class.WALL, (panels, Material("panel", colour, 0.4, 0.4, pattern="tiles")), (posts, DARK_STEEL))


def shelter(rng: np.random.Generator) -> list[Part]:
    """Return a bus shelter open towards -y: glass walls between posts under a flat roof, with a bench."""
    wide = rng.uniform(3.0, 4.5)
    half = wide / 2
    frame = boxes(
        [[-half, -0.7, 2.3], [-half, 0.62, 0], [half - 0.08, 0.62, 0], [-half, -0.7, 0], [half - 0.08, -0.7, 0]],
        [[half, 0.7, 2.45], [-half + 0.08, 0.7, 2.3], [half, 0.7, 2.3], [-half + 0.08, -0.62, 2.3], [half, -0.62, 2.3]],
    )
    panes = boxes(
        [[-half + 0.1, 0.64, 0.2], [-half + 0.02, -0.6, 0.2]], [[half - 0.1, 0.67, 2.25], [-half + 0.05, 0.6, 2.25]]
    )
    seat = boxes([[-0.3 * wide, 0.2, 0.42]], [[0.3 * wide, 0.55, 0.48]])
    return [Part(frame, DARK_STEEL), Part(panes, GLASS), Part(seat, WOOD)]


def barrier(rng: np.random.Generator) -> list[Part]:
    """Return two striped boards on posts across y, with a gap to look through under and between them."""
    wide = rng.uniform(1.6, 2.4)
    red = Material("barrier", (0.5, 0.05, 0.04), 0.2, 0.9, pattern="plain")
    white = Material("barrier board", (0.7, 0.7, 0.68), 0.2, 0.9, pattern="plain")
    posts = sized([[0.05, y - 0.03, 0.0] for y in (-0.4 * wide, 0.4 * wide)], [0.06, 0.06, 1.15])
    cells = np.linspace(-0.5 * wide, 0.5 * wide, 11)[:-1]
    low = np.array([[0.0, y, z] for z in (0.4, 0.85) for y in cells])
    is_red = (np.arange(20) + (np.arange(20) >= 10)) % 2 == 0
    stripes = ((red, is_red), (white, ~is_red))
    boards = [Part(sized(low[rows], [0.04, wide / 10, 0.24]), paint, kind=Class.FENCE) for paint, rows in stripes]
    return [Part(posts, STEEL, kind=Class.FENCE), *boards]


def clutter(rng: np.random.Generator) -> list[Part]:
    """Return something small: a cabinet, a dustbin, a bench, a bollard row, a post box."""
    kind = rng.integers(4)
    paint = Material("painted", pick(rng, CLOTH), 0.25, 0.4, 0.05, "plain")
    if kind == 0:
        x, y, z = rng.uniform((0.3, 0.4, 0.8), (0.6, 1.2, 1.5))
        return [Part(boxes([[-x / 2, -y / 2, 0]], [[x / 2, y / 2, z]]), paint)]
    if kind == 1:
        bins = [cylinder(0.26, 0.05, 1.0, top_radius=0.31, sides=10).moved(0.0, y) for y in (0.0, 0.75)]
        return [Part(join(bins), paint)]
    if kind == 2:
        wide = rng.uniform(1.4, 2.0)
        half = wide / 2
        seat = boxes([[-half, -0.22, 0.42], [-half, 0.2, 0.58]], [[half, 0.22, 0.48], [half, 0.24, 0.92]])
        feet = sized([[x - 0.04, -0.2, 0.0] for x in (-0.4 * wide, 0.4 * wide)], [0.08, 0.4, 0.42])
        return [Part(seat, WOOD), Part(feet, STEEL)]
    posts = join([cylinder(0.06, 0.0, 0.95, sides=10).moved(x) for x in np.arange(4) * 1.3])
    return [Part(posts, CONCRETE, kind=Class.POLE)]


def marker_post() -> list[Part]:
    """Return a white roadside post with a black band."""
    white = Material("marker post", (0.7, 0.7, 0.68), 0.15, 0.6, pattern="plain")
    band = Part(boxes([[-0.034, -0.064, 0.72]], [[0.034, 0.064, 0.9]]), TRIM, kind=Class.POLE)
    return [Part(boxes([[-0.03, -0.06, -0.2]], [[0.03, 0.06, 1.0]]), white, kind=Class.POLE), band]


def wires(length: float, y: float, z: float) -> list[Part]:
    """Return sagging wires along x from 0 to `length`."""
    x = np.linspace(0, length, 13)
    points = stacked(x, y, z - 1.2 * (1 - (2 * x / length - 1) ** 2))
    return [Part(tubes(points[:-1], points[1:], 0.015, sides=4), TRIM, kind=Class.POLE)]
