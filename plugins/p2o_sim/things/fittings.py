"""Interior objects: tables, chairs, shelves, cupboards, screens, lamps, plants in pots, boxes.

Things for walls have their back at y = 0 and are seen from -y, centred on x = 0; all others stand about the z axis.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from p2o import Float

from p2o_sim.things.plants import leaf
from p2o_sim.world.lighting import triple
from p2o_sim.world.mesh import boxes, circle, cylinder, join, leaves, loft, rectangle, sized, stacked, tubes, wheel
from p2o_sim.world.palette import BARK, CLOTH, DARK_STEEL, GLASS, RUBBER, SIGNS, STEEL, TRIM, WALLS, WOOD, pick
from p2o_sim.world.place import Thing, placed
from p2o_sim.world.scene import Class, Material, Part

Item = tuple[Thing, float, float]
"""A thing with its width (x) and depth (y)."""

_WOODS = ((0.42, 0.27, 0.15), (0.2, 0.11, 0.06), (0.55, 0.43, 0.28), (0.62, 0.61, 0.58), (0.1, 0.07, 0.05))
_CARDS = ((0.36, 0.25, 0.15), (0.42, 0.31, 0.19), (0.3, 0.2, 0.12), (0.55, 0.54, 0.5))
_SPINES = (
    (0.5, 0.06, 0.05), (0.05, 0.1, 0.3), (0.6, 0.58, 0.5), (0.05, 0.2, 0.1), (0.02, 0.02, 0.02), (0.55, 0.4, 0.1),
)  # fmt: skip


class Style:
    """Materials of one room: its walls, and furniture, some of which has nearly the colour of the walls."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        pale = np.array(WALLS[rng.integers(len(WALLS))]) if rng.random() < 0.4 else np.array([0.68, 0.67, 0.64])
        self.wall_colour = triple(np.clip(pale * rng.uniform(0.75, 1.12), 0.02, 0.85))
        pattern, rough = (("plain", 0.12), ("plain", 0.12), ("rough", 0.12), ("brick", 0.35))[rng.integers(4)]
        self.wall = Material("inner wall", self.wall_colour, rough, float(rng.uniform(0.4, 0.8)), pattern=pattern)
        # Half of the furniture has the same material.
        self.make = self._surface()

    def _surface(self) -> Material:
        rng = self.rng
        if rng.random() < 0.35:
            near = np.array(self.wall_colour) * rng.uniform(0.82, 1.12)
            return Material("lacquered", triple(np.clip(near, 0.02, 0.85)), 0.06, 0.55, 0.04, "plain")
        pattern = ("streaks", "plain")[rng.integers(2)]
        return Material("furniture", pick(rng, _WOODS), 0.35, float(rng.uniform(0.25, 0.6)), 0.04, pattern)

    def surface(self) -> Material:
        """Return the material of a piece of furniture."""
        return self.make if self.rng.random() < 0.5 else self._surface()

    def metal(self) -> Material:
        """Return the material of legs and frames."""
        return (STEEL, DARK_STEEL, TRIM, self.make)[self.rng.integers(4)]


def _part(low: object, high: object, material: Material) -> Part:
    return Part(boxes(low, high), material)  # type: ignore[arg-type]


def table(style: Style, wide: float, deep: float, high: float) -> Thing:
    """Return a table about the z axis on four legs or two side panels, perhaps with a modesty panel."""
    rng, top = style.rng, style.surface()
    a, b = wide / 2, deep / 2
    parts = [_part([[-a, -b, high - 0.03]], [[a, b, high]], top)]
    if rng.random() < 0.7:
        thick = rng.uniform(0.03, 0.06)
        feet = [[x, y, 0.0] for x in (-a + 0.04, a - 0.04 - thick) for y in (-b + 0.04, b - 0.04 - thick)]
        rails = sized([[-a + 0.05, y, high - 0.1] for y in (-b + 0.05, b - 0.08)], [wide - 0.1, 0.03, 0.07])
        return [*parts, Part(sized(feet, [thick, thick, high - 0.03]) + rails, style.metal())]
    cheeks = sized([[x, -b + 0.02, 0.0] for x in (-a + 0.02, a - 0.05)], [0.03, deep - 0.04, high - 0.03])
    return [*parts, Part(cheeks, top), _part([[-a + 0.05, b - 0.1, 0.3]], [[a - 0.05, b - 0.08, high - 0.03]], top)]


