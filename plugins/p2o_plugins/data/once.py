"""ONCE (One millioN sCenEs): seven cameras and the 40-beam LiDAR on the roof, by one JSON file a sequence.

The files as the public toolkit reads them (once-for-auto-driving/once_devkit, once.py) and as the documentation of the
data set has them (once-for-auto-driving.github.io/documentation.html): cam_to_velo takes points of the optical frame to
the LiDAR, whose x points left, y back and z up; a pose is a quaternion x y z w and a place, world_from_lidar in the
world of the sequence's first frame (issues 21 and 22 of the toolkit settle order and meaning). The documentation says
that distortions are removed from the pictures; the toolkit undistorts them before it projects anything, so they are
taken to be distorted here.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Dataset, Frame, Image, InputError, Method, Options, UnknownNameError, field, se3
from p2o.arrays import Float
from p2o.files.input_file import existing_folder, listing, naming, read_text
from p2o.files.parsed_text import parse_json
from p2o.formats.camera_entry import read_camera
from p2o.geometry.pose_text import numbers, read_pose

from p2o_plugins.data.bin_file import KITTI_COLUMNS
from p2o_plugins.data.cloud_file import read_cloud
from p2o_plugins.data.image_file import read_rgb
from p2o_plugins.data.kitti_folder import is_number
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.name_choice import Words, chosen
from p2o_plugins.data.named_file import file_inside
from p2o_plugins.data.pose_rows import pose_rows

CAMERAS = ("cam01", "cam03", "cam05", "cam06", "cam07", "cam08", "cam09")
_LIDAR = "lidar_roof"
_PER_SECOND = 1000


class OnceOptions(Options):
    """Options of ONCE."""

    root: Path = field(Path("."), help="Folder that holds data, or the sequences themselves.")
    sequences: Words = field((), help="Names of sequences, joined by commas, such as 000027; none: all.")
    cameras: Words = field(("cam01",), min_length=1, help=f"Cameras, joined by commas, or all: {', '.join(CAMERAS)}.")
    distorted: bool = field(
        True, help="Whether the pictures have the distortion of the calibration, as the toolkit takes them."
    )


@dataclass(frozen=True, eq=False)
class _Sequence:
    """What the JSON file of a sequence says: calibration by camera, and the records of frames in the order of time."""

    path: Path
    calibration: Mapping[str, Any]
    frames: Sequence[Mapping[str, Any]]

    @property
    def name(self) -> str:
        return self.path.stem


@dataclass(frozen=True, eq=False)
class _Shot:
    """A picture of a sequence and its sweep; `number` is the frame's, `id` its time in milliseconds."""

    sequence: _Sequence
    camera: str
    number: int
    id: str

    @property
    def name(self) -> str:
        return f"{self.sequence.name}/{self.camera}/{self.id}"

    @property
    def files(self) -> tuple[str, str]:
        """The picture and the sweep, in the folder of the sequence."""
        return f"{self.camera}/{self.id}.jpg", f"{_LIDAR}/{self.id}.bin"


def build(options: OnceOptions) -> Dataset:
    """Return the frames of the chosen sequences and cameras; names are "sequence/camera/frame".

    Frames whose files are missing are listed in `skipped`, as in a download of some parts.

    Raises InputError where the folder is missing or holds no sequences, a JSON file is wrong, for names of sequences
    and cameras that are not there, and where no frame is left.
    """
    root = existing_folder(options.root, "ONCE").resolve()
    cameras = chosen("camera", options.cameras, CAMERAS)
    entries: dict[str, _Shot] = {}
    skipped: dict[str, str] = {}
    for sequence in _sequences(root, options.sequences):
        folder = sequence.path.parent
        for camera in cameras:
            for number, record in enumerate(sequence.frames):
                shot = _Shot(sequence, camera, number, _id(record, sequence.path))
                missing = next((file for file in shot.files if not os.path.isfile(folder / file)), None)
                if missing is None:
                    entries[shot.name] = shot
                else:
                    skipped[shot.name] = f"{folder / missing} is missing"
    if not entries:
        raise InputError(
            "no ONCE frames",
            where=root,
            expected=f"images of {', '.join(cameras)} and sweeps in {_LIDAR}",
            got=next(iter(skipped.values()), "sequences without frames"),
        )
    return LazyFrames(entries, partial(_read, options), skipped)


def _sequences(root: Path, wanted: Sequence[str]) -> list[_Sequence]:
    home = root / "data" if os.path.isdir(root / "data") else root
    files = {folder.name: folder / f"{folder.name}.json" for folder in listing(home, "ONCE") if folder.is_dir()}
    found = {name: path for name, path in files.items() if os.path.isfile(path)}
    if not found:
        raise InputError(
            "there are no sequences of ONCE",
            where=home,
            expected="folders such as 000027 with 000027.json",
            got=", ".join(path.name for path in listing(home, "ONCE")[:8]) or "an empty folder",
        )
    return [_sequence(found[name]) for name in chosen("sequence", wanted, found, where=home)]


