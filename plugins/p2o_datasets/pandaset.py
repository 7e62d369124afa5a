"""Read PandaSet: six cameras, the rotating Pandar64 and the front PandarGT, from JSON files and pickled tables.

The format follows the public toolkit (scaleapi/pandaset-devkit: python/pandaset/sensors.py, geometry.py, and its test
data). Points are in world coordinates, each compensated for motion, with their time and the number of their LiDAR
(0 Pandar64, 1 PandarGT). Poses are world_from_sensor, a heading (quaternion w x y z) and a position, one per frame.
Cameras have optical frames and no distortion. The files contain no extrinsics: they are computed as the mean over the
sequence of the pose of the LiDAR relative to the camera at the times of the images.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Cloud, Dataset, Float, Frame, InputError, Int, Method, Options, field, se3
from p2o.reading import existing_folder, layout, listing, parse_json, read_text
from p2o_formats.kitti_calibration import rectified_camera

from p2o_datasets import lazy_dataset
from p2o_datasets.cloud_file import cloud_from_fields
from p2o_datasets.ego_path import EgoPath, moved_cloud, pose_rows
from p2o_datasets.kitti_folder import is_number
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, drives_in, finite_number, rig_frame
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

    def _content(self, name: str, what: str) -> tuple[Path, Any]:
        """Return the path and the content of a JSON file."""
        path = self.folder / name
        return path, parse_json(read_text(path, what), what, path)

    @cached_property
    def time_ns(self) -> Int:
        """Time stamps of the frames (N,) in nanoseconds."""
        path, content = self._content("timestamps.json", "file of time stamps")
        times: list[Any] = content if isinstance(content, list) else [None]
        numbers = all(isinstance(time, int | float) and not isinstance(time, bool) for time in times)
        if not numbers or not all(abs(time) < _LATEST_S for time in times):
            raise InputError("the file is not a list of times", where=path, expected="seconds", got=str(content)[:60])
        return np.array([round(time * _SECOND) for time in times], np.int64)

    @cached_property
    def poses(self) -> Float:
        """Poses world_from_sensor (N, 4, 4) of the frames."""
        path, content = self._content("poses.json", "file of poses")
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

    def time_of(self, frame: int) -> int:
        """Return the time stamp of a frame in nanoseconds; raises InputError without a pose of the frame."""
        if frame >= (got := len(self.path.time_ns)):
            fault, where = "there is no pose of the frame", self.folder / "poses.json"
            raise InputError(fault, where=where, expected=f"more than {frame} poses", got=got)
        return int(self.time_ns[frame])

    @cached_property
    def projection(self) -> Float:
        """Projection (3, 4) of a camera, in px."""
        path, content = self._content("intrinsics.json", "file of intrinsics")
        fx, fy, cx, cy = (_number(content, key, path) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]])


_POSE = (*(("heading", axis) for axis in "xyzw"), *(("position", axis) for axis in "xyz"))


@dataclass(frozen=True, eq=False)
class _Rig:
    """A camera of a sequence, with its name "sequence/camera", and the LiDARs, which share one pose."""

    name: str
    camera: _Sensor
    lidar: _Sensor

    @cached_property
    def mounting(self) -> tuple[Float, tuple[str, ...]]:
        """Mean camera_from_lidar (4, 4) over all images for which the LiDAR has a pose, and a remark."""
        from scipy.spatial.transform import Rotation

        extrinsics = []
        for time_ns, pose in zip(self.camera.path.time_ns.tolist(), self.camera.poses, strict=True):
            try:
                extrinsics.append(se3.inverse(pose) @ self.lidar.path.at(time_ns))
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
            what = "the relative pose of camera and LiDAR"
            remark = (f"{self.name}: {what} varies by up to {angle_deg:.2f} deg and {shift_m:.3f} m; its mean is used",)
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
        lidar = _Sensor(folder / "lidar")
        for camera in cameras:
            rig = _Rig(f"{folder.name}/{camera}", _Sensor(folder / "camera" / camera), lidar)
            inside = listing(rig.camera.folder, "PandaSet") if os.path.isdir(rig.camera.folder) else []
            for image in (path for path in inside if path.suffix == ".jpg" and is_number(path.stem)):
                paths = (lidar.folder / (image.stem + suffix) for suffix in _SUFFIXES)
                sweep = next(filter(os.path.isfile, paths), None)
                reason = "" if sweep else f"{lidar.folder / image.stem}.pkl.gz is missing"
                frames.add(f"{rig.name}/{image.stem}", (rig, image.stem, image, sweep), reason)
    expected, got = f"images in camera/{cameras[0]} and sweeps in lidar", "sequences without such images"
    return frames.lazy("PandaSet frames", root, partial(_read, options), expected=expected, got=got)


def _is_sequence(folder: Path) -> bool:
    return os.path.isdir(folder / "camera") and os.path.isdir(folder / "lidar")


def _read(options: PandasetOptions, entry: tuple[_Rig, str, Path, Path]) -> Frame:
    rig, number, image_path, sweep_path = entry
    lidar = rig.lidar.path
    image_ns, sweep_ns = (sensor.time_of(int(number)) for sensor in (rig.camera, rig.lidar))
    image, warnings = lazy_dataset.read_image(image_path, partial(rectified_camera, rig.camera.projection))
    mounting, remark = rig.mounting
    now = lidar.at(image_ns)
    moment_ns = image_ns if options.moved else sweep_ns
    cloud, cloud_warnings, span_ns = _sweep(options, sweep_path, moment_ns)
    cloud = moved_cloud(cloud, se3.inverse(lidar.at(moment_ns)))
    # Without a long enough time span or poses for it, the velocity is unknown, and times would mark the sweep as raw.
    known = span_ns is not None and span_ns[1] - span_ns[0] >= _SECOND // 1000
    twist = lidar.twist_or_none(*span_ns) if known and span_ns is not None else None
    cloud = replace(cloud, time_s=None) if twist is None or cloud.time_s is None else replace(cloud, twist=twist)
    name, time_s = f"{rig.name}/{number}", (image_ns - int(lidar.time_ns[0])) / _SECOND
    return rig_frame(name, time_s, image, cloud, mounting, now, *warnings, *cloud_warnings, *remark, twist=twist)


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
