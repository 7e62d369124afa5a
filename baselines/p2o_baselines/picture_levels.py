"""How a point that lies between pixels is counted in the levels of a picture: hard, linear, or by B-splines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from p2o.arrays import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Tap:
    """A share of every point: the level (...) that it goes to, its weight (...), and its derivatives (..., 2) by u, v.

    Shares of one point add up to one, their derivatives to zero.
    """

    level: Int
    weight: Float
    slope: Float | None = None


class Levels(Protocol):
    """A picture of which every pixel has a level from 0 to `count` - 1."""

    @property
    def count(self) -> int: ...

    def shown(self, uv: Float, /) -> Bool:
        """Return which places (..., 2) can be looked up."""
        ...

    def taps(self, uv: Float, /, *, slopes: bool = False) -> Iterator[Tap]:
        """Yield the shares of points at places (..., 2), all of which are shown."""
        ...


def _within(uv: Float, shape: tuple[int, ...], border: float) -> Bool:
    u, v, far_u, far_v = uv[..., 0], uv[..., 1], shape[1] - 1 - border, shape[0] - 1 - border
    with np.errstate(invalid="ignore"):
        return np.asarray((u >= border) & (v >= border) & (u <= far_u) & (v <= far_v))


@dataclass(frozen=True, eq=False)
class Hard:
    """The level of the nearest pixel; `level` (H, W) int. Quick, and a staircase over poses."""

    level: Int
    count: int

    def shown(self, uv: Float) -> Bool:
        return _within(uv, self.level.shape, -0.499)

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        u, v = np.moveaxis(np.rint(uv).astype(np.intp), -1, 0)
        yield Tap(self.level[v, u], np.ones(u.shape), np.zeros(uv.shape) if slopes else None)


@dataclass(frozen=True, eq=False)
class Linear:
    """Grey between pixels is bilinear, and is shared between the two levels beside it; `value` (H, W) in levels."""

    value: Float
    count: int

    def shown(self, uv: Float) -> Bool:
        return _within(uv, self.value.shape, 0.0)

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        height, width = self.value.shape
        u, v = uv[..., 0], uv[..., 1]
        column, row = np.minimum(u.astype(np.intp), width - 2), np.minimum(v.astype(np.intp), height - 2)
        fu, fv = u - column, v - row
        flat, place = self.value.ravel(), row * width + column
        a, b, c, d = flat[place], flat[place + 1], flat[place + width], flat[place + width + 1]
        value = (a * (1 - fu) + b * fu) * (1 - fv) + (c * (1 - fu) + d * fu) * fv
        low = np.clip(value.astype(np.intp), 0, self.count - 2)
        share = value - low
        slope = np.stack([(b - a) * (1 - fv) + (d - c) * fv, (c - a) * (1 - fu) + (d - b) * fu], -1) if slopes else None
        yield Tap(low, 1 - share, None if slope is None else -slope)
        yield Tap(low + 1, share, slope)


@dataclass(frozen=True, eq=False)
class Spline:
    """Every pixel has one level; a point is shared among 4x4 pixels by cubic B-splines, as Koide et al. do it.

    `level` (H, W) int.
    """

    level: Int
    count: int

    def shown(self, uv: Float) -> Bool:
        return _within(uv, self.level.shape, 1.0)

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        height, width = self.level.shape
        u, v = uv[..., 0], uv[..., 1]
        column, row = np.minimum(u.astype(np.intp), width - 3), np.minimum(v.astype(np.intp), height - 3)
        over_u, over_v = cubic(u - column), cubic(v - row)
        du, dv = (cubic_slope(u - column), cubic_slope(v - row)) if slopes else (None, None)
        flat, place = self.level.ravel(), row * width + column
        for j in range(4):
            for i in range(4):
                level = flat[place + ((j - 1) * width + i - 1)]
                slope = None if du is None or dv is None else np.stack([du[i] * over_v[j], over_u[i] * dv[j]], -1)
                yield Tap(level, over_u[i] * over_v[j], slope)


def cubic(f: Float) -> tuple[Float, Float, Float, Float]:
    """Return the weights of pixels -1, 0, 1, 2 at f (...) from 0 to 1 between 0 and 1: uniform cubic B-spline."""
    g = 1 - f
    return g**3 / 6, (4 - 3 * f**2 * (2 - f)) / 6, (4 - 3 * g**2 * (2 - g)) / 6, f**3 / 6


def cubic_slope(f: Float) -> tuple[Float, Float, Float, Float]:
    """Return the derivatives of `cubic` by f."""
    g = 1 - f
    return -(g**2) / 2, f * (3 * f - 4) / 2, -g * (3 * g - 4) / 2, f**2 / 2
