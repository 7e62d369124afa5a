"""Bags for tests, written by the writers of rosbags: ROS 1, ROS 2 in SQLite and in MCAP."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Frame
from p2o.geometry.se3 import inverse
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

FORMS = ("ros1", "sqlite3", "mcap")
LIVOX = "livox_ros_driver2/msg/CustomMsg"
_LIVOX_TEXT = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
================================================================================
MSG: livox_ros_driver2/CustomPoint
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
_FOXGLOVE_TEXTS = {
    "CompressedImage": "uint8[] data\nstring format\n",
    "CompressedVideo": "uint8[] data\nstring format\n",
    "RawImage": "uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
}
_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@dataclass(frozen=True)
class Said:
    """A message to be written: fields of messages in it are dicts; keys that ROS 1 and 2 spell apart are lower case."""

    topic: str
    kind: str
    time_ns: int
    fields: dict[str, Any]


def store_of(form: str) -> Any:
    """Return the types of ROS 1 or 2, with those of Livox."""
    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_LIVOX_TEXT, LIVOX))
    time = "time" if form == "ros1" else "builtin_interfaces/Time"
    for kind, text in _FOXGLOVE_TEXTS.items():
        store.register(get_types_from_msg(f"{time} timestamp\nstring frame_id\n{text}", f"foxglove_msgs/msg/{kind}"))
    if form == "ros1":
        text = "geometry_msgs/TransformStamped[] transforms\n"
        store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return store


def write_bag(root: Path, messages: Iterable[Said], form: str = "mcap", **options: Any) -> Path:
    """Write a bag below `root` and return what a user names: a .bag file, or a folder."""
    store = store_of(form)
    root.mkdir(parents=True, exist_ok=True)
    if form == "ros1":
        path = root / "drive.bag"
        writer: Any = Writer1(path)
        if "compression" in options:
            writer.set_compression(getattr(Writer1.CompressionFormat, options["compression"]))
    else:
        path = root / "drive"
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin[form.upper()])
        if "compression" in options:
            writer.set_compression(CompressionMode[options["compression"]], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for said in messages:
            if said.topic not in connections:
                connections[said.topic] = writer.add_connection(said.topic, said.kind, typestore=store)
            writer.write(connections[said.topic], said.time_ns, serialized(store, said, form))
    return path


def serialized(store: Any, said: Said, form: str) -> bytes:
    """Return the bytes of a message."""
    message = made(store, said.kind, said.fields)
    serialize = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
    return bytes(serialize(message, said.kind))


def file_of(bag: Path) -> Path:
    """Return the one file of a ROS 2 bag."""
    return next(path for path in bag.iterdir() if path.suffix in (".db3", ".mcap"))


def made(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    """Return a message as rosbags writes it; fields that are not given are empty."""
    values = {}
    for name, (node, detail) in store.fielddefs[kind][1]:
        given = fields.get(name.lower(), 0 if name == "seq" else None)
        of_messages = node.name in ("ARRAY", "SEQUENCE") and detail[0][0].name == "NAME"
        inner = detail if node.name == "NAME" else detail[0][1] if of_messages else None
        if node.name == "NAME":
            given = made(store, inner, given or {})
        elif inner is not None:
            given = [made(store, inner, entry) for entry in given or []]
        elif given is None:
            given = _nothing(node.name, detail)
        values[name] = given
    return store.types[kind](**values)


def _nothing(node: str, detail: Any) -> Any:
    if node == "BASE":
        return "" if detail[0] == "string" else 0
    kind = detail[0][1][0]
    dtype = {"byte": "u1", "octet": "u1", "bool": "?"}.get(kind, kind)
    return [] if kind == "string" else np.zeros(detail[1] if node == "ARRAY" else 0, dtype)


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    """Return the fields of a header."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame_id}


def image(topic: str, stamp_ns: int, pixels: Any, encoding: str = "rgb8", frame: str = "camera", **more: Any) -> Said:
    """Return an Image of pixels (H, W) or (H, W, C) of whole numbers."""
    pixels = np.ascontiguousarray(pixels)
    height, width = pixels.shape[:2]
    fields = {
        "header": header(stamp_ns, frame),
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": pixels.nbytes // height,
        "data": pixels.view(np.uint8).reshape(-1),
    }
    return Said(topic, "sensor_msgs/msg/Image", stamp_ns, fields | more)


def compressed(topic: str, stamp_ns: int, data: bytes, form: str = "png", frame: str = "camera") -> Said:
    """Return a CompressedImage of the bytes of a file."""
    fields = {"header": header(stamp_ns, frame), "format": form, "data": np.frombuffer(data, np.uint8)}
    return Said(topic, "sensor_msgs/msg/CompressedImage", stamp_ns, fields)


def foxglove(image: Said, kind: str | None = None) -> Said:
    """Return an Image or CompressedImage as the message of Foxglove with the same content, or of another `kind`."""
    fields = {key: value for key, value in image.fields.items() if key != "header"}
    stamp, frame_id = (image.fields["header"][key] for key in ("stamp", "frame_id"))
    kind = kind or ("RawImage" if "encoding" in fields else "CompressedImage")
    return Said(
        image.topic, f"foxglove_msgs/msg/{kind}", image.time_ns, {"timestamp": stamp, "frame_id": frame_id} | fields
    )


