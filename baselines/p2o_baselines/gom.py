"""Gradient orientation measure, `--matcher gom`, after Taylor, Nieto and Johnson (IROS 2013).

Where the reflectance (or the steepness, `by=normals`) of the points changes, so does the picture, and in the same
direction: the cost is - sum |g . h| / sum |g| |h|, with g the gradient of the picture at a point and h that of the
points, turned into the picture; -1 where all are parallel, -2/pi on average where they have nothing to do with one
another. Made for `--solver particle-swarm` with `--set pipeline.rounds=1`.

As in the paper a gradient is that of a point's eight nearest neighbours by direction; ours are how it is fitted (least
squares in the plane across the beam), the width of the blur, and the points' number. The paper's clouds are dense: on
sweeps with few rings, neighbours are of one ring and gradients across rings poor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import p2o
from p2o.arrays import Float
from scipy.spatial import cKDTree

from p2o_baselines.boards_in_a_yard import boards_in_a_yard
from p2o_baselines.information import Sighting, sightings
from p2o_baselines.rank import by_rank
from p2o_baselines.remembered import remembered

_CHUNK = 1 << 17


class GomOptions(p2o.Options):
    """Options of `gom`."""

    by: Literal["reflectance", "normals"] = p2o.field(
        "reflectance", help="What of the points changes where grey does: reflectance, or the steepness of surfaces."
    )
    neighbours: int = p2o.field(8, ge=3, le=100, help="Neighbours by direction that a point's gradient is told from.")
    blur_sigma_px: float = p2o.field(2.0, ge=0, le=50, help="Width of the blur before the picture's gradient.")
    points: int = p2o.field(6_000, ge=100, le=10_000_000, help="Points of each view that count, at most.")


@dataclass(frozen=True, eq=False)
class Slopes:
    """Points of one sweep with the gradient of their values, and the gradient of the picture that saw them.

    `xyz` (N, 3) m and `along` (N, 3), how values change by angle, across the beam, both in the LiDAR frame; `picture`
    (2, H W) in grey levels a pixel, by u and v.
    """

    camera: p2o.Camera
    picture: Float
    xyz: Float
    along: Float

    def sums(self, poses: Float) -> tuple[Float, Float]:
        """Return sum |g . h| and sum |g| |h|, (B,) each, over the points that poses (B, 4, 4) put in the picture."""
        size = max(1, _CHUNK // max(len(self.xyz), 1))
        parts = [self._sums(poses[i : i + size]) for i in range(0, len(poses), size)]
        met, all_ = (np.concatenate(column) for column in zip(*parts, strict=True))
        return met, all_

    def _sums(self, poses: Float) -> tuple[Float, Float]:
        size = np.linalg.norm(self.along, axis=1)
        step_m = 1e-3 * np.linalg.norm(self.xyz, axis=1) / np.maximum(size, 1e-12)
        uv = self.camera.project(p2o.se3.apply(poses, self.xyz))
        step = self.camera.project(p2o.se3.apply(poses, self.xyz + step_m[:, None] * self.along)) - uv
        u, v, du, dv = uv[..., 0], uv[..., 1], step[..., 0], step[..., 1]
        shown = self.camera.in_image(uv) & np.isfinite(du)
        height, width = self.camera.height, self.camera.width
        column, row = (np.rint(np.where(shown, at, 0.0)).astype(np.intp) for at in (u, v))
        pixel = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
        gu, gv = self.picture[0][pixel], self.picture[1][pixel]
        long = np.maximum(np.sqrt(du**2 + dv**2), 1e-12)
        met = np.where(shown, np.abs(gu * du + gv * dv) / long, 0.0)
        return met @ size, np.where(shown, np.sqrt(gu**2 + gv**2), 0.0) @ size


def gradients(xyz: Float, value: Float, neighbours: int) -> Float:
    """Return the gradients (N, 3) of values (N,) over the directions of points (N, 3), per radian, across the beams."""
    if len(xyz) <= neighbours:
        return np.zeros_like(xyz)
    beam = xyz / np.maximum(np.linalg.norm(xyz, axis=1, keepdims=True), 1e-9)
    near = cKDTree(beam).query(beam, neighbours + 1)[1]
    apart = beam[near] - beam[:, None]
    change = value[near] - value[:, None]
    spread = np.einsum("nki,nkj->nij", apart, apart)
    # Along the beam nothing is measured; a little is added in all directions, as neighbours may lie on one line.
    size = np.trace(spread, axis1=1, axis2=2)[:, None, None] + 1e-12
    full = spread + size * (np.einsum("ni,nj->nij", beam, beam) + 0.03 * np.eye(3))
    slope = np.linalg.solve(full, np.einsum("nki,nk->ni", apart, change)[:, :, None])[:, :, 0]
    return np.asarray(slope - (slope * beam).sum(axis=1, keepdims=True) * beam)


def build(options: GomOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus the orientation measure."""

    def picture_of(grey: p2o.GreyMap) -> Float:
        import cv2

        values = (255 * by_rank(grey.values)).astype(np.float32)
        if options.blur_sigma_px > 0:
            values = cv2.GaussianBlur(values, (0, 0), options.blur_sigma_px)
        pair = [cv2.Sobel(values, cv2.CV_64F, *order, ksize=3) / 8 for order in ((1, 0), (0, 1))]
        return np.stack(pair).reshape(2, -1)

    picture = remembered(picture_of)

    def slopes_of(sighting: Sighting, pose: Float) -> Slopes | None:
        near = sighting.near_picture(pose, len(sighting.xyz))
        if not len(near.xyz):
            return None
        along = gradients(near.xyz, by_rank(near.value), options.neighbours)
        # Of many points those with the steepest gradients say all there is.
        steep = np.argsort(-np.linalg.norm(along, axis=1), kind="stable")[: options.points]
        return Slopes(near.camera, picture(near.grey), near.xyz[steep], along[steep])

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        parts = [s for sighting in sightings(views, options.by) if (s := slopes_of(sighting, camera_from_lidar))]

        def cost(poses: Float) -> Float:
            met, all_ = np.zeros(len(poses)), np.zeros(len(poses))
            for part in parts:
                more = part.sums(np.asarray(poses, np.float64))
                met, all_ = met + more[0], all_ + more[1]
            return -met / np.maximum(all_, 1e-12)

        return p2o.Objective(cost)

    return match


METHOD = p2o.Method(
    name="gom",
    build=build,
    options=GomOptions,
    summary="Gradients of grey and of reflectance (or steepness) are parallel where they belong together.",
    needs={"image-grey", "cloud-points"},
    gives={"objective"},
    cite="Taylor, Nieto and Johnson, Automatic calibration of multi-modal sensor systems using a gradient orientation "
    "measure, IROS 2013",
    example=boards_in_a_yard(2, "particle-swarm", "pipeline.rounds=1", perturb="3deg 0.2m", within="0.6deg 0.05m"),
)
