"""Read the Waymo Open Dataset (perception) from files of v2 or v1: five cameras, and range images of five LiDARs.

The format follows the public code (waymo-research/waymo-open-dataset, src/waymo_open_dataset/v2/perception/utils/
lidar_utils.py, dataset.proto, and third_party/camera/camera_model.cc). Camera frames are x forward, y left, z up; pixel
coordinates start at the left edge of the first pixel, half a pixel from p2o's; distortion is that of OpenCV. The pose
of a frame refers to the middle of the top LiDAR's revolution, the pose of an image to its own time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Cloud, Dataset, Float, Frame, Image, InputError, Method, Options, field, se3
from p2o.reading import adjoint, decode_rgb, existing_folder, layout, listing, naming, pose_at, read_pose
from p2o_formats.camera_entry import read_camera

from p2o_datasets.cloud_file import cloud_from_fields
from p2o_datasets.ego_path import moved_cloud, refuse_jump
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, finite_number, no_sequences, rig_frame
from p2o_datasets.waymo_parquet import COMPONENTS, ParquetSegment
from p2o_datasets.waymo_range_image import LENS, SHUTTER, STAMPS, points_of, to_world, uniform_inclinations
from p2o_datasets.waymo_records import SUFFIX, RecordSegment, segment_name

CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT")
LIDARS = ("TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR")
"""Names of the sensors, which the files number from 1."""
_OPTICAL_FROM_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_PER_SECOND = 1_000_000
_GLOBAL_SHUTTER = 5
# Largest plausible time between the pose of an image and its exposure.
_MAX_EXPOSURE_S = 0.2


class WaymoOptions(Options):
    """Options of the Waymo Open Dataset."""

    root: Path = field(Path("."), help="Folder of v2's components (camera_image, lidar, ...), or v1's .tfrecord files.")
    segments: Words = field((), help="Names of segments, separated by commas; default: all.")
    cameras: Words = cameras_field("FRONT", CAMERAS)
    lidar: Literal["TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"] = field("TOP", help="LiDAR of the sweeps.")
    moved: bool = field(True, help="Transform the sweep to the middle of the exposure with the vehicle's poses.")


Segment = ParquetSegment | RecordSegment
"""A segment of either release."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """Image and sweep of one frame, by their row numbers in the segment; times in microseconds."""

    segment: Segment
    camera: int
    frame_us: int
    first_us: int
    image_row: int
    sweep_row: int

    @property
    def name(self) -> str:
        return f"{self.segment.name}/{CAMERAS[self.camera - 1]}/{self.frame_us}"


def build(options: WaymoOptions) -> Dataset:
    """Return the frames of the selected segments and cameras; names are "segment/camera/microseconds".

    Frames without a sweep, as in partial downloads, are listed in `skipped`. Raises InputError without segments or
    frames, and UnknownNameError for unknown segments and cameras.
    """
    root = existing_folder(options.root, "Waymo").resolve()
    segments, cameras = _segments(root, options.segments), chosen("camera", options.cameras, CAMERAS)
    frames = Listed()
    for segment in segments:
        sweeps = segment.sweeps(LIDARS.index(options.lidar) + 1)
        for camera in cameras:
            number = CAMERAS.index(camera) + 1
            images = segment.images(number)
            first_us = min((*images, *sweeps), default=0)
            for frame_us, image_row in sorted(images.items()):
                pair = _Pair(segment, number, frame_us, first_us, image_row, sweeps.get(frame_us, -1))
                lacking = f"{segment.where('lidar')} has no sweep of {options.lidar} for the frame"
                frames.add(pair.name, pair, "" if frame_us in sweeps else lacking)
    expected = f"images of {', '.join(cameras)} and sweeps of {options.lidar}"
    got = f"{len(segments)} segments without such images"
    return frames.lazy("Waymo frames", root, partial(_read, options), expected=expected, got=got)


def _segments(root: Path, wanted: Sequence[str]) -> Sequence[Segment]:
    records = {segment_name(path): path for path in listing(root, "Waymo") if path.name.endswith(SUFFIX)}
    if records:
        return [RecordSegment(records[name], name) for name in chosen("segment", wanted, records, where=root)]
    folder = root / COMPONENTS[0]
    if not os.path.isdir(folder):
        below = [path for path in listing(root, "Waymo") if os.path.isdir(path / COMPONENTS[0])]
        expected = f"files {SUFFIX} (v1), or folders {', '.join(COMPONENTS)} (v2)"
        hint = f"give the folder of components: {below[0]}" if below else None
        raise no_sequences("segments of Waymo", root, expected, hint)
    files = [path.stem for path in listing(folder, "Waymo") if path.suffix == ".parquet"]
    return [ParquetSegment(root, name) for name in chosen("segment", wanted, files, where=folder)]


def _read(options: WaymoOptions, pair: _Pair) -> Frame:
    segment = pair.segment
    calibration = segment.where("camera_calibration")
    row = _of(segment.camera_rows, pair.camera, CAMERAS[pair.camera - 1], calibration)
    fu, fv, cu, cv, *d = (finite_number(row[f"intrinsic.{name}"], name, calibration) for name in LENS)
    # Pixel coordinates start at the edge of the first pixel, in p2o at its centre.
    matrix = [[fu, 0.0, cu - 0.5], [0.0, fv, cv - 0.5], [0.0, 0.0, 1.0]]
    size = {name: finite_number(row[name], name, calibration) for name in ("width", "height")}
    camera = read_camera({**size, "K": matrix, "distortion_model": "plumb_bob", "D": d}, calibration)
    vehicle_from_camera = _pose(row["extrinsic.transform"], "the extrinsic of the camera", calibration)
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
    vehicle_from_lidar = _pose(lidar_row["extrinsic.transform"], "the extrinsic of the LiDAR", lidars)
    cloud, cloud_warnings = _sweep(options, pair, lidar_row, vehicle_from_lidar)
    now, twist, remark = _moment(exposure, row[SHUTTER], where)
    world_from_lidar = now @ vehicle_from_lidar
    if options.moved:
        cloud = moved_cloud(cloud, se3.inverse(world_from_lidar) @ (_frame_pose(pair) @ vehicle_from_lidar))
    extrinsic = _OPTICAL_FROM_CAMERA @ se3.inverse(vehicle_from_camera) @ vehicle_from_lidar
    twist, warnings = adjoint(se3.inverse(vehicle_from_lidar), twist), (*warnings, *cloud_warnings, *remark)
    time_s = (pair.frame_us - pair.first_us) / _PER_SECOND
    return rig_frame(pair.name, time_s, image, cloud, extrinsic, world_from_lidar, *warnings, twist=twist)


def _of(rows: Mapping[int, Mapping[str, Any]], number: int, name: str, path: Path) -> Mapping[str, Any]:
    if number not in rows:
        raise InputError("a sensor has no calibration", where=path, expected=f"{name} (number {number})")
    return rows[number]


def _moment(exposure: Mapping[str, Any], shutter: Any, where: Path) -> tuple[Float, Float, tuple[str, ...]]:
    """Return world_from_vehicle (4, 4) and the vehicle's velocity (6,) at the exposure of the middle line."""
    pose = _pose(exposure["pose.transform"], "the pose of the image", where)
    velocity, rate = (
        np.array([finite_number(exposure[f"{key}.{axis}"], key, where) for axis in "xyz"])
        for key in ("velocity.linear_velocity", "velocity.angular_velocity")
    )
    pose_s, trigger_s, done_s = (finite_number(exposure[name], name, where) for name in STAMPS)
    # The exposure of the middle line is centred between the start of the first line and the end of the last one.
    later_s = 0.0 if shutter == _GLOBAL_SHUTTER else 0.5 * (trigger_s + done_s) - pose_s
    remark: tuple[str, ...] = ()
    if abs(later_s) > _MAX_EXPOSURE_S:
        fault = f"the exposure is {later_s:.3g} s from its pose, which is implausible"
        remark, later_s = (f"{where}: {fault}; the pose's time is used",), 0.0
    # As in the public camera model, the velocity is in world coordinates, the rates are about the vehicle's axes.
    twist = np.concatenate([rate, pose[:3, :3].T @ velocity])
    return pose @ pose_at(twist, later_s), twist, remark


