"""Initial guess from matched image features, `--init matches` and `--calibrator matches`; no initial guess is needed.

After the initial guess of Koide, Oishi, Yokozuka, Banno, General, Single-shot, Target-less, and Automatic LiDAR-Camera
Extrinsic Calibration Toolbox, ICRA 2023.

1. Virtual views of the sweep show its reflectances (`reflectance_view`).
2. Keypoints of the camera image and of the views are matched by networks (`feature_networks`), with the image upright
   and, if too few matches agree, upside down and on its sides.
3. The rotations on which most matches agree determine further views, which look as the camera does and are matched.
4. The pose comes from all matches by RANSAC and least squares (`matched_pose`); matches of several frames are pooled.

Departures: ALIKED, DISK or XFeat with LightGlue instead of SuperPoint and SuperGlue, whose licences exclude commercial
use; overlapping pinhole views instead of one equirectangular image for LiDARs with a wide field of view; both images
are also equalised locally; the second views; perspective-n-point after the rotation, which the paper follows by least
squares alone. The predicted error is left to the independent check.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import p2o
from p2o import Float, Int, Result, Status, field

from p2o_baselines import examples
from p2o_baselines.information.histogram import by_rank
from p2o_baselines.information.reflectance import ranked_by_ring
from p2o_baselines.information.reflectance_view import (
    FlatImage,
    Rendering,
    VirtualView,
    facing,
    flattened,
    rendered,
    views_of,
)
from p2o_baselines.learned.device import device_of
from p2o_baselines.learned.feature_networks import FEATURES, KeypointMatcher, Keypoints, files_of, read_networks
from p2o_baselines.learned.matched_pose import MatchedPose, Matches, pose_of, rotations_of
from p2o_baselines.start_by_calibrator import StartByCalibrator

_SURE = 2.0
"""The upright image is enough if this many times the required places agree."""
_CELL_PX = 4.0
"""Size of the places of an image that are counted."""
_FOCAL_PX = 600.0  # focal length of virtual views, to which images are resampled
_MIN_RANGE_M = 1.5  # drop points nearer than this, on the vehicle itself
_KEYPOINTS = 1024  # largest number of keypoints in an image
_LEAST = 20  # refuse a pose on which fewer places of the images agree


class MatchesOptions(p2o.Options):
    """Options of `matches`."""

    features: Literal["aliked", "aliked-rotated", "disk", "xfeat"] = field(
        "aliked", help="Keypoints and their network."
    )
    coarse: float = field(
        0.67, ge=0.1, le=1, help="Focal length of the views around the LiDAR, in those of the views after them."
    )
    upright: bool = field(False, help="Match the image upright only, not also upside down and on its sides.")
    offset_m: float = field(1.0, gt=0, le=10, help="Largest distance of the camera from the LiDAR.")
    reach_px: float = field(6.0, gt=0, le=100, help="Largest residual of a match, in pixels of the virtual views.")
    device: str = field("auto", pattern="^(auto|cpu|cuda(:[0-9]+)?)$", help="auto uses a GPU if there is one.")
    seed: int = field(0, ge=0, help="Seed of the samples of RANSAC.")


@dataclass(frozen=True, eq=False)
class FrameMatches:
    """Matches of one frame: rays, points and places as in `Matches`, and orientations `quarter` (N,) of the image."""

    name: str
    rays: Float
    xyz: Float
    cell: Int
    quarter: Int


@dataclass(frozen=True, eq=False)
class Sweep:
    """Points (N, 3) of a sweep with the ranks (N,) of their reflectances."""

    xyz: Float
    rank: Float

    def seen(self, view: VirtualView) -> Rendering:
        """Return the image of the sweep in a virtual view."""
        return rendered(view, self.xyz, self.rank)


def reflectances(frame: p2o.Frame) -> Sweep:
    """Return the points of a frame, motion-compensated if possible, with ranks within rings where these are known.

    Raises InputError without intensities.
    """
    cloud = frame.cloud if frame.twist is None else frame.cloud.untwisted(frame.twist)
    if cloud.intensity is None:
        raise p2o.InputError("the sweep has no intensity, and matches needs it", where=frame.name)
    far = np.flatnonzero(np.linalg.norm(cloud.xyz, axis=1) >= _MIN_RANGE_M)
    xyz, intensity = np.asarray(cloud.xyz[far]), np.asarray(cloud.intensity[far])
    if cloud.ring is not None:
        return Sweep(xyz, ranked_by_ring(intensity, cloud.ring[far]))
    return Sweep(xyz, by_rank(intensity))


@dataclass(frozen=True)
class MatchesCalibration:
    """The calibrator: `prepare` matches features of a frame, `solve` estimates the pose from those of all frames."""

    options: MatchesOptions
    networks: KeypointMatcher

    def prepare(self, frame: p2o.Frame) -> FrameMatches:
        """Return the matches of a frame. Raises InputError for a sweep without intensities."""
        options, sweep = self.options, reflectances(frame)
        image, coarse = flattened(frame.image, _FOCAL_PX), flattened(frame.image, options.coarse * _FOCAL_PX)
        parts: list[FrameMatches] = []
        if image is None or coarse is None or not len(sweep.xyz):
            return joined(frame.name, parts)
        around = [sweep.seen(view) for view in views_of(sweep.xyz, coarse.focal_px, coarse.width_deg)]
        seen = [(each, self.networks.detect(each.grey)) for each in around]
        keypoints = self.networks.detect(image.grey)
        for quarter in (0,) if options.upright else (0, 2, 1, 3):
            turned = self.networks.detect(coarse.turned(quarter))
            first = [self._matched(frame.name, coarse, quarter, turned, *each, quarter) for each in seen]
            parts += first
            matches = pooled(first, quarter)
            for turn in rotations_of(matches, options.reach_px / _FOCAL_PX, options.offset_m, options.seed):
                view = sweep.seen(facing(turn, image))
                parts.append(
                    self._matched(frame.name, image, 0, keypoints, view, self.networks.detect(view.grey), quarter)
                )
            pose = self.pose(parts)
            if pose is not None and pose.agree >= _SURE * _LEAST:
                break
        return joined(frame.name, parts)

    def _matched(
        self,
        name: str,
        image: FlatImage,
        turned: int,
        keypoints: Keypoints,
        rendering: Rendering,
        others: Keypoints,
        quarter: int,
    ) -> FrameMatches:
        """Return the matches of keypoints of an image that is turned by quarters with those of a virtual view."""
        uv, view_uv = self.networks.match(keypoints, others)
        xyz = rendering.lift(view_uv)
        known = np.isfinite(xyz).all(axis=1)
        rays = image.rays(image.turned_back(uv[known], turned))
        plane = rays[:, :2] / rays[:, 2:]
        column, row = np.floor(plane.T * (_FOCAL_PX / _CELL_PX)).astype(np.int64) + (1 << 16)
        return FrameMatches(name, rays, xyz[known], row * (1 << 20) + column, np.full(len(rays), quarter))

    def pose(self, parts: Sequence[FrameMatches]) -> MatchedPose | None:
        """Return the pose on which most places of the images agree, None if there is none.

        Images of one rig have one orientation: their matches are pooled by it.
        """
        options = self.options
        best: MatchedPose | None = None
        for quarter in range(4):
            matches = pooled(parts, quarter)
            pose = pose_of(matches, _FOCAL_PX, options.reach_px, options.offset_m, options.seed)
            if pose is not None and (best is None or pose.agree > best.agree):
                best = pose
        return best

    def solve(self, prepared: Sequence[FrameMatches], camera_from_lidar: Float) -> Result:
        """Return the pose of the matches of all frames, refused if few agree; the initial guess is not used."""
        began, start = time.perf_counter(), np.asarray(camera_from_lidar, np.float64)
        names = tuple(part.name for part in prepared)
        pose, count, least = self.pose(prepared), sum(len(part.rays) for part in prepared), _LEAST
        agree = 0 if pose is None else pose.agree
        result = Result(names, start, start, Status.TOO_FEW_MATCHES, "", matches={"features": count, "agree": agree})
        if pose is None or agree < least:
            reason = f"{agree} of {count} matches of features agree on a pose, and {least} are needed"
            result = replace(result, reason=reason)
        elif pose.reason:
            result = replace(result, status=Status.NOT_OBSERVABLE, reason=pose.reason)
        else:
            result = replace(
                result,
                camera_from_lidar=pose.camera_from_lidar,
                status=Status.CONVERGED,
                reason=f"{agree} of {count} matches of features agree to {pose.off_px:.1f} px",
            )
        return replace(result, seconds={"pose": time.perf_counter() - began})


def joined(name: str, parts: Sequence[FrameMatches]) -> FrameMatches:
    """Return the matches of one frame from its parts."""
    none = np.empty(0, np.int64)
    every = [FrameMatches(name, np.empty((0, 3)), np.empty((0, 3)), none, none), *parts]
    columns = (np.concatenate([getattr(part, key) for part in every]) for key in ("rays", "xyz", "cell", "quarter"))
    return FrameMatches(name, *columns)


def pooled(parts: Sequence[FrameMatches], quarter: int) -> Matches:
    """Return the matches of all parts in one orientation of the image; places of different frames are distinct."""
    names = {name: number for number, name in enumerate(dict.fromkeys(part.name for part in parts))}
    every = [replace(part, cell=part.cell + (names[part.name] << 40)) for part in parts]
    one = joined("", every)
    rows = one.quarter == quarter
    return Matches(one.rays[rows], one.xyz[rows], one.cell[rows])


def _networks(options: MatchesOptions) -> KeypointMatcher:
    """Return the networks of the options. Raises MethodUnavailable without weights, InputError without the GPU."""
    return read_networks(options.features, _KEYPOINTS, device_of(options.device))


def build(options: MatchesOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises MethodUnavailable if the weights are not installed."""
    return MatchesCalibration(options, _networks(options))


