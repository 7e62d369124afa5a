"""Boxes of known size, `--calibrator pusztai`, after Pusztai and Hajder 2017.

    p2o run --data folder:BOXES --joint --calibrator pusztai

An ordinary box shows three faces to both sensors. In the sweep RANSAC finds three planes that stand square to each
other, and a cuboid of the known size is fitted to their points; its corners are points of the LiDAR. In the picture
the same corners are seen, and a perspective-n-point method gives the pose, refined by Levenberg and Marquardt on
pixels. One box can do; it has a corner turned to both sensors.

Departures: the paper's corners in pictures are marked by hand; here they are found (the outline of a region of one
strong colour has six sides, three edges meet inside of it), so a box has to have a colour of its own. Which corner is
which follows from the size. Cuboids stay movable in the last step, by what their points say of them, as in the
authors' paper of 2018 on several sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import p2o
from p2o import Result, Status, se3
from p2o.arrays import Float

from p2o_baselines.boards.board_method import likely
from p2o_baselines.bodies.body_options import BodyOptions, refused, too_unsure
from p2o_baselines.bodies.box_pairing import (
    BoxPair,
    BoxSight,
    box_sight_of,
    nothing_of,
    paired_boxes,
    remarks_of,
)
from p2o_baselines.bodies.bundle import adjusted

_MOST_OFF_PX, _MOST_MOVED = 4.0, 5.0
"""Corners that are farther off than this, or cuboids that had to be moved by so many deviations, are of other boxes."""
_LEAST_SHARE, _LEAST_SEEN = 0.5, 3
"""Of so many boxes that both sensors see, this share agrees on a pose, or their size is wrong."""


@dataclass(frozen=True)
class Cuboid:
    """One pair in the least squares; its own unknown is a left update (6,) of its pose in the sweep."""

    pair: BoxPair
    count: int = 6

    @property
    def distance_m(self) -> float:
        """How far the box is from the camera."""
        return float(np.linalg.norm(self.pair.picture.camera_from_box[:3, 3]))

    @property
    def px_per_rad(self) -> float:
        """The scale of the picture at the box."""
        return self.pair.picture.flat.scale_px

    @cached_property
    def root(self) -> Float:
        """What takes moves (6,) of the sweep's pose to deviations."""
        return np.linalg.inv(np.linalg.cholesky(self.pair.sweep.covariance + 1e-14 * np.eye(6)))

    @cached_property
    def _whitened(self) -> Float:
        """What takes offsets (K, 2) of corners to deviations (K, 2, 2)."""
        return np.linalg.inv(np.linalg.cholesky(self.pair.picture.covariance))

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return how far corners are from where the picture has them, and the pose from the sweep's, in deviations."""
        off = corner_offsets(self.pair, camera_from_lidar @ se3.exp(own))
        middle = self.pair.sweep.lidar_from_box[:3, 3]
        prior = own.copy()
        prior[3:] += bias_m * middle / np.linalg.norm(middle)  # ranges too long: the box is nearer
        whole = np.einsum("kij,kj->ki", self._whitened, np.nan_to_num(off, nan=1e3)).ravel()
        return np.concatenate([whole, self.root @ prior])


def corner_offsets(pair: BoxPair, camera_from_lidar: Float) -> Float:
    """Return how far (K, 2) px a pose puts the corners of the sweep's box from those of the picture."""
    xyz = se3.apply(camera_from_lidar @ pair.lidar_from_box, pair.picture.target.outline[pair.picture.vertex])
    return pair.picture.flat.seen(xyz) - pair.picture.uv


