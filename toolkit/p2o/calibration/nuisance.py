"""Nuisance parameters: motion during raw sweeps, errors of camera calibrations, and an offset between the clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from p2o.arrays import Float
from p2o.calibration.adjustment import Adjustment, Nuisance
from p2o.calibration.intrinsics import IntrinsicsEstimate
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import REACH_AFTER_SEARCH_PX, End, Rounds
from p2o.features.view import View
from p2o.geometry.motion import EgoMotion, MotionPrior
from p2o.geometry.radial_error import RadialFit
from p2o.host.stages import JudgeBase
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import Problem
from p2o.results.result import TimeOffset

_MAX_ROUNDS = 12
_REACH_FACTOR, _SHRINK = 1.6, 0.85
_STILL_PX = 0.05
"""The joint estimation has converged when residuals change by less."""
_MIN_PAIRS = 100
_MIN_SPEED_RANGE_M_S = 1.0
_MIN_FRAMES = 4
_SIGNIFICANT = 2.0
"""An offset in time is used where it exceeds this many of its standard deviations."""


def motion_prior(views: Sequence[View], options: PipelineOptions) -> MotionPrior | None:
    """Return the prior of the vehicle's motion; None where it is not estimated, or no sweep is raw."""
    if options.motion == "trust" or not any(view.cloud_edges.time_s.any() for view in views):
        return None
    return motion_prior_of(options)


def motion_prior_of(options: PipelineOptions) -> MotionPrior:
    """Return the prior of the vehicle's motion during a raw sweep."""
    expected = EgoMotion(options.speed_m_s, 0.0, options.forward)
    return MotionPrior(expected, options.speed_sigma_m_s, float(np.radians(options.turn_sigma_deg_s)))


def known_twists(views: Sequence[View], options: PipelineOptions) -> Float | None:
    """Return the velocities (F, 6) from which an offset in time is observable, else None.

    All velocities must be known and differ, of sweeps that are corrected by them or have no times: in raw sweeps the
    estimated motion absorbs the offset. At least four frames are required.
    """
    known = [view.twist for view in views if view.twist is not None and not view.cloud_edges.time_s.any()]
    if options.time == "trust" or not _MIN_FRAMES <= len(known) == len(views):
        return None
    twists = np.array(known)
    return None if np.linalg.norm(np.ptp(twists[:, 3:], axis=0)) < _MIN_SPEED_RANGE_M_S else twists


@dataclass(frozen=True, eq=False)
class NuisanceEstimate:
    """The final pose with the nuisance parameters that the pairs determine along with it.

    `judge` compares `end` with the initial extrinsic: it holds the points where the nuisance parameters put them.
    `cameras` are the fitted errors of the cameras, and `cameras_corrected` is whether `end` uses them. `covariance`
    (6, 6) is that of the pose, None where the pairs do not determine it; `places` is the number of independent image
    cells that the pairs come from, 0 without pairs. `intrinsics` is the estimate of the errors of cameras at the pose,
    where they are to be checked.
    """

    end: End
    judge: JudgeBase
    nuisance: Nuisance
    cameras: tuple[RadialFit, ...] = ()
    cameras_corrected: bool = False
    covariance: Float | None = None
    places: int = 0
    time: TimeOffset | None = None
    intrinsics: IntrinsicsEstimate | None = None


