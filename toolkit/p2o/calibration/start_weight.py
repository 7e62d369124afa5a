"""The start as a measurement: what is known of an extrinsic before any edge is seen counts for what it is worth."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.calibration.accuracy import LAW, place_by_update
from p2o.calibration.fusion import OWN_SHARE, Fusion, Opinion

_TWO_OF_THREE = 0.967
"""Two of three values of a Gaussian lie within so many of its deviations."""
_MOST_CHI_SQUARE = 16.81
"""A start that lies further from where the edges put it is not as good as was said (1 of 100 would, six directions)."""


def with_start(pose: Float, likely: Float, start: Float, sigma: tuple[float, float]) -> tuple[Float, Float] | None:
    """Return the mean of the pose (4, 4) that edges tell and the start (4, 4), each weighed by what it is worth.

    `likely` (6, 6) is the covariance of the pose's errors; that of the mean's comes back beside it. Both are of turns
    about the camera axes in rad and places of the LiDAR in m (`p2o.calibration.accuracy.likely_covariance`). `sigma` is
    how good the start is, one deviation about (deg) and along (m) each axis. Each direction follows what it is known
    better by: what edges tell surely stays, what they leave open follows the start. None where a covariance is not that
    of six directions, and where the two contradict each other: the start is then not as good as was said.
    """
    if not np.isfinite(likely).all():
        return None
    # As errors are by axis, and a part of them each axis's own (p2o.calibration.fusion).
    real = (LAW.axis / _TWO_OF_THREE) ** 2
    edges = real * ((1 - OWN_SHARE) * likely + OWN_SHARE * np.diag(np.diag(likely)))
    prior = np.diag(np.repeat([np.radians(sigma[0]), sigma[1]], 3) ** 2)
    try:
        fusion = Fusion.of([_opinion("edges", pose, edges), _opinion("start", start, prior)])
    except np.linalg.LinAlgError:
        return None
    if not fusion.chi_square <= _MOST_CHI_SQUARE:
        return None
    by_update = place_by_update(fusion.body_from_lidar)
    return fusion.body_from_lidar, np.asarray(by_update @ fusion.covariance @ by_update.T) / real


def _opinion(name: str, camera_from_lidar: Float, covariance: Float) -> Opinion:
    """Return a pose with the covariance (6, 6) of its turn and place as one with that of its left update."""
    by_place = np.linalg.inv(place_by_update(camera_from_lidar))
    return Opinion(name, camera_from_lidar, by_place @ covariance @ by_place.T)
