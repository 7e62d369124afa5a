"""Houses: walls with windows, doors, balconies and awnings under pitched or flat roofs."""

from __future__ import annotations

import numpy as np

from p2o_sim.world.mesh import boxes, loft, quads, rectangle, sized, stacked
from p2o_sim.world.palette import DARK_STEEL, FRAME, GLASS, SIGNS, STEEL, STONE, WALLS, WOOD, pick
from p2o_sim.world.scene import Class, Material, Part, built


def town_house(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a house of a terrace from x = 0 to `length` with its front at y = 0, seen from -y."""
    parts = _house(rng, length, depth=10.0, height=rng.uniform(7.5, 15.0))
    if rng.random() < 0.5:  # a shop's awning
        cloth = Material("awning", pick(rng, SIGNS), 0.3, 0.5, pattern="plain", thin=True)
        wide, x = rng.uniform(2.5, 4.0), length * rng.uniform(0.35, 0.65)
        a, b = x - wide / 2, x + wide / 2
        sheet = quads(np.array([[[a, -1.3, 2.35], [b, -1.3, 2.35], [b, 0.0, 2.95], [a, 0.0, 2.95]]]))
        board = Material("shop sign", pick(rng, SIGNS), 0.2, 0.6, pattern="plain")
        parts += built(Class.BUILDING, (sheet, cloth), (boxes([[a, -0.2, 2.95]], [[b, 0.0, 3.5]]), board))
    return parts


def villa(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a detached house of one or two floors from x = 0 to `length`, its front at y = 0, with a chimney."""
    depth, height = rng.uniform(7.0, 10.0), rng.uniform(3.2, 6.2)
    parts = _house(rng, length, depth=depth, height=height)
    x = rng.uniform(0.25, 0.7) * length
    chimney = boxes([[x, depth * 0.45, height]], [[x + 0.6, depth * 0.45 + 0.6, height + 4.0]])
    brick = Material("chimney", (0.25, 0.1, 0.07), 0.5, 0.4, pattern="brick")
    return parts + built(Class.BUILDING, (chimney, brick))


def block(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a block of flats or a hall with a flat roof, far from the road."""
    return _house(rng, length, depth=14.0, height=rng.uniform(6.0, 24.0), flat=True)


def _house(rng: np.random.Generator, length: float, *, depth: float, height: float, flat: bool = False) -> list[Part]:
    pattern, contrast = (("plain", 0.3), ("brick", 0.6), ("plain", 0.3), ("rough", 0.3))[rng.integers(4)]
    wall = Material("wall", pick(rng, WALLS), contrast, rng.uniform(0.3, 0.6), pattern=pattern)
    tiles = Material("roof", pick(rng, ((0.22, 0.09, 0.06), (0.1, 0.09, 0.09))), 0.6, 0.3, pattern="tiles")
    solids = [(boxes([[0, 0, -0.5]], [[length, depth, height]]), wall)]
    if flat:
        solids.append((boxes([[-0.15, -0.15, height - 0.1]], [[length + 0.15, depth + 0.15, height + 0.35]]), STONE))
    else:
        sizes = ((0.5, depth + 0.9, -0.05), (0.5, depth + 0.9, 0.12), (0.3, 0.2, 0.42 * depth))
        eaves = [rectangle(length + a, wide, height + z, x=length / 2, y=depth / 2) for a, wide, z in sizes]
        solids.append((loft(eaves), tiles))
        solids.append((boxes([[-0.2, -0.58, height - 0.02]], [[length + 0.2, -0.45, height + 0.1]]), STEEL))
    solids.append((boxes([[-0.01, -0.05, -0.5]], [[length + 0.01, 0.3, 0.6]]), STONE))
    solids.append((boxes([[0.15, -0.12, 0.0]], [[0.25, -0.02, height]]), DARK_STEEL))
    return built(Class.BUILDING, *solids) + _openings(rng, length, height)


def _openings(rng: np.random.Generator, length: float, height: float) -> list[Part]:
    """Return windows, a door and balconies on a wall whose outer face is y = 0."""
    columns, floors = max(1, int(length / rng.uniform(2.2, 3.2))), max(1, int((height - 0.4) / 2.9))
    wide, tall = rng.uniform(0.9, 1.5), rng.uniform(1.2, 1.8)
    column, floor = (g.ravel() for g in np.meshgrid(np.arange(columns), np.arange(floors)))
    x, z = (column + 0.5) * length / columns, 0.95 + 2.9 * floor
    door = (floor == 0) & (column == rng.integers(columns))
    door[0] |= not door.any()
    x_door = float(x[door][0])
    x, z, floor = x[~door], z[~door], floor[~door]
    solids = []
    if len(x):
        a = stacked(x - wide / 2 - 0.09, -0.05, z - 0.09)
        solids.append((boxes(a, stacked(x + wide / 2 + 0.09, 0.03, z + tall + 0.09)), FRAME))
        for half in (-1, 1):
            a = stacked(x + (half - 1) * wide / 4 + 0.03, -0.055, z)
            solids.append((boxes(a, stacked(x + (half + 1) * wide / 4 - 0.03, 0.03, z + tall)), GLASS))
        sill = stacked(x - wide / 2 - 0.15, -0.16, z - 0.14)
        solids.append((sized(sill, [wide + 0.3, 0.2, 0.07]), STONE))
        shut = np.flatnonzero(rng.random(len(x)) < 0.2)
        if len(shut):  # lowered blinds
            a = stacked(x[shut] - wide / 2, -0.062, z[shut] + tall * rng.uniform(0.1, 0.7))
            blind = Material("blind", pick(rng, WALLS), 0.3, 0.5, pattern="tiles")
            solids.append((boxes(a, stacked(x[shut] + wide / 2, 0.0, z[shut] + tall)), blind))
    high = np.flatnonzero((floor > 0) & (rng.random(len(x)) < 0.12))
    if len(high):
        a = stacked(x[high] - wide / 2 - 0.5, -1.1, z[high] - 0.9)
        bars = (a[:, None] + np.linspace([0.0, 0, 0.16], [wide + 0.98, 0, 0.16], 12)).reshape(-1, 3)
        solids.append((sized(a, [wide + 1.0, 1.1, 0.16]), STONE))
        solids.append((sized(bars, [0.02, 0.02, 0.85]), DARK_STEEL))
        solids.append((sized(a + [0.0, -0.01, 0.98], [wide + 1.0, 0.05, 0.05]), DARK_STEEL))
    case = boxes(
        [[x_door - 0.62, -0.05, 0.0], [x_door - 0.9, -0.6, -0.3]],
        [[x_door + 0.62, 0.05, 2.28], [x_door + 0.9, 0.0, 0.16]],
    )
    leaf = boxes([[x_door - 0.5, -0.07, 0.0]], [[x_door + 0.5, 0.05, 2.15]])
    return built(Class.BUILDING, *solids, (case, STONE), (leaf, WOOD))
