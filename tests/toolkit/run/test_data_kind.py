"""The dataset of a path, which the datasets of the registry recognise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import p2o
import pytest
from p2o import InputError, Method, PluginError, Recipe
from p2o.host.registry import Registry
from p2o.reading import layout
from p2o.run.words import data_by_name, data_kind, named_data, split_data

LAYOUTS = {
    "folder": "a/frame.yaml",
    "ros": "bag_0.db3",
    "kitti-raw": "2011_09_26/2011_09_26_drive_0005_sync/velodyne_points/data/0.bin",
    "kitti-odometry": "sequences/00/velodyne/0.bin",
    "kitti-object": "training/velodyne/0.bin",
    "kitti-360": "data_3d_raw/x.bin",
    "argoverse2": "log/city_SE3_egovehicle.feather",
    "nuscenes": "v1.0-mini/sample_data.json",
    "once": "data/000076/lidar_roof/0.bin",
    "pandaset": "001/lidar/poses.json",
    "vkitti2": "Scene01/clone/frames/rgb/Camera_0/0.jpg",
    "waymo": "lidar/x.parquet",
}


def laid_out(root: Path, file: str) -> Path:
    path = root / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize("kind", list(LAYOUTS))
def test_a_folder_is_recognised_by_its_layout(tmp_path: Path, kind: str) -> None:
    laid_out(tmp_path, LAYOUTS[kind])
    assert data_kind(tmp_path) == kind
    assert split_data(f"{tmp_path}?seed=3") == (kind, {"root": str(tmp_path), "seed": "3"})
    assert data_by_name([f"a={tmp_path}"], ["a", "b"], "study s") == {"a": f"{kind}:{tmp_path}"}


@pytest.mark.parametrize(
    ("kind", "inside"),
    [
        ("kitti-raw", "2011_09_26/2011_09_26_drive_0005_sync"),
        ("kitti-odometry", "sequences/00"),
        ("folder", "a"),
        ("ros", "bag_0.db3"),
    ],
)
def test_one_drive_sequence_frame_or_bag_is_recognised(tmp_path: Path, kind: str, inside: str) -> None:
    laid_out(tmp_path, LAYOUTS[kind])
    assert data_kind(tmp_path / inside) == kind


def test_a_relative_path_needs_no_separator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    laid_out(tmp_path, "mine/frame.yaml")
    monkeypatch.chdir(tmp_path)
    assert [named_data(text) for text in ("mine", "./mine", "folder:mine", "synthetic", "synthetic:?scenes=1")] == [
        "folder:mine", "folder:./mine", "folder:mine", "synthetic", "synthetic:?scenes=1"
    ]  # fmt: skip


def test_a_path_of_two_datasets_or_none_is_refused_with_the_next_step(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no dataset recognises it; name it: DATASET:PATH, such as folder:/"):
        data_kind(tmp_path)
    for kind in ("folder", "ros"):
        laid_out(tmp_path, LAYOUTS[kind])
    with pytest.raises(InputError, match="could be of several datasets: folder, ros; name it: DATASET:PATH"):
        data_kind(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        named_data("/no/such/folder")


class Recordings:
    """The plugin of a third party, whose dataset recognises its own folders and fails on others."""

    def __init__(self, recognises: Any) -> None:
        self.recognises = recognises

    @p2o.hookimpl
    def p2o_datasets(self) -> list[Method]:
        return [Method(name="recordings", build=list, summary="Recordings.", recognises=self.recognises)]


def test_the_dataset_of_a_plugin_recognises_its_own_folder_and_is_named_where_it_fails(tmp_path: Path) -> None:
    laid_out(tmp_path, "drive/sweeps.rec")
    registry = Registry.of(Recordings(layout("*/sweeps.rec")))
    assert split_data(str(tmp_path), registry) == ("recordings", {"root": str(tmp_path)})
    with pytest.raises(InputError, match="no dataset recognises it"):
        data_kind(tmp_path)  # installed plugins do not
    with pytest.raises(InputError, match="no dataset recognises it"):
        named_data(str(tmp_path / "drive"), registry)
    with pytest.raises(InputError, match="dataset recordings takes no path"):
        Recipe(data=str(tmp_path)).resolve(registry)
    with pytest.raises(PluginError, match="dataset 'recordings' raised ZeroDivisionError while recognising"):
        data_kind(tmp_path, Registry.of(Recordings(lambda path: 1 / 0)))
