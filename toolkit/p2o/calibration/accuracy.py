"""From the covariance of pairs and the agreement of edges to how wrong a pose is likely to be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.results.accuracy import Accuracy


class _Law(NamedTuple):
    """Errors grow with the deviation that pairs show, times a factor; `floor` is what any number of frames leaves."""

    two_of_three: float
    nineteen_of_twenty: float
    floor: float

    def bounds(self, deviation: float) -> tuple[float, float]:
        wide, wider = (float(np.hypot(factor * deviation, self.floor)) for factor in self[:2])
        return wide, wider


_ROTATION_DEG = _Law(4.2, 9.5, 0.02)
_TRANSLATION_M = _Law(2.3, 5.0, 0.025)
"""So that they hold on KITTI's `train` frames: the factors for one frame, the floor for 8 and 16 together, whose truth
is the published extrinsic (docs/benchmarks.md, How wrong a result says it may be).
"""
_ODDS, _BY_ODDS = 10.0, 0.7
_LEAST_ODDS, _MOST_ODDS = 2.0, 40.0
"""Errors fall with this power of the odds ratio against a usual one, within the odds ratios that were seen."""


def likely_accuracy(covariance: Float, camera_from_lidar: Float, odds_ratio: float) -> Accuracy:
    """Return how wrong a pose (4, 4) is likely to be.

    `covariance` (6, 6) is that of a left update in rad and m as pairs show it (`p2o.calibration.adjustment`),
    `odds_ratio` that of `p2o.calibration.agreement` at the pose. Pairs know of each other's noise only, not of edges
    that were taken for others. That is why errors are several times the deviation that follows from the covariance, the
    less the better the edges agree.
    """
    odds = float(np.clip(np.nan_to_num(odds_ratio, nan=0.0), _LEAST_ODDS, _MOST_ODDS))
    factor = (odds / _ODDS) ** -_BY_ODDS
    rotation_deg, translation_m = deviations(covariance, camera_from_lidar)
    wide_deg, wider_deg = _ROTATION_DEG.bounds(factor * rotation_deg)
    wide_m, wider_m = _TRANSLATION_M.bounds(factor * translation_m)
    return Accuracy(wide_deg, wide_m, wider_deg, wider_m)


def deviations(covariance: Float, camera_from_lidar: Float) -> tuple[float, float]:
    """Return the root mean square errors in deg and m that a covariance (6, 6) of a left update in rad and m means.

    A turn w about the camera moves the LiDAR at t by w x t, which counts as translation (`p2o.pose_error`).
    """
    by_update = np.hstack([-se3.skew(camera_from_lidar[:3, 3]), np.eye(3)])
    rotation, translation = covariance[:3, :3], by_update @ covariance @ by_update.T
    return float(np.degrees(np.sqrt(np.trace(rotation)))), float(np.sqrt(np.trace(translation)))
