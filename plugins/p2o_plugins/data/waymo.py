"""The Waymo Open Dataset v2 (perception), by its Parquet files: five cameras and five LiDARs as range images.

The files as the public code reads them (waymo-research/waymo-open-dataset, src/waymo_open_dataset/v2/component.py and
v2/perception/base.py, camera_image.py, context.py, lidar.py, pose.py, utils/lidar_utils.py, and third_party/camera/
camera_model.cc). Cameras look along x, with y to the left and z up; pixels count from the left edge of the first one,
which is half a pixel from here; distortion is OpenCV's. The pose of a frame is that at the middle of the top LiDAR's
turn, the pose of a picture that of its own time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Camera, Cloud, Dataset, Frame, Image, InputError, Method, Options, field, se3
from p2o.arrays import Float
from p2o.files.input_file import existing_folder, listing, naming
from p2o.formats.camera_entry import read_camera
from p2o.geometry.motion import adjoint, pose_at
from p2o.geometry.pose_text import read_pose

from p2o_plugins.data.arrow_file import ParquetTable
from p2o_plugins.data.cloud_file import cloud_from_fields
from p2o_plugins.data.ego_path import moved_cloud, now_from_then
from p2o_plugins.data.image_file import decode_rgb
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.waymo_range_image import points_of, to_world, uniform_inclinations

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
LIDARS = ("TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR")
"""Both numbered from 1 on in the files."""
_OPTICAL_FROM_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_PER_SECOND = 1_000_000
_GLOBAL_SHUTTER = 5
# A picture is exposed within such a time of the pose that it has; other times are no times.
_LONGEST_EXPOSURE_S = 0.2
_MAX_PIXELS = 1 << 22
_SEGMENT, _FRAME, _CAMERA, _LASER = (
    f"key.{name}" for name in ("segment_context_name", "frame_timestamp_micros", "camera_name", "laser_name")
)
_PIXELS = "range_image_return1"
_LENS = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
_SHUTTER = "rolling_shutter_direction"
_STAMPS = (
    "pose_timestamp",
    "rolling_shutter_params.camera_trigger_time",
    "rolling_shutter_params.camera_readout_done_time",
)


class WaymoOptions(Options):
    """Options of the Waymo Open Dataset."""

    root: Path = field(Path("."), help="Folder that holds camera_image, lidar and the other components of v2.")
    segments: Words = field((), help="Names of segments (files without .parquet), joined by commas; none: all.")
    cameras: Words = field(("FRONT",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}.")
    lidar: Literal["TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"] = field("TOP", help="Whose points.")
    moved: bool = field(
        True, help="Move the sweep to the middle of the image's exposure by the car's poses; else it stays."
    )


@dataclass(frozen=True, eq=False)
class _Segment:
    """A segment: its files, which are read when they are asked for."""

    root: Path
    name: str

    def table(self, component: str) -> ParquetTable:
        return ParquetTable(self.root / component / f"{self.name}.parquet", f"component {component}")

    @cached_property
    def camera_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """Rows of camera_calibration by the numbers of cameras."""
        fields = (*(f"intrinsic.{name}" for name in _LENS), "extrinsic.transform", "width", "height", _SHUTTER)
        return self._rows("camera_calibration", _CAMERA, "CameraCalibrationComponent", fields)

    @cached_property
    def lidar_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """Rows of lidar_calibration by the numbers of LiDARs."""
        fields = ("extrinsic.transform", *(f"beam_inclination.{name}" for name in ("min", "max", "values")))
        return self._rows("lidar_calibration", _LASER, "LiDARCalibrationComponent", fields)

    @cached_property
    def world_from_vehicle(self) -> Mapping[int, int]:
        """Rows of vehicle_pose by stamps of frames in microseconds."""
        return {time: row for row, time in enumerate(self._key("vehicle_pose", _FRAME))}

    @cached_property
    def pixel_poses(self) -> Mapping[int, int]:
        """Rows of lidar_pose by stamps of frames, of the top LiDAR."""
        lasers = self._key("lidar_pose", _LASER)
        return {
            time: row
            for row, (time, laser) in enumerate(zip(self._key("lidar_pose", _FRAME), lasers, strict=True))
            if laser == 1
        }

    def _key(self, component: str, key: str) -> list[int]:
        found: list[int] = self.table(component).columns({key: "number"})[key].tolist()
        return found

    def _rows(self, component: str, key: str, prefix: str, fields: Sequence[str]) -> Mapping[int, Mapping[str, Any]]:
        table, names = self.table(component), [f"[{prefix}].{name}" for name in fields]
        return {
            number: dict(zip(fields, table.row(row, names).values(), strict=True))
            for row, number in enumerate(self._key(component, key))
        }


@dataclass(frozen=True, eq=False)
class _Pair:
    """A picture and a sweep of one frame: rows of camera_image and lidar; times in microseconds."""

    segment: _Segment
    camera: int
    frame_us: int
    first_us: int
    image_row: int
    sweep_row: int

    @property
    def camera_name(self) -> str:
        return CAMERAS[self.camera - 1]

    @property
    def name(self) -> str:
        return f"{self.segment.name}/{self.camera_name}/{self.frame_us}"


def build(options: WaymoOptions) -> Dataset:
    """Return the frames of the chosen segments and cameras; names are "segment/camera/microseconds".

    Frames that have an image and no sweep, as in a download of some components, are listed in `skipped`.

    Raises InputError where the folder is missing or holds no segments of v2, for names of segments and cameras that are
    not there, and where no frame is left.
    """
    root = existing_folder(options.root, "Waymo").resolve()
    segments = _segments(root, options.segments)
    cameras = chosen("camera", options.cameras, CAMERAS)
    entries: dict[str, _Pair] = {}
    skipped: dict[str, str] = {}
    for segment in segments:
        sweeps = _numbered(segment, "lidar", _LASER, LIDARS.index(options.lidar) + 1)
        for camera in cameras:
            images = _numbered(segment, "camera_image", _CAMERA, CAMERAS.index(camera) + 1)
            first_us = min((*images, *sweeps), default=0)
            for frame_us, image_row in sorted(images.items()):
                number = CAMERAS.index(camera) + 1
                pair = _Pair(segment, number, frame_us, first_us, image_row, sweeps.get(frame_us, -1))
                if frame_us in sweeps:
                    entries[pair.name] = pair
                else:
                    skipped[pair.name] = f"{segment.table('lidar').path} has no sweep of {options.lidar} for it"
    if not entries:
        raise InputError(
            "no Waymo frames",
            where=root,
            expected=f"images of {', '.join(cameras)} and sweeps of {options.lidar}",
            got=next(iter(skipped.values()), f"{len(segments)} segments without such images"),
        )
    return LazyFrames(entries, partial(_read, options), skipped)


def _segments(root: Path, wanted: Sequence[str]) -> list[_Segment]:
    folder = root / "camera_image"
    if not os.path.isdir(folder):
        below = [path for path in listing(root, "Waymo") if os.path.isdir(path / "camera_image")]
        old = next((path.name for path in listing(root, "Waymo") if path.name.endswith(".tfrecord")), None)
        hint = f"name the folder of components: {below[0]}" if below else None
        if old is not None:
            hint = "records of v1 (.tfrecord) are not read: take the same segments from the release v2 (Parquet)"
        raise InputError(
            "there are no components of Waymo v2",
            where=root,
            expected="camera_image, lidar, camera_calibration, lidar_calibration, lidar_pose, vehicle_pose",
            got=old or ", ".join(path.name for path in listing(root, "Waymo")[:8]) or "an empty folder",
            hint=hint,
        )
    files = [path for path in listing(folder, "Waymo") if path.suffix == ".parquet"]
    return [_Segment(root, name) for name in chosen("segment", wanted, [path.stem for path in files], where=folder)]


def _numbered(segment: _Segment, component: str, key: str, number: int) -> dict[int, int]:
    """Return the rows of one sensor by the stamps of their frames, in microseconds."""
    keys = segment.table(component).columns({_FRAME: "number", key: "number"})
    rows = np.flatnonzero(keys[key] == number)
    return dict(zip(keys[_FRAME][rows].tolist(), rows.tolist(), strict=True))


def _read(options: WaymoOptions, pair: _Pair) -> Frame:
    segment = pair.segment
    calibration = segment.table("camera_calibration").path
    row = _of(segment.camera_rows, pair.camera, pair.camera_name, calibration)
    camera = _camera(row, calibration)
    vehicle_from_camera = _pose(row["extrinsic.transform"], "the mounting of the camera", calibration)
    exposure = _image_row(pair)
    where = Path(f"{segment.table('camera_image').path}: {pair.frame_us}")
    jpeg = exposure["image"]
    if not isinstance(jpeg, bytes):
        raise InputError("the image is missing", where=where, expected="bytes of a JPEG", got=type(jpeg).__name__)
    rgb, warnings = decode_rgb(jpeg, where, pair.name, (camera.width, camera.height))
    with naming(where):
        image = Image(rgb, camera)
    lidars = segment.table("lidar_calibration").path
    lidar_row = _of(segment.lidar_rows, LIDARS.index(options.lidar) + 1, options.lidar, lidars)
    vehicle_from_lidar = _pose(lidar_row["extrinsic.transform"], "the mounting of the LiDAR", lidars)
    cloud, cloud_warnings = _sweep(options, pair, lidar_row, vehicle_from_lidar)
    now, twist, remark = _moment(exposure, row[_SHUTTER], where)
    world_from_lidar = now @ vehicle_from_lidar
    if options.moved:
        cloud = moved_cloud(cloud, now_from_then(world_from_lidar, _frame_pose(pair) @ vehicle_from_lidar))
    return Frame(
        pair.name,
        image,
        cloud,
        camera_from_lidar=_OPTICAL_FROM_CAMERA @ se3.inverse(vehicle_from_camera) @ vehicle_from_lidar,
        twist=adjoint(se3.inverse(vehicle_from_lidar), twist),
        warnings=(*warnings, *cloud_warnings, *remark),
        sequence=segment.name,
        time_s=(pair.frame_us - pair.first_us) / _PER_SECOND,
        # No pose of the camera: it would be this one and the truth.
        lidar_world_from_lidar=world_from_lidar,
        camera_name=pair.camera_name,
    )


def _of(rows: Mapping[int, Mapping[str, Any]], number: int, name: str, path: Path) -> Mapping[str, Any]:
    if number not in rows:
        raise InputError("a sensor has no calibration", where=path, expected=f"{name} (number {number})")
    return rows[number]


def _camera(row: Mapping[str, Any], path: Path) -> Camera:
    fu, fv, cu, cv, *d = (_number(row[f"intrinsic.{name}"], name, path) for name in _LENS)
    # Pixels count from the edge of the first one there, from its middle here.
    matrix = [[fu, 0.0, cu - 0.5], [0.0, fv, cv - 0.5], [0.0, 0.0, 1.0]]
    size = {name: _number(row[name], name, path) for name in ("width", "height")}
    return read_camera({**size, "K": matrix, "distortion_model": "plumb_bob", "D": d}, path)


def _image_row(pair: _Pair) -> dict[str, Any]:
    vector = ("x", "y", "z")
    names = (
        "image",
        "pose.transform",
        *(f"velocity.linear_velocity.{axis}" for axis in vector),
        *(f"velocity.angular_velocity.{axis}" for axis in vector),
        *_STAMPS,
    )
    table = pair.segment.table("camera_image")
    row = table.row(pair.image_row, [f"[CameraImageComponent].{name}" for name in names])
    return dict(zip(names, row.values(), strict=True))


def _moment(exposure: Mapping[str, Any], shutter: Any, where: Path) -> tuple[Float, Float, tuple[str, ...]]:
    """Return world_from_vehicle (4, 4) and the vehicle's velocity (6,) in its frame, at the middle of the exposure.

    Lines of a rolling shutter are exposed one after the other, which no camera here can say: the middle line counts.
    """
    pose = _pose(exposure["pose.transform"], "the pose of the image", where)
    velocity, rate = (
        np.array([_number(exposure[f"velocity.{kind}_velocity.{axis}"], f"{kind} velocity", where) for axis in "xyz"])
        for kind in ("linear", "angular")
    )
    pose_s, trigger_s, done_s = (_number(exposure[name], name, where) for name in _STAMPS)
    # The middle line is open in the middle between the first line's opening and the last one's end.
    later_s = 0.0 if shutter == _GLOBAL_SHUTTER else 0.5 * (trigger_s + done_s) - pose_s
    remark: tuple[str, ...] = ()
    if abs(later_s) > _LONGEST_EXPOSURE_S:
        remark = (f"{where}: exposed {later_s:.3g} s from its pose, which cannot be; it counts as of its pose",)
        later_s = 0.0
    # The velocity is one in the world, the rates are about the axes of the car, as the public camera model takes them.
    twist = np.concatenate([rate, pose[:3, :3].T @ velocity])
    return pose @ pose_at(twist, later_s), twist, remark


def _frame_pose(pair: _Pair) -> Float:
    table = pair.segment.table("vehicle_pose")
    if pair.frame_us not in pair.segment.world_from_vehicle:
        raise InputError("there is no pose of the car", where=table.path, expected=f"frame {pair.frame_us}")
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    row = table.row(pair.segment.world_from_vehicle[pair.frame_us], [column])
    return _pose(row[column], f"the pose of frame {pair.frame_us}", table.path)


def _sweep(
    options: WaymoOptions, pair: _Pair, row: Mapping[str, Any], vehicle_from_lidar: Float
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the first returns of the LiDAR, in its frame at the pose of the frame, with warnings."""
    table = pair.segment.table("lidar")
    where = Path(f"{table.path}: {pair.frame_us}")
    pixels = _grid(table, pair.sweep_row, "LiDARComponent", 4, where)
    inclination = _inclinations(row, len(pixels), pair.segment.table("lidar_calibration").path)
    xyz, ring, column = points_of(pixels[..., 0].astype(np.float64), inclination, vehicle_from_lidar)
    if not len(xyz):
        raise InputError("the sweep has no returns", where=where, expected="ranges over 0 m")
    if options.lidar == "TOP":
        poses = pair.segment.table("lidar_pose")
        if pair.frame_us not in pair.segment.pixel_poses:
            raise InputError("there are no poses of the pixels", where=poses.path, expected=f"frame {pair.frame_us}")
        six = _grid(poses, pair.segment.pixel_poses[pair.frame_us], "LiDARPoseComponent", 6, poses.path)
        if six.shape[:2] != pixels.shape[:2]:
            raise InputError(
                "poses and ranges have different sizes",
                where=poses.path,
                expected=f"{pixels.shape[0]}x{pixels.shape[1]} pixels",
                got=f"{six.shape[0]}x{six.shape[1]}",
            )
        world = to_world(se3.apply(vehicle_from_lidar, xyz), six[ring, column])
        xyz = se3.apply(se3.inverse(_frame_pose(pair) @ vehicle_from_lidar), world)
    x, y, z = xyz.T
    fields = {"x": x, "y": y, "z": z, "intensity": pixels[ring, column, 1], "ring": ring}
    return cloud_from_fields(fields, where)


