"""How much later than its sweep a picture was taken, from how camera and LiDAR turn on one drive.

A delay shifts the turns of one sensor in time against those of the other. So the LiDAR's poses are asked at shifted
times (rotations between poses by SLERP), and the shift counts at which both turn alike. Turns are vectors
along their axes; those of the LiDAR are taken into the camera frame by a rotation that is about right: one that is 1
degree off changes 0.02 % of them. A drive that does not turn, or turns evenly, tells nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int

_RISE = 6.0
"""Other delays fit worse than the best one by so many times the root of how many numbers are compared.

Ours: where a drive turns evenly, noise alone makes it 2 to 4; where it tells the delay to 20 ms, it is 11 and more.
"""


@dataclass(frozen=True, eq=False)
class Drive:
    """How both sensors turn on one drive.

    `turn` (N, 3) are the rotation vectors (rad, camera frame) by which points turn in the camera from `begin_s` (N,) to
    `end_s` (N,), the times of two pictures, and `steps` (N, 2) the first and the last of the steps from picture to
    picture that they are made of. `pose_s` (M,) are the rising times at which the LiDAR's pose is known, and
    `world_from_lidar` (M, 4, 4) its poses then.
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
        """Return the turns between all pictures that are at most `span_s` apart, and those of single steps.

        `second_from_first` are the rotations (3, 3) from each picture to the next, None where it is not known; pictures
        and poses have the same times (M,).
        """
        begin, end, turn, steps = [], [], [], []
        for first in range(len(second_from_first)):
            whole = np.eye(3)
            for last in range(first, len(second_from_first)):
                step = second_from_first[last]
                if step is None or (last > first and times_s[last + 1] - times_s[first] > span_s):
                    break
                whole = step @ whole
                begin.append(times_s[first])
                end.append(times_s[last + 1])
                turn.append(p2o.se3.rotation_vector(whole))
                steps.append((first, last))
        return cls(
            np.array(begin, np.float64),
            np.array(end, np.float64),
            np.reshape(turn, (-1, 3)),
            np.reshape(np.array(steps, np.int64), (-1, 2)),
            np.asarray(times_s, np.float64),
            np.asarray(world_from_lidar, np.float64),
        )

    def within(self, longest_s: float) -> Bool:
        """Return which turns (N,) the poses cover at every delay of at most `longest_s`."""
        slack_s = 1e-9
        early = self.begin_s - longest_s >= self.pose_s[0] - slack_s
        return np.asarray(early & (self.end_s + longest_s <= self.pose_s[-1] + slack_s))

    def lidar_turn(self, delay_s: float, chosen: Bool) -> Float:
        """Return the rotation vectors (K, 3) of the LiDAR, in its own frame, that belong to turns (N,) at a delay."""
        from scipy.spatial.transform import Rotation, Slerp

        poses = Slerp(self.pose_s, Rotation.from_matrix(self.world_from_lidar[:, :3, :3]))
        first, second = (
            poses(np.clip(times[chosen] + delay_s, self.pose_s[0], self.pose_s[-1]))
            for times in (self.begin_s, self.end_s)
        )
        return np.asarray((second.inv() * first).as_rotvec(), np.float64)


