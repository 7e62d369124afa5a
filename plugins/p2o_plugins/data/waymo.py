"""The Waymo Open Dataset (perception): five cameras and five LiDARs as range images, from the files of v2 or of v1.

What they hold as the public code takes it (waymo-research/waymo-open-dataset, src/waymo_open_dataset/v2/perception/
utils/lidar_utils.py, dataset.proto, and third_party/camera/camera_model.cc). Cameras look along x, with y to the left
and z up; pixels count from the left edge of the first one, which is half a pixel from here; distortion is OpenCV's. The
pose of a frame is that at the middle of the top LiDAR's turn, the pose of a picture that of its own time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Camera, Cloud, Dataset, Frame, Image, InputError, Method, Options, field, se3
from p2o.arrays import Float
from p2o.files.input_file import existing_folder, listing, naming
from p2o.formats.camera_entry import read_camera
from p2o.geometry.motion import adjoint, pose_at
from p2o.geometry.pose_text import read_pose

from p2o_plugins.data.cloud_file import cloud_from_fields
from p2o_plugins.data.ego_path import moved_cloud, now_from_then
from p2o_plugins.data.image_file import decode_rgb
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.waymo_parquet import COMPONENTS, ParquetSegment
from p2o_plugins.data.waymo_range_image import LENS, SHUTTER, STAMPS, points_of, to_world, uniform_inclinations
from p2o_plugins.data.waymo_records import SUFFIX, RecordSegment, segment_name

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
LIDARS = ("TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR")
"""Both numbered from 1 on in the files."""
_OPTICAL_FROM_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_PER_SECOND = 1_000_000
_GLOBAL_SHUTTER = 5
# A picture is exposed within such a time of the pose that it has; other times are no times.
_LONGEST_EXPOSURE_S = 0.2


class WaymoOptions(Options):
    """Options of the Waymo Open Dataset."""

    root: Path = field(
        Path("."), help="Folder of the components of v2 (camera_image, lidar, ...), or of .tfrecord files (v1)."
    )
    segments: Words = field((), help="Names of segments, joined by commas; none: all.")
    cameras: Words = field(("FRONT",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}.")
    lidar: Literal["TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"] = field("TOP", help="Whose points.")
    moved: bool = field(
        True, help="Move the sweep to the middle of the image's exposure by the car's poses; else it stays."
    )


Segment = ParquetSegment | RecordSegment
"""A segment of either release."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """A picture and a sweep of one frame, by what its segment calls their rows; times in microseconds."""

    segment: Segment
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

    Raises InputError where the folder is missing or holds no segments, for names of segments and cameras that are
    not there, and where no frame is left.
    """
    root = existing_folder(options.root, "Waymo").resolve()
    segments = _segments(root, options.segments)
    cameras = chosen("camera", options.cameras, CAMERAS)
    entries: dict[str, _Pair] = {}
    skipped: dict[str, str] = {}
    for segment in segments:
        sweeps = segment.sweeps(LIDARS.index(options.lidar) + 1)
        for camera in cameras:
            number = CAMERAS.index(camera) + 1
            images = segment.images(number)
            first_us = min((*images, *sweeps), default=0)
            for frame_us, image_row in sorted(images.items()):
                pair = _Pair(segment, number, frame_us, first_us, image_row, sweeps.get(frame_us, -1))
                if frame_us in sweeps:
                    entries[pair.name] = pair
                else:
                    skipped[pair.name] = f"{segment.where('lidar')} has no sweep of {options.lidar} for it"
    if not entries:
        raise InputError(
            "no Waymo frames",
            where=root,
            expected=f"images of {', '.join(cameras)} and sweeps of {options.lidar}",
            got=next(iter(skipped.values()), f"{len(segments)} segments without such images"),
        )
    return LazyFrames(entries, partial(_read, options), skipped)


def _segments(root: Path, wanted: Sequence[str]) -> Sequence[Segment]:
    records = {segment_name(path): path for path in listing(root, "Waymo") if path.name.endswith(SUFFIX)}
    if records:
        return [RecordSegment(records[name], name) for name in chosen("segment", wanted, records, where=root)]
    folder = root / COMPONENTS[0]
    if not os.path.isdir(folder):
        below = [path for path in listing(root, "Waymo") if os.path.isdir(path / COMPONENTS[0])]
        raise InputError(
            "there are no segments of Waymo",
            where=root,
            expected=f"files {SUFFIX} (v1), or folders {', '.join(COMPONENTS)} (v2)",
            got=", ".join(path.name for path in listing(root, "Waymo")[:8]) or "an empty folder",
            hint=f"name the folder of components: {below[0]}" if below else None,
        )
    files = [path.stem for path in listing(folder, "Waymo") if path.suffix == ".parquet"]
    return [ParquetSegment(root, name) for name in chosen("segment", wanted, files, where=folder)]


