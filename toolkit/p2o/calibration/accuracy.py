"""From what pairs and beams leave open to how wrong a pose is likely to be, in all and by axis."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from p2o.arrays import Float
from p2o.calibration.shifts import Spread
from p2o.geometry import se3
from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Agreement, Rival


class Law(NamedTuple):
    """What likely errors are made of, as a sum of covariances, and how errors are spread about that.

    `pairs` times the deviation that the scatter of pairs shows, at an odds ratio of 10, and with the power `by_odds` of
    the odds ratio more or less; `beams` times the one that a shift of all edges alike by one deviation of the beams
    makes; `rings` times what half a gap of beams is (`p2o.calibration.shifts.Spread`); and a floor. No number of frames
    goes below beams and floor. Factors then say within how many of these deviations two of three errors are, and 19 of
    20: `rotation` and `translation` as a whole, `axis` of each axis by itself (two of three). Where edges meet in few
    places, some poses are far off: 19 of 20 are then within more, by how much the strength of the agreement falls
    short.
    """

    pairs: float
    by_odds: float
    beams: float
    rings: float
    floor_deg: float
    floor_m: float
    rotation: tuple[float, float]
    translation: tuple[float, float]
    axis: float


LAW = Law(1.1, 0.5, 1.1, 0.74, 0.013, 0.0042, (1.58, 3.69), (1.55, 3.04), 1.31)
"""Fitted by `python benchmarks/verdicts.py fit` to 332 results on 22 rigs, 12 of them simulated, with the extractors of
then: docs/benchmarks.md, A verdict that transfers. The factors of translation were widened afterwards, by 1.20 and
1.23, on random simulated rigs (the same section), with the extractors of now.
"""
_LEAST_ODDS, _MOST_ODDS = 1.5, 40.0
"""Beyond the odds ratios that were seen the law stays as it is at the last of them."""
_STRONG, _LEAST_STRENGTH = 12.0, 3.0


def likely_accuracy(spread: Spread, camera_from_lidar: Float, agreed: Agreement, law: Law = LAW) -> Accuracy:
    """Return how wrong a pose (4, 4) is likely to be.

    `spread` is what pairs and beams leave open, `agreed` how edges meet at the pose. Pairs know of each other's noise
    only, not of edges that were taken for others: errors are a multiple of what they show, the less the better the
    edges agree.
    """
    return accuracy_of(likely_covariance(spread, camera_from_lidar, agreed.odds_ratio, law), agreed, law)


def accuracy_of(covariance: Float, agreed: Agreement, law: Law = LAW) -> Accuracy:
    """Return how wrong a pose is likely to be whose errors have a covariance (6, 6) as `likely_covariance` tells it."""
    axes = np.sqrt(np.diag(covariance))
    rotation_deg, translation_m = float(np.degrees(np.linalg.norm(axes[:3]))), float(np.linalg.norm(axes[3:]))
    bounds = [
        (more * factor * rotation_deg, more * other * translation_m)
        for more, factor, other in zip((1.0, weakness(agreed)), law.rotation, law.translation, strict=True)
    ]
    pitch, yaw, roll = (law.axis * np.degrees(axes[:3])).tolist()
    x, y, z = (law.axis * axes[3:]).tolist()
    return Accuracy(*bounds[0], *bounds[1], roll, pitch, yaw, x, y, z)


def likely_covariance(spread: Spread, camera_from_lidar: Float, odds_ratio: float, law: Law = LAW) -> Float:
    """Return the covariance (6, 6) of likely errors: turns about the camera axes in rad, places of the LiDAR in m.

    A sum of covariances: a direction that one part leaves open becomes wider, and no other.
    """
    odds = float(np.clip(np.nan_to_num(odds_ratio, nan=0.0), _LEAST_ODDS, _MOST_ODDS))
    own = np.repeat([np.radians(law.floor_deg), law.floor_m], 3) ** 2 + (law.rings * spread.rings) ** 2
    scatter = (law.pairs * (odds / 10.0) ** -law.by_odds) ** 2 * spread.pairs + law.beams**2 * spread.beams
    by_update = place_by_update(camera_from_lidar)
    return np.asarray(by_update @ scatter @ by_update.T + np.diag(own))


def or_rival(accuracy: Accuracy, rival: Rival | None, min_lead_edges: float) -> Accuracy:
    """Return the accuracy, its bounds for 19 of 20 at least as far as a rival pose that fits about as well."""
    if rival is None or rival.unit != "edges" or rival.lead >= min_lead_edges:
        return accuracy
    return replace(
        accuracy,
        rotation_deg_95=max(accuracy.rotation_deg_95, rival.rotation_deg),
        translation_m_95=max(accuracy.translation_m_95, rival.translation_m),
    )


def weakness(agreed: Agreement) -> float:
    """Return how much further off the worst of results are where edges meet in few places; 1 where in many."""
    strength = float(np.nan_to_num(agreed.strength, nan=0.0))
    return max(1.0, _STRONG / max(strength, _LEAST_STRENGTH))


def deviations(covariance: Float, camera_from_lidar: Float) -> tuple[float, float]:
    """Return the root mean square errors in deg and m that a covariance (6, 6) of a left update in rad and m means.

    A turn w about the camera moves the LiDAR at t by w x t, which counts as translation (`p2o.pose_error`).
    """
    by_update = place_by_update(camera_from_lidar)
    variances = np.diag(by_update @ covariance @ by_update.T)
    return float(np.degrees(np.sqrt(variances[:3].sum()))), float(np.sqrt(variances[3:].sum()))


def place_by_update(camera_from_lidar: Float) -> Float:
    """Return the derivative (6, 6) of turn and place of the LiDAR in the camera frame by a left update."""
    by_update = np.eye(6)
    by_update[3:, :3] = -se3.skew(camera_from_lidar[:3, 3])
    return by_update
