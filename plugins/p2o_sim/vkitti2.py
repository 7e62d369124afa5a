"""Read Virtual KITTI 2: SCENE/VARIATION/frames/{rgb,depth,classSegmentation}/Camera_N, with a LiDAR from the depth."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from p2o import Camera, Dataset, Float, Frame, Image, InputError, Method, Options, field, se3
from p2o.reading import LazyFrames, existing_folder, layout, listing, naming, read_rgb, read_text, read_uint16
from pydantic import Field

from p2o_sim.sensing.depth_lidar import depth_sweep
from p2o_sim.synthetic import camera_from_lidar as mounted
from p2o_sim.write.vkitti2 import SKY_CM

_MAX_BASELINE_M = 100.0
"""Largest plausible distance between two cameras of one vehicle."""
_FOLIAGE = ((0, 199, 0), (90, 240, 0))
_CAMERA_IN_LIDAR = (0.27, 0.06, -0.08)


class VirtualKitti2Options(Options):
    """Options of Virtual KITTI 2 and of the LiDAR that is simulated for it."""

    root: Path = field(Path("."), help="Folder that contains the scenes (Scene01, ...), or one scene.")
    scenes: tuple[Annotated[int, Field(ge=0, le=99)], ...] = field(
        (), max_length=100, help="Numbers of the scenes, such as [1,2,6,20]; none: all in the folder."
    )
    variation: Literal[
        "clone", "fog", "morning", "overcast", "rain", "sunset", "15-deg-left", "15-deg-right", "30-deg-left",
        "30-deg-right",
    ] = field("clone", help="Weather, light or viewing direction.")  # fmt: skip
    camera: int = field(0, ge=0, le=1, help="Camera: 0 is left (its right image is camera 1), 1 is right.")
    lidar: Literal["hdl-64e", "hdl-32e", "vlp-16", "os1-64", "os1-128", "pandar64"] = field(
        "hdl-64e", help="Beams of the LiDAR that is simulated from the depth."
    )
    mount: Literal["kitti", "camera"] = field(
        "kitti", help="Position of the LiDAR: as in KITTI, or at the camera, where both observe the same surfaces."
    )
    noise_m: float = field(0.02, ge=0, le=1, help="Standard deviation of the LiDAR's range in metres.")
    angle_noise_deg: float = field(0.0, ge=0, le=1, help="Standard deviation of its azimuth and elevation in degrees.")
    mask_foliage: bool = field(True, help="Mask the pixels of the classes Tree and Vegetation (paper Sec. IV-A).")
    seed: int = field(0, ge=0, lt=2**63, help="Seed of the LiDAR's noise.")


@dataclass(frozen=True)
class _Entry:
    """One frame: the folder of its scene and variation, its number, and its name."""

    folder: Path
    number: int
    name: str

    def file(self, kind: str, camera: int) -> Path | None:
        """Return the file rgb, depth or classgt of a camera, or None; PNG has priority over JPEG."""
        folder = {"classgt": "classSegmentation"}.get(kind, kind)
        stem = self.folder / f"frames/{folder}/Camera_{camera}/{kind}_{self.number:05d}"
        return next((path for suffix in (".png", ".jpg") if (path := stem.with_suffix(suffix)).exists()), None)


def build(options: VirtualKitti2Options) -> Dataset:
    """Return the frames of the scenes; names are "Scene01/clone/00000".

    Raises InputError if the folder or a scene is missing or has no frame with both image and depth.
    """
    root = existing_folder(options.root, "Virtual KITTI 2")
    inside = root.resolve().name.startswith("Scene")
    scenes = [root.resolve()] if inside else sorted(p for p in root.glob("Scene*") if p.is_dir())
    if options.scenes:
        wanted = [f"Scene{number:02d}" for number in options.scenes]
        absent = [name for name in wanted if name not in {scene.name for scene in scenes}]
        if absent:
            names = ", ".join(scene.name for scene in scenes) or "no scene"
            raise InputError(f"{absent[0]} is missing", where=root, got=names)
        scenes = [scene for scene in scenes if scene.name in wanted]
    entries: dict[str, _Entry] = {}
    skipped: dict[str, str] = {}
    for scene in scenes:
        folder, prefix = scene / options.variation, f"{scene.name}/{options.variation}"
        rgb = folder / f"frames/rgb/Camera_{options.camera}"
        numbers, strange = _numbers(rgb)
        skipped |= {f"{prefix}/{n}": f"{rgb / n}: the name of the file has no frame number" for n in strange}
        for number in numbers:
            entry = _Entry(folder, number, f"{prefix}/{number:05d}")
            if entry.file("depth", options.camera) is None:
                depth = folder / f"frames/depth/Camera_{options.camera}/depth_{number:05d}.png"
                skipped[entry.name] = f"{depth} is missing"
            else:
                entries[entry.name] = entry
    if not entries:
        where = f"frames/{{rgb,depth}}/Camera_{options.camera}"
        fault = "no Virtual KITTI 2 frames"
        got = next(iter(skipped.values()), f"{len(scenes)} scenes without images" if scenes else "no scene")
        raise InputError(fault, where=root, expected=f"Scene01/{options.variation}/{where}", got=got)
    return LazyFrames(entries, partial(_read, options), skipped)


def camera_from_lidar(options: VirtualKitti2Options) -> Float:
    """Return the extrinsic (4, 4) of the simulated LiDAR: KITTI's lever arm (0.27, 0.06, -0.08) m, or none."""
    place = _CAMERA_IN_LIDAR if options.mount == "kitti" else (0.0, 0.0, 0.0)
    return mounted((*place, 0.0, 0.0, 0.0))


