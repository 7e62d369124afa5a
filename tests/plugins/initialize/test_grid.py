"""The grid spans rotations in degrees about each axis, and the best of its cells are refined."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o_plugins.initialize import grid

from tests import edge_scene


@pytest.mark.parametrize("axis", range(3))
def test_a_rotation_within_the_grid_is_found(axis: int) -> None:
    turn = np.zeros(6)
    turn[axis] = np.radians(6.0)
    start = se3.exp(turn) @ edge_scene.TRUTH
    options = grid.GridOptions(max_angle_deg=6.0, step_deg=3.0)
    pose, *_ = grid.build(options)([edge_scene.view()], start)
    assert se3.angle_deg(pose @ se3.inverse(edge_scene.TRUTH)) < 0.3
