"""A small tree of nuScenes' true format, written by hand: two scenes, two cameras, key frames and images between."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, se3

from .drive import OPTICAL, picture, wxyz

K = [[30.0, 0.0, 15.5], [0.0, 31.0, 11.5], [0.0, 0.0, 1.0]]
CAMERA = Camera.pinhole(30, 31, 15.5, 11.5, 32, 24)
START_US = 1_532_402_927_600_000
EGO_FROM = {
    "CAM_FRONT": se3.make(OPTICAL, [1.7, 0.0, 1.5]),
    "CAM_BACK": se3.make([[0, 0, -1], [1, 0, 0], [0, -1, 0]], [0.0, 0.0, 1.5]),
    "LIDAR_TOP": se3.make([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [0.9, 0.0, 1.8]),
}
WORLD = np.random.default_rng(0).uniform([-30, -30, 0], [60, 30, 6], (300, 3))


def world_from_ego(time_us: int) -> Any:
    """Return where the car is: it goes 9 m/s and turns left."""
    seconds = (time_us - START_US) * 1e-6
    return se3.make(translation=[411.0, 1180.0, 0.0]) @ se3.exp(np.array([0, 0, 0.3, 9, 0, 0]) * seconds)


def points_of(time_us: int) -> Any:
    lidar_from_world = se3.inverse(world_from_ego(time_us) @ EGO_FROM["LIDAR_TOP"])
    return se3.apply(lidar_from_world, WORLD + [411, 1180, 0]).astype(np.float32)


class Tree:
    """Records, written by `write`; tests change them before."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.tables: dict[str, list[dict[str, Any]]] = {
            "scene": [{"token": "s1", "name": "scene-0061"}, {"token": "s2", "name": "scene-0103"}],
            "sample": [],
            "sample_data": [],
            "calibrated_sensor": [],
            "sensor": [],
            "ego_pose": [],
        }
        for channel, pose in EGO_FROM.items():
            modality = "lidar" if channel == "LIDAR_TOP" else "camera"
            self.tables["sensor"].append({"token": f"sensor-{channel}", "channel": channel, "modality": modality})
            self.tables["calibrated_sensor"].append(
                {"token": f"calibrated-{channel}", "sensor_token": f"sensor-{channel}"}
                | {"translation": pose[:3, 3].tolist(), "rotation": wxyz(pose)}
                | {"camera_intrinsic": [] if modality == "lidar" else K}
            )
        for scene, first_us in (("s1", START_US), ("s2", START_US + 60_000_000)):
            for number in range(2):
                sample, later_us = f"{scene}-{number}", number * 500_000
                self.tables["sample"].append({"token": sample, "scene_token": scene})
                self.add(sample, "CAM_FRONT", first_us + later_us + 12_000, key=True)
                self.add(sample, "CAM_BACK", first_us + later_us + 37_000, key=True)
                self.add(sample, "LIDAR_TOP", first_us + later_us + 47_000, key=True)
                self.add(sample, "CAM_FRONT", first_us + later_us + 92_000, key=False)
                self.add(sample, "LIDAR_TOP", first_us + later_us + 97_000, key=False)

    def add(self, sample: str, channel: str, time_us: int, *, key: bool) -> None:
        lidar = channel == "LIDAR_TOP"
        suffix = ".pcd.bin" if lidar else ".jpg"
        file = f"{'samples' if key else 'sweeps'}/{channel}/n015__{channel}__{time_us}{suffix}"
        token = f"{channel}-{time_us}"
        pose = world_from_ego(time_us)
        self.tables["ego_pose"].append(
            {"token": f"pose-{token}", "timestamp": time_us}
            | {"rotation": wxyz(pose), "translation": pose[:3, 3].tolist()}
        )
        self.tables["sample_data"].append(
            {"token": token, "sample_token": sample, "ego_pose_token": f"pose-{token}", "timestamp": time_us}
            | {"calibrated_sensor_token": f"calibrated-{channel}", "is_key_frame": key, "prev": "", "next": ""}
            | {"fileformat": "pcd" if lidar else "jpg", "filename": file}
            | {"height": 0 if lidar else 24, "width": 0 if lidar else 32}
        )
        path = self.root / file
        if lidar:
            path.parent.mkdir(parents=True, exist_ok=True)
            rows = np.zeros((len(WORLD), 5), np.float32)
            rows[:, :3], rows[:, 3], rows[:, 4] = points_of(time_us), np.arange(300) % 256, np.arange(300) % 32
            path.write_bytes(rows.tobytes())
        else:
            picture(path, 32, 24, time_us // 1000 % 256)

    def write(self, version: str = "v1.0-mini") -> Path:
        folder = self.root / version
        folder.mkdir(exist_ok=True)
        for name, records in self.tables.items():
            (folder / f"{name}.json").write_text(json.dumps(records, indent=0))
        return self.root
