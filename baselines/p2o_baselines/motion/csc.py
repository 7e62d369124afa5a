"""Calibrate by consistency of the structure in both sensors: `--calibrator csc --joint`. No initial guess is needed.

After Ou, Cai, Wang, Targetless Lidar-camera Calibration via Cross-modality Structure Consistency, IEEE Transactions on
Intelligent Vehicles 2023.

1. LiDAR: poses by scan matching (`moments`), and all sweeps in one world as small planes (`surface_map`).
2. Camera: a sparse map up to scale, from corners and bundle adjustment (`visual_map`).
3. Closed-form hand-eye calibration from the steps of both sensors (`hand_eye_equations`), with a prior of zero
   translation.
4. A global search over extrinsic and scale in a box around it, with the distance of landmarks from planes as the cost
   (`structure`).
5. One least squares over landmarks and steps, with a scale at each time, which also gives the covariance and the delay.

Departures, as far as its README and settings show (the text of the paper was not at hand): the original uses the maps
of ORB-SLAM and F-LOAM with loop closures; its cost includes points of the sweep at keypoints, reprojected into other
images, in addition to landmarks on planes (here the steps of both sensors, as in `hand-eye`); its search is NOMAD, 5000
evaluations in +-0.1 rad, +-0.3 m, with hand-eye as a constraint, and has no refinement. Here the search is differential
evolution, wider about unobservable axes, followed by least squares. Weights, robust loss, the scale at each time,
covariances and refusals are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import p2o
from p2o import Float, Result, Status, field
from p2o.solving import TimeOffset

from p2o_baselines import examples
from p2o_baselines.motion import moments
from p2o_baselines.motion.hand_eye_equations import HandEye, Steps, first_guess, lengths
from p2o_baselines.motion.moments import Moment, MotionCalibration, MotionOptions, RefusedError, Run
from p2o_baselines.motion.structure import Consistency, Stretch, searched, solved, surface_map
from p2o_baselines.motion.visual_map import VisualMap, corner_tracks, visual_map
from p2o_baselines.outcome import decided

_TURN_RAD, _WAY = np.radians(0.03), 0.01  # deviations of steps of a visual map: turns, and directions of motion (rad)
_LIDAR_RAD, _LIDAR_M = np.radians(0.01), 0.003
_SPAN = 4  # steps over this many frames are used in addition to those to the next frame
_SCALE = 0.2  # the search changes the scale of hand-eye by at most this logarithm
_CONTRADICT_DEG, _CONTRADICT = 0.5, 0.25  # steps that differ by more, of their length, are not of one rig
_WINDOW = 60  # largest number of frames per stretch, with own maps and scales
_LEAST_LANDMARKS = 60  # least number of landmarks next to planes
_CORNERS = 1500  # largest number of corners tracked per image
_CUBE_M = 0.5  # size of the cubes in which planes are fitted to points
_LEAST_STEPS = 4  # least number of steps from frame to frame
_SEARCH = 30  # generations of the search


class CscOptions(MotionOptions):
    """Options of `csc`."""

    reach_deg: float = field(6.0, gt=0, le=180, help="Rotations searched around the extrinsic of the motion.")
    reach_m: float = field(0.5, gt=0, le=10, help="Translation range of the search along each axis.")
    seed: int = field(0, ge=0, help="Seed of the search.")


@dataclass(frozen=True)
class CscCalibration(MotionCalibration):
    """The calibrator."""

    options: CscOptions
    part: ClassVar[str] = "structure"

    def _solved(self, result: Result, prepared: Sequence[Moment], matches: dict[str, int]) -> Result:
        """Return the extrinsic that makes the structure of both sensors consistent; the initial one has no effect."""
        runs, known = self._maps(prepared, matches)
        consistency = self._solution(known, matches)
        delayed = consistency.delay_sigma_s < 0.05
        return decided(
            result,
            camera_from_lidar=consistency.camera_from_lidar,
            status=Status.CONVERGED if consistency.settled else Status.ROUNDS_SPENT,
            reason=self._checked(runs, consistency, matches["steps"]),
            covariance=consistency.covariance,
            accuracy=moments.accuracy(consistency.covariance),
            residual_px={"map": float(np.mean([each.off_px for _, each in known]))},
            time=TimeOffset(consistency.delay_s, consistency.delay_sigma_s, used=False) if delayed else None,
        )

    def _maps(
        self, prepared: Sequence[Moment], matches: dict[str, int]
    ) -> tuple[list[Run], list[tuple[Run, VisualMap]]]:
        """Return the stretches of the drives, and those of them that have a visual map."""
        options = self.options
        groups = moments.consecutive(prepared, options.gap_s)
        groups = [part for group in groups for part in windows(group, _WINDOW)]
        matches["steps"] = sum(len(group) - 1 for group in groups)
        runs = moments.runs_of(groups, len(prepared), options, least_steps=_LEAST_STEPS, span=_SPAN)
        maps = [visual_map_of(run, _CORNERS) for run in runs]
        known = [(run, each) for run, each in zip(runs, maps, strict=True) if each is not None]
        matches["landmarks"] = sum(len(each) for _, each in known)
        if not known:
            reason = "the images make no map: too few corners can be tracked, or the images are not consecutive"
            raise RefusedError(Status.TOO_FEW_MATCHES, reason)
        return runs, known

    def _solution(self, known: Sequence[tuple[Run, VisualMap]], matches: dict[str, int]) -> Consistency:
        """Return the extrinsic by hand-eye calibration, global search and least squares."""
        options = self.options
        first, information = first_guess(steps_of(known))
        stretches, log_scales = [], []
        for run, each in known:
            log_scale = _log_scale(run, each, first)
            stretch = stretch_of(run, each, float(np.exp(log_scale)), _CUBE_M)
            if stretch is not None:
                stretches.append(stretch)
                log_scales.append(log_scale)
        if sum(map(len, stretches)) < _LEAST_LANDMARKS:
            raise RefusedError(Status.TOO_FEW_MATCHES, "the sweeps have no planes, or the images no near landmarks")
        axes, half = box(information, options)
        pose, more = searched(stretches, first, log_scales, axes, half, seed=options.seed, rounds=_SEARCH)
        consistency = solved(stretches, pose, [scale + more for scale in log_scales])
        near = 0 if consistency is None else consistency.landmarks
        if consistency is None or near < _LEAST_LANDMARKS:
            few = f"{near} landmarks of {matches['landmarks']} lie next to a plane of the LiDAR's map"
            raise RefusedError(Status.TOO_FEW_MATCHES, f"{few}; {_LEAST_LANDMARKS} are needed")
        matches["on planes"] = consistency.landmarks
        return consistency

    def _checked(self, runs: Sequence[Run], consistency: Consistency, steps: int) -> str:
        """Return the reason of a result; raises RefusedError for contradictory or insufficient motion."""
        path_m, turn_deg = moments.path_of(runs)
        off_deg, off_step_m = consistency.off_deg, consistency.off_step_m
        if off_deg > _CONTRADICT_DEG or off_step_m > _CONTRADICT * path_m / steps:
            raise RefusedError(
                Status.NOT_OBSERVABLE,
                f"images and sweeps move differently, by {off_deg:.1f} deg and {100 * off_step_m:.0f} cm "
                "per step: check that each image and its sweep have the same time",
            )
        reason = (
            f"{consistency.landmarks} landmarks are {100 * consistency.off_m:.0f} cm from planes (median), over "
            f"{path_m:.1f} m and {turn_deg:.0f} deg of rotation; steps agree to {off_deg:.3f} deg and "
            f"{100 * off_step_m:.1f} cm"
        )
        hand_eye = HandEye(consistency.camera_from_lidar, consistency.covariance, np.zeros(0), off_deg, off_step_m)
        openings = hand_eye.open_directions(over_deg=moments.OPEN_DEG, over_m=moments.OPEN_M)
        if openings:
            directions = ", and ".join(map(str, openings))
            raise RefusedError(Status.NOT_OBSERVABLE, f"not observable from structure: {directions}; {reason}")
        return reason


def windows(drive: Sequence[Moment], most: int) -> list[list[Moment]]:
    """Return a stretch cut into equal parts of at most `most` moments; each begins with the last of the one before."""
    parts = max(int(np.ceil((len(drive) - 1) / (most - 1))), 1)
    ends = np.rint(np.linspace(0, len(drive) - 1, parts + 1)).astype(int)
    return [list(drive[begin : end + 1]) for begin, end in pairwise(ends.tolist())]


def visual_map_of(run: Run, most: int) -> VisualMap | None:
    """Return the visual map of a run with at most `most` corners per image."""
    camera = run.moments[0].camera
    greys, masked = [m.grey for m in run.moments], [m.masked for m in run.moments]
    return visual_map(corner_tracks(greys, camera, masked, most=most), camera.focal_px)


def spans(count: int) -> list[tuple[int, int]]:
    """Return the steps between `count` times: to the next one, and over several."""
    ends = ((first, sorted({first + 1, min(first + _SPAN, count - 1)})) for first in range(count - 1))
    return [(first, second) for first, later in ends for second in later]


def steps_of(known: Sequence[tuple[Run, VisualMap]]) -> Steps:
    """Return the steps of both sensors between key moments, the camera's up to scale."""
    rows = []
    for run, each in known:
        poses = each.camera_from_world
        for first, second in spans(len(poses)):
            camera = poses[second] @ p2o.se3.inverse(poses[first])
            camera[:3, 3] /= max(float(np.linalg.norm(camera[:3, 3])), 1e-12)
            lidar = run.lidar_step(int(each.key_frames[first]), int(each.key_frames[second]))
            rows.append((camera, lidar, np.sqrt(second - first)))
    camera, lidar, longer = (np.array(column) for column in zip(*rows, strict=True))
    covariance = np.repeat(np.diag(np.repeat([_TURN_RAD**2, _WAY**2], 3))[None], len(rows), axis=0)
    return Steps(camera, lidar, np.zeros(len(rows), bool), covariance, _LIDAR_RAD * longer, _LIDAR_M * longer)


