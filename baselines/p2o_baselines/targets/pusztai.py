"""Calibrate with boxes of known size, `--calibrator pusztai`, after Pusztai and Hajder 2017.

An ordinary box shows three faces to both sensors. In the sweep, RANSAC finds three orthogonal planes, and a cuboid of
the known size is fitted to their points; its corners are 3D points of the LiDAR. The image shows the same corners, and
a perspective-n-point method gives the pose, refined by Levenberg-Marquardt on pixels. One box with a corner facing both
sensors is enough.

Departures: the corners in the images of the paper are marked by hand; here they are detected (the outline of a region
of one saturated colour has six sides, and three edges meet inside), so a box needs a colour that differs from the
background. The assignment of corners follows from the size. The poses of the cuboids are adjusted in the last step
within their uncertainty, as in the authors' paper of 2018 on several sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import p2o
from p2o import Float, Result, Status, se3
from p2o.solving import Judged

from p2o_baselines import examples
from p2o_baselines.bodies.box_pairing import BoxPair, box_sight_of, missing_boxes, paired_boxes, warnings_of
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.outcome import refused
from p2o_baselines.target_method import Sight, TargetOptions, solved, unsolved

_MOST_OFF_PX, _MOST_MOVED = 4.0, 5.0
"""Corners with larger residuals, or cuboids moved by more standard deviations, belong to other boxes."""
_LEAST_SHARE, _LEAST_SEEN = 0.5, 3
"""Of at least this many boxes that both sensors see, this share must fit one pose, or their size is wrong."""


@dataclass(frozen=True)
class Cuboid:
    """One pair in the least squares; its own unknown is a left update (6,) of its pose in the sweep."""

    pair: BoxPair

    @property
    def camera_scale(self) -> tuple[float, float]:
        """Distance of the box from the camera in m, and pixels per radian there."""
        return float(np.linalg.norm(self.pair.image.camera_from_box[:3, 3])), self.pair.image.flat.scale_px

    @cached_property
    def root(self) -> Float:
        """What takes moves (6,) of the sweep's pose to deviations."""
        return np.linalg.inv(np.linalg.cholesky(self.pair.sweep.covariance + 1e-14 * np.eye(6)))

    @cached_property
    def _whitened(self) -> Float:
        """What takes offsets (K, 2) of corners to deviations (K, 2, 2)."""
        return np.linalg.inv(np.linalg.cholesky(self.pair.image.covariance))

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return residuals of corners in the image and of the cuboid's pose in the sweep, in standard deviations."""
        off = corner_offsets(self.pair, camera_from_lidar @ se3.exp(own))
        middle = self.pair.sweep.lidar_from_box[:3, 3]
        prior = own.copy()
        prior[3:] += bias_m * middle / np.linalg.norm(middle)  # ranges too long: the box is nearer
        whole = np.einsum("kij,kj->ki", self._whitened, np.nan_to_num(off, nan=1e3)).ravel()
        return np.concatenate([whole, self.root @ prior])


def corner_offsets(pair: BoxPair, camera_from_lidar: Float) -> Float:
    """Return how far (K, 2) px a pose puts the corners of the sweep's box from those of the image."""
    xyz = se3.apply(camera_from_lidar @ pair.lidar_from_box, pair.image.target.outline[pair.image.vertex])
    return pair.image.flat.seen(xyz) - pair.image.uv


