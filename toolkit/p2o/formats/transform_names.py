"""Keys that say by their name which way a transform goes, and the pose below them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.pose_text import read_pose

CAMERA_FROM_LIDAR = ("camera_from_lidar", "T_cam_lidar", "T_camera_lidar", "lidar_to_camera")
LIDAR_FROM_CAMERA = ("lidar_from_camera", "T_lidar_cam", "T_lidar_camera", "camera_to_lidar")
"""`T_b_a` and `b_from_a` take points of a to b (Kalibr, Koide, p2o); "a to b" says the same aloud."""


def named_transform(tree: Mapping[str, Any], where: Path, within: str = "") -> tuple[Float, tuple[str, ...]] | None:
    """Return camera_from_lidar (4, 4) and remarks, of the key that states it or its inverse; None without such a key.

    Raises InputError for a value that is no rigid transform, and where two keys contradict each other.
    """
    found: list[tuple[str, Float, tuple[str, ...]]] = []
    for key in (*CAMERA_FROM_LIDAR, *LIDAR_FROM_CAMERA):
        if key in tree:
            pose, remarks = read_pose(f"{within}.{key}" if within else key, tree[key], where)
            found.append((key, se3.inverse(pose) if key in LIDAR_FROM_CAMERA else pose, remarks))
    for key, pose, _ in found[1:]:
        check_same(found[0][0], found[0][1], key, pose, where)
    return found[0][1:] if found else None


def check_same(name: str, pose: Float, other_name: str, other: Float, where: object) -> None:
    """Raise InputError where two forms of one camera_from_lidar (4, 4) in a file are not the same transform."""
    between = se3.inverse(pose) @ other
    angle_deg, shift_m = se3.angle_deg(between), se3.distance_m(between)
    # Rounded to four digits, as people write them.
    if angle_deg > 0.02 or shift_m > 1e-3 * (1 + se3.distance_m(pose)):
        raise InputError(
            f"{name} and {other_name} are not the same transform",
            where=where,
            expected="one transform, however it is told",
            got=f"{angle_deg:.3g} deg and {shift_m:.3g} m between them",
        )