def stretch_of(run: Run, each: VisualMap, scale: float, cube_m: float) -> Stretch | None:
    """Return both maps of a run, without landmarks that are far or uncertain at a scale; None without planes."""
    surfaces = surface_map([moment.xyz for moment in run.moments], run.world_from_lidar, cube_m=cube_m)
    if surfaces is None:
        return None
    xyz, covariance = each.in_camera()
    poses = each.camera_from_world
    times_s = np.array([run.moments[number].time_s for number in each.key_frames])
    lidar = run.world_from_lidar[each.key_frames]
    steps = p2o.se3.inverse(lidar[:-1]) @ lidar[1:]
    rates = np.array([p2o.se3.log(step) for step in steps]) / np.diff(times_s)[:, None]
    velocity = 0.5 * (np.concatenate([rates[:1], rates]) + np.concatenate([rates, rates[-1:]]))
    camera_step = np.asarray(poses[1:] @ p2o.se3.inverse(poses[:-1]))
    stretch = Stretch(xyz, covariance, each.landmark, each.moment, camera_step, lidar, velocity, surfaces)
    return stretch.nearer(scale)


def box(information: Float, options: CscOptions) -> tuple[Float, Float]:
    """Return rotation axes (3, 3) and range (7,) of the search, from the information of the initial rotation."""
    values, axes = np.linalg.eigh(information)
    turn = np.clip(3.0 / np.sqrt(np.maximum(values, 1e-3)), np.radians(options.reach_deg), np.pi)
    return np.asarray(axes.T), np.concatenate([turn, np.full(3, options.reach_m), [_SCALE]])


def _log_scale(run: Run, each: VisualMap, camera_from_lidar: Float) -> float:
    """Return the logarithm of how many metres a unit of the visual map is, by the LiDAR's steps at an extrinsic."""
    steps, poses = steps_of([(run, each)]), each.camera_from_world
    own = [np.linalg.norm((poses[k] @ p2o.se3.inverse(poses[j]))[:3, 3]) for j, k in spans(len(poses))]
    ratio = lengths(camera_from_lidar, steps) / np.maximum(own, 1e-12)
    return float(np.log(max(float(np.median(ratio)), 1e-6)))


def build(options: CscOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises ModuleNotFoundError if the package of the odometry is missing."""
    moments.require_odometry(options.lidar)
    return CscCalibration(options)


METHOD = p2o.Method(
    name="csc",
    build=build,
    options=CscOptions,
    summary="Aligns a sparse visual map with the surfaces of the LiDAR's map, without an initial guess.",
    needs={"sequence", "frame-time"},
    cite="Ou, Cai, Wang, Targetless Lidar-camera Calibration via Cross-modality Structure Consistency, IEEE TIV 2023",
    extra="gicp",
    example=p2o.Example(examples.DRIVE, perturb="10deg 0.5m", joint=True),
)
