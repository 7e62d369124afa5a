"""The check of an extrinsic in use: whether it still holds, axis by axis, and since when it does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from p2o.results.evidence import Agreement
from p2o.results.json_types import Count, Derived, Flag, Number, Pose, Tree


class CheckStatus(StrEnum):
    """Whether an extrinsic holds, on one axis or on all checked axes."""

    HOLDS = "holds"
    OFF = "off"
    CANNOT_TELL = "cannot-tell"


def size_text(unit: str, size: float, spec: str = "") -> str:
    """Return a size in deg or m as text, in degrees or centimetres; `spec` is "+" for a sign."""
    return f"{size:{spec}.2f} deg" if unit == "deg" else f"{100 * size:{spec}.1f} cm"


@dataclass(frozen=True)
class AxisCheck:
    """One camera axis: `axis` is roll, pitch, yaw, x, y or z, and numbers are in `unit`, deg or m.

    `off` is the signed error of the extrinsic against the pose estimated from edges, `sigma` its standard deviation,
    `limit` the smallest error of this axis alone that is detected at the stated rates; all None without evidence.
    """

    axis: str
    unit: str
    holding: CheckStatus
    off: Number | None = None
    sigma: Number | None = None
    limit: Number | None = None


@dataclass(frozen=True, eq=False)
class Check:
    """The check of an extrinsic camera_from_lidar (4, 4) on these frames; the extrinsic is not changed.

    `holding` is the outcome over all axes, `reason` explains it; `estimate` (4, 4) is the pose estimated from edges
    alone, if observable. `alarm_rate` is the false-alarm rate, `power` the detection rate of an error at the limit;
    `notice_deg` and `notice_m` are the errors that have to be detectable, or else the outcome is `cannot-tell`.
    `chi_square` (six degrees of freedom) is the step to `estimate` relative to its covariance, `p_value` its p-value.
    `far` is True where a search found the pose, outside the convergence range of the given one.
    """

    frames: tuple[str, ...]
    camera_from_lidar: Pose
    holding: CheckStatus
    reason: str
    axes: tuple[AxisCheck, ...]
    alarm_rate: Number
    power: Number
    notice_deg: Number
    notice_m: Number
    estimate: Pose | None = None
    far: Flag = False
    chi_square: Number | None = None
    p_value: Number | None = None
    agreement: Annotated[Agreement, Derived(("odds_ratio", "strength"))] | None = None
    warnings: tuple[str, ...] = ()
    recipe: Tree = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Slip:
    """A slip of the mounting, detected on one axis.

    `noticed` is the index of the frame of the detection, `began` that of the probable beginning. `size`, in `unit`, is
    the change of the signed error since then, `sigma` its standard deviation.
    """

    axis: str
    unit: str
    noticed: Count
    noticed_frame: str
    began: Count
    began_frame: str
    size: Number
    sigma: Number


@dataclass(frozen=True)
class WatchedFrame:
    """One frame of a drive: `level` is the highest of all charts, 1 where an alarm is raised, and `axis` whose it is.

    Both are None for a frame without evidence.
    """

    name: str
    level: Number | None = None
    axis: str | None = None


@dataclass(frozen=True)
class Detectable:
    """The smallest slip on one axis, in `unit`, that the charts of a drive detect; None if they detect none.

    The slip happens after the frames that define the normal level, and is detected by half of such drives.
    """

    axis: str
    unit: str
    size: Number | None


@dataclass(frozen=True, eq=False)
class Watch:
    """The check of an extrinsic (4, 4) over the frames of a drive; `slips` are those that were detected, in order.

    `detectable` are the smallest ones that these frames can show, by axis.

    Charts are sums (CUSUM) of normalised steps of single frames, `slack` less each, against `limit`; the
    `correlation` of consecutive steps is removed. The first `settled` frames define the normal level. A correct
    extrinsic gives `alarms_per_hour` false alarms at `rate_hz` frames per second.
    """

    camera_from_lidar: Pose
    holding: CheckStatus
    reason: str
    slips: tuple[Slip, ...]
    detectable: tuple[Detectable, ...]
    frames: tuple[WatchedFrame, ...]
    settled: Count
    slack: Number
    limit: Number
    correlation: Number
    alarms_per_hour: Number
    rate_hz: Number
    warnings: tuple[str, ...] = ()
    recipe: Tree = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
