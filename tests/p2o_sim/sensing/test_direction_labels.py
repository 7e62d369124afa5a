"""Labels: the occlusion rule on exact depth and normals, and what foliage does to them."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Side, occlusion
from p2o_sim.sensing.rendering import labels, render
from p2o_sim.world.scene import Class, Material, Part, Scene

from tests.p2o_sim.walls import BOX_X, GREY, WORLD_FROM_CAMERA, box, walls

CAMERA = Camera.pinhole(120.0, 120.0, 80.0, 50.0, 161, 101)


def test_the_box_hides_the_wall_on_its_left_right_and_upper_side_along_its_outline() -> None:
    rendered = render(walls(), CAMERA, WORLD_FROM_CAMERA)
    uv, side = occlusion.edges_from_orders(labels(rendered, CAMERA))
    # The front spans 2 m at 5 m: 48 px about the principal point, columns 56 to 104 and rows 26 to 74.
    for direction, axis, at in ((Side.LEFT, 0, 56), (Side.RIGHT, 0, 104), (Side.UPPER, 1, 26)):
        on_it = uv[side == direction]
        assert len(on_it) >= 45
        assert np.abs(on_it[:, axis] - at).max() <= 1
    # Below the box the floor comes nearer than the wall: there is an edge as well, and none on the floor itself.
    assert np.abs(uv[side == Side.BOTTOM][:, 1] - 74).max() <= 1


def test_labels_are_those_of_the_occlusion_rule_on_the_depth_map() -> None:
    rendered = render(walls(), CAMERA, WORLD_FROM_CAMERA)
    exact = labels(rendered, CAMERA)
    from_depth = occlusion.occlusion_orders(rendered.depth_m, CAMERA, connectivity=8)
    differing = sum(int((exact.present[n] != from_depth.present[n]).sum()) for n in exact.present)
    assert differing <= 8  # the corners of the box, where a plane cannot be estimated from two pixels


@pytest.mark.parametrize("masked", [False, True])
def test_edges_of_leaves_are_left_out_on_request_and_edges_before_leaves_are_kept(masked: bool) -> None:
    leaf = Material("leaf", (0.1, 0.2, 0.05))
    bush = Part(box(1.0, 6.0, -3.0, 3.0).moved(20.0), leaf, 0, Class.FOLIAGE)
    post = Part(box(0.5, 1.0, -2.0, 2.0).moved(BOX_X), GREY, 1, Class.POLE)
    wall = Part(box(1.0, 200.0, -50.0, 100.0).moved(40.0), GREY, 2, Class.WALL)
    rendered = render(Scene((bush, post, wall)), CAMERA, WORLD_FROM_CAMERA)
    uv, _ = occlusion.edges_from_orders(labels(rendered, CAMERA, mask_foliage=masked))
    kinds = rendered.classes[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    assert (kinds == Class.POLE).sum() > 50
    assert ((kinds == Class.FOLIAGE).sum() == 0) == masked
