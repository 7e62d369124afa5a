"""The local minimum of the directed distance does not depend on where the descent began."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.problems.directed_fit import nearest_minimum
from p2o.solving import DirectedCost

from tests import edge_scene
from tests.edge_scene import TRUTH


@pytest.mark.parametrize("noise_px", [0.5, 1.0])
def test_descents_from_poses_near_by_end_at_one_pose_of_lower_cost(noise_px: float) -> None:
    cost = DirectedCost.of([edge_scene.view(noise_px=noise_px)], TRUTH, 5.0, margin_px=30.0)
    starts = [wrong_start(TRUTH, 0.1, 0.01, np.random.default_rng(seed)) for seed in range(4)]
    ends = [nearest_minimum(cost, start) for start in starts]
    for start, end in zip(starts, ends, strict=True):
        assert cost.at(end) < cost.at(start)
        apart = pose_error(end, ends[0])
        assert apart.rotation_deg < 0.03
        assert apart.translation_m < 0.01


def test_a_cost_without_points_keeps_the_pose() -> None:
    behind = se3.exp(np.array([0.0, np.pi, 0, 0, 0, 0])) @ TRUTH
    cost = DirectedCost.of([edge_scene.view()], behind, 5.0)
    assert not cost.points
    assert nearest_minimum(cost, TRUTH) is TRUTH
