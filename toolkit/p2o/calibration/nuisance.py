"""What is estimated beside the pose because edges depend on it: motion in raw sweeps, errors of cameras and clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from p2o.arrays import Float
from p2o.calibration.adjustment import Adjustment, MotionFit, TimeFit, adjust
from p2o.calibration.camera_check import checks_of, tells_more
from p2o.calibration.judge import DirectedJudge, Judge
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import End, Rounds
from p2o.features.view import View
from p2o.geometry.camera import Camera
from p2o.geometry.ego_motion import EgoMotion, MotionPrior
from p2o.geometry.motion import pose_at
from p2o.geometry.radial_error import RadialError
from p2o.problems.point_to_line import PointToLine
from p2o.results.result import CameraCheck, SweepMotion, TimeOffset

_ADJUST_ROUNDS = 12
_ADJUST_REACH, _ADJUST_SHRINK = 1.6, 0.85
_STILL_PX = 0.05
_LEAST_SPREAD_M_S = 1.0
_LEAST_FRAMES = 4
_SIGNIFICANT = 2.0
"""An offset in time is used where it is so many of its deviations: less might as well be none."""


def motion_prior(views: Sequence[View], options: PipelineOptions) -> MotionPrior | None:
    """Return what is expected of the car's motion, or None where it is not asked for or no raw sweep tells any."""
    if options.motion == "trust" or not any(view.cloud_edges.time_s.any() for view in views):
        return None
    expected = EgoMotion(options.speed_m_s, 0.0, options.forward)
    return MotionPrior(expected, options.speed_sigma_m_s, float(np.radians(options.turn_sigma_deg_s)))


def known_twists(views: Sequence[View], options: PipelineOptions) -> Float | None:
    """Return the velocities (F, 6) by which an offset in time can be told, or None where it is not asked for or cannot.

    All have to be known, of sweeps that are corrected by them or have no times: elsewhere the motion is estimated, and
    takes the offset along. One velocity, however large, is no way to tell an offset from another pose, and in fewer
    than four frames what each errs by itself passes for one.
    """
    known = [view.twist for view in views if view.twist is not None and not view.cloud_edges.time_s.any()]
    if options.time == "trust" or not _LEAST_FRAMES <= len(known) == len(views):
        return None
    twists = np.array(known)
    return None if np.linalg.norm(np.ptp(twists[:, 3:], axis=0)) < _LEAST_SPREAD_M_S else twists


