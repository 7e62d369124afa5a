"""Argoverse 2, the sensor data set, by its Feather files: nine cameras and two LiDARs on top of each other.

The files as the public code reads them (argoverse/av2-api, src/av2/structures/sweep.py, geometry/camera/
pinhole_camera.py, datasets/sensor/av2_sensor_dataloader.py and utils/io.py): a sweep joins both LiDARs, lies in the
frame of the car (x forward, y left, z up), and is corrected for ego-motion to its own time stamp, the start of the
sweep, from which `offset_ns` counts. Cameras have optical frames and, as their pictures are undistorted, no distortion:
k1, k2, k3 of the table are those of the lens before.

Which laser is of which LiDAR is written nowhere: laser numbers below 32 are of the one, those from 32 on of the other.
Rings tell, as in NVIDIA's converter (NVIDIA/ncore, tools/data_converter/argoverse2/README.md): each has one elevation
in the frame of its own LiDAR, and scatters in that of the other.
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
from p2o.arrays import Bool, Float, Int
from p2o.files.input_file import existing_folder, listing, naming

from p2o_plugins.data.arrow_file import read_feather
from p2o_plugins.data.cloud_file import cloud_from_fields
from p2o_plugins.data.ego_path import EgoPath, moved_cloud, now_from_then
from p2o_plugins.data.image_file import read_rgb
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.pose_rows import pose_rows
from p2o_plugins.data.time_pairs import nearest

RING_CAMERAS = ("front_center", "front_left", "front_right", "side_left", "side_right", "rear_left", "rear_right")
CAMERAS = (*(f"ring_{name}" for name in RING_CAMERAS), "stereo_front_left", "stereo_front_right")
LIDARS = ("up_lidar", "down_lidar")
_BEAMS = 32
_SECOND = 1_000_000_000
_SWEEP_NS = 100_000_000
# Half of the time between images, and half of that between sweeps.
_SAME_MOMENT_NS = 55_000_000
_QUATERNION, _TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")
_POSE = dict.fromkeys((*_QUATERNION, *_TRANSLATION), "number")
_INTRINSICS = dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px"), "number")
_SWEEP = dict.fromkeys(("x", "y", "z", "intensity", "laser_number", "offset_ns"), "number")
# Returns so far away tell whose ring they are: nearer ones are of the car itself, farther ones scatter less.
_TELLING_M = (4.0, 40.0)
_FEWEST = 20
# The wrong LiDAR's rings scatter 2 to 10 times as much.
_CLEARLY = 1.2


class Argoverse2Options(Options):
    """Options of Argoverse 2."""

    root: Path = field(Path("."), help="Folder of logs, such as sensor/val, or of one log.")
    logs: Words = field((), help="Names of logs, joined by commas; none: all.")
    cameras: Words = field(
        ("ring_front_center",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}."
    )
    lidar: Literal["up_lidar", "down_lidar", "both"] = field(
        "up_lidar", help="Whose points; both lie in the frame of up_lidar, where those of down_lidar start 8 cm lower."
    )
    between: bool = field(
        False, help="Take every image with its nearest sweep, not every sweep with its nearest image."
    )
    moved: bool = field(
        True, help="Move the sweep to the moment of the image by the car's poses; else it stays where it was."
    )


@dataclass(frozen=True, eq=False)
class _Log:
    """A log's folder, and its tables, which are read when they are asked for."""

    folder: Path

    @cached_property
    def mounted(self) -> Mapping[str, Float]:
        """The poses ego_from_sensor (4, 4) by the names of sensors."""
        path = self.folder / "calibration" / "egovehicle_SE3_sensor.feather"
        table = read_feather(path, "table of mountings", {"sensor_name": "text", **_POSE})
        names = table["sensor_name"]
        return dict(zip(names, _poses(table, path, names), strict=True))

    @cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """The cameras by their names."""
        path = self.folder / "calibration" / "intrinsics.feather"
        table = read_feather(path, "table of intrinsics", {"sensor_name": "text", **_INTRINSICS})
        with naming(path):
            return {
                name: Camera.pinhole(fx, fy, cx, cy, width, height)
                for name, fx, fy, cx, cy, width, height in zip(
                    table["sensor_name"], *(table[key].tolist() for key in _INTRINSICS), strict=True
                )
            }

    @cached_property
    def path(self) -> EgoPath:
        """The way of the car in the city."""
        path = self.folder / "city_SE3_egovehicle.feather"
        table = read_feather(path, "table of poses", {"timestamp_ns": "number", **_POSE})
        time_ns, first = np.unique(table["timestamp_ns"].astype(np.int64), return_index=True)
        return EgoPath(time_ns, _poses(table, path)[first], path)

    def sensor(self, name: str) -> Float:
        """Return ego_from_sensor (4, 4)."""
        if name not in self.mounted:
            raise InputError(
                "a sensor has no mounting",
                where=self.folder / "calibration" / "egovehicle_SE3_sensor.feather",
                expected=name,
                got=", ".join(self.mounted)[:200],
            )
        return self.mounted[name]


