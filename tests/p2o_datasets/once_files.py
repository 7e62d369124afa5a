"""A small sequence of ONCE's true format, written by hand: one JSON file, pictures and sweeps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .drive import OPTICAL, car, mounted, picture, through, tilted, walls, wxyz

SEQUENCE = "000027"
START_MS = 1_616_100_800_400
SIZE = (96, 51)
# The LiDAR's x points left, y back, z up; seen from the car (forward, left, up).
CAR_FROM_LIDAR = mounted([[0, -1, 0], [1, 0, 0], [0, 0, 1]], 0.8, 0.0, 1.9)
CAR_FROM = {
    "cam01": mounted(OPTICAL @ tilted((0.5, 1, -0.3)), 1.7, 0.1, 1.5),
    "cam09": mounted(tilted((0, 0, 180)) @ OPTICAL, -0.4, 0.0, 1.5),
}
K = [[60.0, 0.0, 47.2], [0.0, 61.0, 25.1], [0.0, 0.0, 1.0]]
D = {"cam01": [-0.12, 0.03, 0.001, -0.002, 0.01], "cam09": [-0.1, 0.02, 0.0, 0.001, 0.0, 0.02, 0.01, 0.001]}


def world_from_lidar(frame_ms: int) -> Any:
    return car((frame_ms - START_MS) / 1000) @ CAR_FROM_LIDAR


def points(frame_ms: int) -> Any:
    return through(np.linalg.inv(world_from_lidar(frame_ms)), walls(600)).astype(np.float32)


class Sequence:
    """What the JSON file holds; tests change it before `write`."""

    def __init__(self, root: Path, name: str = SEQUENCE) -> None:
        self.root, self.name = root, name
        self.times = [START_MS + 500 * number for number in range(3)]
        first = np.linalg.inv(world_from_lidar(START_MS))
        frames = []
        for time in self.times:
            w, x, y, z = wxyz(first @ world_from_lidar(time))
            place = (first @ world_from_lidar(time))[:3, 3]
            frames.append({"sequence_id": name, "frame_id": str(time), "pose": [x, y, z, w, *place.tolist()]})
        self.content: dict[str, Any] = {
            "meta_info": {"weather": "sunny", "period": "morning"},
            "calib": {
                camera: {
                    "cam_to_velo": (np.linalg.inv(CAR_FROM_LIDAR) @ pose).tolist(),
                    "cam_intrinsic": [list(row) for row in K],
                    "distortion": list(D[camera]),
                }
                for camera, pose in CAR_FROM.items()
            },
            "frames": frames,
        }

    def write(self) -> Path:
        folder = self.root / "data" / self.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{self.name}.json").write_text(json.dumps(self.content))
        for number, time in enumerate(self.times):
            for camera in CAR_FROM:
                picture(folder / camera / f"{time}.jpg", *SIZE, 50 * number)
            (folder / "lidar_roof").mkdir(exist_ok=True)
            rows = np.column_stack([points(time), np.arange(600) % 256]).astype(np.float32)
            rows.tofile(folder / "lidar_roof" / f"{time}.bin")
        return self.root
