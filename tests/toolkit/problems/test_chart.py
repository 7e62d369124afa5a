"""The chart of poses around a start."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o.problems.problem import left_from_chart, pose_from_chart

from tests.edge_scene import TRUTH


def test_the_last_three_numbers_shift_the_camera_coordinates() -> None:
    moved = pose_from_chart(TRUTH, np.array([0, 0, 0, 1.0, 2.0, 3.0]))
    assert moved[:3, 3] - TRUTH[:3, 3] == pytest.approx([1, 2, 3])
    assert (moved[:3, :3] == TRUTH[:3, :3]).all()
    assert (pose_from_chart(TRUTH, np.zeros(6)) == TRUTH).all()
    assert (left_from_chart(np.zeros(6)) == np.eye(6)).all()
    deltas = np.random.default_rng(0).normal(size=(4, 6))
    assert pose_from_chart(TRUTH, deltas) == pytest.approx(np.stack([pose_from_chart(TRUTH, d) for d in deltas]))


@pytest.mark.parametrize("seed", range(5))
def test_changes_of_the_chart_become_left_updates(seed: int) -> None:
    delta, step = np.random.default_rng(seed).normal(size=6) * 0.5, 1e-6
    for axis, unit in enumerate(np.eye(6)):
        ahead, behind = pose_from_chart(TRUTH, delta + step * unit), pose_from_chart(TRUTH, delta - step * unit)
        left = se3.log(ahead @ se3.inverse(behind)) / (2 * step)
        assert left_from_chart(delta)[:, axis] == pytest.approx(left, abs=1e-6)
