"""Path of a vehicle: tables of poses, nearest times, interpolation, velocity, and its effect on a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Cloud, Float, InputError, Int, se3

_SECOND = 1_000_000_000
# Within this time the path between two poses is nearly a motion at constant velocity.
_MAX_GAP_NS = _SECOND
_MAX_SPEED_M_S = 100.0
# Time before the first and after the last pose for which the motion is extrapolated.
_MARGIN_NS = _SECOND // 5


@dataclass(frozen=True, eq=False)
class EgoPath:
    """Poses world_from_body (N, 4, 4) of a body on the vehicle at ascending times (N,) in nanoseconds.

    `where` is the file that errors name. Raises InputError without poses, and if the times do not ascend.
    """

    time_ns: Int
    world_from_body: Float
    where: Path

    def __post_init__(self) -> None:
        if not len(self.time_ns):
            raise InputError("there are no poses of the vehicle", where=self.where, expected="at least one")
        if (np.diff(self.time_ns) <= 0).any():
            raise InputError("the times of the poses do not ascend", where=self.where)
        refuse_jump(self.world_from_body[:, :3, 3], np.diff(self.time_ns) / _SECOND, self.where)

    def fixed_to(self, body_from_sensor: Float) -> EgoPath:
        """Return the path of a sensor that is fixed to this body."""
        return replace(self, world_from_body=self.world_from_body @ body_from_sensor)

    def at(self, time_ns: int) -> Float:
        """Return world_from_body (4, 4) at a time, interpolated at constant velocity.

        Raises InputError in gaps of more than 1 s, and more than 0.2 s before the first or after the last pose.
        """
        here = int(nearest(self.time_ns, np.array([time_ns]))[0])
        if self.time_ns[here] == time_ns:
            return np.asarray(self.world_from_body[here])
        start = int(np.clip(np.searchsorted(self.time_ns, time_ns) - 1, 0, max(len(self.time_ns) - 2, 0)))
        gap_ns = 0 if len(self.time_ns) == 1 else int(self.time_ns[start + 1] - self.time_ns[start])
        first, last = int(self.time_ns[0]), int(self.time_ns[-1])
        if not 0 < gap_ns <= _MAX_GAP_NS or not first - _MARGIN_NS <= time_ns <= last + _MARGIN_NS:
            away_s = abs(int(self.time_ns[here]) - time_ns) / _SECOND
            fault = "there is no pose of the vehicle near the requested time"
            got = f"the nearest is {away_s:.3g} s away"
            raise InputError(fault, where=self.where, expected=f"poses before and after {time_ns} ns", got=got)
        before, after = self.world_from_body[start], self.world_from_body[start + 1]
        share = (time_ns - int(self.time_ns[start])) / gap_ns
        return np.asarray(before @ se3.exp(share * se3.log(se3.inverse(before) @ after)))

    def twist(self, from_ns: int, to_ns: int) -> Float:
        """Return the mean velocity (6,) between two times in the body's own frame, in rad/s and m/s."""
        tangent: Float = se3.log(se3.inverse(self.at(from_ns)) @ self.at(to_ns))
        return tangent / ((to_ns - from_ns) / _SECOND)

    def twist_or_none(self, from_ns: int, to_ns: int) -> Float | None:
        """Return the mean velocity (6,) as `twist`, or None if the poses do not cover both times."""
        try:
            return self.twist(from_ns, to_ns)
        except InputError:
            return None


def refuse_jump(positions_m: Float, seconds: Any, where: Path) -> None:
    """Raise InputError if a vehicle at successive positions (N, 3) moves faster than 100 m/s, with a margin of 1 m.

    `seconds` (N - 1,) are the times between them, or one time for all.
    """
    step_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    wrong = np.flatnonzero(step_m > 1 + _MAX_SPEED_M_S * np.abs(seconds))
    if len(wrong):
        fault, expected = "the vehicle jumps between two poses", f"at most 1 m + {_MAX_SPEED_M_S:g} m/s"
        got = f"{step_m[wrong[0]]:.4g} m after {positions_m[wrong[0]].round(2).tolist()}"
        raise InputError(fault, where=where, expected=expected, got=got)


def moved_cloud(cloud: Cloud, now_from_then: Float) -> Cloud:
    """Return a sweep in the frame of its LiDAR at another time, given `now_from_then` (4, 4)."""
    return replace(cloud, xyz=se3.apply(now_from_then, cloud.xyz))


def nearest(sorted_times: Int, wanted: Int) -> Int:
    """Return the indices (N,) of the times nearest to the wanted times (N,); the earlier one at equal distance.

    `sorted_times` (M,) ascend, M at least 1; all are integers of the same unit.
    """
    if len(sorted_times) == 1:
        return np.zeros(len(wanted), np.int64)
    after = np.clip(np.searchsorted(sorted_times, wanted), 1, len(sorted_times) - 1)
    before = after - 1
    return np.where(wanted - sorted_times[before] <= sorted_times[after] - wanted, before, after)


# The same bounds as in `p2o.geometry.pose_text`.
_LENGTH_TOLERANCE, _MAX_DISTANCE_M = 1e-2, 1e9


def pose_rows(xyzw: Any, translation_m: Any, where: Path, names: Sequence[object] | None = None) -> Float:
    """Return the poses (N, 4, 4) of quaternions x y z w (N, 4) and translations (N, 3) in metres.

    `names` identify the rows in errors. Raises InputError for values that are not finite, quaternions whose length
    differs from 1 by more than 0.01, and implausible translations.
    """
    from scipy.spatial.transform import Rotation

    quaternions = np.asarray(xyzw, dtype=np.float64).reshape(-1, 4)
    translations = np.asarray(translation_m, dtype=np.float64).reshape(-1, 3)
    poses = np.tile(np.eye(4), (len(quaternions), 1, 1))
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(np.linalg.norm(quaternions, axis=1) - 1)
        wrong = ~(error < _LENGTH_TOLERANCE) | ~(np.abs(translations) <= _MAX_DISTANCE_M).all(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        values = " ".join(f"{value:g}" for value in (*quaternions[row], *translations[row]))
        fault = f"the pose of {names[row] if names is not None else f'row {row}'} is invalid"
        expected = "a quaternion x y z w of length 1 and a translation in metres"
        raise InputError(fault, where=where, expected=expected, got=values)
    if len(quaternions):
        poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    poses[:, :3, 3] = translations
    return poses
