"""Decode the ROS messages that p2o reads into plain dataclasses; names are those of ROS.

The package `rosbags` decodes the bytes by its own definitions of types: definitions in a bag are never used, because
the package would generate and execute code from them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any

import numpy as np
from p2o import Float, InputError, UInt8

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg", "livox_interfaces/msg/CustomMsg")
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"

FOXGLOVE = {"foxglove_msgs/msg/RawImage": IMAGE, "foxglove_msgs/msg/CompressedImage": COMPRESSED_IMAGE}
"""Messages of Foxglove with the content of a message of ROS, but with another order of fields."""

IMAGES = (IMAGE, COMPRESSED_IMAGE, *FOXGLOVE)
CLOUDS = (POINT_CLOUD, *LIVOX)
PATHS = (ODOMETRY, POSE)
"""Types of messages with an image, a sweep, and a position of the vehicle."""
_HEADER, _FOXGLOVE_HEADER = "std_msgs/msg/Header", "foxglove_msgs/msg/Header"
_FOXGLOVE_FIELDS = {
    _FOXGLOVE_HEADER: "",
    "foxglove_msgs/msg/CompressedImage": "uint8[] data\nstring format\n",
    "foxglove_msgs/msg/RawImage": "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
}
"""Fields after timestamp and frame_id; the name of the first type is p2o's own."""

# Fields of the message before its points; rosbags would create one object per point.
_LIVOX_START = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nuint32 point_count\n"
)

_LIVOX_POINT = np.dtype(
    [("offset_time", "<u4"), *((axis, "<f4") for axis in "xyz"), ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")]
)


@dataclass(frozen=True)
class Header:
    """Time of a measurement in nanoseconds, and the name of its frame."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """An image as rows of `step` bytes."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: UInt8


@dataclass(frozen=True, eq=False)
class CompressedImageMessage:
    """An image as the bytes of a JPEG or PNG file."""

    header: Header
    format: str
    data: UInt8


@dataclass(frozen=True, eq=False)
class CameraInfoMessage:
    """A camera: K (3, 3), R (3, 3) and P (3, 4) for the full image, D with the coefficients of the model.

    `binning` is (x, y); `roi` is (x, y, height, width) in pixels of the full image, zeros for the full image.
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
    """A field of a point cloud: its offset in each point in bytes, and its type as the number of ROS."""

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
    fields: Sequence[PointField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: UInt8


@dataclass(frozen=True, eq=False)
class LivoxMessage:
    """A cloud of the CustomMsg of Livox: records with offset_time (ns), x, y, z, reflectivity, tag, line."""

    header: Header
    points: Any


@dataclass(frozen=True, eq=False)
class Transform:
    """A pose `parent_from_child`: a quaternion x y z w and a translation in metres."""

    header: Header
    child_frame_id: str
    rotation_xyzw: tuple[float, float, float, float]
    translation_m: tuple[float, float, float]


def read_header(kind: str, data: bytes | memoryview, *, ros1: bool, where: object = None) -> Header:
    """Decode the header at the start of a message of a type; raises InputError if there is none."""
    return _header(_decoded(_FOXGLOVE_HEADER if kind in FOXGLOVE else _HEADER, data, ros1, where)[0])


def read_message(kind: str, data: bytes | memoryview, *, ros1: bool, where: object = None) -> Any:
    """Decode a message of one of the types of this module.

    Raises InputError for other types, and for bytes whose length does not match the type and its array lengths.
    """
    if kind not in _READERS and kind not in LIVOX:
        fault = f"p2o does not read messages of type {shown(kind)}"
        raise InputError(fault, where=where, expected=", ".join(shown(name) for name in (*_READERS, *LIVOX)))
    message, rest = _decoded(kind, data, ros1, where)
    # CDR aligns each point of Livox to 4 bytes, except the end of the last, and pads the whole message.
    count, step = (message.point_count, 19 if ros1 else 20) if kind in LIVOX else (0, 0)
    more = len(rest) - (max(count - 1, 0) * step + min(count, 1) * _LIVOX_POINT.itemsize)
    if not 0 <= more <= (0 if ros1 else 3):
        raise InputError("the message length does not match its type", where=where, got=f"{more:+d} bytes")
    if kind not in LIVOX:
        return _READERS[kind](message)
    dtype = _LIVOX_POINT.newbyteorder("<" if ros1 or data[1] else ">")
    return LivoxMessage(_header(message.header), np.ndarray((count,), dtype, rest, strides=(step,)))


def shown(kind: str) -> str:
    """Return the name of a type as people write it."""
    return kind.replace("/msg/", "/")


@cache
def _typestore(ros1: bool) -> Any:
    """Return the types of ROS 1 or 2 with those of TF, Livox and Foxglove."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for kind in TF:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", kind))
    for kind in LIVOX:
        store.register(get_types_from_msg(_LIVOX_START, kind))
    time = "time" if ros1 else "builtin_interfaces/Time"
    for kind, fields_after in _FOXGLOVE_FIELDS.items():
        store.register(get_types_from_msg(f"{time} timestamp\nstring frame_id\n{fields_after}", kind))
    return store


