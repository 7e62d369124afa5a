"""A made-up street with exact truth: camera, right camera and LiDAR look at the same triangles."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from p2o import Camera, Frame, Image, Method, Options, field, se3
from p2o.arrays import Float, UInt8

from p2o_plugins.data.lazy_frames import LazyFrames

BASELINE_M = 0.54
LIDAR_HEIGHT_M = 1.73
_CAMERA_IN_LIDAR = (0.27, 0.06, -0.08)
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_TILT = (0.008, -0.011, 0.006)


class SyntheticOptions(Options):
    """What the dataset `synthetic` shows."""

    scenes: int = field(1, ge=1, le=100_000, help="Number of streets; each gives one frame.")
    seed: int = field(0, ge=0, help="Seed of the streets and of all noise.")
    camera: Literal["pinhole", "opencv-distorted", "fisheye"] = field(
        "pinhole", help="Camera model: KITTI-like pinhole with a right picture, distorted OPENCV, or OPENCV_FISHEYE."
    )
    width_px: int = field(1242, ge=64, le=8192, help="Width of the image; the focal length scales with it.")
    height_px: int = field(375, ge=64, le=8192, help="Height of the image; its field of view follows.")
    noise_m: float = field(0.02, ge=0, le=1, help="Standard deviation of the LiDAR's range in metres.")
    grain: float = field(1.5, ge=0, le=64, help="Standard deviation of the image noise in grey levels of 255.")


def camera_from_lidar() -> Float:
    """Return the true extrinsic (4, 4), like KITTI's: the camera 0.27 m ahead, 0.08 m below, tilted by 0.85 degrees."""
    rotation = se3.exp(np.array([*_TILT, 0.0, 0.0, 0.0]))[:3, :3] @ _AXES
    return se3.make(rotation, -rotation @ np.array(_CAMERA_IN_LIDAR))


def camera_of(options: SyntheticOptions) -> Camera:
    """Return the camera of the options, in proportion to KITTI's 1242x375 px with a focal length of 721.5 px."""
    width, height = options.width_px, options.height_px
    scale = width / 1242
    cx, cy = (609.6 + 0.5) * scale - 0.5, (172.9 + 0.5) * height / 375 - 0.5
    match options.camera:
        case "pinhole":
            return Camera.pinhole(721.5 * scale, 721.5 * scale, cx, cy, width, height)
        case "opencv-distorted":
            distortion = (-0.28, 0.08, 0.001, -0.0015)
            return Camera("OPENCV", width, height, (721.5 * scale, 722.5 * scale, cx, cy, *distortion))
        case "fisheye":
            distortion = (0.02, -0.006, 0.001, -0.0002)
            return Camera("OPENCV_FISHEYE", width, height, (480.0 * scale, 480.0 * scale, cx, cy, *distortion))


def made_up(options: SyntheticOptions, number: int) -> Frame:
    """Return frame `scene-<number>` of the options: the same bytes for the same options."""
    from p2o import simulate

    # One stream each, so that more noise or another camera leaves the street as it was.
    layout, range_noise, grain = (np.random.default_rng([options.seed, number, stream]) for stream in range(3))
    scene = simulate.street(layout)
    world_from_lidar = se3.make(translation=(0.0, 0.0, LIDAR_HEIGHT_M))
    truth = camera_from_lidar()
    world_from_camera = world_from_lidar @ se3.inverse(truth)
    camera = camera_of(options)

    left = simulate.render(scene, camera, world_from_camera)
    rgb, right = _grainy(left.rgb, options.grain, grain), None
    if camera.is_pinhole:
        shifted = world_from_camera @ se3.make(translation=(BASELINE_M, 0.0, 0.0))
        right = _grainy(simulate.render(scene, camera, shifted).rgb, options.grain, grain)
    image = Image(
        rgb,
        camera,
        right=right,
        baseline_m=None if right is None else BASELINE_M,
        depth_m=left.depth_m,
        masked=None if left.seen.all() else ~left.seen,
    )
    cloud = simulate.sweep(scene, replace(simulate.LIDARS["hdl-64e"], range_noise_m=options.noise_m), world_from_lidar, range_noise)
    return Frame(f"scene-{number:04d}", image, cloud, camera_from_lidar=truth)


def _grainy(rgb: UInt8, sigma: float, rng: np.random.Generator) -> UInt8:
    """Return the picture with Gaussian noise of `sigma` grey levels on every value."""
    noisy = rgb + sigma * rng.standard_normal(rgb.shape, np.float32)
    return np.clip(noisy + 0.5, 0, 255).astype(np.uint8)


def build(options: SyntheticOptions) -> LazyFrames:
    """Return the frames scene-0000, scene-0001, ...; each is made when it is asked for, from its own seed."""
    return LazyFrames({f"scene-{i:04d}": i for i in range(options.scenes)}, lambda number: made_up(options, number))


METHOD = Method(
    name="synthetic",
    build=build,
    options=SyntheticOptions,
    summary="Made-up streets with exact truth: image, right image, depth and a sweep of KITTI's HDL-64E.",
    gives=frozenset({"right", "depth", "truth", "rings", "intensity"}),
)
