"""A point is hidden behind nearer surfaces on both sides, not beside an edge."""

from __future__ import annotations

import numpy as np
from p2o import se3
from p2o.geometry.visibility import hidden

from tests.edge_scene import PINHOLE


def wall(depth: float, x: tuple[float, float]) -> np.ndarray:
    """Points of an upright wall in the camera frame, 5 cm apart."""
    xs, ys = np.meshgrid(np.arange(*x, 0.05), np.arange(-1.0, 1.0, 0.05))
    return np.column_stack([xs.ravel(), ys.ravel(), np.full(xs.size, depth)])


def test_points_behind_a_wall_are_hidden_and_points_beside_it_outside_or_behind_the_camera_are_not() -> None:
    surface = wall(10.0, (-2.0, 2.0))
    points = np.array([[0.0, 0, 20], [8, 0, 20], [0, 0, 9], [0, 0, 10], [0, 0, -20], [500, 0, 20]])
    assert hidden(points, surface, PINHOLE, np.eye(4)).tolist() == [True, *[False] * 5]
    # Nor is the silhouette of a far object right beside a near one.
    surface = wall(10.0, (-2.0, 0.0))
    point = np.array([[0.02, 0.0, 20.0]])
    assert not hidden(point, surface, PINHOLE, np.eye(4)).any()


def test_the_answer_does_not_depend_on_the_lidar_frame() -> None:
    move = se3.exp(np.array([0.4, -0.3, 0.2, 1.0, 2.0, -3.0]))
    surface, points = wall(10.0, (-2.0, 2.0)), np.array([[0.0, 0.0, 20.0], [8.0, 0.0, 20.0], [0.0, 0.5, 15.0]])
    here = hidden(points, surface, PINHOLE, np.eye(4))
    there = hidden(se3.apply(move, points), se3.apply(move, surface), PINHOLE, se3.inverse(move))
    assert here.tolist() == there.tolist() == [True, False, True]
