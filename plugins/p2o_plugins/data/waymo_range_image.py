"""Range images of the Waymo Open Dataset: a pixel is a beam of a row at an azimuth, and where the car was at its time.

As the public code decodes them (waymo-research/waymo-open-dataset, src/waymo_open_dataset/utils/range_image_utils.py
and transform_utils.py, v2/perception/lidar.py and context.py): row 0 is the highest beam; azimuths fall from pi to -pi
over the columns, less the azimuth of the LiDAR's mounting; the pose of a pixel is world_from_vehicle as roll, pitch,
yaw (Rz Ry Rx) and place.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float, Int

LENS = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
SHUTTER = "rolling_shutter_direction"
VELOCITY = tuple(f"velocity.{kind}_velocity.{axis}" for kind in ("linear", "angular") for axis in "xyz")
STAMPS = (
    "pose_timestamp",
    "rolling_shutter_params.camera_trigger_time",
    "rolling_shutter_params.camera_readout_done_time",
)
"""What segments tell of cameras and images, in the words of v2."""
MAX_PIXELS = 1 << 22


def grid(values: Any, sizes: Sequence[int], channels: int, where: Path) -> Any:
    """Return the pixels (H, W, channels) of a range image; raises InputError where values and sizes are none."""
    good = len(sizes) == 3 and min(sizes) > 0 and sizes[2] == channels and sizes[0] * sizes[1] <= MAX_PIXELS
    if not good or not isinstance(values, np.ndarray) or values.size != sizes[0] * sizes[1] * channels:
        raise InputError(
            "this is no range image",
            where=where,
            expected=f"height x width x {channels} numbers",
            got=f"{values.size if isinstance(values, np.ndarray) else 'no'} numbers of the shape {list(sizes)}"[:80],
        )
    return values.reshape(sizes)


def uniform_inclinations(lowest: float, highest: float, height: int) -> Float:
    """Return inclinations (H,) in radians of rows between two bounds, lowest first, each in the middle of its band."""
    middles: Float = (0.5 + np.arange(height)) / height
    return lowest + middles * (highest - lowest)


def points_of(range_m: Float, inclination: Float, vehicle_from_lidar: Float) -> tuple[Float, Int, Int]:
    """Return the returns of a range image (H, W) in metres, in the frame of the LiDAR at each one's time.

    `inclination` (H,) in radians is that of each row, row 0 first. Returned are points (N, 3) of pixels whose range is
    more than zero, and their rows and columns (N,).
    """
    row, column = np.nonzero(range_m > 0)
    width = range_m.shape[1]
    mounted = np.arctan2(vehicle_from_lidar[1, 0], vehicle_from_lidar[0, 0])
    azimuth = ((width - column - 0.5) / width * 2 - 1) * np.pi - mounted
    flat = np.cos(inclination[row])
    ray = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(inclination[row])], axis=1)
    return range_m[row, column][:, None] * ray, row, column


def to_world(xyz: Float, poses: Any) -> Float:
    """Return points (N, 3) of the vehicle's frame in the world, each by its own pose (N, 6): roll, pitch, yaw, x, y, z.

    Angles are in radians, places in metres.
    """
    from scipy.spatial.transform import Rotation

    poses = np.asarray(poses, dtype=np.float64)
    turned = np.full(xyz.shape, np.nan)
    good = np.isfinite(poses).all(axis=1)
    # Lower case: axes that stay, which is Rz Ry Rx.
    turned[good] = Rotation.from_euler("xyz", poses[good, :3]).apply(xyz[good])
    return np.asarray(turned + poses[:, 3:])
