"""Find intensity, ring and time among the named fields of points, and convert times of any unit to seconds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from p2o import Bool, Float, InputError

INTENSITY = ("intensity", "intensities", "intens", "i", "reflectivity", "reflectance", "remission", "signal")
RING = (
    *("ring", "rings", "ring_id", "ringid", "laser_id", "laserid", "laser", "laser_number", "beam", "beam_id"),
    *("channel", "channel_id", "line", "line_id", "row", "scan_line", "scanline"),
)
TIME = (
    *("time", "times", "t", "timestamp", "timestamps", "time_stamp", "offset_time", "time_offset", "timeoffset"),
    *("point_time_offset", "point_time", "relative_time", "offset", "gps_time", "gpstime"),
)
"""Names by falling precedence. Names of times may end in their unit: time_s, offset_time_ns."""

Unit = Literal["auto", "none", "s", "ms", "us", "ns"]
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
# A revolution takes 50 to 200 ms, a frame of a solid-state LiDAR 5 ms or more. Only one unit can fit, as units differ
# by a factor of 1000.
_SHORTEST_S, _LONGEST_S = 0.004, 0.4
_SAME_CLOCK_NS, _SAME_MOMENT_NS = 2_000_000_000, 1_000_000_000
_FARTHEST_NS = 1000 * 1_000_000_000
KNOWN_NAMES = (*INTENSITY, *RING, *TIME, *(f"{name}_{unit}" for name in TIME for unit in _PER_SECOND))
_ALWAYS_RINGS = RING.index("channel")
"""The first names of `RING` are those of rings only; the others also name channels and lines of other kinds."""
# Larger than the number of rings of any automotive LiDAR: larger numbers are not rings.
_MAX_RING, _FEWEST_LINES = 1023, 8


def plain_names(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields by lower-case names without CloudCompare's prefix `scalar_`; the first of a name counts."""
    plain: dict[str, Any] = {}
    for name, value in fields.items():
        plain.setdefault(re.sub(r"[\s-]+", "_", name.strip().lower()).removeprefix("scalar_"), value)
    return plain


def time_unit(name: str) -> Unit | None:
    """Return the unit that the name of a time states, "auto" without one; None for names that are no times."""
    base, _, unit = name.rpartition("_")
    if base in TIME and unit in _PER_SECOND:
        return unit  # type: ignore[return-value]
    return "auto" if name in TIME and name != "offset" else None


