"""Calibrate all cameras of a rig in one problem: the unknown is body_from_lidar, the edges are those of all cameras.

Every camera keeps its own matching, judging and error budget, at camera_from_body @ body_from_lidar; residuals, costs
and their derivatives are summed (`p2o.problems.rig_residuals`, `p2o.calibration.rig_judge`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from p2o.arrays import Float
from p2o.calibration.algorithm import EDGES, Estimate, Refined, VisibleViews
from p2o.calibration.judge import SIGMA_PX, is_sparse, judge_of
from p2o.calibration.nuisance import NuisanceEstimate, enough_pairs
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rig_judge import RIG_STEPS, RigJudge
from p2o.calibration.rounds import REACH_AFTER_SEARCH_PX, End, Rounds
from p2o.confidence.assessment import assess
from p2o.confidence.fusion import WIDER, Fusion, Opinion, compared, contradictions, rig_result
from p2o.confidence.verdict import rival_of, verdict_of
from p2o.errors import InputError
from p2o.features.side import Side
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale
from p2o.geometry import se3
from p2o.geometry.pose_error import deviations
from p2o.host.stages import JudgeBase
from p2o.problems.interval_likelihood import IntervalLikelihood, most_likely_near
from p2o.problems.problem import LeastSquares, Problem
from p2o.problems.rig_residuals import RigResiduals
from p2o.results.evidence import Accuracy, Agreement
from p2o.results.result import Result, RigCamera, RigResult, Status
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.run.assembly import Assembly
from p2o.run.pipeline import Pipeline
from p2o.run.rig_motion import compensated

_LEVELS_PX = (8.0, 4.0, SIGMA_PX)
"""Standard deviations of image edges at which the interval likelihood is maximised, from wide to narrow."""
_MOST_INTERVALS, _MARGIN_PX = 2000, 60.0
"""Edges of each camera, and how far outside the image they may be projected."""


@dataclass(frozen=True, eq=False)
class RigCameraFrames:
    """One camera of a rig: its frames, its pose camera_from_body (4, 4), and its own result."""

    name: str
    frames: Sequence[Frame]
    camera_from_body: Float
    result: Result


@dataclass(frozen=True, eq=False)
class _Camera:
    """The prepared views of a camera, with `pipeline` and `visible` views at the initial guess; `start` is that.

    `place` is camera_from_body (4, 4), `own` the result of the camera alone.
    """

    name: str
    place: Float
    own: Result
    views: Sequence[View]
    pipeline: Pipeline
    start: Float
    visible: VisibleViews

    @classmethod
    def of(cls, camera: RigCameraFrames, pipeline: Pipeline, body_from_lidar: Float) -> _Camera:
        """Prepare the frames of a camera, compensated for the motions that its own result reports."""
        motions = {motion.frame: motion for motion in camera.result.motions}
        pipeline = replace(pipeline, options=compensated(pipeline.options, tuple(motions.values())))
        views = []
        for frame in camera.frames:
            view, known = pipeline.prepare(frame), camera.result.twist_of(frame.name)
            view = view if known is None else view.untwisted(known)
            corrected = camera.result.camera_of(frame.camera)
            views.append(view if corrected == frame.camera else replace(view, camera=camera_at_scale(corrected)))
        place, start = camera.camera_from_body, camera.camera_from_body @ body_from_lidar
        visible = pipeline.visible(views, start)
        return cls(camera.name, place, camera.result, views, pipeline, start, visible)

    @cached_property
    def corrected(self) -> list[View]:
        """The visible views, corrected for the motions that are expected."""
        return self.visible.corrected

    def judge(self, poses: Sequence[Float], *, sparse: bool) -> JudgeBase:
        """Return the judge of poses body_from_lidar (4, 4) by the edges of this camera."""
        options = self.pipeline.options
        return judge_of(
            self.pipeline.matcher,
            EDGES,
            self.corrected,
            self.start,
            [self.place @ pose for pose in poses],
            truncate_px=options.judge_px,
            reach_px=options.min_reach_px,
            interval_deg=0.0 if sparse else 90.0,
        )

    def match(self, body_from_lidar: Float, reach_px: float) -> Problem:
        """Return the pairs of this camera at a pose."""
        return self.pipeline.matcher(self.corrected, self.place @ body_from_lidar, reach_px)

    def assessed(self, body_from_lidar: Float, judge: JudgeBase) -> Result:
        """Return the assessment of the common pose by the edges of this camera alone."""
        options, pose = self.pipeline.options, self.place @ body_from_lidar
        nuisance, raw = self.visible.nuisance, self.visible.raw
        problem = self.match(body_from_lidar, options.min_reach_px)
        end = End(pose, Status.CONVERGED, "", (), problem if enough_pairs(problem) else None)
        final = NuisanceEstimate(end, judge, nuisance)
        if end.pairs is not None:
            cameras = tuple(view.camera for view in raw)
            fit = nuisance.fit(end.pairs, cameras, pose, fits_cameras=options.camera != "trust")
            final = replace(final, covariance=fit.covariance, places=fit.places)
            if options.camera == "check":
                final = replace(final, intrinsics=nuisance.intrinsics(raw, pose, judge.camera_errors))
        refined = Refined(self.visible, self.start, [end], judge)
        return assess(Estimate(refined, final), self.views, options, None)


def solve_rig(
    assembly: Assembly, cameras: Sequence[RigCameraFrames], camera_from_body: Mapping[str, Float]
) -> RigResult:
    """Return the common result of cameras with places camera_from_body (4, 4); those without frames have no result.

    It is one calibration of all edges if the methods are a pipeline of directed edges with residuals, and two cameras
    have edges. It begins from the results of the cameras, their mean and the mean of their initial guesses; the pose of
    the lowest cost over all cameras is the result. Its predicted error is that of the information-weighted fusion of
    the error budgets of the cameras at the common pose. Otherwise, or if the edges do not agree better than at the
    initial guess, it is the mean of the results (`p2o.confidence.fusion`).
    """
    mean = rig_result({camera.name: camera.result for camera in cameras}, camera_from_body)
    pipeline = assembly.calibrator
    if not isinstance(pipeline, Pipeline) or not pipeline.needs >= EDGES or not pipeline.directed or len(cameras) < 2:
        return mean
    if any(camera.result.later_s for camera in cameras):
        return mean
    start = mean_pose([se3.inverse(camera.camera_from_body) @ camera.result.start for camera in cameras])
    prepared = [_Camera.of(camera, pipeline, start) for camera in cameras]
    seeing = [one for one in prepared if any(v.count("image-edges") and v.count("cloud-edges") for v in one.corrected)]
    if len(seeing) < 2:
        return mean
    solved = _Solved.of(seeing, pipeline, start, _proposals(cameras, mean, start))
    if solved is None:
        return mean
    return solved.result(mean, camera_from_body)


def mean_pose(poses: Sequence[Float]) -> Float:
    """Return the mean (4, 4) of poses on SE(3), all of equal weight; a single pose is returned unchanged."""
    if len(poses) == 1:
        return poses[0]
    return Fusion.of([Opinion("", pose, np.eye(6)) for pose in poses]).body_from_lidar


def _proposals(cameras: Sequence[RigCameraFrames], mean: RigResult, start: Float) -> list[Float]:
    """Return the poses (4, 4) of the LiDAR on the body to refine: the mean, the cameras' own and the initial one."""
    own = [
        se3.inverse(camera.camera_from_body) @ camera.result.camera_from_lidar
        for camera in cameras
        if camera.result.status.solved
    ]
    poses = [] if mean.body_from_lidar is None else [mean.body_from_lidar]
    return [*poses, *own, *([mean_pose(own)] if len(own) > 1 else []), start]


