"""Range images of the Waymo Open Dataset: a pixel contains the return of one beam at one azimuth.

The decoding follows the public code (waymo-research/waymo-open-dataset, src/waymo_open_dataset/utils/
range_image_utils.py and transform_utils.py, v2/perception/lidar.py and context.py): row 0 is the highest beam; azimuths
decrease from pi to -pi over the columns, minus the yaw of the LiDAR's mounting; the pose of a pixel is
world_from_vehicle as roll, pitch, yaw (Rz Ry Rx) and translation.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Float, InputError, Int

LENS = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
SHUTTER = "rolling_shutter_direction"
VELOCITY = tuple(f"velocity.{kind}_velocity.{axis}" for kind in ("linear", "angular") for axis in "xyz")
STAMPS = ("pose_timestamp", *(f"rolling_shutter_params.camera_{end}_time" for end in ("trigger", "readout_done")))
"""Names of the calibration and image data, as in v2."""
MAX_PIXELS = 1 << 22


def grid(values: Any, sizes: Sequence[int], channels: int, where: Path) -> Any:
    """Return the pixels (H, W, channels) of a range image; raises InputError for invalid values or sizes."""
    good = len(sizes) == 3 and min(sizes) > 0 and sizes[2] == channels and sizes[0] * sizes[1] <= MAX_PIXELS
    if not good or not isinstance(values, np.ndarray) or values.size != sizes[0] * sizes[1] * channels:
        fault = "the data are not a range image"
        got = f"{values.size if isinstance(values, np.ndarray) else 'no'} numbers of shape {list(sizes)}"[:80]
        raise InputError(fault, where=where, expected=f"height x width x {channels} numbers", got=got)
    return values.reshape(sizes)


def uniform_inclinations(lowest: float, highest: float, height: int) -> Float:
    """Return inclinations (H,) in radians, lowest first, as the centres of equal intervals between two bounds."""
    middles: Float = (0.5 + np.arange(height)) / height
    return lowest + middles * (highest - lowest)


def points_of(range_m: Float, inclination: Float, vehicle_from_lidar: Float) -> tuple[Float, Int, Int]:
    """Return the points (N, 3) of a range image (H, W) in metres, with their rows and columns (N,).

    `inclination` (H,) in radians is that of each row. Points are in the frame of the LiDAR at their own times; pixels
    without a positive range are left out.
    """
    row, column = np.nonzero(range_m > 0)
    width = range_m.shape[1]
    mounted = np.arctan2(vehicle_from_lidar[1, 0], vehicle_from_lidar[0, 0])
    azimuth = ((width - column - 0.5) / width * 2 - 1) * np.pi - mounted
    flat = np.cos(inclination[row])
    ray = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(inclination[row])], axis=1)
    return range_m[row, column][:, None] * ray, row, column


def to_world(xyz: Float, poses: Any) -> Float:
    """Transform points (N, 3) of the vehicle's frame to the world, each by its pose (N, 6): roll, pitch, yaw, x, y, z.

    Angles are in radians, translations in metres.
    """
    from scipy.spatial.transform import Rotation

    poses = np.asarray(poses, dtype=np.float64)
    turned = np.full(xyz.shape, np.nan)
    good = np.isfinite(poses).all(axis=1)
    # Lower case means fixed axes: Rz Ry Rx.
    turned[good] = Rotation.from_euler("xyz", poses[good, :3]).apply(xyz[good])
    return np.asarray(turned + poses[:, 3:])
