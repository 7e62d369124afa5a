"""Is a start pose camera_from_lidar, or by mistake its inverse?"""

from __future__ import annotations

from p2o import Camera, Cloud, InputError, se3
from p2o.arrays import Float

_HINT = "give its inverse, the pose that takes LiDAR points to the camera (x right, y down, z forward)"


def check_direction(
    cloud: Cloud, camera: Camera, camera_from_lidar: Float, *, name: str = "start", where: object = None
) -> tuple[str, ...]:
    """Return warnings about a pose (4, 4) that may be lidar_from_camera, or that shows no point at all.

    Certain is only a pose that shows (next to) nothing while its inverse shows many points. A sweep all around lies
    in the image either way; then a pose whose inverse stands upright (LiDAR z up, camera y down) while it does not
    itself is worth a warning: a camera turned by a quarter around its axis looks the same.

    Raises InputError in the certain case.
    """
    lidar_from_camera = se3.inverse(camera_from_lidar)
    seen = _seen(cloud, camera, camera_from_lidar)
    seen_inverse = _seen(cloud, camera, lidar_from_camera)
    if seen_inverse >= max(20, 0.01 * len(cloud)) and seen < 0.01 * seen_inverse:
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
    # Row 1, column 2: how much the LiDAR's up points to the camera's down.
    if seen_inverse and lidar_from_camera[1, 2] < -0.9 and abs(camera_from_lidar[1, 2]) < 0.5:
        return (f"{prefix}{name} may be lidar_from_camera: its inverse stands upright; if so, {_HINT}",)
    return ()


def _seen(cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> int:
    return int(camera.in_image(camera.project(se3.apply(camera_from_lidar, cloud.xyz))).sum())