def chair(style: Style) -> Thing:
    """Return a chair that looks along -y: on four legs, or an office chair on a star of castors."""
    rng = style.rng
    if rng.random() < 0.5:
        plain = style.surface()
        legs = sized([[x, y, 0.0] for x in (-0.2, 0.17) for y in (-0.2, 0.17)], [0.03, 0.03, 0.43])
        legs += boxes([[-0.2, 0.17, 0.43], [0.17, 0.17, 0.43]], [[-0.17, 0.2, 0.9], [0.2, 0.2, 0.9]])
        slats, tall = ((0.6, 0.76), 0.09) if rng.random() < 0.5 else ((0.55,), 0.34)
        back = sized([[-0.2, 0.16, z] for z in slats], [0.4, 0.03, tall])
        return [Part(legs, style.metal()), Part(boxes([[-0.21, -0.21, 0.43]], [[0.21, 0.2, 0.46]]) + back, plain)]
    cloth = Material("upholstery", pick(rng, CLOTH), 0.3, 0.4)
    turn = 2 * np.pi * np.arange(5) / 5
    tips = stacked(0.3 * np.cos(turn), 0.3 * np.sin(turn), 0.06)
    star = tubes(np.tile([0, 0, 0.12], (5, 1)), tips, 0.02, sides=5)
    wheels = join([wheel(0.03, 0.04, 10).moved(x, y, 0.03) for x, y, _ in tips])
    high = rng.uniform(0.95, 1.2)
    seat = loft([rectangle(0.46, 0.44, 0.45), rectangle(0.5, 0.48, 0.49), rectangle(0.46, 0.46, 0.53)])
    back = boxes([[-0.22, 0.19, 0.62]], [[0.22, 0.25, high]])
    arms = boxes([[-0.28, -0.12, 0.68], [0.23, -0.12, 0.68]], [[-0.23, 0.14, 0.71], [0.28, 0.14, 0.71]])
    posts = boxes(
        [[-0.27, 0.0, 0.48], [0.24, 0.0, 0.48], [-0.03, 0.2, 0.45]],
        [[-0.24, 0.04, 0.68], [0.27, 0.04, 0.68], [0.03, 0.23, 0.66]],
    )
    frame = star + cylinder(0.03, 0.08, 0.46, sides=8) + arms + posts
    return [Part(frame, (TRIM, STEEL)[rng.integers(2)]), Part(wheels, RUBBER), Part(seat + back, cloth)]


def screen(rng: np.random.Generator, z: float) -> Thing:
    """Return a computer screen on its foot at height z, seen from -y; some are on."""
    wide = rng.uniform(0.42, 0.75)
    tall, a = wide * rng.uniform(0.5, 0.65), wide / 2
    low = z + rng.uniform(0.08, 0.18)
    foot = boxes([[-0.12, -0.09, z], [-0.025, 0.0, z]], [[0.12, 0.1, z + 0.015], [0.025, 0.03, low + 0.1]])
    if rng.random() < 0.6:
        shown = Material("screen", triple(rng.uniform(0.1, 0.7, 3)), 0.9, 0.03, 0.0, "slabs", glow=0.6)
    else:
        shown = Material("screen", (0.015, 0.016, 0.018), 0.2, 0.03, 0.4, "slabs")
    pane = _part([[-a + 0.015, -0.034, low + 0.015]], [[a - 0.015, -0.029, low + tall - 0.015]], shown)
    return [Part(foot + boxes([[-a, -0.03, low]], [[a, 0.02, low + tall]]), TRIM), pane]


def carton(rng: np.random.Generator, z: float = 0.0, *, most: float = 0.55) -> Thing:
    """Return a box at height z: cardboard with tape, or of plastic."""
    x, y, high = rng.uniform((0.15, 0.15, 0.1), (most, most, most))
    turn = rng.uniform(-25.0, 25.0)
    paint = pick(rng, _CARDS) if rng.random() < 0.7 else pick(rng, SIGNS)
    body = Material("carton", paint, 0.2, 0.5, pattern="plain")
    parts = [_part([[-x / 2, -y / 2, z]], [[x / 2, y / 2, z + high]], body)]
    if rng.random() < 0.6:
        tape = Material("tape", triple(np.array(paint) * rng.uniform(0.6, 1.5)), 0.1, 0.5, 0.2, "plain")
        parts.append(_part([[-0.03, -y / 2 - 0.001, z + 0.5 * high]], [[0.03, y / 2 + 0.001, z + high + 0.001]], tape))
    return placed(parts, 0.0, 0.0, yaw_deg=turn)


