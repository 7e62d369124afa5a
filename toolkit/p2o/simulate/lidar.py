"""A spinning LiDAR: beams as data, and the sweep they take of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o import se3
from p2o.arrays import Float
from p2o.cloud import Cloud
from p2o.errors import InputError
from p2o.simulate.scene import Scene


@dataclass(frozen=True)
class SpinningLidar:
    """Beams that turn about z, counter-clockwise seen from above; LiDAR frame x forward, y left, z up.

    Beam i leaves the axis at height `height_m[i]` with `elevation_deg[i]`, highest ring first; `columns` firings a
    turn, one turn in `turn_s` seconds with time 0 straight ahead; nothing is returned beyond `max_range_m`.

    Raises InputError if there are no beams, or not one height a beam.
    """

    name: str
    elevation_deg: tuple[float, ...]
    height_m: tuple[float, ...]
    columns: int
    turn_s: float = 0.1
    max_range_m: float = 80.0

    def __post_init__(self) -> None:
        if not self.elevation_deg or len(self.elevation_deg) != len(self.height_m):
            raise InputError(
                "a LiDAR needs one height for each of its beams",
                where=self.name,
                expected=f"{len(self.elevation_deg) or 'some'} heights",
                got=len(self.height_m),
            )


# fmt: off
_KITTI_ELEVATION_DEG = (
    1.937, 1.574, 1.305, 0.872, 0.579, 0.181, -0.089, -0.452, -0.803, -1.201, -1.494, -1.833, -2.208, -2.547, -2.874,
    -3.236, -3.539, -3.936, -4.216, -4.588, -4.914, -5.251, -5.611, -5.958, -6.329, -6.676, -6.999, -7.287, -7.679,
    -8.058, -8.310, -8.711, -9.026, -9.574, -10.062, -10.471, -10.957, -11.599, -12.115, -12.562, -13.041, -13.485,
    -14.048, -14.598, -15.189, -15.657, -16.177, -16.554, -17.187, -17.730, -18.323, -18.797, -19.320, -19.736,
    -20.223, -20.788, -21.318, -21.936, -22.438, -22.856, -23.322, -23.970, -24.506, -24.999,
)
# fmt: on

HDL64E = SpinningLidar(
    name="HDL-64E of KITTI",
    elevation_deg=_KITTI_ELEVATION_DEG,
    height_m=tuple(np.concatenate([np.linspace(0.209, 0.198, 32), np.linspace(0.126, 0.116, 32)]).tolist()),
    columns=2000,
)
"""KITTI's own Velodyne, fitted to its raw sweeps: z = d tan(elevation) + height for every ring, to 0.5 mm."""


def sweep(
    scene: Scene, lidar: SpinningLidar, world_from_lidar: Float, rng: np.random.Generator, *, noise_m: float = 0.0
) -> Cloud:
    """Return what a LiDAR at world_from_lidar (4, 4) measures in one turn, standing still.

    Points come as KITTI writes them: ring by ring, highest first, each from straight ahead counter-clockwise; missing
    returns are absent. `noise_m` is the standard deviation of the range. Gives `ring`, `column`, `time_s` relative to
    straight ahead (-turn/2 to turn/2) and `intensity`, reflectance times the cosine of incidence.

    Raises InputError where no beam meets anything.
    """
    beams = len(lidar.elevation_deg)
    azimuth = 2 * np.pi * np.arange(lidar.columns) / lidar.columns
    elevation = np.radians(lidar.elevation_deg)[:, None]
    directions = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation), (beams, lidar.columns)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    origins = np.zeros_like(directions)
    origins[:, 2] = np.repeat(lidar.height_m, lidar.columns)

    world_directions = directions @ world_from_lidar[:3, :3].T
    hits = scene.cast(se3.apply(world_from_lidar, origins), world_directions)
    # Drawn for every ray, so that the noise of one point does not depend on what the others meet.
    noise = noise_m * rng.standard_normal(len(directions))
    rows = np.flatnonzero(hits.distance_m <= lidar.max_range_m)
    if not len(rows):
        raise InputError("the LiDAR meets nothing", where=lidar.name, hint="is it inside of a solid, or far away?")
    facing = np.abs(np.einsum("ni,ni->n", scene.face_normals[hits.face[rows]], world_directions[rows]))
    (reflectance,) = scene.material_table(("reflectance",))
    column = rows % lidar.columns
    turned = (column + lidar.columns // 2) % lidar.columns - lidar.columns // 2
    return Cloud(
        origins[rows] + (hits.distance_m[rows] + noise[rows])[:, None] * directions[rows],
        ring=rows // lidar.columns,
        column=column,
        time_s=turned / lidar.columns * lidar.turn_s,
        intensity=np.clip(reflectance[scene.part_of_face[hits.face[rows]]] * facing, 0.0, 1.0),
    )
