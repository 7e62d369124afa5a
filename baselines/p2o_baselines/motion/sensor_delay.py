"""Estimate the delay of the camera relative to the LiDAR from the rotations of both on one drive.

A delay shifts the rotations of one sensor in time relative to the other. The LiDAR's poses are interpolated at shifted
times (SLERP), and the delay is the shift at which both rotations agree. Rotations are rotation vectors; those of the
LiDAR are expressed in the camera frame by an approximate extrinsic rotation, whose error of 1 degree changes them by
0.02 %. A drive without rotation, or with constant rotation, does not determine the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import p2o
from p2o import Bool, Float, Int

_RISE = 6.0
"""Other delays must fit worse than the best one by this multiple of the root of the number of residuals.

Ours: with constant rotation, noise alone makes it 2 to 4; if the delay is determined to 20 ms, it is 11 and more.
"""


@dataclass(frozen=True, eq=False)
class Drive:
    """Rotations of both sensors on one drive.

    `turn` (N, 3) are the rotation vectors (rad, camera frame) of points in the camera from `begin_s` (N,) to `end_s`
    (N,), the times of two images, and `steps` (N, 2) the first and the last of the steps from image to image that they
    consist of. `pose_s` (M,) are the increasing times of the known LiDAR poses `world_from_lidar` (M, 4, 4).
    """

    begin_s: Float
    end_s: Float
    turn: Float
    steps: Int
    pose_s: Float
    world_from_lidar: Float

    @classmethod
    def of(
        cls, times_s: Float, second_from_first: Sequence[Float | None], world_from_lidar: Float, *, span_s: float
    ) -> Drive:
        """Return the rotations (3, 3) of steps, None if unknown, combined between images at most `span_s` apart."""
        rows, steps = [], []
        for first in range(len(second_from_first)):
            whole = np.eye(3)
            for last in range(first, len(second_from_first)):
                step = second_from_first[last]
                if step is None or (last > first and times_s[last + 1] - times_s[first] > span_s):
                    break
                whole = step @ whole
                rows.append((times_s[first], times_s[last + 1], *p2o.se3.rotation_vector(whole)))
                steps.append((first, last))
        table = np.reshape(np.array(rows, np.float64), (-1, 5))
        numbers = np.reshape(np.array(steps, np.int64), (-1, 2))
        poses = np.asarray(world_from_lidar, np.float64)
        return cls(table[:, 0], table[:, 1], table[:, 2:], numbers, np.asarray(times_s, np.float64), poses)

    def within(self, longest_s: float) -> Bool:
        """Return which turns (N,) the poses cover at every delay of at most `longest_s`."""
        slack_s = 1e-9
        early = self.begin_s - longest_s >= self.pose_s[0] - slack_s
        return np.asarray(early & (self.end_s + longest_s <= self.pose_s[-1] + slack_s))

    def lidar_turn(self, delay_s: float, chosen: Bool) -> Float:
        """Return the rotation vectors (K, 3) of the LiDAR, in its own frame, that belong to turns (N,) at a delay."""
        from scipy.spatial.transform import Rotation, Slerp

        poses = Slerp(self.pose_s, Rotation.from_matrix(self.world_from_lidar[:, :3, :3]))
        ends = (np.clip(times[chosen] + delay_s, *self.pose_s[[0, -1]]) for times in (self.begin_s, self.end_s))
        first, second = (poses(times) for times in ends)
        return np.asarray((second.inv() * first).as_rotvec(), np.float64)


@dataclass(frozen=True)
class Delay:
    """Images were taken `delay_s` after their time stamps by the LiDAR's clock, with standard deviation `sigma_s`.

    `steps` is the number of steps from image to image. Rotations agree to `off_deg` per step (root mean square);
    `explained` is the share of the camera's squared rotations that the LiDAR explains. `inside` is False if the best
    delay is at the limit of the search range.
    """

    delay_s: float
    sigma_s: float
    steps: int
    off_deg: float
    explained: float
    inside: bool


def delay_of(
    drives: Sequence[Drive], camera_from_lidar: Float, *, longest_s: float = 0.2, step_s: float = 0.005
) -> Delay | None:
    """Return the delay of the camera estimated from all drives; None if no rotation is covered by poses.

    `camera_from_lidar` (4, 4) has an approximate rotation. Delays of up to `longest_s` are evaluated, `step_s` apart,
    and a parabola through the best ones gives the minimum. A rotation over n steps has weight 1/n, because errors of
    odometry add up; several steps reduce the noise of the LiDAR, which is smaller between two poses than at them and
    biases the delay of single steps. Outliers are downweighted (Huber). `sigma_s` is the larger of two estimates: from
    the curvature of the squares and from the jackknife over steps; infinite if other delays fit equally well.
    """
    chosen = [drive.within(longest_s) for drive in drives]
    if not any(each.any() for each in chosen):
        return None
    pairs = list(zip(drives, chosen, strict=True))
    turns = np.concatenate([drive.turn[each] for drive, each in pairs])
    steps = _numbered([drive.steps[each] for drive, each in pairs])
    half = max(int(np.ceil(longest_s / step_s - 1e-9)), 1)
    delays_s = np.linspace(-longest_s, longest_s, 2 * half + 1)

    def off(delay_s: float) -> Float:
        lidar_turns = np.concatenate([drive.lidar_turn(delay_s, each) for drive, each in pairs])
        return np.asarray(np.linalg.norm(turns - lidar_turns @ camera_from_lidar[:3, :3].T, axis=1))

    span = steps[:, 1] - steps[:, 0] + 1.0
    every = np.array([off(delay_s) for delay_s in delays_s]) / np.sqrt(span)
    weight = np.ones(len(turns))
    for _ in range(3):
        best = int(np.argmin((weight * every**2).sum(axis=1)))
        usual = max(1.5 * float(np.median(every[best])), 1e-9)
        weight = np.minimum(1.0, usual / np.maximum(every[best], 1e-12))
    parts = weight * every**2
    squares = parts.sum(axis=1)
    low = _lowest(delays_s, squares)
    used = np.unique(np.concatenate([np.arange(first, last + 1) for first, last in steps.tolist()]))
    # Rotations overlap: the information is limited to that of the single steps, three numbers each.
    variance = low.least / float(weight.sum()) / 3.0 * len(turns) / max(len(used) - 1, 1)
    rise = (float(np.median(squares)) - low.least) / max(low.least, 1e-18) * np.sqrt(3 * len(used))
    usual_s = float(np.median(np.concatenate([np.diff(drive.pose_s) for drive in drives])))
    bend = _bend(delays_s, squares, low, usual_s)
    sigma_s = float(np.sqrt(2 * variance / bend)) if bend > 0 and rise > _RISE else np.inf
    sigma_s = max(sigma_s, _spread_s(delays_s, parts, steps, used))
    off_deg = float(np.degrees(np.sqrt(low.least / weight.sum())))
    whole = float((weight * (turns**2).sum(axis=1) / span).sum())
    return Delay(low.delay_s, sigma_s, len(used), off_deg, 1.0 - low.least / whole if whole > 0 else 0.0, low.inside)


def _numbered(steps: Sequence[Int]) -> Int:
    """Concatenate the steps (N, 2) of several drives without shared indices."""
    first, out = 0, []
    for each in steps:
        out.append(each + first)
        first += int(each.max(initial=-1)) + 1
    return np.concatenate(out)


class _Lowest(NamedTuple):
    """The lowest point of the squares, and whether they rise to both sides."""

    delay_s: float
    least: float
    inside: bool


def _lowest(delays_s: Float, squares: Float) -> _Lowest:
    """Return the delay of the minimum of squares (D,) at equally spaced delays (D,), by a parabola."""
    best = int(np.argmin(squares))
    at = int(np.clip(best, 1, len(delays_s) - 2))
    before, here, after = (float(each) for each in squares[at - 1 : at + 2])
    grid_s, curve = float(delays_s[1] - delays_s[0]), before - 2 * here + after
    delay_s, least, inside = float(delays_s[best]), float(squares[best]), 0 < best < len(delays_s) - 1
    if inside and curve > 0:
        delay_s += grid_s * 0.5 * (before - after) / curve
        least -= (before - after) ** 2 / (8 * curve)
    return _Lowest(delay_s, max(least, 0.0), inside)


def _bend(delays_s: Float, squares: Float, low: _Lowest, period_s: float) -> float:
    """Return the second derivative (1/s^2) of squares (D,) at their minimum, over one period of the poses."""
    grid_s = float(delays_s[1] - delays_s[0])
    reach_s = max(min(period_s, float(delays_s[-1]) - abs(low.delay_s)), grid_s)
    sides = np.interp([low.delay_s - reach_s, low.delay_s + reach_s], delays_s, squares)
    return float(sides.sum() - 2 * low.least) / reach_s**2


def _spread_s(delays_s: Float, parts: Float, steps: Int, used: Int) -> float:
    """Return the jackknife's deviation of the delay: from leaving out each step of squares (D, N) in turn."""
    curvatures = []
    for step in used:
        other = (steps[:, 0] > step) | (steps[:, 1] < step)
        if other.any():
            curvatures.append(_lowest(delays_s, parts[:, other].sum(axis=1)).delay_s)
    return float(np.sqrt((len(curvatures) - 1) * np.var(curvatures))) if len(curvatures) > 1 else np.inf


def twists(times_s: Float, world_from_lidar: Float, *, backwards: bool) -> Float:
    """Return the velocity (M, 6) rad/s and m/s at each pose, towards the next one, or since the last (`backwards`)."""
    steps = p2o.se3.inverse(world_from_lidar[:-1]) @ world_from_lidar[1:]
    rates = np.array([p2o.se3.log(step) for step in steps]) / np.diff(times_s)[:, None]
    return np.concatenate([rates[:1], rates] if backwards else [rates, rates[-1:]])
