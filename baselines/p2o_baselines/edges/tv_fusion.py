"""Align depth edges with image edges by total variation: `tv-fusion`, after Castorena et al. 2016.

    p2o run --extractor smoothness/returns --matcher tv-fusion --solver random-shrink --init given
            --set pipeline.rounds=1 --set solver.samples=60

At each pose the sweep is projected onto a coarse grid and interpolated by weighted total variation (`total_variation`),
with small weights at edges of the image. The cost is the share of the variation of the depth map in smooth parts of the
image: sum w |grad psi| / sum |grad psi|. No reflectance, no features, one frame or several.

Departures from the paper: the logarithm of depth is used, so that a step from 5 to 10 m equals one from 20 to 40; the
cost is divided by the variation without weights, since the plain sum is least with few points in view; the inner
problem is solved by 40 steps of a primal-dual method (FISTA in the original) on cells of 6 px; pixels over two cells
from any point are not counted. The outer search is any solver of an objective. Grid, weights and strength are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Bool, Float, field
from p2o.solving import Objective
from scipy.ndimage import binary_dilation

from p2o_baselines.edges.smoothness import SmoothMap


def gradient(values: Float) -> tuple[Float, Float]:
    """Return forward differences of maps (..., H, W) down and across, 0 in the last row and column."""
    down, across = np.zeros_like(values), np.zeros_like(values)
    np.subtract(values[..., 1:, :], values[..., :-1, :], out=down[..., :-1, :])
    np.subtract(values[..., :, 1:], values[..., :, :-1], out=across[..., :, :-1])
    return down, across


def divergence(down: Float, across: Float) -> Float:
    """Return minus the adjoint of `gradient`."""
    out = down + across
    out[..., 1:, :] -= down[..., :-1, :]
    out[..., :, 1:] -= across[..., :, :-1]
    return out


def filled(depth: Float, known: Bool, weight: Float, strength: float, iterations: int) -> Float:
    """Return the maps psi (..., H, W) of least 1/2 |psi - depth|^2 + strength TV(psi), by Chambolle and Pock (2011)."""
    step = 1.0 / np.sqrt(8.0)
    many = np.maximum(known.sum(axis=(-2, -1), keepdims=True), 1)
    mean = np.where(known, depth, 0.0).sum(axis=(-2, -1), keepdims=True) / many
    psi = np.where(known, depth, mean)
    ahead, down, across = psi.copy(), np.zeros_like(psi), np.zeros_like(psi)
    pull, most = np.where(known, step, 0.0), strength * weight
    given = pull * np.where(known, depth, 0.0)
    for _ in range(iterations):
        steps = gradient(ahead)
        down += step * steps[0]
        across += step * steps[1]
        shrink = np.maximum(np.hypot(down, across) / np.maximum(most, 1e-12), 1.0)
        down /= shrink
        across /= shrink
        before = psi
        psi = (psi + step * divergence(down, across) + given) / (1.0 + pull)
        ahead = 2 * psi - before
    return psi


_MARGIN_PX = 100.0  # points so far outside of the image may be brought in by another pose
_AT_ONCE = 1 << 18  # cells of several maps that are filled together
_CELL_PX = 6.0  # pixels to a cell of the grid that is filled
_ITERATIONS = 40  # steps of the inner problem


class FusionOptions(p2o.Options):
    """Options of `tv-fusion`."""

    strength: float = field(0.02, gt=0, le=100, help="Weight of the variation against the measured log depth.")


def coarse(weight: Float, cell_px: float) -> Float:
    """Return the least weight of a map (H, W) in each cell of the grid: an edge anywhere in it is one."""
    rows, columns = (max(2, int(size / cell_px)) for size in weight.shape)
    row = np.minimum((np.arange(weight.shape[0]) / cell_px).astype(np.int64), rows - 1)
    column = np.minimum((np.arange(weight.shape[1]) / cell_px).astype(np.int64), columns - 1)
    out = np.full((rows, columns), np.inf)
    np.minimum.at(out, (row[:, None], column[None, :]), weight)
    return out


@dataclass(frozen=True, eq=False)
class FusedView:
    """One frame: the weights (h, w) on its grid and the points (N, 3) near its image."""

    camera: p2o.Camera
    weight: Float
    xyz: Float
    options: FusionOptions

    def maps(self, poses: Float) -> tuple[Float, Bool]:
        """Return the log depth (B, h, w) of the nearest point in each cell, and the mask of occupied cells."""
        in_camera = p2o.se3.apply(poses, self.xyz)
        uv = self.camera.project(in_camera)
        pose, point = np.nonzero(self.camera.in_image(uv))
        rows, columns = self.weight.shape
        u, v = (np.maximum(uv[pose, point], 0.0) / _CELL_PX).astype(np.int64).T
        place = (pose * rows + np.minimum(v, rows - 1)) * columns + np.minimum(u, columns - 1)
        depth = np.full(len(poses) * rows * columns, np.inf)
        np.minimum.at(depth, place, in_camera[pose, point, 2])
        known = np.isfinite(depth)
        log = np.log(np.maximum(np.where(known, depth, 1.0), 0.1))
        shape = (len(poses), rows, columns)
        return log.reshape(shape), known.reshape(shape)

    def cost(self, poses: Float) -> Float:
        """Return the share (B,) of the variation in smooth parts of the image."""
        size = max(1, _AT_ONCE // max(self.weight.size, len(self.xyz)))
        return np.concatenate([self._cost(poses[i : i + size]) for i in range(0, len(poses), size)])

    def _cost(self, poses: Float) -> Float:
        options = self.options
        depth, known = self.maps(poses)
        psi = filled(depth, known, self.weight, options.strength, _ITERATIONS)
        near = binary_dilation(known, np.ones((1, 5, 5), np.bool_))
        size = np.where(near, np.hypot(*gradient(psi)), 0.0)
        total = size.sum(axis=(1, 2))
        smooth = np.sum(self.weight * size, axis=(1, 2)) / np.maximum(total, 1e-9)
        return np.asarray(np.where(total > 1e-9, smooth, 1.0))


def build(options: FusionOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: the mean cost of the frames."""

    def posed(view: p2o.View, pose: Float) -> FusedView | None:
        smooth, points = view.get(SmoothMap.word), view.get("cloud-points")
        if smooth is None or points is None:
            return None
        near = view.camera.in_image(view.camera.project(p2o.se3.apply(pose, points.xyz)), _MARGIN_PX)
        weight = coarse(smooth.values, _CELL_PX)
        return FusedView(view.camera, weight, points.xyz[near], options) if near.any() else None

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        known = [each for view in views if (each := posed(view, camera_from_lidar)) is not None]

        def cost(poses: Float) -> Float:
            return np.mean([each.cost(poses) for each in known], axis=0) if known else np.ones(len(poses))

        return Objective(cost)

    return match


METHOD = p2o.Method(
    name="tv-fusion",
    build=build,
    options=FusionOptions,
    summary="Aligns edges of interpolated depth with edges of the image.",
    needs={"image-smoothness", "cloud-points"},
    gives={"objective"},
    cite="Castorena et al., Autocalibration of LIDAR and optical cameras via edge alignment, ICASSP 2016",
    expected_failures=(
        ("costs_are_lowest_at_the_truth", "the grain of the stage's walls is as strong an edge of grey as an outline"),
    ),
)
