"""Is a start pose camera_from_lidar, or by mistake its inverse?

Two things tell. The sweep lies in front of the camera, or it does not; and the world stands upright in the image, as
cameras do, or it lies on its side or on its head. Where up is in the sweep, is told by its points alone, so that the
LiDAR may have any axes. `docs/datasets.md` says how often this notices a swapped pose, and where it cannot: a rotation
that is (nearly) its own inverse looks the same both ways, and only the lever arm tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.camera import Camera

_HINT = "give its inverse, the pose that takes LiDAR points to the camera (x right, y down, z forward)"
# Points that are looked at for the vertical and the fewest that tell it, how much less they spread along it than along
# any other axis, and how near they are, so that hills and towers say little.
_SAMPLE, _FEW, _FLATTER, _NEAR_M = 20_000, 100, 2.0, 30.0
# What tells up from down: edges of the world are never sharper than the first; weight of the mean elevation; the least
# evidence. On 117 sweeps of ten rigs it is 1.06 or more, and never wrong.
_SHARPEST_M, _LOOKS_DOWN, _SURE = 0.01, 10.0, 0.5
# A right start may be 20 deg off, and its camera and its LiDAR tilted: up to the second number it counts as upright.
# Cameras on their side are at 90.
_UPRIGHT_DEG, _NOT_UPRIGHT_DEG, _START_OFF_DEG = 45.0, 52.0, 25.0


@dataclass(frozen=True, eq=False)
class Vertical:
    """Axis (3,) of unit length along which the world stands in a sweep, and whether it is known to point up."""

    axis: Float
    points_up: bool


def check_direction(
    cloud: Cloud, camera: Camera, camera_from_lidar: Float, *, name: str = "start", where: object = None
) -> tuple[str, ...]:
    """Return warnings about a pose (4, 4) that may be lidar_from_camera, or that shows no point at all.

    Certain is only a pose that shows (next to) nothing, nor would if it were turned a little, while its inverse shows
    many points. A sweep all around lies in the image either way; then a pose at which the world lies on its side or on
    its head, while it stands upright at its inverse, is worth a warning: a camera that was turned around its axis looks
    the same.

    Raises InputError in the certain case.
    """
    lidar_from_camera = se3.inverse(camera_from_lidar)
    up = vertical(cloud)
    falls = (
        up is not None
        and _lean_deg(camera_from_lidar, up) > _NOT_UPRIGHT_DEG
        and _lean_deg(lidar_from_camera, up) < _UPRIGHT_DEG
    )
    seen, seen_around = _seen(cloud, camera, camera_from_lidar)
    seen_inverse, _ = _seen(cloud, camera, lidar_from_camera)
    few = 0.01 * seen_inverse
    if seen_inverse >= max(20, 0.01 * len(cloud)) and seen < few and (falls or seen_around < few):
        raise InputError(
            f"{name} looks like lidar_from_camera",
            where=where,
            expected="camera_from_lidar",
            got=f"{seen} points in the image, {seen_inverse} with the inverse",
            hint=_HINT,
        )
    prefix = "" if where is None else f"{where}: "
    if not seen:
        return (f"{prefix}no point of the sweep lies in the image at {name}",)
    if falls and seen_inverse:
        return (f"{prefix}{name} may be lidar_from_camera: its inverse stands upright; if so, {_HINT}",)
    return ()


def vertical(cloud: Cloud) -> Vertical | None:
    """Return the vertical of a sweep in the LiDAR frame, told by its points whatever the axes are; None if they do not.

    Beams spread in azimuth and little in elevation, so that their directions spread least along the vertical. Up is
    where the world ends gradually (roofs, trees), down where it ends at once (the ground), and most sensors look down
    more than up; where the two do not agree it stays open which end is up.
    """
    xyz = cloud.xyz[:: max(1, len(cloud) // _SAMPLE)]
    largest = np.abs(xyz).max(axis=1)
    xyz, largest = xyz[largest > 0], largest[largest > 0]
    if len(xyz) < _FEW:
        return None
    rays = xyz / largest[:, None]  # sized first, as squares of what some files hold are infinite
    length = np.linalg.norm(rays, axis=1)
    rays /= length[:, None]
    spread, axes = np.linalg.eigh(rays.T @ rays)
    if spread[1] < _FLATTER * spread[0]:
        return None
    axis = axes[:, 0]
    elevation = rays @ axis
    range_m = largest * length
    near = range_m < _NEAR_M
    if np.count_nonzero(near) < _FEW:
        return Vertical(axis, points_up=False)
    low, lower, high, higher = np.percentile(elevation[near] * range_m[near], [[1, 2], [5, 10], [90, 95], [98, 99]])
    top, bottom = (np.maximum(edge, _SHARPEST_M) for edge in (np.flip(higher - high), lower - low))
    evidence = 0.5 * float(np.log(top / bottom).sum()) - _LOOKS_DOWN * float(elevation.mean())
    return Vertical(axis * (1 if evidence >= 0 else -1), points_up=abs(evidence) > _SURE)


def _lean_deg(camera_from_lidar: Float, up: Vertical) -> float:
    """Return the angle between the vertical and the camera's -y; to its nearer end where it is open which is up."""
    cosine = -float(camera_from_lidar[1, :3] @ up.axis)
    return float(np.degrees(np.arccos(np.clip(cosine if up.points_up else abs(cosine), -1, 1))))


def _seen(cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> tuple[int, int]:
    """Return how many points lie in the image, and in a cone around it that a start may be off."""
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    inside = camera.in_image(camera.project(xyz))
    right, down = camera.width - 1, camera.height - 1
    corners = camera.rays(np.array([[0.0, 0.0], [right, 0.0], [0.0, down], [right, down]]))[:, 2]
    # Corners that a fisheye does not reach see 90 deg or more.
    half_deg = np.degrees(np.arccos(np.clip(np.nan_to_num(corners).min(), 0, 1)))
    cone = np.cos(np.radians(min(half_deg + _START_OFF_DEG, 180.0)))
    return int(inside.sum()), int((xyz[:, 2] >= cone * np.linalg.norm(xyz, axis=1)).sum())
