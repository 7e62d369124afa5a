"""What comes out: one round, one solver call, one calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry.camera import Camera
from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Agreement, Judged, Rival, StartWeight
from p2o.results.verdict import Doubt, Reason, Verdict

DIRECTED = "directed-distance"
"""Name of the judge of methods that match directed edges."""


class Status(StrEnum):
    """How a calibration ended; only CONVERGED and ROUNDS_SPENT carry a new pose, all others return the start."""

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
        """True where the returned pose is an estimate and not the start."""
        return self in (Status.CONVERGED, Status.ROUNDS_SPENT)


class SolverStatus(StrEnum):
    """How a call of a solver ended; SINGULAR means that the problem does not determine the pose."""

    CONVERGED = "converged"
    ITERATIONS_SPENT = "iterations-spent"
    SINGULAR = "singular"


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver returns: the pose (4, 4), its cost, and how it got there.

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
            raise InputError(
                "the status of the solution is unknown", expected=" or ".join(SolverStatus), got=repr(self.status)
            ) from problem


@dataclass(frozen=True)
class Round:
    """One turn of Algorithm 1, as the paper's convergence figure needs it.

    `cost` is that of the method's judge (`Result.judged` says its unit); for directed edges the directed distance in
    pixels. `mean_residual` is in pixels for pairs, NaN where the problem has no residuals.
    """

    stage: str
    reach_px: float
    matches: Mapping[str, int]
    mean_residual: float
    cost: float
    step_deg: float
    step_m: float
    accepted: bool


@dataclass(frozen=True)
class CameraCheck:
    """What the edges of a calibration say about the calibration of one camera, that of `frames` of its frames.

    `camera` is the one that was given, `better` the one without its error. `focal` and `radial` are the error
    (`p2o.RadialError`), with their standard deviations; `shift_px` is how far, at most, things are seen from where the
    calibration puts them, with its standard deviation; `corrected` tells whether the pose is the one for the better
    camera.
    """

    frames: int
    camera: Camera
    better: Camera
    focal: float
    focal_sigma: float
    radial: float
    radial_sigma: float
    shift_px: float
    shift_sigma_px: float
    corrected: bool


@dataclass(frozen=True)
class SweepMotion:
    """How the car moved during the sweep of one frame, as the edges tell it where nothing else does.

    `speed_m_s` is forward and `turn_deg_s` to the left, with standard deviations; `twist` (6,) is the same as a
    velocity in rad/s and m/s in the LiDAR frame, which the edges were corrected for (`Cloud.untwisted`).
    """

    frame: str
    speed_m_s: float
    speed_sigma: float
    turn_deg_s: float
    turn_sigma: float
    twist: tuple[float, ...]


@dataclass(frozen=True)
class TimeOffset:
    """How much later than the data say the images of a calibration were taken, as the edges tell it.

    `offset_s` with its standard deviation, one for all frames; `used` tells whether the pose is the one for images that
    were: what lies at `xyz` at the time that the data say is seen from a LiDAR that has moved on by `twist * offset_s`.
    """

    offset_s: float
    sigma_s: float
    used: bool


@dataclass(frozen=True, eq=False)
class Result:
    """One calibration, of one frame or of several jointly.

    `camera_from_lidar` (4, 4) is the estimate, or the start where `status.solved` is False; `reason` says why in one
    sentence. `covariance` (6, 6) is that of a left update in the camera frame (rad, m), neighbouring pairs taken as one
    measurement and motions and errors of cameras as unknown, or that of the solver where pairs are too few or none;
    `accuracy` says how wrong the pose is likely to be. Both are None where they cannot be told. `judged` holds what the
    method's judge makes of the start and of the estimate, `agreement` how the edges of both sensors meet, `rival` the
    next best pose that is another one; None where there is none. `verdict` says whether all this may be trusted, and
    why not: a result that is not solved is refused. `intrinsics` is the camera that the pose is for: that of the
    frames, corrected where `cameras` says so; None where they are of several. `cameras` says what the edges tell of
    each camera's calibration, `motions` how the car moved during raw sweeps, `time` how much later than they say images
    of several frames were taken, None where that cannot be told; `start_weight` what the start was worth where it was
    weighed in. `seconds` by stage. `recipe` holds every resolved option.
    """

    frames: tuple[str, ...]
    start: Float
    camera_from_lidar: Float
    status: Status
    reason: str
    rounds: tuple[Round, ...] = ()
    covariance: Float | None = None
    accuracy: Accuracy | None = None
    matches: Mapping[str, int] = field(default_factory=dict)
    residual_px: Mapping[str, float] = field(default_factory=dict)
    judged: Judged | None = None
    agreement: Agreement | None = None
    rival: Rival | None = None
    verdict: Verdict = None  # type: ignore[assignment]  # filled in below
    intrinsics: Camera | None = None
    cameras: tuple[CameraCheck, ...] = ()
    motions: tuple[SweepMotion, ...] = ()
    time: TimeOffset | None = None
    start_weight: StartWeight | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict is None:
            refusal = Reason(Doubt.NOT_SOLVED, self.reason)
            object.__setattr__(self, "verdict", Verdict() if self.status.solved else Verdict((refusal,)))

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the result is likely to be this good, and trusted."""
        good = self.accuracy is not None and self.accuracy.reaches(rotation_deg, translation_m)
        return good and self.verdict.trusted

    @property
    def directed_cost_px(self) -> tuple[float, float] | None:
        """The directed edge distance in pixels at the start and at the estimate; None for other judges."""
        if self.judged is None or self.judged.judge != DIRECTED:
            return None
        return self.judged.start, self.judged.estimate

    def camera_of(self, camera: Camera) -> Camera:
        """Return the camera that the estimate is for, given that of a frame: another one where it was corrected."""
        return next((c.better for c in self.cameras if c.corrected and c.camera == camera), camera)

    def twist_of(self, frame: str) -> Float | None:
        """Return the velocity (6,) that the edges of a frame were corrected for, or None where they were not."""
        return next((np.array(motion.twist) for motion in self.motions if motion.frame == frame), None)

    @property
    def later_s(self) -> float:
        """How much later than the data say the images were taken, as far as the estimate is for that."""
        return self.time.offset_s if self.time is not None and self.time.used else 0.0
