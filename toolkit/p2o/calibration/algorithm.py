"""The stages of Algorithm 1 that work on prepared views: search for poses, and refine each of them in rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from p2o.arrays import Float
from p2o.calibration.adjustment import Nuisance
from p2o.calibration.interval_search import most_likely_pose
from p2o.calibration.judge import is_sparse, judge_of
from p2o.calibration.nuisance import NuisanceEstimate, estimate_nuisances, known_twists, motion_prior
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import REACH_AFTER_SEARCH_PX, End, Rounds
from p2o.calibration.search_box import SearchBox
from p2o.features.view import View
from p2o.geometry import se3
from p2o.host.stages import Initializer, InitializerBase, JudgeBase, Matcher, Solver
from p2o.problems.distinct_views import weighted
from p2o.results.result import Status

EDGES = frozenset({"image-edges", "cloud-edges"})

_MOST_RIVALS, _NEAR_FAR = 2, 4
"""Poses near the best one that are refined: as rivals of a result, and as results themselves after a far search."""
_CERTAIN_LEAD = 8.0
"""A local minimum that loses this many edges against the best one is not refined further."""
_SAME_DEG, _SAME_M = 0.1, 0.05
"""Poses closer than this are of one local minimum."""
_FAR_DEG, _FAR_M = 6.0, 0.5
"""A camera displaced by more than this sees other surfaces, and edges may have other directions in its image."""


def is_far(start: Float, pose: Float) -> bool:
    """Return whether a pose (4, 4) is so far from the initial one that the camera sees other edges from it."""
    moved_m = float(np.linalg.norm(se3.inverse(pose)[:3, 3] - se3.inverse(start)[:3, 3]))
    return se3.angle_deg(pose @ se3.inverse(start)) > _FAR_DEG or moved_m > _FAR_M


def _is_same(pose: Float, other: Float) -> bool:
    """Return whether two poses (4, 4) are of one local minimum."""
    step = se3.inverse(other) @ pose
    return se3.angle_deg(step) < _SAME_DEG and se3.distance_m(step) < _SAME_M


@dataclass(frozen=True, eq=False)
class Refined:
    """The poses that rounds of matching and solving ended at, one for each proposal, and the judge that compares them.

    `views` are those that the rounds matched, `box` that of the initializer's search, None if it has none. `rivals` are
    poses near the best one, which are no results but may fit better.
    """

    views: VisibleViews
    start: Float
    ends: Sequence[End]
    judge: JudgeBase
    box: SearchBox | None = None
    rivals: Sequence[End] = ()

    @property
    def solved(self) -> list[End]:
        """The ends with a pose to judge: those within the box of the search, all of them if none is."""
        solved = [end for end in self.ends if end.status.solved]
        return [end for end in solved if self.within(end.pose)] or solved

    def within(self, pose: Float) -> bool:
        """Return whether a pose (4, 4) is within the box of the search."""
        return self.box is None or self.box.has(self.start, pose)

    @cached_property
    def best(self) -> End:
        """The solved end of the lowest cost; there must be one."""
        solved = self.solved
        return solved[int(np.argmin(self.judge.costs([end.pose for end in solved])))]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What Algorithm 1 found, before it is assessed: poses of all proposals, and the best with its nuisances."""

    refined: Refined
    final: NuisanceEstimate

    @cached_property
    def views(self) -> list[View]:
        """The visible views, corrected by the estimated nuisance parameters."""
        return self.final.nuisance.views(self.refined.views.raw)


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """Matcher, solver and initializer with the options of Algorithm 1.

    `needs` are the words of what matcher and initializer need. With `directed` False the views have no directions, and
    none are derived from a pose.
    """

    matcher: Matcher
    solver: Solver
    initializer: Initializer
    options: PipelineOptions = field(default_factory=PipelineOptions)
    directed: bool = True
    needs: frozenset[str] = EDGES

    def visible(self, views: Sequence[View], camera_from_lidar: Float) -> VisibleViews:
        """Return the views as visible from a pose (4, 4), weighted by what each of them alone shows.

        Edges with directions have those in the image axes of the pose; motions are those that the options expect.
        """
        turned = [view.as_seen_from(camera_from_lidar) for view in views] if self.directed else views
        visible = weighted([view.without_hidden(camera_from_lidar) for view in turned], camera_from_lidar)
        prior, twists = motion_prior(views, self.options), known_twists(views, self.options)
        return VisibleViews(visible, Nuisance.expected(visible, prior, twists))

    def propose(self, views: VisibleViews, start: Float) -> list[Float]:
        """Return the poses (4, 4) to refine, best first; the initial extrinsic where the initializer proposes none."""
        return self.initializer(views.corrected, start) or [start]

    def refine(self, views: VisibleViews, start: Float, proposals: Sequence[Float]) -> Refined:
        """Run the rounds of Algorithm 1 from each proposed pose (4, 4).

        The initial extrinsic is refined only where nothing else is proposed. For sweeps whose rings are far apart, the
        pose of the highest interval likelihood is added to the proposals.
        """
        if self.needs >= EDGES and is_sparse(views.corrected, self.options.interval_deg):
            centre = proposals[0] if is_far(start, proposals[0]) else start
            proposals = [most_likely_pose(views.corrected, centre, proposals), *proposals]
        options, judge = self.options, self.judge(views.corrected, start, proposals)
        reach = self.initializer.reach if isinstance(self.initializer, InitializerBase) else None
        refined = Refined(views, start, [], judge, None if reach is None else SearchBox(*reach))
        others = [pose for pose in proposals if not np.allclose(pose, start, atol=1e-12)]
        ends, rivals = self._ends(refined, others, REACH_AFTER_SEARCH_PX)
        if not ends:
            rounds = Rounds(self.matcher, self.solver, options)
            ends = [rounds(views.corrected, start, start, judge, reach_px=options.reach_px)]
        return replace(refined, ends=ends, rivals=rivals)

    def refine_again(self, views: Sequence[View], refined: Refined) -> Refined:
        """Repeat the rounds from all solved poses, with what is visible from the best of them.

        If no pose is solved again, the previous ones are kept and evaluated again. The best pose of a searched box may
        be a local minimum: the rounds start from poses near it, too.
        """
        proposals = [end.pose for end in refined.solved]
        again = self.refine(self.visible(views, refined.best.pose), refined.start, proposals)
        again = replace(again, ends=again.solved or refined.solved)
        return again if again.box is None else replace(again, ends=[*again.ends, *self._near_ends(again, _NEAR_FAR)[0]])

    def with_rivals(self, refined: Refined) -> Refined:
        """Return the refined poses with rivals of the best one.

        Without a search, or from an initial guess outside its range, the best pose may be a local minimum.
        """
        ends, rivals = self._near_ends(refined, _MOST_RIVALS)
        return replace(refined, rivals=[*refined.rivals, *ends, *rivals])

    def _near_ends(self, refined: Refined, count: int) -> tuple[list[End], list[End]]:
        """Return `_ends` from up to `count` poses of low cost near the best one."""
        return self._ends(refined, refined.judge.rivals(refined.best.pose, count), self.options.min_reach_px)

    def _ends(self, known: Refined, poses: Sequence[Float], reach_px: float) -> tuple[list[End], list[End]]:
        """Return the ends of rounds from poses (4, 4), and local minima of the judge's cost without rounds.

        Where the judge counts edges, no rounds are run from a pose whose local minimum is that of another one or of a
        known end, or matches `_CERTAIN_LEAD` fewer edges than the best within the box.
        """
        judge, ends, rivals = known.judge, list[End](), list[End]()
        rounds, views = Rounds(self.matcher, self.solver, self.options), known.views.corrected
        end = partial(rounds, views, known.start, judge=judge, reach_px=reach_px, found_by="initialize")
        if judge.lead(0.0, 0.0)[1] != "edges":
            return [end(pose) for pose in poses], []
        minima, seen = [judge.maximised(pose) for pose in poses], [end.pose for end in known.solved]
        costs = judge.costs([*minima, *seen])
        within = [cost for cost, pose in zip(costs, [*minima, *seen], strict=True) if known.within(pose)]
        for number in np.argsort(costs[: len(poses)], kind="stable"):
            minimum, (lead, _) = minima[number], judge.lead(min(within or costs), costs[number])
            if lead > _CERTAIN_LEAD or any(_is_same(minimum, other) for other in seen):
                rivals.append(End(minimum, Status.CONVERGED, "a local minimum of the cost", ()))
            else:
                ends.append(end(poses[number]))
                seen.append(minimum)
        return ends, rivals

    def judge(self, views: Sequence[View], start: Float, poses: Sequence[Float]) -> JudgeBase:
        """Return the judge of poses (4, 4) that are proposed from an initial one (4, 4)."""
        reach = {"truncate_px": self.options.judge_px, "reach_px": self.options.min_reach_px}
        reach["interval_deg"] = self.options.interval_deg
        return judge_of(self.matcher, self.needs, views, start, poses, **reach)

    def estimate_nuisances(self, refined: Refined) -> Estimate:
        """Estimate sweep motion, camera errors and time offset along with the best pose, where edges allow it."""
        raw, start, nuisance = refined.views.raw, refined.start, refined.views.nuisance
        rounds = Rounds(self.matcher, self.solver, self.options)
        return Estimate(refined, estimate_nuisances(raw, start, refined.best, refined.judge, nuisance, rounds))


