"""Writes small KITTI trees with a synthetic rig, so that no file of KITTI is needed to test the readers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from p2o import se3

WIDTH, HEIGHT = 64, 32
DAY = "2020_01_02"
# A camera looking along +x of the LiDAR, a little turned, a little away.
VELO_TO_CAM = se3.make(
    se3.exp(np.array([0.01, -0.02, 0.015, 0, 0, 0]))[:3, :3] @ np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    [0.02, -0.08, -0.27],
)
IMU_TO_VELO = se3.make(np.eye(3), [-0.8, 0.3, -0.8])
R_RECT = se3.exp(np.array([0.003, -0.004, 0.01, 0, 0, 0]))
# The fourth columns have all three entries, as KITTI's do: the shortcut of pykitti is then not exact.
PROJECTIONS = {
    number: np.array([[50.0, 0, 31.0, p[0]], [0, 50.0, 15.5, p[1]], [0, 0, 1, p[2]]])
    for number, p in enumerate([(0.0, 0.0, 0.0), (-27.0, 0.0, 0.0), (3.0, 0.2, 0.003), (-24.0, 0.5, 0.003)])
}
BASELINE_M = (27.0) / 50.0


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.12e}" for v in np.ravel(values))


def write_lines(path: Path, lines: Mapping[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))


def write_image(
    path: Path, *, grey: bool = False, size: tuple[int, int] = (WIDTH, HEIGHT), seed: int = 0
) -> np.ndarray:
    """Write random pixels and return them as RGB (or grey)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = (size[1], size[0]) if grey else (size[1], size[0], 3)
    pixels = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    assert cv2.imwrite(str(path), pixels if grey else pixels[:, :, ::-1])
    return pixels


def sweep(rings: int = 64, columns: int = 120) -> np.ndarray:
    """Return points (N, 4) float32 on a cylinder of 10 m, in the order of KITTI's files."""
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False) + 1e-3
    height = np.linspace(1.0, -3.0, rings)
    grid = np.broadcast_arrays(10 * np.cos(azimuth), 10 * np.sin(azimuth), height[:, None], 0.5)
    return np.stack(grid, axis=-1).reshape(-1, 4).astype(np.float32)


def write_sweep(path: Path, points: np.ndarray | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    (sweep() if points is None else points).astype("<f4").tofile(path)


def calib_cam_to_cam() -> dict[str, object]:
    lines: dict[str, object] = {"calib_time": "02-Jan-2020 10:00:00"}
    for number, projection in PROJECTIONS.items():
        lines[f"S_{number:02d}"] = f"{WIDTH + 6} {HEIGHT + 4}"
        lines[f"K_{number:02d}"] = numbers(np.array([[60.0, 0, 34], [0, 61.0, 17], [0, 0, 1]]))
        lines[f"D_{number:02d}"] = "-0.3 0.1 0.001 -0.002 -0.01"
        lines[f"R_{number:02d}"] = numbers(se3.exp(np.array([0.01 * number, 0, 0, 0, 0, 0]))[:3, :3])
        lines[f"T_{number:02d}"] = f"{-0.1 * number} 0.01 0.02"
        lines[f"S_rect_{number:02d}"] = f"{WIDTH} {HEIGHT}"
        lines[f"R_rect_{number:02d}"] = numbers(R_RECT[:3, :3])
        lines[f"P_rect_{number:02d}"] = numbers(projection)
    return lines


def write_day(root: Path) -> Path:
    """Write the calibration files of the day and return its folder."""
    day = root / DAY
    write_lines(day / "calib_cam_to_cam.txt", calib_cam_to_cam())
    for name, transform in (("velo_to_cam", VELO_TO_CAM), ("imu_to_velo", IMU_TO_VELO)):
        lines = {"calib_time": "x", "R": numbers(transform[:3, :3]), "T": numbers(transform[:3, 3])}
        write_lines(day / f"calib_{name}.txt", lines)
    return day


def write_raw_frame(day: Path, drive: str = "0001", frame: int = 0, camera: int = 2, kind: str = "sync") -> Path:
    """Write one frame (image and sweep) of a drive and return the drive's folder."""
    folder = day / f"{DAY}_drive_{drive}_{kind}"
    write_image(folder / f"image_{camera:02d}/data/{frame:010d}.png", grey=camera < 2, seed=frame)
    write_sweep(folder / f"velodyne_points/data/{frame:010d}.bin")
    return folder


def write_oxts(folder: Path, frame: int, **values: float) -> None:
    """Write one packet; values by the names of KITTI's dataformat.txt, all others 0."""
    order = "lat lon alt roll pitch yaw vn ve vf vl vu ax ay az af al au wx wy wz wf wl wu"
    path = folder / f"oxts/data/{frame:010d}.txt"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(" ".join(str(values.get(name, 0.0)) for name in order.split()) + " 0.05 0.01 4 10 4 4 0\n")


def stamps(seconds: np.ndarray | list[float]) -> str:
    """Return lines of time stamps that lie `seconds` after a full minute."""
    return "".join(f"{DAY.replace('_', '-')} 10:00:{s:012.9f}\n" for s in seconds)
