"""Write frames in the layout of the data set `vkitti2`, Virtual KITTI 2, whose LiDAR is simulated from the depth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from p2o import Frame, Image

from p2o_sim.write.files import numbers, png, require, write_file

_VARIATION = "Scene01/clone"
_COLOURS = {
    "Terrain": (210, 0, 200), "Sky": (90, 200, 255), "Tree": (0, 199, 0), "Vegetation": (90, 240, 0),
    "Building": (140, 140, 140), "Road": (100, 60, 100), "GuardRail": (250, 100, 255), "TrafficSign": (255, 255, 0),
    "TrafficLight": (200, 200, 0), "Pole": (255, 130, 0), "Misc": (80, 80, 80), "Truck": (160, 60, 60),
    "Car": (255, 127, 80), "Van": (0, 139, 139), "Undefined": (0, 0, 0),
}  # fmt: skip
SKY_CM = 65535
"""Depth of the sky in files of Virtual KITTI 2, in centimetres."""


def write(frames: Iterable[Frame], root: Path) -> Iterator[str]:
    """Write frames below `root`/Scene01/clone one by one and yield the name with which `vkitti2` reads each.

    Images are PNG, not JPEG as in Virtual KITTI 2. Depth is rounded to centimetres, and more than 655 m becomes sky.
    Frames have no classes: masked pixels become Tree, sky Sky, all others Misc. Each frame is at the origin of its own
    world. The layout cannot store sweep, ground truth and initial guess.

    Raises InputError for frames without depth or without a pinhole camera.
    """
    base = root / _VARIATION
    write_file(base / "colors.txt", _table("Category r g b", [f"{n} {r} {g} {b}" for n, (r, g, b) in _COLOURS.items()]))
    intrinsic, extrinsic = [], []
    for number, frame in enumerate(frames):
        image = frame.image
        require("vkitti2", frame, {"a pinhole camera": frame.camera.is_pinhole, "depth": image.depth_m})
        images = [image.rgb] if image.right is None else [image.rgb, image.right]
        for camera, rgb in enumerate(images):
            world = np.eye(4)
            world[0, 3] = -camera * (image.baseline_m or 0.0)
            intrinsic.append(f"{number} {camera} {numbers(frame.camera.params)}")
            extrinsic.append(f"{number} {camera} {numbers(world)}")
            write_file(base / f"frames/rgb/Camera_{camera}/rgb_{number:05d}.png", png(rgb))
        write_file(base / f"frames/classSegmentation/Camera_0/classgt_{number:05d}.png", png(_classes(image)))
        rows = " ".join(f"{name}{i}" for i in (1, 2, 3) for name in (f"r{i},1 r{i},2 r{i},3 t",))
        write_file(base / "intrinsic.txt", _table("frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]", intrinsic))
        write_file(base / "extrinsic.txt", _table(f"frame cameraID {rows} 0 0 0 1", extrinsic))
        # Written last, so that the reader skips an interrupted frame.
        write_file(base / f"frames/depth/Camera_0/depth_{number:05d}.png", png(_centimetres(image)))
        yield f"{_VARIATION}/{number:05d}"


def _centimetres(image: Image) -> np.ndarray:
    """Return depth (H, W) uint16 in centimetres along the axis, 65535 for sky, 0 if unknown."""
    steps = np.rint(100.0 * np.asarray(image.depth_m))
    # Values that round to 0 would mean unknown.
    steps = np.clip(np.where(np.isnan(steps), -1, steps), None, SKY_CM)
    return np.where(steps < 0, 0, np.maximum(steps, 1)).astype(np.uint16)


def _classes(image: Image) -> np.ndarray:
    """Return the class colours (H, W, 3) uint8."""
    out = np.full(image.rgb.shape, _COLOURS["Misc"], np.uint8)
    out[np.isinf(np.asarray(image.depth_m))] = _COLOURS["Sky"]
    if image.masked is not None:
        out[image.masked] = _COLOURS["Tree"]
    return out


def _table(header: str, rows: list[str]) -> str:
    return "\n".join([header, *rows]) + "\n"