@dataclass(frozen=True, eq=False)
class VisibleViews:
    """Views without LiDAR edges that are hidden from the camera at an assumed pose.

    `raw` are the views before any correction; `nuisance` holds the expected motions of their sweeps.
    """

    raw: Sequence[View]
    nuisance: Nuisance

    @cached_property
    def corrected(self) -> list[View]:
        """The views corrected for the expected motions."""
        return self.nuisance.views(self.raw)


def missing_features(views: Sequence[View], start: Float, needs: frozenset[str]) -> tuple[Status, str] | None:
    """Return status and reason where the views lack a kind of feature that the stages need, else None.

    `needs` are the words of the stages; those that name no feature are ignored. Image edges are checked before LiDAR
    edges, and edges before other kinds; then whether any LiDAR feature is in front of the camera at `start` (4, 4).
    """
    words = (word for word in needs if word.startswith(("image-", "cloud-")))
    kinds = sorted(words, key=lambda word: (not word.endswith("-edges"), not word.startswith("image-"), word))
    for word in kinds:
        if not any(view.count(word) for view in views):
            sensor, _, feature = word.partition("-")
            source = "image" if sensor == "image" else "sweep"
            status = Status.NO_EDGES if feature == "edges" else Status.NO_FEATURES
            return status, f"no {feature} were found in the {source}"
    for word in kinds:
        if not word.startswith("cloud-"):
            continue
        features = [(view.camera, feature) for view in views if (feature := view.get(word)) is not None]
        positions = [(camera, feature.places) for camera, feature in features if feature.places is not None]
        if positions and not any(np.isfinite(c.project(se3.apply(start, xyz))).any() for c, xyz in positions):
            is_edge = word == "cloud-edges"
            status = Status.NO_EDGES if is_edge else Status.NO_FEATURES
            kind = "edge" if is_edge else "feature"
            return status, f"every LiDAR {kind} lies behind the camera: is the start the transform lidar_from_camera?"
    return None
