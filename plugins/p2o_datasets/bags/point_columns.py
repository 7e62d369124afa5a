"""Decode the columns of a point cloud message of any layout."""

from __future__ import annotations

from typing import Any

import numpy as np
from p2o import InputError

from p2o_datasets.bags.messages import LivoxMessage, PointCloudMessage
from p2o_datasets.number_text import MAX_POINTS

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_MAX_FIELDS = 256


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
