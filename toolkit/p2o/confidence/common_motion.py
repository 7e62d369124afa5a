"""Fuse the motions that several cameras estimate from one sweep: a vehicle has one motion per sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from p2o.arrays import Float
from p2o.calibration.adjustment import sweep_motion
from p2o.geometry.motion import MotionPrior
from p2o.results.result import SweepMotion

_LEAST_P = 0.01
"""Motions contradict each other if the p-value of their chi-square is below this value."""
_LEAST_INFORMATION = 0.5
"""A camera counts if its own information on a motion is at least this share of that of the prior."""


@dataclass(frozen=True)
class CommonMotion:
    """Motion of one sweep from several cameras; `consistent` is False if they differ more than their deviations."""

    speed_m_s: float
    speed_sigma: float
    turn_rad_s: float
    turn_sigma: float
    consistent: bool

    @classmethod
    def of(cls, motions: Sequence[SweepMotion], prior: MotionPrior) -> CommonMotion:
        """Fuse estimates of the same sweep, each of which contains the prior: in the result it counts once.

        Speed and turning rate are fused separately. A camera whose estimate hardly exceeds the prior
        is left out.
        """
        from scipy.stats import chi2

        speeds = [(motion.speed_m_s, motion.speed_sigma) for motion in motions]
        turns = [(np.radians(motion.turn_deg_s), np.radians(motion.turn_sigma)) for motion in motions]
        speed = _fused(np.array(speeds), prior.expected.speed_m_s, prior.speed_sigma)
        turn = _fused(np.array(turns), prior.expected.turn_rad_s, prior.turn_sigma)
        chi_square, degrees = speed[2] + turn[2], speed[3] + turn[3]
        consistent = degrees == 0 or float(chi2.sf(chi_square, degrees)) >= _LEAST_P
        return cls(*speed[:2], *turn[:2], consistent)

    def reported(self, motion: SweepMotion, prior: MotionPrior) -> SweepMotion:
        """Return this motion as that of the frame of `motion`."""
        moving = replace(prior.expected, speed_m_s=self.speed_m_s, turn_rad_s=self.turn_rad_s)
        return sweep_motion(motion.frame, moving, self.speed_sigma, self.turn_sigma)


def _fused(values: Float, expected: float, sigma: float) -> tuple[float, float, float, int]:
    """Return mean, standard deviation, chi-square and its degrees of freedom of (N, 2) values and deviations."""
    mean, known = values[:, 0], 1 / values[:, 1] ** 2
    own = known - 1 / sigma**2
    telling = own > _LEAST_INFORMATION / sigma**2
    own, mean = own[telling], (mean[telling] * known[telling] - expected / sigma**2) / own[telling]
    total = own.sum() + 1 / sigma**2
    common = (float(own @ mean) + expected / sigma**2) / total
    among = float(own @ mean) / own.sum() if len(own) else 0.0
    return float(common), float(1 / np.sqrt(total)), float(own @ (mean - among) ** 2), max(0, len(own) - 1)
