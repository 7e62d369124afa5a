"""Files that stand in for those that shell lines of the pages name: small synthetic frames, a bag, calibrations."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import p2o
import yaml
from p2o.cli import main
from p2o.run.recipe import open_dataset

from tests.bag_files import messages_of, odometry, write_bag
from tests.pages import ROOT, blocks

KITTI_WEIGHTS = ROOT / "plugins/kitti_weights/p2o_kitti_weights"

SMALL = "width_px=320&height_px=120&right=false"
KITTI = "PATH"
"""A drive of KITTI raw in the layout of its dataset."""

FOLDERS = ("my-frame", "my_car", "mine", "DRIVE")
RIGS = ("my-rig", "my_rig")
FRAMES = 5


def written(root: Path) -> Path:
    """Write all stand-ins into a folder and return it."""
    for name, layout, count in ((KITTI, "kitti-raw", FRAMES), ("drive-of-frames", "folder", 2)):
        data = f"?{SMALL}&frames_per_scene={count}&speed_m_s=8&seed=3"
        assert main(["simulate", str(root / name), "--layout", layout, *_set(data)]) == 0
    frames = list(open_dataset(f"kitti-raw:{root / KITTI}", p2o.Registry.load()))
    truth = frames[0].camera_from_lidar
    assert truth is not None
    for name in FOLDERS:
        source = root / "drive-of-frames"
        for frame in sorted(source.iterdir())[: None if name == "DRIVE" else 1]:
            shutil.copytree(frame, root / name / frame.name)
    _write_rigs(root)
    _write_bag(root)
    matrix = " ".join(repr(float(value)) for value in truth.ravel())
    for name in ("calib.yaml", "extrinsic.yaml", "start.yaml"):
        (root / name).write_text(f"camera_from_lidar: [{', '.join(matrix.split())}]\n")
    (root / "camchain.yaml").write_text(json.dumps({"cam0": _KALIBR, "cam1": _KALIBR}))
    xyz = frames[0].cloud.xyz[::97]
    uv = frames[0].camera.project(p2o.se3.apply(truth, xyz))
    seen = frames[0].camera.in_image(uv)
    picks = [{"uv": u.tolist(), "xyz": x.tolist()} for u, x in zip(uv[seen], xyz[seen], strict=True)]
    (root / "pairs.yaml").write_text(yaml.safe_dump({"frames": {frames[0].name: picks[:20]}}))
    for name in ("test_13.txt", "mine.csv"):
        np.savetxt(root / name, np.full((1000, 6), 0.01), delimiter=",")
    (root / "trained").mkdir()
    shutil.copy(ROOT / "plugins/p2o_plugins/weights/p2ornet-free.safetensors", root / "trained/weights.safetensors")
    (root / "lccnet").mkdir()
    shutil.copy(KITTI_WEIGHTS / "lccnet-small.safetensors", root / "lccnet/weights.safetensors")
    (root / "trained/weights.json").write_text('{"level": 30}')
    return root


def _write_rigs(root: Path) -> None:
    data = f"synthetic:?scenes=1&cameras=front,left&{SMALL}"
    frames = list(open_dataset(data, p2o.Registry.load()))
    poses = {}
    for frame in frames:
        assert frame.camera_from_lidar is not None
        poses[str(frame.camera_name)] = {"camera_from_lidar": [float(x) for x in frame.camera_from_lidar.ravel()]}
    (root / "rig.yaml").write_text(yaml.safe_dump({"cameras": poses}))
    assert main(["simulate", str(root / RIGS[0]), "--layout", "folder", *_set(data)]) == 0
    for name in RIGS[1:]:
        shutil.copytree(root / RIGS[0], root / name)
    for rig in ("nuscenes", "ddad", "waymo"):
        folder = root / "build/data/rigs" / rig
        folder.mkdir(parents=True)
        (folder / "rig.json").write_text(json.dumps(poses))
    shutil.copy(root / "rig.yaml", root / "rig.json")
    (root / "rig.json").write_text(json.dumps({"cameras": poses}))
    [around] = [
        block.text for block in blocks("docs/how-to/rig.md") if block.language == "yaml" and "back:" in block.text
    ]
    (root / "around.yaml").write_text(around)


def _write_bag(root: Path) -> None:
    frames = list(open_dataset(f"synthetic:?scenes=3&lidar=vlp-16&seed=1&{SMALL}", p2o.Registry.load()))
    said = messages_of(frames)
    first = said[0].time_ns
    said += [odometry("/odom", first + number * 100_000_000, [6.0 * number, 0, 0]) for number in range(len(frames))]
    write_bag(root, sorted(said, key=lambda message: message.time_ns), "ros1")


def _set(data: str) -> list[str]:
    return [word for text in data.partition("?")[2].split("&") for word in ("--set", text)]


_KALIBR = {
    "camera_model": "pinhole",
    "intrinsics": [700.0, 700.0, 320.0, 240.0],
    "distortion_model": "radtan",
    "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
    "resolution": [640, 480],
}


def linked(world: Path, folder: Path) -> Path:
    """Make a folder of which every entry is a link to the stand-ins, and return it: what is written stays apart."""
    for entry in world.iterdir():
        (folder / entry.name).symlink_to(entry)
    for name in ("benchmarks", "baselines"):
        (folder / name).symlink_to(ROOT / name)
    return folder
