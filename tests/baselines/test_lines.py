"""Lines and planes on scenes in closed form: `lsd`, `plane-lines`, `lines`, `voxel-planes`, `canny-long`,
`knn-line`."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.edges import canny_long, knn_line, lines, lsd, plane_lines, voxel_planes
from p2o_baselines.edges.lsd import ImageLines
from p2o_baselines.edges.plane_lines import CloudLines
from p2o_testing import stage


def image(grey: np.ndarray, masked: np.ndarray | None = None) -> p2o.Image:
    height, width = grey.shape
    rgb = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    return p2o.Image(rgb, p2o.Camera.pinhole(100, 100, width / 2, height / 2, width, height), masked=masked)


def box() -> np.ndarray:
    """A bright rectangle, columns 30 to 99 and rows 20 to 69 of 140x100 px."""
    grey = np.full((100, 140), 50.0)
    grey[20:70, 30:100] = 200.0
    return grey


# ---- image side


def test_lsd_finds_the_four_sides_of_a_rectangle() -> None:
    found = lsd.METHOD.build(lsd.METHOD.options())(image(box()))
    ends = found.get("image-lines").ends
    assert len(ends) == 4
    upright = np.abs(ends[:, 1, 0] - ends[:, 0, 0]) < 1.0
    assert sorted(ends[upright].mean(axis=1)[:, 0]) == pytest.approx([29.5, 99.5], abs=0.7)
    assert sorted(ends[~upright].mean(axis=1)[:, 1]) == pytest.approx([19.5, 69.5], abs=0.7)
    steps = np.linalg.norm(np.diff(found.edges.uv[:40], axis=0), axis=1)
    assert steps.max() <= 1.0 + 1e-9
    assert (found.edges.side == p2o.Side.NONE).all()


def test_masked_and_short_segments_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lsd, "_MIN_LENGTH_PX", 30.0)
    masked = np.zeros((100, 140), bool)
    masked[:, 90:] = True
    ends = lsd.METHOD.build(lsd.METHOD.options())(image(box(), masked)).get("image-lines").ends
    assert len(ends) == 1  # the left side; both level ones reach into the mask
    assert ends[0, :, 0] == pytest.approx([29.5, 29.5], abs=0.7)


def test_canny_long_keeps_long_contours_only() -> None:
    grey = box()
    grey[80:90, 110:120] = 200.0  # 40 px around
    edges = canny_long.METHOD.build(canny_long.CannyLongOptions())(image(grey)).edges
    assert len(edges) > 150
    assert edges.uv[:, 1].max() < 75


# ---- lines


LINES = np.array(
    [
        [[6.0, 2.0, -1.0], [6.0, 2.0, 1.0]],
        [[9.0, -2.0, -1.0], [9.0, -2.0, 0.5]],
        [[8.0, -1.0, 0.8], [8.0, 1.0, 0.8]],
        [[12.0, -3.0, -1.0], [12.0, 2.0, -1.2]],
        [[7.0, 0.5, -0.8], [10.0, 0.5, -0.8]],
    ]
)


def line_view() -> p2o.View:
    """Five lines and what the camera of the stage sees of them."""
    uv = stage.camera().project(p2o.se3.apply(stage.camera_from_lidar(), LINES.reshape(-1, 3))).reshape(-1, 2, 2)
    return p2o.View(
        "lines",
        stage.camera(),
        p2o.ImageFeatures(features=[ImageLines(uv)]),
        p2o.CloudFeatures(features=[CloudLines(LINES)]),
    )


def test_lines_lead_back_to_the_truth() -> None:
    from p2o_plugins.solve import lm

    truth = stage.camera_from_lidar()
    pose = p2o.se3.exp(np.array([0.01, -0.008, 0.012, 0.04, -0.03, 0.05])) @ truth
    match, solve = lines.build(lines.METHOD.options()), lm.METHOD.build(lm.LmOptions())
    for _ in range(5):
        pose = solve(match([line_view()], pose, 20.0), pose).camera_from_lidar
    np.testing.assert_allclose(pose, truth, atol=1e-6)


def test_lines_that_run_another_way_or_lie_beyond_are_not_paired() -> None:
    near = np.array([[[10.0, 10.0], [10.0, 50.0]]])
    level, beyond, beside = np.array([[[8.0, 30], [12, 30]], [[10, 70], [10, 90]], [[12, 20], [12, 40]]])
    found = lines.nearest_lines(np.stack([level, beyond, beside]), near, 5.0, 8.0)
    assert found.tolist() == [-1, -1, 0]


# ---- planes


def corner(step_m: float = 0.05) -> np.ndarray:
    """A floor at z = -1.5 and a wall at y = 3.5 that meet along x, from 5 to 9 m."""
    x, a = (v.ravel() for v in np.meshgrid(np.arange(5, 9, step_m), np.arange(0, 1.3, step_m)))
    floor = np.column_stack([x, 3.5 - a, np.full(x.shape, -1.5)])
    wall = np.column_stack([x, np.full(x.shape, 3.5), -1.5 + a])
    return np.vstack([floor, wall])


def test_two_planes_meet_along_their_edge() -> None:
    edges = voxel_planes.METHOD.build(voxel_planes.VoxelPlanesOptions())(p2o.Cloud(corner())).edges
    assert len(edges) > 100
    np.testing.assert_allclose(edges.xyz[:, 1], 3.5, atol=1e-6)
    np.testing.assert_allclose(edges.xyz[:, 2], -1.5, atol=1e-6)
    assert edges.xyz[:, 0].min() < 5.1
    assert edges.xyz[:, 0].max() > 8.8


def test_one_plane_has_no_edge_and_planes_apart_have_none() -> None:
    extract = voxel_planes.METHOD.build(voxel_planes.VoxelPlanesOptions())
    floor = corner()[: len(corner()) // 2]
    assert len(extract(p2o.Cloud(floor)).edges) == 0
    apart = corner()
    apart = apart[(apart[:, 1] < 3.1) | (apart[:, 2] > -1.1)]  # nothing within 0.4 m of where they meet
    assert len(extract(p2o.Cloud(apart)).edges) == 0


def test_borders_grow_into_segments_and_end_at_gaps() -> None:
    post = np.column_stack([np.full(20, 6.0), np.full(20, 1.0), np.linspace(-1, 1, 20)])
    beam = np.column_stack([np.full(20, 8.0), np.linspace(-2, 0, 20), np.full(20, 0.5)])
    on = beam + [0.0, 4.0, 0.0]  # goes on along the same line after a gap of 2 m
    found = [np.sort(np.round(ends, 6), axis=0).tolist() for ends in plane_lines.grown(np.vstack([post, beam, on]))]
    assert sorted(found) == [
        [[6.0, 1.0, -1.0], [6.0, 1.0, 1.0]],
        [[8.0, -2.0, 0.5], [8.0, 0.0, 0.5]],
        [[8.0, 2.0, 0.5], [8.0, 4.0, 0.5]],
    ]


# ---- pairs


def test_knn_line_asks_for_the_same_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    """Image edges that run level, cloud edges that stand upright."""
    view = stage.view().without_sides()
    along = np.linspace(0, 100, 300)
    level = p2o.ImageEdges(np.column_stack([190 + along, np.full(300, 118.0)]), np.full(300, -1, np.int8))
    truth = stage.camera_from_lidar()
    rays = stage.camera().rays(np.column_stack([np.full(200, 240.0), np.linspace(90, 146, 200)]))
    xyz = p2o.se3.apply(p2o.se3.inverse(truth), 10.0 * rays)
    upright = p2o.CloudEdges(xyz, np.full(200, -1, np.int8))
    crossed = p2o.View("crossed", view.camera, p2o.ImageFeatures(level), p2o.CloudFeatures(upright))
    match = knn_line.build(p2o.Options())
    assert len(match([crossed], truth, 15.0)) == 0
    monkeypatch.setattr(knn_line, "_MAX_ANGLE_DEG", 90.0)
    assert len(match([crossed], truth, 15.0)) > 20
