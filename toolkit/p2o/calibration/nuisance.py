"""What is estimated beside the pose because edges depend on it: motion during raw sweeps, errors of the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from p2o.arrays import Float
from p2o.calibration.adjustment import Adjustment, MotionFit, adjust
from p2o.calibration.camera_check import checks_of, tells_more
from p2o.calibration.judge import DirectedJudge, Judge
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import End, Rounds
from p2o.features.view import View
from p2o.geometry.camera import Camera
from p2o.geometry.ego_motion import EgoMotion, MotionPrior
from p2o.geometry.radial_error import RadialError
from p2o.problems.point_to_line import PointToLine
from p2o.results.result import CameraCheck, SweepMotion

_ADJUST_ROUNDS = 12
_ADJUST_REACH, _ADJUST_SHRINK = 1.6, 0.85
_STILL_PX = 0.05


def motion_prior(views: Sequence[View], options: PipelineOptions) -> MotionPrior | None:
    """Return what is expected of the car's motion, or None where it is not asked for or no raw sweep tells any."""
    if options.motion == "trust" or not any(view.cloud_edges.time_s.any() for view in views):
        return None
    expected = EgoMotion(options.speed_m_s, 0.0, options.forward)
    return MotionPrior(expected, options.speed_sigma_m_s, float(np.radians(options.turn_sigma_deg_s)))


@dataclass(frozen=True)
class Nuisance:
    """What is known beside the pose: errors of cameras, and motions, one a view or none."""

    prior: MotionPrior | None = None
    errors: Mapping[Camera, RadialError] = field(default_factory=dict)
    motions: tuple[MotionFit, ...] = ()

    @classmethod
    def expected(cls, views: Sequence[View], prior: MotionPrior | None) -> Nuisance:
        """Return what is known before the edges are asked."""
        if prior is None:
            return cls()
        return cls(prior, motions=(MotionFit(prior.expected, prior.covariance),) * len(views))

    def fit(self, problem: PointToLine, given: tuple[Camera, ...], pose: Float, *, cameras: bool) -> Adjustment:
        """Return what pairs tell beside the pose, beginning from here; `given` are the cameras of the calibration."""
        motions = [fit.motion for fit in self.motions]
        pairs = replace(problem, cameras=given)
        return adjust(pairs, pose, cameras=cameras, known=self.errors, prior=self.prior, motions=motions)

    def after(self, fit: Adjustment) -> Nuisance:
        """Return what an adjustment found."""
        return Nuisance(self.prior, dict(self.errors) | {c.camera: c.error for c in fit.cameras}, fit.motions)

    def views(self, raw: Sequence[View]) -> list[View]:
        """Return raw views with their cameras corrected and their features as if seen at one time."""
        if self.motions:
            raw = [view.untwisted(fit.motion.twist) for view, fit in zip(raw, self.motions, strict=True)]
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


def adjusted(raw: Sequence[View], start: Float, found: End, judge: Judge, nuisance: Nuisance, run: Rounds) -> Adjusted:
    """Return what was found with all that the pairs say beside the pose.

    Motion of raw sweeps and, with the option `camera=refine`, errors of the cameras are found along with the pose, with
    new pairs in every round until these hardly move; then the pose is what matcher and solver make of it. Where its
    cost is not below that of what was found before, nothing is changed: few pairs fit any motion. Both are judged on
    the same points, with the same weights.
    """
    options, given = run.options, tuple(view.camera for view in raw)
    if not tells_more(found.problem):
        if found.problem is None:
            return Adjusted(found, judge, nuisance)
        few = nuisance.fit(found.problem, given, found.pose, cameras=options.camera != "trust")
        return Adjusted(found, judge, nuisance, (), few.covariance, few.places)
    refines = options.camera == "refine"
    if (refines or nuisance.prior is not None) and isinstance(judge, DirectedJudge):
        better = _bettered(raw, start, found, judge, nuisance, run)
        if better is not None:
            end, its_judge, fit = better
            found, judge, nuisance = end, its_judge, nuisance.after(fit)
            if refines:
                checks = checks_of(fit.cameras, given, corrected=True)
                return Adjusted(found, judge, nuisance, checks, fit.covariance, fit.places)
    assert found.problem is not None
    fit = nuisance.fit(found.problem, given, found.pose, cameras=options.camera != "trust")
    checks = checks_of(fit.cameras, given, corrected=False)
    return Adjusted(found, judge, nuisance, checks, fit.covariance, fit.places)


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
