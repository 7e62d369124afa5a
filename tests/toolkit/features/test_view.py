"""Sides are told in image axes, however the sensors are mounted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import SIDES, CloudFeatures, Side, se3

from tests import edge_scene


@pytest.mark.parametrize(
    ("roll_deg", "becomes"),
    [
        (0, {side: side for side in SIDES}),
        (90, {Side.LEFT: Side.UPPER, Side.UPPER: Side.RIGHT, Side.RIGHT: Side.BOTTOM, Side.BOTTOM: Side.LEFT}),
        (180, {Side.LEFT: Side.RIGHT, Side.UPPER: Side.BOTTOM, Side.RIGHT: Side.LEFT, Side.BOTTOM: Side.UPPER}),
    ],
)
def test_a_rolled_camera_sees_other_sides(roll_deg: float, becomes: dict[Side, Side]) -> None:
    view = edge_scene.view()
    roll = se3.exp(np.array([0, 0, np.radians(roll_deg), 0, 0, 0]))
    again = view.as_seen_from(roll @ edge_scene.TRUTH)
    expected = np.array([becomes[Side(int(s))] for s in view.cloud_edges.side])
    assert (again.cloud_edges.side == expected).all()


def test_edges_without_a_background_direction_keep_their_letter() -> None:
    view = edge_scene.view()
    edges = replace(view.cloud_edges, background=np.zeros((len(view.cloud_edges), 3)))
    bare = replace(view, cloud=CloudFeatures(edges))
    roll = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    assert (bare.as_seen_from(roll @ edge_scene.TRUTH).cloud_edges.side == edges.side).all()


def test_moving_the_lidar_frame_moves_nothing_in_the_image() -> None:
    view = edge_scene.view()
    move = se3.exp(np.array([0.4, -0.3, 0.2, 1.0, 2.0, -3.0]))
    there = view.moved(move).as_seen_from(edge_scene.TRUTH @ se3.inverse(move))
    assert (there.cloud_edges.side == view.cloud_edges.side).all()
    pixels = [
        edge_scene.PINHOLE.project(se3.apply(pose, v.cloud_edges.xyz))
        for pose, v in ((edge_scene.TRUTH, view), (edge_scene.TRUTH @ se3.inverse(move), there))
    ]
    np.testing.assert_allclose(pixels[0], pixels[1], atol=1e-8)
