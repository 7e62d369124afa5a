"""The way of a car: its poses at times, the pose between them, its velocity, and what that does to a sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from p2o import Cloud, InputError, se3
from p2o.arrays import Float, Int

from p2o_plugins.data.time_pairs import nearest

_SECOND = 1_000_000_000
# Cars do not turn within such a time so that the way between two poses is another than the straight one.
_LONGEST_GAP_NS = _SECOND
# How far before the first and after the last pose the car is taken to go on as it did.
_BEYOND_NS = _SECOND // 5


@dataclass(frozen=True, eq=False)
class EgoPath:
    """Poses world_from_body (N, 4, 4) of something on the car at ascending times (N,) in nanoseconds.

    `where` names the file in errors. Raises InputError without poses, and where times do not ascend.
    """

    time_ns: Int
    world_from_body: Float
    where: Path

    def __post_init__(self) -> None:
        if not len(self.time_ns):
            raise InputError("there are no poses of the car", where=self.where, expected="at least one")
        if (np.diff(self.time_ns) <= 0).any():
            raise InputError("the times of the poses do not ascend", where=self.where, expected="each after the last")

    def fixed_to(self, body_from_sensor: Float) -> EgoPath:
        """Return the way of a sensor that is fixed to this body."""
        return replace(self, world_from_body=self.world_from_body @ body_from_sensor)

    def at(self, time_ns: int) -> Float:
        """Return world_from_body (4, 4) at a time, between two poses at constant velocity.

        Raises InputError where no poses are near: a gap of more than a second, or more than 0.2 s beyond the ends.
        """
        here = int(nearest(self.time_ns, np.array([time_ns]))[0])
        if self.time_ns[here] == time_ns:
            return np.asarray(self.world_from_body[here])
        start = int(np.clip(np.searchsorted(self.time_ns, time_ns) - 1, 0, max(len(self.time_ns) - 2, 0)))
        gap_ns = 0 if len(self.time_ns) == 1 else int(self.time_ns[start + 1] - self.time_ns[start])
        first, last = int(self.time_ns[0]), int(self.time_ns[-1])
        if not 0 < gap_ns <= _LONGEST_GAP_NS or not first - _BEYOND_NS <= time_ns <= last + _BEYOND_NS:
            away_s = abs(int(self.time_ns[here]) - time_ns) / _SECOND
            raise InputError(
                "there is no pose of the car near",
                where=self.where,
                expected=f"poses before and after {time_ns} ns",
                got=f"the nearest is {away_s:.3g} s away",
            )
        before, after = self.world_from_body[start], self.world_from_body[start + 1]
        share = (time_ns - int(self.time_ns[start])) / gap_ns
        return np.asarray(before @ se3.exp(share * se3.log(se3.inverse(before) @ after)))

    def twist(self, from_ns: int, to_ns: int) -> Float:
        """Return the mean velocity (6,) between two times in the body's own frame, in rad/s and m/s."""
        tangent: Float = se3.log(se3.inverse(self.at(from_ns)) @ self.at(to_ns))
        return tangent / ((to_ns - from_ns) / _SECOND)


def now_from_then(world_from_body_now: Float, world_from_body_then: Float) -> Float:
    """Return what takes points that stand still from the body's frame of then to its frame of now (4, 4)."""
    moved: Float = se3.inverse(world_from_body_now) @ world_from_body_then
    return moved


def moved_cloud(cloud: Cloud, now_from_then: Float) -> Cloud:
    """Return a sweep in the frame that its LiDAR had at another moment, by `now_from_then` (4, 4)."""
    return replace(cloud, xyz=se3.apply(now_from_then, cloud.xyz))
