"""Options, uncertainty and results that all methods with known targets (boards, spheres, boxes) share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import p2o
from p2o import Float, Result, Status, field, se3
from p2o.solving import Accuracy, Judged

from p2o_baselines.outcome import decided, refused

_Z_95 = 1.9  # ratio of the 95 % bound to the standard deviation: 1.96 for one direction, 1.61 for three equal ones
_SCATTER_M = 0.04  # largest scatter of ranges on the surface of a target
_WORST_DEG = 5.0  # refuse results less certain than this about any axis
_WORST_M = 0.5  # refuse results less certain than this along any axis


class TargetOptions(p2o.Options):
    """Options of all methods with targets."""

    farthest_m: float = field(12.0, gt=0, le=200, help="Search targets up to this distance from the LiDAR.")


@dataclass(frozen=True)
class Sight:
    """One frame: `asked` describes the requested targets, `in_image` and `in_sweep` are the detected ones."""

    name: str
    asked: str
    in_image: tuple[Any, ...]
    in_sweep: tuple[Any, ...]


_detected: WeakKeyDictionary[p2o.Cloud, dict[Hashable, tuple[Any, ...]]] = WeakKeyDictionary()
"""Targets in sweeps in use: the search takes seconds, and all methods with one kind of target share it."""


def once_per_sweep(
    cloud: p2o.Cloud, detect: Callable[..., tuple[Any, ...]], wanted: tuple[Any, ...], options: TargetOptions
) -> tuple[Any, ...]:
    """Return the targets of a sweep, one of those `wanted` each, by a detector that runs once per sweep."""
    if not wanted:
        return ()
    known, key = _detected.setdefault(cloud, {}), (detect, wanted, options.farthest_m, _SCATTER_M)
    if key not in known:
        known[key] = detect(cloud, wanted, farthest_m=options.farthest_m, sigma_m=_SCATTER_M)
    return known[key]


def missing_targets(sights: Sequence[Sight], kind: str, outline: str, bodies: str) -> str:
    """Return why there are no targets to pair; "" if both sensors show some.

    `outline` states what no image shows, `bodies` what images show but no sweep; {} in them is the requested target.
    """
    request = next((sight.asked for sight in sights if sight.asked != "none"), "none")
    if request == "none":
        return f"no frame states that it shows a {kind}: add it to `targets` of frame.yaml"
    seen = [sight for sight in sights if sight.in_image]
    if not seen:
        return f"none of {len(sights)} images shows {outline.replace('{}', request)}"
    if not any(sight.in_sweep for sight in seen):
        return f"{len(seen)} of {len(sights)} images show {bodies.replace('{}', request)}"
    return ""


def standard_deviations(covariance: Float, camera_from_lidar: Float) -> Float:
    """Return standard deviations (6,): rotation about the camera's axes in rad, LiDAR position along them in m."""
    by_update = np.eye(6)
    by_update[3:, :3] = -se3.skew(camera_from_lidar[:3, 3])
    return np.asarray(np.sqrt(np.diag(by_update @ covariance @ by_update.T)))


def accuracy_of(covariance: Float, camera_from_lidar: Float) -> Accuracy:
    """Return the predicted error of a pose (4, 4) from the covariance (6, 6) of its left update."""
    axes = standard_deviations(covariance, camera_from_lidar)
    rotation_deg, translation_m = float(np.degrees(np.linalg.norm(axes[:3]))), float(np.linalg.norm(axes[3:]))
    pitch, yaw, roll = np.degrees(axes[:3]).tolist()
    return Accuracy(
        rotation_deg, translation_m, _Z_95 * rotation_deg, _Z_95 * translation_m, roll, pitch, yaw, *axes[3:].tolist()
    )


def uncertainty(covariance: Float | None, pose: Float, remedy: str) -> str:
    """Return why a pose (4, 4) is too uncertain, with the advice `remedy`; "" if it is certain enough."""
    if covariance is None or not np.isfinite(covariance).all():
        return f"a direction of the pose is not observable: {remedy}"
    axes = standard_deviations(covariance, pose)
    deg, metres = float(np.degrees(axes[:3].max())), float(axes[3:].max())
    if deg > _WORST_DEG or metres > _WORST_M:
        return f"the standard deviation of the pose is {deg:.1f} deg and {metres:.2f} m for its worst axes: {remedy}"
    return ""


def unsolved(sights: Sequence[Sight], start: Float) -> Result:
    """Return the result of frames before anything is known: the initial extrinsic, without features."""
    return Result(tuple(sight.name for sight in sights), start, start, Status.NO_FEATURES, "")


def solved(
    result: Result,
    pose: Float,
    covariance: Float | None,
    *,
    reason: str,
    judged: Judged,
    remedy: str,
) -> Result:
    """Return an unsolved result with its pose (4, 4), or refused if the pose is too uncertain."""
    doubt = uncertainty(covariance, pose, remedy)
    if covariance is None or doubt:
        return refused(result, doubt, Status.NOT_OBSERVABLE)
    return decided(
        result,
        camera_from_lidar=pose,
        status=Status.CONVERGED,
        reason=reason,
        covariance=covariance,
        accuracy=accuracy_of(covariance, pose),
        judged=judged,
    )


def pairing_warnings(
    target: str, targets: str, sights: Sequence[Sight], *, unmatched: Sequence[str], alternatives: int = 0
) -> tuple[str, ...]:
    """Return warnings about targets that only one sensor sees and about other poses that fit as well."""
    empty, lines = [sight.name for sight in sights if not sight.in_image], []
    if unmatched:
        lines.append(f"{targets} in images without a match in the sweep: {_listed(unmatched)}")
    if empty:
        lines.append(f"images without a detected {target}: {_listed(empty)}")
    if alternatives:
        others = f"{1 + alternatives} poses fit the {targets} equally well"
        lines.append(f"{others}: the one nearest to the initial extrinsic is used")
    return tuple(lines)


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:5])} ({len(names)})"