def candidates(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of fields that may be the intensity, ring and time of points, by falling precedence.

    Lines of a Livox sensor, which has a field `tag`, are not rings of a rotating LiDAR.
    """
    livox = {"line", "tag"} <= set(names)
    times = [name for name in names if time_unit(name) is not None]
    return {
        "intensity": [name for name in INTENSITY if name in names],
        "ring": [name for name in RING if name in names and not (livox and name == "line")],
        # A stated unit counts most.
        "time": sorted(times, key=lambda name: (name in TIME, TIME.index(name) if name in TIME else 0)),
    }


def unused_fields(fields: Mapping[str, Any], used: Sequence[str]) -> tuple[str, ...]:
    """Return the names of fields except x, y, z and those `used`."""
    return tuple(name for name in fields if name not in "xyz" and name not in used and name != "xyz")


def usable_points(xyz: Float) -> Bool:
    """Return the mask (N,) of points (N, 3) that are finite and not all zero, which marks missing returns."""
    return np.asarray(np.isfinite(xyz).all(axis=1) & xyz.any(axis=1))


def not_finite(value: Any) -> str | None:
    """Return why the values of a field cannot be used, or None."""
    with np.errstate(invalid="ignore", over="ignore"):
        finite = value.dtype.kind in "iu" or (value.dtype.kind == "f" and np.isfinite(value.astype(np.float64)).all())
    return None if finite else "not finite numbers"


def only_rings(name: str) -> bool:
    """Return whether fields of this name hold rings and nothing else."""
    return RING.index(name) < _ALWAYS_RINGS


def no_rings(name: str, ring: Any) -> str | None:
    """Return why the finite numbers of a field cannot be ring numbers, or None."""
    if not ring.size:
        return None
    least, most = ring.min(), ring.max()
    if least < 0 or most > _MAX_RING:
        return f"numbers from {least:.6g} to {most:.6g} are not rings"
    if ring.dtype.kind == "f" and (ring != np.floor(ring)).any():
        return "rings are not integers"
    if ring.size > 1 and least == most:
        return f"all {ring.size} points have ring {most:.6g}"
    if not only_rings(name) and ring.size > _FEWEST_LINES:
        count = len(np.unique(ring))
        return f"{count} values are not the rings of a rotating LiDAR" if count < _FEWEST_LINES else None
    return None


@dataclass(frozen=True)
class PointClock:
    """How times of points are converted to seconds after the image.

    `unit` is that of the times; auto: the only one in which a sweep takes 4 to 400 ms. `image_ns` is the time of the
    image; None: unknown, times are relative to it. Times near zero are relative to the stamp `sweep_ns`, if given, and
    otherwise on the clock of the image. If times are not `required`, they are left out where no unit fits. `setting` is
    the text with which a user states the unit.
    """

    unit: Unit = "auto"
    image_ns: int | None = None
    sweep_ns: int | None = None
    required: bool = True
    setting: str = "point_times: "

    @classmethod
    def of_image(cls, image_time_s: float | None, unit: Unit = "auto") -> PointClock:
        """Return the clock of points that share their clock with an image."""
        image_ns = None if image_time_s is None else round(image_time_s * 1e9)
        return cls(unit, image_ns, required=image_ns is not None)

    def after_image(self, times: Any, usable: Bool, unit: Unit = "auto") -> tuple[Float | None, str | None]:
        """Return times (N,) in seconds after the image with an optional remark, or None with the reason.

        `usable` (N,) masks valid points. `unit` is stated by the name of the field. Raises InputError if no unit fits,
        and if the times are on another clock than the stamp of the sweep.
        """
        values = np.asarray(times)
        known = values[usable]
        stated = self.unit if self.unit != "auto" else unit
        if stated == "none" or not known.size:
            return None, None
        wrong = not_finite(known)
        if wrong:
            return None, wrong
        least, most = known.min(), known.max()
        if stated == "auto" and least == most:
            return None, "all are the same"
        try:
            chosen = stated if stated != "auto" else self._unit_of(least, most, known.dtype)
        except InputError as problem:
            if self.required:
                raise
            return None, str(problem)
        per, whole = _PER_SECOND[chosen], known.dtype.kind != "f"
        # Clip first, because larger values overflow in nanoseconds.
        start_s = float(np.clip(float(least) / per, -1e12, 1e12))
        start_ns = int(least) * (1_000_000_000 // per) if whole else round(start_s * 1e9)
        shift_ns, remark = self._shift(start_ns, float(most) / per - start_s, per)
        if shift_ns is None:
            return None, remark
        with np.errstate(invalid="ignore", over="ignore"):
            if shift_ns == 0 and not whole:
                return values.astype(np.float64) / per, remark
            # Subtract as integers first: nanoseconds since 1970 have more digits than a double.
            later = (values - least).astype(np.float64) / per if whole else values.astype(np.float64) / per - start_s
        return later + (start_ns - shift_ns) * 1e-9, remark

    def _unit_of(self, least: Any, most: Any, dtype: Any) -> Unit:
        """Return the only unit in which times from `least` to `most` are those of a sweep."""
        span = float(most) - float(least) if dtype.kind == "f" else float(int(most) - int(least))
        units = [name for name, per in _PER_SECOND.items() if _SHORTEST_S <= span / per <= _LONGEST_S]
        if len(units) != 1:
            expected = f"a sweep of {_SHORTEST_S:g} to {_LONGEST_S:g} s, in s, ms, us or ns"
            got = f"{dtype} from {least} to {most}"
            hint = f"set it: {self.setting}ns, or none to ignore the times"
            raise InputError("the unit of the points' times is ambiguous", expected=expected, got=got, hint=hint)
        return units[0]  # type: ignore[return-value]

    def _shift(self, start_ns: int, span_s: float, per: int) -> tuple[int | None, str | None]:
        """Return the time in ns on the clock of the points that becomes zero, and a remark; None with the reason."""
        if self.sweep_ns is not None:
            image_ns = self.sweep_ns if self.image_ns is None else self.image_ns
            if abs(start_ns) <= _SAME_CLOCK_NS:
                return image_ns - self.sweep_ns, None
            if abs(start_ns - self.sweep_ns) > _SAME_CLOCK_NS:
                fault = "the points' times and the stamps are on different clocks"
                expected = f"times within {_SAME_CLOCK_NS * 1e-9:g} s of the stamp {self.sweep_ns * 1e-9:.3f}, or of 0"
                hint = f"ignore the times: {self.setting}none"
                raise InputError(fault, expected=expected, got=f"{start_ns * 1e-9:.3f} s", hint=hint)
            return image_ns, None
        if self.image_ns is None:
            far = abs(start_ns) > _FARTHEST_NS
            return (None, "not relative to the image; give image_time_s") if far else (0, None)
        middle_ns, half_ns = start_ns + round(span_s * 5e8), round(span_s * 5e8)
        if per > 1 and abs(self.image_ns - middle_ns) > half_ns + _SAME_MOMENT_NS:
            # Seconds are impossible; the number is that of the points, in their unit.
            other_ns = self.image_ns // per
            if abs(other_ns - middle_ns) <= half_ns + _SAME_MOMENT_NS // 10:
                unit = next(name for name, count in _PER_SECOND.items() if count == per)
                text = f"image_time_s {self.image_ns * 1e-9:g} is taken as {unit}, as the times of the points"
                return other_ns, f"{text}: write {other_ns * 1e-9:.9g}"
        return self.image_ns, None