def _sequence(path: Path) -> _Sequence:
    value = parse_json(read_text(path, "file of a sequence"), "file of a sequence", path)
    calibration, frames = (value.get(key) if isinstance(value, Mapping) else None for key in ("calib", "frames"))
    if not isinstance(calibration, Mapping) or not isinstance(frames, list):
        raise InputError("this is no sequence of ONCE", where=path, expected="an object with calib and frames")
    if not all(isinstance(record, Mapping) for record in frames):
        raise InputError("a frame of the sequence is no object", where=path, expected="frame_id, pose")
    return _Sequence(path, calibration, sorted(frames, key=lambda record: int(_id(record, path))))


def _id(record: Mapping[str, Any], path: Path) -> str:
    """Return the id of a frame, its time in milliseconds; raises InputError for what is no number."""
    said = record.get("frame_id")
    text = str(said) if isinstance(said, int) and not isinstance(said, bool) else said
    if not isinstance(text, str) or not is_number(text) or len(text) > 18:
        raise InputError("a frame_id is no number", where=path, expected="milliseconds", got=repr(said)[:60])
    return text


def _read(options: OnceOptions, shot: _Shot) -> Frame:
    sequence = shot.sequence
    image_path, sweep_path = (file_inside(sequence.path.parent.resolve(), file) for file in shot.files)
    rgb, warnings = read_rgb(image_path)
    camera, lidar_from_camera = _camera(options, shot, image_path, (rgb.shape[1], rgb.shape[0]))
    with naming(image_path):
        image = Image(rgb, camera)
    cloud, cloud_warnings = read_cloud(sweep_path, columns=KITTI_COLUMNS)
    first = _id(sequence.frames[0], sequence.path)
    return Frame(
        shot.name,
        image,
        cloud,
        camera_from_lidar=se3.inverse(lidar_from_camera),
        warnings=(*warnings, *cloud_warnings),
        sequence=sequence.name,
        time_s=(int(shot.id) - int(first)) / _PER_SECOND,
        # No pose of the camera: it would be this one and the truth.
        lidar_world_from_lidar=_pose(sequence.frames[shot.number], shot.id, sequence.path),
        camera_name=shot.camera,
    )


def _camera(options: OnceOptions, shot: _Shot, image: Path, size: tuple[int, int]) -> tuple[Camera, Float]:
    """Return the camera of a picture of width x height px, and lidar_from_camera (4, 4)."""
    path = shot.sequence.path
    if shot.camera not in shot.sequence.calibration:
        raise UnknownNameError("camera", shot.camera, map(str, shot.sequence.calibration), where=path)
    said = shot.sequence.calibration[shot.camera]
    if not isinstance(said, Mapping):
        raise InputError(f"calib.{shot.camera} is no object", where=path, expected="cam_to_velo, cam_intrinsic")
    pose, _ = read_pose(f"calib.{shot.camera}.cam_to_velo", said.get("cam_to_velo"), path)
    matrix = numbers(said.get("cam_intrinsic"), (3, 3))
    if matrix is not None and not (0 <= matrix[0, 2] < size[0] and 0 <= matrix[1, 2] < size[1]):
        raise InputError(
            "the image size does not fit the camera",
            where=image,
            expected=f"the principal point ({matrix[0, 2]:.0f}, {matrix[1, 2]:.0f}) inside the image",
            got=f"{size[0]}x{size[1]} px",
        )
    entry: dict[str, Any] = {"width": size[0], "height": size[1], "K": said.get("cam_intrinsic")}
    if options.distorted:
        d = numbers(said.get("distortion"), (4,), (5,), (8,), (12,), (14,))
        if d is None:
            raise InputError(
                f"calib.{shot.camera}.distortion is none",
                where=path,
                expected="4, 5, 8, 12 or 14 numbers of OpenCV",
                got=str(said.get("distortion"))[:60],
            )
        model = "plumb_bob" if len(d) <= 5 else "rational_polynomial"
        entry |= {"distortion_model": model, "D": d.tolist()}
    return read_camera(entry, path), pose


def _pose(record: Mapping[str, Any], name: str, path: Path) -> Float | None:
    """Return world_from_lidar (4, 4) of a frame, None where it has none (left out, or zeros)."""
    if record.get("pose") is None:
        return None
    values = numbers(record["pose"], (7,))
    if values is None:
        raise InputError(
            f"the pose of {name} is none", where=path, expected="7 finite numbers", got=str(record["pose"])[:60]
        )
    if not values.any():
        return None
    return np.asarray(pose_rows(values[:4], values[4:], path, [name])[0])


METHOD = Method(
    name="once",
    build=build,
    options=OnceOptions,
    summary="ONCE: seven cameras and the 40-beam LiDAR on the roof.",
    gives=frozenset({"intensity"}),
    cite="Mao et al.: One million scenes for autonomous driving: ONCE dataset. NeurIPS Datasets and Benchmarks 2021",
)
