"""The ground: roads with lane marks, kerbs, pavements, verges, banks and open land, drawn along x."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from p2o.arrays import Float
from p2o.simulate.classes import Class
from p2o.simulate.mesh import boxes, swept
from p2o.simulate.palette import GRASS, PAINT
from p2o.simulate.scene import Material, Part

_STEP_M = 4.0


def stations(start: float, stop: float, step: float = _STEP_M) -> Float:
    """Return places along x, `step` metres apart or a little less, from start to stop."""
    return np.linspace(start, stop, max(2, int(np.ceil((stop - start) / step)) + 1))


def strips(points: Sequence[tuple[float, float]], surfaces: Sequence[tuple[Material, Class]], x: Float) -> list[Part]:
    """Return one sheet a surface between neighbouring points (y, z), which run from left to right."""
    return [
        Part(swept(np.array([a, b]), x), material, kind=kind)
        for a, b, (material, kind) in zip(points[:-1], points[1:], surfaces, strict=True)
    ]


def land(
    rng: np.random.Generator,
    x: Float,
    y: float,
    z: float,
    outwards: int,
    *,
    rise: float = 0.0,
    over: float = 10.0,
    width: float = 110.0,
    rough: float = 0.15,
    material: Material = GRASS,
) -> Part:
    """Return open land from the line (y, z) `outwards`, +1 left, -1 right: a bank of `over` metres, then waves."""
    away = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0]) * over
    away = np.concatenate([away, over + np.geomspace(3.0, width - over, 9)])
    bank = rise * (0.5 - 0.5 * np.cos(np.pi * np.clip(away / over, 0, 1)))
    bumps = rng.normal(size=(len(x), len(away))) * rough * np.clip(away / 2.0, 0, 1)
    waves = 0.02 * np.clip(away - over, 0, None) * np.sin(x[:, None] / 31.0 + rng.uniform(0, 6))
    height = np.maximum(z + bank + bumps + waves, min(z, 0.02))
    height[:, 0] = z
    line = np.stack([np.broadcast_to(y + outwards * away, height.shape), height], axis=-1)
    if outwards > 0:
        line = line[:, ::-1]
    return Part(swept(line, x), material, kind=Class.TERRAIN)


def dashes(
    start: float, stop: float, y: float, *, length: float = 3.0, period: float = 9.0, width: float = 0.13
) -> Part:
    """Return a dashed line at y; `period` equal to `length` makes it solid."""
    x = np.arange(start, stop, period)
    low = np.column_stack([x, np.full(len(x), y - width / 2), np.full(len(x), -0.02)])
    return Part(boxes(low, low + [length, width, 0.024]), PAINT, kind=Class.ROAD)


def stop_line(x: float, right: float, left: float) -> Part:
    """Return a line across the lanes between two y, and a crossing of dashes behind it."""
    y = np.arange(right + 0.2, left - 0.4, 1.0)
    low = np.column_stack([np.full(len(y), x + 1.5), y, np.full(len(y), -0.02)])
    all_low = np.vstack([[x, right, -0.02], low])
    size = np.vstack([[0.4, left - right, 0.024], np.tile([3.0, 0.5, 0.024], (len(y), 1))])
    return Part(boxes(all_low, all_low + size), PAINT, kind=Class.ROAD)