def _frame_pose(pair: _Pair) -> Float:
    value, path = pair.segment.frame_pose(pair.frame_us), pair.segment.where("vehicle_pose")
    if value is None:
        raise InputError("there is no pose of the vehicle", where=path, expected=f"frame {pair.frame_us}")
    return _pose(value, f"the pose of frame {pair.frame_us}", path)


def _sweep(
    options: WaymoOptions, pair: _Pair, row: Mapping[str, Any], vehicle_from_lidar: Float
) -> tuple[Cloud, tuple[str, ...]]:
    """Return the first returns of the LiDAR in its frame at the pose of the frame, and warnings."""
    segment = pair.segment
    where = Path(f"{segment.where('lidar')}: {pair.frame_us}")
    pixels = segment.ranges(pair.sweep_row, LIDARS.index(options.lidar) + 1, where)
    inclination = _inclinations(row, len(pixels), segment.where("lidar_calibration"))
    xyz, ring, column = points_of(pixels[..., 0].astype(np.float64), inclination, vehicle_from_lidar)
    if not len(xyz):
        raise InputError("the sweep has no returns", where=where, expected="ranges above 0 m")
    if options.lidar == "TOP":
        pixel_poses, path = segment.pixel_poses(pair.frame_us), segment.where("lidar_pose")
        if pixel_poses is None:
            raise InputError("there are no poses of the pixels", where=path, expected=f"frame {pair.frame_us}")
        if pixel_poses.shape[:2] != pixels.shape[:2]:
            got, size = ("x".join(map(str, grid.shape[:2])) for grid in (pixel_poses, pixels))
            fault = "poses and ranges have different sizes"
            raise InputError(fault, where=path, expected=f"{size} pixels", got=got)
        pixel_poses = pixel_poses[ring, column]
        refuse_jump(np.vstack([_frame_pose(pair)[:3, 3], pixel_poses[:, 3:]]), _MAX_EXPOSURE_S, path)
        world = to_world(se3.apply(vehicle_from_lidar, xyz), pixel_poses)
        xyz = se3.apply(se3.inverse(_frame_pose(pair) @ vehicle_from_lidar), world)
    x, y, z = xyz.T
    fields = {"x": x, "y": y, "z": z, "intensity": pixels[ring, column, 1], "ring": ring}
    return cloud_from_fields(fields, where)


