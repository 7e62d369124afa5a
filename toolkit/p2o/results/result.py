"""What comes out: one round, one solver call, one calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.geometry.camera import Camera
from p2o.results.accuracy import Accuracy


class Status(StrEnum):
    """How a calibration ended; only CONVERGED and ROUNDS_SPENT carry a new pose, all others return the start."""

    CONVERGED = "converged"
    ROUNDS_SPENT = "rounds-spent"
    NO_IMPROVEMENT = "no-improvement"
    TOO_FEW_MATCHES = "too-few-matches"
    NOT_OBSERVABLE = "not-observable"
    NO_EDGES = "no-edges"
    STAGE_FAILED = "stage-failed"

    @property
    def solved(self) -> bool:
        """True where the returned pose is an estimate and not the start."""
        return self in (Status.CONVERGED, Status.ROUNDS_SPENT)


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver returns: the pose (4, 4), its cost, and how it got there.

    `covariance` (6, 6) of a left update in the camera frame (rad, m), scaled by the residuals, or None where the
    solver has none or the system is singular; `status` says "converged", "iterations-spent" or "singular".
    """

    camera_from_lidar: Float
    cost: float
    iterations: int
    status: str = "converged"
    covariance: Float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Round:
    """One turn of Algorithm 1, as the paper's convergence figure needs it."""

    stage: str
    reach_px: float
    matches: Mapping[str, int]
    mean_residual_px: float
    directed_cost_px: float
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


@dataclass(frozen=True, eq=False)
class Result:
    """One calibration, of one frame or of several jointly.

    `camera_from_lidar` (4, 4) is the estimate, or the start where `status.solved` is False; `reason` says why in one
    sentence. `covariance` (6, 6) is that of a left update in the camera frame (rad, m), neighbouring pairs taken as one
    measurement and motions and errors of cameras as unknown, or that of the solver where pairs are too few or none;
    `accuracy` says how wrong the pose is likely to be. Both are None where they cannot be told. `directed_cost_px` is
    the directed edge distance at the start and at the estimate; `agreement` holds the shares `near` and `chance`, and
    the `odds_ratio`, of `p2o.calibration.agreement`.
    `rival` is the next best pose that is another one: by how many `edges` fewer it is met, and how far away it is
    (`rotation_deg`, `translation_m`); empty where none was found. `cameras` says what the edges tell of each camera's
    calibration, `motions` how the car moved during sweeps as measured. `seconds` by stage. `recipe` holds every
    resolved option.
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
    directed_cost_px: tuple[float, float] | None = None
    agreement: Mapping[str, float] = field(default_factory=dict)
    rival: Mapping[str, float] = field(default_factory=dict)
    cameras: tuple[CameraCheck, ...] = ()
    motions: tuple[SweepMotion, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the result is likely to be this good, and neither doubtful nor ambiguous."""
        unsure = any(text.startswith(("doubtful", "ambiguous")) for text in self.warnings)
        return self.accuracy is not None and self.accuracy.reaches(rotation_deg, translation_m) and not unsure

    def camera_of(self, camera: Camera) -> Camera:
        """Return the camera that the estimate is for, given that of a frame: another one where it was corrected."""
        return next((c.better for c in self.cameras if c.corrected and c.camera == camera), camera)

    def twist_of(self, frame: str) -> Float | None:
        """Return the velocity (6,) that the edges of a frame were corrected for, or None where they were not."""
        return next((np.array(motion.twist) for motion in self.motions if motion.frame == frame), None)
