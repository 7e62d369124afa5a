"""A small log of Argoverse 2's true format, written by pyarrow alone: tables, sweeps of both LiDARs, two cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import feather

from .drive import OPTICAL, car, mounted, picture, through, tilted, wxyz

LOG = "02678d04-cc9f-3148-9f95-1ba66347dff9"
START_NS = 315_966_070_559_696_000
SECOND = 1_000_000_000
UPSIDE_DOWN = np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]])
EGO_FROM = {
    "ring_front_center": mounted(OPTICAL @ tilted((1, -2, 0.5)), 1.6, 0.0, 1.4),
    "ring_rear_left": mounted(tilted((0, 0, 150)) @ OPTICAL, 1.1, 0.3, 1.4),
    "up_lidar": mounted(tilted((0.3, 0.2, 1.0)), 1.35, 0.0, 1.64),
    "down_lidar": mounted(UPSIDE_DOWN @ tilted((0, 0, 12)), 1.355, 0.0, 1.565),
}
SIZE = {"ring_front_center": (31, 41), "ring_rear_left": (41, 31)}
FOCAL = 33.0
BEAMS_DEG = np.linspace(-25.0, 15.0, 32)


def seconds(time_ns: int) -> float:
    return (time_ns - START_NS) / SECOND


def measured(lidar: str, sweep_ns: int) -> tuple[Any, Any, Any]:
    """Return what a LiDAR measures, (N, 3) in its frame at each point's time, laser numbers 0 to 31 and times in ns."""
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    beam, column = (grid.ravel() for grid in np.meshgrid(np.arange(32), np.arange(90), indexing="ij"))
    elevation, azimuth = np.radians(BEAMS_DEG)[beam], -turn[column]
    ray = np.column_stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    far = 8 + 6 * np.sin(3 * azimuth) ** 2 + 5 * np.cos(5 * azimuth + beam) ** 2
    offset_ns = (column * (SECOND // 900)).astype(np.int32)
    return ray * far[:, None], beam, offset_ns


class Log:
    """A log: what its tables hold may be changed before `write`."""

    def __init__(self, root: Path, name: str = LOG, low_is_up: bool = True, dtype: Any = np.float16) -> None:
        self.root, self.folder, self.low_is_up, self.dtype = root, root / name, low_is_up, dtype
        self.sweeps = [START_NS + number * SECOND // 10 for number in range(3)]
        self.images = [START_NS + 7_000_000 + number * SECOND // 20 for number in range(5)]
        times = np.array(sorted({*self.sweeps, *self.images, START_NS + SECOND // 2}))
        self.poses = {"timestamp_ns": times, **columns([car(seconds(int(time))) for time in times])}
        self.mountings = {"sensor_name": list(EGO_FROM), **columns(list(EGO_FROM.values()))}
        self.intrinsics: dict[str, Any] = {
            "sensor_name": list(SIZE),
            **{name: [FOCAL, FOCAL] for name in ("fx_px", "fy_px")},
            "cx_px": [15.2, 20.3],
            "cy_px": [20.1, 15.4],
            "k1": [-0.3, -0.3],
            "k2": [0.1, 0.1],
            "k3": [0.0, 0.0],
            "height_px": [SIZE[name][1] for name in SIZE],
            "width_px": [SIZE[name][0] for name in SIZE],
        }

    def sweep(self, sweep_ns: int) -> dict[str, Any]:
        """Return a sweep's columns: points in the frame of the car at the sweep's stamp, both LiDARs in one."""
        xyz, laser, offset = [], [], []
        for lidar, first in (("up_lidar", 0 if self.low_is_up else 32), ("down_lidar", 32 if self.low_is_up else 0)):
            points, beam, offset_ns = measured(lidar, sweep_ns)
            back = np.linalg.inv(car(seconds(sweep_ns)))
            for time in np.unique(offset_ns):
                at = offset_ns == time
                car_then = car(seconds(sweep_ns + int(time)))
                points[at] = through(back @ car_then @ EGO_FROM[lidar], points[at])
            xyz.append(points)
            laser.append(beam + first)
            offset.append(offset_ns)
        x, y, z = np.concatenate(xyz).T.astype(self.dtype)
        laser_number = np.concatenate(laser).astype(np.uint8)
        return {
            "x": x,
            "y": y,
            "z": z,
            "intensity": (laser_number * 3).astype(np.uint8),
            "laser_number": laser_number,
            "offset_ns": np.concatenate(offset),
        }

    def write(self) -> Path:
        save(self.folder / "city_SE3_egovehicle.feather", self.poses)
        save(self.folder / "calibration/egovehicle_SE3_sensor.feather", self.mountings)
        save(self.folder / "calibration/intrinsics.feather", self.intrinsics)
        for sweep_ns in self.sweeps:
            save(self.folder / f"sensors/lidar/{sweep_ns}.feather", self.sweep(sweep_ns))
        for camera, (width, height) in SIZE.items():
            for number, image_ns in enumerate(self.images):
                picture(self.folder / f"sensors/cameras/{camera}/{image_ns}.jpg", width, height, 40 * number)
        return self.root


def columns(poses: list[Any]) -> dict[str, Any]:
    quaternions = np.array([wxyz(pose) for pose in poses])
    translations = np.array([pose[:3, 3] for pose in poses])
    rotation = {name: quaternions[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    return rotation | {name: translations[:, i] for i, name in enumerate(("tx_m", "ty_m", "tz_m"))}


def save(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(content), path, compression="zstd")