def small_things(rng: np.random.Generator, wide: float, deep: float, z: float, count: int) -> Thing:
    """Return mugs, books, bottles, boxes and papers on a surface `wide` and `deep` metres about the z axis."""
    out: Thing = []
    for _ in range(count):
        x, y = rng.uniform(-0.42, 0.42) * wide, rng.uniform(-0.4, 0.4) * deep
        draw = rng.integers(5)
        paint = Material("thing", pick(rng, (*_SPINES, *WALLS)), 0.2, 0.5, 0.03, "plain")
        if draw == 0:
            out.append(Part(cylinder(0.045, z, z + 0.1, sides=10).moved(x, y), paint))
        elif draw == 1:
            rings = ((0.04, z), (0.04, z + 0.18), (0.015, z + 0.23), (0.015, z + 0.29))
            out.append(Part(loft([circle(radius, at, 10) for radius, at in rings]).moved(x, y), paint))
        elif draw == 2:
            book = boxes([[-0.1, -0.14, z]], [[0.1, 0.14, z + rng.uniform(0.005, 0.09)]])
            out.append(Part(book.moved(x, y, yaw_deg=rng.uniform(0, 360)), paint))
        else:
            out += placed(carton(rng, z, most=0.32), x, y)
    return out


def books(rng: np.random.Generator, low: Float, wide: float, tall: float, deep: float) -> Thing:
    """Return a row of books or folders from the corner `low` (3,) along x, their backs towards -y."""
    rows: list[list[Float]] = [[], [], []]
    x = 0.0
    while x + (thick := rng.uniform(0.02, 0.075)) <= wide:
        if rng.random() > 0.12:
            high, inn = tall * rng.uniform(0.62, 0.95), rng.uniform(0.0, 0.06)
            start = low + [x, inn, 0.0]
            rows[rng.integers(3)].append(np.array([start, [start[0] + 0.94 * thick, low[1] + deep, start[2] + high]]))
        x += thick
    solids = [boxes(*np.moveaxis(np.array(row), 1, 0)) for row in rows if row]
    return [Part(mesh, Material("book", pick(rng, _SPINES), 0.3, 0.5, pattern="plain")) for mesh in solids]


def shelf(style: Style) -> Item:
    """Return open shelves for a wall with books, boxes and gaps; some without a back."""
    rng = style.rng
    wide, deep, high = rng.uniform(0.7, 1.8), rng.uniform(0.26, 0.45), rng.uniform(0.8, 2.25)
    body, thick = style.surface(), 0.025
    levels = np.linspace(0.06, high - thick, max(3, round(high / 0.37)))
    boards = sized([[-wide / 2, -deep, z] for z in levels], [wide, deep, thick])
    sides = sized([[x, -deep, 0.0] for x in (-wide / 2, wide / 2 - thick)], [thick, deep, high])
    parts = [Part(boards + sides, body)]
    if rng.random() < 0.6:
        parts.append(_part([[-wide / 2, -0.012, 0.0]], [[wide / 2, 0.0, high]], body))
    for z, above in pairwise(levels):
        draw, gap = rng.random(), above - z - thick
        if draw < 0.55:
            share = rng.uniform(0.3, 0.97) * (wide - 0.06)
            parts += books(rng, np.array([-wide / 2 + 0.03, -deep + 0.03, z + thick]), share, gap, 0.8 * deep)
        elif draw < 0.85:
            for x in rng.uniform(-0.35, 0.35, 3) * wide:
                parts += placed(carton(rng, z + thick, most=min(0.3, 0.9 * gap)), x, -deep / 2)
    if high < 1.6:
        parts += placed(small_things(rng, wide, 0.6 * deep, high, 3), 0.0, -deep / 2)
    return parts, float(wide), float(deep)


