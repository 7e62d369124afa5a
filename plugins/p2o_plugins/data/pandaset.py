"""PandaSet: six cameras, the Pandar64 around and the PandarGT ahead, by JSON files and pickled tables of points.

The files as the public toolkit reads them (scaleapi/pandaset-devkit: python/pandaset/sensors.py, geometry.py, and its
test data): points lie in the world, corrected for motion point by point, with their time and the number of their LiDAR
(0 Pandar64, 1 PandarGT); poses are world_from_sensor, a heading (quaternion w x y z) and a position, one a frame;
cameras have optical frames and no distortion. Mountings are not among the files: here the mean over the sequence of
where the LiDAR is seen from the camera at the time of each image.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Camera, Cloud, Dataset, Frame, Image, InputError, Method, Options, field, se3
from p2o.arrays import Float, Int
from p2o.files.input_file import existing_folder, listing, naming, read_text
from p2o.files.parsed_text import parse_json
from p2o.formats.kitti_calibration import rectified_camera

from p2o_plugins.data.cloud_file import cloud_from_fields
from p2o_plugins.data.ego_path import EgoPath, moved_cloud
from p2o_plugins.data.image_file import read_rgb
from p2o_plugins.data.kitti_folder import is_number
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.pickled_table import read_pickled_table
from p2o_plugins.data.pose_rows import pose_rows

CAMERAS = tuple(f"{place}_camera" for place in ("front", "front_left", "front_right", "left", "right", "back"))
_SUFFIXES = (".pkl.gz", ".pkl")
_COLUMNS = ("x", "y", "z", "i", "t", "d")
_SECOND = 1_000_000_000
_LATEST_S = 9e9
# Beyond these the mean over the frames is no mounting.
_LOOSE_DEG, _LOOSE_M = 0.5, 0.05


class PandasetOptions(Options):
    """Options of PandaSet."""

    root: Path = field(Path("."), help="Folder of sequences, or of one sequence.")
    sequences: Words = field((), help="Names of sequences, joined by commas, such as 001; none: all.")
    cameras: Words = field(
        ("front_camera",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}."
    )
    lidar: Literal["pandar64", "pandargt", "both"] = field("pandar64", help="Whose points.")
    moved: bool = field(
        True, help="Move the sweep to the moment of the image by the LiDAR's poses; else it stays where it was."
    )


@dataclass(frozen=True, eq=False)
class _Sensor:
    """The folder of a sensor, and its files, read when they are asked for: a stamp and a pose a frame."""

    folder: Path

    @cached_property
    def time_ns(self) -> Int:
        """The stamps of the frames (N,) in nanoseconds."""
        path = self.folder / "timestamps.json"
        said = parse_json(read_text(path, "file of time stamps"), "file of time stamps", path)
        times: list[Any] = said if isinstance(said, list) else [None]
        numbers = all(isinstance(time, int | float) and not isinstance(time, bool) for time in times)
        if not numbers or not all(abs(time) < _LATEST_S for time in times):
            raise InputError("this is no list of time stamps", where=path, expected="seconds", got=str(said)[:60])
        return np.array([round(time * _SECOND) for time in times], np.int64)

    @cached_property
    def poses(self) -> Float:
        """World_from_sensor (N, 4, 4) of the frames."""
        path = self.folder / "poses.json"
        said = parse_json(read_text(path, "file of poses"), "file of poses", path)
        records = said if isinstance(said, list) else [None]
        rows = [
            [_part(record, group, axis, path) for group, axis in _POSE] if isinstance(record, Mapping) else None
            for record in records
        ]
        if None in rows:
            raise InputError(
                "this is no list of poses", where=path, expected="heading and position", got=str(said)[:60]
            )
        numbers = np.array(rows, np.float64).reshape(-1, 7)
        return pose_rows(numbers[:, :4], numbers[:, 4:], path, [f"frame {row}" for row in range(len(rows))])

    @cached_property
    def path(self) -> EgoPath:
        """The way of the sensor."""
        where = self.folder / "poses.json"
        if len(self.poses) != len(self.time_ns):
            raise InputError(
                "poses and time stamps are of different numbers",
                where=where,
                expected=f"{len(self.time_ns)} poses",
                got=len(self.poses),
            )
        return EgoPath(self.time_ns, self.poses, where)

    @cached_property
    def lens(self) -> tuple[float, float, float, float]:
        """Focal lengths and principal point of a camera in px."""
        path = self.folder / "intrinsics.json"
        said = parse_json(read_text(path, "file of intrinsics"), "file of intrinsics", path)
        fx, fy, cx, cy = (_number(said, key, path) for key in ("fx", "fy", "cx", "cy"))
        return fx, fy, cx, cy

    def file(self, frame: str, suffixes: Sequence[str]) -> Path | None:
        """Return the file of a frame, None where there is none."""
        return next((path for end in suffixes if os.path.isfile(path := self.folder / (frame + end))), None)


_POSE = (*(("heading", axis) for axis in "xyzw"), *(("position", axis) for axis in "xyz"))


@dataclass(frozen=True, eq=False)
class _Sequence:
    """A sequence: its folder and its LiDARs, which have one pose in common."""

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
        """camera_from_lidar (4, 4), the mean over all images that poses of the LiDAR reach, and a remark."""
        from scipy.spatial.transform import Rotation

        lidar = self.sequence.lidar.path
        seen = []
        for time_ns, pose in zip(self.camera.path.time_ns.tolist(), self.camera.poses, strict=True):
            try:
                seen.append(se3.inverse(pose) @ lidar.at(time_ns))
            except InputError:
                continue
        if not seen:
            raise InputError("no image has a pose of the LiDAR near", where=self.camera.folder / "timestamps.json")
        poses = np.array(seen)
        mean = se3.make(Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix(), poses[:, :3, 3].mean(axis=0))
        off = [se3.inverse(mean) @ pose for pose in poses]
        turned, away = max(se3.angle_deg(pose) for pose in off), max(se3.distance_m(pose) for pose in off)
        remark: tuple[str, ...] = ()
        if turned > _LOOSE_DEG or away > _LOOSE_M:
            remark = (
                f"{self.sequence.name}/{self.name}: the poses of camera and LiDAR are not fixed to each other: up to "
                f"{turned:.2f} deg and {away:.3f} m from the mean, which is taken",
            )
        return mean, remark


def build(options: PandasetOptions) -> Dataset:
    """Return the frames of the chosen sequences and cameras; names are "sequence/camera/frame".

    Frames whose sweep is missing are listed in `skipped`.

    Raises InputError where the folder is missing or holds no sequences, for names of sequences and cameras that are not
    there, and where no frame is left.
    """
    root = existing_folder(options.root, "PandaSet").resolve()
    cameras = chosen("camera", options.cameras, CAMERAS)
    entries: dict[str, tuple[_Rig, str, Path, Path]] = {}
    skipped: dict[str, str] = {}
    for folder in _folders(root, options.sequences):
        sequence = _Sequence(folder, _Sensor(folder / "lidar"))
        for camera in cameras:
            rig = _Rig(sequence, _Sensor(folder / "camera" / camera))
            for image in _images(rig.camera.folder):
                name, sweep = f"{sequence.name}/{camera}/{image.stem}", sequence.lidar.file(image.stem, _SUFFIXES)
                if sweep is None:
                    skipped[name] = f"{sequence.lidar.folder / image.stem}.pkl.gz is missing"
                else:
                    entries[name] = (rig, image.stem, image, sweep)
    if not entries:
        raise InputError(
            "no PandaSet frames",
            where=root,
            expected=f"images in camera/{cameras[0]} and sweeps in lidar",
            got=next(iter(skipped.values()), "sequences without such images"),
        )
    return LazyFrames(entries, partial(_read, options), skipped)


def _folders(root: Path, wanted: Sequence[str]) -> list[Path]:
    if _is_sequence(root):
        chosen("sequence", wanted, (root.name,), where=root.parent)
        return [root]
    found = {folder.name: folder for folder in listing(root, "PandaSet") if _is_sequence(folder)}
    if not found:
        raise InputError(
            "there are no sequences of PandaSet",
            where=root,
            expected="folders such as 001 with camera and lidar",
            got=", ".join(path.name for path in listing(root, "PandaSet")[:8]) or "an empty folder",
        )
    return [found[name] for name in chosen("sequence", wanted, found, where=root)]


def _is_sequence(folder: Path) -> bool:
    return os.path.isdir(folder / "camera") and os.path.isdir(folder / "lidar")


def _images(folder: Path) -> list[Path]:
    if not os.path.isdir(folder):
        return []
    return [path for path in listing(folder, "PandaSet") if path.suffix == ".jpg" and is_number(path.stem)]


def _read(options: PandasetOptions, entry: tuple[_Rig, str, Path, Path]) -> Frame:
    rig, number, image_path, sweep_path = entry
    sequence = rig.sequence
    lidar = sequence.lidar.path
    image_ns, _ = _at(rig.camera, int(number))
    sweep_ns, _ = _at(sequence.lidar, int(number))
    rgb, warnings = read_rgb(image_path)
    camera = _camera(rig.camera, rgb.shape[1], rgb.shape[0], image_path)
    with naming(image_path):
        image = Image(rgb, camera)
    mounting, remark = rig.mounting
    now = lidar.at(image_ns)
    moment_ns = image_ns if options.moved else sweep_ns
    cloud, cloud_warnings, span_ns = _sweep(options, sweep_path, moment_ns)
    cloud = moved_cloud(cloud, se3.inverse(lidar.at(moment_ns)))
    twist = _twist(lidar, span_ns)
    # Times without the velocity would say that the sweep is raw.
    cloud = replace(cloud, time_s=None) if twist is None or cloud.time_s is None else replace(cloud, twist=twist)
    return Frame(
        f"{sequence.name}/{rig.name}/{number}",
        image,
        cloud,
        camera_from_lidar=mounting,
        twist=twist,
        warnings=(*warnings, *cloud_warnings, *remark),
        sequence=sequence.name,
        time_s=(image_ns - int(lidar.time_ns[0])) / _SECOND,
        # No pose of the camera: it would be this one and the truth.
        lidar_world_from_lidar=now,
        camera_name=rig.name,
    )


def _at(sensor: _Sensor, frame: int) -> tuple[int, Float]:
    """Return stamp and pose of a frame."""
    path = sensor.path
    if frame >= len(path.time_ns):
        raise InputError(
            "there is no pose of the frame",
            where=sensor.folder / "poses.json",
            expected=f"more than {frame} poses",
            got=len(path.time_ns),
        )
    return int(path.time_ns[frame]), path.world_from_body[frame]


def _camera(sensor: _Sensor, width: int, height: int, image: Path) -> Camera:
    fx, fy, cx, cy = sensor.lens
    with naming(image):
        return rectified_camera(np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]]), width, height)


def _sweep(
    options: PandasetOptions, path: Path, moment_ns: int
) -> tuple[Cloud, tuple[str, ...], tuple[int, int] | None]:
    """Return the points of the chosen LiDAR in the world, seconds from a moment, warnings, and from when to when."""
    table = read_pickled_table(path, "sweep", _COLUMNS)
    if options.lidar != "both":
        wanted = table["d"] == (0 if options.lidar == "pandar64" else 1)
        if not wanted.any():
            raise InputError(
                f"the sweep has no points of {options.lidar}",
                where=path,
                expected="column d: 0 for pandar64, 1 for pandargt",
                got=f"{len(wanted)} points of others",
            )
        table = {name: values[wanted] for name, values in table.items()}
    times = table["t"].astype(np.float64)
    good = bool(np.isfinite(times).all() and (np.abs(times) < _LATEST_S).all())
    fields = {axis: table[axis] for axis in "xyz"} | {"intensity": table["i"]}
    # Differences first: nanoseconds since 1970 have more digits than a double.
    fields |= {"time_s": times - moment_ns / _SECOND} if good else {}
    cloud, warnings = cloud_from_fields(fields, path)
    span = (round(times.min() * _SECOND), round(times.max() * _SECOND)) if good else None
    return cloud, warnings, span


def _twist(path: EgoPath, span_ns: tuple[int, int] | None) -> Float | None:
    """Return the velocity (6,) between two times, None where they are one or the poses do not reach."""
    if span_ns is None or span_ns[1] - span_ns[0] < _SECOND // 1000:
        return None
    try:
        return path.twist(*span_ns)
    except InputError:
        return None


def _part(record: Mapping[str, Any], group: str, axis: str, path: Path) -> float:
    return _number(record.get(group), axis, path)


def _number(record: Any, key: str, path: Path) -> float:
    value = record.get(key) if isinstance(record, Mapping) else None
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e300:
        raise InputError(f"{key} is no number", where=path, expected="a finite number", got=str(value)[:40])
    return float(value)


METHOD = Method(
    name="pandaset",
    build=build,
    options=PandasetOptions,
    summary="PandaSet: six cameras, the Pandar64 and the PandarGT; its pickles are read without running them.",
    gives=frozenset({"intensity", "time"}),
    cite="Xiao et al.: PandaSet: advanced sensor suite dataset for autonomous driving. ITSC 2021",
)
