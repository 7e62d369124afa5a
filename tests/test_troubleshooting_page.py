"""Every message that docs/troubleshooting.md quotes is printed by p2o, apart from numbers, paths and line breaks."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o.cli import main

from tests.pages import ROOT

Frame = dict[str, Any]
PAGE = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")


def quoted(text: str) -> str:
    """Return a text without backticks, line breaks, paths and the values of numbers."""
    text = re.sub(r"\S*/(?=[\w-]+\.\w+:)", ".../", text.replace("`", ""))
    return " ".join(re.sub(r"\d+(\.\d+)?", "0", text).split())


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("street") / "data"
    options = ("scenes=1", "width_px=320", "height_px=120", "right=false", "start_error=0deg 0m")
    assert main(["simulate", str(folder), "--layout", "folder", *(w for o in options for w in ("--set", o))]) == 0
    return folder


def inverse(frame: Frame, folder: Path) -> None:
    frame["start"] = np.linalg.inv(np.array(frame["start"])).tolist()


def millimetres(frame: Frame, folder: Path) -> None:
    pose = np.array(frame["start"])
    pose[:3, 3] *= 1000
    frame["start"] = pose.tolist()


def points_in_millimetres(frame: Frame, folder: Path) -> None:
    points = dict(np.load(folder / "cloud.npz"))
    np.savez(folder / "cloud.npz", **{**points, "xyz": 1000 * points["xyz"]})


def intensity_absent(frame: Frame, folder: Path) -> None:
    np.load(folder / "cloud.npz")["xyz"].astype(np.float32).tofile(folder / "cloud.bin")
    frame["cloud"] = "cloud.bin"


def camera_of_another_size(frame: Frame, folder: Path) -> None:
    frame["camera"].update(width=640, height=240)


def distortion_without_model(frame: Frame, folder: Path) -> None:
    f, _, u, v = frame["camera"]["params"]
    frame["camera"] = {"width": 320, "height": 120, "K": [[f, 0, u], [0, f, v], [0, 0, 1]], "D": [0.1, 0, 0]}


def late(frame: Frame, folder: Path) -> None:
    frame["image_time_s"] = 1.5


def no_start(frame: Frame, folder: Path) -> None:
    del frame["start"]


def nothing(frame: Frame, folder: Path) -> None:
    pass


CHECK, RUN = ("data", "check"), ("run", "--data")


@pytest.mark.parametrize(
    ("change", "command", "words", "message"),
    [
        (inverse, CHECK, (), r"start may be lidar_from_camera.*z forward\)"),
        (inverse, ("check",), ("--extrinsic", "start"), r"the extrinsic looks like lidar_from_camera.*upright"),
        (millimetres, CHECK, (), r"no point of the sweep lies in the image at start"),
        (millimetres, RUN, (), r"every LiDAR edge lies behind the camera.*lidar_from_camera\?"),
        (points_in_millimetres, CHECK, (), r"this is not a point cloud in metres.*farther away"),
        (intensity_absent, CHECK, (), r"the point cloud has no intensity"),
        (camera_of_another_size, CHECK, (), r"the image size does not fit the camera.*new size"),
        (distortion_without_model, CHECK, (), r"camera.distortion_model is missing.*0\)"),
        (late, CHECK, (), r"image and sweep are not of the same time.*apart"),
        (no_start, RUN, (), r"there is no start to calibrate from.*in Python"),
        (nothing, RUN, ("--perturb", "1deg 0.1m"), r"the truth is not known, so it cannot be perturbed.*give"),
        (nothing, RUN, ("--extractor", "stereo/rings"), r"the frame has no right; stereo needs it"),
        (nothing, RUN, ("--matcher", "nid"), r"p2ornet gives no image-grey; nid needs it"),
    ],
)
def test_a_quoted_message_is_printed(
    change: Callable[[Frame, Path], None],
    command: tuple[str, ...],
    words: tuple[str, ...],
    message: str,
    street: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    data = tmp_path / "data"
    shutil.copytree(street, data)
    [file] = data.rglob("frame.yaml")
    frame = yaml.safe_load(file.read_text())
    for key in ("truth", "depth", "twist", "image_time_s"):
        frame.pop(key, None)
    change(frame, file.parent)
    file.write_text(yaml.safe_dump(frame))
    main([*command, f"folder:{data}", *words])
    printed = capsys.readouterr()
    found = re.search(message, printed.out + printed.err)
    assert found is not None, printed.out + printed.err
    assert quoted(found[0]) in quoted(PAGE)
