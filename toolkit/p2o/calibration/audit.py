"""Whether a given extrinsic holds: the step that edges ask for, by its likely error, on each axis and in all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from p2o.arrays import Float
from p2o.calibration.edge_step import EdgeStep, edge_step
from p2o.calibration.fusion import OWN_SHARE
from p2o.calibration.judge import judge_of
from p2o.calibration.options import PipelineOptions
from p2o.calibration.pipeline import Pipeline, missing_features
from p2o.features.view import View
from p2o.geometry import se3
from p2o.results.check import AxisCheck, Check, Holding

AXES = (("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("x", "m"), ("y", "m"), ("z", "m"))
"""Camera axes and their units, in the order of errors."""


class Tail(NamedTuple):
    """How errors are spread: Student's t of so many `degrees`, `scale` times the deviations of single steps.

    A search finds another pose for a right one, too: it counts where it is met by `lead_edges` more.
    """

    degrees: float
    scale: float
    lead_edges: float


TAIL = Tail(20.0, 1.0, 6.0)
"""Of steps at right extrinsics on simulated frames and KITTI's `train` (`python benchmarks/audit.py`)."""
_APART_DEG, _APART_M = 0.5, 0.3
"""Nearer than this, a pose that a search finds is the one that edges lead to anyway."""
_SEARCHED = 3
"""A slip of degrees shows in few frames, and a search of many takes long."""


@dataclass(frozen=True)
class Rates:
    """What is asked of a check: how often it may be wrong, and how small an error has to be noticed.

    `alarm` is how often a right extrinsic may be called off, `power` how often an error as large as a limit is.
    """

    alarm: float = 0.01
    power: float = 0.95
    notice_deg: float = 1.0
    notice_m: float = 0.3

    @property
    def noticed(self) -> float:
        """How many deviations a step of one axis has to be for it to be called off; half of all alarms are of axes."""
        return TAIL.scale * _t(1 - self.alarm / 2 / (2 * len(AXES)))

    @property
    def limit(self) -> float:
        """How many deviations an error of one axis has to be so that it is noticed as often as asked."""
        return self.noticed + TAIL.scale * _t(self.power)

    @property
    def joint(self) -> float:
        """How large a step may be in all, as a chi-square of six degrees."""
        from scipy.stats import f

        return float(TAIL.scale**2 * 6 * f.ppf(1 - self.alarm / 2, 6, TAIL.degrees))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What edges say of a given pose (4, 4): the step `near` it, or why there is none; and a step to the best pose that
    a search finds elsewhere, if any, at which edges are met by `lead_edges` more.
    """

    frames: tuple[str, ...]
    camera_from_lidar: Float
    near: EdgeStep | str
    far: EdgeStep | None = None
    lead_edges: float = 0.0

    @classmethod
    def of(
        cls, views: Sequence[View], camera_from_lidar: Float, pipeline: Pipeline, *, search: bool = True
    ) -> Evidence:
        """Return what the edges of prepared views say.

        They lead from the given pose within a narrow reach, with no weight on where they begin; a `search` tells
        whether there is a better pose out of that reach.
        """
        given, names = se3.check_rigid("the extrinsic", camera_from_lidar), tuple(view.name for view in views)
        missing = missing_features(views, given, pipeline.needs)
        if missing is not None:
            return cls(names, given, missing[1])
        near = edge_step(views, given, pipeline.matcher, pipeline.options)
        return cls(names, given, near, *(_searched(views, given, near, pipeline) if search else ()))

    @property
    def led_away(self) -> bool:
        """Whether edges meet clearly better somewhere else."""
        return self.far is not None and self.lead_edges >= TAIL.lead_edges


def audit(evidence: Evidence, options: PipelineOptions, rates: Rates) -> Check:
    """Return whether a given pose holds, by what edges say of it."""
    step = evidence.far if evidence.led_away and evidence.far is not None else evidence.near
    if isinstance(step, str):
        return _untold(evidence, rates, step)
    met = step.agreement
    if met.odds_ratio < options.min_odds_ratio or met.strength < options.min_strength:
        text = (
            f"image and LiDAR edges meet in too few places, or little more often than by chance (odds ratio "
            f"{met.odds_ratio:.1f}, strength {met.strength:.1f}; {options.min_odds_ratio:g} and "
            f"{options.min_strength:g} are needed): take more frames together"
        )
        return replace(_untold(evidence, rates, text), agreement=met)
    return _told(evidence, step, rates)


def _told(evidence: Evidence, step: EdgeStep, rates: Rates) -> Check:
    """Return what a step says, axis by axis."""
    far = evidence.led_away
    notice = np.repeat([rates.notice_deg, rates.notice_m], 3)
    limit, off = rates.limit * step.sigma, np.abs(step.error) > rates.noticed * step.sigma
    axes = []
    for (axis, unit), error, sigma, least, most, is_off in zip(
        AXES, step.error.tolist(), step.sigma.tolist(), limit.tolist(), notice.tolist(), off.tolist(), strict=True
    ):
        holding = Holding.OFF if is_off else Holding.HOLDS if least <= most else Holding.CANNOT_TELL
        axes.append(AxisCheck(axis, unit, holding, error, sigma, least))
    chi_square = _chi_square(step)
    apart = chi_square > rates.joint
    if apart and not off.any():
        # Which axis it is, is not known: none of them holds for sure.
        axes = [replace(axis, holding=Holding.CANNOT_TELL) for axis in axes]
    holding, reason = _in_all(axes, apart, far)
    return Check(
        frames=evidence.frames,
        camera_from_lidar=evidence.camera_from_lidar,
        holding=holding,
        reason=reason,
        axes=tuple(axes),
        alarm_rate=rates.alarm,
        power=rates.power,
        notice_deg=rates.notice_deg,
        notice_m=rates.notice_m,
        found=step.found,
        far=far,
        chi_square=chi_square,
        p_value=p_value(chi_square),
        agreement=step.agreement,
    )


def _in_all(axes: Sequence[AxisCheck], apart: bool, far: bool) -> tuple[Holding, str]:
    """Return the word for all axes, and why."""
    off = [a for a in axes if a.holding is Holding.OFF]
    unsure = [a for a in axes if a.holding is Holding.CANNOT_TELL]
    if off:
        found = "; a search found edges to meet far better there" if far else ""
        return Holding.OFF, "off by about " + ", ".join(map(amount, off)) + found
    if apart or far:
        return Holding.OFF, "off, but these frames do not tell on which axis"
    if unsure:
        names = ", ".join(a.axis for a in unsure)
        return Holding.CANNOT_TELL, f"an error of {names} as large as asked might go unnoticed: take more frames"
    return Holding.HOLDS, "no axis is off by more than its limit"


def amount(check: AxisCheck) -> str:
    """Return by how much an axis is off, in words."""
    assert check.off is not None
    return f"{check.axis} {check.off:+.2f} deg" if check.unit == "deg" else f"{check.axis} {100 * check.off:+.1f} cm"


def p_value(chi_square: float) -> float:
    """Return how often a right extrinsic is as far off in all, by its likely errors."""
    from scipy.stats import f

    return float(f.sf(chi_square / TAIL.scale**2 / 6, 6, TAIL.degrees))


def _chi_square(step: EdgeStep) -> float:
    """Return how large a step is in all, by its likely errors: a part of these is each axis's own."""
    covariance = (1 - OWN_SHARE) * step.covariance + OWN_SHARE * np.diag(np.diag(step.covariance))
    return float(step.error @ np.linalg.solve(covariance, step.error))


