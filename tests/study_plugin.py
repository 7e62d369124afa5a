"""A plugin of the tests of studies: tiny frames made of edges only, and methods that count their calls and misbehave.

Every call is noted as a line of the file that TINY_CALLS names, so that all processes count together.
"""

from __future__ import annotations

import builtins
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import Camera, se3
from p2o.errors import Terminated

AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
TRUTH = se3.exp(np.array([0.01, -0.02, 0.015, 0, 0, 0])) @ se3.make(AXES, [0.02, -0.08, -0.27])
CAMERA = Camera.pinhole(350.0, 350.0, 300.0, 90.0, 600, 180)


def note(*words: object) -> None:
    path = os.environ.get("TINY_CALLS")
    if path:
        # One write of a short line to a file that is appended to is never torn.
        with open(path, "a", encoding="utf-8") as file:
            file.write(" ".join(str(word) for word in words) + "\n")


class TinyOptions(p2o.Options):
    root: str = p2o.field("", help="Unused, as a path would be.")
    frames: int = p2o.field(3, ge=1, help="How many frames there are.")
    bad: int = p2o.field(-1, help="This one cannot be read.")
    deadly: int = p2o.field(-1, help="Whoever reads this one is killed.")
    seed: int = p2o.field(0, ge=0, help="Seed of the scenes.")
    with_right: int = p2o.field(0, ge=0, help="So many frames, from the first on, have a right picture.")
    salt: int = p2o.field(0, ge=0, le=255, help="Changes a pixel of every image, and nothing else.")
    cameras: int = p2o.field(1, ge=1, help="How many cameras take turns.")


def truth_of(camera: int) -> Any:
    """Return camera_from_lidar (4, 4) of a camera by its number."""
    return se3.exp(np.array([0.0, 0.3, 0.1, 0.2, 0.0, 0.0]) * camera) @ TRUTH


class Frames(Sequence[p2o.Frame]):
    """Frames whose picture holds only the number of the scene, from which the extractors make its edges."""

    def __init__(self, options: TinyOptions) -> None:
        self.options = options
        self.names = tuple(f"tiny/{i:03d}" for i in range(options.frames))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        note("frame", index)
        if index == self.options.bad:
            raise p2o.InputError("the image is cut short", where="a.png")
        if index == self.options.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        rgb = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
        scene = self.options.seed * 100 + index
        rgb[0, 0] = divmod(scene, 256)[0], divmod(scene, 256)[1], self.options.salt
        number = index % self.options.cameras
        xyz = np.array([[1.0, 0, 0], [scene, 1 + number, 1]])
        has_right = index < self.options.with_right
        image = p2o.Image(rgb, CAMERA, right=rgb if has_right else None, baseline_m=0.5 if has_right else None)
        return p2o.Frame(self.names[index], image, p2o.Cloud(xyz), camera_from_lidar=truth_of(number))


def boxes(scene: int) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (N, 2) and depths of upright rectangles in the camera frame at depth 1."""
    rng = np.random.default_rng(scene)
    return rng.uniform([-0.8, -0.2], [0.8, 0.2], (14, 2)), rng.uniform(5, 30, 14)


def outline(scene: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) in the camera frame on the outlines of the rectangles, and their sides."""
    points, sides = [], []
    for (x, y), depth in zip(*boxes(scene), strict=True):
        half = np.array([0.07, 0.05]) * depth
        for side, (du, dv) in {0: (-1, 0), 1: (1, 0), 2: (0, -1), 3: (0, 1)}.items():
            along = np.array([0, 1]) if du else np.array([1, 0])
            t = np.arange(-1, 1, step)[:, None]
            xy = np.array([x, y]) * depth + half * [du, dv] + t * along * half
            points.append(np.column_stack([xy, np.full(len(t), depth)]))
            sides.append(np.full(len(t), side, np.int8))
    return np.concatenate(points), np.concatenate(sides)


class ImageOptions(p2o.Options):
    step: float = p2o.field(0.03, gt=0, help="Distance of points on an outline.")
    fail_on: int = p2o.field(-1, help="Raise on this scene.")


