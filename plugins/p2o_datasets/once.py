"""Read ONCE (One millioN sCenEs): seven cameras and a 40-beam roof LiDAR, with one JSON file per sequence.

The format follows the public toolkit (once-for-auto-driving/once_devkit, once.py) and the documentation of the data set
(once-for-auto-driving.github.io/documentation.html). cam_to_velo maps the optical frame of the camera to the LiDAR's
frame (x left, y back, z up). A pose is a quaternion x y z w and a translation, world_from_lidar in the world of the
sequence's first frame (confirmed in issues 21 and 22 of the toolkit). According to the documentation, images are
undistorted; because the toolkit undistorts them before every projection, p2o assumes that they are distorted.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Dataset, Float, Frame, InputError, Method, Options, UnknownNameError, field, se3
from p2o.reading import existing_folder, layout, numbers, parse_json, read_pose, read_text
from p2o_formats.camera_entry import read_camera
from p2o_formats.kitti_calibration import check_centre

from p2o_datasets import lazy_dataset
from p2o_datasets.bin_file import KITTI_COLUMNS
from p2o_datasets.cloud_file import read_cloud
from p2o_datasets.ego_path import pose_rows
from p2o_datasets.kitti_folder import is_number
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, drives_in, file_inside, rig_frame

CAMERAS = ("cam01", "cam03", "cam05", "cam06", "cam07", "cam08", "cam09")
_LIDAR = "lidar_roof"
_PER_SECOND = 1000


class OnceOptions(Options):
    """Options of ONCE."""

    root: Path = field(Path("."), help="Folder that contains data/, or the sequences.")
    sequences: Words = field((), help="Names of sequences, separated by commas, such as 000027; default: all.")
    cameras: Words = cameras_field("cam01", CAMERAS)
    distorted: bool = field(True, help="Whether images have the calibration's distortion, as the toolkit assumes.")


@dataclass(frozen=True, eq=False)
class _Sequence:
    """Content of a sequence's JSON file: calibration by camera, and the records of the frames in temporal order."""

    path: Path
    calibration: Mapping[str, Any]
    frames: Sequence[Mapping[str, Any]]


def build(options: OnceOptions) -> Dataset:
    """Return the frames of the selected sequences and cameras; names are "sequence/camera/frame".

    Frames with missing files, as in partial downloads, are listed in `skipped`. Raises InputError for invalid JSON
    files and without sequences or frames, and UnknownNameError for unknown sequences and cameras.
    """
    root = existing_folder(options.root, "ONCE").resolve()
    cameras = chosen("camera", options.cameras, CAMERAS)
    frames = Listed()
    home, expected = root / "data" if os.path.isdir(root / "data") else root, "folders such as 000027 with 000027.json"
    for folder in drives_in(home, "sequence", "ONCE", options.sequences, _is_sequence, expected):
        sequence = _sequence(folder)
        for camera in cameras:
            for number, record in enumerate(sequence.frames):
                frame_id = _id(record, sequence.path)
                files = (f"{camera}/{frame_id}.jpg", f"{_LIDAR}/{frame_id}.bin")
                missing = (f"{folder / file} is missing" for file in files if not os.path.isfile(folder / file))
                name = f"{folder.name}/{camera}/{frame_id}"
                frames.add(name, (name, sequence, camera, number, files), next(missing, ""))
    expected = f"images of {', '.join(cameras)} and sweeps in {_LIDAR}"
    return frames.lazy("ONCE frames", root, partial(_read, options), expected=expected, got="sequences without frames")


def _is_sequence(folder: Path) -> bool:
    return os.path.isfile(folder / f"{folder.name}.json")


def _sequence(folder: Path) -> _Sequence:
    path = folder / f"{folder.name}.json"
    value = parse_json(read_text(path, "file of a sequence"), "file of a sequence", path)
    calibration, frames = (value.get(key) if isinstance(value, Mapping) else None for key in ("calib", "frames"))
    if not isinstance(calibration, Mapping) or not isinstance(frames, list):
        raise InputError("the file is not a sequence of ONCE", where=path, expected="an object with calib and frames")
    if not all(isinstance(record, Mapping) for record in frames):
        raise InputError("a frame of the sequence is not an object", where=path, expected="frame_id, pose")
    return _Sequence(path, calibration, sorted(frames, key=lambda record: int(_id(record, path))))