def cupboard(style: Style) -> Item:
    """Return a closed cupboard for a wall: doors or drawers with gaps between them, and handles."""
    rng = style.rng
    wide, deep = rng.uniform(0.6, 1.9), rng.uniform(0.38, 0.65)
    high = rng.uniform(1.6, 2.2) if rng.random() < 0.5 else rng.uniform(0.7, 1.1)
    body = style.surface()
    parts = [_part([[-wide / 2, -deep, 0.07]], [[wide / 2, 0.0, high]], body)]
    parts.append(_part([[-wide / 2 + 0.03, -deep + 0.05, 0.0]], [[wide / 2 - 0.03, -0.02, 0.08]], TRIM))
    columns, rows, gap = max(1, round(wide / 0.5)), 1 if high > 1.3 else int(rng.integers(1, 4)), 0.004
    across = [-wide / 2 + wide * i / columns + gap for i in range(columns)]
    up = [0.09 + (high - 0.1) * j / rows + gap for j in range(rows)]
    low = np.array([[x, -deep - 0.018, z] for x in across for z in up])
    size = np.array([wide / columns - 2 * gap, 0.018, (high - 0.1) / rows - 2 * gap])
    parts.append(Part(sized(low, size), body if rng.random() < 0.6 else style.surface()))
    knob = low + [0.8 * size[0], -0.025, 0.5 * size[2] - 0.06]
    parts.append(Part(sized(knob, [0.015, 0.028, 0.12]), STEEL))
    if high < 1.3:
        parts += placed(small_things(rng, wide, 0.7 * deep, high, int(rng.integers(1, 6))), 0.0, -deep / 2)
    elif rng.random() < 0.5:
        for x in rng.uniform(-0.3, 0.3, 2) * wide:
            parts += placed(carton(rng, high, most=0.4), x, -deep / 2)
    return parts, float(wide), float(deep)


def desk(style: Style) -> Item:
    """Return a desk before a wall with screens, things and a chair."""
    rng = style.rng
    wide, deep, high = rng.uniform(1.2, 1.9), rng.uniform(0.65, 0.85), rng.uniform(0.71, 0.76)
    parts = placed(table(style, wide, deep, high), 0.0, -deep / 2)
    for x in rng.choice([-0.25, 0.0, 0.25], size=rng.integers(1, 3), replace=False) * wide:
        parts += placed(screen(rng, high), x, -0.25, yaw_deg=rng.uniform(-18.0, 18.0))
    parts += placed(small_things(rng, wide, 0.5 * deep, high, int(rng.integers(2, 7))), 0.0, -0.6 * deep)
    at = -deep - rng.uniform(0.05, 0.4)
    parts += placed(chair(style), rng.uniform(-0.2, 0.2) * wide, at, yaw_deg=180.0 + rng.uniform(-50.0, 50.0))
    if rng.random() < 0.5:
        drawers = boxes([[0.2 * wide, -deep + 0.08, 0.04]], [[0.2 * wide + 0.4, -0.05, high - 0.08]])
        parts.append(Part(drawers, style.surface()))
    return parts, float(wide), float(deep + 0.65)


def bench(style: Style) -> Item:
    """Return a bench of a laboratory for a wall: instruments on it, a shelf above."""
    rng = style.rng
    wide, deep, high = rng.uniform(1.5, 3.0), rng.uniform(0.65, 0.8), 0.9
    parts = placed(table(style, wide, deep, high), 0.0, -deep / 2)
    pale = Material("instrument", pick(rng, ((0.6, 0.6, 0.57), (0.25, 0.27, 0.3), (0.1, 0.1, 0.1))), 0.15, 0.5, 0.03)
    for x in np.arange(-0.42, 0.4, 0.26) * wide:
        if rng.random() < 0.75:
            a, b, tall = rng.uniform((0.2, 0.2, 0.12), (0.55, 0.5, 0.5))
            parts.append(_part([[x - a / 2, -0.6, high]], [[x + a / 2, -0.6 + b, high + tall]], pale))
            face = [[x - 0.4 * a, -0.606, high + 0.25 * tall]]
            dark = Material("panel", pick(rng, ((0.02, 0.03, 0.04), (0.05, 0.2, 0.3))), 0.6, 0.1, 0.2, "slabs")
            parts.append(_part(face, np.array(face) + [0.5 * a, 0.01, 0.5 * tall], dark))
    boards = sized([[-wide / 2, -0.32, z] for z in (1.45, 1.85)], [wide, 0.3, 0.03])
    posts = sized([[x, -0.3, 0.9] for x in (-wide / 2, wide / 2 - 0.04)], [0.04, 0.04, 1.0])
    parts.append(Part(boards + posts, STEEL))
    parts += placed(small_things(rng, wide, 0.2, 1.48, 8), 0.0, -0.16)
    if rng.random() < 0.6:
        parts += placed(stool(style), rng.uniform(-0.3, 0.3) * wide, -deep - 0.25)
    return parts, float(wide), float(deep + 0.5)


