"""Consistency of the structure that both sensors see: `--calibrator csc --joint`. No start is needed.

After Ou, Cai, Wang, Targetless Lidar-camera Calibration via Cross-modality Structure Consistency, IEEE Transactions on
Intelligent Vehicles 2023.

1. LiDAR: poses by aligning sweeps (`moments`), and all sweeps in one world as small planes (`surface_map`).
2. Camera: a sparse map up to scale, from corners and a bundle adjustment (`visual_map`).
3. Hand-eye calibration in closed form from the steps of both (`hand_eye_equations`), the translation drawn to zero.
4. A global search over extrinsic and scale in a box around it: landmarks should lie on planes (`structure`).
5. One least squares of landmarks and steps, with a scale at each moment, tells the covariance and the delay as well.

Departures, as far as its README and settings tell (the paper's text was not at hand): their maps are ORB-SLAM's and
F-LOAM's with loops closed; their cost has points of the sweep at keypoints, reprojected into other pictures, besides
landmarks on planes (here steps of both sensors take that place, as `hand-eye` has the former); their search is NOMAD,
5000 evaluations in +-0.1 rad, +-0.3 m, with hand-eye as a constraint, and its result is the end. Here it is
differential evolution, wider about axes that the motion leaves open, and then least squares. Weights, damping, the
scale at each moment, covariances and refusals are ours.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import p2o
from p2o import Result, Status
from p2o.arrays import Float

from p2o_baselines.hand_eye_equations import HandEye, Steps, first_guess, lengths
from p2o_baselines.moments import Moment, Run, accuracy, consecutive, lidar_poses, moment_of, moves
from p2o_baselines.structure import Consistency, Stretch, searched, solved
from p2o_baselines.surface_map import surface_map
from p2o_baselines.visual_map import VisualMap, corner_tracks, visual_map

_TURN_RAD, _WAY = np.radians(0.03), 0.01
"""Deviations of steps of a visual map: turns, and directions of motion (rad)."""
_LIDAR_RAD, _LIDAR_M = np.radians(0.01), 0.003
_SPAN = 4
"""Steps over so many moments count besides those to the next."""
_SCALE = 0.2
"""The search changes the scale of hand-eye by at most this logarithm."""
_CONTRADICT_DEG, _CONTRADICT = 0.5, 0.25
"""Steps that differ by more, of their length, are not of one rig."""


class CscOptions(p2o.Options):
    """Options of `csc`."""

    lidar: Literal["gicp", "kiss-icp", "given"] = p2o.field(
        "gicp", help="Motion of the LiDAR: by small_gicp, by KISS-ICP, or the poses that the frames hold."
    )
    gap_s: float = p2o.field(0.6, gt=0, le=60, help="Frames farther apart in time are not consecutive.")
    window: int = p2o.field(60, ge=6, le=10_000, help="Longer stretches are cut: each has its own maps and scales.")
    least_steps: int = p2o.field(4, ge=2, le=1000, help="Fewer steps from frame to frame are too few.")
    least_landmarks: int = p2o.field(60, ge=10, le=100_000, help="Fewer landmarks next to planes are too few.")
    corners: int = p2o.field(1500, ge=50, le=100_000, help="Corners of a picture that are followed, at most.")
    cube_m: float = p2o.field(0.5, gt=0.05, le=5, help="Size of the cubes in which the sweeps' points make a plane.")
    reach_deg: float = p2o.field(6.0, gt=0, le=180, help="The search turns the extrinsic of the motion by this much.")
    reach_m: float = p2o.field(0.5, gt=0, le=10, help="And moves the camera by this much along each axis.")
    search: int = p2o.field(30, ge=0, le=10_000, help="Generations of the search; 0 leaves it out.")
    seed: int = p2o.field(0, ge=0, help="Seed of the search.")
    open_deg: float = p2o.field(2.0, gt=0, le=90, help="A rotation known no better than this is open.")
    open_m: float = p2o.field(0.25, gt=0, le=10, help="A place known no better than this along a direction is open.")


@dataclass(frozen=True)
class CscCalibration:
    """The whole method."""

    options: CscOptions

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return what is needed of a frame. Raises InputError where it is of no drive, or lacks a pose asked for."""
        if self.options.lidar == "given" and frame.lidar_world_from_lidar is None:
            raise p2o.InputError(
                "the frame holds no pose of the LiDAR", where=frame.name, hint="leave out calibrator.lidar=given"
            )
        return moment_of(frame)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> Result:
        """Return the extrinsic at which the structure of both sensors agrees; the start does not matter."""
        began = time.perf_counter()
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        names = tuple(moment.name for moment in prepared)
        counts: dict[str, int] = {}

        def refused(status: Status, reason: str) -> Result:
            seconds = {"structure": time.perf_counter() - began}
            return Result(names, start, start, status, reason, matches=counts, seconds=seconds)

        groups = [part for group in consecutive(prepared, options.gap_s) for part in windows(group, options.window)]
        counts["steps"] = sum(len(group) - 1 for group in groups)
        if counts["steps"] < options.least_steps:
            return refused(
                Status.TOO_FEW_MATCHES,
                f"{counts['steps']} steps between consecutive frames, of {len(names)} frames; {options.least_steps} "
                f"are needed: frames of one drive, at most {options.gap_s:g} s apart, calibrated jointly",
            )
        try:
            runs = [Run(tuple(group), lidar_poses(group, options.lidar)) for group in groups]
        except p2o.InputError as error:
            return refused(Status.TOO_FEW_MATCHES, f"the sweeps make no map: {error}")
        if not any(moves(run, _SPAN) for run in runs):
            return refused(Status.NOT_OBSERVABLE, "the LiDAR stands still: structure comes from motion")
        maps = [visual_map_of(run, options.corners) for run in runs]
        known = [(run, each) for run, each in zip(runs, maps, strict=True) if each is not None]
        counts["landmarks"] = sum(len(each) for _, each in known)
        if not known:
            return refused(
                Status.TOO_FEW_MATCHES,
                "the pictures make no map: too few corners can be followed, or they do not follow one another",
            )
        first, information = first_guess(steps_of(known))
        stretches, log_scales = [], []
        for run, each in known:
            log_scale = _log_scale(run, each, first)
            stretch = stretch_of(run, each, float(np.exp(log_scale)), options.cube_m)
            if stretch is not None:
                stretches.append(stretch)
                log_scales.append(log_scale)
        if sum(map(len, stretches)) < options.least_landmarks:
            return refused(Status.TOO_FEW_MATCHES, "the sweeps have no planes, or the pictures nothing that is near")
        pose, more = first, 0.0
        if options.search:
            axes, half = box(information, options)
            pose, more = searched(stretches, first, log_scales, axes, half, seed=options.seed, rounds=options.search)
        found = solved(stretches, pose, [scale + more for scale in log_scales])
        if found is None or found.landmarks < options.least_landmarks:
            return refused(
                Status.TOO_FEW_MATCHES,
                f"{0 if found is None else found.landmarks} landmarks of {counts['landmarks']} lie next to a plane of "
                f"the LiDAR's map; {options.least_landmarks} are needed",
            )
        counts["on planes"] = found.landmarks
        way_m, turn_deg = _way(runs)
        if found.off_deg > _CONTRADICT_DEG or found.off_step_m > _CONTRADICT * way_m / counts["steps"]:
            return refused(
                Status.NOT_OBSERVABLE,
                f"pictures and sweeps move differently, by {found.off_deg:.1f} deg and {100 * found.off_step_m:.0f} cm "
                "a step: is each picture of the time of its sweep?",
            )
        openings = _as_hand_eye(found).open_directions(over_deg=options.open_deg, over_m=options.open_m)
        said = (
            f"{found.landmarks} landmarks lie {100 * found.off_m:.0f} cm off planes in the median, over {way_m:.1f} m "
            f"and {turn_deg:.0f} deg of turns; steps agree to {found.off_deg:.3f} deg and "
            f"{100 * found.off_step_m:.1f} cm"
        )
        if openings:
            return refused(
                Status.NOT_OBSERVABLE, f"structure does not tell {', and '.join(map(str, openings))}; {said}"
            )
        cameras = {moment.camera for moment in prepared}
        return Result(
            names,
            start,
            found.camera_from_lidar,
            Status.CONVERGED if found.settled else Status.ROUNDS_SPENT,
            said,
            covariance=found.covariance,
            accuracy=accuracy(found.covariance),
            matches=counts,
            residual_px={"map": float(np.mean([each.off_px for _, each in known]))},
            time=p2o.TimeOffset(found.delay_s, found.delay_sigma_s, used=False) if found.delay_sigma_s < 0.05 else None,
            intrinsics=cameras.pop() if len(cameras) == 1 else None,
            seconds={"structure": time.perf_counter() - began},
        )


