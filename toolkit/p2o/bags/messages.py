"""The messages that p2o reads from bags, as plain dataclasses; names are those of ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.bags.message_bytes import MessageBytes
from p2o.errors import InputError

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg", "livox_interfaces/msg/CustomMsg")
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"

IMAGES = (IMAGE, COMPRESSED_IMAGE)
CLOUDS = (POINT_CLOUD, *LIVOX)
PATHS = (ODOMETRY, POSE)
"""Types of messages that are an image, a sweep, and a place on the way of the vehicle."""

_LIVOX_POINT = np.dtype(
    [
        ("offset_time", "<u4"),
        *((axis, "<f4") for axis in "xyz"),
        ("reflectivity", "u1"),
        ("tag", "u1"),
        ("line", "u1"),
    ]
)


@dataclass(frozen=True)
class Header:
    """When something was measured, in nanoseconds, and the frame that it is in."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """A picture as rows of `step` bytes."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: memoryview


@dataclass(frozen=True, eq=False)
class CompressedImageMessage:
    """A picture as a file."""

    header: Header
    format: str
    data: memoryview


@dataclass(frozen=True, eq=False)
class CameraInfoMessage:
    """A camera: K (3, 3), R (3, 3) and P (3, 4) of the picture of full size, D as many as the model has.

    `binning` is (x, y), `roi` (x, y, height, width) in pixels of the full picture, zeros for all of it.
    """

    header: Header
    height: int
    width: int
    distortion_model: str
    D: Float
    K: Float
    R: Float
    P: Float
    binning: tuple[int, int]
    roi: tuple[int, int, int, int]


@dataclass(frozen=True)
class PointField:
    """A column of a point cloud: its bytes begin at `offset` in each point; `datatype` is ROS' number."""

    name: str
    offset: int
    datatype: int
    count: int


@dataclass(frozen=True, eq=False)
class PointCloudMessage:
    """A cloud of `height` rows of `width` points, as bytes."""

    header: Header
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview


@dataclass(frozen=True, eq=False)
class LivoxMessage:
    """A cloud of Livox' own message: records with offset_time (ns), x, y, z, reflectivity, tag, line."""

    header: Header
    points: Any


@dataclass(frozen=True, eq=False)
class Transform:
    """A pose: `parent_from_child` by a quaternion x y z w and a translation in metres."""

    header: Header
    child_frame_id: str
    rotation_xyzw: tuple[float, float, float, float]
    translation_m: tuple[float, float, float]


def read_header(data: bytes | memoryview, *, ros1: bool, where: object = None) -> Header:
    """Return the header that a message begins with; raises InputError where it has none."""
    return _header(MessageBytes(data, ros1=ros1, where=where))


def read_message(kind: str, data: bytes | memoryview, *, ros1: bool, where: object = None) -> Any:
    """Return a message of one of the types of this module.

    Raises InputError for other types, and for bytes that are not as long as the type and its own counts say.
    """
    reader = _READERS.get(kind)
    if reader is None:
        raise InputError(
            f"p2o does not read messages of type {shown(kind)}",
            where=where,
            expected=", ".join(shown(name) for name in _READERS),
        )
    values = MessageBytes(data, ros1=ros1, where=where)
    message = reader(values)
    values.end()
    return message


def shown(kind: str) -> str:
    """Return the name of a type as people write it."""
    return kind.replace("/msg/", "/")


def _header(values: MessageBytes) -> Header:
    if values.ros1:
        _, seconds, nanoseconds = values.numbers("III")
    else:
        seconds = values.number("i")
        nanoseconds = values.number("I")
    return Header(seconds * 1_000_000_000 + nanoseconds, values.text())


def _image(values: MessageBytes) -> ImageMessage:
    header = _header(values)
    height, width = values.numbers("II")
    encoding = values.text()
    bigendian = bool(values.number("B"))
    return ImageMessage(header, height, width, encoding, bigendian, values.number("I"), values.raw())


def _compressed(values: MessageBytes) -> CompressedImageMessage:
    return CompressedImageMessage(_header(values), values.text(), values.raw())


def _camera_info(values: MessageBytes) -> CameraInfoMessage:
    header = _header(values)
    height, width = values.numbers("II")
    model = values.text()
    d, k, r, p = values.array("f8"), *(values.array("f8", count) for count in (9, 9, 12))
    binning = values.numbers("II")
    x, y, roi_height, roi_width = values.numbers("IIII")
    values.number("B")
    square = (3, 3)
    return CameraInfoMessage(
        *(header, height, width, model, d, k.reshape(square), r.reshape(square), p.reshape(3, 4)),
        binning=(binning[0], binning[1]),
        roi=(x, y, roi_height, roi_width),
    )


def _cloud(values: MessageBytes) -> PointCloudMessage:
    header = _header(values)
    height, width = values.numbers("II")
    fields = []
    for _ in range(values.count(13)):
        name, offset, datatype = values.text(), values.number("I"), values.number("B")
        fields.append(PointField(name, offset, datatype, values.number("I")))
    bigendian = bool(values.number("B"))
    point_step, row_step = values.numbers("II")
    data = values.raw()
    values.number("B")
    return PointCloudMessage(header, height, width, tuple(fields), bigendian, point_step, row_step, data)


def _livox(values: MessageBytes) -> LivoxMessage:
    header = _header(values)
    values.number("Q")
    values.number("I")
    values.numbers("BBBB")
    return LivoxMessage(header, values.records(_LIVOX_POINT, 4))


def _pose(values: MessageBytes) -> tuple[tuple[float, ...], tuple[float, ...]]:
    numbers = values.numbers("ddddddd")
    return numbers[3:], numbers[:3]


def _transform(values: MessageBytes) -> Transform:
    header, child = _header(values), values.text()
    rotation, translation = _pose(values)
    return Transform(header, child, rotation, translation)  # type: ignore[arg-type]


def _transforms(values: MessageBytes) -> tuple[Transform, ...]:
    return tuple(_transform(values) for _ in range(values.count(72)))


def _odometry(values: MessageBytes) -> Transform:
    transform = _transform(values)
    values.array("f8", 36)  # covariance
    values.array("f8", 6)  # velocity
    values.array("f8", 36)
    return transform


def _pose_stamped(values: MessageBytes) -> Transform:
    header = _header(values)
    rotation, translation = _pose(values)
    return Transform(header, "", rotation, translation)  # type: ignore[arg-type]


_READERS: Mapping[str, Callable[[MessageBytes], Any]] = {
    IMAGE: _image,
    COMPRESSED_IMAGE: _compressed,
    CAMERA_INFO: _camera_info,
    POINT_CLOUD: _cloud,
    **dict.fromkeys(LIVOX, _livox),
    **dict.fromkeys(TF, _transforms),
    ODOMETRY: _odometry,
    POSE: _pose_stamped,
}