def stool(style: Style) -> Thing:
    """Return a stool on one leg."""
    stem = cylinder(0.025, 0.02, 0.6, sides=8) + cylinder(0.22, 0.0, 0.025)
    return [Part(cylinder(0.18, 0.58, 0.63), style.surface()), Part(stem, STEEL)]


def sofa(style: Style) -> Item:
    """Return a sofa for a wall, with cushions."""
    rng = style.rng
    wide, deep = rng.uniform(1.5, 2.4), rng.uniform(0.85, 1.0)
    cloth = Material("sofa", pick(rng, (*CLOTH, *WALLS)), 0.3, 0.45)
    low = [[-wide / 2, -deep, 0.1], [-wide / 2, -0.25, 0.1], [-wide / 2, -deep, 0.1], [wide / 2 - 0.18, -deep, 0.1]]
    high = [[wide / 2, 0.0, 0.42], [wide / 2, 0.0, 0.85], [-wide / 2 + 0.18, 0.0, 0.62], [wide / 2, 0.0, 0.62]]
    pillow = Material("cushion", pick(rng, (*CLOTH, *SIGNS)), 0.4, 0.5)
    parts = [_part(low, high, cloth)]
    for x in rng.uniform(-0.35, 0.35, 2) * wide:
        bag = loft([rectangle(0.4, 0.1, 0.42), rectangle(0.45, 0.2, 0.6), rectangle(0.38, 0.08, 0.8)])
        parts.append(Part(bag.moved(x, -0.36, yaw_deg=rng.uniform(-20, 20)), pillow))
    return parts, float(wide), float(deep)


def radiator(style: Style) -> Item:
    """Return a ribbed radiator for a wall."""
    wide = float(style.rng.uniform(0.8, 1.8))
    ribs = sized(stacked(np.arange(-wide / 2, wide / 2, 0.06), -0.12, 0.14), [0.045, 0.09, 0.52])
    rails = sized([[-wide / 2, -0.1, z] for z in (0.18, 0.6)], [wide, 0.06, 0.03])
    pipes = boxes([[-wide / 2 + 0.1, -0.08, 0.0]], [[-wide / 2 + 0.13, -0.05, 0.2]])
    pale = Material("radiator", (0.66, 0.65, 0.62), 0.08, 0.6, 0.05, "plain")
    return [Part(ribs + rails + pipes, pale)], wide, 0.15


def fridge(style: Style) -> Item:
    """Return a refrigerator or another tall appliance for a wall."""
    rng = style.rng
    wide, high = rng.uniform(0.55, 0.75), rng.uniform(1.4, 2.0)
    pale = Material("enamel", pick(rng, ((0.7, 0.7, 0.68), (0.3, 0.31, 0.32))), 0.05, 0.6, 0.08, "plain")
    low = [[-wide / 2, -0.6, 0.03], [-wide / 2, -0.66, 0.05], [-wide / 2, -0.66, 0.62 * high]]
    top = [[wide / 2, 0.0, high], [wide / 2, -0.605, 0.61 * high], [wide / 2, -0.605, high]]
    handle = _part([[-wide / 2 + 0.04, -0.7, 0.66 * high]], [[-wide / 2 + 0.06, -0.66, 0.86 * high]], STEEL)
    return [_part(low, top, pale), handle], float(wide), 0.7


