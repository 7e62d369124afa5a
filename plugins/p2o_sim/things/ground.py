"""The ground: roads with lane marks, kerbs, pavements, verges, banks and open land, drawn along x."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from p2o import Float

from p2o_sim.world.mesh import sized, stacked, swept
from p2o_sim.world.palette import ASPHALT, GRASS, KERB, PAINT, PAVING
from p2o_sim.world.scene import Class, Material, Part

_STEP_M, _LAND_M = 4.0, 110.0
"""Distance between stations along x, and width of open land."""


def stations(start: float, stop: float, step: float = _STEP_M) -> Float:
    """Return positions along x from start to stop, at most `step` metres apart."""
    return np.linspace(start, stop, max(2, int(np.ceil((stop - start) / step)) + 1))


def strips(points: Sequence[tuple[float, float]], surfaces: Sequence[tuple[Material, Class]], x: Float) -> list[Part]:
    """Return one sheet a surface between neighbouring points (y, z), which run from left to right."""
    return [
        Part(swept(np.array([a, b]), x), material, kind=kind)
        for a, b, (material, kind) in zip(points[:-1], points[1:], surfaces, strict=True)
    ]


def kerbed_street(
    x: Float, outer: tuple[float, float], right: float, left: float, kerb_m: float, high: tuple[float, float]
) -> list[Part]:
    """Return a road between kerbs at y = `right` and `left`, and pavements out to the `outer` edges (right, left).

    Kerbs are `kerb_m` wide; `high` (2,) are the heights of their edge and of the pavement.
    """
    kerb, pavement = high
    points = [(outer[1], pavement), (left + kerb_m, pavement), (left, kerb), (left, 0.0), (right, 0.0), (right, kerb)]
    sides = [(PAVING, Class.PAVEMENT), (KERB, Class.PAVEMENT), (KERB, Class.PAVEMENT)]
    points += [(right - kerb_m, pavement), (outer[0], pavement)]
    return strips(points, [*sides, (ASPHALT, Class.ROAD), *sides[::-1]], x)


def land(
    rng: np.random.Generator,
    x: Float,
    y: float,
    z: float,
    outwards: int,
    *,
    rise: float = 0.0,
    over: float = 10.0,
    rough: float = 0.15,
    material: Material = GRASS,
) -> Part:
    """Return open land from the line (y, z) `outwards`, +1 left, -1 right: a bank of `over` metres, then waves."""
    away = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0]) * over
    away = np.concatenate([away, over + np.geomspace(3.0, _LAND_M - over, 9)])
    bank = rise * (0.5 - 0.5 * np.cos(np.pi * np.clip(away / over, 0, 1)))
    bumps = rng.normal(size=(len(x), len(away))) * rough * np.clip(away / 2.0, 0, 1)
    waves = 0.02 * np.clip(away - over, 0, None) * np.sin(x[:, None] / 31.0 + rng.uniform(0, 6))
    height = np.maximum(z + bank + bumps + waves, min(z, 0.02))
    height[:, 0] = z
    line = np.stack([np.broadcast_to(y + outwards * away, height.shape), height], axis=-1)
    if outwards > 0:
        line = line[:, ::-1]
    return Part(swept(line, x), material, kind=Class.TERRAIN)


def bank_height(rise: float, over: float, away: float) -> float:
    """Return the height of a bank at a distance from its foot, as `land` draws it."""
    return float(rise * (0.5 - 0.5 * np.cos(np.pi * min(away / over, 1.0))))


def dashes(
    start: float, stop: float, y: float, *, length: float = 3.0, period: float = 9.0, width: float = 0.13
) -> Part:
    """Return a dashed line at y; `period` equal to `length` makes it solid."""
    low = stacked(np.arange(start, stop, period), y - width / 2, -0.02)
    return Part(sized(low, [length, width, 0.024]), PAINT, kind=Class.ROAD)


def stop_line(x: float, right: float, left: float) -> Part:
    """Return a line across the lanes between two y, and a crossing of dashes behind it."""
    y = np.arange(right + 0.2, left - 0.4, 1.0)
    low = stacked(x + 1.5, y, -0.02)
    all_low = np.vstack([[x, right, -0.02], low])
    size = np.vstack([[0.4, left - right, 0.024], np.tile([3.0, 0.5, 0.024], (len(y), 1))])
    return Part(sized(all_low, size), PAINT, kind=Class.ROAD)