def from_corners(pairs: Sequence[BoxPair], rough: Float) -> Float:
    """Return the pose (4, 4) from all corners by a perspective-n-point method; the rough one if it fails."""
    import cv2

    xyz = np.concatenate([se3.apply(p.lidar_from_box, p.image.target.outline[p.image.vertex]) for p in pairs])
    rays = np.concatenate([pair.image.corner_rays for pair in pairs])
    if (rays[:, 2] < 0.05).any():
        return rough
    plane = rays[:, :2] / rays[:, 2:]
    solved, turn, shift = cv2.solvePnP(xyz, plane, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    return se3.make(cv2.Rodrigues(turn)[0], shift.ravel()) if solved else rough


@dataclass(frozen=True)
class Pusztai:
    """The calibrator."""

    options: TargetOptions

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Return the boxes in image and sweep."""
        return box_sight_of(frame, self.options)

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the corners of both sensors are the same."""
        start = np.asarray(camera_from_lidar, np.float64)
        result = unsolved(prepared, start)
        missing = missing_boxes(prepared)
        if missing:
            return refused(result, missing)
        pairing = paired_boxes(prepared, start)
        if pairing is None:
            reason = "no box of a sweep matches its image at a pose with less than 3 m between the sensors"
            return refused(result, reason, Status.TOO_FEW_MATCHES)
        pairs = pairing.pairs
        corners = sum(len(pair.image.uv) for pair in pairs)
        result = replace(
            result,
            matches={"boxes": len(pairs), "corners": corners, "points": sum(pair.sweep.points for pair in pairs)},
            warnings=warnings_of(prepared, pairing),
        )
        both = sum(min(len(sight.in_image), len(sight.in_sweep)) for sight in prepared)
        if both >= _LEAST_SEEN and len(pairs) < _LEAST_SHARE * both:
            reason = f"{len(pairs)} of {both} boxes that both sensors see fit one pose: check the size in `targets`"
            return refused(result, reason, Status.TOO_FEW_MATCHES)
        cuboids, rough = [Cuboid(pair) for pair in pairs], from_corners(pairs, pairing.camera_from_lidar)
        fit = adjusted(cuboids, rough, [np.zeros(6)] * len(pairs))
        before, after = (_off_px(pairs, pose) for pose in (start, fit.camera_from_lidar))
        solution = solved(
            result,
            fit.camera_from_lidar,
            fit.covariance,
            reason=f"{corners} corners of {len(pairs)} boxes are {after:.2f} px off (root mean square)",
            judged=Judged("corners off boxes", "px", before, after),
            remedy="add boxes elsewhere in the image",
        )
        wrong = _wrong(pairs, fit.camera_from_lidar, fit.own) if solution.status.solved else ""
        return refused(result, wrong, Status.TOO_FEW_MATCHES) if wrong else solution


def _off_px(pairs: Sequence[BoxPair], pose: Float) -> float:
    off = np.concatenate([np.nan_to_num(corner_offsets(pair, pose), nan=1e3) for pair in pairs])
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _wrong(pairs: Sequence[BoxPair], pose: Float, own: Sequence[Float]) -> str:
    """Return why boxes of sweeps and images do not fit each other after adjustment; "" if they do."""
    off = [corner_offsets(pair, pose @ se3.exp(step)) for pair, step in zip(pairs, own, strict=True)]
    rms = float(np.sqrt(np.mean(np.sum(np.nan_to_num(np.concatenate(off), nan=1e3) ** 2, axis=1))))
    moved = [np.linalg.norm(Cuboid(pair).root @ step) / np.sqrt(6) for pair, step in zip(pairs, own, strict=True)]
    if rms < _MOST_OFF_PX and np.median(moved) < _MOST_MOVED:
        return ""
    off_px = f"{_off_px(pairs, pose):.1f} px off at the best pose"
    why = "sweeps and images show other boxes, or the size in `targets` is wrong"
    return f"corners of {len(pairs)} boxes lie {off_px}: {why}"


METHOD = p2o.Method(
    name="pusztai",
    build=Pusztai,
    options=TargetOptions,
    summary="Boxes of known size: three faces and a cuboid in the sweep, corners in the image, PnP; one can do.",
    needs=frozenset({"targets"}),
    cite="Pusztai and Hajder, Accurate calibration of LiDAR-camera systems using ordinary boxes, ICCV workshops 2017",
    example=examples.targets("box", "os1-64", 4, "0.6deg 0.05m"),
)
