"""`idt` and `line-idt`: inverse distance transforms, ring jumps, and lines."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.edges.idt import build
from p2o_baselines.edges.inverse_distance import edge_strength, inverse_distance, spread
from p2o_baselines.edges.line_points import along_lines, range_image_jumps
from p2o_baselines.edges.ring_discontinuity import ring_jumps
from p2o_testing import stage


@pytest.mark.parametrize("gamma", [0.6, 0.98])
def test_one_edge_pixel_spreads_by_gamma_to_the_chebyshev_distance(gamma: float) -> None:
    edge = np.zeros((31, 47))
    edge[12, 20] = 3.0
    v, u = np.mgrid[:31, :47]
    far = np.maximum(np.abs(u - 20), np.abs(v - 12))
    np.testing.assert_allclose(spread(edge, gamma), 3.0 * gamma**far, rtol=1e-12)
    np.testing.assert_allclose(inverse_distance(edge, 0.25, gamma), 0.25 * edge + 2.25 * gamma**far, rtol=1e-12)


def test_the_transform_is_the_largest_over_all_edges() -> None:
    edges = np.random.default_rng(0).uniform(0, 255, (17, 23)) ** 3
    v, u = np.mgrid[:17, :23]
    far = np.maximum(np.abs(u[..., None, None] - u), np.abs(v[..., None, None] - v))
    np.testing.assert_allclose(spread(edges, 0.9), (edges * 0.9**far).max(axis=(2, 3)), rtol=1e-12)


def test_the_strength_of_an_edge_is_its_largest_step_to_a_neighbour() -> None:
    grey = np.full((5, 5), 100.0)
    grey[2, 2] = 70.0
    strength = edge_strength(grey)
    assert strength[1:4, 1:4].min() == strength.max() == 30.0
    assert strength[0].max() == 0.0


def ring_of(ranges: list[float], step_deg: float = 0.2) -> p2o.Cloud:
    angle = np.radians(step_deg * np.arange(len(ranges)))
    xyz = np.array(ranges)[:, None] * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    return p2o.Cloud(xyz, ring=np.zeros(len(ranges), int))


def test_only_the_near_side_of_a_jump_counts() -> None:
    rows, jump = ring_jumps(ring_of([9.0, 9.0, 5.0, 5.1, 5.0, 7.0]), 0.3, 0.6)
    assert rows.tolist() == [2, 4]
    np.testing.assert_allclose(jump, [4.0, 2.0])
    gap = ring_of([9.0] * 20 + [7.0] * 5 + [5.0] * 20).select(np.r_[0:20, 25:45])
    assert len(ring_jumps(gap, 0.3, 0.6)[0]) == 0, "a missing return"
    assert sorted(ring_jumps(ring_of([5.0] * 1799 + [9.0]), 0.3, 0.6)[0]) == [0, 1798], "rings are closed"


def test_points_along_a_line_are_kept_and_those_of_a_cloud_are_not() -> None:
    rng = np.random.default_rng(1)
    line = np.column_stack([np.full(20, 5.0), np.full(20, 1.0), np.linspace(0, 2, 20)])
    ball = rng.normal(0, 0.15, (20, 3)) + [5.0, 4.0, 0.0]
    keep = along_lines(np.vstack([line, ball]), np.full(40, 0.3), 3, 0.95)
    assert keep[1:19].all()  # its ends have too few neighbours
    assert keep[20:].mean() < 0.3


def test_a_joined_cloud_shows_its_jumps_in_a_picture() -> None:
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-3, 3, 901), np.linspace(-1, 1, 61)))
    wall = np.column_stack([np.full(y.shape, 12.0), y, z])
    post = np.column_stack([np.full(y.shape, 6.0), y, z])[np.abs(y) < 0.3]
    rows, jump = range_image_jumps(np.vstack([wall, post]), np.radians(0.2), 0.5)
    found = np.vstack([wall, post])[rows]
    assert (found[:, 0] == 6.0).all()
    assert np.abs(np.abs(found[:, 1]) - 0.3).max() < 0.021  # within a cell of the post's sides
    assert set(np.sign(found[:, 1])) == {-1.0, 1.0}
    np.testing.assert_allclose(jump, 6.0, atol=0.3)


def test_a_point_that_leaves_the_image_is_neither_won_nor_lost() -> None:
    """With a map of one value everywhere no pose is better than another, whatever it shows."""
    from p2o_baselines.edges.inverse_distance import InverseDistanceMap

    view = stage.view()
    flat = view.image.having(InverseDistanceMap(np.full((240, 480), 3.0)))
    problem = build(p2o.Options())([p2o.View("flat", view.camera, flat, view.cloud)], stage.camera_from_lidar(), 5.0)
    turned = p2o.se3.exp(np.array([[0, a, 0, 0, 0, 0] for a in (0.0, 0.1, 0.4)])) @ stage.camera_from_lidar()
    np.testing.assert_allclose(problem.cost(turned), -3.0)
