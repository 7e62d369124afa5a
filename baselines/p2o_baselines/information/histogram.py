"""Joint histograms of the values of two sensors for many poses at once, and the information that they share.

Rows are the levels of the LiDAR, columns those of the image. Three estimators convert counts (B, R, C) to probabilities
(B, R, C), which add up to one: plain, smoothed by Gaussian kernels, and shrunk towards equal probabilities. Measures
are costs: lower is better. All return their derivatives, so that costs of poses can be differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from p2o import Float, Int


@dataclass(frozen=True, eq=False)
class Tap:
    """A share of every point: level (...), weight (...), its derivatives (..., 2) by u, v; weights add up to one."""

    level: Int
    weight: Float
    slope: Float | None = None


_FADE_PX = 10.0
"""Points count less from this distance to the border on: a pose that moves them out changes a cost steadily."""


def presence(uv: Float, width: int, height: int, border: float) -> Float:
    """Return weights (...) of positions (..., 2).

    The weight is 0 outside and at `border` px from the outermost pixel centres, and 1 from 10 px further inside.
    """
    u, v, far_ends = uv[..., 0], uv[..., 1], (width - 1 - border, height - 1 - border)
    with np.errstate(invalid="ignore"):
        across, down = (np.minimum(x - border, far - x) for x, far in zip((u, v), far_ends, strict=True))
        weight = np.clip(np.minimum(across, down) / _FADE_PX, 0.0, 1.0)
    return np.where(np.isnan(weight), 0.0, weight)


def presence_slope(uv: Float, width: int, height: int, border: float) -> Float:
    """Return the derivatives (..., 2) by u, v of `presence`."""
    with np.errstate(invalid="ignore"):
        to_low, to_high = uv - border, np.array([width, height]) - 1 - border - uv
        by_axis = np.minimum(to_low, to_high) / _FADE_PX
    weight = by_axis.min(axis=-1, keepdims=True)
    least = np.arange(2) == by_axis.argmin(axis=-1)[..., None]
    return np.where(least & (weight > 0) & (weight < 1), np.where(to_low < to_high, 1, -1) / _FADE_PX, 0.0)


@dataclass(frozen=True, eq=False)
class Levels:
    """An image `level` (H, W) of levels from 0 to `count` - 1, which is shown up to `border` px from its ends."""

    level: Any
    count: int
    border: ClassVar[float]

    def presence(self, uv: Float) -> Float:
        """Return weights (...) of positions (..., 2); those of weight 0 cannot be sampled."""
        height, width = self.level.shape
        return presence(uv, width, height, self.border)

    def presence_slope(self, uv: Float) -> Float:
        """Return the derivatives (..., 2) of the weights."""
        height, width = self.level.shape
        return presence_slope(uv, width, height, self.border)

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        """Yield the shares of points at places (..., 2), all of which are shown."""
        raise TypeError("a subclass samples the image")


@dataclass(frozen=True, eq=False)
class Hard(Levels):
    """The level of the nearest pixel; `level` (H, W) int. Quick, and a staircase over poses."""

    border = -0.499

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        u, v = np.moveaxis(np.rint(uv).astype(np.intp), -1, 0)
        yield Tap(self.level[v, u], np.ones(u.shape), np.zeros(uv.shape) if slopes else None)


@dataclass(frozen=True, eq=False)
class Linear(Levels):
    """Bilinear grey values, divided between the two nearest levels; `level` (H, W) float."""

    border = 0.0

    def taps(self, uv: Float, *, slopes: bool = False) -> Iterator[Tap]:
        height, width = self.level.shape
        u, v = uv[..., 0], uv[..., 1]
        column, row = np.minimum(u.astype(np.intp), width - 2), np.minimum(v.astype(np.intp), height - 2)
        fu, fv = u - column, v - row
        flat, place = self.level.ravel(), row * width + column
        a, b, c, d = flat[place], flat[place + 1], flat[place + width], flat[place + width + 1]
        value = (a * (1 - fu) + b * fu) * (1 - fv) + (c * (1 - fu) + d * fu) * fv
        low = np.clip(value.astype(np.intp), 0, self.count - 2)
        share = value - low
        slope = np.stack([(b - a) * (1 - fv) + (d - c) * fv, (c - a) * (1 - fu) + (d - b) * fu], -1) if slopes else None
        yield Tap(low, 1 - share, None if slope is None else -slope)
        yield Tap(low + 1, share, slope)


@dataclass(frozen=True, eq=False)
class Spline(Levels):
    """Every pixel has one level (H, W) int; a point is shared among 4x4 by cubic B-splines, after Koide et al."""

    border = 1.0

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
    return g * g * g / 6, (4 - 3 * f**2 * (2 - f)) / 6, (4 - 3 * g**2 * (2 - g)) / 6, f * f * f / 6


def cubic_slope(f: Float) -> tuple[Float, Float, Float, Float]:
    """Return the derivatives of `cubic` by f."""
    g = 1 - f
    return -(g**2) / 2, f * (3 * f - 4) / 2, -g * (3 * g - 4) / 2, f**2 / 2


_LEAST_ENTROPY = 1e-9  # entropy below which a sensor is constant and carries no information


def by_rank(values: Float) -> Float:
    """Return values of any shape replaced by their rank, in (0, 1); equal ones share the mean of their ranks."""
    flat = np.sort(values, axis=None)
    below, up_to = (np.searchsorted(flat, values, side) for side in ("left", "right"))
    return np.asarray((below + up_to) / (2.0 * max(flat.size, 1)))


def ranked_levels(values: Float, bins: int) -> Int:
    """Return values of any shape as equally frequent levels 0 to `bins` - 1 (histogram equalisation)."""
    return np.asarray((by_rank(values) * bins).astype(np.int64))


def joint_counts(row: Int, column: Int, weight: Float, rows: int, columns: int) -> Float:
    """Return joint histograms (B, R, C) of rows (N,), the same for all, and columns (B, N), with weights (B, N)."""
    many = len(column)
    cell = row * columns + column
    cell += np.arange(many)[:, None] * (rows * columns)
    return np.asarray(np.bincount(cell.ravel(), weight.ravel(), many * rows * columns).reshape(many, rows, columns))


# ---- estimators


@dataclass(frozen=True)
class Plain:
    """Shares of the counts as they are: the estimate of maximum likelihood."""

    def shares(self, counts: Float) -> Float:
        """Return probabilities (B, R, C) of counts (B, R, C); zero without counts."""
        return np.asarray(counts / np.maximum(counts.sum(axis=(-2, -1), keepdims=True), 1e-12))

    def slope(self, counts: Float, by_shares: Float) -> Float:
        """Return derivatives (R, C) by counts (R, C) of what has derivatives `by_shares` (R, C)."""
        total = max(float(counts.sum()), 1e-12)
        return np.asarray((by_shares - float((by_shares * counts).sum()) / total) / total)


@dataclass(frozen=True, eq=False)
class Smoothed(Plain):
    """Probabilities smoothed by kernels for both axes, (R, R) and (C, C), whose columns distribute a level."""

    over_rows: Float
    over_columns: Float

    @classmethod
    def by_silverman(cls, counts: Float, factor: float = 1.06) -> Smoothed:
        """Return Gaussian kernels for counts (R, C): deviation `factor` sigma n^(-1/5) on each axis (Silverman)."""
        total = max(float(counts.sum()), 1.0)
        widths = [factor * _deviation(counts.sum(axis=axis)) * total**-0.2 for axis in (1, 0)]
        return cls(*(kernel(size, width) for size, width in zip(counts.shape, widths, strict=True)))

    def shares(self, counts: Float) -> Float:
        return super().shares(self.smoothed(counts))

    def slope(self, counts: Float, by_shares: Float) -> Float:
        return self.over_rows.T @ super().slope(self.smoothed(counts), by_shares) @ self.over_columns

    def smoothed(self, counts: Float) -> Float:
        """Return smoothed counts (..., R, C), whose sum is that of counts (..., R, C)."""
        return self.over_rows @ counts @ self.over_columns.T


@dataclass(frozen=True)
class Shrunk(Plain):
    """Probabilities between the relative counts and equal ones, t = 1 / (R C): p = k t + (1 - k) p_counts.

    k = (1 - sum p^2) / ((n - 1) sum (t - p)^2), limited to 0 and 1: the James-Stein estimator of Hausser and Strimmer
    (JMLR 2009), which Pandey et al. use in 2015. Few counts are shrunk strongly.
    """

    def share_of_target(self, counts: Float) -> Float:
        """Return k (B,) of counts (B, R, C)."""
        p, total = super().shares(counts), counts.sum(axis=(-2, -1))
        spread = np.maximum((total - 1) * ((p - 1 / p[0].size) ** 2).sum(axis=(-2, -1)), 1e-12)
        return np.asarray(np.clip((1 - (p**2).sum(axis=(-2, -1))) / spread, 0.0, 1.0))

    def shares(self, counts: Float) -> Float:
        k = self.share_of_target(counts)[:, None, None]
        counted = counts.sum(axis=(-2, -1), keepdims=True) > 0
        return np.where(counted, k / counts[0].size + (1 - k) * super().shares(counts), 0.0)

    def slope(self, counts: Float, by_shares: Float) -> Float:
        p, target, total = super().shares(counts), 1 / counts.size, float(counts.sum())
        k = float(self.share_of_target(counts[None])[0])
        slope = (1 - k) * by_shares
        if 0 < k < 1:
            above, below = 1 - float((p**2).sum()), (total - 1) * float(((p - target) ** 2).sum())
            of_k = -2 * p / below - above * 2 * (total - 1) * (p - target) / below**2
            along = float((by_shares * (target - p)).sum())
            of_total = -above / below * along / (total - 1)
            return super().slope(counts, slope + of_k * along) + of_total
        return super().slope(counts, slope)


def kernel(size: int, sigma: float) -> Float:
    """Return the matrix (size, size) that spreads each level to its neighbours by a Gaussian of `sigma` levels."""
    apart = np.subtract.outer(np.arange(size), np.arange(size))
    weight = np.exp(-0.5 * (apart / max(sigma, 1e-3)) ** 2)
    return np.asarray(weight / weight.sum(axis=0))


def _deviation(counts: Float) -> float:
    level, total = np.arange(len(counts)), max(float(counts.sum()), 1e-12)
    mean = float(level @ counts) / total
    return float(np.sqrt(max(float((level - mean) ** 2 @ counts) / total, 0.0)))


# ---- measures


@dataclass(frozen=True, eq=False)
class Entropies:
    """Entropies in nats of shares (B, R, C): of the rows, of the columns, and of both together, (B,) each."""

    rows: Float
    columns: Float
    both: Float

    @classmethod
    def of(cls, shares: Float) -> Entropies:
        whole = entropy(shares.reshape(*shares.shape[:-2], -1))
        return cls(entropy(shares.sum(axis=-1)), entropy(shares.sum(axis=-2)), whole)


def entropy(shares: Float) -> Float:
    """Return the entropy (...) in nats of shares (..., K): - sum p log p."""
    return np.asarray(-(shares * np.log(np.maximum(shares, 1e-300))).sum(axis=-1))


@dataclass(frozen=True)
class Measure:
    """A cost of entropies, its derivatives by a single one and by both, and its value if nothing is shared."""

    value: Callable[[Entropies], Float]
    weights: Callable[[Entropies], tuple[float, float]]
    worst: float

    def of(self, shares: Float) -> Float:
        """Return the costs (B,) of shares (B, R, C)."""
        entropies = Entropies.of(shares)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(entropies.both > _LEAST_ENTROPY, self.value(entropies), self.worst)

    def slope(self, shares: Float) -> Float:
        """Return the derivatives (R, C) by shares (R, C) whose sum stays; empty cells count as nearly so."""
        entropies = Entropies.of(shares)
        if entropies.both <= _LEAST_ENTROPY:
            return np.zeros_like(shares)
        single, both = self.weights(entropies)
        margins = (shares, shares.sum(axis=1, keepdims=True), shares.sum(axis=0, keepdims=True))
        log_both, log_rows, log_columns = (np.log(np.maximum(p, 1e-12)) for p in margins)
        # The derivative of -p log p is -log p - 1; the ones move nothing where the sum stays.
        return np.asarray(-both * log_both - single * (log_rows + log_columns))


MI = Measure(value=lambda h: h.both - h.rows - h.columns, weights=lambda h: (-1.0, 1.0), worst=0.0)
"""Minus mutual information: H(X, Y) - H(X) - H(Y), from -log of the number of levels to 0."""

NMI = Measure(
    value=lambda h: -(h.rows + h.columns) / h.both,
    weights=lambda h: (-1 / float(h.both), float(h.rows + h.columns) / float(h.both) ** 2),
    worst=-1.0,
)
"""Minus normalised mutual information: -(H(X) + H(Y)) / H(X, Y), from -2 to -1 (Studholme et al. 1999)."""

NID = Measure(value=lambda h: 2 - (h.rows + h.columns) / h.both, weights=NMI.weights, worst=1.0)
"""Normalised information distance: (H(X, Y) - MI) / H(X, Y), from 0 to 1; it is 2 - NMI."""