def plant(rng: np.random.Generator) -> Thing:
    """Return a plant in a pot."""
    high, pot = rng.uniform(0.6, 1.9), rng.uniform(0.14, 0.24)
    paint = Material("pot", pick(rng, (*WALLS, *SIGNS)), 0.3, 0.4)
    tub = cylinder(0.8 * pot, 0.0, 1.8 * pot, top_radius=pot)
    count, stems = int(rng.integers(60, 220)), int(rng.integers(3, 8))
    tips = np.column_stack([rng.normal(0, 0.16, (stems, 2)), rng.uniform(0.55, 1.0, stems) * high])
    share = rng.uniform(0.3, 1.05, (count, 1)) ** 0.7
    centre = tips[rng.integers(stems, size=count)] * share + rng.normal(0, 0.09, (count, 3))
    centre[:, 2] = np.maximum(centre[:, 2], 1.8 * pot)
    mesh = leaves(centre, rng.uniform(0.08, 0.26, count), rng)
    foliage = Part(mesh, leaf(rng), kind=Class.FOLIAGE, openness=rng.uniform(0.5, 1.0, 2 * count))
    branches = tubes(np.tile([0.0, 0.0, 1.7 * pot], (stems, 1)), tips, 0.012, sides=5)
    return [Part(tub, paint), Part(branches, BARK, kind=Class.TRUNK), foliage]


def floor_lamp(rng: np.random.Generator) -> Thing:
    """Return a lamp on a stand."""
    high = rng.uniform(1.3, 1.8)
    cloth = Material("lamp shade", (0.75, 0.68, 0.5), 0.1, 0.5, pattern="plain", thin=True, glow=rng.choice([0.0, 1.2]))
    stand = cylinder(0.16, 0.0, 0.03) + cylinder(0.014, 0.02, high, sides=8)
    shade = cylinder(0.2, high - 0.02, high + 0.26, top_radius=0.13)
    return [Part(stand, DARK_STEEL, kind=Class.POLE), Part(shade, cloth)]


def coat_rack(rng: np.random.Generator) -> Thing:
    """Return a stand with coats."""
    stand = cylinder(0.2, 0.0, 0.03) + cylinder(0.02, 0.02, 1.8, sides=8)
    out = [Part(stand, (WOOD, DARK_STEEL)[rng.integers(2)], kind=Class.POLE)]
    for turn in rng.uniform(0, 360, 3):
        coat = loft([rectangle(0.14, 0.42, 0.7), rectangle(0.16, 0.4, 1.2), rectangle(0.06, 0.12, 1.68)])
        cloth = Material("coat", pick(rng, CLOTH), 0.35, 0.4)
        out.append(Part(coat.moved(0.12, 0.0).moved(yaw_deg=turn), cloth))
    return out


def pendant(rng: np.random.Generator, ceiling: float, low: float, glow: float) -> Thing:
    """Return a lamp that hangs on a cord from the ceiling down to height `low`."""
    radius = rng.uniform(0.14, 0.3)
    shade = Material("pendant", pick(rng, (*WALLS, *SIGNS)), 0.1, 0.5, 0.05, "plain")
    bulb = Material("bulb", (0.9, 0.82, 0.62), 0.0, 0.5, pattern="plain", glow=glow)
    hood = cylinder(radius, low, low + 0.22, top_radius=0.35 * radius)
    cord = cylinder(0.008, low + 0.2, ceiling + 0.02, sides=5)
    disc = cylinder(0.8 * radius, low - 0.01, low + 0.001)
    return [Part(hood, shade), Part(cord, TRIM, kind=Class.POLE), Part(disc, bulb)]


def strip_light(length: float, wide: float, ceiling: float, drop: float, glow: float) -> Thing:
    """Return a long lamp along x below the ceiling; with a `drop` it hangs on two wires."""
    z = ceiling - drop
    case = boxes([[-length / 2, -wide / 2, z - 0.06]], [[length / 2, wide / 2, z]])
    pane = boxes([[-length / 2 + 0.02, -wide / 2 + 0.02, z - 0.066]], [[length / 2 - 0.02, wide / 2 - 0.02, z - 0.058]])
    light = Material("light", (0.9, 0.9, 0.86), 0.0, 0.5, pattern="plain", glow=glow)
    white = Material("lamp case", (0.6, 0.6, 0.58), 0.05, 0.5, pattern="plain")
    out = [Part(case, white), Part(pane, light)]
    if drop > 0.05:
        wires = join([cylinder(0.006, z, ceiling + 0.02, sides=4).moved(x) for x in (-0.4 * length, 0.4 * length)])
        out.append(Part(wires, TRIM, kind=Class.POLE))
    return out


