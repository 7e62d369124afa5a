"""Joint histograms of what two sensors measure, for many poses at once, and how much one tells of the other.

Rows count the levels of the LiDAR, columns those of the picture. From counts (B, R, C) to shares (B, R, C), which add
up to one, lead three estimators: plain, smoothed by Gaussian kernels, and shrunk towards equal shares. Measures are
costs: lower is better. All of them say their derivatives, so that costs of poses can be differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from p2o.arrays import Float, Int

_LEAST_ENTROPY = 1e-9
"""Below this nothing varies, and neither sensor can tell anything of the other."""


def joint_counts(row: Int, column: Int, weight: Float, rows: int, columns: int) -> Float:
    """Return joint histograms (B, R, C) of rows (N,), the same for all, and columns (B, N), with weights (B, N)."""
    many = len(column)
    cell = (np.arange(many)[:, None] * rows + row) * columns + column
    return np.bincount(cell.ravel(), weight.ravel(), many * rows * columns).reshape(many, rows, columns)


# ---- estimators


class Estimator(Protocol):
    """Turns counts into shares."""

    def shares(self, counts: Float, /) -> Float:
        """Return shares (B, R, C) of counts (B, R, C); zero where nothing was counted."""
        ...

    def slope(self, counts: Float, by_shares: Float, /) -> Float:
        """Return derivatives (R, C) by counts (R, C) whose sum stays, of what has derivatives `by_shares` (R, C)."""
        ...


@dataclass(frozen=True)
class Plain:
    """Shares of the counts as they are: the estimate of maximum likelihood."""

    def shares(self, counts: Float) -> Float:
        return counts / np.maximum(counts.sum(axis=(-2, -1), keepdims=True), 1e-12)

    def slope(self, counts: Float, by_shares: Float) -> Float:
        return np.asarray(by_shares / max(float(counts.sum()), 1e-12))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Shares smoothed by a kernel for each axis: matrices `over_rows` (R, R) and `over_columns` (C, C).

    A column of these is where the counts of one level go; it adds up to one.
    """

    over_rows: Float
    over_columns: Float

    @classmethod
    def by_silverman(cls, counts: Float, factor: float = 1.06) -> Smoothed:
        """Return Gaussian kernels for counts (R, C): deviation `factor` sigma n^(-1/5) on each axis (Silverman)."""
        total = max(float(counts.sum()), 1.0)
        widths = [factor * _deviation(counts.sum(axis=axis)) * total**-0.2 for axis in (1, 0)]
        return cls(*(kernel(size, width) for size, width in zip(counts.shape, widths, strict=True)))

    def shares(self, counts: Float) -> Float:
        return Plain().shares(self.over_rows @ counts @ self.over_columns.T)

    def slope(self, counts: Float, by_shares: Float) -> Float:
        return self.over_rows.T @ Plain().slope(counts, by_shares) @ self.over_columns


@dataclass(frozen=True)
class Shrunk:
    """Shares between those of the counts and equal ones, t = 1 / (R C): p = k t + (1 - k) p_counts.

    k = (1 - sum p^2) / ((n - 1) sum (t - p)^2), cut off at 0 and 1: the James-Stein estimator of Hausser and Strimmer
    (JMLR 2009), which Pandey et al. take in 2015. Few counts are drawn far towards equal shares.
    """

    def share_of_target(self, counts: Float) -> Float:
        """Return k (B,) of counts (B, R, C)."""
        p, total = Plain().shares(counts), counts.sum(axis=(-2, -1))
        spread = np.maximum((total - 1) * ((p - 1 / p[0].size) ** 2).sum(axis=(-2, -1)), 1e-12)
        return np.clip((1 - (p**2).sum(axis=(-2, -1))) / spread, 0.0, 1.0)

    def shares(self, counts: Float) -> Float:
        k = self.share_of_target(counts)[:, None, None]
        there = counts.sum(axis=(-2, -1), keepdims=True) > 0
        return np.where(there, k / counts[0].size + (1 - k) * Plain().shares(counts), 0.0)

    def slope(self, counts: Float, by_shares: Float) -> Float:
        p, target, total = Plain().shares(counts), 1 / counts.size, float(counts.sum())
        k = float(self.share_of_target(counts[None])[0])
        slope = (1 - k) * by_shares
        if 0 < k < 1:
            above, below = 1 - float((p**2).sum()), (total - 1) * float(((p - target) ** 2).sum())
            of_k = -2 * p / below - above * 2 * (total - 1) * (p - target) / below**2
            slope = slope + of_k * float((by_shares * (target - p)).sum())
        return Plain().slope(counts, slope)


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
        return cls(
            entropy(shares.sum(axis=-1)), entropy(shares.sum(axis=-2)), entropy(shares.reshape(*shares.shape[:-2], -1))
        )


def entropy(shares: Float) -> Float:
    """Return the entropy (...) in nats of shares (..., K): - sum p log p."""
    return np.asarray(-(shares * np.log(np.maximum(shares, 1e-300))).sum(axis=-1))


@dataclass(frozen=True)
class Measure:
    """A cost of entropies: `value` of (rows, columns, both), its `weights` the derivatives by the three; `worst` is it
    where one sensor tells nothing of the other.
    """

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
        log_both, log_rows, log_columns = (
            np.log(np.maximum(p, 1e-12))
            for p in (shares, shares.sum(axis=1, keepdims=True), shares.sum(axis=0, keepdims=True))
        )
        # The derivative of -p log p is -log p - 1; the ones move nothing where the sum stays.
        return np.asarray(-both * log_both - single * (log_rows + log_columns))


MI = Measure(
    value=lambda h: h.both - h.rows - h.columns,
    weights=lambda h: (-1.0, 1.0),
    worst=0.0,
)
"""Minus mutual information: H(X, Y) - H(X) - H(Y), from -log of the number of levels to 0."""

NMI = Measure(
    value=lambda h: -(h.rows + h.columns) / h.both,
    weights=lambda h: (-1 / float(h.both), float(h.rows + h.columns) / float(h.both) ** 2),
    worst=-1.0,
)
"""Minus normalised mutual information: -(H(X) + H(Y)) / H(X, Y), from -2 to -1 (Studholme et al. 1999)."""

NID = Measure(value=lambda h: 2 - (h.rows + h.columns) / h.both, weights=NMI.weights, worst=1.0)
"""Normalised information distance: (H(X, Y) - MI) / H(X, Y), from 0 to 1; it is 2 - NMI."""
