"""Read the Argoverse 2 sensor data set from its Feather files: nine cameras and two stacked LiDARs.

The format follows the public code (argoverse/av2-api, src/av2/structures/sweep.py, geometry/camera/pinhole_camera.py,
datasets/sensor/av2_sensor_dataloader.py and utils/io.py). A sweep contains the points of both LiDARs in the vehicle's
frame (x forward, y left, z up), motion-compensated to its time stamp, the start of the sweep; `offset_ns` is relative
to this stamp. Cameras have optical frames. Their images are undistorted, so that k1, k2, k3 of the table do not apply.

The files do not state which laser belongs to which LiDAR: numbers below 32 belong to one, all others to the second.
As in NVIDIA's converter (NVIDIA/ncore, tools/data_converter/argoverse2/README.md), the assignment is derived from the
rings: each ring has a constant elevation in the frame of its own LiDAR only.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from p2o import Bool, Camera, Cloud, Dataset, Float, Frame, InputError, Int, Method, Options, field, se3
from p2o.reading import existing_folder, layout, listing, naming

from p2o_datasets.arrow_file import read_feather
from p2o_datasets.cloud_file import cloud_from_fields
from p2o_datasets.ego_path import EgoPath, moved_cloud, nearest, pose_rows
from p2o_datasets.kitti_folder import is_number
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, drives_in, read_image, rig_frame

RING_CAMERAS = ("front_center", "front_left", "front_right", "side_left", "side_right", "rear_left", "rear_right")
CAMERAS = (*(f"ring_{name}" for name in RING_CAMERAS), "stereo_front_left", "stereo_front_right")
LIDARS = ("up_lidar", "down_lidar")
_BEAMS = 32
_SECOND = 1_000_000_000
_SWEEP_NS = 100_000_000
# Half of the interval between images, plus a margin of half of that between sweeps.
_SAME_MOMENT_NS = 55_000_000
_QUATERNION, _TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")
_POSE = dict.fromkeys((*_QUATERNION, *_TRANSLATION), "number")
_INTRINSICS = dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px"), "number")
_SWEEP = dict.fromkeys(("x", "y", "z", "intensity"), "number") | {"laser_number": "integer", "offset_ns": "integer"}
# Ranges used to assign lasers: nearer returns are from the vehicle itself, and farther ones vary less in elevation.
_ASSIGNMENT_RANGE_M = (4.0, 40.0)
_MIN_RETURNS = 20
# In the frame of the wrong LiDAR, elevations within a ring vary 2 to 10 times as much.
_MIN_RATIO = 1.2


class Argoverse2Options(Options):
    """Options of Argoverse 2."""

    root: Path = field(Path("."), help="Folder of logs, such as sensor/val, or of one log.")
    logs: Words = field((), help="Names of logs, separated by commas; default: all.")
    cameras: Words = cameras_field("ring_front_center", CAMERAS)
    lidar: Literal["up_lidar", "down_lidar", "both"] = field(
        "up_lidar", help="LiDAR whose points are used; `both` in the frame of up_lidar (down_lidar is 8 cm lower)."
    )
    between: bool = field(False, help="Pair every image with its nearest sweep, instead of the reverse.")
    moved: bool = field(True, help="Transform the sweep to the time of the image with the vehicle's poses.")


@dataclass(frozen=True, eq=False)
class _Log:
    """Folder and tables of a log; tables are read on first access."""

    folder: Path

    @cached_property
    def mounted(self) -> Mapping[str, Float]:
        """Poses ego_from_sensor (4, 4) by sensor name."""
        path = self.folder / "calibration" / "egovehicle_SE3_sensor.feather"
        table = read_feather(path, "table of extrinsics", {"sensor_name": "text", **_POSE})
        names = table["sensor_name"]
        return dict(zip(names, _poses(table, path, names), strict=True))

    @cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """Cameras by name."""
        path = self.folder / "calibration" / "intrinsics.feather"
        table = read_feather(path, "table of intrinsics", {"sensor_name": "text", **_INTRINSICS})
        rows = zip(*(table[key].tolist() for key in _INTRINSICS), strict=True)
        with naming(path):
            return {name: Camera.pinhole(*row) for name, row in zip(table["sensor_name"], rows, strict=True)}

    @cached_property
    def path(self) -> EgoPath:
        """Path of the vehicle in the frame of the city."""
        path = self.folder / "city_SE3_egovehicle.feather"
        table = read_feather(path, "table of poses", {"timestamp_ns": "integer", **_POSE})
        time_ns, first = np.unique(table["timestamp_ns"].astype(np.int64), return_index=True)
        return EgoPath(time_ns, _poses(table, path)[first], path)

    def sensor(self, name: str) -> Float:
        """Return ego_from_sensor (4, 4)."""
        if name not in self.mounted:
            where = self.folder / "calibration" / "egovehicle_SE3_sensor.feather"
            raise InputError("a sensor has no extrinsic", where=where, expected=name, got=", ".join(self.mounted)[:200])
        return self.mounted[name]


@dataclass(frozen=True, eq=False)
class _Pair:
    """Image and sweep, with time stamps in nanoseconds; `first_ns` is that of the log's first sweep."""

    log: _Log
    camera: str
    image_ns: int
    sweep_ns: int
    first_ns: int

    @property
    def name(self) -> str:
        return f"{self.log.folder.name}/{self.camera}/{self.image_ns}"

    @property
    def sweep(self) -> Path:
        return self.log.folder / "sensors" / "lidar" / f"{self.sweep_ns}.feather"


