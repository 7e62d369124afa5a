"""Align lanes and poles of the sweep with those of the image: `crlf`, after Ma et al. 2021, without its network.

    p2o run --extractor lane-pole/lane-pole --matcher crlf --solver random-shrink --init given
            --set pipeline.rounds=1

The cost is minus the share of lane points on lanes of the image, plus that of pole points, each class with weight one
half if both exist. The score of a point falls linearly with its distance from the mask, from 1 on the mask to 0 at
6 px; points outside the image score 0, so that a pose cannot gain by losing points.

Departures from the paper and its code (PJLab lidar2camera/auto_calib): masks by shape instead of a network
(`lane_pole_image`); the given initial extrinsic instead of one from three lines (P3L); a linear fall-off instead of a
dilated mask (grey level over 55); `random-shrink` as the search (the original draws 10000 poses per round and confuses
degrees and metres in its ranges).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Float, Int
from p2o.solving import Objective

from p2o_baselines.segments.lane_pole_cloud import LANE, POLE, LanePolePoints
from p2o_baselines.segments.lane_pole_image import FAR_PX, LanePoleMap

_AT_ONCE = 1 << 18  # number of points of several poses that are sampled in one call
_POINTS = 4000  # largest number of points per frame, evenly sampled
_MARGIN_PX = 60.0  # margin around the image in which points are used
_SOFT_PX = 6.0  # distance from the mask at which a point scores 0


@dataclass(frozen=True, eq=False)
class LanePoleView:
    """One frame with the points that count at the pose it was posed at; `weight` (N,) sums to 1."""

    camera: p2o.Camera
    distance: LanePoleMap
    xyz: Float
    kind: Int
    weight: Float

    @classmethod
    def of(cls, view: p2o.View, pose: Float) -> LanePoleView | None:
        """Return the frame projected at a pose; None if no class is in both image and sweep."""
        camera, away, points = view.camera, view.get(LanePoleMap.word), view.get(LanePolePoints.word)
        if away is None or points is None or not len(points):
            return None
        near = camera.in_image(camera.project(p2o.se3.apply(pose, points.xyz)), _MARGIN_PX)
        for kind in (LANE, POLE):
            if not (away.values[..., kind] < FAR_PX).any():
                near &= points.kind != kind
        points = points.select(near).thinned(_POINTS)
        if not len(points):
            return None
        count = np.bincount(points.kind, minlength=2)
        weight = (1.0 / np.maximum(count, 1) / np.count_nonzero(count))[points.kind]
        return cls(camera, away, points.xyz, points.kind, weight)

    def share(self, poses: Float) -> Float:
        """Return the share (B,) of points on their masks at poses (B, 4, 4)."""
        size = max(1, _AT_ONCE // len(self.xyz))
        return np.concatenate([self._share(poses[i : i + size]) for i in range(0, len(poses), size)])

    def _share(self, poses: Float) -> Float:
        uv = self.camera.project(p2o.se3.apply(poses, self.xyz))
        away = np.take_along_axis(self.distance.at(uv), self.kind[None, :, None], axis=2)[..., 0]
        on = np.where(np.isfinite(away), np.maximum(1 - away / _SOFT_PX, 0.0), 0.0)
        return np.asarray(on @ self.weight)


def build(options: p2o.Options) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus the mean share."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        known = [each for view in views if (each := LanePoleView.of(view, camera_from_lidar)) is not None]

        def cost(poses: Float) -> Float:
            return -np.mean([each.share(poses) for each in known], axis=0) if known else np.zeros(len(poses))

        return Objective(cost)

    return match


METHOD = p2o.Method(
    name="crlf",
    build=build,
    summary="Aligns points of lanes and poles with lanes and poles of the image.",
    needs={"image-lane-pole", "cloud-lane-pole"},
    gives={"objective"},
    cite="Ma et al., CRLF: automatic calibration and refinement based on line feature, arXiv 2103.04558, 2021",
    expected_failures=(("costs_are_lowest_at_the_truth", "the stage has neither lanes nor poles, only plates"),),
)
