"""Align lines of the sweep with planes through lines of the image, `--extractor lsd/plane-lines --matcher lines`.

Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013. A line of the image
and the camera's centre span a plane with the unit normal n. A 3D line with point p and direction d lies in it if n . (R
d) = 0 and n . (R p + t) = 0. Each 3D line is matched with the nearest image line; the robust sum over both residuals of
all pairs is minimised (solver `lm`), and lines are matched again.

Intended for dense clouds of indoor scenes; `--accumulate poses` and streets with buildings are closest to that.

Departures: nearest is defined by the reach of the round, an angle, and an overlap (the original is not known to us in
detail). Residuals are in pixels: the offset is divided by the range of the point and multiplied by the focal length;
the direction is also multiplied by half the length of the 3D line, so that it is the error at the ends and short lines
with uncertain direction have less influence. The initial extrinsic is given, as in the original.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Float, Int
from p2o.solving import LeastSquares

_MAX_ANGLE_DEG = 8.0  # largest angle in the image between lines that are paired
_HUBER_PX = 2.0  # residual from which a pair counts linearly and no longer squared


@dataclass(frozen=True, eq=False)
class LinesInPlanes(LeastSquares):
    """Residuals scale normal . (R vector + whole t) px: offsets where `whole` (K,) is 1, directions where it is 0."""

    vector: Float
    normal: Float
    scale: Float
    whole: Float
    frame: Int
    huber_px: float = 2.0

    @property
    def weight(self) -> Float:  # type: ignore[override]
        """One each."""
        return np.ones(len(self.vector))

    @property
    def huber(self) -> float:
        """The width of the Huber kernel in pixels."""
        return self.huber_px

    @property
    def far(self) -> float:
        """The largest residual that counts."""
        return 50.0 * self.huber_px

    def depth_m(self, camera_from_lidar: Float) -> float:
        """Return the mean distance of the lines from the camera."""
        points = self.vector[self.whole > 0]
        if not len(points):
            return 30.0
        return float(np.linalg.norm(p2o.se3.apply(camera_from_lidar, points), axis=1).mean())

    def _turned(self, pose: Float) -> Float:
        """Return R vector + whole t, (..., K, 3)."""
        pose = np.asarray(pose, np.float64)
        turned = self.vector @ np.swapaxes(pose[..., :3, :3], -1, -2)
        return np.asarray(turned + self.whole[:, None] * pose[..., None, :3, 3])

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return signed residuals in pixels, (K,) for one pose or (B, K) for several."""
        return np.asarray(self.scale * (self._turned(camera_from_lidar) * self.normal).sum(axis=-1))

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (K,) and derivatives (K, 6) for a left update exp(delta) @ camera_from_lidar."""
        turned = self._turned(camera_from_lidar)
        by_turn, by_shift = np.cross(turned, self.normal), self.whole[:, None] * self.normal
        jacobian = self.scale[:, None] * np.concatenate([by_turn, by_shift], axis=1)
        return np.asarray(self.scale * (turned * self.normal).sum(axis=-1)), jacobian


def build(options: p2o.Options) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> LinesInPlanes`."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> LinesInPlanes:
        parts = [_rows(view, camera_from_lidar, reach_px) for view in views]
        frame = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        rows = np.concatenate([np.zeros((0, 8)), *parts])
        return LinesInPlanes(rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7], frame, _HUBER_PX)

    return match


def nearest_lines(uv: Float, ends: Float, reach_px: float, max_angle_deg: float) -> Int:
    """Return the row of the nearest of `ends` for each projected segment (M, 2, 2) px, -1 for none beside it."""
    out = np.full(len(uv), -1)
    if not len(uv) or not len(ends):
        return out
    middle, along = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    normal = along[:, ::-1] * [-1.0, 1.0]
    with np.errstate(invalid="ignore", divide="ignore"):
        turn = uv[:, 1] - uv[:, 0]
        turn = turn / np.linalg.norm(turn, axis=1, keepdims=True)
        off = np.abs(uv @ normal.T - (middle * normal).sum(axis=1)).max(axis=1)  # (M, N)
        good = (off <= reach_px) & (np.abs(turn @ normal.T) <= np.sin(np.radians(max_angle_deg)))
        beside = np.abs(uv.mean(axis=1) @ along.T - (middle * along).sum(axis=1))
        good &= beside <= 0.5 * length + reach_px
    rows = np.flatnonzero(good.any(axis=1))
    out[rows] = np.where(good[rows], off[rows], np.inf).argmin(axis=1)
    return out


def _rows(view: p2o.View, pose: Float, reach_px: float) -> Float:
    """Return rows (K, 8) of one view: vector, normal, scale, whole; two for each pair of lines."""
    image, cloud = view.get("image-lines"), view.get("cloud-lines")
    if not image or not cloud:
        return np.zeros((0, 8))
    xyz = p2o.se3.apply(pose, cloud.ends.reshape(-1, 3))
    uv = view.camera.project(xyz).reshape(-1, 2, 2)
    uv[~view.camera.in_image(uv).all(axis=1)] = np.nan
    chosen = nearest_lines(uv, image.ends, reach_px, _MAX_ANGLE_DEG)
    pairs = np.flatnonzero(chosen >= 0)
    normal = np.cross(*np.moveaxis(view.camera.rays(image.ends[chosen[pairs]]), 1, 0))
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    finite = np.isfinite(length[:, 0]) & (length[:, 0] > 1e-9)
    pairs, normal = pairs[finite], normal[finite] / length[finite]
    ends = cloud.ends[pairs]
    point, half = ends.mean(axis=1), 0.5 * (ends[:, 1] - ends[:, 0])
    scale, one = view.camera.focal_px / np.linalg.norm(p2o.se3.apply(pose, point), axis=1), np.ones(len(pairs))
    rows = ([point, normal, scale, one], [half, normal, scale, 0 * one])
    return np.concatenate([np.column_stack(each) for each in rows])


METHOD = p2o.Method(
    name="lines",
    build=build,
    summary="Lines of the sweep on planes through the nearest lines of the image: direction and offset.",
    needs={"image-lines", "cloud-lines"},
    gives={"residuals"},
    cite="Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013",
)
