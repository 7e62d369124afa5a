"""nuScenes v1.0 by its tables: key frames and the images between them, any camera, and the sweep of the top LiDAR."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Dataset, Frame, Image, InputError, Method, Options, UnknownNameError, field, se3
from p2o.files.input_file import existing_folder, listing, naming
from p2o.formats.camera_entry import read_camera

from p2o_plugins.data.cloud_file import read_cloud
from p2o_plugins.data.ego_path import moved_cloud, now_from_then
from p2o_plugins.data.image_file import read_rgb
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.named_file import file_inside
from p2o_plugins.data.nuscenes_tables import (
    by_token,
    matrix_of,
    named,
    number_of,
    pose_of,
    records,
    text_of,
)

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
_LIDAR = "LIDAR_TOP"
_COLUMNS = ("x", "y", "z", "intensity", "ring")
_TABLES = ("scene", "sample", "sample_data", "calibrated_sensor", "sensor", "ego_pose")
_PER_SECOND = 1_000_000
# Sweeps follow each other after 50 ms, images after 80.
_SAME_MOMENT = 60_000


class NuscenesOptions(Options):
    """Options of nuScenes."""

    root: Path = field(Path("."), help="Folder that holds v1.0-mini (or another version), samples and sweeps.")
    version: str | None = field(None, help="Folder of the tables, such as v1.0-trainval; null: the only one.")
    cameras: Words = field(
        ("CAM_FRONT",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}."
    )
    scenes: Words = field((), help="Names of scenes, joined by commas, such as scene-0061; none: all.")
    between: bool = field(False, help="Take the images between the key frames, too, each with the nearest sweep.")
    moved: bool = field(
        True, help="Move the sweep to the moment of the image by the car's poses; else it stays where it was."
    )


@dataclass(frozen=True)
class _File:
    """A picture or a sweep: its record in sample_data without what is not needed; times in microseconds."""

    scene: str
    channel: str
    sample: str
    time_us: int
    is_key: bool
    file: str
    size: tuple[int, int]
    sensor: str
    ego_pose: str


@dataclass(frozen=True, eq=False)
class _Source:
    """What frames have in common: folders, options, and the records that they name."""

    root: Path
    tables: Path
    options: NuscenesOptions
    sensors: Mapping[str, Mapping[str, Any]]
    poses: Mapping[str, Mapping[str, Any]]
    first_us: Mapping[str, int]


def build(options: NuscenesOptions) -> Dataset:
    """Return the frames of the chosen scenes and cameras; names are "scene/camera/microseconds".

    Frames whose files are missing are listed in `skipped`, as in a download of some parts.

    Raises InputError where the folder, a table or a record is missing or wrong, and where no frame is left.
    """
    root = existing_folder(options.root, "nuScenes").resolve()
    tables = _tables(root, options.version)
    channels = chosen("camera", options.cameras, CAMERAS)
    files = _files(tables, channels, options)
    pairs = _pairs(files, options)
    entries: dict[str, tuple[_File, _File]] = {}
    skipped: dict[str, str] = {}
    for image, sweep in pairs:
        name = f"{image.scene}/{image.channel}/{image.time_us}"
        missing = next((file.file for file in (image, sweep) if not os.path.isfile(root / file.file)), None)
        if missing is None:
            entries[name] = (image, sweep)
        else:
            skipped[name] = f"{root / missing} is missing"
    if not entries:
        raise InputError(
            "no nuScenes frames",
            where=root,
            expected=f"images of {', '.join(channels)} and sweeps of {_LIDAR}",
            got=next(iter(skipped.values()), f"{len(files)} files in the table, none together"),
        )
    wanted = {file.ego_pose for pair in entries.values() for file in pair}
    poses = by_token(tables, "ego_pose", lambda record: record.get("token") in wanted)
    first_us: dict[str, int] = {}
    for image, _ in entries.values():
        first_us[image.scene] = min(image.time_us, first_us.get(image.scene, image.time_us))
    source = _Source(root, tables, options, by_token(tables, "calibrated_sensor"), poses, first_us)
    return LazyFrames(entries, partial(_read, source), skipped)


def _tables(root: Path, version: str | None) -> Path:
    found = [folder.name for folder in listing(root, "nuScenes") if folder.name.startswith("v1.0") and folder.is_dir()]
    if version is not None and version not in found:
        raise UnknownNameError("version", version, found, where=root)
    if version is None and len(found) != 1:
        raise InputError(
            "no single folder of tables" if found else "there are no tables of nuScenes",
            where=root,
            expected="one folder such as v1.0-mini, or its name: --set data.version=NAME",
            got=", ".join(found) or "none",
        )
    tables = root / (version or found[0])
    lacking = [name for name in _TABLES if not (tables / f"{name}.json").is_file()]
    if lacking:
        raise InputError("a table is missing", where=tables, expected=f"{lacking[0]}.json")
    return tables


def _files(tables: Path, channels: Sequence[str], options: NuscenesOptions) -> list[_File]:
    """Return the pictures and sweeps of the chosen scenes and sensors."""
    scenes = {
        token: text_of(record, "name", tables / "scene.json") for token, record in by_token(tables, "scene").items()
    }
    wanted = frozenset(chosen("scene", options.scenes, scenes.values(), where=tables))
    channel_of = _channel_of(tables)
    scene_of = {
        token: scenes.get(text_of(record, "scene_token", tables / "sample.json"), "")
        for token, record in by_token(tables, "sample").items()
    }
    path = tables / "sample_data.json"
    found = []
    for record in records(tables, "sample_data"):
        is_key = record.get("is_key_frame") is True
        sensor = text_of(record, "calibrated_sensor_token", path)
        channel = channel_of.get(sensor, "")
        if channel not in (*channels, _LIDAR) or not (is_key or options.between):
            continue
        sample = text_of(record, "sample_token", path)
        scene = scene_of.get(sample)
        if not scene:
            raise InputError("a table lacks a record that another one names", where=path, got=f"sample {sample[:80]}")
        if scene not in wanted:
            continue
        size = (0, 0) if channel == _LIDAR else (number_of(record, "width", path), number_of(record, "height", path))
        found.append(
            _File(
                *(scene, channel, sample, number_of(record, "timestamp", path), is_key),
                *(text_of(record, "filename", path), size, sensor, text_of(record, "ego_pose_token", path)),
            )
        )
    return found


def _channel_of(tables: Path) -> dict[str, str]:
    """Return the channel of each calibrated sensor by its token."""
    sensors = by_token(tables, "sensor")
    path = tables / "calibrated_sensor.json"
    return {
        token: text_of(
            named(sensors, text_of(record, "sensor_token", path), tables / "sensor.json"),
            "channel",
            tables / "sensor.json",
        )
        for token, record in by_token(tables, "calibrated_sensor").items()
    }


def _pairs(files: Sequence[_File], options: NuscenesOptions) -> list[tuple[_File, _File]]:
    """Return images with their sweeps, scene by scene, camera by camera, in the order of time.

    Key frames say which sweep is theirs; the images between them have the nearest one.
    """
    sweeps = {file.sample: file for file in files if file.channel == _LIDAR and file.is_key}
    scenes: dict[str, list[_File]] = {}
    for file in files:
        if file.channel == _LIDAR:
            scenes.setdefault(file.scene, []).append(file)
    ordered = {scene: sorted(found, key=lambda file: file.time_us) for scene, found in scenes.items()}
    times = {scene: np.array([file.time_us for file in found], np.int64) for scene, found in ordered.items()}
    pairs = []
    for image in sorted(files, key=lambda file: (file.scene, file.channel, file.time_us)):
        if image.channel == _LIDAR:
            continue
        sweep = sweeps.get(image.sample) if image.is_key else None
        if sweep is None and options.between and image.scene in times:
            nearest = int(np.abs(times[image.scene] - image.time_us).argmin())
            sweep = ordered[image.scene][nearest]
            sweep = sweep if abs(sweep.time_us - image.time_us) <= _SAME_MOMENT else None
        if sweep is not None:
            pairs.append((image, sweep))
    return pairs


def _read(source: _Source, pair: tuple[_File, _File]) -> Frame:
    image_file, sweep_file = pair
    calibrated, poses = source.tables / "calibrated_sensor.json", source.tables / "ego_pose.json"
    camera_record = named(source.sensors, image_file.sensor, calibrated)
    camera = _camera(camera_record, image_file, calibrated)
    ego_from_camera = pose_of(camera_record, calibrated)
    ego_from_lidar = pose_of(named(source.sensors, sweep_file.sensor, calibrated), calibrated)
    now, then = (pose_of(named(source.poses, file.ego_pose, poses), poses) for file in (image_file, sweep_file))
    image_path, sweep_path = (file_inside(source.root, file.file) for file in (image_file, sweep_file))
    rgb, warnings = read_rgb(image_path, image_file.size)
    with naming(image_path):
        image = Image(rgb, camera)
    cloud, cloud_warnings = read_cloud(sweep_path, columns=_COLUMNS)
    world_from_lidar = now @ ego_from_lidar
    if source.options.moved:
        cloud = moved_cloud(cloud, now_from_then(world_from_lidar, then @ ego_from_lidar))
    return Frame(
        f"{image_file.scene}/{image_file.channel}/{image_file.time_us}",
        image,
        cloud,
        camera_from_lidar=se3.inverse(ego_from_camera) @ ego_from_lidar,
        warnings=(*warnings, *cloud_warnings),
        sequence=image_file.scene,
        time_s=(image_file.time_us - source.first_us[image_file.scene]) / _PER_SECOND,
        # No pose of the camera: it would be this one and the truth.
        lidar_world_from_lidar=world_from_lidar,
        camera_name=image_file.channel,
    )


def _camera(record: Mapping[str, Any], file: _File, path: Path) -> Camera:
    width, height = file.size
    return read_camera({"width": width, "height": height, "K": matrix_of(record, "camera_intrinsic", path)}, path)


METHOD = Method(
    name="nuscenes",
    build=build,
    options=NuscenesOptions,
    summary="nuScenes v1.0: key frames and what lies between them, six cameras and the top LiDAR.",
    gives=frozenset({"rings", "intensity"}),
    cite="Caesar et al.: nuScenes: a multimodal dataset for autonomous driving. CVPR 2020",
)