def build(options: Argoverse2Options) -> Dataset:
    """Return the frames of the selected logs and cameras; names are "log/camera/nanoseconds" of the image.

    Raises InputError if there are no logs or no frames, and UnknownNameError for unknown logs and cameras.
    """
    root = existing_folder(options.root, "Argoverse 2").resolve()
    tables = "folders with calibration, sensors and city_SE3_egovehicle.feather"
    logs = drives_in(root, "log", "Argoverse 2", options.logs, _is_log, tables)
    cameras = chosen("camera", options.cameras, CAMERAS)
    pairs = [pair for log in logs for camera in cameras for pair in _pairs(_Log(log), camera, options)]
    expected = f"images in sensors/cameras/{cameras[0]} and sweeps of their time in sensors/lidar"
    frames, got = Listed({pair.name: pair for pair in pairs}), f"none in {len(logs)} logs"
    return frames.lazy("Argoverse 2 frames", root, partial(_read, options), expected=expected, got=got)


def _is_log(folder: Path) -> bool:
    return os.path.isdir(folder / "calibration") and os.path.isdir(folder / "sensors")


def _pairs(log: _Log, camera: str, options: Argoverse2Options) -> list[_Pair]:
    """Return the pairs of a camera in temporal order, one per sweep or one per image."""
    images = _stamps(log.folder / "sensors" / "cameras" / camera, ".jpg")
    sweeps = _stamps(log.folder / "sensors" / "lidar", ".feather")
    if not len(images) or not len(sweeps):
        return []
    both = (images, sweeps[nearest(sweeps, images)]) if options.between else (images[nearest(images, sweeps)], sweeps)
    pairs = zip(*(side.tolist() for side in both), strict=True)
    near = [(image, sweep) for image, sweep in pairs if abs(image - sweep) <= _SAME_MOMENT_NS]
    return [_Pair(log, camera, image, sweep, int(sweeps[0])) for image, sweep in near]


def _stamps(folder: Path, suffix: str) -> Int:
    """Return the sorted time stamps (N,) of the file names; other files are ignored."""
    if not os.path.isdir(folder):
        return np.array([], np.int64)
    names = (path.name.removesuffix(suffix) for path in listing(folder, "Argoverse 2") if path.name.endswith(suffix))
    return np.array(sorted(int(name) for name in names if is_number(name) and len(name) < 19), np.int64)


def _read(options: Argoverse2Options, pair: _Pair) -> Frame:
    log = pair.log
    if pair.camera not in log.cameras:
        where, got = log.folder / "calibration" / "intrinsics.feather", ", ".join(log.cameras)[:200]
        raise InputError("a camera has no intrinsics", where=where, expected=pair.camera, got=got)
    camera = log.cameras[pair.camera]
    image, warnings = read_image(log.folder / "sensors" / "cameras" / pair.camera / f"{pair.image_ns}.jpg", camera)
    unit = LIDARS[0] if options.lidar == "both" else options.lidar
    ego_from_lidar = log.sensor(unit)
    cloud, cloud_warnings = _sweep(options, pair, se3.inverse(ego_from_lidar))
    path = log.path.fixed_to(ego_from_lidar)
    now = path.at(pair.image_ns)
    twist = path.twist_or_none(pair.sweep_ns, pair.sweep_ns + _SWEEP_NS)
    if options.moved:
        cloud = moved_cloud(cloud, se3.inverse(now) @ path.at(pair.sweep_ns))
    if twist is None or cloud.time_s is None:
        cloud = replace(cloud, time_s=None)
    else:
        later_s = (pair.sweep_ns - (pair.image_ns if options.moved else pair.sweep_ns)) / _SECOND
        cloud = replace(cloud, time_s=cloud.time_s + later_s, twist=twist)
    extrinsic = se3.inverse(log.sensor(pair.camera)) @ ego_from_lidar
    time_s, warnings = (pair.image_ns - pair.first_ns) / _SECOND, (*warnings, *cloud_warnings)
    return rig_frame(pair.name, time_s, image, cloud, extrinsic, now, *warnings, twist=twist)


