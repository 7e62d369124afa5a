"""Write frames in the layout of the data set `kitti-raw`: drives with calibration, oxts packets and disparity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from p2o import Cloud, Float, Frame, Image, InputError
from p2o.reading import moved

from p2o_sim.write.files import numbers, png, require, write_file

_FIRST_DAY = datetime(2026, 1, 1, 12, tzinfo=UTC)
_FRAME_S = 0.1
# Distance in metres of the right camera for frames without a right image, because disparity needs one.
_BASELINE_M = 0.54
# The reader refuses other numbers of rings.
_RINGS = range(32, 65)


def write(frames: Iterable[Frame], root: Path) -> Iterator[str]:
    """Write frames below `root` one by one and yield the name with which `kitti-raw` reads each.

    A day has one calibration: a frame with another camera or extrinsic than the previous one starts a new day. Frames
    with different prefixes, such as drive/0003, belong to different drives. Sweeps are written raw: if the velocity is
    known, the motion compensation of the frame's sweep is reversed, and the velocity is written to the oxts packet.
    Disparity is rounded to 1/256 px; sky becomes unknown, because KITTI's disparity cannot express it.

    Raises InputError for frames that the layout cannot store: without a pinhole camera or ground truth, a sweep
    without 32 to 64 rings, or a moving LiDAR that does not rotate clockwise.
    """
    day, drive, number = -1, 0, 0
    calibration: dict[str, str] = {}
    prefix = ""
    for frame in frames:
        pinhole, truth, ring = frame.camera.is_pinhole, frame.camera_from_lidar, frame.cloud.ring
        data = {"a pinhole camera": pinhole, "the ground truth of the extrinsic": truth, "a ring for every point": ring}
        require("kitti-raw", frame, data)
        # The inertial unit is at the LiDAR.
        poses = {"velo_to_cam": np.asarray(frame.camera_from_lidar), "imu_to_velo": np.eye(4)}
        own = {"cam_to_cam": _cam_to_cam(frame)} | {name: _rigid(pose) for name, pose in poses.items()}
        place = frame.name.rpartition("/")[0]
        if own != calibration:
            day, drive, number = day + 1, 0, 0
        elif place != prefix:
            drive, number = drive + 1, 0
        start = _FIRST_DAY + timedelta(days=day)
        date = start.strftime("%Y_%m_%d")
        if own != calibration:
            for name, text in own.items():
                write_file(root / date / f"calib_{name}.txt", text)
        calibration, prefix = own, place
        _write_frame(root / date / f"{date}_drive_{drive + 1:04d}_sync", frame, number, start)
        yield f"{date}/{drive + 1:04d}/{number:010d}"
        number += 1


def _write_frame(folder: Path, frame: Frame, number: int, start: datetime) -> None:
    image, name = frame.image, f"{number:010d}"
    cloud, turn_s = _as_measured(frame)
    write_file(folder / f"image_02/data/{name}.png", png(image.rgb))
    if image.right is not None:
        write_file(folder / f"image_03/data/{name}.png", png(image.right))
    if image.depth_m is not None:
        write_file(folder / f"disparity/data/{name}.png", png(_disparity(image)))
    if frame.twist is not None:
        write_file(folder / f"oxts/data/{name}.txt", _oxts(frame.twist))
    for stream, shift_s in (("", 0.0), ("_start", -turn_s / 2), ("_end", turn_s / 2)):
        _write_stamps(folder / f"velodyne_points/timestamps{stream}.txt", number, start, shift_s)
    _write_stamps(folder / "image_02/timestamps.txt", number, start, 0.0)
    # Written last, so that the reader skips an interrupted frame.
    write_file(folder / f"velodyne_points/data/{name}.bin", _velodyne(cloud, frame.name))


def _cam_to_cam(frame: Frame) -> str:
    """Return calib_cam_to_cam.txt; cameras 0 and 2 are the left camera, 1 and 3 the right one."""
    fx, fy, cx, cy = frame.camera.params
    size = f"{frame.camera.width} {frame.camera.height}"
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    lines = ["calib_time: 01-Jan-2026 12:00:00", "corner_dist: 0"]
    for camera in range(4):
        shift = (image_baseline(frame.image) if camera % 2 else 0.0) * np.array([-1.0, 0.0, 0.0])
        projection = np.column_stack([intrinsics, intrinsics @ shift])
        arrays = {"K": intrinsics, "D": np.zeros(5), "R": np.eye(3), "T": shift}
        values = {"S": size} | {key: numbers(value) for key, value in arrays.items()}
        values |= {"S_rect": size, "R_rect": numbers(np.eye(3)), "P_rect": numbers(projection)}
        lines += [f"{key}_{camera:02d}: {value}" for key, value in values.items()]
    return "\n".join(lines) + "\n"


def image_baseline(image: Image) -> float:
    """Return the distance in metres between left and right camera; a nominal one without a right image."""
    return _BASELINE_M if image.baseline_m is None else image.baseline_m


def _rigid(transform: Float) -> str:
    return (
        f"calib_time: 01-Jan-2026 12:00:00\nR: {numbers(transform[:3, :3])}\nT: {numbers(transform[:3, 3])}\n"
        "delta_f: 0 0\ndelta_c: 0 0\n"
    )


def _disparity(image: Image) -> np.ndarray:
    """Return the disparity (H, W) uint16 in 1/256 px; 0 (unknown) for sky and for values above 16 bits."""
    scale = 256.0 * image.camera.params[0] * image_baseline(image)
    steps = np.rint(np.nan_to_num(scale / np.asarray(image.depth_m)))
    return np.where(steps < 65536, steps, 0).astype(np.uint16)


def _oxts(twist: Float) -> str:
    """Return a packet of a level unit that points east, so that forward is east and left is north."""
    omega, (forward, left, up) = twist[:3], twist[3:]
    moving = [left, forward, forward, left, up]
    return numbers([*np.zeros(6), *moving, *np.zeros(6), *omega, *omega, *np.zeros(2)]) + " 4 10 4 4 0\n"


def _write_stamps(path: Path, number: int, start: datetime, shift_s: float) -> None:
    """Write the time stamps of frames 0 to `number`, at intervals of 0.1 s."""
    times = [start + timedelta(seconds=_FRAME_S * i + shift_s) for i in range(number + 1)]
    write_file(path, "".join(f"{t:%Y-%m-%d %H:%M:%S}.{t.microsecond:06d}000\n" for t in times))


def _as_measured(frame: Frame) -> tuple[Cloud, float]:
    """Return the sweep as measured by a moving sensor, and the duration of a revolution in seconds."""
    # A point of time t moves by exp(-twist t) from the frame of the sensor at time 0 to that at time t.
    cloud = frame.cloud
    if cloud.time_s is None:
        return cloud, _FRAME_S
    moving = frame.twist is not None and bool(frame.twist.any())
    xyz = moved(np.asarray(frame.twist), -cloud.time_s, cloud.xyz) if moving else cloud.xyz
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    # Clockwise seen from above: the left side (positive azimuth) is measured first.
    sideways = np.abs(azimuth) > 0.1
    turn_s = -2 * np.pi * float(np.median(cloud.time_s[sideways] / azimuth[sideways])) if sideways.any() else _FRAME_S
    if turn_s <= 0 and moving:
        raise InputError(
            "the layout kitti-raw needs a LiDAR that rotates clockwise, because its reader infers times from azimuths",
            where=frame.name,
            hint="write the layout folder, which stores times",
        )
    values = {"ring": cloud.ring, "intensity": cloud.intensity, "time_s": cloud.time_s}
    return Cloud(xyz, **values), abs(turn_s)  # type: ignore[arg-type]


def _velodyne(cloud: Cloud, name: str) -> bytes:
    """Return the .bin file: ring by ring, highest first, each counter-clockwise from straight ahead."""
    if cloud.ring is None:
        raise TypeError("checked before")
    xyz = cloud.xyz.astype(np.float32)
    # As the reader sees them in single precision: rounding must not move a point across straight ahead.
    azimuth = np.mod(np.arctan2(*xyz.astype(np.float64).T[1::-1]), 2 * np.pi)
    rings, label = np.unique(cloud.ring, return_inverse=True)
    rise = np.bincount(label, xyz[:, 2]) / np.bincount(label, np.hypot(xyz[:, 0], xyz[:, 1]))
    # Independent of the sensor's numbering, the highest ring has the steepest returns.
    upwards = rings[-1] != rings[0] and np.corrcoef(np.arange(len(rings)), rise)[0, 1] > 0
    order = np.lexsort((azimuth, -label if upwards else label))
    seen = 1 + int((np.diff(azimuth[order]) < -np.pi).sum())
    if seen != len(rings) or seen not in _RINGS:
        raise InputError(
            "the layout kitti-raw stores no rings: its reader counts where the azimuth restarts",
            where=name,
            expected=f"{_RINGS[0]} to {_RINGS[-1]} rings of full revolutions",
            got=f"{len(rings)} rings, {seen} according to the azimuths",
            hint="write the layout folder, which stores rings",
        )
    intensity = np.zeros(len(xyz)) if cloud.intensity is None else cloud.intensity
    rows: bytes = np.column_stack([xyz, intensity])[order].astype("<f4").tobytes()
    return rows
