"""A pose that is moved by hand: about and along which axes, and in what order."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o_pages.view.nudge import Nudge

# A camera that looks along x of a LiDAR whose z is up.
POSE = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.1, -0.2, 0.3])
POINT = np.array([[7.0, 1.0, -2.0]])


@pytest.mark.parametrize(("axis", "moves"), [(0, [0.5, 0, 0]), (1, [0, 0.5, 0]), (2, [0, 0, 0.5])])
def test_a_shift_moves_every_point_along_an_axis_of_the_camera_or_the_lidar(axis: int, moves: list[float]) -> None:
    shift = [0.0, 0.0, 0.0]
    shift[axis] = 0.5
    moved = Nudge("camera", shift_m=tuple(shift)).applied(POSE)
    np.testing.assert_allclose(se3.apply(moved, POINT) - se3.apply(POSE, POINT), [moves], atol=1e-12)
    in_lidar = Nudge("LiDAR", shift_m=tuple(shift)).applied(POSE)
    np.testing.assert_allclose(se3.apply(in_lidar, POINT), se3.apply(POSE, POINT + moves), atol=1e-12)


def test_a_turn_in_the_cameras_axes_is_about_the_camera_and_in_the_lidars_about_the_lidar() -> None:
    """90 deg about y (down) takes what is ahead to the right; about the LiDAR's z (up) what is ahead to the left."""
    moved = Nudge("camera", turn_deg=(0.0, 90.0, 0.0)).applied(POSE)
    x, y, z = se3.apply(POSE, POINT)[0]
    np.testing.assert_allclose(se3.apply(moved, POINT)[0], [z, y, -x], atol=1e-12)
    moved = Nudge("LiDAR", turn_deg=(0.0, 0.0, 90.0)).applied(POSE)
    np.testing.assert_allclose(se3.apply(moved, POINT), se3.apply(POSE, [[-1.0, 7.0, -2.0]]), atol=1e-12)
    np.testing.assert_allclose(se3.apply(moved, np.zeros((1, 3))), POSE[None, :3, 3], atol=1e-12)


def test_it_turns_first_and_shifts_then() -> None:
    both = Nudge("camera", (0.0, 0.0, 90.0), (1.0, 0.0, 0.0)).applied(np.eye(4))
    np.testing.assert_allclose(se3.apply(both, np.array([[2.0, 0, 5]])), [[1.0, 2.0, 5.0]], atol=1e-12)