def _sweep(options: Argoverse2Options, pair: _Pair, lidar_from_ego: Float) -> tuple[Cloud, tuple[str, ...]]:
    """Return the points of the selected LiDAR in its frame, with times in s after the sweep's stamp, and warnings."""
    table = read_feather(pair.sweep, "sweep", _SWEEP)
    for name, most in (("laser_number", 2 * _BEAMS - 1), ("offset_ns", 2 * _SWEEP_NS)):
        least, largest = (int(end(table[name], initial=0)) for end in (np.min, np.max))
        if least < 0 or largest > most:
            fault, got = f"{name} is out of range", f"{least} to {largest}"
            raise InputError(fault, where=pair.sweep, expected=f"0 to {most}", got=got)
    fields: dict[str, Any] = {key: table[key] for key in ("x", "y", "z", "intensity")}
    fields |= {"ring": table["laser_number"], "time_s": table["offset_ns"].astype(np.float64) / _SECOND}
    warnings: tuple[str, ...] = ()
    if options.lidar != "both":
        low = table["laser_number"] < _BEAMS
        is_up, remark = _low_is_up(pair, table, low)
        kept = low if is_up == (options.lidar == "up_lidar") else ~low
        if not kept.any():
            fault = f"the sweep has no points of {options.lidar}"
            raise InputError(fault, where=pair.sweep, expected="32 lasers each", got=f"{len(low)} points of the other")
        fields = {key: value[kept] for key, value in fields.items()}
        warnings = (remark,) if remark else ()
    cloud, remarks = cloud_from_fields(fields, pair.sweep)
    return moved_cloud(cloud, lidar_from_ego), (*warnings, *remarks)


def _low_is_up(pair: _Pair, table: Mapping[str, Any], low: Bool) -> tuple[bool, str]:
    """Return whether lasers below 32 belong to up_lidar, and a remark if the rings do not determine it."""
    xyz = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    up_from_ego, down_from_ego = (se3.inverse(pair.log.sensor(name)) for name in LIDARS)
    spread = [
        _ring_spread(se3.apply(low_from_ego, xyz[low]), table["laser_number"][low])
        + _ring_spread(se3.apply(high_from_ego, xyz[~low]), table["laser_number"][~low])
        for low_from_ego, high_from_ego in ((up_from_ego, down_from_ego), (down_from_ego, up_from_ego))
    ]
    if min(spread) * _MIN_RATIO > max(spread):
        return True, f"{pair.sweep.name}: the rings do not show which LiDAR has lasers 0 to 31; up_lidar is assumed"
    return spread[0] < spread[1], ""


def _ring_spread(xyz: Float, ring: Int) -> float:
    """Return the median deviation of elevations (rad) within a ring, averaged over the rings; 0 without rings."""
    near, far = _ASSIGNMENT_RANGE_M
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    used = (flat > near) & (flat < far)
    elevation, ring = np.arctan2(xyz[used, 2], flat[used]), ring[used]
    groups = (elevation[ring == number] for number in np.unique(ring))
    groups = (group for group in groups if len(group) >= _MIN_RETURNS)
    spreads = [float(np.median(np.abs(group - np.median(group)))) for group in groups]
    return float(np.mean(spreads)) if spreads else 0.0


def _poses(table: Mapping[str, Any], path: Path, names: Sequence[object] | None = None) -> Float:
    """Return the poses (N, 4, 4) of a table with quaternions w x y z and translations in metres."""
    xyzw, translation = (
        np.stack([table[key] for key in keys], axis=1) for keys in ((*_QUATERNION[1:], "qw"), _TRANSLATION)
    )
    return pose_rows(xyzw, translation, path, names)


METHOD = Method(
    name="argoverse2",
    build=build,
    options=Argoverse2Options,
    summary="Argoverse 2 (sensor data set): nine cameras and two stacked LiDARs, from its Feather files.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Wilson et al.: Argoverse 2: next generation datasets for self-driving perception. NeurIPS Datasets 2021",
    extra="arrow",
    recognises=layout("city_SE3_egovehicle.feather", "*/city_SE3_egovehicle.feather"),
)
