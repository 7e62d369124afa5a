"""Decode the columns of a point cloud message of any layout, and the times of its points in seconds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from p2o import Bool, Float, InputError

from p2o_datasets.bags.messages import LivoxMessage, PointCloudMessage
from p2o_datasets.number_text import MAX_POINTS

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_MAX_FIELDS = 256

INTENSITY = ("intensity", "intensities", "reflectivity", "reflectance", "i")
RING = ("ring", "channel", "laser_id", "line", "row")
TIME = ("time", "t", "timestamp", "time_stamp", "offset_time", "time_offset", "timeoffset", "point_time_offset")

Unit = Literal["auto", "none", "s", "ms", "us", "ns"]
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
# A revolution takes 50 to 200 ms, a frame of a solid-state LiDAR 5 ms or more. Only one unit can fit, as units differ
# by a factor of 1000.
_SHORTEST_S, _LONGEST_S = 0.004, 0.4
_SAME_CLOCK_NS = 2_000_000_000


def columns_of(message: PointCloudMessage | LivoxMessage) -> dict[str, Any]:
    """Return the columns (N,) of a cloud by name, in row-major order; fields with several values are left out.

    Raises InputError for fields outside their points, a length that contradicts the layout, unknown types, duplicate
    names, and more than 2^23 points.
    """
    if isinstance(message, LivoxMessage):
        _check_count(len(message.points))
        return {name: message.points[name] for name in message.points.dtype.names}
    count = message.width * message.height
    _check_count(count)
    dtype = _point_type(message)
    # Some drivers leave row_step at zero for a single row.
    row = message.row_step if message.height > 1 or message.row_step else message.width * message.point_step
    least = message.width * message.point_step
    size = len(message.data)
    if row < least or size != row * message.height:
        expected = f"{message.height} rows of {row} bytes, for {message.width} points of {message.point_step} bytes"
        raise InputError("the length of the point cloud contradicts its layout", expected=expected, got=f"{size} bytes")
    if not count:
        return {name: np.zeros(0, dtype[name]) for name in dtype.names or ()}
    shape, steps = (message.height, message.width), (row, message.point_step)
    points = np.ndarray(shape, dtype, message.data, strides=steps).reshape(-1)
    return {name: points[name] for name in dtype.names or ()}


def named_columns(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return x, y, z and the available ones of intensity, ring and time, by these names.

    Lines of a Livox sensor, which has a column `tag`, are not rings of a rotating LiDAR.
    """
    by_name = {name.lower(): column for name, column in reversed(list(columns.items()))}
    named = {axis: by_name[axis] for axis in "xyz" if axis in by_name}
    rosette = "line" in by_name and "tag" in by_name
    for target, names in (("intensity", INTENSITY), ("ring", RING), ("time", TIME)):
        name = next((n for n in names if n in by_name and not (rosette and n == "line")), None)
        if name is not None:
            named[target] = by_name[name]
    return named


def usable_points(columns: Mapping[str, Any]) -> Bool:
    """Return the mask (N,) of points that are finite and not all zero, which marks missing returns."""
    with np.errstate(invalid="ignore"):
        xyz = np.stack([np.asarray(columns[axis], np.float64) for axis in "xyz"])
    usable: Bool = np.asarray(np.isfinite(xyz).all(axis=0) & xyz.any(axis=0))
    return usable


def seconds_after(
    times: Any, usable: Bool, stamp_ns: int, image_ns: int, unit: Unit = "auto"
) -> tuple[Float | None, str | None]:
    """Return times (N,) in seconds after the image, or None with a remark; `usable` (N,) masks valid points.

    `times` are relative to the stamp of the sweep or on the clock of the stamp. Unless `unit` is given, it is the unit
    in which the sweep takes 4 to 400 ms.

    Raises InputError if no unit fits, and if the times are on another clock than the stamps.
    """
    values = np.asarray(times)
    known = values[usable]
    if unit == "none" or not known.size:
        return None, None
    if known.dtype.kind not in "iuf" or not np.isfinite(known).all():
        return None, "times of the points ignored: not finite numbers"
    least, most = known.min(), known.max()
    if least == most:
        return None, "times of the points ignored: all are the same"
    span = float(most) - float(least) if known.dtype.kind == "f" else float(int(most) - int(least))
    units = [name for name, per in _PER_SECOND.items() if _SHORTEST_S <= span / per <= _LONGEST_S]
    chosen = unit if unit != "auto" else units[0] if units else None
    if chosen is None:
        expected = f"a sweep of {_SHORTEST_S:g} to {_LONGEST_S:g} s, in s, ms, us or ns"
        got = f"{known.dtype} from {least} to {most}"
        hint = "set it: --set data.point_times=ns, or none to ignore the times"
        raise InputError("the unit of the points' times is ambiguous", expected=expected, got=got, hint=hint)
    per = _PER_SECOND[chosen]
    whole = known.dtype.kind != "f"
    # Clip first, because larger values overflow in nanoseconds.
    start_s = float(np.clip(float(least) / per, -1e12, 1e12))
    start_ns = int(least) * (1_000_000_000 // per) if whole else round(start_s * 1e9)
    if abs(start_ns) <= _SAME_CLOCK_NS:
        start_ns += stamp_ns
    elif abs(start_ns - stamp_ns) > _SAME_CLOCK_NS:
        fault = "the points' times and the stamps are on different clocks"
        expected = f"times within {_SAME_CLOCK_NS * 1e-9:g} s of the stamp {stamp_ns * 1e-9:.3f}, or of 0"
        got = f"{start_ns * 1e-9:.3f} s"
        raise InputError(fault, expected=expected, got=got, hint="ignore the times: --set data.point_times=none")
    with np.errstate(invalid="ignore", over="ignore"):
        # Subtract as integers first: nanoseconds since 1970 have more digits than a double.
        later = (values - least).astype(np.float64) / per if whole else values.astype(np.float64) / per - start_s
    return later + (start_ns - image_ns) * 1e-9, None


def _check_count(count: int) -> None:
    if count > MAX_POINTS:
        raise InputError("the point cloud has too many points", expected=f"at most {MAX_POINTS}", got=count)


def _point_type(message: PointCloudMessage) -> np.dtype[Any]:
    layout: dict[str, tuple[str, int]] = {}
    order = ">" if message.is_bigendian else "<"
    if len(message.fields) > _MAX_FIELDS:
        raise InputError("the points have too many fields", expected=f"at most {_MAX_FIELDS}", got=len(message.fields))
    for field in message.fields:
        if field.datatype not in _TYPES:
            expected = "datatype 1 to 8"
            raise InputError(f"field {field.name} is of an unknown type", expected=expected, got=field.datatype)
        size = int(_TYPES[field.datatype][1]) * max(field.count, 1)
        if field.offset + size > message.point_step:
            fault = f"field {field.name} is outside its point"
            got = f"bytes {field.offset} to {field.offset + size}"
            raise InputError(fault, expected=f"at most {message.point_step} bytes (point_step)", got=got)
        if field.count > 1:
            continue
        if field.name in layout or not field.name:
            raise InputError("the field names are empty or not unique", got=f"'{field.name}'")
        layout[field.name] = (order + _TYPES[field.datatype], field.offset)
    if not message.point_step:
        raise InputError("the points have no bytes", expected="a point_step above 0", got="0")
    formats, offsets = ([entry[i] for entry in layout.values()] for i in (0, 1))
    record = {"names": list(layout), "formats": formats, "offsets": offsets, "itemsize": message.point_step}
    return np.dtype(record)  # type: ignore[call-overload,no-any-return]
