"""Search for the pose of the highest interval likelihood: cross-entropy from wide to narrow image edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from p2o.arrays import Float
from p2o.calibration.judge import SIGMA_PX
from p2o.features.view import View
from p2o.geometry import se3
from p2o.problems.interval_likelihood import IntervalLikelihood

_LEVELS = ((8.0, 300, 6), (4.0, 150, 4), (SIGMA_PX, 100, 3))
"""Standard deviation of image edges in px, poses in a generation, and generations, from wide to narrow."""
_MAX_POINTS, _MAX_VIEWS, _MARGIN_PX = 4000, 64, 60.0
_UNIT = np.array([*np.radians([1.0, 1.0, 1.0]), 0.1, 0.1, 0.1])
_SPREAD = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
"""Standard deviations of the first generation: 2 deg and 10 cm."""
_PRIOR = 0.25
"""Nats that a pose costs at 1 deg or 10 cm from the initial one, per square of it: without edges it stays there."""
_ELITE = 0.1
_WIDER, _LEAST_VARIANCE = 2.0, 1e-3
"""The next level starts with a wider population than the last one ended with."""


def most_likely_pose(views: Sequence[View], start: Float, proposals: Sequence[Float], seed: int = 0) -> Float:
    """Return the pose (4, 4) of the highest interval likelihood near `start`; `proposals` (4, 4) are evaluated, too.

    Poses of a left update are drawn from a Gaussian that follows the best tenth of each generation (Rubinstein, 1999).
    """
    rng = np.random.default_rng(seed)
    mean, spread, shares = np.zeros(6), np.diag(_SPREAD**2), None
    first = np.array([se3.log(pose @ se3.inverse(start)) / _UNIT for pose in proposals]).reshape(-1, 6)
    for sigma_px, population, generations in _LEVELS:
        likelihood = IntervalLikelihood.of(
            views, start, sigma_px, margin_px=_MARGIN_PX, max_points=_MAX_POINTS, max_views=_MAX_VIEWS, shares=shares
        )
        if not likelihood.points:
            return start
        for _ in range(generations):
            draws = np.concatenate(
                [mean[None], first, rng.multivariate_normal(mean, spread, population, method="eigh")]
            )
            first = first[:0]
            values = likelihood(se3.exp(draws * _UNIT) @ start) - _PRIOR * np.square(draws).sum(axis=1)
            best = draws[np.argsort(-values, kind="stable")[: int(_ELITE * population)]]
            mean, spread = best.mean(axis=0), np.cov(best.T, ddof=1) + 1e-6 * np.eye(6)
        pose = se3.exp(mean * _UNIT) @ start
        shares = likelihood.fitted(pose).shares
        spread = _WIDER * spread + _LEAST_VARIANCE * np.eye(6)
    return pose