def wall_print(style: Style) -> Thing:
    """Return a framed print, poster or whiteboard on a wall, about x = 0, z = 0."""
    rng = style.rng
    wide, high = rng.uniform((0.3, 0.3), (1.8, 1.0))
    colour, contrast = triple(rng.uniform(0.03, 0.75, 3)), rng.uniform(0.1, 0.8)
    paint = Material("poster", colour, contrast, 0.5, 0.02, ("plain", "slabs", "rough", "tiles")[rng.integers(4)])
    rim = _part([[-wide / 2, -0.02, -high / 2]], [[wide / 2, 0.0, high / 2]], style.metal())
    inner = [[-wide / 2 + 0.02, -0.024, -high / 2 + 0.02]]
    return [rim, _part(inner, [[wide / 2 - 0.02, -0.018, high / 2 - 0.02]], paint)]


def window_frame(wide: float, high: float, deep: float, panes: int, material: Material, glass: bool) -> Thing:
    """Return the frame in an opening of a wall from x = 0 to `wide`, z = 0 to `high`: mullions, a transom, a sill.

    With `glass` there is a pane that mirrors; without, both sensors look through, as they mostly do.
    """
    bar, y = 0.05, 0.4 * deep
    uprights = sized([[x, y, 0.0] for x in np.linspace(0.0, wide - bar, panes + 1)], [bar, 0.05, high])
    across = sized([[0.0, y, z] for z in (0.0, high - bar)], [wide, 0.05, bar])
    mesh = uprights + across + boxes([[-0.05, -0.12, -0.03]], [[wide + 0.05, y, 0.0]])
    out = [Part(mesh, material, kind=Class.BUILDING)]
    if glass:
        out.append(Part(boxes([[0.0, y + 0.02, 0.0]], [[wide, y + 0.03, high]]), GLASS, kind=Class.BUILDING))
    return out


def blind(rng: np.random.Generator, wide: float, high: float) -> Thing:
    """Return a blind or a curtain before an opening of a wall, which leaves some of it free."""
    cloth = Material("blind", pick(rng, WALLS), 0.3, 0.5, pattern=("tiles", "streaks")[rng.integers(2)], thin=True)
    if rng.random() < 0.5:  # slats, let down part of the way
        slats = np.arange(high - high * rng.uniform(0.2, 0.7), high, 0.05)
        return [Part(sized(stacked(0.0 * slats, -0.05, slats), [wide, 0.03, 0.035]), cloth)]
    bottom, depth = -0.85 if high < 1.9 else 0.02, np.tile([-0.1, -0.06], 3)
    folds = [stacked(start + np.arange(6) * 0.06, depth, bottom) for start in (-0.15, wide - 0.2)]
    return [Part(sized(low, [0.055, 0.03, high + 0.12 - bottom]), cloth) for low in folds]


def partition(style: Style) -> Item:
    """Return a screen between desks, of cloth or half of glass."""
    rng = style.rng
    wide, high = rng.uniform(1.2, 2.2), rng.uniform(1.1, 1.7)
    cloth = Material("partition", pick(rng, (*CLOTH, *WALLS)), 0.25, 0.4)
    ends = (-0.4 * wide, 0.4 * wide)
    feet = boxes([[x, -0.25, 0.0] for x in ends], [[x + 0.05, 0.25, 0.04] for x in ends])
    posts = boxes([[x, -0.02, 0.0] for x in ends], [[x + 0.03, 0.02, 0.3] for x in ends])
    body = _part([[-wide / 2, -0.025, 0.12]], [[wide / 2, 0.025, high]], cloth)
    return [Part(feet + posts, STEEL), body], float(wide), 0.5


