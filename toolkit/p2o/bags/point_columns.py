"""The columns of a point cloud message, whatever the layout of its points, and their times in seconds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from p2o.arrays import Bool, Float
from p2o.bags.messages import LivoxMessage, PointCloudMessage
from p2o.errors import InputError

MAX_POINTS = 1 << 23
"""No sweep has more points."""
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_MAX_FIELDS = 256

INTENSITY = ("intensity", "intensities", "reflectivity", "reflectance", "i")
RING = ("ring", "channel", "laser_id", "line", "row")
TIME = ("time", "t", "timestamp", "time_stamp", "offset_time", "time_offset", "timeoffset", "point_time_offset")

Unit = Literal["auto", "none", "s", "ms", "us", "ns"]
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
# A turn takes 50 to 200 ms, a frame of a solid-state sensor 5 ms and more. Units differ by 1000: one fits at most.
_SHORTEST_S, _LONGEST_S = 0.004, 0.4
_NEAR_NS = 2_000_000_000


def columns_of(message: PointCloudMessage | LivoxMessage) -> dict[str, Any]:
    """Return the columns (N,) of a cloud by their names, row by row where it has rows; fields of several numbers have
    none.

    Raises InputError where fields lie outside of their points, the bytes are not as many as the message says, a type
    is unknown or a name comes twice, and for more than 2^23 points.
    """
    if isinstance(message, LivoxMessage):
        _check_count(len(message.points))
        return {name: message.points[name] for name in message.points.dtype.names}
    count = message.width * message.height
    _check_count(count)
    dtype = _point_type(message)
    # Some drivers leave the length of the only row out.
    row = message.row_step if message.height > 1 or message.row_step else message.width * message.point_step
    least = message.width * message.point_step
    size = len(message.data)
    if row < least or size != row * message.height:
        raise InputError(
            "the point cloud has another length than it says",
            expected=f"{message.height} rows of {row} bytes, for {message.width} points of {message.point_step} bytes",
            got=f"{size} bytes",
        )
    if not count:
        return {name: np.zeros(0, dtype[name]) for name in dtype.names or ()}
    shape, steps = (message.height, message.width), (row, message.point_step)
    points = np.ndarray(shape, dtype, message.data, strides=steps).reshape(-1)
    return {name: points[name] for name in dtype.names or ()}


def named_columns(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return x, y, z and, where they are there, intensity, ring and time by these names.

    Lines of a Livox (which has `tag` beside them) are none of a sensor that spins: they are no rings.
    """
    by_name = {name.lower(): column for name, column in reversed(list(columns.items()))}
    found = {axis: by_name[axis] for axis in "xyz" if axis in by_name}
    rosette = "line" in by_name and "tag" in by_name
    for target, names in (("intensity", INTENSITY), ("ring", RING), ("time", TIME)):
        name = next((n for n in names if n in by_name and not (rosette and n == "line")), None)
        if name is not None:
            found[target] = by_name[name]
    return found


def usable_points(columns: Mapping[str, Any]) -> Bool:
    """Return which points (N,) are finite and not all zero, as missing returns are."""
    with np.errstate(invalid="ignore"):
        xyz = np.stack([np.asarray(columns[axis], np.float64) for axis in "xyz"])
    usable: Bool = np.asarray(np.isfinite(xyz).all(axis=0) & xyz.any(axis=0))
    return usable


def seconds_after(
    times: Any, usable: Bool, stamp_ns: int, image_ns: int, unit: Unit = "auto"
) -> tuple[Float | None, str | None]:
    """Return times (N,) in seconds after the image, and a remark where there are none; only `usable` ones count.

    `times` count from the stamp of the sweep, or from where that stamp does. Their unit is told by how long the sweep
    takes, 4 to 400 ms, unless it is given.

    Raises InputError where the unit cannot be told, and where times are on another clock than the stamps.
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
        raise InputError(
            "the unit of the points' times cannot be told",
            expected=f"a sweep of {_SHORTEST_S:g} to {_LONGEST_S:g} s, in s, ms, us or ns",
            got=f"{known.dtype} from {least} to {most}",
            hint="say it: --set data.point_times=ns, or none to leave them out",
        )
    per = _PER_SECOND[chosen]
    whole = known.dtype.kind != "f"
    # No clock counts further, and numbers beyond are none in nanoseconds.
    start_s = float(np.clip(float(least) / per, -1e12, 1e12))
    start_ns = int(least) * (1_000_000_000 // per) if whole else round(start_s * 1e9)
    if abs(start_ns) <= _NEAR_NS:
        start_ns += stamp_ns
    elif abs(start_ns - stamp_ns) > _NEAR_NS:
        raise InputError(
            "the points' times are on another clock than the stamps",
            expected=f"times within {_NEAR_NS * 1e-9:g} s of the stamp {stamp_ns * 1e-9:.3f}, or of 0",
            got=f"{start_ns * 1e-9:.3f} s",
            hint="leave them out: --set data.point_times=none",
        )
    with np.errstate(invalid="ignore", over="ignore"):
        # Whole numbers first: those of nanoseconds since 1970 have more digits than a double.
        later = (values - least).astype(np.float64) / per if whole else values.astype(np.float64) / per - start_s
    return later + (start_ns - image_ns) * 1e-9, None


def _check_count(count: int) -> None:
    if count > MAX_POINTS:
        raise InputError("the point cloud has too many points", expected=f"at most {MAX_POINTS}", got=count)


def _point_type(message: PointCloudMessage) -> np.dtype[Any]:
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    order = ">" if message.is_bigendian else "<"
    if len(message.fields) > _MAX_FIELDS:
        raise InputError("the points have too many fields", expected=f"at most {_MAX_FIELDS}", got=len(message.fields))
    for field in message.fields:
        if field.datatype not in _TYPES:
            raise InputError(
                f"field {field.name} is of an unknown type", expected="datatype 1 to 8", got=field.datatype
            )
        size = int(_TYPES[field.datatype][1]) * max(field.count, 1)
        if field.offset + size > message.point_step:
            raise InputError(
                f"field {field.name} lies outside of its point",
                expected=f"at most {message.point_step} bytes (point_step)",
                got=f"bytes {field.offset} to {field.offset + size}",
            )
        if field.count > 1:
            continue
        if field.name in names or not field.name:
            raise InputError("the fields of the points are not named apart", got=f"'{field.name}'")
        names.append(field.name)
        formats.append(order + _TYPES[field.datatype])
        offsets.append(field.offset)
    if not message.point_step:
        raise InputError("the points have no bytes", expected="a point_step above 0", got="0")
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step})
