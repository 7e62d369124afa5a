"""Cues beside directed edges: each one finds a known pose, or does not exist where nothing determines it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from cue_estimates import CUES, UNIT, Cue, edges_cue, motion, moved, pipeline_of, rays_cue, verticals
from cues import Stated, table
from p2o import Cloud, Frame, Image
from p2o.problems.points_on_rays import PointsOnRays
from p2o_testing import stage

TRUTH = stage.camera_from_lidar()
STEP = np.array([0.2, -0.25, 0.3, 0.1, -0.1, 0.2])


def street() -> Frame:
    """Return a frame of flat ground and upright posts, in a room that neither sensor sees."""
    rgb = np.full((240, 480, 3), 200, np.uint8)
    rng = np.random.default_rng(0)
    for y in np.linspace(-6.0, 6.0, 13):
        bottom, top = stage.camera().project([[9.0, y, -1.5], [9.0, y, 2.0]] @ TRUTH[:3, :3].T + TRUTH[:3, 3])
        side = 4 * np.array([[-1, 0], [1, 0], [1, 0], [-1, 0]])
        corners = np.array([bottom, bottom, top, top]) + side
        cv2.fillPoly(rgb, [np.round(16 * corners).astype(np.int32)], (40, 40, 40), cv2.LINE_AA, 4)
    ground = np.column_stack([rng.uniform(-15, 15, (5000, 2)), np.full(5000, -1.7)])
    return Frame("street", Image(rgb, stage.camera()), Cloud(ground))


def test_mutual_information_leads_from_a_wrong_pose_to_the_truth() -> None:
    cue = CUES["mutual information"]([stage.frame()], [stage.view()], moved(TRUTH, -STEP))
    assert cue is not None
    expected = cue.directions @ STEP
    assert np.linalg.norm(expected) > 0.25
    assert np.linalg.norm(cue.directions @ cue.step - expected) < 0.5 * np.linalg.norm(expected)


def test_vertical_directions_lead_to_the_true_roll_and_pitch_and_do_not_observe_yaw() -> None:
    step = np.array([0.6, 0.0, -0.5, 0.0, 0.0, 0.0])
    cue = verticals([street()], moved(TRUTH, -step))
    assert cue is not None
    assert cue.step == pytest.approx(step, abs=0.15)
    assert len(cue.directions) == 2
    up = np.concatenate([TRUTH[:3, :3] @ [0.0, 0.0, 1.0], np.zeros(3)])
    assert cue.directions @ up == pytest.approx(np.zeros(2), abs=0.05)


def test_the_cue_of_other_edges_leads_to_the_truth() -> None:
    cue = edges_cue([stage.view()], moved(TRUTH, -STEP), pipeline_of("canny/rings", "nearest"))
    assert cue is not None
    assert cue.directions @ cue.step == pytest.approx(cue.directions @ STEP, abs=0.05)
    assert len(cue.directions) == 6


@pytest.mark.parametrize(
    "name", ["mutual information", "information distance", "canny image edges", "vertical directions"]
)
def test_a_cue_does_not_exist_without_features(name: str) -> None:
    frame = replace(stage.frame(), image=stage.featureless_image(), cloud=stage.featureless_cloud())
    assert CUES[name]([frame], [stage.bare_view()], TRUTH) is None


def rays(count: int, wrong: int) -> tuple[PointsOnRays, Any]:
    rng = np.random.default_rng(0)
    xyz = rng.uniform([5.0, -5.0, -1.0], [20.0, 5.0, 3.0], (count, 3))
    seen = xyz @ TRUTH[:3, :3].T + TRUTH[:3, 3]
    seen[:wrong] += rng.normal(0, 3.0, (wrong, 3))
    directions = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    return PointsOnRays(xyz, directions, np.full(count, 600.0)), np.floor(600 * directions[:, :2] / 64)


def test_matched_features_find_the_truth_in_spite_of_wrong_matches_and_not_from_few_of_them() -> None:
    cue = rays_cue(*rays(120, 40), moved(TRUTH, -STEP))
    assert cue is not None
    assert cue.directions @ cue.step == pytest.approx(cue.directions @ STEP, abs=0.02)
    assert rays_cue(*rays(15, 0), TRUTH) is None


def test_motion_does_not_exist_for_two_frames() -> None:
    assert motion(stage.drive()[:2], TRUTH)[0] is None


def test_the_chi_square_compares_a_difference_with_the_errors_of_both_and_fusion_weighs_by_them() -> None:
    cue = Cue(np.array([3.0, 0, 0, 0, 0, 9.0]), np.eye(6)[:1], np.array([[4.0]]))
    edges = np.diag([5.0, 1, 1, 1, 1, 1])
    assert cue.chi_square(edges) == pytest.approx(9 / (4 + 5))
    assert cue.chi_square(edges, 2.0) == pytest.approx(9 / (16 + 5))
    assert cue.fused(edges) == pytest.approx([3 * 5 / 9, 0, 0, 0, 0, 0])


def test_directions_with_large_errors_are_not_observable() -> None:
    cue = Cue.of(np.zeros(6), np.diag([0.01, 0.01, 0.01, 0.01, 0.01, 4.0]), np.eye(6))
    assert cue is not None
    assert len(cue.directions) == 5
    assert cue.directions[:, 5] == pytest.approx(np.zeros(5))
    assert Cue.of(np.zeros(6), 4.0 * np.eye(6), np.eye(6)) is None


def row(case: str, off: float, source: str = "kitti-raw") -> dict[str, Any]:
    """Return a row whose result differs by `off` deg from a cue that is right, with deviations of 0.1 deg each."""
    truth = moved(TRUTH, np.array([off, 0, 0, 0, 0, 0]))
    stated = {"step": [off, 0, 0, 0, 0, 0], "directions": np.eye(6)[:1].tolist(), "covariance": [[0.01]]}
    return {
        "source": source,
        "kind": "focal length 3 %",
        "variant": "+",
        "frames": [f"{case}{off}"],
        "case": case,
        "pose": TRUTH.tolist(),
        "truth": truth.tolist(),
        "edges": (0.01 * np.eye(6)).tolist(),
        "cues": {"mutual information": stated},
        "cue_seconds": {"mutual information": 0.5},
    }


def test_a_result_is_detected_if_it_differs_from_a_cue_by_more_than_right_results_do() -> None:
    rows = [row("right", off) for off in (0.1, 0.12, -0.1, 0.15)] + [row("right", 0.1, "waymo")]
    text = table([*rows, row("wrong", 1.0), row("wrong", 0.05), row("moved", 0.8)])
    line = next(line for line in text.splitlines() if line.startswith("| mutual information"))
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    assert cells[1] == "5 of 5"
    assert cells[4:7] == ["0 of 1", "1 of 2", "1 of 1"]
    assert "| focal length 3 % | 1 of 2 |" in text


def test_fusion_moves_a_result_half_way_to_a_cue_of_the_same_error() -> None:
    turn, shift = Stated(row("right", 0.2), "mutual information").gain(1.0)
    assert turn == pytest.approx(-0.1, abs=0.001)
    assert shift == pytest.approx(0.0, abs=1.0)
    assert UNIT[0] == pytest.approx(np.radians(1.0))