def dining(style: Style) -> Item:
    """Return a table with chairs around it and things on it."""
    rng = style.rng
    wide, deep, high = rng.uniform(0.8, 2.2), rng.uniform(0.8, 1.1), rng.uniform(0.7, 0.78)
    parts = table(style, wide, deep, high)
    parts += small_things(rng, wide, deep, high, int(rng.integers(2, 9)))
    for x in np.arange(-wide / 2 + 0.35, wide / 2 - 0.2, 0.65):
        for side in (-1, 1):
            if rng.random() < 0.75:
                turn = (0.0 if side > 0 else 180.0) + rng.uniform(-20, 20)
                parts += placed(chair(style), x, side * (deep / 2 + rng.uniform(0.05, 0.35)), yaw_deg=turn)
    return parts, float(wide + 0.3), float(deep + 1.1)


def island(style: Style) -> Item:
    """Return two or four desks back to back with screens and chairs, some with a screen of cloth between them."""
    rng = style.rng
    wide, deep, high = rng.uniform(1.3, 1.7), 0.75, rng.uniform(0.71, 0.76)
    parts: Thing = []
    for side in (0.0, 180.0):
        one = placed(table(style, wide, deep, high), 0.0, -deep / 2)
        one += placed(screen(rng, high), rng.uniform(-0.3, 0.3), -0.28, yaw_deg=rng.uniform(-15, 15))
        one += placed(small_things(rng, wide, 0.4, high, int(rng.integers(1, 6))), 0.0, -0.5)
        seat, x, y = chair(style), rng.uniform(-0.3, 0.3), -deep - rng.uniform(0.05, 0.3)
        one += placed(seat, x, y, yaw_deg=180.0 + rng.uniform(-60, 60))
        parts += placed(one, 0.0, 0.0, yaw_deg=side)
    if rng.random() < 0.5:
        cloth = Material("divider", pick(rng, (*CLOTH, *WALLS)), 0.2, 0.4)
        parts.append(_part([[-wide / 2, -0.015, high]], [[wide / 2, 0.015, high + 0.4]], cloth))
    return parts, float(wide), float(2 * deep + 1.2)


def trolley(style: Style) -> Item:
    """Return a trolley with boxes on its shelves."""
    rng = style.rng
    wide, deep, high = rng.uniform(0.6, 0.95), 0.5, rng.uniform(0.8, 1.1)
    posts = [[x, y, 0.08] for x in (-wide / 2, wide / 2 - 0.03) for y in (-deep / 2, deep / 2 - 0.03)]
    levels = (0.15, 0.5, high - 0.1)
    boards = sized([[-wide / 2, -deep / 2, z] for z in levels], [wide, deep, 0.025])
    rolls = join([wheel(0.05, 0.03, 10).moved(x + 0.015, y + 0.015, 0.05) for x, y, _ in posts])
    parts = [Part(sized(posts, [0.03, 0.03, high]) + boards, style.metal()), Part(rolls, RUBBER)]
    for z in levels:
        parts += small_things(rng, wide, deep, z + 0.025, 2)
    return parts, float(wide + 0.1), deep + 0.1


def pile(style: Style) -> Item:
    """Return boxes on top of each other."""
    rng, parts, z = style.rng, [], 0.0
    for _ in range(rng.integers(1, 4)):
        box = carton(rng, z)
        parts += placed(box, rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05))
        z = float(box[0].mesh.vertices[:, 2].max())
    return parts, 0.75, 0.75


Items = tuple[tuple[Callable[[Style], Item], float], ...]
WALL_ITEMS: dict[str, Items] = {
    "office": ((shelf, 0.22), (cupboard, 0.26), (desk, 0.36), (radiator, 0.06), (pile, 0.1)),
    "living": ((shelf, 0.24), (cupboard, 0.26), (sofa, 0.2), (desk, 0.1), (radiator, 0.12), (fridge, 0.08)),
    "laboratory": ((shelf, 0.16), (cupboard, 0.24), (bench, 0.38), (fridge, 0.12), (pile, 0.1)),
}
"""Things along the walls of each kind of room, and their frequencies."""
FLOOR_ITEMS: dict[str, Items] = {
    "office": ((island, 0.4), (partition, 0.2), (dining, 0.15), (pile, 0.15), (trolley, 0.1)),
    "living": ((dining, 0.6), (pile, 0.2), (sofa, 0.2)),
    "laboratory": ((island, 0.15), (dining, 0.2), (trolley, 0.35), (pile, 0.3)),
}
"""Things in the middle of each kind of room, and their frequencies."""
