"""Local lines through image edge points, and the gates that tell a good pair from a bad one (paper Sec. III-D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Bool, Float


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of K candidate edges: `centre` (K, 2) px, unit `normal` (K, 2), variances in px^2 along and across."""

    centre: Float
    normal: Float
    along: Float
    across: Float


def fit_lines(points: Float) -> Lines:
    """Return the lines through K sets of n points (K, n, 2) in pixels: centre of gravity and direction of least spread.

    The eigenvectors of the 2x2 covariance are taken in closed form. A set of equal points gets normal (0, 1) and no
    spread; `straight` refuses it.
    """
    # One row for each of the n: sums over rows are quick.
    u, v = np.ascontiguousarray(points.T)
    centre = np.stack([u.mean(axis=0), v.mean(axis=0)], axis=1)
    du, dv = u - centre[:, 0], v - centre[:, 1]
    uu, vv, uv = (du * du).mean(axis=0), (dv * dv).mean(axis=0), (du * dv).mean(axis=0)
    mean, half = 0.5 * (uu + vv), np.hypot(0.5 * (uu - vv), uv)
    direction = 0.5 * np.arctan2(2 * uv, uu - vv)
    normal = np.stack([-np.sin(direction), np.cos(direction)], axis=1)
    return Lines(centre, normal, mean + half, np.maximum(mean - half, 0.0))


def straight(lines: Lines, min_ratio: float) -> Bool:
    """Return which lines (K,) have a variance along them `min_ratio` times that across (lambda_c of the paper)."""
    return (lines.along > 0) & (lines.along >= min_ratio * lines.across)


def faces(lines: Lines, uv: Float, max_angle_deg: float, free_px: float) -> Bool:
    """Return which pixels uv (K, 2) lie across their line rather than beyond its end (lambda_a of the paper).

    The angle between centre-to-pixel and normal, whatever its sign, must not exceed `max_angle_deg`. Pixels within
    `free_px` of the centre always pass: there the direction is that of the pixel grid, and the gate would throw away
    just the pairs that fit best.
    """
    offset = uv - lines.centre
    distance = np.hypot(offset[:, 0], offset[:, 1])
    across = np.abs((offset * lines.normal).sum(axis=1))
    # The slack admits the limit itself in spite of rounding.
    good: Bool = (distance <= free_px) | (across >= distance * (np.cos(np.radians(max_angle_deg)) - 1e-12))
    return good
