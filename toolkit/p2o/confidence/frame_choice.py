"""Choose the frames of a joint calibration by the information of their edges, before anything is calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from p2o.arrays import Float, Int
from p2o.confidence.accuracy import ErrorBudget, likely_accuracy
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.problems.point_to_line import OUTLINE_CELL_PX, PointToLine
from p2o.results.evidence import Accuracy, Agreement

_DEPTH_STEP = 0.25
"""Depth step of a place (a cell by edge direction, image position and depth), in the natural logarithm of depth."""
_PLACE_SIGMA_PX = 1.5
"""Standard deviation of the common error of the edges of one place, in px."""
_AGAIN = 0.1
"""Share of the information of a place that a further frame from the same vehicle pose adds."""
_SAME_PLACE_SHARE = 0.3
"""Share of common places from which frames count as one scene if the vehicle poses are unknown. On KITTI, frames at an
interval of 0.1 s share at least 0.44, frames of a static vehicle 0.6, and different streets at most 0.14.
"""
_SAME_M, _SAME_DEG = 1.0, 3.0
_PRIOR = np.repeat([np.radians(10.0), 2.0], 3)
"""Prior standard deviations (6,); they keep the information matrix invertible if a direction is unobservable."""
_ODDS_RATIO = 10.0
NEAR_M = 12.0
LEVEL, UPRIGHT = (Side.UPPER, Side.BOTTOM), (Side.LEFT, Side.RIGHT)


@dataclass(frozen=True, eq=False)
class SeenEdges:
    """Information of one frame on the pose: pairs of its edges, the vehicle pose, if known, and the drive."""

    name: str
    problem: PointToLine
    camera_from_lidar: Float
    sequence: str = ""
    world_from_lidar: Float | None = None

    @cached_property
    def _seen(self) -> tuple[Float, Float]:
        """Derivatives (K, 6) and weights (K,) of the pairs; zero for points outside the view of the camera."""
        residuals, rows = self.problem.residuals_with_jacobian(self.camera_from_lidar)
        visible = np.isfinite(residuals) & np.isfinite(rows).all(axis=1)
        return np.where(visible[:, None], rows, 0.0), np.where(visible, self.problem.weight, 0.0)

    @cached_property
    def depth_m(self) -> Float:
        """Depths (K,) of the points along the optical axis."""
        return np.asarray(se3.apply(self.camera_from_lidar, self.problem.xyz)[:, 2])

    @cached_property
    def _labels(self) -> tuple[Int, Int]:
        """Distinct places (P, 4) as side, cell and step of depth, and the number (K,) of that of each pair."""
        cell = np.floor(self.problem.centre / OUTLINE_CELL_PX)
        step = np.floor(np.log(np.maximum(self.depth_m, 0.1)) / _DEPTH_STEP)
        table = np.column_stack([self.problem.side, cell, step]).astype(np.int64)
        places, number = np.unique(table, axis=0, return_inverse=True)
        return places, number.reshape(-1)

    @cached_property
    def places(self) -> tuple[tuple[int, ...], ...]:
        """Return the places that contain its edges."""
        return tuple(map(tuple, self._labels[0].tolist()))

    @cached_property
    def by_place(self) -> Float:
        """The information (P, 6, 6) of each place: the mean of its pairs is one measurement."""
        rows, weight = self._seen
        count, number = len(self.places), self._labels[1]
        total = np.bincount(number, weight, count)
        summed = np.stack([np.bincount(number, weight * column, count) for column in rows.T], axis=1)
        mean = summed / (np.maximum(total, 1e-12)[:, None] * _PLACE_SIGMA_PX)
        return np.asarray(np.einsum("pi,pj->pij", mean, mean))

    def same_place(self, other: SeenEdges) -> bool:
        """Return whether both frames have the same vehicle pose or, if poses are unknown, mostly the same places."""
        # Names of drives are not sufficient: a vehicle that waits at a traffic light may be in two drives.
        if self.sequence == other.sequence and self.world_from_lidar is not None and other.world_from_lidar is not None:
            step = se3.inverse(self.world_from_lidar) @ other.world_from_lidar
            return bool(se3.distance_m(step) < _SAME_M and se3.angle_deg(step) < _SAME_DEG)
        mine, others = set(self.places), set(other.places)
        return len(mine & others) >= _SAME_PLACE_SHARE * max(1, len(mine | others))


@dataclass(frozen=True)
class Step:
    """One chosen frame: the gain of the log determinant of the information, the number of places that it adds, and the
    predicted accuracy of all frames chosen up to it; None if the pose is unobservable.
    """

    name: str
    gain: float
    places: int
    accuracy: Accuracy | None


Wanted = tuple[float, float]
"""Required accuracy at 67 %, in deg and m."""


def choose(
    frames: Sequence[SeenEdges],
    *,
    count: int | None = None,
    wanted: Wanted | None = None,
    most: int = 12,
    least_gain: float = 0.05,
) -> list[Step]:
    """Choose frames for a joint calibration, in each step the one with the largest gain (greedy D-optimal design).

    The information (6, 6) of a frame is the sum over its places; its determinant grows with edges of all directions,
    near and far, spread over the image. Places that a chosen frame of the same scene already contains count a tenth.
    With `count`, this number is chosen; otherwise frames are added until `wanted` is reached or, without it, until a
    further frame reduces both predicted errors by less than the share `least_gain`, and at most `most`.
    """
    left, chosen, steps = list(frames), list[SeenEdges](), list[Step]()
    total: Float = np.diag(_PRIOR**-2.0)
    while left and len(steps) < (most if count is None else count):
        added = [_added(frame, chosen) for frame in left]
        gains = [float(np.linalg.slogdet(total + new)[1] - np.linalg.slogdet(total)[1]) for new, _ in added]
        best = int(np.argmax(gains))
        chosen.append(left.pop(best))
        total = total + added[best][0]
        step = Step(chosen[-1].name, gains[best], added[best][1], expected(chosen, total))
        if count is None and wanted is None and steps and _little(steps[-1], step, least_gain):
            break
        steps.append(step)
        if count is None and wanted is not None and step.accuracy is not None and step.accuracy.reaches(*wanted):
            break
    return steps


def expected(chosen: Sequence[SeenEdges], information: Float) -> Accuracy | None:
    """Predict the accuracy of the pose from these frames, without the initial guess; None if they have no pairs.

    `information` (6, 6) is that of a left update. Systematic errors are those of a result (`likely_accuracy`), but
    frames of one scene add no independent rings. The odds of agreement are assumed to be 10.
    """
    problem = _together([frame.problem for frame in chosen])
    if not len(problem):
        return None
    pose = chosen[0].camera_from_lidar
    # The position of an outline between two rings is independent in different scenes only.
    budget = ErrorBudget.of(np.asarray(np.linalg.inv(information), np.float64), problem, pose, _distinct(chosen))
    points, places = len(problem), sum(len(frame.places) for frame in chosen)
    met = Agreement(near=0.5, chance=1 / (1 + _ODDS_RATIO), points=points, places=places)
    return likely_accuracy(budget, pose, met)


def open_axes(accuracy: Accuracy, wanted: Wanted) -> list[str]:
    """Return the names of the axes with the largest errors, for rotation and translation that miss the requirement."""
    words: list[str] = []
    for size, bound, axes in (
        (accuracy.rotation_deg, wanted[0], ("roll_deg", "pitch_deg", "yaw_deg")),
        (accuracy.translation_m, wanted[1], ("x_m", "y_m", "z_m")),
    ):
        values = {axis: getattr(accuracy, axis) or 0.0 for axis in axes}
        if size > bound:
            words += [_WORDS[axis] for axis, value in values.items() if value >= 0.6 * max(values.values())]
    return words


_WORDS = {"roll_deg": "roll", "pitch_deg": "pitch", "yaw_deg": "yaw"}
_WORDS |= {"x_m": "the place to the side", "y_m": "height", "z_m": "the place along the view"}


def shortage(chosen: Sequence[SeenEdges], words: Sequence[str]) -> str:
    """Explain why these axes are weakly observable, by the direction, distance and image position of the edges."""
    sides = np.array([place[0] for frame in chosen for place in frame.places])
    level, upright = (int(np.isin(sides, group).sum()) for group in (LEVEL, UPRIGHT))
    near = sum(len(np.unique(f._labels[1][f.depth_m < NEAR_M])) for f in chosen)
    reasons = []
    if len(words) > len(_WORDS) // 2:
        scenes = _distinct(chosen)
        return f"{len(chosen)} frames of {scenes} scene{'s' if scenes != 1 else ''} are too few for every axis"
    if {"pitch", "height"} & set(words) and level <= upright:
        reasons.append(f"{level} of {len(sides)} places have level edges (roofs, sills, tops and bottoms of things)")
    if {"yaw", "the place to the side"} & set(words) and upright <= level:
        reasons.append(f"{upright} of {len(sides)} places have upright edges (poles, corners, sides of cars)")
    if any(word in words for word in ("height", "the place to the side", "the place along the view")):
        reasons.append(f"{near} of {len(sides)} places are nearer than {NEAR_M:g} m")
    if "roll" in words or not reasons:
        reasons.append(f"there are {len(sides)} places with edges, and few of them at the sides of the image")
    return "; ".join(reasons)


def _distinct(chosen: Sequence[SeenEdges]) -> int:
    """Return the number of distinct scenes of the frames."""
    return sum(not any(f.same_place(other) for other in chosen[:number]) for number, f in enumerate(chosen))


def _added(frame: SeenEdges, chosen: Sequence[SeenEdges]) -> tuple[Float, int]:
    """Return the information (6, 6) that a frame adds to the chosen ones, and the number of its new places."""
    known = {place for other in chosen if frame.same_place(other) for place in other.places}
    again = np.array([place in known for place in frame.places], dtype=bool)
    share = np.where(again, _AGAIN, 1.0)
    return np.asarray(np.einsum("p,pij->ij", share, frame.by_place)), int((~again).sum())


def _little(before: Step, after: Step, least: float) -> bool:
    """Return whether a frame reduces the predicted errors by less than the share `least`."""
    if before.accuracy is None or after.accuracy is None:
        return before.accuracy is not None
    sizes = [(a.rotation_deg, a.translation_m) for a in (before.accuracy, after.accuracy)]
    return all(new > (1 - least) * old for old, new in zip(*sizes, strict=True))


def _together(problems: Sequence[PointToLine]) -> PointToLine:
    """Concatenate the pairs of several frames to one problem."""
    names = ("xyz", "centre", "normal", "weight", "side", "time_s", "sigma_px")
    columns: dict[str, Any] = {name: np.concatenate([getattr(problem, name) for problem in problems]) for name in names}
    starts = np.cumsum([0, *(len(problem.cameras) for problem in problems[:-1])])
    frame = np.concatenate([problem.frame + start for problem, start in zip(problems, starts, strict=True)])
    cameras = tuple(camera for problem in problems for camera in problem.cameras)
    return replace(problems[0], **columns, frame=frame, cameras=cameras)
