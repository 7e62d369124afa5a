"""The right inputs that cases begin with: small frames in every layout, a study, its store, a result, a cache."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o import Camera
from p2o.cli import main

from tests import bag_files
from tests.p2o_datasets import argoverse2_files, kitti_360_files, kitti_files, once_files, pandaset_files, waymo_files
from tests.p2o_datasets.nuscenes_files import Tree

STUDY = """name = "small"
title = "A small study"
perturb = "0.5deg 0.02m"
seeds = 2
note = "Synthetic."

[[dataset]]
name = "own"
data = "folder:DATA"
frames = "0"

[defaults]
extractor = "depth/rings"
solver = "lm"
init = "given"
options.pipeline.rounds = 3

[[variant]]
name = "ogm-lr"
matcher = "ogm"
options.matcher.sides = "LR"

[[product]]
section = "single frames"
label = "{matcher}"
matcher = ["ogm", "ogm-lr"]

[[row]]
label = "simplex"
solver = "nelder-mead"
seeds = [3]

[[published]]
label = "theirs"
source = "Someone 2020"
values = { rotation_deg = 1.0, translation_m = 0.1 }
"""

_SMALL = {"width_px": 160, "height_px": 96, "lidar": "vlp-16", "place": "street"}
RUN = ("--extractor", "depth/rings", "--init", "given", "--set", "pipeline.rounds=3")
"""A calibration of a fifth of a second."""


@dataclass(frozen=True)
class Bases:
    """Folders of right inputs, which cases copy and then damage."""

    root: Path

    @property
    def folder(self) -> Path:
        """Two frames of the layout `folder`, with right picture, depth, times and start."""
        return self.root / "folder"

    @property
    def layouts(self) -> dict[str, Path]:
        """Every other dataset by name."""
        kitti = ("kitti-raw", "kitti-object", "kitti-odometry", "kitti-360", "vkitti2")
        return {name: self.root / name for name in (*kitti, "argoverse2", "nuscenes", "once", "pandaset", "waymo")}

    @property
    def bags(self) -> list[Path]:
        """A bag in each container, packed ones too, each one file."""
        return sorted(path for path in (self.root / "bags").rglob("*") if path.suffix in (".bag", ".db3", ".mcap"))

    @property
    def study(self) -> Path:
        """A folder with study.toml, the finished store (out) and the cache of its features."""
        return self.root / "study"

    @property
    def result(self) -> Path:
        """The result.json of a frame."""
        return self.root / "run" / "scene-0000" / "result.json"


def build(root: Path) -> Bases:
    """Return the bases, written to an empty folder; their commands also load what cases need, before any fork."""
    bases = Bases(root)
    root.mkdir(parents=True)
    os.environ["P2O_CACHE"] = str(bases.study / "cache")
    for layout in ("folder", "kitti-raw", "vkitti2"):
        # KITTI's readers want the rings of its own sensor.
        small = {**_SMALL, "lidar": "hdl-64e"} if layout == "kitti-raw" else _SMALL
        _p2o("simulate", root / layout, "--layout", layout, *_settings({**small, "scenes": 2}))
    _other_kitti(root)
    _bags(root / "bags")
    Tree(root / "nuscenes").write()
    argoverse2_files.Log(root / "argoverse2").write()
    kitti_360_files.Drive(root / "kitti-360").write()
    once_files.Sequence(root / "once").write()
    pandaset_files.Drive(root / "pandaset").write()
    waymo_files.Segment(root / "waymo").write()
    bases.study.mkdir()
    toml = bases.study / "study.toml"
    toml.write_text(STUDY.replace("DATA", str(bases.folder)), encoding="utf-8")
    _p2o("ablate", toml, "--out", bases.study / "out", "--jobs", 1, "--quiet")
    _p2o("run", "--data", f"folder:{bases.folder}", *RUN, "--out", root / "run")
    # What these load stays loaded in every fork.
    _p2o("run", "--data", f"folder:{bases.folder}", "--frames", "0")
    _p2o("report", bases.study / "out", "--out", root / "report")
    for data in (f"{name}:{folder}" for name, folder in bases.layouts.items()):
        _p2o("data", "check", data)
    for bag in bases.bags:
        _p2o("data", "check", f"ros:{bag}")
    shutil.rmtree(root / "report")
    del os.environ["P2O_CACHE"]
    return bases


def _bags(root: Path) -> None:
    rng = np.random.default_rng(0)
    camera = Camera.pinhole(20, 20, 7, 5, 16, 12)
    said = [bag_files.tf([bag_files.transform("lidar", "camera", np.eye(4))])]
    for number in range(3):
        time_ns = 10**18 + number * 100_000_000
        columns = {axis: rng.uniform(2, 9, 40).astype(np.float32) for axis in "xyz"}
        columns |= {"t": np.linspace(0, 1e8, 40).astype(np.uint32), "ring": (np.arange(40) % 4).astype(np.uint16)}
        said.append(bag_files.camera_info("/camera_info", time_ns, camera))
        said.append(bag_files.image("/image", time_ns, rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)))
        said.append(bag_files.cloud("/points", time_ns, columns))
        said.append(bag_files.odometry("/odom", time_ns, (number, 0, 0)))
    for form, packed in (("ros1", None), ("ros1", "LZ4"), ("ros1", "BZ2"), ("sqlite3", None), ("mcap", "STORAGE")):
        folder = root / f"{form}-{packed}"
        folder.mkdir(parents=True)
        bag_files.write_bag(folder, said, form, **({} if packed is None else {"compression": packed}))


def _settings(values: dict[str, object]) -> list[str]:
    return [word for name, value in values.items() for word in ("--set", f"{name}={value}")]


def _p2o(*words: object) -> None:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = main([str(word) for word in words])
    if status not in (0, 1):
        raise RuntimeError(f"a base cannot be made: p2o {' '.join(map(str, words))}: {said.getvalue()}")


def _other_kitti(root: Path) -> None:
    """Write two frames in KITTI's object and odometry layouts."""
    rig = {f"P{number}": kitti_files.numbers(matrix) for number, matrix in kitti_files.PROJECTIONS.items()}
    velo, rect = (kitti_files.numbers(m) for m in (kitti_files.VELO_TO_CAM[:3], kitti_files.R_RECT[:3, :3]))
    objects, sequence = root / "kitti-object/training", root / "kitti-odometry/sequences/00"
    for number in range(2):
        for folder in (objects, sequence):
            kitti_files.write_image(folder / f"image_2/{number:06d}.png", seed=number)
            kitti_files.write_sweep(folder / f"velodyne/{number:06d}.bin")
        lines = {**rig, "R0_rect": rect, "Tr_velo_to_cam": velo, "Tr_imu_to_velo": velo}
        kitti_files.write_lines(objects / f"calib/{number:06d}.txt", lines)
    kitti_files.write_lines(sequence / "calib.txt", {**rig, "Tr": velo})
    (sequence / "times.txt").write_text("0.000000e+00\n1.036e-01\n", encoding="utf-8")
    poses = root / "kitti-odometry/poses/00.txt"
    poses.parent.mkdir()
    poses.write_text(2 * f"{kitti_files.numbers(np.eye(4)[:3])}\n", encoding="utf-8")