def _searched(
    views: Sequence[View], given: Float, near: EdgeStep | str, pipeline: Pipeline
) -> tuple[EdgeStep | None, float]:
    """Return the step to the best pose that a search finds apart from the given one, and by how many edges it leads."""
    some = [views[at] for at in np.unique(np.linspace(0, len(views) - 1, _SEARCHED).round().astype(int))]
    raw = [view.as_seen_from(given).without_hidden(given) for view in some]
    known = [given] if isinstance(near, str) else [given, near.found]
    proposed = [pose for pose in pipeline.initializer(raw, given) if all(_apart(pose, other) for other in known)]
    if not proposed:
        return None, 0.0
    options = pipeline.options
    reach = {"truncate_px": options.judge_px, "reach_px": options.min_reach_px}
    judge = judge_of(pipeline.matcher, pipeline.needs, raw, given, proposed, **reach)
    best = proposed[int(np.argmin(judge.costs(proposed)))]
    step = edge_step(views, given, pipeline.matcher, options, around=best, reach_px=options.reach_after_search_px)
    if isinstance(step, str) or not all(_apart(step.found, other) for other in known):
        return None, 0.0
    *costs, cost = judge.costs([*known, step.found])
    lead, unit = judge.lead(cost, min(costs))
    return (step, lead) if unit == "edges" else (None, 0.0)


def _apart(pose: Float, other: Float) -> bool:
    step = se3.inverse(other) @ pose
    return se3.angle_deg(step) > _APART_DEG or se3.distance_m(step) > _APART_M


def _untold(evidence: Evidence, rates: Rates, reason: str) -> Check:
    return Check(
        frames=evidence.frames,
        camera_from_lidar=evidence.camera_from_lidar,
        holding=Holding.CANNOT_TELL,
        reason=reason,
        axes=tuple(AxisCheck(axis, unit, Holding.CANNOT_TELL) for axis, unit in AXES),
        alarm_rate=rates.alarm,
        power=rates.power,
        notice_deg=rates.notice_deg,
        notice_m=rates.notice_m,
    )


def _t(share: float) -> float:
    from scipy.stats import t

    return float(t.ppf(share, TAIL.degrees))
