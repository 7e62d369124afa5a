"""One calibration of the edges of all cameras of a rig: sparse sweeps, and the same result in a worker process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.cli import main
from p2o_sim.synthetic import SyntheticOptions, truth_at

CAMERAS = ("front", "left", "right", "back")
SPARSE = "synthetic:?cameras={}&width_px=621&height_px=240&place=street&right=false&lidar=vlp-16"


def places(*names: str) -> dict[str, dict[str, list[list[float]]]]:
    """Return the content of a rig file of these cameras; the body is the LiDAR, so that the truth is the identity."""
    return {name: {"camera_from_body": truth_at(SyntheticOptions(), 0, 0, name).tolist()} for name in names}


def test_sixteen_rings_determine_the_pose_with_all_cameras_where_they_do_not_with_one() -> None:
    data, rig = SPARSE.format(",".join(CAMERAS)), {"cameras": places(*CAMERAS)}
    run = p2o.calibrate(data, extractor="depth/rings", perturb="2deg 0.15m", rig=rig)
    assert run.rig is not None
    assert run.rig.body_from_lidar is not None
    alone = [row.error.rotation_deg for row in run.rows if row.error is not None]
    assert se3.angle_deg(run.rig.body_from_lidar) < min(0.2, np.median(alone))
    assert se3.distance_m(run.rig.body_from_lidar) < 0.03
    assert run.rig.verdict.trusted


def test_a_worker_process_gives_the_same_common_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"cameras": places("front", "left")}))
    words = ["run", "--data", SPARSE.format("front,left"), "--extractor", "depth/rings", "--rig", str(path), "--json"]
    common = []
    for more in ([], ["--isolate"]):
        assert main([*words, *more]) in (0, 1)
        common.append(json.loads(capsys.readouterr().out)["rig"])
    assert common[0]["body_from_lidar"] is not None
    np.testing.assert_allclose(common[0]["body_from_lidar"], common[1]["body_from_lidar"], atol=1e-9)
    assert common[0]["verdict"] == common[1]["verdict"]
