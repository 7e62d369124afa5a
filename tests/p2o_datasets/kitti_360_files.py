"""A small drive of KITTI-360's true format, written by hand: calibration, poses, raw sweeps, four cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .drive import OPTICAL, car, mounted, picture, tilted

DRIVE = "2013_05_28_drive_0000_sync"
TURN_S = 0.1036
# Mountings on the GPS/IMU unit, x forward, y right, z down there; here forward, left, up.
BODY_FROM = {
    "image_00": mounted(OPTICAL @ tilted((0.5, -1, 0.3)), 0.9, 0.3, 1.2),
    "image_01": mounted(OPTICAL @ tilted((0.2, 1, -0.4)), 0.9, -0.3, 1.2),
    "image_02": mounted(tilted((0, 0, 90)) @ OPTICAL @ tilted((2, 0, 0)), 0.5, 0.6, 1.3),
    "image_03": mounted(tilted((0, 0, -90)) @ OPTICAL @ tilted((2, 0, 0)), 0.5, -0.6, 1.3),
}
VELO_FROM_CAM0 = mounted(OPTICAL @ tilted((-0.4, 0.6, 0.2)), 0.8, 0.3, -0.3)
BODY_FROM_VELO = BODY_FROM["image_00"] @ np.linalg.inv(VELO_FROM_CAM0)
R_RECT = {"00": tilted((0.3, -0.2, 0.5)), "01": tilted((-0.3, 0.4, -0.2))}
P_RECT = {"00": (55.0, 68.2, 23.9, 0.0), "01": (55.0, 68.2, 23.9, -33.0)}
SIZE, FISHEYE_SIZE = (140, 47), (140, 140)
MEI = {"xi": 2.2134047507854890, "k1": 0.016798235660113681, "k2": 1.6548773243373522}
MEI |= {"p1": 4.2223943394772046e-04, "p2": 4.2462134260997584e-04}
MEI |= {"gamma1": 133.63220825849971, "gamma2": 133.57883350012958, "u0": 71.694323510126321, "v0": 70.576498308221585}


def measured() -> tuple[Any, Any]:
    """Return a sweep as the Velodyne measures it, (N, 3) ring by ring, and the azimuths (N,) in -pi to pi."""
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False) + 1e-3
    rise = np.radians(np.linspace(2, -24, 64))
    azimuth = np.tile(turn, 64)
    elevation = np.repeat(rise, 100)
    far = 9 + 4 * np.sin(3 * azimuth) ** 2
    ray = np.column_stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return (ray * far[:, None]).astype(np.float32), np.mod(azimuth + np.pi, 2 * np.pi) - np.pi


def lidar(frame: float) -> Any:
    """Return world_from_lidar (4, 4) some frames after the first."""
    return car(frame * TURN_S) @ BODY_FROM_VELO


class Drive:
    """Texts of the files; tests change them before `write`."""

    def __init__(self, root: Path, name: str = DRIVE) -> None:
        self.root, self.name = root, name
        self.frames = [3, 4, 5]
        inner = {
            f"image_{number}": " ".join(f"{value:.12e}" for value in BODY_FROM[f"image_{number}"][:3].ravel())
            for number in ("00", "01", "02", "03")
        }
        lines = ["calib_time: 25-May-2012 16:47:16", "corner_dist: 9.950000e-02"]
        for number, (focal, u, v, shift) in P_RECT.items():
            rectified = " ".join(f"{value:.12e}" for value in R_RECT[number].ravel())
            lines += [
                f"S_{number}: 1.392000e+03 5.120000e+02",
                f"S_rect_{number}: {SIZE[0]:e} {SIZE[1]:e}",
                f"R_rect_{number}: {rectified}",
                f"P_rect_{number}: {focal} 0 {u} {shift} 0 {focal} {v} 0 0 0 1 0",
            ]
        fisheye = (
            "%YAML:1.0\n---\nmodel_type: MEI\ncamera_name: {name}\n"
            f"image_width: {FISHEYE_SIZE[0]}\nimage_height: {FISHEYE_SIZE[1]}\n"
            f"mirror_parameters:\n   xi: {MEI['xi']:.16e}\n"
            f"distortion_parameters:\n   k1: {MEI['k1']:.16e}\n   k2:{MEI['k2']:.16e}\n"
            f"   p1: {MEI['p1']:.16e}\n   p2: {MEI['p2']:.16e}\n"
            f"projection_parameters:\n   gamma1: {MEI['gamma1']:.16e}\n   gamma2: {MEI['gamma2']:.16e}\n"
            f"   u0: {MEI['u0']:.16e}\n   v0: {MEI['v0']:.16e}\n"
        )
        stamps = [f"2013-05-28 08:46:{TURN_S * frame:012.9f}" for frame in range(8)]
        poses = [
            " ".join([str(frame), *(f"{value:.12e}" for value in car(frame * TURN_S)[:3].ravel())])
            for frame in (1, 3, 4, 6, 7)
        ]
        self.texts = {
            "calibration/calib_cam_to_pose.txt": "".join(f"{key}: {value}\n" for key, value in inner.items()),
            "calibration/calib_cam_to_velo.txt": " ".join(f"{value:.12e}" for value in VELO_FROM_CAM0[:3].ravel())
            + "\n",
            "calibration/perspective.txt": "\n".join(lines) + "\n",
            "calibration/image_02.yaml": fisheye.replace("{name}", "image_02"),
            "calibration/image_03.yaml": fisheye.replace("{name}", "image_03"),
            f"data_3d_raw/{name}/velodyne_points/timestamps.txt": "\n".join(stamps) + "\n",
            f"data_poses/{name}/poses.txt": "\n".join(poses) + "\n",
        }

    def write(self) -> Path:
        for name, text in self.texts.items():
            path = self.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        points, _ = measured()
        for frame in self.frames:
            sweep = self.root / f"data_3d_raw/{self.name}/velodyne_points/data/{frame:010d}.bin"
            sweep.parent.mkdir(parents=True, exist_ok=True)
            np.column_stack([points, np.full(len(points), 0.5)]).astype(np.float32).tofile(sweep)
            for camera in BODY_FROM:
                kind, size = ("data_rect", SIZE) if camera in ("image_00", "image_01") else ("data_rgb", FISHEYE_SIZE)
                folder = self.root / "data_2d_raw" / self.name / camera
                picture(folder / kind / f"{frame:010d}.png", *size, 20 * frame)
        return self.root
