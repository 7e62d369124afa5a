"""Algorithm 1 of the paper: extract, initialize, then match and solve in rounds with a shrinking cutting distance."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from pydantic import field_validator

from p2o.arrays import Float
from p2o.calibration.accuracy import likely_accuracy
from p2o.calibration.adjustment import Adjustment, MotionFit, adjust
from p2o.calibration.agreement import agreement
from p2o.calibration.camera_check import checks_of, doubt, tells_more
from p2o.features.edges import ImageFeatures
from p2o.features.missing import RADIUS_PX, frame_rng, without_patches
from p2o.features.side import Side
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.ego_motion import EgoMotion, MotionPrior
from p2o.geometry.radial_error import RadialError
from p2o.geometry.visibility import hidden
from p2o.host.options import Options
from p2o.host.options import field as option
from p2o.host.stages import CloudExtractor, ImageExtractor, Initializer, Matcher, Solver
from p2o.problems.directed_cost import DirectedCost
from p2o.problems.point_to_line import PointToLine, Problem
from p2o.results.evidence import Agreement, Judged, Rival
from p2o.results.result import DIRECTED, CameraCheck, Result, Round, Solution, SolverStatus, Status, SweepMotion
from p2o.results.verdict import Doubt, Reason, Verdict


class PipelineOptions(Options):
    """Options of Algorithm 1 itself."""

    rounds: int = option(10, ge=1, le=100, help="Largest number of match-and-solve rounds (paper: n_opt = 10).")
    reach_px: float = option(50.0, gt=1, le=500, help="First cutting distance d_c from the given start (paper: 50).")
    reach_after_search_px: float = option(
        12.0, gt=1, le=500, help="First cutting distance from a pose that an initializer has found."
    )
    shrink: float = option(0.7, gt=0.1, lt=1, help="Factor on the cutting distance from round to round.")
    min_reach_px: float = option(5.0, gt=0.5, le=100, help="Smallest cutting distance.")
    min_matches: int = option(30, ge=6, help="Fewer pairs than this end a calibration as too-few-matches.")
    judge_px: float = option(5.0, gt=1, le=100, help="Truncation of the directed distance that poses are judged by.")
    min_odds_ratio: float = option(6.0, ge=0, help="A lower agreement of both sensors' edges is called doubtful.")
    min_lead_edges: float = option(
        1.5, ge=0, help="A result that another pose comes nearer to than by this many edges is called ambiguous."
    )
    camera: Literal["trust", "check", "refine"] = option(
        "check",
        help="The camera's calibration: trust it; check its focal length and radial distortion against the edges, and "
        "warn; or refine: correct them along with the pose (with many frames together).",
    )
    motion: Literal["trust", "estimate"] = option(
        "estimate",
        help="Sweeps as measured, whose points have times: trust them, as of a car that stands; or estimate how the "
        "car moves during each of them, along with the pose. Sweeps that were corrected for motion stay as they are.",
    )
    forward: tuple[float, float, float] = option(
        (1.0, 0.0, 0.0), help="Direction of travel in the LiDAR frame, for `motion`; its z axis is up."
    )
    speed_m_s: float = option(8.0, ge=-60, le=60, help="Forward speed of the car that `motion` begins from.")
    speed_sigma_m_s: float = option(8.0, gt=0, le=60, help="Standard deviation of the true speed from it.")
    turn_sigma_deg_s: float = option(6.0, gt=0, le=90, help="Standard deviation of the car's turning rate from zero.")
    tolerance_deg: float = option(1e-3, ge=0, help="A smaller turn (and shift) in the last round means converged.")
    tolerance_m: float = option(1e-3, ge=0, help="A smaller shift (and turn) in the last round means converged.")
    missing_edges: float = option(
        0.0, ge=0, le=0.95, help="Share of the image edges that random circle patches take away (paper Sec. IV-B)."
    )
    missing_radius_px: float = option(RADIUS_PX, gt=0, le=1000, help="Radius of such a patch.")
    seed: int = option(0, ge=0, help="Seed of the patches.")

    @field_validator("forward")
    @classmethod
    def _somewhere(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not (np.isfinite(value).all() and any(value)):
            raise ValueError("a direction of three finite numbers, not all zero")
        return value


@dataclass
class _Clock:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - began


@dataclass(frozen=True)
class _Refined:
    """Where the rounds from one start ended."""

    pose: Float
    cost_px: float
    status: Status
    reason: str
    rounds: tuple[Round, ...]
    problem: PointToLine | None = None
    solution: Solution | None = None

    @property
    def covariance(self) -> Float | None:
        """The covariance (6, 6) that the solver gives."""
        return None if self.solution is None else self.solution.covariance


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """What was found, with all that the edges tell beside the pose; `covariance` (6, 6) of it where they can tell."""

    found: _Refined
    at_start: float
    state: _State
    cameras: tuple[CameraCheck, ...] = ()
    covariance: Float | None = None


@dataclass(frozen=True)
class _State:
    """What is known of views beside the pose: errors of their cameras, and motions, one a view or none."""

    errors: Mapping[Camera, RadialError] = field(default_factory=dict)
    motions: tuple[MotionFit, ...] = ()

    @classmethod
    def expected(cls, views: Sequence[View], prior: MotionPrior | None) -> _State:
        """Return what is known before the edges are asked."""
        return cls() if prior is None else cls(motions=(MotionFit(prior.expected, prior.covariance),) * len(views))

    def adjusted(
        self,
        problem: PointToLine,
        cameras_given: tuple[Camera, ...],
        pose: Float,
        prior: MotionPrior | None,
        *,
        cameras: bool,
    ) -> Adjustment:
        """Return what pairs of `views` tell beside the pose, beginning from this state."""
        motions = [fit.motion for fit in self.motions]
        pairs = replace(problem, cameras=cameras_given)
        return adjust(pairs, pose, cameras=cameras, known=self.errors, prior=prior, motions=motions)

    def after(self, fit: Adjustment) -> _State:
        """Return what an adjustment found."""
        return _State(dict(self.errors) | {c.camera: c.error for c in fit.cameras}, fit.motions)

    def views(self, measured: Sequence[View]) -> list[View]:
        """Return views as measured with their cameras corrected and their edges as if seen at one time."""
        if self.motions:
            measured = [view.untwisted(fit.motion.twist) for view, fit in zip(measured, self.motions, strict=True)]
        cameras = [self.errors.get(view.camera, RadialError()).corrected(view.camera) for view in measured]
        return [replace(view, camera=camera) for view, camera in zip(measured, cameras, strict=True)]


@dataclass(frozen=True)
class Pipeline:
    """The staged calibrator: the paper's method with every part replaceable.

    Calling it with frames and a start camera_from_lidar (4, 4) gives a Result. With `directed` False every direction
    is forgotten right after extraction, so that no stage of an ablation without directions can profit from them.
    """

    image_extractor: ImageExtractor
    cloud_extractor: CloudExtractor
    matcher: Matcher
    solver: Solver
    initializer: Initializer
    options: PipelineOptions = field(default_factory=PipelineOptions)
    directed: bool = True

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        """Calibrate the frames jointly; one frame is the ordinary case."""
        clock = _Clock()
        with clock.of("extract"):
            views = [self.extract(frame) for frame in frames]
        result = self.solve(views, camera_from_lidar)
        warnings = tuple(f"{frame.name}: {text}" for frame in frames for text in frame.warnings)
        return replace(result, seconds={**clock.seconds, **result.seconds}, warnings=(*warnings, *result.warnings))

    def extract(self, frame: Frame) -> View:
        """Return the features of one frame; the truth is not looked at."""
        frame = frame.without_truth()
        image = self._patched(self.image_extractor(frame.image), frame)
        view = View(frame.name, frame.camera, image, self.cloud_extractor(frame.cloud))
        return view if self.directed else view.without_sides()

    def _patched(self, image: ImageFeatures, frame: Frame) -> ImageFeatures:
        """Return the image features without the edges that the options take away."""
        options, camera = self.options, frame.camera
        if options.missing_edges == 0 or image.edges is None:
            return image
        rng, radius_px = frame_rng(options.seed, frame.name), options.missing_radius_px
        edges = without_patches(
            image.edges, camera.width, camera.height, options.missing_edges, rng, radius_px=radius_px
        )
        return replace(image, edges=edges)

    def solve(self, views: Sequence[View], camera_from_lidar: Float) -> Result:
        """Return the joint calibration of extracted views from a start (4, 4)."""
        start = se3.check_rigid("start", camera_from_lidar)
        names = tuple(view.name for view in views)
        clock = _Clock()

        def refused(status: Status, reason: str, rounds: tuple[Round, ...] = ()) -> Result:
            return Result(names, start, start, status, reason, rounds, seconds=clock.seconds)

        missing = _missing_edges(views, start)
        if missing:
            return refused(Status.NO_EDGES, missing)
        prior = self._motion_prior(views)
        with clock.of("initialize"):
            measured = [self._seen(view, start) for view in views]
            state = _State.expected(measured, prior)
            seen = state.views(measured)
            poses = self.initializer(seen, start) or [start]
        with clock.of("refine"):
            judge = DirectedCost.of(seen, start, self.options.judge_px, margin_px=_margin_px(seen, start, poses))
            at_start = judge.at(start)
            # Basins come best first; the given start among them is only tried when nothing else was proposed.
            moved = [pose for pose in poses if not np.allclose(pose, start, atol=1e-12)] or [start]
            tried = [self._refine(seen, start, pose, judge) for pose in moved]
        best = min(tried, key=lambda r: (not r.status.solved, r.cost_px))
        if not best.status.solved:
            return refused(best.status, best.reason, best.rounds)
        rival = _rival(tried, best, judge)
        with clock.of("adjust"):
            adjusted = self._adjusted(measured, start, best, at_start, state, prior)
            best, at_start, state = adjusted.found, adjusted.at_start, adjusted.state
            seen = state.views(measured)
        judged = Judged(DIRECTED, "px", at_start, best.cost_px)
        if not best.cost_px < at_start:
            reason = (
                f"the directed edge distance did not fall below that of the start "
                f"({best.cost_px:.3f} px against {at_start:.3f} px): the start is returned"
            )
            return replace(refused(Status.NO_IMPROVEMENT, reason, best.rounds), judged=judged)
        with clock.of("agree"):
            agreed = agreement(seen, best.pose)
        return Result(
            frames=names,
            start=start,
            camera_from_lidar=best.pose,
            status=best.status,
            reason=best.reason,
            rounds=best.rounds,
            covariance=best.covariance if adjusted.covariance is None else adjusted.covariance,
            accuracy=None
            if adjusted.covariance is None
            else likely_accuracy(adjusted.covariance, best.pose, agreed.odds_ratio),
            matches={} if best.problem is None else _counts(best.problem),
            residual_px={} if best.problem is None else _mean_residuals(best.problem, best.pose),
            judged=judged,
            agreement=agreed,
            rival=rival,
            verdict=Verdict((*self._doubts(agreed, rival), *filter(None, map(doubt, adjusted.cameras)))),
            cameras=adjusted.cameras,
            motions=_motions(views, state.motions),
            seconds=clock.seconds,
        )

    def _motion_prior(self, views: Sequence[View]) -> MotionPrior | None:
        """Return what is expected of the car's motion, or None where it is not asked for or no sweep tells any."""
        options = self.options
        if options.motion == "trust" or not any(view.cloud_edges.time_s.any() for view in views):
            return None
        expected = EgoMotion(options.speed_m_s, 0.0, options.forward)
        return MotionPrior(expected, options.speed_sigma_m_s, float(np.radians(options.turn_sigma_deg_s)))

    def _adjusted(
        self,
        measured: Sequence[View],
        start: Float,
        found: _Refined,
        at_start: float,
        state: _State,
        prior: MotionPrior | None,
    ) -> _Adjusted:
        """Return what was found with all that the edges say beside the pose.

        Motion of the sweeps and, with the option `refine`, errors of the cameras are found along with the pose, with
        new pairs in every round until these hardly move; then the pose is what matcher and solver make of it. Where its
        cost is not below that of what was found before, nothing is changed: few pairs fit any motion.
        """
        options, given = self.options, tuple(view.camera for view in measured)
        if not tells_more(found.problem):
            return _Adjusted(found, at_start, state, (), self._covariance(found, given, state, prior))
        refines, fit = options.camera == "refine", None
        if refines or prior is not None:
            pose, then, reach = found.pose, state, options.min_reach_px * _ADJUST_REACH
            for _ in range(_ADJUST_ROUNDS):
                problem = self.matcher(then.views(measured), pose, reach)
                if not tells_more(problem):
                    break
                fit = then.adjusted(problem, given, pose, prior, cameras=refines)
                pose, then = fit.camera_from_lidar, then.after(fit)
                if fit.step_px < _STILL_PX and reach <= options.min_reach_px:
                    break
                reach = max(options.min_reach_px, reach * _ADJUST_SHRINK)
            views = then.views(measured)
            judge = DirectedCost.of(views, start, options.judge_px, margin_px=_margin_px(measured, start, [pose]))
            near = replace(self, options=options.model_copy(update={"reach_after_search_px": options.min_reach_px}))
            end = near._refine(views, start, pose, judge, "adjust")
            if fit is not None and end.status.solved and end.cost_px < found.cost_px and tells_more(end.problem):
                found = replace(end, rounds=found.rounds + end.rounds)
                at_start, state = judge.at(start), then
            else:
                fit = None
        if refines and fit is not None:
            checks = checks_of(fit.cameras, given, corrected=True)
            return _Adjusted(found, at_start, state, checks, fit.covariance)
        assert found.problem is not None
        fit = state.adjusted(found.problem, given, found.pose, prior, cameras=options.camera != "trust")
        return _Adjusted(found, at_start, state, checks_of(fit.cameras, given, corrected=False), fit.covariance)

    def _covariance(
        self, found: _Refined, given: tuple[Camera, ...], state: _State, prior: MotionPrior | None
    ) -> Float | None:
        """Return the covariance (6, 6) of what was found from so few pairs that nothing else is asked of them."""
        if found.problem is None:
            return None
        return state.adjusted(
            found.problem, given, found.pose, prior, cameras=self.options.camera != "trust"
        ).covariance

    def _doubts(self, agreed: Agreement, rival: Rival | None) -> tuple[Reason, ...]:
        """Return reasons where the edges do not seem to belong together, or fit elsewhere as well."""
        doubts: tuple[Reason, ...] = ()
        if rival is not None and rival.lead < self.options.min_lead_edges:
            away = f"{rival.rotation_deg:.2f} deg and {rival.translation_m:.2f} m away"
            text = (
                f"another pose, {away}, fits as well but for {rival.lead:.1f} edges; take more frames together, or a "
            )
            doubts = (Reason(Doubt.RIVAL_POSE, text + "a nearer start"),)
        if agreed.odds_ratio >= self.options.min_odds_ratio:
            return doubts
        return (
            *doubts,
            Reason(
                Doubt.LITTLE_AGREEMENT,
                "image and LiDAR edges meet little more often than by chance (odds ratio "
                f"{agreed.odds_ratio:.1f}, {self.options.min_odds_ratio:g} or more is usual at a right pose); look at "
                "the overlay, and check that image and sweep belong to the same moment",
            ),
        )

    def _seen(self, view: View, start: Float) -> View:
        """Return the view without edges that the camera cannot see, sides told in image axes."""
        if self.directed:
            view = view.as_seen_from(start)
        edges, surface = view.cloud.edges, view.cloud.points
        if edges is None or surface is None or not len(edges):
            return view
        keep = ~hidden(edges.xyz, surface, view.camera, start)
        return replace(view, cloud=replace(view.cloud, edges=edges.select(keep)))

    def _refine(
        self, views: Sequence[View], start: Float, pose: Float, judge: DirectedCost, found_by: str = "initialize"
    ) -> _Refined:
        """Return the end of the match-and-solve rounds from `pose`; a pose is kept only where its cost falls."""
        options = self.options
        searched = pose is not start
        rounds: list[Round] = []
        best_pose, best_cost = pose, judge.at(pose)
        if searched:
            step = pose @ se3.inverse(start)
            rounds.append(
                Round(found_by, 0.0, {}, float("nan"), best_cost, se3.angle_deg(step), se3.distance_m(step), True)
            )
        reach = options.reach_after_search_px if searched else options.reach_px
        status, reason = Status.ROUNDS_SPENT, f"all {options.rounds} rounds were used"
        solution: Solution | None = None
        improved = False
        stopped: Status | None = None
        for _ in range(options.rounds):
            problem = self.matcher(views, pose, reach)
            if isinstance(problem, PointToLine) and len(problem) < options.min_matches:
                reason = f"{len(problem)} pairs within {reach:.0f} px, at least {options.min_matches} are needed"
                stopped = Status.TOO_FEW_MATCHES
                break
            solution = self.solver(problem, pose)
            if solution.status is SolverStatus.SINGULAR:
                stopped, reason = Status.NOT_OBSERVABLE, solution.reason
                break
            step = solution.camera_from_lidar @ se3.inverse(pose)
            pose = solution.camera_from_lidar
            cost = judge.at(pose)
            better = cost < best_cost
            if better:
                best_pose, best_cost, improved = pose, cost, True
            rounds.append(
                Round(
                    stage="refine",
                    reach_px=reach,
                    matches=_counts(problem),
                    mean_residual=_mean_residual(problem, pose),
                    cost=cost,
                    step_deg=se3.angle_deg(step),
                    step_m=se3.distance_m(step),
                    accepted=better,
                )
            )
            still = se3.angle_deg(step) < options.tolerance_deg and se3.distance_m(step) < options.tolerance_m
            if still and reach <= options.min_reach_px:
                status, reason = Status.CONVERGED, "the last round moved the pose by less than the tolerance"
                break
            reach = max(options.min_reach_px, reach * options.shrink)
        if stopped is not None and not improved:
            return _Refined(start, np.inf, stopped, reason, tuple(rounds))
        if searched and not improved:
            reason += f"; no round improved on the pose of the stage {found_by}"
        # A later round that has too little to go on does not take back what an earlier one found.
        last = self.matcher(views, best_pose, options.min_reach_px)
        final = last if isinstance(last, PointToLine) and len(last) else None
        return _Refined(best_pose, best_cost, status, reason, tuple(rounds), final, solution)