def build_image(options: ImageOptions) -> p2o.ImageExtractor:
    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        scene = int(image.rgb[0, 0, 0]) * 256 + int(image.rgb[0, 0, 1])
        note("image", scene)
        if scene == options.fail_on:
            raise ValueError("this picture is not liked")
        points, sides = outline(scene, options.step)
        return p2o.ImageFeatures(p2o.ImageEdges(image.camera.project(points), sides))

    return extract


class CloudOptions(p2o.Options):
    step: float = p2o.field(0.2, gt=0, help="Distance of points on an outline.")


def build_cloud(options: CloudOptions) -> p2o.CloudExtractor:
    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        scene = int(cloud.xyz[1, 0])
        note("cloud", scene)
        points, sides = outline(scene, options.step)
        truth = truth_of(int(cloud.xyz[1, 1]) - 1)
        return p2o.CloudFeatures(p2o.CloudEdges(se3.apply(se3.inverse(truth), points), sides))

    return extract


class QuickOptions(p2o.Options):
    sleep_s: float = p2o.field(0.0, ge=0, help="How long it takes.")
    gain: float = p2o.field(0.5, ge=0, help="Factor on the error of the start, which a test may know.")
    fail_on: str = p2o.field("", help="Raise on the frame of this name.")
    raises: str = p2o.field("ValueError", help="What `fail_on` raises: the name of an exception.")
    status: str = p2o.field("converged", help="How it ends.")
    interrupt_after: int = p2o.field(-1, help="Press Ctrl-C after so many calls.")
    die_on: str = p2o.field("", help="Kill the own process on the frame of this name.")
    die_by: str = p2o.field("SIGKILL", help="The signal by which it dies.")
    die_once: str = p2o.field("", help="A folder that the first call makes, which then kills its own process.")


def build_quick(options: QuickOptions) -> p2o.Calibrator:
    """Return a method that knows the answer, and comes near it."""
    calls = []

    def calibrate(frames: Any, start: Any) -> p2o.Result:
        names = tuple(frame.name for frame in frames)
        calls.append(names)
        if len(calls) == options.interrupt_after:
            raise Terminated  # as Ctrl-C does
        if options.die_once:
            try:
                # A file that an option names would count with its content.
                Path(options.die_once).mkdir()
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        if options.die_on in names:
            os.kill(os.getpid(), getattr(signal, options.die_by))
        time.sleep(options.sleep_s)
        if options.fail_on in names:
            raise getattr(builtins, options.raises)("no such luck")
        assert all(frame.camera_from_lidar is None for frame in frames)
        error = se3.log(se3.inverse(TRUTH) @ start)
        pose = TRUTH @ se3.exp(options.gain * error)
        note("quick", names[0], f"{np.abs(np.round(start, 9)).sum():.6f}")
        # A sum that BLAS cuts up by threads: with another number of them the last bits differ.
        numbers = np.random.default_rng(len(names)).normal(size=200_000)
        reason = f"as told, {numbers @ numbers:.17g}"
        return p2o.Result(names, start, pose, p2o.Status(options.status), reason)

    return calibrate


@p2o.hookimpl
def p2o_datasets():
    yield p2o.Method(name="tiny", build=Frames, options=TinyOptions, summary="Frames made of edges.")


@p2o.hookimpl
def p2o_image_extractors():
    gives = {"image-edges", "side"}
    yield p2o.Method(name="tiny", build=build_image, options=ImageOptions, summary="Knows the edges.", gives=gives)
    yield p2o.Method(
        name="tiny-plain", build=build_image, options=ImageOptions, summary="Without sides.", gives={"image-edges"}
    )
    yield p2o.Method(
        name="tiny-right", build=build_image, options=ImageOptions, summary="Of two.", gives=gives, needs={"right"}
    )


@p2o.hookimpl
def p2o_cloud_extractors():
    gives = {"cloud-edges", "side"}
    yield p2o.Method(name="tiny", build=build_cloud, options=CloudOptions, summary="Knows the edges.", gives=gives)


@p2o.hookimpl
def p2o_calibrators():
    yield p2o.Method(name="quick", build=build_quick, options=QuickOptions, summary="Halves the error of its start.")