def estimate_nuisances(
    raw: Sequence[View], start: Float, best: End, judge: JudgeBase, nuisance: Nuisance, rounds: Rounds
) -> NuisanceEstimate:
    """Estimate the nuisance parameters along with the best pose.

    With `camera=refine`, cameras are first corrected by significant errors (`estimate_intrinsics`). Motion of raw
    sweeps and, with that option, remaining errors of the cameras are estimated jointly with the pose, with new pairs in
    every round; then matcher and solver refine the pose. The result is kept only if its cost on the same points is
    lower: few pairs fit any motion. With `time=estimate`, a time offset follows, which must also be significant.
    """
    options, cameras = rounds.options, tuple(view.camera for view in raw)
    fits_cameras, refines = options.camera != "trust", options.camera == "refine"
    if best.pairs is None:
        return NuisanceEstimate(best, judge, nuisance)
    if not enough_pairs(best.pairs):
        fit = nuisance.fit(best.pairs, cameras, best.pose, fits_cameras=fits_cameras)
        return NuisanceEstimate(best, judge, nuisance, covariance=fit.covariance, places=fit.places)
    refined: Adjustment | None = None
    offset: TimeOffset | None = None
    if refines and any(judge.camera_errors):
        corrected_cameras = _cameras_corrected(raw, start, best, judge, nuisance, rounds)
        if corrected_cameras is not None:
            best, judge, nuisance = corrected_cameras
    if (refines or nuisance.prior is not None) and any(judge.camera_errors):
        better = _refined_jointly(raw, start, best, judge, nuisance, rounds)
        if better is not None:
            best, judge, refined = better
            nuisance = nuisance.after(refined)
    if nuisance.twists is not None and any(judge.camera_errors):
        assert best.pairs is not None
        offset = nuisance.timed().fit(best.pairs, cameras, best.pose, fits_cameras=refines).time
        better = _refined_jointly(raw, start, best, judge, nuisance.timed(), rounds)
        time_fit = None if better is None else better[2].time
        if better is not None and time_fit is not None and abs(time_fit.offset_s) > _SIGNIFICANT * time_fit.sigma_s:
            best, judge, refined = better
            nuisance, offset = nuisance.after(refined), refined.time
    time = None if offset is None else replace(offset, used=nuisance.time is not None)
    corrected = bool(nuisance.errors)
    if refines and refined is not None:
        fit = refined
    else:
        assert best.pairs is not None
        fit = nuisance.fit(best.pairs, cameras, best.pose, fits_cameras=fits_cameras)
    checked = None
    if fits_cameras and not corrected and any(judge.camera_errors):
        checked = nuisance.intrinsics(raw, best.pose, judge.camera_errors)
    return NuisanceEstimate(best, judge, nuisance, fit.cameras, corrected, fit.covariance, fit.places, time, checked)


def enough_pairs(problem: Problem | None) -> TypeGuard[PointToLine]:
    """Return whether a problem has enough pairs to determine more than the pose."""
    return isinstance(problem, PointToLine) and len(problem) >= _MIN_PAIRS


def _cameras_corrected(
    raw: Sequence[View], start: Float, best: End, judge: JudgeBase, nuisance: Nuisance, rounds: Rounds
) -> tuple[End, JudgeBase, Nuisance] | None:
    """Return the end with significant errors of the cameras corrected, its judge and nuisances; None without any."""
    estimate = nuisance.intrinsics(raw, best.pose, judge.camera_errors)
    wrong = (
        np.any([fit.significant for fit in estimate.fits], axis=0) if estimate is not None else np.zeros(4, np.bool_)
    )
    if wrong.any():
        estimate = nuisance.intrinsics(raw, best.pose, wrong.tolist())
    if estimate is None or not wrong.any():
        return None
    nuisance = replace(nuisance, errors={fit.camera: fit.error for fit in estimate.fits})
    views, pose = nuisance.views(raw), estimate.camera_from_lidar
    better = _better_end(views, start, pose, best, judge, rounds, REACH_AFTER_SEARCH_PX)
    return None if better is None else (*better, nuisance)


def _better_end(
    views: Sequence[View], start: Float, pose: Float, best: End, judge: JudgeBase, rounds: Rounds, reach_px: float
) -> tuple[End, JudgeBase] | None:
    """Return the end of rounds from a pose (4, 4) with corrected views, and their judge; None if it costs no less."""
    corrected = judge.on(views)
    end = rounds(views, start, pose, corrected, reach_px=reach_px, found_by="adjust")
    if not (end.status.solved and enough_pairs(end.problem)):
        return None
    [previous_cost], [cost] = judge.costs([best.pose]), corrected.costs([end.pose])
    return (replace(end, rounds=best.rounds + end.rounds), corrected) if cost < previous_cost else None


def _refined_jointly(
    raw: Sequence[View], start: Float, best: End, judge: JudgeBase, nuisance: Nuisance, rounds: Rounds
) -> tuple[End, JudgeBase, Adjustment] | None:
    """Return the end, its judge and the fit of a joint estimation of pose and nuisances; None where it costs more."""
    options, cameras = rounds.options, tuple(view.camera for view in raw)
    refines = options.camera == "refine"
    pose, reach_px, fit = best.pose, options.min_reach_px * _REACH_FACTOR, None
    for _ in range(_MAX_ROUNDS):
        problem = rounds.matcher(nuisance.views(raw), pose, reach_px)
        if not enough_pairs(problem):
            break
        fit = nuisance.fit(problem, cameras, pose, fits_cameras=refines)
        pose, nuisance = fit.camera_from_lidar, nuisance.after(fit)
        if fit.step_px < _STILL_PX and reach_px <= options.min_reach_px:
            break
        reach_px = max(options.min_reach_px, reach_px * _SHRINK)
    if fit is None:
        return None
    better = _better_end(nuisance.views(raw), start, pose, best, judge, rounds, options.min_reach_px)
    return None if better is None else (*better, fit)