@dataclass(frozen=True)
class Nuisance:
    """What is known beside the pose: errors of cameras, motions, one a view or none, and an offset in time.

    `twists` (F, 6) are the velocities that an offset can be told by, None where there is none to be told.
    """

    prior: MotionPrior | None = None
    errors: Mapping[Camera, RadialError] = field(default_factory=dict)
    motions: tuple[MotionFit, ...] = ()
    twists: Float | None = None
    time: TimeFit | None = None

    @classmethod
    def expected(cls, views: Sequence[View], prior: MotionPrior | None, twists: Float | None = None) -> Nuisance:
        """Return what is known before the edges are asked."""
        if prior is None:
            return cls(twists=twists)
        motions = (MotionFit(prior.expected, prior.covariance),) * len(views)
        return cls(prior, motions=motions, twists=twists)

    def timed(self) -> Nuisance:
        """Return the same with an offset in time that is to be found."""
        return replace(self, time=TimeFit())

    def fit(self, problem: PointToLine, given: tuple[Camera, ...], pose: Float, *, cameras: bool) -> Adjustment:
        """Return what pairs tell beside the pose, beginning from here; `given` are the cameras of the calibration."""
        motions = [fit.motion for fit in self.motions]
        pairs = replace(problem, cameras=given)
        return adjust(
            pairs,
            pose,
            cameras=cameras,
            known=self.errors,
            prior=self.prior,
            motions=motions,
            twists=self.twists,
            time=self.time,
        )

    def after(self, fit: Adjustment) -> Nuisance:
        """Return what an adjustment found."""
        errors = dict(self.errors) | {c.camera: c.error for c in fit.cameras}
        return replace(self, errors=errors, motions=fit.motions, time=fit.time)

    def views(self, raw: Sequence[View]) -> list[View]:
        """Return raw views with their cameras corrected and their features as if seen at the time of the image."""
        if self.motions:
            raw = [view.untwisted(fit.motion.twist) for view, fit in zip(raw, self.motions, strict=True)]
        if self.time is not None and self.twists is not None:
            offset_s = self.time.offset_s
            raw = [view.moved(pose_at(twist, -offset_s)) for view, twist in zip(raw, self.twists, strict=True)]
        cameras = [self.errors.get(view.camera, RadialError()).corrected(view.camera) for view in raw]
        return [replace(view, camera=camera) for view, camera in zip(raw, cameras, strict=True)]

    def sweep_motions(self, views: Sequence[View]) -> tuple[SweepMotion, ...]:
        """Return the motions of those views whose sweeps are raw."""
        found = []
        for view, fit in zip(views, self.motions, strict=bool(self.motions)):
            if view.cloud_edges.time_s.any():
                motion, (speed_sigma, turn_sigma) = fit.motion, np.sqrt(np.diag(fit.covariance)).tolist()
                turn = float(np.degrees(motion.turn_rad_s)), float(np.degrees(turn_sigma))
                found.append(SweepMotion(view.name, motion.speed_m_s, speed_sigma, *turn, tuple(motion.twist.tolist())))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What was found, with all that the pairs tell beside the pose; `covariance` (6, 6) of it where they can tell.

    `places` is from how many places of the pictures the pairs come; 0 where there are none.

    `judge` is the one to compare `end` with the start by: of the same points, where the nuisances put them.
    """

    end: End
    judge: Judge
    nuisance: Nuisance
    cameras: tuple[CameraCheck, ...] = ()
    covariance: Float | None = None
    places: int = 0
    time: TimeOffset | None = None


def adjusted(raw: Sequence[View], start: Float, found: End, judge: Judge, nuisance: Nuisance, run: Rounds) -> Adjusted:
    """Return what was found with all that the pairs say beside the pose.

    Motion of raw sweeps and, with the option `camera=refine`, errors of the cameras are found along with the pose, with
    new pairs in every round until these hardly move; then the pose is what matcher and solver make of it. Where its
    cost is not below that of what was found before, nothing is changed: few pairs fit any motion. Both are judged on
    the same points, with the same weights. So is, after them and with the option `time=estimate`, an offset in time,
    which also has to be larger than its deviation explains.
    """
    options, given = run.options, tuple(view.camera for view in raw)
    if not tells_more(found.problem):
        if found.problem is None:
            return Adjusted(found, judge, nuisance)
        few = nuisance.fit(found.problem, given, found.pose, cameras=options.camera != "trust")
        return Adjusted(found, judge, nuisance, (), few.covariance, few.places)
    refines = options.camera == "refine"
    fit: Adjustment | None = None
    offset: TimeFit | None = None
    if (refines or nuisance.prior is not None) and isinstance(judge, DirectedJudge):
        better = _bettered(raw, start, found, judge, nuisance, run)
        if better is not None:
            found, judge, fit = better
            nuisance = nuisance.after(fit)
    if nuisance.twists is not None and isinstance(judge, DirectedJudge):
        assert found.problem is not None
        offset = nuisance.timed().fit(found.problem, given, found.pose, cameras=refines).time
        better = _bettered(raw, start, found, judge, nuisance.timed(), run)
        if better is not None and _significant(better[2].time):
            found, judge, fit = better
            nuisance, offset = nuisance.after(fit), fit.time
    time = None if offset is None else TimeOffset(offset.offset_s, offset.sigma_s, nuisance.time is not None)
    if refines and fit is not None:
        checks = checks_of(fit.cameras, given, corrected=True)
        return Adjusted(found, judge, nuisance, checks, fit.covariance, fit.places, time)
    assert found.problem is not None
    fit = nuisance.fit(found.problem, given, found.pose, cameras=options.camera != "trust")
    checks = checks_of(fit.cameras, given, corrected=False)
    return Adjusted(found, judge, nuisance, checks, fit.covariance, fit.places, time)


def _significant(time: TimeFit | None) -> bool:
    return time is not None and abs(time.offset_s) > _SIGNIFICANT * time.sigma_s


def _bettered(
    raw: Sequence[View], start: Float, found: End, judge: DirectedJudge, nuisance: Nuisance, run: Rounds
) -> tuple[End, DirectedJudge, Adjustment] | None:
    """Return where pose and nuisances end that are estimated together, or None where that is no better."""
    options, given = run.options, tuple(view.camera for view in raw)
    refines = options.camera == "refine"
    pose, then, reach, fit = found.pose, nuisance, options.min_reach_px * _ADJUST_REACH, None
    for _ in range(_ADJUST_ROUNDS):
        problem = run.matcher(then.views(raw), pose, reach)
        if not tells_more(problem):
            break
        fit = then.fit(problem, given, pose, cameras=refines)
        pose, then = fit.camera_from_lidar, then.after(fit)
        if fit.step_px < _STILL_PX and reach <= options.min_reach_px:
            break
        reach = max(options.min_reach_px, reach * _ADJUST_SHRINK)
    if fit is None:
        return None
    views = then.views(raw)
    after = judge.on(views)
    end = run(views, start, pose, after, reach_px=options.min_reach_px, found_by="adjust")
    if not (end.solved and tells_more(end.problem)):
        return None
    [cost_before], [cost] = judge.costs([found.pose]), after.costs([end.pose])
    if not cost < cost_before:
        return None
    return replace(end, rounds=found.rounds + end.rounds), after, fit
