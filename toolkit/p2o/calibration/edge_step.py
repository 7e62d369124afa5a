"""Where edges alone lead from a given pose, within a narrow reach of it, and how wrong that is likely to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from p2o.arrays import Float
from p2o.calibration.accuracy import LAW, likely_covariance, weakness
from p2o.calibration.camera_check import tells_more
from p2o.calibration.different_views import view_count
from p2o.calibration.nuisance import Nuisance, motion_prior
from p2o.calibration.options import PipelineOptions
from p2o.calibration.shifts import Spread
from p2o.calibration.verdict import agreement_of
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.host.stages import Matcher
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import Problem
from p2o.results.evidence import Agreement

REACH_PX = 15.0
"""An edge of KITTI's camera moves that far with 1.2 deg; larger slips are found by a search."""
_ROUNDS = 14
_STILL_PX = 0.05
_FARTHEST_DEG, _FARTHEST_M = 5.0, 1.0
_TWO_OF_THREE = 0.967
"""Two of three values of a Gaussian lie within so many of its deviations."""
_AXES = np.array([2, 0, 1, 3, 4, 5])
"""Where roll, pitch, yaw, x, y, z are among turns about x, y, z and places."""


@dataclass(frozen=True, eq=False)
class EdgeStep:
    """What edges tell of a given pose: `found` (4, 4) is where they lead from it.

    `error` (6,) is how the given pose is off by that: roll, pitch, yaw in deg and x, y, z in m as errors have them
    (`p2o.geometry.pose_error`); `covariance` (6, 6) that of its own likely errors, in the same order and units.
    """

    found: Float
    error: Float
    covariance: Float
    agreement: Agreement
    places: int

    @property
    def sigma(self) -> Float:
        """The deviations (6,) of the likely errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def edge_step(
    views: Sequence[View],
    camera_from_lidar: Float,
    matcher: Matcher,
    options: PipelineOptions,
    *,
    around: Float | None = None,
    reach_px: float = REACH_PX,
) -> EdgeStep | str:
    """Return where edges lead from a given pose (4, 4), or why they do not tell.

    Pairs are made within a reach that shrinks, and solved, until they stay; how raw sweeps moved is found with it. The
    given pose has no say but as the place to begin from; `around` (4, 4) is another one.
    """
    pose = begin = camera_from_lidar if around is None else around
    raw = [view.as_seen_from(begin).without_hidden(begin) for view in views]
    cameras = tuple(view.camera for view in raw)
    nuisance = Nuisance.expected(raw, motion_prior(raw, options))
    reach = reach_px
    for _ in range(_ROUNDS):
        problem = matcher(nuisance.views(raw), pose, reach)
        if not _enough(problem, options):
            return "too few pairs of edges are within reach"
        fit = nuisance.fit(problem, cameras, pose, cameras=False)
        pose, nuisance = fit.camera_from_lidar, nuisance.after(fit)
        step = se3.inverse(begin) @ pose
        if se3.angle_deg(step) > _FARTHEST_DEG or se3.distance_m(step) > _FARTHEST_M:
            return "edges lead away from the pose and do not stay near it"
        if fit.step_px < _STILL_PX and reach <= options.min_reach_px:
            break
        reach = max(options.min_reach_px, reach * options.shrink)
    seen = nuisance.views(raw)
    problem = matcher(seen, pose, options.min_reach_px)
    if not _enough(problem, options):
        return "too few pairs of edges are within reach"
    last = nuisance.fit(problem, cameras, pose, cameras=options.camera != "trust")
    agreed = agreement_of(seen, pose)
    if last.covariance is None or agreed is None:
        return "edges meet in too few places to tell how sure they are"
    different = view_count(problem.xyz, problem.side, problem.frame)
    spread = Spread.of(last.covariance, problem, pose, different)
    likely = (LAW.axis / _TWO_OF_THREE) ** 2 * likely_covariance(spread, pose, agreed.odds_ratio)
    units = np.repeat([np.degrees(1.0), 1.0], 3)
    covariance = (units[:, None] * likely * units)[np.ix_(_AXES, _AXES)]
    if not np.isfinite(covariance).all():
        return "edges leave a direction open"
    error = np.array(list(pose_error(camera_from_lidar, pose).per_axis.values()))
    return EdgeStep(pose, error, weakness(agreed) ** 2 * covariance, agreed, last.places)


def _enough(problem: Problem, options: PipelineOptions) -> TypeGuard[PointToLine]:
    return tells_more(problem) and len(problem) >= options.min_matches
