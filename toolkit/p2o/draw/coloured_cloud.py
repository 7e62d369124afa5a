"""Write the sweep with the colours of the image as a .ply file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Bool, Float, UInt8, checked
from p2o.files.whole_file import write_whole
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.visibility import hidden

GREY = (110, 110, 110)
"""Colour of points that are not visible in the image."""


def colours_of(rgb: UInt8, cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> tuple[UInt8, Bool]:
    """Return the colour (N, 3) of the pixel of each point at a pose (4, 4), and which points (N,) are visible.

    Points outside the image and occluded points are `GREY`. Raises InputError if the image does not fit the camera.
    """
    image = checked("the image", rgb, (camera.height, camera.width, 3), np.uint8)
    uv = camera.project(se3.apply(camera_from_lidar, cloud.xyz))
    seen = camera.in_image(uv)
    seen &= ~hidden(cloud.xyz, cloud.xyz, camera, camera_from_lidar)
    colours = np.full((len(cloud), 3), GREY, np.uint8)
    # Points up to half a pixel beyond the centre of the last pixel are inside the image.
    u, v = np.clip(np.rint(uv[seen]).astype(np.int64), 0, [camera.width - 1, camera.height - 1]).T
    colours[seen] = image[v, u]
    return colours, seen


def write_coloured_cloud(path: Path | str, rgb: UInt8, cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> None:
    """Write the sweep in the LiDAR's frame, in metres, as binary PLY: x y z, red green blue, intensity if it has any.

    Raises InputError as `colours_of`, and if the file cannot be written.
    """
    colours, _ = colours_of(rgb, cloud, camera, camera_from_lidar)
    columns = dict(zip(("x", "y", "z"), cloud.xyz.T, strict=True))
    columns |= dict(zip(("red", "green", "blue"), colours.T, strict=True))
    columns |= {} if cloud.intensity is None else {"intensity": cloud.intensity}
    comment = "LiDAR frame, metres; colours of the image, grey where the point is not visible"
    write_whole(path, ply_bytes(columns, comment))


def ply_bytes(columns: Mapping[str, Any], *comments: str) -> bytes:
    """Return points as binary PLY; `columns` are arrays (N,) by property: uint8, or numbers written as 32 bit."""
    kinds = {name: "u1" if np.asarray(column).dtype == np.uint8 else "<f4" for name, column in columns.items()}
    table = np.zeros(len(next(iter(columns.values()))), np.dtype(list(kinds.items())))
    for name, column in columns.items():
        table[name] = column
    properties = [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds.items()]
    remarks = [f"comment {comment}" for comment in comments]
    head = ["ply", "format binary_little_endian 1.0", *remarks, f"element vertex {len(table)}"]
    return ("\n".join([*head, *properties, "end_header"]) + "\n").encode() + table.tobytes()
