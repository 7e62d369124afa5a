"""One LiDAR sweep."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from p2o.arrays import Bool, Float, Int, checked
from p2o.errors import InputError
from p2o.geometry.motion import moved


@dataclass(frozen=True, eq=False)
class Cloud:
    """One sweep; `xyz` (N, 3) in metres, LiDAR frame, in the order of the sensor or file.

    Optional per point: `ring` (N,) beam index, any order; `intensity` (N,) in units of the sensor; `time_s` (N,)
    seconds relative to the image; `column` (N,) firing index. Use `Cloud.from_raw` for data with missing returns. A
    motion-compensated sweep has `twist` (6,), the sensor's velocity in rad/s and m/s in its own frame: points are as
    measured at time 0, and `as_measured` inverts the compensation. Raises InputError for wrong shapes, no points,
    points that are not finite, and a twist without times.
    """

    xyz: Float
    ring: Int | None = None
    intensity: Float | None = None
    time_s: Float | None = None
    column: Int | None = None
    twist: Float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("xyz", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        if count == 0:
            raise InputError("the cloud has no points", expected="at least one point")
        for name in ("ring", "intensity", "time_s", "column"):
            value, dtype = getattr(self, name), np.int64 if name in ("ring", "column") else np.float64
            if value is not None:
                object.__setattr__(self, name, checked(name, value, (count,), dtype))
        if self.twist is not None:
            object.__setattr__(self, "twist", checked("twist", self.twist, (6,), np.float64))
            if self.time_s is None:
                raise InputError("a motion-compensated sweep has no times", expected="time_s", got="none")

    @classmethod
    def from_raw(cls, xyz: Any, **per_point: Any) -> tuple[Cloud, tuple[str, ...]]:
        """Return the cloud without NaN, infinite and all-zero points (missing returns), and warnings with their number.

        Raises InputError if no point is left.
        """
        xyz = checked("xyz", xyz, (None, 3), np.float64, finite=False)
        finite = np.isfinite(xyz).all(axis=1)
        zero = finite & ~xyz.any(axis=1)
        keep = finite & ~zero
        if len(xyz) and not keep.any():
            kind = "all-zero" if zero.any() else "NaN or infinite"
            raise InputError("the cloud has no valid point", expected="finite points", got=f"{len(xyz)} {kind} points")
        counts = {"NaN or infinite": int((~finite).sum()), "all zero": int(zero.sum())}
        warnings = [f"{n} of {len(xyz)} points dropped: {why}" for why, n in counts.items() if n]
        kept: dict[str, Any] = {k: None if v is None else np.asarray(v)[keep] for k, v in per_point.items()}
        return cls(xyz[keep], **kept), tuple(warnings)

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, index: Int | Bool) -> Cloud:
        """Return the points of an index or mask, with all fields."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "twist"}
        picked: dict[str, Any] = {name: None if value is None else value[index] for name, value in values.items()}
        return Cloud(**picked, twist=self.twist)

    def untwisted(self, twist: Float) -> Cloud:
        """Return the sweep as measured at time 0 from a sensor with constant velocity `twist` (6,).

        The twist is in the LiDAR frame (rad/s, m/s); points measured at t are transformed by exp(twist t). Times are
        kept, and the twist is stored. A sweep without times is unchanged; an earlier compensation is inverted first.
        """
        if self.time_s is None:
            return self
        return replace(self, xyz=moved(twist, self.time_s, self.as_measured()), twist=twist)

    def later(self, by_s: float, twist: Float) -> Cloud:
        """Return the sweep with time 0 shifted by `by_s` seconds, for a sensor with velocity `twist` (6,).

        A motion-compensated sweep is compensated to the new time 0, a sweep without times is transformed as a whole,
        and a raw sweep keeps its points.
        """
        time_s = None if self.time_s is None else self.time_s - by_s
        if self.twist is not None:
            return replace(self, xyz=self.as_measured(), time_s=time_s, twist=None).untwisted(self.twist)
        if time_s is not None:
            return replace(self, time_s=time_s)
        return replace(self, xyz=moved(twist, np.full(len(self), -by_s), self.xyz))

    def as_measured(self) -> Float:
        """Return the points (N, 3) as measured, each in the sensor frame at its own time; `xyz` without `twist`.

        In these coordinates rings are cones and beams are evenly spaced.
        """
        if self.twist is None or self.time_s is None:
            return self.xyz
        return moved(self.twist, -self.time_s, self.xyz)
