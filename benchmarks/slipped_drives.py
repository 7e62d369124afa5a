"""A data set of p2o that moves the camera of another one: the frames of a drive after a mounting has slipped.

    p2o fleet run drives.csv --plugin benchmarks/slipped_drives.py

`slipped:PATH?of=kitti-raw&axis=yaw&size=0.5` reads the frames of `kitti-raw:PATH` with images as a camera takes them
that has turned by 0.5 deg, or with points as a LiDAR measures them that has moved. Names and the extrinsic of the data
stay as they are, so that this extrinsic has an error of exactly `size` on `axis`, as `p2o.pose_error` defines it.
Occlusions are those of the first place.

The camera turns and not the LiDAR: points that are turned about the horizontal axes no longer lie on the rings of a
sensor, and their edges move with the rings.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import p2o
from p2o.arrays import Float
from p2o.confidence.audit import AXES
from p2o.confidence.explanation import corrected
from p2o.frames.image import Image
from p2o.geometry import se3
from p2o.geometry.motion import adjoint
from p2o.host.registry import Registry
from p2o.reading import LazyFrames
from p2o.run.recipe import open_dataset


class SlippedOptions(p2o.Options):
    """Which frames, and how their sensors have moved."""

    root: Path = p2o.field(Path("."), help="Folder of the data set `of`.")
    of: str = p2o.field("folder", help="Data set that reads the frames.")
    axis: Literal["roll", "pitch", "yaw", "x", "y", "z"] = p2o.field("yaw", help="Axis of the error.")
    size: float = p2o.field(0.5, ge=-10, le=10, help="Error of the extrinsic in deg, or in m for x, y and z.")


def build(options: SlippedOptions) -> p2o.Dataset:
    """Return the frames; their `camera_from_lidar` is the extrinsic before the slip."""
    source = open_dataset(f"{options.of}:{options.root}", Registry.load())
    axis = [name for name, _ in AXES].index(options.axis)

    def read(index: int) -> p2o.Frame:
        return slipped(source[index], axis, options.size)

    return LazyFrames({name: index for index, name in enumerate(source.names)}, read)


def slipped(frame: p2o.Frame, axis: int, size: float) -> p2o.Frame:
    """Return a frame of sensors that have moved, so that its extrinsic has an error `size` on `axis`.

    Raises InputError for a frame without extrinsic, and for rotations of a camera with distortion.
    """
    if frame.camera_from_lidar is None:
        raise p2o.InputError("a slip needs the extrinsic of the data", where=frame.name)
    after = corrected(frame.camera_from_lidar, axis, np.array([size]))[0]
    turn = np.eye(4)
    turn[:3, :3] = after[:3, :3] @ frame.camera_from_lidar[:3, :3].T
    # About the camera, the LiDAR turns by some millimetres, which `pose_error` assigns to other axes: a translation.
    new_from_old = se3.inverse(after) @ turn @ frame.camera_from_lidar
    cloud = replace(
        frame.cloud, xyz=se3.apply(new_from_old, frame.cloud.xyz), twist=_turned(new_from_old, frame.cloud.twist)
    )
    world, camera_world = frame.lidar_world_from_lidar, frame.camera_world_from_camera
    return replace(
        frame,
        cloud=cloud,
        image=frame.image if axis > 2 else _image_after(turn[:3, :3], frame.image),
        sweep=None,
        twist=_turned(new_from_old, frame.twist),
        lidar_world_from_lidar=None if world is None else world @ se3.inverse(new_from_old),
        camera_world_from_camera=None if camera_world is None else camera_world @ se3.inverse(turn),
    )


def _image_after(turn: Float, image: Image) -> Image:
    """Return the image of a camera that has turned (3, 3) about its centre; the border is repeated."""
    camera = image.camera
    if not camera.is_pinhole:
        expected = "images without distortion"
        raise p2o.InputError("the camera cannot be turned", expected=expected, got=camera.model)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2))
    uv = np.asarray(camera.project(rays @ turn), np.float32).reshape(camera.height, camera.width, 2)
    rgb = cv2.remap(image.rgb, uv[..., 0], uv[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return Image(np.asarray(rgb, np.uint8), camera)


def _turned(new_from_old: Float, twist: Float | None) -> Float | None:
    return None if twist is None else adjoint(new_from_old, twist)


@p2o.hookimpl
def p2o_datasets():
    """Yield the data set."""
    yield p2o.Method(
        name="slipped",
        build=build,
        options=SlippedOptions,
        summary="Frames of another data set whose sensors have moved.",
        gives=frozenset({"rings", "intensity", "time"}),
        parallel=True,
    )
