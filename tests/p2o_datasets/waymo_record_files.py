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


def context(segment: Segment) -> bytes:
    cameras = [
        message(
            2,
            whole(1, row["key.camera_name"]),
            *(double(2, row[f"[CameraCalibrationComponent].intrinsic.{name}"]) for name in LENS),
            transform(3, row["[CameraCalibrationComponent].extrinsic.transform"]),
            whole(4, row["[CameraCalibrationComponent].width"]),
            whole(5, row["[CameraCalibrationComponent].height"]),
            whole(6, row["[CameraCalibrationComponent].rolling_shutter_direction"]),
        )
        for row in segment.components["camera_calibration"]
    ]
    lidars = [
        message(
            3,
            whole(1, row["key.laser_name"]),
            *(double(2, value) for value in row["[LiDARCalibrationComponent].beam_inclination.values"] or ()),
            double(3, row["[LiDARCalibrationComponent].beam_inclination.min"]),
            double(4, row["[LiDARCalibrationComponent].beam_inclination.max"]),
            transform(5, row["[LiDARCalibrationComponent].extrinsic.transform"]),
        )
        for row in segment.components["lidar_calibration"]
    ]
    return message(1, message(1, segment.name.encode()), *cameras, *lidars)


def image(row: dict[str, Any]) -> bytes:
    prefix = "[CameraImageComponent]"
    velocity = [
        *(single(i, row[f"{prefix}.velocity.linear_velocity.{axis}"]) for i, axis in enumerate("xyz", 1)),
        *(double(i, row[f"{prefix}.velocity.angular_velocity.{axis}"]) for i, axis in enumerate("xyz", 4)),
    ]
    return message(
        4,
        whole(1, row["key.camera_name"]),
        message(2, row[f"{prefix}.image"]),
        transform(3, row[f"{prefix}.pose.transform"]),
        message(4, *velocity),
        double(5, row[f"{prefix}.pose_timestamp"]),
        double(6, row[f"{prefix}.rolling_shutter_params.shutter"]),
        double(7, row[f"{prefix}.rolling_shutter_params.camera_trigger_time"]),
        double(8, row[f"{prefix}.rolling_shutter_params.camera_readout_done_time"]),
    )


def frames(segment: Segment) -> list[bytes]:
    """Return the Frame messages of a segment."""
    found = []
    for number, time in enumerate(segment.frames):
        images = [row for row in segment.components["camera_image"] if row["key.frame_timestamp_micros"] == time]
        sweeps = [row for row in segment.components["lidar"] if row["key.frame_timestamp_micros"] == time]
        [poses] = [row for row in segment.components["lidar_pose"] if row["key.frame_timestamp_micros"] == time]
        lasers = []
        for row in sweeps:
            prefix = "[LiDARComponent].range_image_return1"
            parts = matrix(2, row[f"{prefix}.values"], row[f"{prefix}.shape"])
            if row["key.laser_name"] == 1:
                prefix = "[LiDARPoseComponent].range_image_return1"
                parts += matrix(4, poses[f"{prefix}.values"], poses[f"{prefix}.shape"])
            lasers.append(message(5, whole(1, row["key.laser_name"]), message(2, parts)))
        pose = segment.components["vehicle_pose"][number]["[VehiclePoseComponent].world_from_vehicle.transform"]
        label = message(6, message(1, double(1, 3.0)), message(4, b"a label, which nobody asks for"))
        found.append(
            context(segment)
            + whole(2, time)
            + transform(3, pose)
            + b"".join(map(image, images))
            + b"".join(lasers)
            + label
        )
    return found


def write_records(segment: Segment, messages: Sequence[bytes] | None = None) -> Path:
    path = segment.root / f"segment-{segment.name}_with_camera_labels.tfrecord"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(record(data) for data in messages or frames(segment)))
    return path