def _read(options: VirtualKitti2Options, entry: _Entry) -> Frame:
    from p2o_sim.sensing.lidar import Lidar
    from p2o_sim.sensing.sensors import LIDARS

    image, warnings = _image(options, entry)
    lidar = LIDARS[options.lidar]
    if not isinstance(lidar, Lidar):
        raise TypeError("only rotating LiDARs are options")
    lidar = replace(lidar, range_noise_m=options.noise_m, angle_noise_deg=options.angle_noise_deg)
    if options.mount == "camera":
        # At the camera's centre nothing is occluded; beam heights relative to it would cause occlusions again.
        lidar = replace(lidar, height_m=())
    truth = camera_from_lidar(options)
    # One stream per frame and camera, so that the noise does not depend on which other frames are read.
    rng = np.random.default_rng([options.seed, options.camera, *os.fsencode(entry.name)])
    with naming(entry.folder):
        cloud = depth_sweep(np.asarray(image.depth_m), image.camera, truth, lidar, rng)
    return Frame(entry.name, image, cloud, camera_from_lidar=truth, warnings=warnings)


def _image(options: VirtualKitti2Options, entry: _Entry) -> tuple[Image, tuple[str, ...]]:
    number = options.camera
    path, depth_path = entry.file("rgb", number), entry.file("depth", number)
    if path is None or depth_path is None:
        raise InputError("the image or its depth no longer exists", where=entry.folder)
    rgb, warnings = read_rgb(path)
    fx, fy, cx, cy = _row(entry.folder / "intrinsic.txt", 4, entry.number, number)
    size = (rgb.shape[1], rgb.shape[0])
    raw = 256 * read_uint16(depth_path, "depth", size)
    right_path = entry.file("rgb", 1) if number == 0 else None
    right = baseline_m = masked = None
    if right_path is not None:
        right, more = read_rgb(right_path, size)
        warnings += more
        baseline_m = _baseline_m(entry)
    class_path = entry.file("classgt", number) if options.mask_foliage else None
    if class_path is not None:
        classes, _ = read_rgb(class_path, size)
        masked = np.any([(classes == colour).all(axis=2) for colour in _FOLIAGE], axis=0)
    elif options.mask_foliage:
        warnings += ("foliage is not masked: no class segmentation",)
    with naming(entry.folder / "intrinsic.txt"):
        camera = Camera.pinhole(fx, fy, cx, cy, rgb.shape[1], rgb.shape[0])
    with naming(path):
        image = Image(rgb, camera, right, baseline_m, np.where(raw == SKY_CM, np.inf, raw / 100), masked)
    return image, warnings


def _baseline_m(entry: _Entry) -> float:
    """Return the distance between left and right camera; raises InputError unless the right one is to the right."""
    path = entry.folder / "extrinsic.txt"
    left, right = (_row(path, 16, entry.number, camera).reshape(4, 4) for camera in (0, 1))
    with naming(path):
        left, right = (se3.check_rigid("an extrinsic", pose, tolerance=1e-3) for pose in (left, right))
    right_from_left = right @ se3.inverse(left)
    if se3.angle_deg(right_from_left) > 0.1 or np.abs(right_from_left[1:3, 3]).max() > 0.01:
        raise InputError("cameras 0 and 1 are not rectified", where=path, expected="a shift along x alone")
    if not 0 < -right_from_left[0, 3] <= _MAX_BASELINE_M:
        fault = "camera 1 is not to the right of camera 0"
        got = f"{right_from_left[0, 3]:g} m"
        raise InputError(fault, where=path, expected=f"a shift along -x of up to {_MAX_BASELINE_M:g} m", got=got)
    return float(-right_from_left[0, 3])


def _row(path: Path, count: int, frame: int, camera: int) -> Float:
    """Return the numbers of a frame and camera in intrinsic.txt or extrinsic.txt; raises InputError if missing."""
    _, _, text = read_text(path, "calibration file").partition("\n")
    try:
        table = np.array(text.split(), dtype=np.float64).reshape(-1, count + 2)
    except ValueError as problem:
        fault = "this is not a calibration file of Virtual KITTI 2"
        expected = f"a header, then rows of frame, camera and {count} numbers"
        raise InputError(fault, where=path, expected=expected) from problem
    rows = table[(table[:, 0] == frame) & (table[:, 1] == camera), 2:]
    if len(rows) != 1 or not np.isfinite(rows).all():
        fault = f"frame {frame} of camera {camera} is not calibrated"
        raise InputError(fault, where=path, expected=f"one row of {count} finite numbers", got=f"{len(rows)} rows")
    return np.asarray(rows[0])


def _numbers(folder: Path) -> tuple[list[int], list[str]]:
    """Return the sorted numbers of the images of a folder, and names rgb_* without one; both may be empty."""
    if not folder.is_dir():
        return [], []
    images = [path for path in listing(folder, "images") if path.suffix in (".png", ".jpg")]
    good = {int(path.stem[4:]) for path in images if _is_frame(path.stem)}
    return sorted(good), [p.name for p in images if p.name.startswith("rgb_") and not _is_frame(p.stem)]


def _is_frame(stem: str) -> bool:
    digits = stem.removeprefix("rgb_")
    return digits != stem and digits.isascii() and digits.isdecimal() and digits == f"{int(digits):05d}"


METHOD = Method(
    name="vkitti2",
    build=build,
    options=VirtualKitti2Options,
    summary="Virtual KITTI 2 with a LiDAR simulated from its depth, as in the paper's Table 1.",
    gives=frozenset({"depth", "truth", "rings"}),
    cite="Cabon, Murray, Humenberger: Virtual KITTI 2. arXiv 2001.10773, 2020",
    recognises=layout("Scene[0-9]*/*/frames", "*/frames/rgb"),
)