def camera_info(topic: str, stamp_ns: int, camera: Camera, **more: Any) -> Said:
    """Return the CameraInfo of a pinhole camera; `more` replaces fields."""
    fx, fy, cx, cy = camera.params[:4]
    fields = {
        "header": header(stamp_ns, "camera"),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1]),
        "r": np.eye(3).reshape(-1),
        "p": np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]),
    }
    return Said(topic, "sensor_msgs/msg/CameraInfo", stamp_ns, fields | more)


def cloud(
    topic: str,
    stamp_ns: int,
    columns: dict[str, Any],
    *,
    offsets: Sequence[int] | None = None,
    point_step: int | None = None,
    row_padding: int = 0,
    height: int = 1,
    big_endian: bool = False,
    frame: str = "lidar",
    **more: Any,
) -> Said:
    """Return a PointCloud2 of columns (N,), packed unless `offsets` and `point_step` say otherwise."""
    names = list(columns)
    kinds = [np.asarray(columns[name]).dtype.str[1:] for name in names]
    sizes = [int(kind[1]) for kind in kinds]
    offsets = list(np.cumsum([0, *sizes[:-1]])) if offsets is None else offsets
    step = sum(sizes) if point_step is None else point_step
    count = len(columns[names[0]])
    width = count // height
    order = ">" if big_endian else "<"
    dtype = np.dtype({"names": names, "formats": [order + k for k in kinds], "offsets": offsets, "itemsize": step})
    data = np.full((height, width * step + row_padding), 0xA5, np.uint8)
    points = np.ndarray((height, width), dtype, data, strides=(data.shape[1], step))
    for name in names:
        points[name] = np.asarray(columns[name]).reshape(height, width)
    fields = {
        "header": header(stamp_ns, frame),
        "height": height,
        "width": width,
        "fields": [
            {"name": name, "offset": int(offset), "datatype": _DATATYPES[kind], "count": 1}
            for name, offset, kind in zip(names, offsets, kinds, strict=True)
        ],
        "is_bigendian": big_endian,
        "point_step": step,
        "row_step": data.shape[1],
        "data": data.reshape(-1),
        "is_dense": True,
    }
    return Said(topic, "sensor_msgs/msg/PointCloud2", stamp_ns, fields | more)


def transform(parent: str, child: str, parent_from_child: Any, stamp_ns: int = 0) -> dict[str, Any]:
    """Return the fields of a TransformStamped."""
    x, y, z, w = Rotation.from_matrix(parent_from_child[:3, :3]).as_quat().tolist()
    tx, ty, tz = parent_from_child[:3, 3].tolist()
    pose = {"translation": {"x": tx, "y": ty, "z": tz}, "rotation": {"x": x, "y": y, "z": z, "w": w}}
    return {"header": header(stamp_ns, parent), "child_frame_id": child, "transform": pose}


def tf(transforms: Sequence[dict[str, Any]], time_ns: int = 0, topic: str = "/tf_static") -> Said:
    """Return a message of transforms."""
    return Said(topic, "tf2_msgs/msg/TFMessage", time_ns, {"transforms": list(transforms)})


def odometry(topic: str, stamp_ns: int, place: Sequence[float]) -> Said:
    """Return an Odometry at a place, without a turn."""
    position = dict(zip("xyz", map(float, place), strict=True))
    pose = {"pose": {"position": position, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}}
    fields = {"header": header(stamp_ns, "odom"), "child_frame_id": "base", "pose": pose}
    return Said(topic, "nav_msgs/msg/Odometry", stamp_ns, fields)


def messages_of(
    frames: Sequence[Frame], start_ns: int = 1_700_000_000_000_000_000, *, drawing: Any = None
) -> list[Said]:
    """Return frames as a recording: a picture and a sweep each 0.1 s, their camera, and where the sensors are.

    TF contains `drawing` (camera_from_lidar) where it is given, else the true pose.
    """
    truth = frames[0].camera_from_lidar if drawing is None else drawing
    said = [
        tf(
            [
                transform("base", "lidar", _LIDAR_ON_BASE),
                transform("base", "camera", _LIDAR_ON_BASE @ inverse(truth)),
            ],
            start_ns,
        )
    ]
    for number, frame in enumerate(frames):
        stamp_ns = start_ns + number * 100_000_000
        columns: dict[str, Any] = {axis: frame.cloud.xyz[:, i].astype(np.float32) for i, axis in enumerate("xyz")}
        if frame.cloud.intensity is not None:
            columns["intensity"] = frame.cloud.intensity.astype(np.float32)
        if frame.cloud.ring is not None:
            columns["ring"] = frame.cloud.ring.astype(np.uint16)
        said += [
            camera_info("/camera/camera_info", stamp_ns, frame.camera),
            image("/camera/image_raw", stamp_ns, frame.image.rgb),
            cloud("/points", stamp_ns, columns),
        ]
    return said


_LIDAR_ON_BASE = np.array([[0.0, -1, 0, 0.4], [1, 0, 0, -0.1], [0, 0, 1, 1.8], [0, 0, 0, 1]])