@dataclass(frozen=True, eq=False)
class _Pair:
    """An image and its sweep, by their stamps in nanoseconds; `first_ns` is that of the log's first sweep."""

    log: _Log
    camera: str
    image_ns: int
    sweep_ns: int
    first_ns: int

    @property
    def name(self) -> str:
        return f"{self.log.folder.name}/{self.camera}/{self.image_ns}"

    @property
    def image(self) -> Path:
        return self.log.folder / "sensors" / "cameras" / self.camera / f"{self.image_ns}.jpg"

    @property
    def sweep(self) -> Path:
        return self.log.folder / "sensors" / "lidar" / f"{self.sweep_ns}.feather"


def build(options: Argoverse2Options) -> Dataset:
    """Return the frames of the chosen logs and cameras; names are "log/camera/nanoseconds", by the image's stamp.

    Raises InputError where the folder is missing or holds no logs, for names of logs and cameras that are not there,
    and where no frame is left.
    """
    root = existing_folder(options.root, "Argoverse 2").resolve()
    logs = _logs(root, options.logs)
    cameras = chosen("camera", options.cameras, CAMERAS)
    pairs = [pair for log in logs for camera in cameras for pair in _pairs(_Log(log), camera, options)]
    if not pairs:
        raise InputError(
            "no Argoverse 2 frames",
            where=root,
            expected=f"images in sensors/cameras/{cameras[0]} and sweeps of their time in sensors/lidar",
            got=f"none in {len(logs)} logs",
        )
    return LazyFrames({pair.name: pair for pair in pairs}, partial(_read, options))


def _logs(root: Path, wanted: Sequence[str]) -> list[Path]:
    if _is_log(root):
        chosen("log", wanted, (root.name,), where=root.parent)
        return [root]
    folders = [folder for folder in listing(root, "Argoverse 2") if folder.is_dir()]
    found = {folder.name: folder for folder in folders if _is_log(folder)}
    if not found:
        below = [folder.name for folder in folders if any(_is_log(log) for log in listing(folder, "Argoverse 2")[:20])]
        raise InputError(
            "there are no logs of Argoverse 2",
            where=root,
            expected="folders with calibration, sensors and city_SE3_egovehicle.feather",
            got=", ".join(folder.name for folder in folders[:8]) or "no folders",
            hint=f"name the folder of logs: {root / below[0]}" if below else None,
        )
    return [found[name] for name in chosen("log", wanted, found, where=root)]


def _is_log(folder: Path) -> bool:
    return os.path.isdir(folder / "calibration") and os.path.isdir(folder / "sensors")


def _pairs(log: _Log, camera: str, options: Argoverse2Options) -> list[_Pair]:
    """Return the pairs of a camera in the order of time: one a sweep, or one an image."""
    images = _stamps(log.folder / "sensors" / "cameras" / camera, ".jpg")
    sweeps = _stamps(log.folder / "sensors" / "lidar", ".feather")
    if not len(images) or not len(sweeps):
        return []
    both = (images, sweeps[nearest(sweeps, images)]) if options.between else (images[nearest(images, sweeps)], sweeps)
    return [
        _Pair(log, camera, image, sweep, int(sweeps[0]))
        for image, sweep in zip(*(side.tolist() for side in both), strict=True)
        if abs(image - sweep) <= _SAME_MOMENT_NS
    ]


def _stamps(folder: Path, suffix: str) -> Int:
    """Return the stamps (N,) that names of files say, in order; other files are passed by."""
    if not os.path.isdir(folder):
        return np.array([], np.int64)
    names = (path.name.removesuffix(suffix) for path in listing(folder, "Argoverse 2") if path.name.endswith(suffix))
    return np.array(
        sorted(int(name) for name in names if name.isascii() and name.isdigit() and len(name) < 19), np.int64
    )


def _read(options: Argoverse2Options, pair: _Pair) -> Frame:
    log = pair.log
    if pair.camera not in log.cameras:
        raise InputError(
            "a camera has no intrinsics",
            where=log.folder / "calibration" / "intrinsics.feather",
            expected=pair.camera,
            got=", ".join(log.cameras)[:200],
        )
    camera = log.cameras[pair.camera]
    rgb, warnings = read_rgb(pair.image, (camera.width, camera.height))
    with naming(pair.image):
        image = Image(rgb, camera)
    unit = LIDARS[0] if options.lidar == "both" else options.lidar
    ego_from_lidar = log.sensor(unit)
    cloud, cloud_warnings = _sweep(options, pair, se3.inverse(ego_from_lidar))
    path = log.path.fixed_to(ego_from_lidar)
    now = path.at(pair.image_ns)
    twist = _twist(path, pair.sweep_ns)
    if options.moved:
        cloud = moved_cloud(cloud, now_from_then(now, path.at(pair.sweep_ns)))
    if twist is None or cloud.time_s is None:
        cloud = replace(cloud, time_s=None)
    else:
        moment_ns = pair.image_ns if options.moved else pair.sweep_ns
        later_s = (pair.sweep_ns - moment_ns) / _SECOND
        cloud = replace(cloud, time_s=cloud.time_s + later_s, twist=twist)
    return Frame(
        pair.name,
        image,
        cloud,
        camera_from_lidar=se3.inverse(log.sensor(pair.camera)) @ ego_from_lidar,
        twist=twist,
        warnings=(*warnings, *cloud_warnings),
        sequence=log.folder.name,
        time_s=(pair.image_ns - pair.first_ns) / _SECOND,
        # No pose of the camera: it would be this one and the truth.
        lidar_world_from_lidar=now,
        camera_name=pair.camera,
    )