def _decoded(kind: str, data: bytes | memoryview, ros1: bool, where: object) -> tuple[Any, memoryview]:
    """Decode a message and return it with the bytes after it; raises InputError for damaged bytes."""
    data = memoryview(data)
    if not ros1 and (len(data) < 4 or bytes(data[:2]) not in (b"\0\0", b"\0\1")):
        fault = "the message is not in plain CDR"
        got = bytes(data[:4]).hex(" ") or "nothing"
        raise InputError(fault, where=where, expected="the bytes 00 00 or 00 01, and two more", got=got)
    store = _typestore(ros1)
    definition = store.get_msgdef(kind)
    decode = getattr(definition, "deserialize_ros1" if ros1 else f"deserialize_cdr_{'le' if data[1] else 'be'}")
    body = data if ros1 else data[4:]
    try:
        message, end = decode(body, 0, definition.cls, store)
    except Exception as problem:  # struct, NumPy and rosbags raise different types for damaged bytes
        fault, got = "the message is damaged or truncated", str(problem)[:200]
        raise InputError(fault, where=where, expected=shown(kind), got=got) from problem
    return message, body[end:]


def _header(message: Any) -> Header:
    """Return the header of a decoded header of ROS or start of a message of Foxglove."""
    stamp = getattr(message, "stamp", None) or message.timestamp
    return Header(stamp.sec * 1_000_000_000 + stamp.nanosec, message.frame_id)


def _copied(kind: type[Any], message: Any) -> Any:
    """Return a message of a dataclass whose fields are those of the decoded message.

    Messages of Foxglove have no header and are little-endian.
    """
    values = {field.name: getattr(message, field.name, False) for field in fields(kind)}
    return kind(**values | {"header": _header(getattr(message, "header", message))})


def _camera_info(message: Any) -> CameraInfoMessage:
    values = {name.lower(): value for name, value in vars(message).items()}  # ROS 1 writes D, K, R and P
    roi = message.roi
    return CameraInfoMessage(
        *(_header(message.header), message.height, message.width, message.distortion_model),
        *(values["d"], values["k"].reshape(3, 3), values["r"].reshape(3, 3), values["p"].reshape(3, 4)),
        binning=(message.binning_x, message.binning_y),
        roi=(roi.x_offset, roi.y_offset, roi.height, roi.width),
    )


def _transform(message: Any, rotation: Any, translation: Any) -> Transform:
    """Return the pose of a TransformStamped, Odometry or PoseStamped message; the latter has no child frame."""
    child, quaternion = getattr(message, "child_frame_id", ""), (rotation.x, rotation.y, rotation.z, rotation.w)
    return Transform(_header(message.header), child, quaternion, (translation.x, translation.y, translation.z))


def _transforms(message: Any) -> tuple[Transform, ...]:
    return tuple(_transform(one, one.transform.rotation, one.transform.translation) for one in message.transforms)


def _path_pose(message: Any) -> Transform:
    pose = getattr(message.pose, "pose", message.pose)
    return _transform(message, pose.orientation, pose.position)


_IMAGE_READERS = {IMAGE: partial(_copied, ImageMessage), COMPRESSED_IMAGE: partial(_copied, CompressedImageMessage)}
_READERS: Mapping[str, Callable[[Any], Any]] = {
    **_IMAGE_READERS,
    **{kind: _IMAGE_READERS[same] for kind, same in FOXGLOVE.items()},
    CAMERA_INFO: _camera_info,
    POINT_CLOUD: partial(_copied, PointCloudMessage),
    **dict.fromkeys(TF, _transforms),
    **dict.fromkeys(PATHS, _path_pose),
}
