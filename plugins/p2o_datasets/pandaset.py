"""Read PandaSet: six cameras, the rotating Pandar64 and the front PandarGT, from JSON files and pickled tables.

The format follows the public toolkit (scaleapi/pandaset-devkit: python/pandaset/sensors.py, geometry.py, and its test
data). Points are in world coordinates, each compensated for motion, with their time and the number of their LiDAR
(0 Pandar64, 1 PandarGT). Poses are world_from_sensor, a heading (quaternion w x y z) and a position, one per frame.
Cameras have optical frames and no distortion. The files contain no extrinsics: they are computed as the mean over the
sequence of the pose of the LiDAR relative to the camera at the times of the images.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Cloud, Dataset, Float, Frame, InputError, Int, Method, Options, field, se3
from p2o.reading import existing_folder, layout, listing, parse_json, read_text
from p2o_formats.kitti_calibration import rectified_camera

from p2o_datasets.cloud_file import cloud_from_fields
from p2o_datasets.ego_path import EgoPath, moved_cloud, pose_rows
from p2o_datasets.kitti_folder import is_number
from p2o_datasets.lazy_dataset import (
    Listed,
    Words,
    cameras_field,
    chosen,
    drives_in,
    finite_number,
    read_image,
    rig_frame,
)
from p2o_datasets.pickled_table import read_pickled_table

CAMERAS = tuple(f"{place}_camera" for place in ("front", "front_left", "front_right", "left", "right", "back"))
_SUFFIXES = (".pkl.gz", ".pkl")
_COLUMNS = ("x", "y", "z", "i", "t", "d")
_SECOND = 1_000_000_000
_LATEST_S = 9e9
# With larger deviations from the mean over the frames, the poses contradict a rigid mounting.
_LOOSE_DEG, _LOOSE_M = 0.5, 0.05


class PandasetOptions(Options):
    """Options of PandaSet."""

    root: Path = field(Path("."), help="Folder of sequences, or of one sequence.")
    sequences: Words = field((), help="Names of sequences, separated by commas, such as 001; default: all.")
    cameras: Words = cameras_field("front_camera", CAMERAS)
    lidar: Literal["pandar64", "pandargt", "both"] = field("pandar64", help="LiDAR whose points are used.")
    moved: bool = field(True, help="Transform the sweep to the time of the image with the LiDAR's poses.")


@dataclass(frozen=True, eq=False)
class _Sensor:
    """Folder of a sensor; its files, with one time stamp and one pose per frame, are read on first access."""

    folder: Path

    @cached_property
    def time_ns(self) -> Int:
        """Time stamps of the frames (N,) in nanoseconds."""
        path = self.folder / "timestamps.json"
        content = parse_json(read_text(path, "file of time stamps"), "file of time stamps", path)
        times: list[Any] = content if isinstance(content, list) else [None]
        numbers = all(isinstance(time, int | float) and not isinstance(time, bool) for time in times)
        if not numbers or not all(abs(time) < _LATEST_S for time in times):
            raise InputError("the file is not a list of times", where=path, expected="seconds", got=str(content)[:60])
        return np.array([round(time * _SECOND) for time in times], np.int64)

    @cached_property
    def poses(self) -> Float:
        """Poses world_from_sensor (N, 4, 4) of the frames."""
        path = self.folder / "poses.json"
        content = parse_json(read_text(path, "file of poses"), "file of poses", path)
        records: list[Any] = content if isinstance(content, list) else [None]
        if not all(isinstance(record, Mapping) for record in records):
            got = str(content)[:60]
            raise InputError("the file is not a list of poses", where=path, expected="heading and position", got=got)
        rows = [[_number(record.get(group), axis, path) for group, axis in _POSE] for record in records]
        numbers = np.array(rows, np.float64).reshape(-1, 7)
        return pose_rows(numbers[:, :4], numbers[:, 4:], path, [f"frame {row}" for row in range(len(rows))])

    @cached_property
    def path(self) -> EgoPath:
        """Path of the sensor in the world."""
        where = self.folder / "poses.json"
        if len(self.poses) != len(self.time_ns):
            fault = "the numbers of poses and time stamps differ"
            raise InputError(fault, where=where, expected=f"{len(self.time_ns)} poses", got=len(self.poses))
        return EgoPath(self.time_ns, self.poses, where)

    @cached_property
    def projection(self) -> Float:
        """Projection (3, 4) of a camera, in px."""
        path = self.folder / "intrinsics.json"
        content = parse_json(read_text(path, "file of intrinsics"), "file of intrinsics", path)
        fx, fy, cx, cy = (_number(content, key, path) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]])

    def file(self, frame: str, suffixes: Sequence[str]) -> Path | None:
        """Return the file of a frame, or None."""
        return next((path for end in suffixes if os.path.isfile(path := self.folder / (frame + end))), None)


_POSE = (*(("heading", axis) for axis in "xyzw"), *(("position", axis) for axis in "xyz"))


@dataclass(frozen=True, eq=False)
class _Sequence:
    """A sequence: its folder and its LiDARs, which share one pose."""

    folder: Path
    lidar: _Sensor

    @property
    def name(self) -> str:
        return self.folder.name


@dataclass(frozen=True, eq=False)
class _Rig:
    """A camera of a sequence."""

    sequence: _Sequence
    camera: _Sensor

    @property
    def name(self) -> str:
        return self.camera.folder.name

    @cached_property
    def mounting(self) -> tuple[Float, tuple[str, ...]]:
        """Mean camera_from_lidar (4, 4) over all images for which the LiDAR has a pose, and a remark."""
        from scipy.spatial.transform import Rotation

        lidar = self.sequence.lidar.path
        extrinsics = []
        for time_ns, pose in zip(self.camera.path.time_ns.tolist(), self.camera.poses, strict=True):
            try:
                extrinsics.append(se3.inverse(pose) @ lidar.at(time_ns))
            except InputError:
                continue
        if not extrinsics:
            raise InputError("no image has a pose of the LiDAR near", where=self.camera.folder / "timestamps.json")
        poses = np.array(extrinsics)
        mean = se3.make(Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix(), poses[:, :3, 3].mean(axis=0))
        errors = [se3.inverse(mean) @ pose for pose in poses]
        angle_deg, shift_m = (max(map(measure, errors)) for measure in (se3.angle_deg, se3.distance_m))
        remark: tuple[str, ...] = ()
        if angle_deg > _LOOSE_DEG or shift_m > _LOOSE_M:
            what = f"{self.sequence.name}/{self.name}: the relative pose of camera and LiDAR"
            remark = (f"{what} varies by up to {angle_deg:.2f} deg and {shift_m:.3f} m; its mean is used",)
        return mean, remark


def build(options: PandasetOptions) -> Dataset:
    """Return the frames of the selected sequences and cameras; names are "sequence/camera/frame".

    Frames without a sweep are listed in `skipped`. Raises InputError without sequences or frames, and UnknownNameError
    for unknown sequences and cameras.
    """
    root = existing_folder(options.root, "PandaSet").resolve()
    cameras = chosen("camera", options.cameras, CAMERAS)
    frames = Listed()
    folders = "folders such as 001 with camera and lidar"
    for folder in drives_in(root, "sequence", "PandaSet", options.sequences, _is_sequence, folders):
        sequence = _Sequence(folder, _Sensor(folder / "lidar"))
        for camera in cameras:
            rig = _Rig(sequence, _Sensor(folder / "camera" / camera))
            for image in _images(rig.camera.folder):
                name, sweep = f"{sequence.name}/{camera}/{image.stem}", sequence.lidar.file(image.stem, _SUFFIXES)
                reason = "" if sweep else f"{sequence.lidar.folder / image.stem}.pkl.gz is missing"
                frames.add(name, (rig, image.stem, image, sweep), reason)
    expected = f"images in camera/{cameras[0]} and sweeps in lidar"
    got = "sequences without such images"
    return frames.lazy("PandaSet", root, partial(_read, options), expected=expected, got=got)


def _is_sequence(folder: Path) -> bool:
    return os.path.isdir(folder / "camera") and os.path.isdir(folder / "lidar")


def _images(folder: Path) -> list[Path]:
    inside = listing(folder, "PandaSet") if os.path.isdir(folder) else []
    return [path for path in inside if path.suffix == ".jpg" and is_number(path.stem)]


def _read(options: PandasetOptions, entry: tuple[_Rig, str, Path, Path]) -> Frame:
    rig, number, image_path, sweep_path = entry
    sequence = rig.sequence
    lidar = sequence.lidar.path
    image_ns, _ = _at(rig.camera, int(number))
    sweep_ns, _ = _at(sequence.lidar, int(number))
    image, warnings = read_image(image_path, partial(rectified_camera, rig.camera.projection))
    mounting, remark = rig.mounting
    now = lidar.at(image_ns)
    moment_ns = image_ns if options.moved else sweep_ns
    cloud, cloud_warnings, span_ns = _sweep(options, sweep_path, moment_ns)
    cloud = moved_cloud(cloud, se3.inverse(lidar.at(moment_ns)))
    # Without a long enough time span or poses for it, the velocity is unknown, and times would mark the sweep as raw.
    known = span_ns is not None and span_ns[1] - span_ns[0] >= _SECOND // 1000
    twist = lidar.twist_or_none(*span_ns) if known and span_ns is not None else None
    cloud = replace(cloud, time_s=None) if twist is None or cloud.time_s is None else replace(cloud, twist=twist)
    name, time_s = f"{sequence.name}/{rig.name}/{number}", (image_ns - int(lidar.time_ns[0])) / _SECOND
    return rig_frame(name, time_s, image, cloud, mounting, now, *warnings, *cloud_warnings, *remark, twist=twist)


def _at(sensor: _Sensor, frame: int) -> tuple[int, Float]:
    """Return time stamp and pose of a frame."""
    path = sensor.path
    if frame >= len(path.time_ns):
        where = sensor.folder / "poses.json"
        got = len(path.time_ns)
        raise InputError("there is no pose of the frame", where=where, expected=f"more than {frame} poses", got=got)
    return int(path.time_ns[frame]), path.world_from_body[frame]


def _sweep(
    options: PandasetOptions, path: Path, moment_ns: int
) -> tuple[Cloud, tuple[str, ...], tuple[int, int] | None]:
    """Return the points of the selected LiDAR in the world, times in s after `moment_ns`, warnings, and time span."""
    table = read_pickled_table(path, "sweep", _COLUMNS)
    if options.lidar != "both":
        wanted = table["d"] == (0 if options.lidar == "pandar64" else 1)
        if not wanted.any():
            fault = f"the sweep has no points of {options.lidar}"
            got = f"{len(wanted)} points of other LiDARs"
            raise InputError(fault, where=path, expected="column d: 0 for pandar64, 1 for pandargt", got=got)
        table = {name: values[wanted] for name, values in table.items()}
    times = table["t"].astype(np.float64)
    good = bool(np.isfinite(times).all() and (np.abs(times) < _LATEST_S).all())
    fields = {axis: table[axis] for axis in "xyz"} | {"intensity": table["i"]}
    # Subtract first: seconds since 1970 leave too few digits for differences.
    fields |= {"time_s": times - moment_ns / _SECOND} if good else {}
    cloud, warnings = cloud_from_fields(fields, path)
    span = (round(times.min() * _SECOND), round(times.max() * _SECOND)) if good else None
    return cloud, warnings, span


def _number(record: Any, key: str, path: Path) -> float:
    return finite_number(record.get(key) if isinstance(record, Mapping) else None, key, path)


METHOD = Method(
    name="pandaset",
    build=build,
    options=PandasetOptions,
    summary="PandaSet: six cameras, the Pandar64 and the PandarGT; its pickles are read without executing them.",
    gives=frozenset({"intensity", "time"}),
    cite="Xiao et al.: PandaSet: advanced sensor suite dataset for autonomous driving. ITSC 2021",
    recognises=layout("lidar/poses.json", "*/lidar/poses.json"),
)
