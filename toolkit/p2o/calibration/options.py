"""Options of Algorithm 1 itself, `--set pipeline.FIELD=VALUE`."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import PositiveFloat, field_validator

from p2o.options import Options
from p2o.options import field as option


class PipelineOptions(Options):
    """Options of Algorithm 1 itself."""

    rounds: int = option(10, ge=1, le=100, help="Largest number of match-and-solve rounds (paper: n_opt = 10).")
    reach_px: float = option(50.0, gt=1, le=500, help="First cutting distance d_c from the given start (paper: 50).")
    shrink: float = option(0.7, gt=0.1, lt=1, help="Factor on the cutting distance from round to round.")
    min_reach_px: float = option(5.0, gt=0.5, le=100, help="Smallest cutting distance.")
    min_matches: int = option(30, ge=6, help="Fewer point-to-line pairs end a calibration as too-few-matches.")
    judge_px: float = option(5.0, gt=1, le=100, help="Truncation of the directed distance that poses are judged by.")
    interval_deg: float = option(
        0.6,
        ge=0,
        le=90,
        help="Rings at least this far apart, in degrees: edges are intervals between two beams, and the pose of the "
        "highest interval likelihood is searched for; 0: for every sweep, 90: never.",
    )
    most_deg: float = option(0.8, gt=0, help="A larger 95 % rotation bound, in degrees, marks a result as doubtful.")
    most_m: float = option(0.3, gt=0, help="A larger 95 % translation bound, in metres, marks a result as doubtful.")
    start_sigma: tuple[PositiveFloat, PositiveFloat] | None = option(
        None,
        help="Standard deviation of the initial guess per axis, deg and m: then a prior of the result. null: unknown.",
    )
    camera: Literal["trust", "check", "refine"] = option(
        "check",
        help="The intrinsics of the camera: trust them; check focal length, radial distortion and principal point "
        "against the edges, and doubt the result if they are wrong; or refine: correct them along with the pose.",
    )
    motion: Literal["trust", "estimate"] = option(
        "estimate",
        help="Raw sweeps, whose points have times: trust them, as of a car that stands; or estimate how the "
        "car moves during each of them, along with the pose. Sweeps that were corrected for motion stay as they are.",
    )
    time: Literal["trust", "estimate"] = option(
        "estimate",
        help="Whether images were taken when the data say: trust it; or estimate one offset to the sweeps along with "
        "the pose, from four or more frames whose velocities are known and differ.",
    )
    forward: tuple[float, float, float] = option(
        (1.0, 0.0, 0.0), help="Direction of travel in the LiDAR frame, for `motion`; its z axis is up."
    )
    speed_m_s: float = option(8.0, ge=-60, le=60, help="Forward speed of the car that `motion` begins from.")
    speed_sigma_m_s: float = option(8.0, gt=0, le=60, help="Standard deviation of the true speed from it.")
    turn_sigma_deg_s: float = option(6.0, gt=0, le=90, help="Standard deviation of the car's turning rate from zero.")
    tolerance_deg: float = option(1e-3, ge=0, help="A smaller turn (and shift) in the last round means converged.")
    tolerance_m: float = option(1e-3, ge=0, help="A smaller shift (and turn) in the last round means converged.")

    @field_validator("forward")
    @classmethod
    def _somewhere(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not (np.isfinite(value).all() and any(value)):
            raise ValueError("a direction of three finite numbers, not all zero")
        return value
