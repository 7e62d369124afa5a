"""The segment of `waymo_files` in Waymo's format v1: records of TensorFlow, messages of Protocol Buffers by hand."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .waymo_files import LENS, Segment


def varint(number: int) -> bytes:
    out = b""
    while number > 127:
        out, number = out + bytes([number % 128 + 128]), number // 128
    return out + bytes([number])


def whole(number: int, value: int) -> bytes:
    return varint(number * 8) + varint(value)


def double(number: int, value: float) -> bytes:
    return varint(number * 8 + 1) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    return varint(number * 8 + 5) + struct.pack("<f", value)


def message(number: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return varint(number * 8 + 2) + varint(len(body)) + body


def transform(number: int, values: Sequence[float]) -> bytes:
    return message(number, *(double(1, value) for value in values))


def matrix(number: int, values: Sequence[float], shape: Sequence[int]) -> bytes:
    """Return a compressed MatrixFloat: packed floats, and a shape of which each length is a field."""
    floats = np.array(values, "<f4").tobytes()
    plain = message(1, floats) + message(2, *(whole(1, size) for size in shape))
    return message(number, zlib.compress(plain))


def record(data: bytes) -> bytes:
    """Return a record of TensorFlow, with zeros for its two checksums."""
    return struct.pack("<QI", len(data), 0) + data + bytes(4)


def rows(segment: Segment, component: str, frame_us: int | None = None) -> list[dict[str, Any]]:
    """Return the rows of a component, or those of one frame, with columns without the prefix of the component."""
    found = [{name.rpartition("].")[2]: value for name, value in row.items()} for row in segment.components[component]]
    return [row for row in found if frame_us is None or row["key.frame_timestamp_micros"] == frame_us]


def context(segment: Segment) -> bytes:
    cameras = [
        message(
            *(2, whole(1, row["key.camera_name"]), *(double(2, row[f"intrinsic.{name}"]) for name in LENS)),
            transform(3, row["extrinsic.transform"]),
            *(whole(4, row["width"]), whole(5, row["height"]), whole(6, row["rolling_shutter_direction"])),
        )
        for row in rows(segment, "camera_calibration")
    ]
    lidars = [
        message(
            *(3, whole(1, row["key.laser_name"]), *(double(2, v) for v in row["beam_inclination.values"] or ())),
            *(double(number, row[f"beam_inclination.{end}"]) for number, end in ((3, "min"), (4, "max"))),
            transform(5, row["extrinsic.transform"]),
        )
        for row in rows(segment, "lidar_calibration")
    ]
    return message(1, message(1, segment.name.encode()), *cameras, *lidars)


def image(row: dict[str, Any]) -> bytes:
    velocity = [
        *(single(i, row[f"velocity.linear_velocity.{axis}"]) for i, axis in enumerate("xyz", 1)),
        *(double(i, row[f"velocity.angular_velocity.{axis}"]) for i, axis in enumerate("xyz", 4)),
    ]
    shutter = [
        f"rolling_shutter_params.{name}" for name in ("shutter", "camera_trigger_time", "camera_readout_done_time")
    ]
    return message(
        *(4, whole(1, row["key.camera_name"]), message(2, row["image"]), transform(3, row["pose.transform"])),
        message(4, *velocity),
        *(double(number, row[name]) for number, name in enumerate(("pose_timestamp", *shutter), 5)),
    )


def frames(segment: Segment) -> list[bytes]:
    """Return the Frame messages of a segment."""
    found = []
    for number, time in enumerate(segment.frames):
        images = b"".join(map(image, rows(segment, "camera_image", time)))
        [poses] = rows(segment, "lidar_pose", time)
        lasers = b""
        for row in rows(segment, "lidar", time):
            parts = matrix(2, row["range_image_return1.values"], row["range_image_return1.shape"])
            if row["key.laser_name"] == 1:
                parts += matrix(4, poses["range_image_return1.values"], poses["range_image_return1.shape"])
            lasers += message(5, whole(1, row["key.laser_name"]), message(2, parts))
        pose = transform(3, rows(segment, "vehicle_pose")[number]["world_from_vehicle.transform"])
        label = message(6, message(1, double(1, 3.0)), message(4, b"a label, which nobody asks for"))
        found.append(context(segment) + whole(2, time) + pose + images + lasers + label)
    return found


def write_records(segment: Segment, messages: Sequence[bytes] | None = None) -> Path:
    path = segment.root / f"segment-{segment.name}_with_camera_labels.tfrecord"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(record(data) for data in messages or frames(segment)))
    return path