def _id(record: Mapping[str, Any], path: Path) -> str:
    """Return the id of a frame, its time in milliseconds; raises InputError if it is not a number."""
    value = record.get("frame_id")
    text = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    if not isinstance(text, str) or not is_number(text) or len(text) > 18:
        raise InputError("a frame_id is not a number", where=path, expected="milliseconds", got=repr(value)[:60])
    return text


def _read(options: OnceOptions, entry: tuple[str, _Sequence, str, int, tuple[str, str]]) -> Frame:
    name, sequence, camera, number, files = entry
    path, calibration = sequence.path, sequence.calibration
    image_path, sweep_path = (file_inside(path.parent.resolve(), path.parent, file, path) for file in files)
    if camera not in calibration:
        raise UnknownNameError("camera", camera, map(str, calibration), where=path)
    values = calibration[camera]
    if not isinstance(values, Mapping):
        raise InputError(f"calib.{camera} is not an object", where=path, expected="cam_to_velo, cam_intrinsic")
    lidar_from_camera, _ = read_pose(f"calib.{camera}.cam_to_velo", values.get("cam_to_velo"), path)
    image, warnings = lazy_dataset.read_image(image_path, partial(_camera, options, camera, values, path))
    cloud, cloud_warnings = read_cloud(sweep_path, columns=KITTI_COLUMNS)
    first, frame_id = (_id(sequence.frames[index], path) for index in (0, number))
    pose = _pose(sequence.frames[number], frame_id, path)
    time_s, extrinsic = (int(frame_id) - int(first)) / _PER_SECOND, se3.inverse(lidar_from_camera)
    return rig_frame(name, time_s, image, cloud, extrinsic, pose, *warnings, *cloud_warnings)


def _camera(options: OnceOptions, name: str, entry: Mapping[str, Any], path: Path, width: int, height: int) -> Camera:
    """Return the camera of an image of width x height px."""
    matrix = numbers(entry.get("cam_intrinsic"), (3, 3))
    if matrix is not None:
        check_centre(matrix, width, height)
    camera: dict[str, Any] = {"width": width, "height": height, "K": entry.get("cam_intrinsic")}
    if options.distorted:
        d = numbers(entry.get("distortion"), (4,), (5,), (8,), (12,), (14,))
        if d is None:
            expected = "4, 5, 8, 12 or 14 numbers of OpenCV"
            got = str(entry.get("distortion"))[:60]
            raise InputError(f"calib.{name}.distortion is invalid", where=path, expected=expected, got=got)
        model = "plumb_bob" if len(d) <= 5 else "rational_polynomial"
        camera |= {"distortion_model": model, "D": d.tolist()}
    return read_camera(camera, path)


def _pose(record: Mapping[str, Any], name: str, path: Path) -> Float | None:
    """Return world_from_lidar (4, 4) of a frame, None if it is missing or all zeros."""
    if record.get("pose") is None:
        return None
    values = numbers(record["pose"], (7,))
    if values is None:
        got = str(record["pose"])[:60]
        raise InputError(f"the pose of {name} is invalid", where=path, expected="7 finite numbers", got=got)
    return np.asarray(pose_rows(values[:4], values[4:], path, [name])[0]) if values.any() else None


METHOD = Method(
    name="once",
    build=build,
    options=OnceOptions,
    summary="ONCE: seven cameras and the 40-beam roof LiDAR.",
    gives=frozenset({"intensity"}),
    cite="Mao et al.: One million scenes for autonomous driving: ONCE dataset. NeurIPS Datasets and Benchmarks 2021",
    recognises=layout("lidar_roof", "*/lidar_roof", "data/*/lidar_roof"),
)
