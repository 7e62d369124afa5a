"""Maximise the gradient orientation measure, `--matcher gom`, after Taylor, Nieto and Johnson (IROS 2013).

Gradients of reflectance (or of the steepness of surfaces, `by=normals`) and of the image are parallel if they are
aligned. The cost is - sum |g . h| / sum |g| |h|, with g the gradient of the image at a point and h that of the points,
rotated into the image; -1 if all are parallel, -2/pi on average if they are unrelated. The paper searches by `--solver
particle-swarm` with `--set pipeline.rounds=1`; `--method gom` by `cma-es` in the box of `mi`, with reflectances ranked
in each ring (`cloud.equalise=auto`).

As in the paper, the gradient of a point uses its eight nearest neighbours by direction; the fit (least squares in the
plane across the beam), the width of the blur, the number of points, and a weight that decreases over the last 10 px to
the border are ours. The clouds of the paper are dense: in
sweeps with few rings the neighbours are on one ring and gradients across rings are poor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import p2o
from p2o import Float, field
from p2o.solving import Objective
from scipy.spatial import cKDTree

from p2o_baselines import examples
from p2o_baselines.information.histogram import by_rank, presence
from p2o_baselines.information.information import Sighting, remembered, sightings

_CHUNK = 1 << 17
_BLUR_SIGMA_PX = 2.0  # width of the blur before the image's gradient
_POINTS = 6_000  # largest number of points per view
_NEIGHBOURS = 8  # nearest neighbours by direction for the gradient of a point


class GomOptions(p2o.Options):
    """Options of `gom`."""

    by: Literal["reflectance", "normals"] = field("reflectance", help="Compare reflectance, or steepness of surfaces.")


@dataclass(frozen=True, eq=False)
class Slopes:
    """Points (N, 3) m of one sweep with gradients across the beam (N, 3) per rad, and those of the image (2, H W)."""

    camera: p2o.Camera
    grey: Float
    xyz: Float
    along: Float

    def sums(self, poses: Float) -> tuple[Float, Float]:
        """Return sum |g . h| and sum |g| |h|, (B,) each, over the points that poses (B, 4, 4) put in the image."""
        size = max(1, _CHUNK // max(len(self.xyz), 1))
        parts = [self._sums(poses[i : i + size]) for i in range(0, len(poses), size)]
        aligned, all_ = (np.concatenate(column) for column in zip(*parts, strict=True))
        return aligned, all_

    def _sums(self, poses: Float) -> tuple[Float, Float]:
        size = np.linalg.norm(self.along, axis=1)
        step_m = 1e-3 * np.linalg.norm(self.xyz, axis=1) / np.maximum(size, 1e-12)
        uv = self.camera.project(p2o.se3.apply(poses, self.xyz))
        step = self.camera.project(p2o.se3.apply(poses, self.xyz + step_m[:, None] * self.along)) - uv
        u, v, du, dv = uv[..., 0], uv[..., 1], step[..., 0], step[..., 1]
        height, width = self.camera.height, self.camera.width
        weight = presence(uv, width, height, -0.5) * np.isfinite(du)
        shown = weight > 0
        column, row = (np.rint(np.where(shown, at, 0.0)).astype(np.intp) for at in (u, v))
        pixel = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
        gu, gv = self.grey[0][pixel], self.grey[1][pixel]
        long = np.maximum(np.sqrt(du**2 + dv**2), 1e-12)
        aligned = np.where(shown, weight * np.abs(gu * du + gv * dv) / long, 0.0)
        return aligned @ size, (weight * np.sqrt(gu**2 + gv**2)) @ size


def gradients(xyz: Float, value: Float, neighbours: int) -> Float:
    """Return the gradients (N, 3) of values (N,) over the directions of points (N, 3), per radian, across the beams."""
    if len(xyz) <= neighbours:
        return np.zeros_like(xyz)
    beam = xyz / np.maximum(np.linalg.norm(xyz, axis=1, keepdims=True), 1e-9)
    near = cKDTree(beam).query(beam, neighbours + 1)[1]
    apart = beam[near] - beam[:, None]
    change = value[near] - value[:, None]
    spread = np.einsum("nki,nkj->nij", apart, apart)
    # The gradient along the beam is not measured; a small isotropic term is added, because neighbours may be collinear.
    size = np.trace(spread, axis1=1, axis2=2)[:, None, None] + 1e-12
    full = spread + size * (np.einsum("ni,nj->nij", beam, beam) + 0.03 * np.eye(3))
    slope = np.linalg.solve(full, np.einsum("nki,nk->ni", apart, change)[:, :, None])[:, :, 0]
    return np.asarray(slope - (slope * beam).sum(axis=1, keepdims=True) * beam)


def build(options: GomOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus the orientation measure."""

    @remembered
    def grey_gradient(grey: p2o.GreyMap) -> Float:
        import cv2

        values = (255 * by_rank(grey.values)).astype(np.float32)
        values = cv2.GaussianBlur(values, (0, 0), _BLUR_SIGMA_PX)
        pair = [cv2.Sobel(values, cv2.CV_64F, *order, ksize=3) / 8 for order in ((1, 0), (0, 1))]
        return np.stack(pair).reshape(2, -1)

    def slopes_of(sighting: Sighting, pose: Float) -> Slopes | None:
        near = sighting.near_image(pose, len(sighting.xyz))
        if not len(near.xyz):
            return None
        along = gradients(near.xyz, by_rank(near.value), _NEIGHBOURS)
        # The points with the steepest gradients contain nearly all information.
        steep = np.argsort(-np.linalg.norm(along, axis=1), kind="stable")[:_POINTS]
        return Slopes(near.camera, grey_gradient(near.grey), near.xyz[steep], along[steep])

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        parts = [s for sighting in sightings(views, options.by) if (s := slopes_of(sighting, camera_from_lidar))]

        def cost(poses: Float) -> Float:
            aligned, all_ = np.zeros(len(poses)), np.zeros(len(poses))
            for part in parts:
                more = part.sums(np.asarray(poses, np.float64))
                aligned, all_ = aligned + more[0], all_ + more[1]
            return -aligned / np.maximum(all_, 1e-12)

        return Objective(cost)

    return match


METHOD = p2o.Method(
    name="gom",
    build=build,
    options=GomOptions,
    summary="Maximises the alignment of gradients of grey and of reflectance (or steepness).",
    needs={"image-grey", "cloud-points"},
    gives={"objective"},
    cite="Taylor, Nieto and Johnson, Automatic calibration of multi-modal sensor systems using a gradient orientation "
    "measure, IROS 2013",
    example=examples.information(2, "particle-swarm", "pipeline.rounds=1", perturb="3deg 0.2m", within="0.6deg 0.05m"),
)