def _inclinations(row: Mapping[str, Any], height: int, path: Path) -> Float:
    """Return the inclinations (H,) of the rows in radians, highest beam first."""
    values = row["beam_inclination.values"]
    if values is None or not len(values):
        ends = {end: row[f"beam_inclination.{end}"] for end in ("min", "max")}
        lowest, highest = (finite_number(value, f"{end} inclination", path) for end, value in ends.items())
        values = uniform_inclinations(lowest, highest, height)
    values = np.asarray(values, dtype=np.float64) if isinstance(values, np.ndarray) else np.array([])
    if values.shape != (height,) or not (np.abs(values) < np.pi / 2).all():
        expected = f"{height} angles in radians"
        got = f"{values.size}, the largest {np.abs(values).max(initial=0):g}"
        raise InputError("the inclinations do not fit the range image", where=path, expected=expected, got=got)
    return values[::-1]


def _pose(value: Any, name: str, path: Path) -> Float:
    return read_pose(name, value.tolist() if isinstance(value, np.ndarray) else value, path)[0]


METHOD = Method(
    name="waymo",
    build=build,
    options=WaymoOptions,
    summary="Waymo Open Dataset (perception), files of v2 or v1: five cameras, and one of five LiDARs.",
    gives=frozenset({"rings", "intensity"}),
    cite="Sun et al.: Scalability in perception for autonomous driving: Waymo Open Dataset. CVPR 2020",
    extra="arrow",
    recognises=layout("lidar/*.parquet", "*/lidar/*.parquet", "*.tfrecord"),
)