def build_start(options: MatchesOptions) -> p2o.Initializer:
    """Return the initializer. Raises MethodUnavailable if the weights are not installed."""
    return start_of(MatchesCalibration(options, _networks(options)))


def start_of(method: MatchesCalibration) -> StartByCalibrator:
    """Return the initializer of a calibrator."""
    hint = "denser sweeps (--accumulate, or a static LiDAR), --joint, or --init far"
    return StartByCalibrator(method, "matched features", hint)


METHOD = p2o.Method(
    name="matches",
    build=build,
    options=MatchesOptions,
    summary="Features matched between the image and views of the sweep's reflectances; needs no initial guess.",
    needs={"intensity"},
    cite="Koide, Oishi, Yokozuka, Banno, General, Single-shot, Target-less, and Automatic LiDAR-Camera Extrinsic "
    "Calibration Toolbox, ICRA 2023",
    extra="matches",
    example=p2o.Example(examples.DWELL, perturb="10deg 0.5m", within="1deg 0.3m"),
    data_files=lambda options: files_of(options.features),
    data_licence=lambda options: f"{FEATURES[options.features].wheel}: {FEATURES[options.features].licence}",
)
START = replace(
    METHOD,
    build=build_start,
    summary="Initialises by matched features of image and reflectances.",
    expected_failures=(("starts_without_edges_are_no_crash", "a view without matches has no pose, which is reported"),),
)