_RIVAL_DEG, _RIVAL_M = 0.5, 0.3


def _rival(tried: Sequence[_Refined], best: _Refined, judge: DirectedCost) -> Rival | None:
    """Return how much worse the next best end is that is not the place of the best, and how far away; or nothing."""
    ends = []
    for end in tried:
        step = se3.inverse(end.pose) @ best.pose
        if end.status.solved and (se3.angle_deg(step) > _RIVAL_DEG or se3.distance_m(step) > _RIVAL_M):
            ends.append((end.cost_px, step))
    if not ends:
        return None
    cost, step = min(ends, key=lambda end: end[0])
    worse = (cost - best.cost_px) * judge.edges / judge.truncate_px
    return Rival(worse, "edges", se3.angle_deg(step), se3.distance_m(step))


def _motions(views: Sequence[View], fits: Sequence[MotionFit]) -> tuple[SweepMotion, ...]:
    """Return the motions of those views whose sweeps are as measured."""
    found = []
    for view, fit in zip(views, fits, strict=bool(fits)):
        if view.cloud_edges.time_s.any():
            motion, (speed_sigma, turn_sigma) = fit.motion, np.sqrt(np.diag(fit.covariance)).tolist()
            turn = float(np.degrees(motion.turn_rad_s)), float(np.degrees(turn_sigma))
            found.append(SweepMotion(view.name, motion.speed_m_s, speed_sigma, *turn, tuple(motion.twist.tolist())))
    return tuple(found)


