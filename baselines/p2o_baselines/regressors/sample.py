"""What one step learns from: a lesson cut, mirrored, lit, turned and decalibrated by chance, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from p2o import se3
from p2o.arrays import Float, UInt8

from p2o_baselines.regressors import decalibration
from p2o_baselines.regressors.glance import Size
from p2o_baselines.regressors.lesson import Lesson
from p2o_baselines.regressors.options import Augmentation
from p2o_baselines.regressors.sweep_map import Channel, drawn

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Sample:
    """`rgb` (h, w, 3) uint8 and `sweep` (C, h, w) at the start, what corrects the start, and what losses ask for.

    `xyz` (P, 3) are points in the camera's frame at the start (metres), `intrinsics` (4,) fx fy cx cy of the grid,
    `reach` (2,) the bounds of the error in rad and m, `true_nearness` (h, w) the sweep at the truth, `hand_eye`
    (2, 4, 4) how camera and LiDAR moved since the sample before in its window, NaN where that is unknown.
    """

    rgb: UInt8
    sweep: Float
    correction: Float
    reach: Float
    xyz: Float
    intrinsics: Float
    true_nearness: Float
    hand_eye: Float
    start: Float


@dataclass(frozen=True, eq=False)
class View:
    """How the pinhole of a sample sees, drawn once for all frames of a window: fx fy cx cy, a turn, a mirror."""

    zoom: float
    place: Float
    mirrored: bool
    turn: Float
    wrong: Float
    reach: decalibration.Reach
    other_lidar: Float


def view(reaches: Sequence[decalibration.Reach], augmentation: Augmentation, rng: np.random.Generator) -> View:
    """Return a view drawn by chance, with the error of its start."""
    from scipy.spatial.transform import Rotation

    reach = reaches[int(rng.integers(len(reaches)))]
    turn = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * augmentation.turn_deg, degrees=True).as_matrix()
    other = np.eye(4)
    if augmentation.reexpress:
        other = se3.make(Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix(), rng.normal(size=3))
    return View(
        float(np.exp(rng.uniform(0, np.log(augmentation.zoom)))),
        rng.uniform(0, 1, 2),
        bool(augmentation.mirror and rng.random() < 0.5),
        np.asarray(turn),
        decalibration.error(reach, rng),
        reach,
        other,
    )


def shrunk(lesson: Lesson, size: Size, zoom: float) -> Lesson:
    """Return a lesson whose picture has no more pixels than the largest zoom asks for."""
    import cv2

    height, width = lesson.rgb.shape[:2]
    scale = min(1.0, 1.2 * zoom * max(size[0] / height, size[1] / width))
    if scale > 0.9:
        return lesson
    small = (max(1, round(width * scale)), max(1, round(height * scale)))
    by = np.array(small) / [width, height]
    rgb = np.asarray(cv2.resize(lesson.rgb, small, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    changed = {"rgb": rgb, "focal": lesson.focal * by, "centre": (lesson.centre + 0.5) * by - 0.5}
    return Lesson(**{**vars(lesson), **changed})


def grid_camera(lesson: Lesson, size: Size, zoom: float, place: Float) -> Float:
    """Return fx fy cx cy (4,) of a network's grid that shows a window of a lesson; place (2,) in 0..1 is where."""
    height, width = lesson.rgb.shape[:2]
    scale = min(width / size[1], height / size[0]) / zoom
    corner = place * (np.array([width, height]) - scale * np.array(size[::-1]))
    focal = lesson.focal / scale
    centre = (lesson.centre + 0.5 - corner) / scale - 0.5
    return np.concatenate([focal, centre])


