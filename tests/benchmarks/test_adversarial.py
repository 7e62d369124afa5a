"""Adversarial inputs: what counts as a false accept, and what the changes do to a frame."""

from __future__ import annotations

from dataclasses import replace

import adversarial_cases as cases
import numpy as np
import pytest
from adversarial import Row, tables
from p2o_testing import stage

GOOD = Row("rig", "unchanged", "", ("a",), "trusted", (), 0.2, 0.05, 0.5, 0.1)


def test_a_trusted_result_is_a_false_accept_where_no_pose_is_right_and_elsewhere_beyond_the_limits() -> None:
    assert not GOOD.wrong
    assert replace(GOOD, rotation_deg=1.2).wrong
    assert replace(GOOD, translation_m=0.4).wrong
    assert replace(GOOD, kind="mirrored image").wrong
    assert not replace(GOOD, kind="mirrored image").good


def test_the_table_counts_false_accepts_and_false_refusals_by_kind() -> None:
    kind = "focal length 3 %"
    rows = [
        GOOD,
        replace(GOOD, verdict="doubtful", why=("too-unsure",)),
        replace(GOOD, kind=kind, rotation_deg=1.5),
        replace(GOOD, kind=kind, verdict="ambiguous", why=("rival-pose",), rotation_deg=1.5),
    ]
    lines = {
        line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]]
        for line in tables(rows).split("\n")
        if line
    }
    assert lines["unchanged"][:5] == ["2 (1)", "1", "0 (0.0 %)", "0", "1 of 2"]
    assert lines[kind][:5] == ["2 (1)", "1", "1 (50.0 %)", "1", "0 of 0"]
    assert lines[kind][-1] == "rival-pose 1"


@pytest.mark.parametrize("kind", cases.CHANGES)
def test_a_change_keeps_the_truth_and_changes_one_of_image_camera_and_sweep(kind: str) -> None:
    frame = stage.frame()
    for change in cases.CHANGES[kind].values():
        after = change([frame], 0)
        assert after.camera_from_lidar is not None
        assert np.allclose(after.camera_from_lidar, frame.camera_from_lidar, atol=1e-12)
        same = (
            np.array_equal(after.image.rgb, frame.image.rgb),
            after.camera == frame.camera,
            np.array_equal(after.cloud.xyz, frame.cloud.xyz),
        )
        assert same.count(False) == 1
