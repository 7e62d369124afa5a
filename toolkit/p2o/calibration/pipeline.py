"""Algorithm 1 of the paper: extract, initialize, then match and solve in rounds with a shrinking cutting distance."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.calibration.accuracy import accuracy_of, likely_accuracy, likely_covariance, or_rival
from p2o.calibration.camera_check import at_full_size
from p2o.calibration.different_views import standing_still, view_count
from p2o.calibration.judge import Judge, judge_of
from p2o.calibration.nuisance import Nuisance, adjusted, known_twists, motion_prior
from p2o.calibration.options import PipelineOptions as PipelineOptions
from p2o.calibration.rounds import End, Rounds, counts, mean_residuals_px
from p2o.calibration.shifts import Spread
from p2o.calibration.start_weight import with_start
from p2o.calibration.verdict import agreement_of, rival_of, verdict_of
from p2o.features.missing import patched
from p2o.features.remarks import CloudRemarks
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.host.stages import CloudExtractor, ImageExtractor, Initializer, Matcher, Solver
from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Judged, StartWeight
from p2o.results.result import DIRECTED, Result, Round, Status

EDGES = frozenset({"image-edges", "cloud-edges"})


@dataclass(frozen=True)
class Pipeline:
    """The staged calibrator: the paper's method with every part replaceable.

    Calling it with frames and a start camera_from_lidar (4, 4) gives a Result. `needs` are the words of what matcher
    and initializer need: a calibration of views that lack one is refused. With `directed` False every direction is
    forgotten right after extraction, so that no stage of an ablation without directions can profit from them.
    """

    image_extractor: ImageExtractor
    cloud_extractor: CloudExtractor
    matcher: Matcher
    solver: Solver
    initializer: Initializer
    options: PipelineOptions = field(default_factory=PipelineOptions)
    directed: bool = True
    needs: frozenset[str] = EDGES

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        """Calibrate the frames jointly; one frame is the ordinary case."""
        clock = Clock()
        with clock.of("extract"):
            views = [self.prepare(frame) for frame in frames]
        result = self.solve(views, camera_from_lidar)
        warnings = tuple(f"{frame.name}: {text}" for frame in frames for text in frame.warnings)
        return replace(result, seconds={**clock.seconds, **result.seconds}, warnings=(*warnings, *result.warnings))

    def prepare(self, frame: Frame) -> View:
        """Return the features of one frame; the truth is not looked at."""
        image, cloud = self.image_extractor(image_at_scale(frame.image)), self.cloud_extractor(frame.cloud)
        own = getattr(self.initializer, "prepare", None)
        prepared = None if own is None else own(frame.without_truth())
        return self.view(frame.name, frame.camera, image, cloud, frame.twist, prepared)

    extract = prepare  # its older name

    def view(
        self,
        name: str,
        camera: Camera,
        image: ImageFeatures,
        cloud: CloudFeatures,
        twist: Float | None = None,
        prepared: Any = None,
    ) -> View:
        """Return what the stages see of one frame: what its extractors found, and its velocity (6,) where known.

        `camera` is that of the frame, image features are of the picture that is looked at (`p2o.frames.scale`);
        `prepared` is what the initializer prepared of the frame.
        """
        options, seen_by = self.options, camera_at_scale(camera)
        view = View(name, seen_by, image, cloud, twist, None if seen_by is camera else camera, prepared)
        view = patched(view, options.missing_edges, options.missing_radius_px, options.seed)
        return view if self.directed else view.without_sides()

    def solve(self, views: Sequence[View], camera_from_lidar: Float) -> Result:
        """Return the joint calibration of prepared views from a start (4, 4)."""
        start, options, clock = se3.check_rigid("start", camera_from_lidar), self.options, Clock()
        rounds = Rounds(self.matcher, self.solver, options)

        def refused(status: Status, reason: str, history: tuple[Round, ...] = ()) -> Result:
            names = tuple(view.name for view in views)
            return Result(
                names, start, start, status, reason, history, warnings=remarks_of(views), seconds=clock.seconds
            )

        missing = missing_features(views, start, self.needs)
        if missing is not None:
            return refused(*missing)
        with clock.of("initialize"):
            raw = [self._seen(view, start) for view in views]
            nuisance = Nuisance.expected(raw, motion_prior(views, options), known_twists(views, options))
            seen = nuisance.views(raw)
            poses = self.initializer(seen, start) or [start]
        with clock.of("refine"):
            ends, judge = self._refined(rounds, seen, start, poses)
            solved = [end for end in ends if end.solved]
            if solved:
                best = _best(solved, judge)
                if _far(best.pose, start):
                    # What the camera sees was told from a place where it is not: tell it anew, and refine again.
                    raw = [self._seen(view, best.pose) for view in views]
                    seen = nuisance.views(raw)
                    again, judge = self._refined(rounds, seen, start, [end.pose for end in solved])
                    solved = [end for end in again if end.solved] or solved
                    best = _best(solved, judge)
        if not solved:
            return refused(ends[0].status, ends[0].reason, ends[0].rounds)
        rival = rival_of(solved, best, judge)
        with clock.of("adjust"):
            final = adjusted(raw, start, best, judge, nuisance, rounds)
        end, seen = final.end, final.nuisance.views(raw)
        judged = Judged(judge.name, judge.unit, *final.judge.costs([start, end.pose]))
        if not judged.estimate < judged.start:
            result = refused(Status.NO_IMPROVEMENT, _no_better(judged), end.rounds)
            return replace(result, judged=judged)
        with clock.of("agree"):
            agreed = agreement_of(seen, end.pose)
        covariance = final.covariance
        told, pose, weight = None, end.pose, None
        still: tuple[str, ...] = ()
        if covariance is not None and agreed is not None and end.problem is not None:
            different = view_count(end.problem.xyz, end.problem.side, end.problem.frame)
            still = standing_still(different, len(views))
            spread = Spread.of(covariance, end.problem, end.pose, different)
            told = likely_accuracy(spread, end.pose, agreed)
            found = self._with_start(end.pose, likely_covariance(spread, end.pose, agreed.odds_ratio), start)
            if found is not None:
                mean = Judged(judge.name, judge.unit, *final.judge.costs([start, found[0]]))
                if mean.estimate < mean.start:
                    weight = self._weight(end.pose, told, found[0])
                    pose, told, judged = found[0], accuracy_of(found[1], agreed), mean
        if covariance is None and end.solution is not None:
            covariance = end.solution.covariance
        return Result(
            frames=tuple(view.name for view in views),
            start=start,
            camera_from_lidar=pose,
            status=end.status,
            reason=end.reason,
            rounds=end.rounds,
            covariance=covariance,
            accuracy=None if told is None else or_rival(told, rival, options.min_lead_edges),
            matches={} if end.problem is None else counts(end.problem),
            residual_px={} if end.problem is None else mean_residuals_px(end.problem, pose),
            judged=judged,
            agreement=agreed,
            rival=rival,
            verdict=verdict_of(
                agreed, rival, final.cameras, options, told, places=final.places if judge.name == DIRECTED else None
            ),
            cameras=at_full_size(final.cameras, views),
            motions=final.nuisance.sweep_motions(views),
            time=final.time,
            start_weight=weight,
            warnings=(*remarks_of(views), *still),
            seconds=clock.seconds,
        )

    def _with_start(self, pose: Float, likely: Float, start: Float) -> tuple[Float, Float] | None:
        """Return what edges and start say together, or None where the initializer does not say how good starts are."""
        sigma = getattr(self.initializer, "start_sigma", None)
        return None if sigma is None else with_start(pose, likely, start, sigma)

    def _weight(self, pose: Float, accuracy: Accuracy, mean: Float) -> StartWeight:
        """Return what the start was worth: the pose (4, 4) of the edges alone, and the step to the mean."""
        sigma_deg, sigma_m = self.initializer.start_sigma  # type: ignore[attr-defined]
        step = se3.inverse(pose) @ mean
        return StartWeight(sigma_deg, sigma_m, pose, accuracy, se3.angle_deg(step), se3.distance_m(step))

    def _refined(
        self, rounds: Rounds, seen: Sequence[View], start: Float, poses: Sequence[Float]
    ) -> tuple[list[End], Judge]:
        """Return where the rounds from each pose that an initializer proposes end, and what judges them."""
        options = self.options
        reach = {"truncate_px": options.judge_px, "reach_px": options.min_reach_px}
        judge = judge_of(self.matcher, self.needs, seen, start, poses, **reach)
        # Basins come best first; the given start among them is only tried when nothing else was proposed.
        found = [pose for pose in poses if not np.allclose(pose, start, atol=1e-12)]
        ends = [
            rounds(seen, start, pose, judge, reach_px=options.reach_after_search_px, found_by="initialize")
            for pose in found
        ] or [rounds(seen, start, start, judge, reach_px=options.reach_px)]
        return ends, judge

    def _seen(self, view: View, start: Float) -> View:
        """Return the view without edges that the camera cannot see, sides told in image axes."""
        return (view.as_seen_from(start) if self.directed else view).without_hidden(start)


@dataclass
class Clock:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Count what happens within as seconds of a stage."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - began


def missing_features(views: Sequence[View], start: Float, needs: frozenset[str]) -> tuple[Status, str] | None:
    """Return why there is nothing to match, or None; `needs` are the words of the methods, also those of no features.

    Image edges come before LiDAR edges, and edges before other kinds; then whether the camera can see any of them.
    """
    kinds = sorted((word for word in needs if word.startswith(("image-", "cloud-"))), key=_edges_first)
    for word in kinds:
        if not any(view.count(word) for view in views):
            sensor, _, what = word.partition("-")
            where = "image" if sensor == "image" else "sweep"
            status = Status.NO_EDGES if what == "edges" else Status.NO_FEATURES
            return status, f"no {what} were found in the {where}"
    for word in kinds:
        if not word.startswith("cloud-"):
            continue
        places = [(view.camera, feature.places) for view in views if (feature := view.get(word)) is not None]
        known = [(camera, xyz) for camera, xyz in places if xyz is not None]
        if known and not any(np.isfinite(camera.project(se3.apply(start, xyz))).any() for camera, xyz in known):
            what = "edge" if word == "cloud-edges" else "feature"
            status = Status.NO_EDGES if what == "edge" else Status.NO_FEATURES
            return status, f"every LiDAR {what} lies behind the camera: is the start the transform lidar_from_camera?"
    return None


def remarks_of(views: Sequence[View]) -> tuple[str, ...]:
    """Return what the cloud extractors had to say about the sweeps, each named by its frame."""
    said = ((view.name, view.get(CloudRemarks.word)) for view in views)
    return tuple(f"{name}: {text}" for name, remarks in said if remarks is not None for text in remarks.texts)


_FAR_DEG, _FAR_M = 6.0, 0.5
"""A pose that is further from the start sees other surfaces and may name other directions."""


def _far(pose: Float, start: Float) -> bool:
    return se3.angle_deg(pose @ se3.inverse(start)) > _FAR_DEG or _apart_m(pose, start) > _FAR_M


def _apart_m(pose: Float, other: Float) -> float:
    """Return how far apart two poses put the camera."""
    return float(np.linalg.norm(se3.inverse(pose)[:3, 3] - se3.inverse(other)[:3, 3]))


def _best(ends: Sequence[End], judge: Judge) -> End:
    return ends[int(np.argmin(judge.costs([end.pose for end in ends])))]


def _edges_first(word: str) -> tuple[bool, bool, str]:
    return not word.endswith("-edges"), not word.startswith("image-"), word


def _no_better(judged: Judged) -> str:
    what = "the directed edge distance" if judged.unit == "px" else "the cost"
    unit = f" {judged.unit}" if judged.unit == "px" else ""
    return (
        f"{what} did not fall below that of the start "
        f"({judged.estimate:.3f}{unit} against {judged.start:.3f}{unit}): the start is returned"
    )