def windows(moments: Sequence[Moment], most: int) -> list[list[Moment]]:
    """Return a stretch cut into equal parts of at most `most` moments; each begins with the last of the one before."""
    parts = max(int(np.ceil((len(moments) - 1) / (most - 1))), 1)
    ends = np.rint(np.linspace(0, len(moments) - 1, parts + 1)).astype(int)
    return [list(moments[begin : end + 1]) for begin, end in pairwise(ends.tolist())]


def visual_map_of(run: Run, most: int) -> VisualMap | None:
    """Return the visual map of a run, with at most so many corners a picture."""
    camera = run.moments[0].camera
    greys, masked = [m.grey for m in run.moments], [m.masked for m in run.moments]
    return visual_map(corner_tracks(greys, camera, masked, most=most), camera.focal_px)


def spans(count: int) -> list[tuple[int, int]]:
    """Return the steps between so many moments: to the next one, and over several."""
    return [
        (first, second) for first in range(count - 1) for second in sorted({first + 1, min(first + _SPAN, count - 1)})
    ]


def steps_of(known: Sequence[tuple[Run, VisualMap]]) -> Steps:
    """Return the steps of both sensors between key moments, the camera's up to scale."""
    rows = []
    for run, each in known:
        poses = each.camera_from_world
        for first, second in spans(len(poses)):
            camera = poses[second] @ p2o.se3.inverse(poses[first])
            camera[:3, 3] /= max(float(np.linalg.norm(camera[:3, 3])), 1e-12)
            lidar = run.lidar_step(int(each.pictures[first]), int(each.pictures[second]))
            rows.append((camera, lidar, np.sqrt(second - first)))
    longer = np.array([row[2] for row in rows])
    covariance = np.diag(np.repeat([_TURN_RAD**2, _WAY**2], 3))
    return Steps(
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        np.zeros(len(rows), bool),
        np.repeat(covariance[None], len(rows), axis=0),
        _LIDAR_RAD * longer,
        _LIDAR_M * longer,
    )


