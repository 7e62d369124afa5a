"""The study of rigs runs on whatever of them there is, from one folder and one file of splits."""

from __future__ import annotations

from pathlib import Path

import pytest
from p2o import InputError, Registry
from p2o_study.study import BY_CAMERA, check_study, find_study

REGISTRY = Registry.load()
STUDY = find_study("rigs", REGISTRY)


def test_every_rig_that_is_there_has_its_rows_and_the_others_none(tmp_path: Path) -> None:
    for place in ("kitti_odometry", "rigs/nuscenes", "rigs/ddad"):
        (tmp_path / place).mkdir(parents=True)
    study = STUDY.overridden(["waymo=folder:elsewhere"], root=tmp_path)
    rows = {row.label: row for row in check_study(study, REGISTRY)}
    assert list(rows) == [
        "single @ odometry00",
        "single @ waymo",
        "single @ nuscenes",
        "single @ ddad",
        "joint @ odometry00",
        "joint @ waymo",
        "joint @ ddad",
        "joint, from 10 deg 0.2 m @ odometry00",
    ]
    assert rows["joint @ waymo"].dataset.data == "folder:elsewhere"
    assert rows["single @ ddad"].dataset.data == f"folder:{tmp_path}/rigs/ddad"
    assert rows["joint @ ddad"].joint == BY_CAMERA
    cloud = rows["single @ ddad"].resolve(REGISTRY, 0).parts["cloud"]
    assert (cloud.offer.name, cloud.options.origin_m) == ("range-view", (1.65, 0.0, 1.35))
    assert rows["single @ nuscenes"].resolve(REGISTRY, 0).parts["cloud"].offer.name == "rings"


def test_one_file_of_splits_chooses_the_frames_of_every_rig(tmp_path: Path) -> None:
    study = STUDY.overridden(["hitsz=folder:x"], ["@my/splits.json", "waymo=0-3"])
    frames = {table.name: table.frames for table in study.dataset}
    assert frames["hitsz"] == "@my/splits.json#hitsz-dev"
    assert frames["kitti-raw"] == "@my/splits.json#test"
    assert frames["waymo"] == "0-3"
    assert frames["ddad"].split(",")[1] == "@my/splits.json#ddad-dev-CAMERA_05"


def test_a_study_without_any_data_says_how_to_give_them() -> None:
    with pytest.raises(InputError, match=r"no data are given; expected --root DIR or --data NAME=DATASET:PATH .*waymo"):
        check_study(STUDY, REGISTRY)
    with pytest.raises(InputError, match="no such folder; expected the folder of the data of studies"):
        STUDY.overridden(root="not/there")
