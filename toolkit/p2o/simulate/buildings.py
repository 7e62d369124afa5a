"""Houses: walls with windows, doors, balconies and awnings under pitched or flat roofs."""

from __future__ import annotations

import numpy as np

from p2o.simulate.classes import Class
from p2o.simulate.mesh import boxes, loft, quads, rectangle
from p2o.simulate.palette import DARK_STEEL, FRAME, GLASS, SIGNS, STEEL, STONE, WALLS, WOOD, pick
from p2o.simulate.scene import Material, Part


def town_house(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a house of a terrace from x = 0 to `length` with its front at y = 0, seen from -y."""
    parts = _house(rng, length, depth=10.0, height=rng.uniform(7.5, 15.0))
    if rng.random() < 0.5:  # a shop's awning
        cloth = Material("awning", pick(rng, SIGNS), 0.3, 0.5, pattern="plain", thin=True)
        wide, x = rng.uniform(2.5, 4.0), length * rng.uniform(0.35, 0.65)
        a, b = x - wide / 2, x + wide / 2
        sheet = quads(np.array([[[a, -1.3, 2.35], [b, -1.3, 2.35], [b, 0.0, 2.95], [a, 0.0, 2.95]]]))
        parts.append(Part(sheet, cloth, kind=Class.BUILDING))
        board = boxes([[x - wide / 2, -0.2, 2.95]], [[x + wide / 2, 0.0, 3.5]])
        parts.append(
            Part(board, Material("shop sign", pick(rng, SIGNS), 0.2, 0.6, pattern="plain"), kind=Class.BUILDING)
        )
    return parts


def villa(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a detached house of one or two floors from x = 0 to `length`, its front at y = 0, with a chimney."""
    depth, height = rng.uniform(7.0, 10.0), rng.uniform(3.2, 6.2)
    parts = _house(rng, length, depth=depth, height=height)
    x = rng.uniform(0.25, 0.7) * length
    chimney = boxes([[x, depth * 0.45, height]], [[x + 0.6, depth * 0.45 + 0.6, height + 4.0]])
    brick = Material("chimney", (0.25, 0.1, 0.07), 0.5, 0.4, pattern="brick")
    return [*parts, Part(chimney, brick, kind=Class.BUILDING)]


def block(rng: np.random.Generator, length: float) -> list[Part]:
    """Return a block of flats or a hall with a flat roof, far from the road."""
    return _house(rng, length, depth=14.0, height=rng.uniform(6.0, 24.0), flat=True)


def _house(rng: np.random.Generator, length: float, *, depth: float, height: float, flat: bool = False) -> list[Part]:
    pattern = ("plain", "brick", "plain", "rough")[rng.integers(4)]
    wall = Material(
        "wall", pick(rng, WALLS), 0.3 if pattern != "brick" else 0.6, rng.uniform(0.3, 0.6), pattern=pattern
    )
    tiles = Material("roof", pick(rng, ((0.22, 0.09, 0.06), (0.1, 0.09, 0.09))), 0.6, 0.3, pattern="tiles")
    middle = length / 2
    parts = [Part(boxes([[0, 0, -0.5]], [[length, depth, height]]), wall, kind=Class.BUILDING)]
    if flat:
        rim = boxes([[-0.15, -0.15, height - 0.1]], [[length + 0.15, depth + 0.15, height + 0.35]])
        parts.append(Part(rim, STONE, kind=Class.BUILDING))
    else:
        eaves = [
            rectangle(length + 0.5, depth + 0.9, height - 0.05, x=middle, y=depth / 2),
            rectangle(length + 0.5, depth + 0.9, height + 0.12, x=middle, y=depth / 2),
            rectangle(length + 0.3, 0.2, height + 0.42 * depth, x=middle, y=depth / 2),
        ]
        parts.append(Part(loft(eaves), tiles, kind=Class.BUILDING))
        gutter = boxes([[-0.2, -0.58, height - 0.02]], [[length + 0.2, -0.45, height + 0.1]])
        parts.append(Part(gutter, STEEL, kind=Class.BUILDING))
    base = boxes([[-0.01, -0.05, -0.5]], [[length + 0.01, 0.3, 0.6]])
    pipe = boxes([[0.15, -0.12, 0.0]], [[0.25, -0.02, height]])
    parts += [Part(base, STONE, kind=Class.BUILDING), Part(pipe, DARK_STEEL, kind=Class.BUILDING)]
    return parts + _openings(rng, length, height)


def _openings(rng: np.random.Generator, length: float, height: float) -> list[Part]:
    """Return windows, a door and balconies on a wall whose outer face is y = 0."""
    columns, floors = max(1, int(length / rng.uniform(2.2, 3.2))), max(1, int((height - 0.4) / 2.9))
    wide, tall = rng.uniform(0.9, 1.5), rng.uniform(1.2, 1.8)
    column, floor = (g.ravel() for g in np.meshgrid(np.arange(columns), np.arange(floors)))
    x, z = (column + 0.5) * length / columns, 0.95 + 2.9 * floor
    door = (floor == 0) & (column == rng.integers(columns))
    if not door.any():
        door[0] = True
    x_door = float(x[door][0])
    x, z, floor = x[~door], z[~door], floor[~door]

    def around(left: float, right: float, low: float, high: float, out: float, inn: float = 0.03) -> Part | None:
        """Return boxes about all windows, offsets in metres from their edges."""
        if not len(x):
            return None
        a = np.column_stack([x - wide / 2 - left, np.full(len(x), -out), z - low])
        b = np.column_stack([x + wide / 2 + right, np.full(len(x), inn), z + tall + high])
        return Part(boxes(a, b), FRAME, kind=Class.BUILDING)

    panes = []
    for half in (-1, 1):
        a = np.column_stack([x + (half - 1) * wide / 4 + 0.03, np.full(len(x), -0.055), z])
        b = np.column_stack([x + (half + 1) * wide / 4 - 0.03, np.full(len(x), 0.03), z + tall])
        if len(x):
            panes.append(Part(boxes(a, b), GLASS, kind=Class.BUILDING))
    sill = np.column_stack([x - wide / 2 - 0.15, np.full(len(x), -0.16), z - 0.14])
    parts = [p for p in (around(0.09, 0.09, 0.09, 0.09, 0.05), *panes) if p is not None]
    if len(x):
        parts.append(Part(boxes(sill, sill + [wide + 0.3, 0.2, 0.07]), STONE, kind=Class.BUILDING))
        shut = np.flatnonzero(rng.random(len(x)) < 0.2)
        if len(shut):  # lowered blinds
            a = np.column_stack(
                [x[shut] - wide / 2, np.full(len(shut), -0.062), z[shut] + tall * rng.uniform(0.1, 0.7)]
            )
            b = np.column_stack([x[shut] + wide / 2, np.full(len(shut), 0.0), z[shut] + tall])
            blind = Material("blind", pick(rng, WALLS), 0.3, 0.5, pattern="tiles")
            parts.append(Part(boxes(a, b), blind, kind=Class.BUILDING))
    high = np.flatnonzero((floor > 0) & (rng.random(len(x)) < 0.12))
    if len(high):
        a = np.column_stack([x[high] - wide / 2 - 0.5, np.full(len(high), -1.1), z[high] - 0.9])
        parts.append(Part(boxes(a, a + [wide + 1.0, 1.1, 0.16]), STONE, kind=Class.BUILDING))
        bars = (a[:, None] + np.linspace([0.0, 0, 0.16], [wide + 0.98, 0, 0.16], 12)).reshape(-1, 3)
        parts.append(Part(boxes(bars, bars + [0.02, 0.02, 0.85]), DARK_STEEL, kind=Class.BUILDING))
        rail = a + [0.0, -0.01, 0.98]
        parts.append(Part(boxes(rail, rail + [wide + 1.0, 0.05, 0.05]), DARK_STEEL, kind=Class.BUILDING))
    leaf = boxes([[x_door - 0.5, -0.07, 0.0]], [[x_door + 0.5, 0.05, 2.15]])
    case = boxes(
        [[x_door - 0.62, -0.05, 0.0], [x_door - 0.9, -0.6, -0.3]],
        [[x_door + 0.62, 0.05, 2.28], [x_door + 0.9, 0.0, 0.16]],
    )
    return [*parts, Part(case, STONE, kind=Class.BUILDING), Part(leaf, WOOD, kind=Class.BUILDING)]
