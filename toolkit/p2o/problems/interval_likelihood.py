"""Log-likelihood of a pose if LiDAR edges are intervals: between the last beam on an object and the first beyond it.

The outline of an object lies anywhere between these two beams, with uniform probability. Where rings are more than
half a degree apart, the distance from the middle of the interval to the next image edge contains no information; the
number of intervals that contain an image edge has one sharp maximum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from p2o.arrays import Float, Int
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.motion import adjoint_matrix
from p2o.problems.directed_cost import interpolated
from p2o.problems.distinct_views import evenly_chosen, scenes_of
from p2o.problems.point_to_line import OUTLINE_CELL_PX
from p2o.runtime.native import for_each

Float32 = np.ndarray

_WINDOW_PX = 241
"""Width and height of the window in which the density of image edges is the one of random alignment."""
_MIN_DENSITY = 0.002
"""Smallest density of weighted image edges per pixel that is expected under random alignment."""
_ACROSS_PX = 2.0
"""Standard deviation of an image edge along itself: outlines have gaps."""
_LEAST_PX = 0.5
_SHARE, _MIN_SHARE, _MAX_SHARE, _SHARE_ITERATIONS = 0.3, 0.03, 0.9, 20
_AT_ONCE = 40_000
"""Number of intervals times poses in one batch: more do not fit in the cache of a core."""
_STEPS = np.radians(0.1) * np.ones(6) * [1, 1, 1, 5, 5, 5]
"""Steps of a left update (rad, m) in which the local maximisation is well conditioned: 0.1 deg and about 1 cm."""
_DIFFERENCE = 2.5
"""Half a step of differences for the curvature, in `_STEPS`: single intervals end closer to the maximum."""
_LEAST_CURVATURE = 0.05
"""Smallest curvature in nats per square of a step of `_STEPS`: 0.45 deg and 4.5 cm where nothing is observable."""


@dataclass(frozen=True, eq=False)
class _Part:
    """Intervals of one side of view number `view`: rows, ends (N, 3) in the frame of `around`, weights, `integral`."""

    view: int
    side: Side
    rows: Int
    camera: Camera
    ends: tuple[Float, Float]
    weight: Float
    integral: Float32

    @property
    def upright(self) -> bool:
        """Whether the intervals are vertical in the image; the integral of horizontal ones is transposed."""
        return self.side in (Side.UPPER, Side.BOTTOM)


def ring_step_deg(views: Sequence[View]) -> float:
    """Return the median angle in degrees between neighbouring beams across the rings; 0 without edges with sides.

    This is the larger of the medians of horizontal and of vertical edges.
    """
    edges = [view.cloud_edges for view in views]
    side = np.concatenate([np.zeros(0, np.int8), *(each.side for each in edges)])
    angle = np.concatenate([np.zeros(0), *(each.gap_rad for each in edges)])
    level = np.isin(side, (Side.UPPER, Side.BOTTOM))
    kinds = (angle[level], angle[~level & (side != Side.NONE)])
    return float(np.degrees(max((np.median(angles) for angles in kinds if len(angles)), default=0.0)))


def integral_of_edges(view: View, side: Side, sigma_px: float) -> Float32:
    """Return the integral (H, W) of the image edges of a side down each column, relative to their local density.

    The density of edges, weighted by the square of their confidence, is divided by its mean over a window, so that its
    mean is about 1, and smoothed by `sigma_px` along the integral. The array of left and right edges is transposed: it
    integrates along rows.
    """
    import cv2

    edges = view.image_edges
    density = np.zeros((view.camera.height, view.camera.width), np.float32)
    rows = edges.index.get(side, np.zeros(0, np.int64))
    pixel = np.rint(edges.uv[rows]).astype(np.int64)
    inside = view.camera.in_image(pixel)
    np.maximum.at(density, tuple(pixel[inside].T[::-1]), np.square(edges.weight[rows][inside]))
    if side in (Side.LEFT, Side.RIGHT):
        density = np.ascontiguousarray(density.T)
    density /= cv2.blur(density, (_WINDOW_PX, _WINDOW_PX), borderType=cv2.BORDER_REPLICATE) + np.float32(_MIN_DENSITY)
    density = cv2.GaussianBlur(density, (0, 0), _ACROSS_PX, sigmaY=sigma_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(np.cumsum(density, axis=0, dtype=np.float32) - np.float32(0.5) * density)


@dataclass(frozen=True, eq=False)
class IntervalLikelihood:
    """Logarithm of the likelihood of a pose over that of random alignment, in nats; higher is better.

    Made by `IntervalLikelihood.of`; calling it with camera_from_lidar (B, 4, 4) gives (B,). An edge of the sweep has a
    counterpart in the image with the probability `shares` of its side. Its position is then uniform over the projected
    interval, with an error of `sigma_px`; other image edges have their local density. The likelihood ratio of an edge
    is therefore 1 - a + a m, with m the mean density of image edges over the interval relative to the local one (Bar-
    Shalom and Fortmann, 1988, on the association of measurements among clutter). For intervals of length 0 this is the
    density at a point. Parts of intervals outside the image count as randomly aligned.
    """

    parts: tuple[_Part, ...]
    lidar_from_around: Float
    scenes: Int
    shares: Mapping[Side, float] = field(default_factory=lambda: dict.fromkeys(SIDES, _SHARE))

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        around: Float,
        sigma_px: float,
        *,
        margin_px: float = 0.0,
        max_points: int | None = None,
        max_views: int | None = None,
        shares: Mapping[Side, float] | None = None,
    ) -> IntervalLikelihood:
        """Return the likelihood of the edges that `around` (4, 4) projects into the images or near them.

        `max_points` and `max_views` keep even subsets of edges and views. Edges of one side within a cell of 64 px are
        of one outline: their weights are divided by the root of their number, and multiplied by that of their view.
        Sides that an image has no edges of are left out.
        """
        pixels = [view.camera.project(se3.apply(around, view.cloud_edges.xyz)) for view in views]
        masks = [
            view.camera.in_image(uv, margin_px) & np.isin(view.cloud_edges.side, view.image_edges.sides)
            for view, uv in zip(views, pixels, strict=True)
        ]
        numbers = np.arange(len(views))
        if max_views is not None:
            numbers = evenly_chosen(np.array([view.weight for view in views]), max_views)
        points = int(sum(masks[number].sum() for number in numbers))
        step = 1 if max_points is None else max(1, -(-points // max_points))

        def parts_of(number: int) -> list[_Part]:
            view, kept = views[number], np.flatnonzero(masks[number])[::step]
            parts = []
            for side in SIDES:
                rows = kept[view.cloud_edges.side[kept] == side]
                if len(rows):
                    cell = np.floor(pixels[number][rows] / OUTLINE_CELL_PX)
                    _, group, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
                    weight = view.weight * view.cloud_edges.weight[rows] / np.sqrt(count[group.reshape(-1)])
                    ends = _ends(view, rows, around)
                    integral = integral_of_edges(view, side, sigma_px)
                    parts.append(_Part(number, side, rows, view.camera, ends, weight, integral))
            return parts

        parts = [part for of_view in for_each(parts_of, numbers.tolist(), parallel=True) for part in of_view]
        likelihood = cls(tuple(parts), se3.inverse(around), scenes_of(views))
        return likelihood if shares is None else replace(likelihood, shares=shares)

    def on(self, views: Sequence[View]) -> IntervalLikelihood:
        """Return the likelihood of the same edges with the same weights, where `views` put them and see them."""
        around = se3.inverse(self.lidar_from_around)
        parts = (
            replace(part, camera=views[part.view].camera, ends=_ends(views[part.view], part.rows, around))
            for part in self.parts
        )
        return replace(self, parts=tuple(parts))

    @cached_property
    def points(self) -> int:
        """The number of edges."""
        return sum(len(part.rows) for part in self.parts)

    def __call__(self, poses: Float) -> Float:
        """Return the log-likelihood ratio (B,) of poses (B, 4, 4); 0 for random alignment."""
        total = np.zeros(len(poses))
        for part in self.parts:
            size = max(1, _AT_ONCE // len(part.rows))
            for first in range(0, len(poses), size):
                batch = slice(first, first + size)
                total[batch] += self._terms(part, poses[batch]).sum(axis=1)
        return total

    def terms(self, poses: Float) -> Float:
        """Return the weighted terms (B, K) of all edges at poses (B, 4, 4)."""
        return np.concatenate([np.zeros((len(poses), 0)), *(self._terms(part, poses) for part in self.parts)], axis=1)

    def _terms(self, part: _Part, poses: Float) -> Float:
        return np.log1p(self.shares[part.side] * (self.density(part, poses) - 1.0)) * part.weight

    def density(self, part: _Part, poses: Float) -> Float:
        """Return the mean relative density (B, N) of image edges over the intervals of a part at poses (B, 4, 4)."""
        ends = [part.camera.project(se3.apply(poses @ self.lidar_from_around, xyz)) for xyz in part.ends]
        along = 1 if part.upright else 0
        with np.errstate(invalid="ignore"):
            low, high = np.minimum(*(uv[..., along] for uv in ends)), np.maximum(*(uv[..., along] for uv in ends))
            across = 0.5 * (ends[0][..., 1 - along] + ends[1][..., 1 - along])
            short = 0.5 * np.maximum(_LEAST_PX - (high - low), 0.0)
            low, high = low - short, high + short
            rows, columns = part.integral.shape
            inside = (across >= 0) & (across <= columns - 1) & (high >= 0) & (low <= rows - 1)
        out = np.ones(inside.shape)
        across, low, high = across[inside], low[inside], high[inside]
        out[inside] = (_integrated(part, across, high) - _integrated(part, across, low)) / (high - low)
        return np.asarray(out)

    def fitted(self, pose: Float) -> IntervalLikelihood:
        """Return the likelihood with the shares of edges that have a counterpart at a pose (4, 4), by EM."""
        shares = dict(self.shares)
        for side in {part.side for part in self.parts}:
            of_side = [part for part in self.parts if part.side is side]
            density = np.concatenate([self.density(part, pose[None])[0] for part in of_side])
            weight = np.concatenate([part.weight for part in of_side])
            share = shares[side]
            for _ in range(_SHARE_ITERATIONS):
                posterior = share * density / (1.0 - share + share * density)
                share = float(np.clip(weight @ posterior / max(weight.sum(), 1e-9), _MIN_SHARE, _MAX_SHARE))
            shares[side] = share
        return replace(self, shares=shares)

    def with_gradient(self, pose: Float) -> tuple[float, Float]:
        """Return the log-likelihood ratio of a pose (4, 4) and its derivatives (6,) by a left update in rad and m."""
        total, gradient = 0.0, np.zeros(6)
        for part in self.parts:
            density, by_update = self._linearised(part, pose)
            share = self.shares[part.side]
            ratio = 1.0 + share * (density - 1.0)
            total += float(part.weight @ np.log(ratio))
            gradient += (part.weight * share / ratio) @ by_update
        return total, gradient

    def _linearised(self, part: _Part, pose: Float) -> tuple[Float, Float]:
        """Return the density (N,) of a part at a pose (4, 4), and its derivatives (N, 6) by a left update."""
        density = self.density(part, pose[None])[0]
        along = 1 if part.upright else 0
        xyz = np.stack([se3.apply(pose @ self.lidar_from_around, ends) for ends in part.ends])
        with np.errstate(divide="ignore", invalid="ignore"):
            uv, by_xyz = part.camera.project_with_jacobian(xyz.reshape(-1, 3))
        uv, by_xyz = uv.reshape(2, -1, 2), by_xyz.reshape(2, -1, 2, 3)
        known = np.isfinite(uv).all(axis=(0, 2)) & (density != 1.0)  # outside of the image it is constant
        uv, by_xyz, xyz = uv[:, known], by_xyz[:, known], xyz[:, known]
        across, length = uv[:, :, 1 - along].mean(axis=0), uv[1, :, along] - uv[0, :, along]
        length = np.where(length < 0, -1.0, 1.0) * np.maximum(np.abs(length), _LEAST_PX)
        # Derivatives by the position of each end along the interval, and by that of both across it.
        at_ends = [_slope(part, across, end) for end in uv[:, :, along]]
        by_ends = (density[known] - at_ends[0]) / length, (at_ends[1] - density[known]) / length
        across_ends = [_slope_across(part, across, end) for end in uv[:, :, along]]
        by_across = (across_ends[1] - across_ends[0]) / length
        out = np.zeros((len(density), 6))
        for by_end, jacobian, point in zip(by_ends, by_xyz, xyz, strict=True):
            by_point = by_end[:, None] * jacobian[:, along] + 0.5 * by_across[:, None] * jacobian[:, 1 - along]
            out[known] += np.concatenate([np.cross(point, by_point), by_point], axis=1)
        return density, out

    def maximised(self, pose: Float) -> Float:
        """Return the pose (4, 4) of the local maximum near a pose."""
        return most_likely_near([(np.eye(4), self.with_gradient)], pose, _STEPS, 20) if self.points else pose

    def covariance(self, pose: Float) -> Float:
        """Return the covariance (6, 6) of a left update in rad and m at the maximum.

        It is cluster robust: the scatter of the gradient over outlines (edges of one side in a cell of 64 px, in
        all views of one scene), between two inverses of the curvature.
        """
        shifts = _DIFFERENCE * np.eye(6)
        steps = np.concatenate([(a + b)[None] for a in (*shifts, *-shifts) for b in (*shifts, *-shifts)])
        values = self(se3.exp(steps * _STEPS) @ pose).reshape(2, 6, 2, 6)
        signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
        curvature = -np.einsum("iajb,ij->ab", values, signs) / (2 * _DIFFERENCE) ** 2
        eigenvalues, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
        inverse = (axes / np.maximum(eigenvalues, _LEAST_CURVATURE)) @ axes.T
        around = self.terms(se3.exp(np.concatenate([shifts, -shifts]) * _STEPS) @ pose)
        gradient = (around[:6] - around[6:]) / (2 * _DIFFERENCE)
        cells = self._outlines(pose)
        by_outline = np.array([np.bincount(cells, row) for row in gradient])
        score = by_outline @ by_outline.T
        scale = np.diag(_STEPS)
        return np.asarray(scale @ inverse @ score @ inverse @ scale)

    def _outlines(self, pose: Float) -> Int:
        """Return the number (K,) of the outline of each edge: its scene, side and cell of 64 px."""
        keys = []
        for part in self.parts:
            middle = se3.apply(pose @ self.lidar_from_around, 0.5 * (part.ends[0] + part.ends[1]))
            cell = np.floor(np.nan_to_num(part.camera.project(middle), nan=-1.0) / OUTLINE_CELL_PX)
            keys.append(np.column_stack([np.full((len(cell), 2), (self.scenes[part.view], int(part.side))), cell]))
        numbers = np.unique(np.concatenate([np.zeros((0, 4)), *keys]), axis=0, return_inverse=True)[1]
        return np.asarray(numbers.reshape(-1), np.int64)


def most_likely_near(
    parts: Sequence[tuple[Float, Callable[[Float], tuple[float, Float]]]],
    body_from_lidar: Float,
    steps: Float,
    iterations: int,
) -> Float:
    """Return the pose (4, 4) of the local maximum of a sum of interval likelihoods near a pose, by BFGS.

    `parts` are camera_from_body (4, 4) and the log likelihood of each camera with its derivatives; `steps` (6,) are the
    units of the unknowns in rad and m.
    """
    from scipy.optimize import minimize

    known = [(place, adjoint_matrix(place), likelihood) for place, likelihood in parts]

    def cost_and_gradient(x: Float) -> tuple[float, Float]:
        pose, total, gradient = se3.exp(x * steps) @ body_from_lidar, 0.0, np.zeros(6)
        for place, adjoint, likelihood in known:
            value, by_camera = likelihood(place @ pose)
            total, gradient = total - value, gradient - by_camera @ adjoint
        return total, gradient * steps

    start = np.zeros(6)
    best = minimize(cost_and_gradient, start, jac=True, method="BFGS", options={"maxiter": iterations, "gtol": 0.2})
    return np.asarray(se3.exp(best.x * steps) @ body_from_lidar)


def _ends(view: View, rows: Int, around: Float) -> tuple[Float, Float]:
    """Return both ends (N, 3) of the intervals of the edges of a view, in the frame of a pose `around` (4, 4)."""
    ends = view.cloud_edges.select(rows).ends
    return se3.apply(around, ends[0]), se3.apply(around, ends[1])


def _integrated(part: _Part, across: Float, along: Float) -> Float:
    """Return the integral at positions in px; beyond the ends of the image, where nothing is known, its slope is 1."""
    inside = np.clip(along, 0.0, part.integral.shape[0] - 1.001)
    values = interpolated(part.integral, across.astype(np.float32), inside.astype(np.float32))
    return np.asarray(values + (along - inside))


def _slope(part: _Part, across: Float, along: Float) -> Float:
    """Return the derivative of the integral along the interval: the density of image edges."""
    return np.asarray(_integrated(part, across, along + 0.5) - _integrated(part, across, along - 0.5))


def _slope_across(part: _Part, across: Float, along: Float) -> Float:
    """Return the derivative of the integral across the interval."""
    last = part.integral.shape[1] - 1.0
    low, high = np.maximum(across - 0.5, 0.0), np.minimum(across + 0.5, last)
    return np.asarray((_integrated(part, high, along) - _integrated(part, low, along)) / np.maximum(high - low, 0.5))