@dataclass(frozen=True, eq=False)
class _Solved:
    """The best pose of the common problem with its judge; `ends` are those of all proposals."""

    cameras: Sequence[_Camera]
    options: PipelineOptions
    start: Float
    judge: RigJudge
    best: End
    ends: Sequence[End]

    @classmethod
    def of(
        cls, cameras: Sequence[_Camera], pipeline: Pipeline, start: Float, proposals: Sequence[Float]
    ) -> _Solved | None:
        """Refine the proposals (4, 4) by the edges of all cameras; None where no pose costs less than the start."""
        sparse = is_sparse([view for camera in cameras for view in camera.corrected], pipeline.options.interval_deg)
        poses = [_most_likely(cameras, proposals), *proposals] if sparse else list(proposals)
        judges = tuple(camera.judge(poses, sparse=sparse) for camera in cameras)
        judge = RigJudge(
            tuple(camera.place for camera in cameras), judges, tuple(len(camera.views) for camera in cameras)
        )

        def match(views: Sequence[View], pose: Float, reach_px: float) -> Problem:
            problems = [(camera.place, camera.match(pose, reach_px)) for camera in cameras]
            parts = [(place, its) for place, its in problems if isinstance(its, LeastSquares) and len(its)]
            return RigResiduals(tuple(parts))

        rounds = Rounds(match, pipeline.solver, pipeline.options)
        ends = []
        for pose in poses:
            end = rounds((), start, pose, judge, reach_px=REACH_AFTER_SEARCH_PX, found_by="initialize")
            if end.status.solved:
                ends.append(end)
        if not ends:
            return None
        costs = judge.costs([end.pose for end in ends])
        best = ends[int(np.argmin(costs))]
        if not min(costs) < judge.costs([start])[0]:
            return None
        return cls(cameras, pipeline.options, start, judge, best, ends)

    def result(self, mean: RigResult, places: Mapping[str, Float]) -> RigResult:
        """Return the result at the best pose, with the comparison of the cameras' own results of `mean`."""
        from scipy.stats import chi2

        pose, opinions, reasons, agreements = self.best.pose, [], [], []
        for camera, judge in zip(self.cameras, self.judge.judges, strict=True):
            its = camera.assessed(pose, judge)
            try:
                opinions.append(Opinion.of(camera.name, its, camera.place))
            except InputError:
                continue
            doubts = [reason for reason in its.verdict.reasons if reason.doubt is Doubt.CAMERA]
            reasons += [Reason(Doubt.CAMERA, f"{camera.name}: {reason.text}") for reason in doubts]
            agreements += [] if its.agreement is None else [its.agreement]
        if not opinions:
            return mean
        covariance = Fusion.of(opinions).covariance
        beside = {camera.name: self._beside(camera, covariance) for camera in self.cameras}
        alone = [beside[camera.name] for camera in self.cameras if camera.own.verdict.trusted]
        chi_squares = [one.chi_square for one in alone if one.chi_square is not None]
        chi_square, degrees = float(sum(chi_squares)), 6 * len(chi_squares)
        p_value = float(chi2.sf(chi_square, degrees)) if degrees else None
        if p_value is not None:
            words = {"whose": "trusted results of single cameras", "other": "the common result"}
            reasons += contradictions(alone, chi_square, degrees, p_value, **words)
        covariance = covariance * max(1.0, chi_square / max(degrees, 1))
        rotation_deg, translation_m = deviations(covariance, pose)
        accuracy = Accuracy(rotation_deg, translation_m, WIDER * rotation_deg, WIDER * translation_m)
        rival = rival_of(self.ends, self.best, self.judge)
        verdict = verdict_of(_together(agreements), rival, (), self.options, accuracy)
        left_out = {one.name: one.left_out or "it has no edges of both sensors" for one in mean.cameras}
        return RigResult(
            pose,
            f"one calibration of the edges of {len(self.cameras)} cameras",
            Verdict((*verdict.reasons, *reasons)),
            tuple(beside.get(n, RigCamera(n, place @ pose, left_out=left_out[n])) for n, place in places.items()),
            covariance=covariance,
            accuracy=accuracy,
            chi_square=chi_square,
            degrees=degrees,
            p_value=p_value,
        )

    def _beside(self, camera: _Camera, covariance: Float) -> RigCamera:
        """Compare the own result of a camera with the common pose, whose covariance (6, 6) is given."""
        common = camera.place @ self.best.pose
        try:
            own = Opinion.of(camera.name, camera.own, camera.place)
        except InputError:
            return RigCamera(camera.name, common)
        return compared(own, self.best.pose, covariance, common)


