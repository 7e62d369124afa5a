"""Textures: tables of periodic random patterns, averaged over the size of a pixel."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from p2o import Float, Int

from p2o_sim.sensing.photo import Single

PATTERNS = ("rough", "plain", "asphalt", "brick", "slabs", "grass", "streaks", "tiles")
"""Names of the patterns of materials."""
PERIOD_M = 4.0
"""Period of a pattern; a coarse pattern with another period conceals the repetition."""
_COARSE_PERIOD_M = 38.7
_SIZE = 512
_LEVELS = 10


def texture(pattern: Int, uv_m: Single, footprint_m: Single) -> Single:
    """Return the texture (N,), about -1 to 1 with mean 0, at positions (N, 2) in metres on a surface.

    `pattern` (N,) are indices of PATTERNS; `footprint_m` (N,) is the size of a pixel on the surface, over which the
    texture is averaged.
    """
    fine = _sample(pattern, uv_m * (_SIZE / PERIOD_M), footprint_m * (_SIZE / PERIOD_M))
    broad = np.zeros(len(uv_m), np.int64)
    coarse = _sample(broad, uv_m[:, ::-1] * (_SIZE / _COARSE_PERIOD_M), footprint_m * (_SIZE / _COARSE_PERIOD_M))
    return np.asarray(fine + np.float32(0.45) * coarse, np.float32)


def clouds(layer: Single) -> Single:
    """Return the density of clouds, about -1 to 1, at positions (N, 2) in a layer at height 1."""
    place = layer * (_SIZE / 23.0)
    flat = np.zeros(len(layer), np.int64)
    return np.asarray(1.6 * _sample(flat, place, np.full(len(layer), 1.0, np.float32)), np.float32)


def _sample(pattern: Int, place: Single, width: Single) -> Single:
    """Return table values at positions (N, 2) in cells, from the level whose cell size is `width` (N,)."""
    table, start = _tables()
    level = np.clip(np.rint(np.log2(np.maximum(width, 1e-6))), 0, _LEVELS - 1).astype(np.int32)
    scale = np.ldexp(np.float32(1.0), -level)
    size = (_SIZE >> level).astype(np.int32)
    x, y = place[:, 0] * scale - np.float32(0.5), place[:, 1] * scale - np.float32(0.5)
    x0, y0 = np.floor(x), np.floor(y)
    fx, fy = x - x0, y - y0
    mask = size - 1
    left, low = x0.astype(np.int32) & mask, y0.astype(np.int32) & mask
    right, high = (left + 1) & mask, (low + 1) & mask
    first = start[pattern, level]
    low_row, high_row = first + low * size, first + high * size
    a, b = table.take(low_row + left), table.take(low_row + right)
    c, d = table.take(high_row + left), table.take(high_row + right)
    a += fx * (b - a)
    c += fx * (d - c)
    return np.asarray(a + fy * (c - a))


@cache
def _tables() -> tuple[Single, NDArray[np.int32]]:
    """Return all levels of all patterns in one array, and the start of each (patterns, levels)."""
    rng = np.random.default_rng(20260101)
    pieces, start, place = [], np.zeros((len(PATTERNS), _LEVELS), np.int32), 0
    for row, name in enumerate(PATTERNS):
        level_table = _pattern(name, rng)
        for level in range(_LEVELS):
            pieces.append(level_table.ravel())
            start[row, level] = place
            place += level_table.size
            if len(level_table) > 1:
                level_table = level_table.reshape(len(level_table) // 2, 2, -1, 2).mean(axis=(1, 3))
    return np.concatenate(pieces).astype(np.float32), start


def _spectrum(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> Float:
    """Return periodic noise of unit variance with amplitude frequency^-slope, stretched along v."""
    fx, fy = np.meshgrid(np.fft.fftfreq(_SIZE) * _SIZE, np.fft.fftfreq(_SIZE) * _SIZE)
    frequency = np.hypot(fx, fy * stretch)
    frequency[0, 0] = np.inf
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((_SIZE, _SIZE))) * np.maximum(frequency, 1.0) ** -slope).real
    return np.asarray(noise / noise.std())


def _pattern(name: str, rng: np.random.Generator) -> Float:
    """Return one pattern (512, 512), rows along v, with mean 0."""
    v, u = np.mgrid[:_SIZE, :_SIZE]
    if name == "rough":
        table = 0.35 * _spectrum(rng, 1.1)
    elif name == "plain":
        table = 0.1 * _spectrum(rng, 1.6)
    elif name == "asphalt":
        table = 0.16 * rng.standard_normal((_SIZE, _SIZE)) + 0.1 * _spectrum(rng, 0.8)
        table -= 0.5 * (np.abs(_spectrum(rng, 1.6)) < 0.012)  # cracks
    elif name == "brick":
        # 52 courses of 7.7 cm, bricks of 25 cm, every other course shifted by half.
        course = v * 52 // _SIZE
        across = (u / _SIZE * 16 + 0.5 * (course % 2)) % 16
        own = rng.standard_normal((52, 16))[course, across.astype(int)]
        mortar = ((v * 52 / _SIZE) % 1 < 0.14) | (across % 1 < 0.05)
        table = np.where(mortar, 0.45, 0.22 * own) + 0.08 * rng.standard_normal((_SIZE, _SIZE))
    elif name == "slabs":
        across, down = u / _SIZE * 8, v / _SIZE * 8
        own = rng.standard_normal((8, 8))[down.astype(int), across.astype(int)]
        joint = (across % 1 < 0.03) | (down % 1 < 0.03)
        table = np.where(joint, -0.8, 0.12 * own) + 0.1 * _spectrum(rng, 0.7)
    elif name == "grass":
        table = 0.4 * _spectrum(rng, 0.45) + 0.25 * _spectrum(rng, 1.2)
    elif name == "streaks":
        table = 0.4 * _spectrum(rng, 0.9, stretch=7.0)
    else:  # tiles: rows of roof tiles
        rows = 0.5 * ((v * 16 / _SIZE) % 1 - 0.5) + 0.25 * np.cos(2 * np.pi * u * 20 / _SIZE)
        table = rows + 0.12 * _spectrum(rng, 0.6)
    return np.asarray(table - table.mean())
