"""Read KITTI-360: two rectified cameras to the front, two fisheyes to the sides, and raw sweeps of the Velodyne.

The format follows the public scripts (autonomousvision/kitti360Scripts: devkits/commons/loadCalibration.py,
helpers/project.py, viewer/kitti360Viewer3DRaw.py, helpers/curlVelodyneData_impl.c) and the documentation of the data
set (cvlibs.net/datasets/kitti-360/documentation.php). camera_from_lidar of a rectified camera is R_rect times the
mounting, and P_rect only provides the intrinsic matrix. Sweeps are raw; the poses of the vehicle provide its velocity.
The public scripts ignore p1 and p2 of the fisheyes, which are part of the model that the files name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Dataset, Float, Frame, InputError, Method, Options, field, se3
from p2o.reading import existing_folder, layout, naming, parse_yaml, read_text
from p2o.reading import numbers as numbers_in
from p2o_formats.kitti_calibration import calibration_of, read_calibration, rectified_camera

from p2o_datasets import lazy_dataset
from p2o_datasets.ego_path import EgoPath
from p2o_datasets.kitti_folder import add_pairs, is_number, read_stamps, sweeps
from p2o_datasets.lazy_dataset import Listed, Words, cameras_field, chosen, drives_in, finite_number, rig_frame
from p2o_datasets.mei_camera import MeiLens, mei_camera
from p2o_datasets.velodyne_file import SWEEP_S, compensated, read_sweep

RECTIFIED = {"image_00": "data_rect", "image_01": "data_rect"}
FISHEYES = {"image_02": "data_rgb", "image_03": "data_rgb"}
CAMERAS = {**RECTIFIED, **FISHEYES}
_SECOND = 1_000_000_000
_SEQUENCE = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}_sync", re.ASCII)
# "key:value" without a blank, as OpenCV writes it, is not valid YAML.
_NO_BLANK = re.compile(r"^(\s*\w+):(?=[^\s])", re.MULTILINE)
_LENS = {"mirror": ("xi",), "distortion": ("k1", "k2", "p1", "p2"), "projection": ("gamma1", "gamma2", "u0", "v0")}


class Kitti360Options(Options):
    """Options of KITTI-360."""

    root: Path = field(Path("."), help="Folder that contains calibration, data_2d_raw and data_3d_raw.")
    sequences: Words = field((), help="Drives, separated by commas, such as 2013_05_28_drive_0000_sync; default: all.")
    cameras: Words = cameras_field("image_00", CAMERAS)
    deskew: bool = field(True, help="Compensate the sweep for motion if the vehicle's poses (data_poses) are known.")
    image_delay_s: float = field(0.0, ge=-0.05, le=0.05, help="Time of the image in s after the LiDAR points ahead.")


@dataclass(frozen=True, eq=False)
class _Drive:
    """A drive; its files and those of the rig are read on first access."""

    root: Path
    name: str

    @property
    def sweeps(self) -> Path:
        return self.root / "data_3d_raw" / self.name / "velodyne_points"

    @cached_property
    def velo_from_cam0(self) -> Float:
        path = self.root / "calibration" / "calib_cam_to_velo.txt"
        return calibration_of(f"Tr: {read_text(path, 'calibration file')}", path).rigid_12("Tr")

    @cached_property
    def body_from_camera(self) -> Mapping[str, Float]:
        """Poses of all cameras in the frame of the GPS/IMU unit."""
        lines = read_calibration(self.root / "calibration" / "calib_cam_to_pose.txt")
        return {camera: lines.rigid_12(camera) for camera in CAMERAS}

    def camera_from_lidar(self, camera: str) -> Float:
        """Return the extrinsic (4, 4) of a camera before it is rectified."""
        cam0_from_camera = se3.inverse(self.body_from_camera["image_00"]) @ self.body_from_camera[camera]
        return se3.inverse(self.velo_from_cam0 @ cam0_from_camera)

    @cached_property
    def stamps(self) -> Any:
        """Time at which each sweep points straight ahead (N,), NaT for lost sweeps."""
        return read_stamps(self.sweeps / "timestamps.txt")

    @cached_property
    def turn_s(self) -> float:
        """Duration of a revolution: the median of the stamps, else the nominal value."""
        steps = np.diff(self.stamps) / np.timedelta64(1, "s")
        steps = steps[np.isfinite(steps)]
        turn_s = float(np.median(steps)) if len(steps) else SWEEP_S
        return turn_s if 0.5 * SWEEP_S < turn_s < 2 * SWEEP_S else SWEEP_S

    def time_ns(self, frame: int) -> int:
        """Return the time at which a sweep points straight ahead: its stamp, else extrapolated by revolutions."""
        known = np.flatnonzero(~np.isnat(self.stamps))
        if not len(known):
            return round(frame * self.turn_s * _SECOND)
        near = int(known[np.abs(known - frame).argmin()])
        return int(self.stamps[near].astype(np.int64)) + round((frame - near) * self.turn_s * _SECOND)

    @cached_property
    def path(self) -> EgoPath | None:
        """Path of the LiDAR, None without poses of the drive."""
        path = self.root / "data_poses" / self.name / "poses.txt"
        if not path.exists():
            return None
        frames, poses = _pose_lines(path)
        time_ns, first = np.unique([self.time_ns(frame) for frame in frames], return_index=True)
        body_from_lidar = self.body_from_camera["image_00"] @ se3.inverse(self.velo_from_cam0)
        return EgoPath(time_ns, poses[first], path).fixed_to(body_from_lidar)


def _pose_lines(path: Path) -> tuple[list[int], Float]:
    """Return the frame numbers and the poses (N, 4, 4) of a file with a number and a matrix of 12 numbers per line."""
    numbers: list[int] = []
    poses: list[Float] = []
    for place, line in enumerate(read_text(path, "file of poses").splitlines(), 1):
        number, *words = line.split() or [""]
        if not number:
            continue
        values = numbers_in(words, (3, 4))
        if values is None or not is_number(number) or len(number) > 10:
            fault = f"line {place} of the file of poses is not a pose"
            raise InputError(fault, where=path, expected="a frame's number and 12 numbers", got=line[:60])
        pose = se3.make(values[:, :3], values[:, 3])
        numbers.append(int(number))
        poses.append(se3.check_rigid(f"the pose of frame {number}", pose, where=path, tolerance=1e-2))
    return numbers, np.array(poses).reshape(-1, 4, 4)


def build(options: Kitti360Options) -> Dataset:
    """Return the frames of the selected drives and cameras; names are "drive/camera/frame".

    Frames without an image or a sweep are listed in `skipped`. Raises InputError if there are no drives or no frames,
    and UnknownNameError for unknown drives and cameras.
    """
    root = existing_folder(options.root, "KITTI-360")
    folder, expected = root / "data_2d_raw", "data_2d_raw/2013_05_28_drive_NNNN_sync"
    names = (folder if folder.is_dir() else root, "drive", "KITTI-360", options.sequences)
    folders = drives_in(*names, lambda path: bool(_SEQUENCE.fullmatch(path.name)), expected)
    drives = [_Drive(root, path.name) for path in folders]
    cameras = chosen("camera", options.cameras, CAMERAS)
    frames = Listed()
    for drive in drives:
        clouds = sweeps(drive.sweeps / "data")
        for camera in cameras:
            data = (root / "data_2d_raw" / drive.name / camera / CAMERAS[camera], drive.sweeps / "data")
            add_pairs(frames, *data, f"{drive.name}/{camera}/", (drive, camera), clouds=clouds)
    expected = f"data_2d_raw/DRIVE/{cameras[0]}/{CAMERAS[cameras[0]]} and data_3d_raw/DRIVE/velodyne_points/data"
    got = f"{len(drives)} drives without images and sweeps"
    return frames.lazy("KITTI-360 frames", root, partial(_read, options), expected=expected, got=got)


def _read(options: Kitti360Options, entry: tuple[_Drive, str, Path, Path]) -> Frame:
    drive, camera_name, image_path, sweep_path = entry
    # Names have ten digits; larger numbers would overflow the times.
    frame = min(int(image_path.stem), 10**10)
    camera, extrinsic = (_rectified if camera_name in RECTIFIED else _fisheye)(drive, camera_name)
    image, warnings = lazy_dataset.read_image(image_path, camera)
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=drive.turn_s)
    if cloud.time_s is not None:
        cloud = replace(cloud, time_s=cloud.time_s - options.image_delay_s)
    moment_ns = drive.time_ns(frame) + round(options.image_delay_s * _SECOND)
    pose, twist, lacking = _motion(drive, moment_ns)
    cloud, remarks = compensated(cloud, twist, asked=options.deskew, lacking=lacking)
    name, time_s = f"{drive.name}/{camera_name}/{image_path.stem}", (moment_ns - drive.time_ns(0)) / _SECOND
    return rig_frame(name, time_s, image, cloud, extrinsic, pose, *warnings, *cloud_warnings, *remarks, twist=twist)


def _motion(drive: _Drive, moment_ns: int) -> tuple[Float | None, Float | None, str]:
    """Return pose (4, 4) and velocity (6,) of the LiDAR, and the missing input if they are unknown."""
    if drive.path is None:
        return None, None, f"no data_poses/{drive.name}/poses.txt"
    half_ns = round(0.5 * drive.turn_s * _SECOND)
    try:
        return drive.path.at(moment_ns), drive.path.twist(moment_ns - half_ns, moment_ns + half_ns), ""
    except InputError as problem:
        # The data set has no poses while the vehicle is static and at the ends of drives.
        return None, None, f"{problem.what} ({problem.got})"


def _rectified(drive: _Drive, camera: str) -> tuple[Camera, Float]:
    """Return a front camera, and camera_from_lidar of its rectified frame."""
    path = drive.root / "calibration" / "perspective.txt"
    lines, number = read_calibration(path), camera[-2:]
    with naming(path):
        rectified = rectified_camera(lines.projection(f"P_rect_{number}"), *lines.size(f"S_rect_{number}"))
    return rectified, lines.rigid(f"R_rect_{number}") @ drive.camera_from_lidar(camera)


def _fisheye(drive: _Drive, camera: str) -> tuple[Camera, Float]:
    """Return a side camera, and camera_from_lidar."""
    path = drive.root / "calibration" / f"{camera}.yaml"
    text = re.sub(r"\A%YAML[^\n]*\n", "", read_text(path, "calibration file"))
    value = parse_yaml(_NO_BLANK.sub(r"\1: ", text), "calibration file", path)
    if not isinstance(value, Mapping) or value.get("model_type") != "MEI":
        model = value.get("model_type") if isinstance(value, Mapping) else value
        fault = "the file is not a fisheye of the unified model"
        raise InputError(fault, where=path, expected="model_type: MEI", got=model)
    numbers = [_number(value, (f"{group}_parameters", key), path) for group, keys in _LENS.items() for key in keys]
    width, height = (int(_number(value, (f"image_{side}",), path)) for side in ("width", "height"))
    with naming(path):
        return mei_camera(MeiLens(*numbers), width, height), drive.camera_from_lidar(camera)


def _number(value: Any, keys: tuple[str, ...], path: Path) -> float:
    """Return a finite number of nested mappings; YAML reads 1e-3 as text."""
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    with suppress(ValueError):
        value = float(value) if isinstance(value, str) else value
    return float(finite_number(value, ".".join(keys), path))


METHOD = Method(
    name="kitti-360",
    build=build,
    options=Kitti360Options,
    summary="KITTI-360: rectified front cameras, side fisheyes, raw sweeps compensated with the vehicle's poses.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Liao, Xie, Geiger: KITTI-360: a novel dataset and benchmarks for urban scene understanding. PAMI 2022",
    recognises=layout("data_3d_raw"),
)
