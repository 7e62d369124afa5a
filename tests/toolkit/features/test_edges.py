"""Features are checked when they are made, and stay consistent through every change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, InputError, Side, se3

UV = np.array([[10.0, 20], [30, 40], [50, 60], [70, 80], [90, 10]])
SIDES = np.array([Side.LEFT, Side.NONE, Side.LEFT, Side.BOTTOM, Side.RIGHT], np.int8)
XYZ = np.array([[10.0, 1, 0], [12, -3, 1], [8, 0, -1], [30, 5, 2], [6, 2, 0.5]])


def image_edges() -> ImageEdges:
    return ImageEdges(UV, SIDES, np.arange(5.0))


def cloud_edges() -> CloudEdges:
    background = np.tile([0.0, 1, 0], (5, 1))
    return CloudEdges(XYZ, SIDES, np.arange(5.0), 0.01 * np.arange(5), background)


def test_arrays_are_read_only_and_of_fixed_types() -> None:
    edges = ImageEdges(UV.astype(np.float32), SIDES.tolist(), [1, 2, 3, 4, 5])
    assert (edges.uv.dtype, edges.side.dtype, edges.weight.dtype) == (np.float64, np.int8, np.float64)
    for array in (edges.uv, edges.side, edges.weight):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert (ImageEdges(UV, SIDES).weight == 1).all(), "unless it is given"


@pytest.mark.parametrize(
    ("uv", "side", "weight", "text"),
    [
        (UV[:, :1], SIDES, None, r"uv of the image edges has the wrong shape; expected \(any, 2\); got \(5, 1\)"),
        (UV.ravel(), SIDES, None, "uv of the image edges has the wrong shape"),
        (UV, SIDES[:4], None, r"side of the image edges has the wrong shape; expected \(5\); got \(4,\)"),
        (UV, SIDES, np.ones(4), "weight of the image edges has the wrong shape"),
        (UV, SIDES, -np.ones(5), "weight of the image edges is negative; expected weights >= 0; got -1"),
        (UV, SIDES, np.full(5, np.nan), "weight of the image edges contains values that are not finite"),
        (np.where(UV == 10, np.nan, UV), SIDES, None, "uv of the image edges .* not finite.*got 2 NaN"),
        (UV, np.array([0, 1, 2, 3, 4]), None, "unknown direction; expected -1 .none., 0 L, 1 R, 2 U, 3 B; got 4"),
        (UV, np.array([0, 1, 2, 3, -2]), None, "unknown direction.*got -2"),
        (UV, np.array([0, 1, 2, 3, 256]), None, "unknown direction.*got 256"),
        (UV, [0, 1, 2, 3, 300], None, "unknown direction.*got 300"),
        (UV, np.array([0, 1, 2, 3, 0.7]), None, "unknown direction.*got 0.7"),
        (UV, np.array([0, 1, 2, 3, np.nan]), None, "side of the image edges .* not finite"),
        (UV, list("LRUBL"), None, "side of the image edges is not an array of numbers"),
    ],
)
def test_wrong_image_edges_are_refused(uv: object, side: object, weight: object, text: str) -> None:
    with pytest.raises(InputError, match=text):
        ImageEdges(uv, side, weight)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"xyz": XYZ[:, :2]}, r"xyz of the cloud edges has the wrong shape; expected \(any, 3\)"),
        ({"xyz": np.where(XYZ == 10, np.inf, XYZ)}, "xyz of the cloud edges .* not finite"),
        ({"side": SIDES[:2]}, "side of the cloud edges has the wrong shape"),
        ({"side": np.full(5, 7)}, "unknown direction"),
        ({"weight": -np.ones(5)}, "weight of the cloud edges is negative"),
        ({"sigma_m": -np.ones(5)}, "sigma_m of the cloud edges is negative"),
        ({"time_s": np.zeros(4)}, "time_s of the cloud edges has the wrong shape"),
        ({"time_s": np.full(5, np.nan)}, "time_s of the cloud edges .* not finite"),
        ({"background": np.zeros((5, 2))}, "background of the cloud edges has the wrong shape"),
    ],
)
def test_wrong_cloud_edges_are_refused(changed: dict[str, np.ndarray], text: str) -> None:
    with pytest.raises(InputError, match=text):
        CloudEdges(**{"xyz": XYZ, "side": SIDES, **changed})


@pytest.mark.parametrize("kind", [ImageEdges, CloudEdges])
def test_no_edges_are_edges_too(kind: type[ImageEdges] | type[CloudEdges]) -> None:
    none = kind.empty()
    assert len(none) == len(none.weight) == len(none.select(np.zeros(0, bool))) == len(none.without_sides()) == 0
    assert (ImageEdges.empty().sides, ImageEdges.empty().trees) == ((), {})


def test_rows_and_trees_of_a_side_belong_together() -> None:
    edges = image_edges()
    assert edges.sides == (Side.NONE, Side.LEFT, Side.RIGHT, Side.BOTTOM)
    assert sorted(np.concatenate(list(edges.index.values())).tolist()) == [0, 1, 2, 3, 4]
    for side, rows in edges.index.items():
        assert (edges.side[rows] == side).all()
        distance, nearest = edges.trees[side].query(edges.uv[rows] + 0.1)
        np.testing.assert_array_equal(rows[nearest], rows)
        np.testing.assert_allclose(distance, np.hypot(0.1, 0.1))


def test_selecting_keeps_all_fields_of_a_row_together() -> None:
    for keep in (np.array([True, False, True, False, False]), np.array([0, 2])):
        image, cloud = image_edges().select(keep), cloud_edges().select(keep)
        np.testing.assert_array_equal(image.uv, UV[keep])
        np.testing.assert_array_equal(image.side, SIDES[keep])
        np.testing.assert_array_equal(image.weight, [0, 2])
        np.testing.assert_array_equal(cloud.xyz, XYZ[keep])
        np.testing.assert_array_equal(cloud.sigma_m, [0, 0.02])
        np.testing.assert_array_equal(cloud.background, [[0, 1, 0], [0, 1, 0]])
        assert set(image.trees) == {Side.LEFT}


def test_moving_the_frame_moves_points_and_turns_directions() -> None:
    b_from_lidar = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    b_from_lidar[:3, 3] = [1, 2, 3]
    moved = cloud_edges().moved(b_from_lidar)
    np.testing.assert_allclose(moved.xyz[0], [-1 + 1, 10 + 2, 0 + 3], atol=1e-12)  # x to y, y to -x
    np.testing.assert_allclose(moved.background, np.tile([-1.0, 0, 0], (5, 1)), atol=1e-12)
    np.testing.assert_array_equal(moved.side, SIDES)
    np.testing.assert_array_equal(moved.sigma_m, cloud_edges().sigma_m)
    back = moved.moved(se3.inverse(b_from_lidar))
    np.testing.assert_allclose(back.xyz, XYZ, atol=1e-12)


def test_edges_of_a_moving_lidar_move_by_their_own_times() -> None:
    time_s = np.array([-0.1, 0.0, 0.1, 0.2, 0.0])
    edges = replace(cloud_edges(), time_s=time_s)
    there = edges.untwisted(np.array([0, 0, 0, 10.0, 0, 0]))
    np.testing.assert_allclose(there.xyz - XYZ, np.outer(time_s, [10, 0, 0]), atol=1e-12)
    np.testing.assert_array_equal(there.background, edges.background)
    turned = edges.untwisted(np.array([0, 0, np.pi, 0, 0, 0]))
    np.testing.assert_allclose(turned.background[3], [-np.sin(0.2 * np.pi), np.cos(0.2 * np.pi), 0], atol=1e-12)
    np.testing.assert_array_equal(turned.xyz[[1, 4]], XYZ[[1, 4]])
    for both in (there, turned, edges.select(np.array([1, 2]))):
        np.testing.assert_array_equal(both.time_s, time_s if len(both) == 5 else time_s[1:3])
    np.testing.assert_array_equal(cloud_edges().untwisted(np.ones(6)).xyz, XYZ)


def test_features_hand_on_to_what_they_hold() -> None:
    shift = se3.make(translation=[0, 0, 1])
    features = CloudFeatures(cloud_edges(), XYZ)
    moved = features.moved(shift)
    assert moved.points is not None
    np.testing.assert_allclose(moved.points - XYZ, np.tile([0, 0, 1], (5, 1)))
    np.testing.assert_allclose(moved.edges.xyz - XYZ, np.tile([0, 0, 1], (5, 1)))
    np.testing.assert_array_equal(features.without_sides().points, XYZ)
    for before, bare in (
        (image_edges(), ImageFeatures(image_edges()).without_sides().edges),
        (cloud_edges(), features.without_sides().edges),
    ):
        assert (bare.side == Side.NONE).all()
        np.testing.assert_array_equal(bare.weight, before.weight)
        assert (before.side == SIDES).all()
    empty = CloudFeatures().moved(np.eye(4)).without_sides()
    assert (empty.edges, empty.points, ImageFeatures().without_sides().edges) == (None, None, None)
    with pytest.raises(InputError, match="points of the cloud features has the wrong shape"):
        CloudFeatures(points=XYZ[:, :2])


def test_the_ends_of_an_edge_are_half_a_gap_towards_and_away_from_its_background_and_move_with_it() -> None:
    edges = cloud_edges()
    first, last = edges.ends
    np.testing.assert_allclose(0.5 * (first + last), XYZ)
    np.testing.assert_allclose(last - first, np.sqrt(12) * 0.01 * np.arange(5)[:, None] * [0, 1, 0])
    np.testing.assert_allclose(edges.gap_rad * np.linalg.norm(XYZ, axis=1), np.sqrt(12) * 0.01 * np.arange(5))
    motion = se3.exp(np.array([0.3, -0.2, 1.0, 0.5, 2.0, -1.0]))
    for moved, end in zip(edges.moved(motion).ends, edges.ends, strict=True):
        np.testing.assert_allclose(moved, se3.apply(motion, end), atol=1e-12)
    for end in CloudEdges(XYZ, SIDES).ends:  # without a known gap
        np.testing.assert_array_equal(end, XYZ)