def _most_likely(cameras: Sequence[_Camera], proposals: Sequence[Float]) -> Float:
    """Return the pose (4, 4) of the highest interval likelihood over all cameras, from wide to narrow image edges.

    It begins from the best of the proposals by the likelihood of the widest edges.
    """
    pose = proposals[0]
    shares: list[Mapping[Side, float] | None] = [None] * len(cameras)
    for level, sigma_px in enumerate(_LEVELS_PX):
        parts = []
        for number, camera in enumerate(cameras):
            around = camera.place @ pose
            likelihood = IntervalLikelihood.of(
                camera.corrected,
                around,
                sigma_px,
                margin_px=_MARGIN_PX,
                max_points=_MOST_INTERVALS,
                shares=shares[number],
            )
            parts.append((camera.place, likelihood))
        if level == 0:
            values = [sum(float(its((place @ one)[None])[0]) for place, its in parts) for one in proposals]
            pose = proposals[int(np.argmax(values))]
        pose = most_likely_near([(place, its.with_gradient) for place, its in parts], pose, RIG_STEPS, 30)
        shares = [its.fitted(place @ pose).shares for place, its in parts]
    return pose


def _together(agreements: Sequence[Agreement]) -> Agreement | None:
    """Return the agreement of the edges of all cameras; None without any."""
    points = sum(one.points for one in agreements)
    if not points:
        return None
    near, chance = (sum(getattr(one, name) * one.points for one in agreements) / points for name in ("near", "chance"))
    odds, side = min(
        ((one.least_odds, one.least_side) for one in agreements if one.least_odds is not None), default=(None, "")
    )
    return Agreement(near, chance, points, sum(one.places for one in agreements), odds, side)
