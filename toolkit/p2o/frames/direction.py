"""Detect a pose that is lidar_from_camera instead of camera_from_lidar, in millimetres, or of a reordered quaternion.

There are two criteria: whether the sweep projects into the image, and whether the vertical of the scene is upright in
the image. The vertical is estimated from the points of the sweep, for any axes of the LiDAR. The inverse of a
rotation that is (nearly) its own inverse cannot be detected (docs/datasets.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.camera import Camera

_HINT = "give its inverse, the pose that takes LiDAR points to the camera (x right, y down, z forward)"
_REORDERED = "write its quaternion in the other order (p2o and ROS have x y z w, others w x y z)"
_MILLIMETRES = "if it is in millimetres, divide it by 1000"
# Estimate of the vertical: maximum and minimum number of points, minimum ratio of the scatter along other axes to that
# along the vertical, and maximum range, which excludes hills and towers.
_SAMPLE, _FEW, _FLATTER, _NEAR_M = 20_000, 100, 2.0, 30.0
# Sign of the vertical: minimum width of the percentile ranges and minimum evidence. The mean elevation is no criterion,
# because some sensors observe more points above (Livox Mid-360).
_SHARPEST_M, _SURE = 0.01, 0.5
# A ceiling ends the scene as abruptly as the ground. A scene without one ends gradually on one side, within more than
# this width, or has at least this share of its points beyond this range.
_GRADUAL_M, _OPEN_SHARE, _OPEN_M = 1.0, 0.25, 10.0
# Angles of the camera to the vertical: a correct initial guess may have an error of 20 deg and tilted sensors; a camera
# on its side is at 90 deg.
_UPRIGHT_DEG, _NOT_UPRIGHT_DEG, _START_OFF_DEG = 45.0, 52.0, 25.0
# A random reordered quaternion is rarely within this limit, which is narrower than that of the inverse.
_REORDERED_UPRIGHT_DEG = 25.0
# Share of the points that have to be in the image, and their minimum number, to say what is wrong with a pose.
_SEEN_SHARE, _SEEN = 0.01, 20
_AROUND_SHARE = 0.5
"""A correct pose has at least this ratio of points around its image, within the error of a guess, to those in the image
at its inverse."""
_LONG_M = 30.0
_NEAREST_MEDIAN_M, _FARTHEST_MEDIAN_M = 0.15, 150.0
"""Length of a translation from which it is probably in millimetres: rigs are smaller."""


class Direction(Enum):
    """The plausibility of a pose as camera_from_lidar."""

    PLAUSIBLE = "camera_from_lidar"
    NOTHING_VISIBLE = "no point in the image"
    POSSIBLY_INVERSE = "upright only as lidar_from_camera"
    POSSIBLY_REORDERED = "upright only with the quaternion in the other order"

    def warnings(self, name: str, where: object = None) -> tuple[str, ...]:
        """Return the warnings about the pose `name` from the file `where`."""
        prefix = "" if where is None else f"{where}: "
        if self is Direction.NOTHING_VISIBLE:
            return (f"{prefix}no point of the sweep lies in the image at {name}",)
        if self is Direction.POSSIBLY_REORDERED:
            return (f"{prefix}the scene is not upright or not visible at {name}: unless that is right, {_REORDERED}",)
        if self is Direction.POSSIBLY_INVERSE:
            return (f"{prefix}{name} may be lidar_from_camera: its inverse stands upright; if so, {_HINT}",)
        return ()


@dataclass(frozen=True, eq=False)
class Vertical:
    """Unit vector (3,) along the vertical of the scene in the LiDAR frame; without `points_up` its sign is unknown."""

    axis: Float
    points_up: bool


def check_direction(
    cloud: Cloud,
    camera: Camera,
    camera_from_lidar: Float,
    *,
    name: str = "start",
    where: object = None,
    quaternion: bool = True,
) -> tuple[str, ...]:
    """Return the outcomes of `pose_direction` and `unit_remark` as warnings; raises as `pose_direction`."""
    direction = pose_direction(cloud, camera, camera_from_lidar, name=name, where=where, quaternion=quaternion)
    return (*direction.warnings(name, where), *unit_remark(camera_from_lidar, name, where))


def unit_remark(camera_from_lidar: Float, name: str, where: object = None) -> tuple[str, ...]:
    """Return a warning about a translation of more than 30 m, which is probably in millimetres."""
    length_m = se3.distance_m(camera_from_lidar)
    if length_m < _LONG_M:
        return ()
    prefix = "" if where is None else f"{where}: "
    return (f"{prefix}the translation of {name} is {length_m:.4g} m long: {_MILLIMETRES}",)


def range_remark(cloud: Cloud) -> tuple[str, ...]:
    """Return a warning about a median range that no scene has in metres, with the units in which it is plausible."""
    xyz = cloud.xyz[:: max(1, len(cloud) // _SAMPLE)]
    length = np.abs(xyz).max(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        range_m = length * np.linalg.norm(xyz / length[:, None], axis=1)
    low, median, high = np.nanpercentile(range_m, [1, 50, 99]) if length.any() else (0.0, 1.0, 0.0)
    if _NEAREST_MEDIAN_M <= median <= _FARTHEST_MEDIAN_M:
        return ()
    units = [
        f"{unit} (then {median * scale:.2g} m: cloud_scale: {scale:g} in frame.yaml)"
        for unit, scale in (("millimetres", 1e-3), ("centimetres", 1e-2), ("kilometres", 1e3))
        if 0.3 <= median * scale <= 100
    ]
    advice = f"they are probably in {' or '.join(units)}" if units else "scale the points to metres"
    extent = f"{low:.4g} to {high:.4g} m, median {median:.4g} m"
    return (f"the ranges of the points are {extent}, which no scene has: {advice}",)


def pose_direction(
    cloud: Cloud,
    camera: Camera,
    camera_from_lidar: Float,
    *,
    name: str = "start",
    where: object = None,
    quaternion: bool = True,
) -> Direction:
    """Check whether a pose (4, 4) is lidar_from_camera instead of camera_from_lidar, or projects no point.

    Raises InputError if (nearly) no point projects into the image, and more do at the inverse than any pose within a
    rotation error of 25 deg could show. A sweep of 360 deg projects into the image at both poses: then a scene that is
    upright only at the inverse is POSSIBLY_INVERSE, because a rolled camera gives the same observation. A pose at which
    the scene is upright and visible only if the numbers of its quaternion are read in the other order is
    POSSIBLY_REORDERED, unless its rotation was not given as a `quaternion`.
    """
    lidar_from_camera = se3.inverse(camera_from_lidar)
    up = vertical(cloud)
    leans = up is not None and _lean_deg(camera_from_lidar, up) > _NOT_UPRIGHT_DEG
    falls = leans and up is not None and _lean_deg(lidar_from_camera, up) < _UPRIGHT_DEG
    seen, seen_around = _seen(cloud, camera, camera_from_lidar)
    seen_inverse, _ = _seen(cloud, camera, lidar_from_camera)
    few = _SEEN_SHARE * seen_inverse
    enough = max(_SEEN, _SEEN_SHARE * len(cloud))
    doubted = quaternion and (leans or not seen)
    reordered = doubted and up is not None and _is_reordered(cloud, camera, camera_from_lidar, up, enough)
    if seen_inverse >= enough and seen < few and (falls or seen_around < _AROUND_SHARE * seen_inverse):
        text = f"{name} looks like lidar_from_camera"
        got = f"{seen} points in the image, {seen_inverse} with the inverse"
        hint = f"{_HINT}; or {_REORDERED}" if reordered else _HINT
        raise InputError(text, where=where, expected="camera_from_lidar", got=got, hint=hint)
    if falls and seen and seen_inverse:
        return Direction.POSSIBLY_INVERSE
    if reordered:
        return Direction.POSSIBLY_REORDERED
    return Direction.PLAUSIBLE if seen else Direction.NOTHING_VISIBLE


def _is_reordered(cloud: Cloud, camera: Camera, camera_from_lidar: Float, up: Vertical, enough: float) -> bool:
    """Return whether the scene is upright and in the image if the quaternion of a pose is read as w x y z.

    The quaternion may be that of the pose or of its inverse.
    """
    from scipy.spatial.transform import Rotation

    for inverted in (False, True):
        written = se3.inverse(camera_from_lidar) if inverted else camera_from_lidar
        w, x, y, z = Rotation.from_matrix(written[:3, :3]).as_quat()
        read = se3.make(Rotation.from_quat([x, y, z, w]).as_matrix(), written[:3, 3])
        pose = se3.inverse(read) if inverted else read
        if _lean_deg(pose, up) < _REORDERED_UPRIGHT_DEG and _seen(cloud, camera, pose)[0] >= enough:
            return True
    return False


def vertical(cloud: Cloud) -> Vertical | None:
    """Estimate the vertical of the scene in the LiDAR frame, for any axes of the LiDAR; None if not observable.

    The directions of beams scatter least along the vertical. Upwards the scene ends gradually, downwards abruptly (the
    ground). The sign is unknown if both ends are similar, and in rooms, where the ceiling may be sharper than the
    ground.
    """
    xyz = cloud.xyz[:: max(1, len(cloud) // _SAMPLE)]
    largest = np.abs(xyz).max(axis=1)
    xyz, largest = xyz[largest > 0], largest[largest > 0]
    if len(xyz) < _FEW:
        return None
    rays = xyz / largest[:, None]  # scaled first, because squares of huge coordinates overflow
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
    widths = [np.maximum(edge, _SHARPEST_M) for edge in (np.flip(higher - high), lower - low)]
    top, bottom = (float(np.log(width).mean()) for width in widths)
    enclosed = max(top, bottom) < np.log(_GRADUAL_M) and np.mean(range_m > _OPEN_M) < _OPEN_SHARE
    sure = abs(top - bottom) > _SURE and not enclosed
    return Vertical(axis * (1 if top >= bottom else -1), points_up=bool(sure))


def _lean_deg(camera_from_lidar: Float, up: Vertical) -> float:
    """Return the angle between the vertical and the camera's -y axis, below 90 deg if the sign is unknown."""
    cosine = -float(camera_from_lidar[1, :3] @ up.axis)
    return float(np.degrees(np.arccos(np.clip(cosine if up.points_up else abs(cosine), -1, 1))))


def _seen(cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> tuple[int, int]:
    """Return the number of points in the image, and in the image enlarged by the error of an initial guess."""
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    inside = camera.in_image(camera.project(xyz))
    right, down = camera.width - 1, camera.height - 1
    corners = camera.rays(np.array([[0.0, 0.0], [right, 0.0], [0.0, down], [right, down]]))[:, 2]
    # The corners of a fisheye image may have no ray: 90 deg.
    half_deg = np.degrees(np.arccos(np.clip(np.nan_to_num(corners).min(), 0, 1)))
    cone = np.cos(np.radians(min(half_deg + _START_OFF_DEG, 180.0)))
    return int(inside.sum()), int((xyz[:, 2] >= cone * np.linalg.norm(xyz, axis=1)).sum())