@dataclass(frozen=True)
class Delay:
    """Pictures were taken `delay_s` after what their times say by the LiDAR's clock, give or take `sigma_s`.

    So many `steps` from picture to picture tell so. Turns agree to `off_deg` a step (root mean square); `explained`
    is the share of the camera's turns (squared) that are the LiDAR's as well. `inside` is False where the best delay
    is the longest one that was tried.
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
    """Return the delay of the camera that all drives tell together; None where no turn is covered by poses.

    `camera_from_lidar` (4, 4) is about right in rotation. Delays of up to `longest_s` are tried, `step_s` apart, and a
    parabola around the best one tells where the squares are least. A turn of n steps weighs 1/n, for errors of
    odometry add up; turns that are off by much more than most weigh less (Huber). `sigma_s` is the larger one of what
    the squares' bend says and of the jackknife over steps, which knows of what lies between poses as well; infinite
    where other delays fit about as well, as on a drive that turns evenly.

    Turns of several steps are there for the LiDAR's noise: between two poses it is smaller than at them, which draws
    the delay of single steps to between the poses.
    """
    chosen = [drive.within(longest_s) for drive in drives]
    if not any(each.any() for each in chosen):
        return None
    turns = np.concatenate([drive.turn[each] for drive, each in zip(drives, chosen, strict=True)])
    steps = _numbered([drive.steps[each] for drive, each in zip(drives, chosen, strict=True)])
    half = max(int(np.ceil(longest_s / step_s - 1e-9)), 1)
    delays_s = np.linspace(-longest_s, longest_s, 2 * half + 1)

    def off(delay_s: float) -> Float:
        there = [drive.lidar_turn(delay_s, each) for drive, each in zip(drives, chosen, strict=True)]
        return np.linalg.norm(turns - np.concatenate(there) @ camera_from_lidar[:3, :3].T, axis=1)

    lasting = steps[:, 1] - steps[:, 0] + 1.0
    every = np.array([off(delay_s) for delay_s in delays_s]) / np.sqrt(lasting)
    weight = np.ones(len(turns))
    for _ in range(3):
        best = int(np.argmin((weight * every**2).sum(axis=1)))
        usual = max(1.5 * float(np.median(every[best])), 1e-9)
        weight = np.minimum(1.0, usual / np.maximum(every[best], 1e-12))
    parts = weight * every**2
    low = _lowest(delays_s, parts.sum(axis=1))
    used = np.unique(np.concatenate([np.arange(first, last + 1) for first, last in steps.tolist()]))
    # Turns overlap: no more is known than what single steps tell, three numbers each.
    variance = low.least / float(weight.sum()) / 3.0 * len(turns) / max(len(used) - 1, 1)
    rise = (float(np.median(parts.sum(axis=1))) - low.least) / max(low.least, 1e-18) * np.sqrt(3 * len(used))
    usual_s = float(np.median(np.concatenate([np.diff(drive.pose_s) for drive in drives])))
    bend = _bend(delays_s, parts.sum(axis=1), low, usual_s)
    sigma_s = float(np.sqrt(2 * variance / bend)) if bend > 0 and rise > _RISE else np.inf
    all_of_it = float((weight * (turns**2).sum(axis=1) / lasting).sum())
    return Delay(
        low.delay_s,
        max(sigma_s, _spread_s(delays_s, parts, steps, used)),
        len(used),
        float(np.degrees(np.sqrt(low.least / weight.sum()))),
        1.0 - low.least / all_of_it if all_of_it > 0 else 0.0,
        low.inside,
    )


def _numbered(steps: Sequence[Int]) -> Int:
    """Return the steps (N, 2) of several drives as those of one, none shared."""
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
    """Return where squares (D,) at delays (D,) in equal steps are lowest, by a parabola around the best one."""
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
    """Return the second derivative (1/s^2) of the squares (D,) about their lowest point, over a period to either side.

    Between poses the squares swell with the noise of the LiDAR, with the period of the poses, and that tells nothing.
    """
    grid_s = float(delays_s[1] - delays_s[0])
    reach_s = max(min(period_s, float(delays_s[-1]) - abs(low.delay_s)), grid_s)
    sides = np.interp([low.delay_s - reach_s, low.delay_s + reach_s], delays_s, squares)
    return float(sides.sum() - 2 * low.least) / reach_s**2


def _spread_s(delays_s: Float, parts: Float, steps: Int, used: Int) -> float:
    """Return the jackknife's deviation of the delay: from leaving out each step of squares (D, N) in turn."""
    found = []
    for step in used:
        other = (steps[:, 0] > step) | (steps[:, 1] < step)
        if other.any():
            found.append(_lowest(delays_s, parts[:, other].sum(axis=1)).delay_s)
    return float(np.sqrt((len(found) - 1) * np.var(found))) if len(found) > 1 else np.inf


def twists(times_s: Float, world_from_lidar: Float, *, backwards: bool) -> Float:
    """Return the velocity (M, 6) at each pose (M, 4, 4), rad/s and m/s in the LiDAR frame, of a drive of at least two.

    It is that towards the next pose, or since the last one (`backwards`); the one at the end is its neighbour's.
    """
    steps = p2o.se3.inverse(world_from_lidar[:-1]) @ world_from_lidar[1:]
    rates = np.array([p2o.se3.log(step) for step in steps]) / np.diff(times_s)[:, None]
    return np.concatenate([rates[:1], rates] if backwards else [rates, rates[-1:]])
