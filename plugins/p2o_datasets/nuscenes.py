"""Read nuScenes v1.0 from its tables: key frames and intermediate images of all cameras, and the top LiDAR."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Dataset, Frame, InputError, Method, Options, UnknownNameError, field, se3
from p2o.reading import existing_folder, layout, listing
from p2o_formats.camera_entry import read_camera

from p2o_datasets.cloud_file import read_cloud
from p2o_datasets.ego_path import moved_cloud, nearest, refuse_jump
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, file_inside, read_image, rig_frame
from p2o_datasets.nuscenes_tables import by_token, matrix_of, named, number_of, pose_of, records, text_of, wrong

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
_LIDAR = "LIDAR_TOP"
_COLUMNS = ("x", "y", "z", "intensity", "ring")
_TABLES = ("scene", "sample", "sample_data", "calibrated_sensor", "sensor", "ego_pose")
_PER_SECOND = 1_000_000
# Sweeps have an interval of 50 ms, images of 80 ms.
_SAME_MOMENT = 60_000


class NuscenesOptions(Options):
    """Options of nuScenes."""

    root: Path = field(Path("."), help="Folder that contains v1.0-mini (or another version), samples and sweeps.")
    version: str | None = field(None, help="Folder of the tables, such as v1.0-trainval; null: the only one.")
    cameras: Words = cameras_field("CAM_FRONT", CAMERAS)
    scenes: Words = field((), help="Names of scenes, separated by commas, such as scene-0061; default: all.")
    between: bool = field(False, help="Also use the images between the key frames, each with the nearest sweep.")
    moved: bool = field(True, help="Transform the sweep to the time of the image with the vehicle's poses.")


@dataclass(frozen=True)
class _File:
    """An image or a sweep: the required fields of its record in sample_data; times in microseconds."""

    scene: str
    channel: str
    sample: str
    time_us: int
    is_key: bool
    file: str
    size: tuple[int, int]
    sensor: str
    ego_pose: str

    @property
    def name(self) -> str:
        return f"{self.scene}/{self.channel}/{self.time_us}"


@dataclass(frozen=True, eq=False)
class _Source:
    """Data that all frames share: folders, options, and records."""

    root: Path
    tables: Path
    options: NuscenesOptions
    sensors: Mapping[str, Mapping[str, Any]]
    poses: Mapping[str, Mapping[str, Any]]
    first_us: Mapping[str, int]


def build(options: NuscenesOptions) -> Dataset:
    """Return the frames of the selected scenes and cameras; names are "scene/camera/microseconds".

    Frames with missing files, as in partial downloads, are listed in `skipped`. Raises InputError for missing folders
    and tables, for invalid records, and without a frame.
    """
    root = existing_folder(options.root, "nuScenes").resolve()
    tables = _tables(root, options.version)
    channels = chosen("camera", options.cameras, CAMERAS)
    files = _files(tables, channels, options)
    frames = Listed()
    for image, sweep in _pairs(files, options):
        missing = (root / file.file for file in (image, sweep) if not os.path.isfile(root / file.file))
        frames.add(image.name, (image, sweep), next((f"{path} is missing" for path in missing), ""))
    wanted = {file.ego_pose for pair in frames.entries.values() for file in pair}
    poses = by_token(tables, "ego_pose", wanted.__contains__)
    first_us: dict[str, int] = {}
    for image, _ in frames.entries.values():
        first_us[image.scene] = min(image.time_us, first_us.get(image.scene, image.time_us))
    source = _Source(root, tables, options, by_token(tables, "calibrated_sensor"), poses, first_us)
    expected = f"images of {', '.join(channels)} and sweeps of {_LIDAR}"
    got = f"{len(files)} files in the table, no pair of image and sweep"
    return frames.lazy("nuScenes frames", root, partial(_read, source), expected=expected, got=got)


def _tables(root: Path, version: str | None) -> Path:
    versions = [path.name for path in listing(root, "nuScenes") if path.name.startswith("v1.0") and path.is_dir()]
    if version is not None and version not in versions:
        raise UnknownNameError("version", version, versions, where=root)
    if version is None and len(versions) != 1:
        fault = "several folders of tables" if versions else "there are no tables of nuScenes"
        expected = "one folder such as v1.0-mini, or its name: --set data.version=NAME"
        raise InputError(fault, where=root, expected=expected, got=", ".join(versions) or "none")
    tables = root / (version or versions[0])
    lacking = [name for name in _TABLES if not (tables / f"{name}.json").is_file()]
    if lacking:
        raise InputError("a table is missing", where=tables, expected=f"{lacking[0]}.json")
    return tables


def _files(tables: Path, channels: Sequence[str], options: NuscenesOptions) -> list[_File]:
    """Return the images and sweeps of the selected scenes and sensors."""
    records_of_scenes = by_token(tables, "scene").items()
    scenes = {token: text_of(record, "name", tables / "scene.json") for token, record in records_of_scenes}
    wanted = frozenset(chosen("scene", options.scenes, scenes.values(), where=tables))
    where, path = tables / "sensor.json", tables / "calibrated_sensor.json"
    sensors, calibrated = by_token(tables, "sensor"), by_token(tables, "calibrated_sensor").items()
    of = {token: named(sensors, text_of(record, "sensor_token", path), where) for token, record in calibrated}
    channel_of = {token: text_of(sensor, "channel", where) for token, sensor in of.items()}
    where, samples = tables / "sample.json", by_token(tables, "sample").items()
    scene_of = {token: named(scenes, text_of(record, "scene_token", where), where) for token, record in samples}
    path = tables / "sample_data.json"
    files = []
    for record in records(tables, "sample_data"):
        is_key = record.get("is_key_frame")
        if not isinstance(is_key, bool):
            raise wrong(record, "is_key_frame", "true or false", path)
        sensor = text_of(record, "calibrated_sensor_token", path)
        channel = named(channel_of, sensor, path)
        if channel not in (*channels, _LIDAR) or not (is_key or options.between):
            continue
        sample = text_of(record, "sample_token", path)
        scene = named(scene_of, sample, path)
        if scene not in wanted:
            continue
        size = (0, 0) if channel == _LIDAR else (number_of(record, "width", path), number_of(record, "height", path))
        time_us, name = number_of(record, "timestamp", path), text_of(record, "filename", path)
        ego_pose = text_of(record, "ego_pose_token", path)
        files.append(_File(scene, channel, sample, time_us, is_key, name, size, sensor, ego_pose))
    return files


def _pairs(files: Sequence[_File], options: NuscenesOptions) -> list[tuple[_File, _File]]:
    """Return images with the sweep of their key frame, else the nearest one, sorted by scene, camera and time."""
    sweeps = {file.sample: file for file in files if file.channel == _LIDAR and file.is_key}
    ordered: dict[str, list[_File]] = {}
    for file in sorted((file for file in files if file.channel == _LIDAR), key=lambda file: file.time_us):
        ordered.setdefault(file.scene, []).append(file)
    times = {scene: np.array([file.time_us for file in in_order], np.int64) for scene, in_order in ordered.items()}
    pairs = []
    for image in sorted(files, key=lambda file: (file.scene, file.channel, file.time_us)):
        if image.channel == _LIDAR:
            continue
        sweep = sweeps.get(image.sample) if image.is_key else None
        if sweep is None and options.between and image.scene in times:
            sweep = ordered[image.scene][int(nearest(times[image.scene], np.array([image.time_us]))[0])]
            sweep = sweep if abs(sweep.time_us - image.time_us) <= _SAME_MOMENT else None
        if sweep is not None:
            pairs.append((image, sweep))
    return pairs


def _read(source: _Source, pair: tuple[_File, _File]) -> Frame:
    image_file, sweep_file = pair
    calibrated, poses = source.tables / "calibrated_sensor.json", source.tables / "ego_pose.json"
    camera_record = named(source.sensors, image_file.sensor, calibrated)
    size = dict(zip(("width", "height"), image_file.size, strict=True))
    camera = read_camera({**size, "K": matrix_of(camera_record, "camera_intrinsic", calibrated)}, calibrated)
    ego_from_camera = pose_of(camera_record, calibrated)
    ego_from_lidar = pose_of(named(source.sensors, sweep_file.sensor, calibrated), calibrated)
    now, then = (pose_of(named(source.poses, file.ego_pose, poses), poses) for file in (image_file, sweep_file))
    table = source.tables / "sample_data.json"
    image_path, sweep_path = (file_inside(source.root, source.root, f.file, table) for f in (image_file, sweep_file))
    image, warnings = read_image(image_path, camera)
    cloud, cloud_warnings = read_cloud(sweep_path, columns=_COLUMNS)
    world_from_lidar = now @ ego_from_lidar
    refuse_jump(np.array([then[:3, 3], now[:3, 3]]), (image_file.time_us - sweep_file.time_us) / _PER_SECOND, poses)
    if source.options.moved:
        cloud = moved_cloud(cloud, se3.inverse(world_from_lidar) @ (then @ ego_from_lidar))
    extrinsic = se3.inverse(ego_from_camera) @ ego_from_lidar
    time_s = (image_file.time_us - source.first_us[image_file.scene]) / _PER_SECOND
    return rig_frame(image_file.name, time_s, image, cloud, extrinsic, world_from_lidar, *warnings, *cloud_warnings)


METHOD = Method(
    name="nuscenes",
    build=build,
    options=NuscenesOptions,
    summary="nuScenes v1.0: key frames and intermediate images of six cameras, and the top LiDAR.",
    gives=frozenset({"rings", "intensity"}),
    cite="Caesar et al.: nuScenes: a multimodal dataset for autonomous driving. CVPR 2020",
    recognises=layout("v1.0-*/sample_data.json"),
)
