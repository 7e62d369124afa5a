"""A label file: a picture without distortion, its sweep in the camera's frame at the truth, and what goes with them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import p2o
from p2o import InputError, se3
from p2o.arrays import Float, UInt8
from p2o.files.array_file import read_npz
from p2o.files.input_file import read_bytes

from p2o_baselines.regressors.glance import reflectance_of, thinned

VERSION = 1
_WIDEST_PX = 1280
_MOST_POINTS = 60_000
_LEAST_POINTS = 200
_BESIDE_DEG = 35.0
"""Points so far outside of the picture are kept: a wrong start may bring them in."""
_MOST_BYTES = 64 << 20


@dataclass(frozen=True, eq=False)
class Lesson:
    """`rgb` (H, W, 3) of a pinhole camera `focal` (2,) and `centre` (2,) in pixels; `xyz` (N, 3) in its frame.

    Points are in an order of chance, their `reflectance` (N,) is in 0..1; `camera_from_lidar` (4, 4) is the truth.
    `group` names the drive; the poses of both sensors at the time of the picture, each in a world of its own, are NaN
    where they are unknown.
    """

    name: str
    group: str
    rgb: UInt8
    focal: Float
    centre: Float
    xyz: Float
    reflectance: Float
    camera_from_lidar: Float
    camera_world_from_camera: Float
    lidar_world_from_lidar: Float

    def packed(self) -> bytes:
        """Return the content of the label file."""
        file = io.BytesIO()
        np.savez_compressed(file, **{**vars(self), "xyz": self.xyz.astype(np.float32)})
        return file.getvalue()

    @classmethod
    def load(cls, path: Path) -> Lesson:
        """Return what `packed` wrote; raises InputError where the file is something else."""
        shapes: dict[str, tuple[int, ...]] = {"focal": (2,), "centre": (2,)}
        poses = ("camera_from_lidar", "camera_world_from_camera", "lidar_world_from_lidar")
        shapes |= dict.fromkeys(poses, (4, 4))
        try:
            file = read_npz(read_bytes(path, "file of labels", _MOST_BYTES), path)
            rgb, xyz, reflectance = file["rgb"], file["xyz"], file["reflectance"]
            if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or xyz.shape != (len(reflectance), 3):
                raise ValueError(f"rgb {rgb.dtype} {rgb.shape}, xyz {xyz.shape}")
            rest = {name: np.asarray(file[name], np.float64).reshape(shape) for name, shape in shapes.items()}
            return cls(str(file["name"]), str(file["group"]), rgb, xyz=xyz, reflectance=reflectance, **rest)
        except (ValueError, KeyError, InputError) as problem:
            got = problem.what if isinstance(problem, InputError) else problem
            raise InputError(
                "a file of labels cannot be read", where=path, expected="what p2o labels wrote", got=got
            ) from problem


def lesson_of(frame: p2o.Frame) -> Lesson:
    """Return what a frame teaches; raises InputError where its truth is unknown or its camera sees no points."""
    if frame.camera_from_lidar is None:
        raise InputError("the frame teaches nothing", where=frame.name, expected="a true extrinsic", got="none")
    rgb, camera = flat(frame.image)
    cloud = thinned(frame.cloud, 4 * _MOST_POINTS)
    there = se3.apply(frame.camera_from_lidar, cloud.xyz)
    fx, fy, cx, cy = camera.params
    beside = np.tan(np.radians(np.minimum(_BESIDE_DEG + np.degrees(np.arctan([cx / fx, cy / fy])), 85.0)))
    beheld = (there[:, 2] > 0.3) & (np.abs(there[:, :2]) < beside * there[:, 2:]).all(axis=1)
    near = np.random.default_rng(0).permutation(np.flatnonzero(beheld))[:_MOST_POINTS]
    if camera.in_image(camera.project(there[near])).sum() < _LEAST_POINTS:
        raise InputError(
            "the frame teaches nothing",
            where=frame.name,
            expected=f"{_LEAST_POINTS} points or more that the camera sees",
            got="fewer",
        )
    unknown = np.full((4, 4), np.nan)
    world = (frame.camera_world_from_camera, frame.lidar_world_from_lidar)
    return Lesson(
        frame.name,
        frame.sequence or frame.name.rpartition("/")[0],
        rgb,
        np.array([fx, fy]),
        np.array([cx, cy]),
        there[near],
        reflectance_of(cloud)[near].astype(np.float32),
        frame.camera_from_lidar,
        *(unknown if pose is None else pose for pose in world),
    )


def flat(image: p2o.Image) -> tuple[UInt8, p2o.Camera]:
    """Return a picture (H, W, 3) as a pinhole shows it, at most 1280 px wide, and that pinhole.

    Losses project points inside of the training, where only pinholes are known. Pixels that the lens does not have
    are black.
    """
    import cv2

    camera, rgb = image.camera, image.rgb
    scale = min(1.0, _WIDEST_PX / camera.width)
    width, height = max(1, round(scale * camera.width)), max(1, round(scale * camera.height))
    if scale < 1.0:
        rgb, camera = (
            np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)),
            camera.resized(width, height),
        )
    if camera.is_pinhole:
        return np.asarray(rgb, dtype=np.uint8), camera
    pinhole = p2o.Camera.pinhole(camera.focal_px, camera.focal_px, (width - 1) / 2, (height - 1) / 2, width, height)
    v, u = np.indices((height, width))
    uv = camera.project(pinhole.rays(np.stack([u, v], axis=-1).astype(np.float64)))
    x, y = np.where(np.isfinite(uv), uv, -10.0).astype(np.float32).transpose(2, 0, 1)
    return np.asarray(cv2.remap(rgb, x, y, cv2.INTER_LINEAR), dtype=np.uint8), pinhole


def picture(lesson: Lesson) -> UInt8:
    """Return the picture of a lesson with its points where they belong, near ones warm: `p2o labels --draw`."""
    import cv2

    from p2o_baselines.regressors.sweep_map import nearness

    out = (0.5 * lesson.rgb).astype(np.uint8)
    uv = lesson.xyz[:, :2] / lesson.xyz[:, 2:] * lesson.focal + lesson.centre
    height, width = out.shape[:2]
    seen = (uv >= 0).all(axis=1) & (uv < [width - 1, height - 1]).all(axis=1)
    order = np.flatnonzero(seen)[np.argsort(-lesson.xyz[seen, 2])]
    colour = cv2.applyColorMap((255 * nearness(lesson.xyz[order, 2])).astype(np.uint8)[:, None], cv2.COLORMAP_TURBO)
    u, v = np.rint(uv[order]).astype(np.int64).T
    out[v, u] = np.asarray(colour)[:, 0, ::-1]
    return out