def _grid(table: ParquetTable, row: int, prefix: str, channels: int, where: Path) -> Any:
    """Return the pixels (H, W, channels) of a range image."""
    names = [f"[{prefix}].{_PIXELS}.{part}" for part in ("values", "shape")]
    values, shape = table.row(row, names).values()
    sizes = [int(size) for size in shape] if isinstance(shape, np.ndarray) and shape.dtype.kind == "i" else []
    good = len(sizes) == 3 and min(sizes) > 0 and sizes[2] == channels and sizes[0] * sizes[1] <= _MAX_PIXELS
    if not good or not isinstance(values, np.ndarray) or values.size != sizes[0] * sizes[1] * channels:
        raise InputError(
            "this is no range image",
            where=where,
            expected=f"height x width x {channels} numbers",
            got=f"{values.size if isinstance(values, np.ndarray) else 'no'} numbers of the shape {sizes}",
        )
    return values.reshape(sizes)


def _inclinations(row: Mapping[str, Any], height: int, path: Path) -> Float:
    """Return the inclinations (H,) of the rows in radians, that of the highest beam first."""
    values = row["beam_inclination.values"]
    if values is None or not len(values):
        lowest, highest = (
            _number(row[f"beam_inclination.{end}"], f"{end} inclination", path) for end in ("min", "max")
        )
        values = uniform_inclinations(lowest, highest, height)
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (height,) or not (np.abs(values) < np.pi / 2).all():
        raise InputError(
            "inclinations do not fit the range image",
            where=path,
            expected=f"{height} angles in radians",
            got=f"{values.size}, the largest {np.abs(values).max(initial=0):g}",
        )
    return values[::-1]


def _pose(value: Any, name: str, path: Path) -> Float:
    return read_pose(name, value.tolist() if isinstance(value, np.ndarray) else value, path)[0]


def _number(value: Any, name: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{name} is no number", where=path, expected="a finite number", got=str(value)[:40])
    return value


METHOD = Method(
    name="waymo",
    build=build,
    options=WaymoOptions,
    summary="Waymo Open Dataset v2 (perception): five cameras and the top or another LiDAR, by its Parquet files.",
    gives=frozenset({"rings", "intensity"}),
    cite="Sun et al.: Scalability in perception for autonomous driving: Waymo Open Dataset. CVPR 2020",
    extra="arrow",
)