def sample(
    lesson: Lesson,
    seen: View,
    size: Size,
    channels: Sequence[Channel],
    points: int,
    augmentation: Augmentation,
    rng: np.random.Generator,
    before: Lesson | None = None,
    *,
    with_truth: bool = True,
) -> Sample:
    """Return what a lesson gives in a view; `before` is the lesson before it in its window.

    Without `with_truth` the map at the truth, which not all losses ask for, is empty.
    """
    import cv2

    grid = grid_camera(lesson, size, seen.zoom, seen.place)
    matrix = np.array([[grid[0], 0, grid[2]], [0, grid[1], grid[3]], [0, 0, 1]])
    old = np.array([[lesson.focal[0], 0, lesson.centre[0]], [0, lesson.focal[1], lesson.centre[1]], [0, 0, 1]])
    warp = matrix @ seen.turn @ np.linalg.inv(old)
    rgb = cv2.warpPerspective(lesson.rgb, warp, size[::-1], flags=cv2.INTER_LINEAR)
    camera_from_camera = se3.make(seen.turn, np.zeros(3))
    if seen.mirrored:
        rgb = np.asarray(rgb)[:, ::-1]
        grid[2] = size[1] - 1 - grid[2]
        camera_from_camera = MIRROR @ camera_from_camera
    keep = some(len(lesson.xyz), augmentation, rng)
    there = lesson.xyz[keep] @ camera_from_camera[:3, :3].T.astype(np.float32)
    wrong = seen.wrong.astype(np.float32)
    at_start = there @ wrong[:3, :3].T + wrong[:3, 3]
    xyz_lidar = None
    if "x" in channels:
        # Mirrored in the LiDAR's frame, too: a left-handed frame would tell that the picture is mirrored.
        lidar_from_camera = se3.inverse(lesson.camera_from_lidar)
        mirror = np.diag([1.0, -1.0, 1.0, 1.0]) if seen.mirrored else np.eye(4)
        xyz_lidar = se3.apply(seen.other_lidar @ mirror @ lidar_from_camera, lesson.xyz[keep])
    sweep = drawn(projected(at_start, grid), at_start[:, 2], size, channels, lesson.reflectance[keep], xyz_lidar)
    true = drawn(projected(there, grid), there[:, 2], size)[0] if with_truth else np.zeros(size, np.float32)
    chosen = rng.integers(len(there), size=points)
    return Sample(
        lit(rgb, augmentation.light, rng),
        sweep,
        se3.inverse(seen.wrong),
        np.array([np.radians(seen.reach[0]), seen.reach[1]]),
        at_start[chosen],
        grid,
        np.asarray(true, np.float64),
        hand_eye(before, lesson, camera_from_camera, seen),
        seen.wrong @ camera_from_camera @ lesson.camera_from_lidar,
    )


def some(count: int, augmentation: Augmentation, rng: np.random.Generator) -> slice:
    """Return which of the points of a lesson are used: neighbours of a list whose order is one of chance."""
    most = min(count, augmentation.most_points)
    used = max(1, int(most * rng.uniform(augmentation.thin, 1.0)))
    first = int(rng.integers(count - used + 1))
    return slice(first, first + used)


def projected(xyz: Float, grid: Float) -> Float:
    """Return pixels (N, 2) of points (N, 3) in a pinhole fx fy cx cy (4,); NaN behind it."""
    scale = 1.0 / np.where(xyz[:, 2] > 1e-6, xyz[:, 2], np.nan)
    out = np.empty((len(xyz), 2), xyz.dtype)
    for axis in (0, 1):
        out[:, axis] = xyz[:, axis] * scale * grid[axis] + grid[2 + axis]
    return out


def hand_eye(before: Lesson | None, lesson: Lesson, camera_from_camera: Float, seen: View) -> Float:
    """Return how camera and LiDAR moved (2, 4, 4) from the lesson before: later from earlier; NaN where unknown.

    The camera's motion is that of the camera of the view. Mirrored motions are told as they are seen.
    """
    unknown = np.full((2, 4, 4), np.nan)
    if before is None or seen.mirrored:
        return unknown
    worlds = ("camera_world_from_camera", "lidar_world_from_lidar")
    poses = [[getattr(each, world) for each in (before, lesson)] for world in worlds]
    if not np.isfinite(poses).all():
        return unknown
    camera, lidar = (se3.inverse(later) @ earlier for earlier, later in poses)
    return np.stack([camera_from_camera @ camera @ se3.inverse(camera_from_camera), lidar])


def lit(rgb: UInt8, strength: float, rng: np.random.Generator) -> UInt8:
    """Return a picture (h, w, 3) in another light: exposure, contrast, colour and noise; 0 leaves it as it is."""
    if strength <= 0:
        return np.ascontiguousarray(rgb)
    gain = np.exp(strength * (rng.normal(0, 0.2) + rng.normal(0, 0.05, 3)))
    gamma, more = np.exp(strength * rng.normal(0, 0.15)), strength * rng.normal(0, 10)
    table = 255.0 * np.power(np.arange(256) / 255.0, gamma)[:, None] * gain + more
    noise = rng.standard_normal(rgb.shape[:2], np.float32)[..., None] * (strength * rng.uniform(0, 6))
    return np.clip(table[rgb, np.arange(3)] + noise, 0, 255).astype(np.uint8)
