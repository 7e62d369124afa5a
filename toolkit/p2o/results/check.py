"""What edges say of an extrinsic that is in use: whether it still holds, axis by axis, and since when it does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from p2o.arrays import Float
from p2o.results.evidence import Agreement


class Holding(StrEnum):
    """Whether an extrinsic holds: on one axis, or on all that were asked."""

    HOLDS = "holds"
    OFF = "off"
    CANNOT_TELL = "cannot-tell"


@dataclass(frozen=True)
class AxisCheck:
    """One camera axis: `axis` is roll, pitch, yaw, x, y or z, and numbers are in `unit`, deg or m.

    The extrinsic is `off` by so much from where the edges put it (signed, as `p2o.geometry.pose_error` has errors),
    and that is known to `sigma`, one deviation. `limit` is the smallest error of this axis alone that would have been
    noticed at the stated rates. Without evidence all three are None.
    """

    axis: str
    unit: str
    holding: Holding
    off: float | None = None
    sigma: float | None = None
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class Check:
    """Whether an extrinsic camera_from_lidar (4, 4) holds on these frames; nothing was moved.

    `holding` is the word for all axes, `reason` why. `found` (4, 4) is where the edges alone put the LiDAR, None where
    they do not tell. `alarm_rate` is how often a right extrinsic is called off, `power` how often an error at a limit
    is; `notice_deg` and `notice_m` are the errors that have to be noticed, or else the word is `cannot-tell`.
    `chi_square` is the step by its likely errors, of six degrees of freedom, and `p_value` how often a right extrinsic
    is as far off. `far` says that a search found the pose, out of reach from the given one.
    """

    frames: tuple[str, ...]
    camera_from_lidar: Float
    holding: Holding
    reason: str
    axes: tuple[AxisCheck, ...]
    alarm_rate: float
    power: float
    notice_deg: float
    notice_m: float
    found: Float | None = None
    far: bool = False
    chi_square: float | None = None
    p_value: float | None = None
    agreement: Agreement | None = None
    warnings: tuple[str, ...] = ()
    recipe: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Slip:
    """A slip of the mounting that was noticed on one axis.

    It was `noticed` at a frame by its number in the drive and probably `began` at another one. `size`, in `unit`, is by
    how much the extrinsic has been off since, more than before (signed, as errors), known to `sigma`.
    """

    axis: str
    unit: str
    noticed: int
    noticed_frame: str
    began: int
    began_frame: str
    size: float
    sigma: float


@dataclass(frozen=True)
class WatchedFrame:
    """One frame of a drive: `level` is the highest of all charts, 1 where an alarm is raised, and `axis` whose it is.

    Both are None where the frame told nothing.
    """

    name: str
    level: float | None = None
    axis: str | None = None


@dataclass(frozen=True, eq=False)
class Watch:
    """What a drive says of an extrinsic (4, 4), frame after frame; `slips` are those that were noticed, in order.

    Charts are sums (CUSUM) of normalised steps of single frames, `slack` less each, against `limit`; steps follow each
    other with the `correlation` that is taken out. `settled` frames at the start say what is usual. A right extrinsic
    gives `alarms_per_hour` at `rate_hz` frames a second.
    """

    camera_from_lidar: Float
    holding: Holding
    reason: str
    slips: tuple[Slip, ...]
    frames: tuple[WatchedFrame, ...]
    settled: int
    slack: float
    limit: float
    correlation: float
    alarms_per_hour: float
    rate_hz: float
    warnings: tuple[str, ...] = ()
    recipe: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