def stretch_of(run: Run, each: VisualMap, scale: float, cube_m: float) -> Stretch | None:
    """Return both maps of a run, without landmarks that are far or vague at a scale; None where no plane is."""
    surfaces = surface_map([moment.xyz for moment in run.moments], run.world_from_lidar, cube_m=cube_m)
    if surfaces is None:
        return None
    xyz, covariance = each.in_camera()
    poses = each.camera_from_world
    times_s = np.array([run.moments[number].time_s for number in each.pictures])
    lidar = run.world_from_lidar[each.pictures]
    steps = p2o.se3.inverse(lidar[:-1]) @ lidar[1:]
    rates = np.array([p2o.se3.log(step) for step in steps]) / np.diff(times_s)[:, None]
    velocity = 0.5 * (np.concatenate([rates[:1], rates]) + np.concatenate([rates, rates[-1:]]))
    return Stretch(
        xyz,
        covariance,
        each.landmark,
        each.moment,
        np.asarray(poses[1:] @ p2o.se3.inverse(poses[:-1])),
        lidar,
        velocity,
        surfaces,
    ).nearer(scale)


def box(information: Float, options: CscOptions) -> tuple[Float, Float]:
    """Return the axes (3, 3, rows) about which the search turns, and how far it goes (7,): three deviations at least.

    `information` (3, 3) is that of the first guess's rotation.
    """
    values, axes = np.linalg.eigh(information)
    turn = 3.0 / np.sqrt(np.maximum(values, 1e-3))
    turn = np.clip(turn, np.radians(options.reach_deg), np.pi)
    return np.asarray(axes.T), np.concatenate([turn, np.full(3, options.reach_m), [_SCALE]])


def _log_scale(run: Run, each: VisualMap, camera_from_lidar: Float) -> float:
    """Return the logarithm of how many metres a unit of the visual map is, by the LiDAR's steps at an extrinsic."""
    steps = steps_of([(run, each)])
    poses = each.camera_from_world
    own = [
        np.linalg.norm((poses[second] @ p2o.se3.inverse(poses[first]))[:3, 3]) for first, second in spans(len(poses))
    ]
    ratio = lengths(camera_from_lidar, steps) / np.maximum(own, 1e-12)
    return float(np.log(max(float(np.median(ratio)), 1e-6)))


def _way(runs: Sequence[Run]) -> tuple[float, float]:
    """Return how far the LiDAR goes, m, and how much it turns, deg."""
    steps = [run.lidar_step(first, later[0]) for run in runs for first, later in run.spans(1)]
    return sum(map(p2o.se3.distance_m, steps)), sum(map(p2o.se3.angle_deg, steps))


def _as_hand_eye(found: Consistency) -> HandEye:
    none = np.zeros(0)
    return HandEye(found.camera_from_lidar, found.covariance, none, none, found.off_deg, found.off_step_m)


def build(options: CscOptions) -> p2o.Calibrator:
    """Return the calibrator. Raises ModuleNotFoundError where the odometry that is asked is not installed."""
    # A missing package is told before any frame is read.
    if options.lidar == "gicp":
        import small_gicp  # noqa: F401
    if options.lidar == "kiss-icp":
        import kiss_icp  # noqa: F401
    return CscCalibration(options)


METHOD = p2o.Method(
    name="csc",
    build=build,
    options=CscOptions,
    summary="Extrinsic at which a sparse map from pictures lies on the surfaces of the LiDAR's map, without a start.",
    needs={"sequence", "frame-time"},
    cite="Ou, Cai, Wang, Targetless Lidar-camera Calibration via Cross-modality Structure Consistency, IEEE TIV 2023",
    extra="gicp",
    example=p2o.Example(
        "synthetic:?place=street&frames_per_scene=5&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
        "&seed=1",
        perturb="10deg 0.5m",
        joint=True,
    ),
)