_ADJUST_ROUNDS = 12
_ADJUST_REACH, _ADJUST_SHRINK = 1.6, 0.85
_STILL_PX = 0.05


def _missing_edges(views: Sequence[View], start: Float) -> str:
    """Return why there is nothing to match, or an empty string."""
    if not any(len(view.image_edges) for view in views):
        return "no edges were found in the image"
    if not any(len(view.cloud_edges) for view in views):
        return "no edges were found in the sweep"
    projected = [view.camera.project(se3.apply(start, view.cloud_edges.xyz)) for view in views]
    if not any(np.isfinite(uv).any() for uv in projected):
        return "every LiDAR edge lies behind the camera: is the start the transform lidar_from_camera?"
    return ""


def _margin_px(views: Sequence[View], start: Float, poses: Sequence[Float]) -> float:
    """Return how far outside the image a point may start and still be brought in by one of the poses."""
    widest = max((se3.angle_deg(pose @ se3.inverse(start)) for pose in poses), default=0.0)
    return float(max(view.camera.focal_px for view in views) * np.tan(np.radians(min(widest, 60.0))))


def _counts(problem: Problem) -> dict[str, int]:
    if not isinstance(problem, PointToLine):
        return {}
    return {Side(int(s)).letter: int(n) for s, n in zip(*np.unique(problem.side, return_counts=True), strict=True)}


def _mean_residuals(problem: PointToLine, pose: Float) -> dict[str, float]:
    residuals = np.abs(problem.residuals(pose))
    return {
        Side(int(s)).letter: float(np.nanmean(residuals[problem.side == s])) for s in np.unique(problem.side).tolist()
    }


def _mean_residual(problem: Problem, pose: Float) -> float:
    if not isinstance(problem, PointToLine) or not len(problem):
        return float("nan")
    return float(np.nanmean(np.abs(problem.residuals(pose))))