def from_corners(pairs: Sequence[BoxPair], rough: Float) -> Float:
    """Return the pose (4, 4) by a perspective-n-point method on all corners; the rough one where it has no answer."""
    import cv2

    xyz = np.concatenate([se3.apply(p.lidar_from_box, p.picture.target.outline[p.picture.vertex]) for p in pairs])
    rays = np.concatenate([pair.picture.corner_rays for pair in pairs])
    if (rays[:, 2] < 0.05).any():
        return rough
    plane = rays[:, :2] / rays[:, 2:]
    solved, turn, shift = cv2.solvePnP(xyz, plane, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    return se3.make(cv2.Rodrigues(turn)[0], shift.ravel()) if solved else rough


@dataclass(frozen=True)
class Pusztai:
    """The whole method."""

    options: BodyOptions

    def prepare(self, frame: p2o.Frame) -> BoxSight:
        """Return the boxes in picture and sweep."""
        return box_sight_of(frame, self.options)

    def solve(self, prepared: Sequence[BoxSight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the corners of both sensors are the same."""
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(sight.name for sight in prepared), start, start, Status.NO_FEATURES, "")
        nothing = nothing_of(prepared)
        if nothing:
            return refused(blank, Status.NO_FEATURES, nothing)
        pairing = paired_boxes(prepared, start)
        if pairing is None:
            return refused(
                blank,
                Status.TOO_FEW_MATCHES,
                "no box of a sweep is that of its picture at a pose whose sensors are within 3 m of each other",
            )
        pairs = pairing.pairs
        corners = sum(len(pair.picture.uv) for pair in pairs)
        told = replace(
            blank,
            matches={"boxes": len(pairs), "corners": corners, "points": sum(pair.sweep.points for pair in pairs)},
            warnings=remarks_of(prepared, pairing),
        )
        both = sum(min(len(sight.pictures), len(sight.sweeps)) for sight in prepared)
        if both >= _LEAST_SEEN and len(pairs) < _LEAST_SHARE * both:
            return refused(
                told,
                Status.TOO_FEW_MATCHES,
                f"{len(pairs)} of {both} boxes that both sensors see agree on a pose: is the size in `targets` right?",
            )
        fit = adjusted(
            [Cuboid(pair) for pair in pairs],
            from_corners(pairs, pairing.camera_from_lidar),
            [np.zeros(6)] * len(pairs),
            range_bias_m=options.range_bias_m,
            camera_px=options.camera_px,
        )
        unsure = too_unsure(fit.covariance, fit.camera_from_lidar, "boxes", options)
        if fit.covariance is None or unsure:
            return refused(told, Status.NOT_OBSERVABLE, unsure)
        wrong = _wrong(pairs, fit.camera_from_lidar, fit.own)
        if wrong:
            return refused(told, Status.TOO_FEW_MATCHES, wrong)
        before, after = (_off_px(pairs, pose) for pose in (start, fit.camera_from_lidar))
        return Result(
            told.frames,
            start,
            fit.camera_from_lidar,
            Status.CONVERGED,
            f"{corners} corners of {len(pairs)} boxes lie {after:.2f} px off (root mean square)",
            covariance=fit.covariance,
            accuracy=likely(fit.covariance, fit.camera_from_lidar),
            matches=told.matches,
            judged=p2o.Judged("corners off boxes", "px", before, after),
            warnings=told.warnings,
        )


def _off_px(pairs: Sequence[BoxPair], pose: Float) -> float:
    off = np.concatenate([np.nan_to_num(corner_offsets(pair, pose), nan=1e3) for pair in pairs])
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _wrong(pairs: Sequence[BoxPair], pose: Float, own: Sequence[Float]) -> str:
    """Return in words that boxes of sweeps and pictures do not fit each other, moved as they may be."""
    off = [corner_offsets(pair, pose @ se3.exp(step)) for pair, step in zip(pairs, own, strict=True)]
    rms = float(np.sqrt(np.mean(np.sum(np.nan_to_num(np.concatenate(off), nan=1e3) ** 2, axis=1))))
    moved = [np.linalg.norm(Cuboid(pair).root @ step) / np.sqrt(6) for pair, step in zip(pairs, own, strict=True)]
    if rms < _MOST_OFF_PX and np.median(moved) < _MOST_MOVED:
        return ""
    return (
        f"corners of {len(pairs)} boxes lie {_off_px(pairs, pose):.1f} px off at the best pose: sweeps and pictures "
        "show other boxes, or the size in `targets` is wrong"
    )


def build(options: BodyOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return Pusztai(options)


_BOXES = "targets=box&place=yard&frames_per_scene=4&width_px=621&height_px=350&right=false&lidar=os1-64"
METHOD = p2o.Method(
    name="pusztai",
    build=build,
    options=BodyOptions,
    summary="Boxes of known size: three faces and a cuboid in the sweep, corners in the picture, PnP; one can do.",
    needs=frozenset({"targets"}),
    cite="Pusztai and Hajder, Accurate calibration of LiDAR-camera systems using ordinary boxes, ICCV workshops 2017",
    example=p2o.Example(f"synthetic:?{_BOXES}", "10deg 0.3m", "0.6deg 0.05m", joint=True),
)
