"""Results: of one round, of one solver call, of one calibration, of the cameras of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np
from pydantic import Field

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.results.evidence import Accuracy, Agreement, Judged, Rival, StartWeight
from p2o.results.json_types import Count, Covariance, Derived, Flag, Number, Pose, Tree
from p2o.results.verdict import Doubt, Reason, Verdict

_NO_STEP_DEG, _NO_STEP_M = 1e-3, 1e-4
"""Changes of a pose that no data resolve."""
DIRECTED, INTERVALS = "directed-distance", "interval-likelihood"
"""Name of the judge of methods that match directed edges."""


class Status(StrEnum):
    """How a calibration ended; only CONVERGED and ROUNDS_SPENT have a new pose, all others return the initial guess."""

    CONVERGED = "converged"
    ROUNDS_SPENT = "rounds-spent"
    NO_IMPROVEMENT = "no-improvement"
    TOO_FEW_MATCHES = "too-few-matches"
    NOT_OBSERVABLE = "not-observable"
    NO_EDGES = "no-edges"
    NO_FEATURES = "no-features"
    STAGE_FAILED = "stage-failed"

    @property
    def solved(self) -> bool:
        """True where the returned pose is an estimate and not the initial guess."""
        return self in (Status.CONVERGED, Status.ROUNDS_SPENT)


class SolverStatus(StrEnum):
    """How a call of a solver ended.

    NOT_MOVED means that no pose of lower cost was found near the start, SINGULAR that the problem does not determine
    the pose.
    """

    CONVERGED = "converged"
    NOT_MOVED = "not-moved"
    ITERATIONS_SPENT = "iterations-spent"
    SINGULAR = "singular"

    @classmethod
    def of(cls, start: Float, pose: Float, *, converged: bool) -> SolverStatus:
        """Return how a solver ended that began at `start` (4, 4); less than 0.001 deg and 0.1 mm is no motion."""
        if not converged:
            return cls.ITERATIONS_SPENT
        step = pose @ se3.inverse(start)
        still = se3.angle_deg(step) < _NO_STEP_DEG and se3.distance_m(step) < _NO_STEP_M
        return cls.NOT_MOVED if still else cls.CONVERGED


@dataclass(frozen=True, eq=False)
class Solution:
    """The output of a solver: the pose (4, 4), its cost, the number of iterations and the status.

    `covariance` (6, 6) of a left update in the camera frame (rad, m), scaled by the residuals, or None where the
    solver has none or the system is singular. `status` may be given as its word; raises InputError for any other.
    """

    camera_from_lidar: Float
    cost: float
    iterations: int
    status: SolverStatus = SolverStatus.CONVERGED
    covariance: Float | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "status", SolverStatus(self.status))
        except ValueError as problem:
            text = "the status of the solution is unknown"
            raise InputError(text, expected=" or ".join(SolverStatus), got=repr(self.status)) from problem


@dataclass(frozen=True)
class Round:
    """One round of Algorithm 1.

    `cost` is that of the method's judge (`Result.judged` states its unit); for directed edges the directed distance in
    pixels. `mean_residual` is in pixels for pairs, NaN where the problem has no residuals.
    """

    stage: str
    reach_px: Number
    matches: Mapping[str, Count]
    mean_residual: Number
    cost: Number
    step_deg: Number
    step_m: Number
    accepted: Flag


@dataclass(frozen=True)
class CameraCheck:
    """The error of the intrinsics of one camera, estimated from the edges of `frames` of its frames.

    `camera` is the given camera, `better` the one with the error removed. `focal`, `radial`, `x_px` and `y_px` are the
    error (`RadialError`), with standard deviations; `shift_px` is the largest displacement in the image that it causes,
    with its standard deviation; `corrected` is True where the pose is the one for the better camera. `evidence` is by
    how many standard deviations the edges fit better with it; `wrong` names the parameters that are in doubt.
    """

    frames: Count
    camera: Camera
    better: Camera
    focal: Number
    focal_sigma: Number
    radial: Number
    radial_sigma: Number
    shift_px: Number
    shift_sigma_px: Number
    corrected: Flag
    x_px: Number = 0.0
    x_sigma_px: Number = 0.0
    y_px: Number = 0.0
    y_sigma_px: Number = 0.0
    evidence: Number = 0.0
    wrong: tuple[str, ...] = ()


@dataclass(frozen=True)
class SweepMotion:
    """The motion of the LiDAR during the sweep of one frame, estimated from edges.

    `speed_m_s` is forward and `turn_deg_s` to the left, with standard deviations; `twist` (6,) is the same as a
    velocity in rad/s and m/s in the LiDAR frame, for which the edges were compensated (`Cloud.untwisted`).
    """

    frame: str
    speed_m_s: Number
    speed_sigma: Number
    turn_deg_s: Number
    turn_sigma: Number
    twist: Annotated[tuple[Number, ...], Field(min_length=6, max_length=6)]


@dataclass(frozen=True)
class TimeOffset:
    """The time offset between images and sweeps, estimated from edges: positive where images are later than stamped.

    `offset_s` with its standard deviation, one for all frames. `used` is True where the pose is the one for this
    offset: a point at `xyz` at the stamped time is observed from a LiDAR that has moved on by `twist * offset_s`.
    """

    offset_s: Number
    sigma_s: Number
    used: Flag


@dataclass(frozen=True, eq=False)
class Result:
    """The result of the calibration of one frame, or of the joint calibration of several frames.

    `camera_from_lidar` (4, 4) is the estimate, or the initial guess `start` where `status.solved` is False; `reason`
    explains the status in one sentence. `covariance` (6, 6) is that of a left update in the camera frame (rad, m):
    its deviations are the predicted error `accuracy` (67 %), in total and by axis (`p2o.geometry.pose_error`), or those
    of the scatter of pairs where no error is predicted. Both are None where they are unknown. `judged` holds the costs
    of initial guess and estimate, `agreement` that of the edges of both sensors, `rival` the next best pose; None where
    there is none. `verdict` is trusted, ambiguous, doubtful or refused, with reasons; a result that is not solved is
    refused. `intrinsics` is the camera of the pose: that of the frames, corrected where `cameras` contains a
    correction; None for frames of several cameras. `cameras` holds the estimated errors of the intrinsics, `motions`
    the estimated motion during raw sweeps, `time` the estimated time offset, `start_weight` the effect of the initial
    guess used as a prior. `seconds` are by stage. `recipe` holds every resolved option, `licences` the licences of the
    weights that were used, by stage. The figures of a result are described in `p2o.results.figures`.
    """

    frames: tuple[str, ...]
    start: Pose
    camera_from_lidar: Pose
    status: Status
    reason: str
    rounds: tuple[Round, ...] = ()
    covariance: Covariance | None = None
    accuracy: Accuracy | None = None
    matches: Mapping[str, Count] = field(default_factory=dict)
    residual_px: Mapping[str, Number] = field(default_factory=dict)
    judged: Judged | None = None
    agreement: Annotated[Agreement, Derived(("odds_ratio", "strength"))] | None = None
    rival: Rival | None = None
    verdict: Annotated[Verdict, Derived(("trust",))] = None  # type: ignore[assignment]  # filled in below
    intrinsics: Camera | None = None
    cameras: tuple[CameraCheck, ...] = ()
    motions: tuple[SweepMotion, ...] = ()
    time: TimeOffset | None = None
    start_weight: StartWeight | None = None
    seconds: Mapping[str, Number] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    recipe: Tree = field(default_factory=dict)
    seed: Count | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    licences: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict is None:
            refusal = Reason(Doubt.NOT_SOLVED, self.reason)
            object.__setattr__(self, "verdict", Verdict() if self.status.solved else Verdict((refusal,)))

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the result is trusted and its predicted errors (67 %) are at most these."""
        good = self.accuracy is not None and self.accuracy.reaches(rotation_deg, translation_m)
        return good and self.verdict.trusted

    @property
    def directed_cost_px(self) -> tuple[float, float] | None:
        """The directed edge distance in pixels at the initial guess and at the estimate; None for other judges."""
        judged = self.judged
        return None if judged is None or judged.judge != DIRECTED else (judged.start, judged.estimate)

    def camera_of(self, camera: Camera) -> Camera:
        """Return the camera of the estimate, given that of a frame: the corrected one where it was corrected."""
        return next((c.better for c in self.cameras if c.corrected and c.camera == camera), camera)

    def twist_of(self, frame: str) -> Float | None:
        """Return the velocity (6,) for which the edges of a frame were compensated, None where they were not."""
        return next((np.array(motion.twist) for motion in self.motions if motion.frame == frame), None)

    @property
    def later_s(self) -> float:
        """The time offset of the images in s that the estimate accounts for, 0 where there is none."""
        return self.time.offset_s if self.time is not None and self.time.used else 0.0


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig compared with the common result.

    `camera_from_lidar` (4, 4) follows from the common result, if any. `rotation_deg` and `translation_m` are the
    distance of the camera's own result from the common result (if that is a mean: from the mean of the other cameras),
    `chi_square` (six degrees of freedom) is it relative to the covariances; None without an own pose. `left_out` is the
    reason for exclusion, or "".
    """

    name: str
    camera_from_lidar: Pose | None = None
    rotation_deg: Number | None = None
    translation_m: Number | None = None
    chi_square: Number | None = None
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class RigResult:
    """The common result of the cameras of a rig with known, fixed poses on a body.

    `body_from_lidar` (4, 4) is None where fewer than two cameras are used; `reason` explains. `covariance` (6, 6) is
    that of a left update in the body frame (rad, m), `accuracy` the predicted error; both are inflated where cameras
    differ more than predicted. `chi_square`, with `degrees` degrees of freedom, is the disagreement of the cameras
    relative to their predicted errors (of a common calibration: of those that are trusted alone), `p_value` its
    p-value. `verdict` is that on the common result.
    """

    body_from_lidar: Pose | None
    reason: str
    verdict: Annotated[Verdict, Derived(("trust",))]
    cameras: tuple[RigCamera, ...]
    covariance: Covariance | None = None
    accuracy: Accuracy | None = None
    chi_square: Number | None = None
    degrees: Count = 0
    p_value: Number | None = None

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the result is trusted and its predicted errors (67 %) are at most these."""
        good = self.accuracy is not None and self.accuracy.reaches(rotation_deg, translation_m)
        return good and self.verdict.trusted
