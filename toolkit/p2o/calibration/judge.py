"""Judges compare poses by their cost. All poses that are compared are judged on one set of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from p2o.arrays import Float
from p2o.features.view import View
from p2o.geometry import se3
from p2o.host.stages import JudgeBase, LogLikelihood, Matcher, MatcherBase
from p2o.problems.agreement import agreement_of
from p2o.problems.directed_cost import DirectedCost
from p2o.problems.directed_fit import nearest_minimum
from p2o.problems.interval_likelihood import IntervalLikelihood, ring_step_deg
from p2o.problems.problem import LeastSquares, Problem
from p2o.problems.rivals import rival_poses
from p2o.results.evidence import Agreement
from p2o.results.result import DIRECTED, INTERVALS

_MOST_VIEWS = 64
"""Poses of more frames are judged on this many: distance maps dominate the memory of a joint calibration."""


@dataclass(frozen=True, eq=False)
class DirectedJudge(JudgeBase):
    """Judges by the directed distance: the points are those that the start or a proposed pose brings into the image."""

    cost: DirectedCost
    name: str = DIRECTED
    unit: str = "px"
    camera_errors: tuple[bool, bool, bool, bool] = (True, True, True, True)
    _known: dict[bytes, float] = field(default_factory=dict)

    @classmethod
    def of(cls, views: Sequence[View], start: Float, poses: Sequence[Float], truncate_px: float) -> DirectedJudge:
        """Return the judge of poses near the start; distances are truncated at `truncate_px`."""
        margin_px = _margin_px(views, start, poses)
        return cls(DirectedCost.of(views, start, truncate_px, margin_px=margin_px, max_views=_MOST_VIEWS))

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the directed distance of each pose in pixels."""
        for pose in poses:
            if pose.tobytes() not in self._known:
                self._known[pose.tobytes()] = self.cost.at(pose)
        return [self._known[pose.tobytes()] for pose in poses]

    def lead(self, best: float, other: float) -> tuple[float, str]:
        """Return how many matched edges the other pose loses."""
        return (other - best) * self.cost.edges / self.cost.truncate_px, "edges"

    def on(self, views: Sequence[View]) -> DirectedJudge:
        """Return the judge of the same points and weights where `views` put them."""
        return replace(self, cost=self.cost.on(views), _known={})

    def maximised(self, pose: Float) -> Float:
        """Return the pose (4, 4) of the local minimum of the directed distance near a pose."""
        return nearest_minimum(self.cost, pose)

    def rivals(self, pose: Float, count: int) -> list[Float]:
        """Return up to `count` poses (4, 4) of low cost near a pose."""
        return rival_poses(self.cost, pose, count)


SIGMA_PX = 2.0
"""Standard deviation in pixels of an image edge from the outline that it belongs to."""
_MAX_INTERVALS = 6000
_NATS_PER_EDGE = 6.5
"""The decrease of the log-likelihood ratio that counts as one edge.

An edge whose interval contains the only image edge around adds 2.5, but edges of one outline are correlated: poses
that were up to 10 nats worse than a wrong one were right (single frames of a KITTI drive with 16 and 32 rings).
"""