def _twist(path: EgoPath, sweep_ns: int) -> Float | None:
    """Return the velocity (6,) during a sweep, None where the poses do not reach over it."""
    try:
        return path.twist(sweep_ns, sweep_ns + _SWEEP_NS)
    except InputError:
        return None


def _sweep(options: Argoverse2Options, pair: _Pair, lidar_from_ego: Float) -> tuple[Cloud, tuple[str, ...]]:
    """Return the points of the chosen LiDAR in its frame, with seconds from the sweep's stamp, and warnings."""
    table = read_feather(pair.sweep, "sweep", _SWEEP)
    fields: dict[str, Any] = {key: table[key] for key in ("x", "y", "z", "intensity")}
    fields |= {"ring": table["laser_number"], "time_s": table["offset_ns"].astype(np.float64) / _SECOND}
    warnings: tuple[str, ...] = ()
    if options.lidar != "both":
        low = table["laser_number"] < _BEAMS
        is_up, remark = _low_is_up(pair, table, low)
        kept = low if is_up == (options.lidar == "up_lidar") else ~low
        if not kept.any():
            raise InputError(
                f"the sweep has no points of {options.lidar}",
                where=pair.sweep,
                expected="laser numbers 0 to 63",
                got=f"{table['laser_number'].min()} to {table['laser_number'].max()}",
            )
        fields = {key: value[kept] for key, value in fields.items()}
        warnings = (remark,) if remark else ()
    cloud, remarks = cloud_from_fields(fields, pair.sweep)
    return moved_cloud(cloud, lidar_from_ego), (*warnings, *remarks)


def _low_is_up(pair: _Pair, table: Mapping[str, Any], low: Bool) -> tuple[bool, str]:
    """Return whether lasers below 32 are those of up_lidar, and a remark where the rings do not tell."""
    xyz = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    up_from_ego, down_from_ego = (se3.inverse(pair.log.sensor(name)) for name in LIDARS)
    spread = [
        _ring_spread(se3.apply(low_from_ego, xyz[low]), table["laser_number"][low])
        + _ring_spread(se3.apply(high_from_ego, xyz[~low]), table["laser_number"][~low])
        for low_from_ego, high_from_ego in ((up_from_ego, down_from_ego), (down_from_ego, up_from_ego))
    ]
    if min(spread) * _CLEARLY > max(spread):
        remark = f"{pair.sweep.name}: rings do not tell whose lasers 0 to 31 are; they are taken for those of up_lidar"
        return True, remark
    return spread[0] < spread[1], ""


def _ring_spread(xyz: Float, ring: Int) -> float:
    """Return how far elevations lie from the middle one of their ring, in radians, in the mean over rings; 0 if none.

    Medians, as some returns are of the car and of what moves.
    """
    near, far = _TELLING_M
    flat = np.hypot(xyz[:, 0], xyz[:, 1])
    used = (flat > near) & (flat < far)
    elevation, ring = np.arctan2(xyz[used, 2], flat[used]), ring[used]
    spreads = [
        float(np.median(np.abs(values - np.median(values))))
        for values in (elevation[ring == number] for number in np.unique(ring))
        if len(values) >= _FEWEST
    ]
    return float(np.mean(spreads)) if spreads else 0.0


def _poses(table: Mapping[str, Any], path: Path, names: Sequence[object] | None = None) -> Float:
    """Return the poses (N, 4, 4) of a table with quaternions w x y z and translations in metres."""
    w, x, y, z = (table[key] for key in _QUATERNION)
    return pose_rows(
        np.stack([x, y, z, w], axis=1), np.stack([table[key] for key in _TRANSLATION], axis=1), path, names
    )


METHOD = Method(
    name="argoverse2",
    build=build,
    options=Argoverse2Options,
    summary="Argoverse 2 (sensor data set): nine cameras and the two stacked LiDARs, by its Feather files.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Wilson et al.: Argoverse 2: next generation datasets for self-driving perception. NeurIPS Datasets 2021",
    extra="arrow",
)