def _read(options: WaymoOptions, pair: _Pair) -> Frame:
    segment = pair.segment
    calibration = segment.where("camera_calibration")
    row = _of(segment.camera_rows, pair.camera, pair.camera_name, calibration)
    camera = _camera(row, calibration)
    vehicle_from_camera = _pose(row["extrinsic.transform"], "the mounting of the camera", calibration)
    exposure = segment.image(pair.image_row, pair.camera)
    where = Path(f"{segment.where('camera_image')}: {pair.frame_us}")
    jpeg = exposure["image"]
    if not isinstance(jpeg, bytes):
        raise InputError("the image is missing", where=where, expected="bytes of a JPEG", got=type(jpeg).__name__)
    rgb, warnings = decode_rgb(jpeg, where, pair.name, (camera.width, camera.height))
    with naming(where):
        image = Image(rgb, camera)
    lidars, lidar_number = segment.where("lidar_calibration"), LIDARS.index(options.lidar) + 1
    lidar_row = _of(segment.lidar_rows, lidar_number, options.lidar, lidars)
    vehicle_from_lidar = _pose(lidar_row["extrinsic.transform"], "the mounting of the LiDAR", lidars)
    cloud, cloud_warnings = _sweep(options, pair, lidar_row, vehicle_from_lidar)
    now, twist, remark = _moment(exposure, row[SHUTTER], where)
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
    fu, fv, cu, cv, *d = (_number(row[f"intrinsic.{name}"], name, path) for name in LENS)
    # Pixels count from the edge of the first one there, from its middle here.
    matrix = [[fu, 0.0, cu - 0.5], [0.0, fv, cv - 0.5], [0.0, 0.0, 1.0]]
    size = {name: _number(row[name], name, path) for name in ("width", "height")}
    return read_camera({**size, "K": matrix, "distortion_model": "plumb_bob", "D": d}, path)


def _moment(exposure: Mapping[str, Any], shutter: Any, where: Path) -> tuple[Float, Float, tuple[str, ...]]:
    """Return world_from_vehicle (4, 4) and the vehicle's velocity (6,) in its frame, at the middle of the exposure.

    Lines of a rolling shutter are exposed one after the other, which no camera here can say: the middle line counts.
    """
    pose = _pose(exposure["pose.transform"], "the pose of the image", where)
    velocity, rate = (
        np.array([_number(exposure[f"velocity.{kind}_velocity.{axis}"], f"{kind} velocity", where) for axis in "xyz"])
        for kind in ("linear", "angular")
    )
    pose_s, trigger_s, done_s = (_number(exposure[name], name, where) for name in STAMPS)
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
    value, path = pair.segment.frame_pose(pair.frame_us), pair.segment.where("vehicle_pose")
    if value is None:
        raise InputError("there is no pose of the car", where=path, expected=f"frame {pair.frame_us}")
    return _pose(value, f"the pose of frame {pair.frame_us}", path)


def _sweep(
    options: WaymoOptions, pair: _Pair, row: Mapping[str, Any], vehicle_from_lidar: Float
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the first returns of the LiDAR, in its frame at the pose of the frame, with warnings."""
    segment = pair.segment
    where = Path(f"{segment.where('lidar')}: {pair.frame_us}")
    pixels = segment.ranges(pair.sweep_row, LIDARS.index(options.lidar) + 1, where)
    inclination = _inclinations(row, len(pixels), segment.where("lidar_calibration"))
    xyz, ring, column = points_of(pixels[..., 0].astype(np.float64), inclination, vehicle_from_lidar)
    if not len(xyz):
        raise InputError("the sweep has no returns", where=where, expected="ranges over 0 m")
    if options.lidar == "TOP":
        six, path = segment.pixel_poses(pair.frame_us), segment.where("lidar_pose")
        if six is None:
            raise InputError("there are no poses of the pixels", where=path, expected=f"frame {pair.frame_us}")
        if six.shape[:2] != pixels.shape[:2]:
            raise InputError(
                "poses and ranges have different sizes",
                where=path,
                expected=f"{pixels.shape[0]}x{pixels.shape[1]} pixels",
                got=f"{six.shape[0]}x{six.shape[1]}",
            )
        world = to_world(se3.apply(vehicle_from_lidar, xyz), six[ring, column])
        xyz = se3.apply(se3.inverse(_frame_pose(pair) @ vehicle_from_lidar), world)
    x, y, z = xyz.T
    fields = {"x": x, "y": y, "z": z, "intensity": pixels[ring, column, 1], "ring": ring}
    return cloud_from_fields(fields, where)


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
    summary="Waymo Open Dataset (perception), files of v2 or v1: five cameras and the top or another LiDAR.",
    gives=frozenset({"rings", "intensity"}),
    cite="Sun et al.: Scalability in perception for autonomous driving: Waymo Open Dataset. CVPR 2020",
    extra="arrow",
)