@dataclass(frozen=True, eq=False)
class IntervalJudge(JudgeBase):
    """Judges by the likelihood of the intervals between beams, for sweeps whose rings are far apart."""

    likelihood: IntervalLikelihood
    name: str = INTERVALS
    unit: str = "nats"
    # Edges between rings that are far apart do not reveal the vertical principal point.
    camera_errors: tuple[bool, bool, bool, bool] = (True, True, True, False)

    @classmethod
    def of(cls, views: Sequence[View], start: Float, poses: Sequence[Float]) -> IntervalJudge:
        """Return the judge of poses near the start; shares of edges with a counterpart are those of the best pose."""
        margin_px = _margin_px(views, start, poses)
        likelihood = IntervalLikelihood.of(
            views, start, SIGMA_PX, margin_px=margin_px, max_points=_MAX_INTERVALS, max_views=_MOST_VIEWS
        )
        for _ in range(2):
            likelihood = likelihood.fitted(poses[int(np.argmax(likelihood(np.stack(poses))))])
        return cls(likelihood)

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return minus the log-likelihood ratio of each pose; infinite without edges."""
        if not self.likelihood.points:
            return [float("inf")] * len(poses)
        costs: list[float] = (-self.likelihood(np.stack(poses))).tolist()
        return costs

    def lead(self, best: float, other: float) -> tuple[float, str]:
        """Return how many matched edges the other pose loses."""
        return (other - best) / _NATS_PER_EDGE, "edges"

    def on(self, views: Sequence[View]) -> IntervalJudge:
        """Return the judge of the same edges and weights where `views` put them."""
        return IntervalJudge(self.likelihood.on(views))

    def agreement(self, views: Sequence[View], pose: Float) -> Agreement | None:
        """Return how many intervals of views contain an image edge at a pose (4, 4)."""
        return agreement_of(views, pose, intervals=True)

    def covariance(self, pose: Float) -> Float:
        """Return the covariance (6, 6) of the maximum, with the error by the position of outlines between beams."""
        return self.likelihood.covariance(pose)

    def maximised(self, pose: Float) -> Float:
        """Return the pose (4, 4) of the local maximum of the likelihood near a pose."""
        return self.likelihood.maximised(pose)

    @property
    def log_likelihood(self) -> LogLikelihood:
        """The log likelihood ratio of a pose."""
        return self.likelihood.with_gradient


def is_sparse(views: Sequence[View], interval_deg: float) -> bool:
    """Return whether edges of views are treated as intervals: their rings are at least `interval_deg` apart."""
    return 0 < ring_step_deg(views) >= interval_deg


def _margin_px(views: Sequence[View], start: Float, poses: Sequence[Float]) -> float:
    """Return how far outside the image a point may be projected and still be moved inside by one of the poses."""
    widest = max((se3.angle_deg(pose @ se3.inverse(start)) for pose in poses), default=0.0)
    return float(max(view.camera.focal_px for view in views) * np.tan(np.radians(min(widest, 60.0))))


@dataclass(frozen=True, eq=False)
class ProblemJudge(JudgeBase):
    """Judges by the method's own cost, for methods without directed edges.

    What a matcher pairs depends on the pose it is asked at. So it is asked at every pose that takes part, and each pose
    pays the mean of its costs over all these problems: no pose is judged by its own pairs alone.
    """

    matcher: Matcher
    views: tuple[View, ...]
    reach_px: float
    name: str = "own-cost"
    unit: str = "cost"
    _known: dict[bytes, Problem] = field(default_factory=dict)

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the mean cost of each pose; for least squares the robust sum over the sum of the weights."""
        stack = np.stack(poses)
        rows = [self._at(pose, stack) for pose in {pose.tobytes(): pose for pose in poses}.values()]
        finite = [row for row in rows if np.isfinite(row).any()]
        mean: list[float] = np.mean(finite, axis=0).tolist() if finite else [float("inf")] * len(poses)
        return mean

    def _at(self, pose: Float, stack: Float) -> Float:
        """Return the costs (B,) of all poses by the problem that is posed at `pose`; infinite without pairs."""
        key = pose.tobytes()
        if key not in self._known:
            self._known[key] = self.matcher(self.views, pose, self.reach_px)
        problem = self._known[key]
        costs = np.asarray(problem.cost(stack), np.float64)
        if isinstance(problem, LeastSquares):
            total = float(problem.weight.sum())
            return costs / total if total > 0 else np.full(len(stack), np.inf)
        return costs

    def on(self, views: Sequence[View]) -> ProblemJudge:
        """Return the judge of other views."""
        return replace(self, views=tuple(views), _known={})


def judge_of(
    matcher: Matcher,
    needs: frozenset[str],
    views: Sequence[View],
    start: Float,
    poses: Sequence[Float],
    *,
    truncate_px: float,
    reach_px: float,
    interval_deg: float = 90.0,
) -> JudgeBase:
    """Return the judge of a method: the matcher's own, else by directed edges where it needs edges, else by its cost.

    Directed edges of sweeps whose rings are at least `interval_deg` apart are judged as intervals.

    `needs` are the words of the matcher, `poses` (4, 4) those that are proposed to begin from.
    """
    own = matcher.judge(views, start, poses) if isinstance(matcher, MatcherBase) else None
    if own is not None:
        assert isinstance(own, JudgeBase)  # the guard has seen to it
        return own
    if {"image-edges", "cloud-edges"} <= needs:
        if is_sparse(views, interval_deg):
            return IntervalJudge.of(views, start, poses)
        return DirectedJudge.of(views, start, poses, truncate_px)
    return ProblemJudge(matcher, tuple(views), reach_px)
