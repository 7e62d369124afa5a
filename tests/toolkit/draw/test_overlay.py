"""Overlays: the right colour at the right pixel, and pictures that are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, Cloud, CloudEdges, ImageEdges, InputError, Side, se3
from p2o.draw.overlay import CLOUD_NONE, COLOURS, IMAGE_NONE, before_after, draw, draw_cloud, write_png

CAMERA = Camera.pinhole(100.0, 100.0, 100.0, 50.0, 200, 100)
RGB = np.full((100, 200, 3), 120, np.uint8)
ALL = np.array([Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM, Side.NONE], np.int8)
PLACES = np.array([[20.0, 50.0], [60.0, 50.0], [100.0, 50.0], [140.0, 50.0], [180.0, 50.0]])
NO_IMAGE = ImageEdges.empty()
NO_CLOUD = CloudEdges.empty()


def _lifted(uv: np.ndarray, depth: float = 10.0) -> np.ndarray:
    """Return points of the camera frame at pixels (N, 2)."""
    return np.column_stack([(uv - [100.0, 50.0]) / 100.0 * depth, np.full(len(uv), depth)])


def test_image_edges_are_single_pixels_of_their_colour() -> None:
    """Green, red, yellow and blue, as in the paper."""
    hue = ["".join(name for name, c in zip("rgb", rgb, strict=True) if c > 150) for rgb in COLOURS.values()]
    assert dict(zip(COLOURS, hue, strict=True)) == {"L": "g", "R": "r", "U": "rg", "B": "b"}
    picture = draw(RGB, ImageEdges(PLACES, ALL), NO_CLOUD, CAMERA, np.eye(4), legend=False)
    ground = picture[0, 0]
    for (u, v), colour in zip(PLACES.astype(int), [*COLOURS.values(), IMAGE_NONE], strict=True):
        assert tuple(picture[v, u]) == colour
        assert (picture[v + 1, u] == ground).all()
    assert (picture != ground).any(axis=2).sum() == 5


def test_doubtful_edges_are_faint_and_the_surest_wins() -> None:
    edges = ImageEdges(PLACES[[0, 1, 1, 1]], ALL[[0, 0, 1, 2]], np.array([0.5, 0.2, 0.9, 0.1]))
    picture = draw(RGB, edges, NO_CLOUD, CAMERA, np.eye(4), legend=False).astype(int)
    ground = picture[0, 0]
    for u, side, weight in ((20, "L", 0.5), (60, "R", 0.9)):
        np.testing.assert_allclose(picture[50, u], ground + weight * (np.array(COLOURS[side]) - ground), atol=1)


def test_lidar_edges_are_rings_around_their_projection_at_the_pose() -> None:
    lidar_from_camera = se3.exp(np.array([0.1, -0.2, 1.0, 0.3, 0.2, -0.5]))
    edges = CloudEdges(se3.apply(lidar_from_camera, _lifted(PLACES)), ALL)
    image_edge = ImageEdges(PLACES[:1], ALL[:1])  # shows through the ring of its partner
    picture = draw(RGB, image_edge, edges, CAMERA, se3.inverse(lidar_from_camera), legend=False)
    ground = picture[0, 0]
    for (u, v), colour in zip(PLACES.astype(int), [*COLOURS.values(), CLOUD_NONE], strict=True):
        assert tuple(picture[v, u]) == (COLOURS["L"] if u == 20 else tuple(ground))
        for du, dv in ((3, 0), (-3, 0), (0, 3), (0, -3)):
            assert tuple(picture[v + dv, u + du]) == colour


def test_what_lies_behind_or_outside_is_left_out_and_what_leaves_the_image_is_cut_off() -> None:
    xyz = np.concatenate([_lifted(np.array([[500.0, 50.0], [199.4, 99.4]])), [[0.0, 0.0, -5.0]]])
    picture = draw(RGB, NO_IMAGE, CloudEdges(xyz, ALL[:3]), CAMERA, np.eye(4), legend=False)
    changed = np.argwhere((picture != picture[0, 0]).any(axis=2))
    assert len(changed) > 0
    assert (changed >= [95, 195]).all()


def test_the_image_is_darkened_and_left_untouched_and_one_of_another_size_refused() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, RGB.shape, np.uint8)
    before = rgb.copy()
    picture = draw(rgb, ImageEdges(PLACES, ALL), NO_CLOUD, CAMERA, np.eye(4))
    np.testing.assert_array_equal(rgb, before)
    assert picture.shape == rgb.shape
    assert picture.dtype == np.uint8
    assert picture[60:].mean() < 0.7 * rgb[60:].mean()
    with pytest.raises(InputError, match="the image has the wrong shape"):
        draw(RGB[:50], NO_IMAGE, NO_CLOUD, CAMERA, np.eye(4))


def test_the_legend_stays_in_its_corner_and_is_left_out_of_small_pictures() -> None:
    wide = Camera.pinhole(100.0, 100.0, 300.0, 50.0, 600, 100)
    rgb = np.full((100, 600, 3), 120, np.uint8)
    with_legend, without = (draw(rgb, NO_IMAGE, NO_CLOUD, wide, np.eye(4), legend=on) for on in (True, False))
    changed = np.argwhere((with_legend != without).any(axis=2))
    assert len(changed) > 0
    assert (changed.max(axis=0) < [30, 335]).all()
    small = draw(RGB, NO_IMAGE, NO_CLOUD, CAMERA, np.eye(4))
    assert (small == small[0, 0]).all()


@pytest.mark.parametrize("grey", [120, 5])
def test_words_are_twice_as_large_on_a_picture_that_a_page_shows_at_half_its_size(grey: int) -> None:
    """The legend, and on a dark picture its gamma: of 1600 px halved they are where those of 800 px are."""
    cameras = [Camera.pinhole(500.0, 500.0, width / 2, width / 4, width, width // 2) for width in (800, 1600)]
    pictures = [
        draw(np.full((c.height, c.width, 3), grey, np.uint8), NO_IMAGE, NO_CLOUD, c, np.eye(4)) for c in cameras
    ]
    halved = pictures[1].reshape(400, 2, 800, 2, 3).mean(axis=(1, 3))
    ground = pictures[0][-1, 400].astype(float)
    boxes = [np.argwhere((np.abs(p - ground) > 5).any(axis=2)) for p in (pictures[0], halved)]
    assert len(boxes[0])
    for ends in (boxes[0].min(axis=0) - boxes[1].min(axis=0), boxes[0].max(axis=0) - boxes[1].max(axis=0)):
        assert np.abs(ends).max() <= 20, "bold letters are wider"


def test_a_cloud_is_red_where_near_and_blue_where_far_and_near_points_hide_far_ones() -> None:
    uv = np.array([[50.0, 50.0], [150.0, 50.0], [150.0, 50.0]])
    xyz = np.concatenate([_lifted(uv[:1], 5.0), _lifted(uv[1:2], 4.0), _lifted(uv[2:], 60.0)])
    picture = draw_cloud(RGB, Cloud(xyz), CAMERA, np.eye(4)).astype(int)
    far = draw_cloud(RGB, Cloud(xyz[2:]), CAMERA, np.eye(4)).astype(int)
    assert picture[50, 150, 0] > picture[50, 150, 2]
    assert picture[50, 50, 0] > picture[50, 50, 2]
    assert far[50, 150, 2] > far[50, 150, 0]


def test_before_and_after_stand_above_each_other_each_below_its_title() -> None:
    before, after = np.full((40, 60, 3), 10, np.uint8), np.full((40, 60, 3), 250, np.uint8)
    both = before_after(before, after)
    bar = (len(both) - 80) // 2
    np.testing.assert_array_equal(both[bar : bar + 40], before)
    np.testing.assert_array_equal(both[-40:], after)
    assert both[:bar].max() > 150  # the title
    with pytest.raises(InputError, match="differ in size"):
        before_after(before, after[:30])


def test_a_picture_reads_back_as_it_was_written(tmp_path: Path) -> None:
    import cv2

    rgb = np.random.default_rng(0).integers(0, 256, (12, 17, 3), np.uint8)
    write_png(tmp_path / "picture.png", rgb)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "picture.png"))[..., ::-1], rgb)
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]
    with pytest.raises(InputError, match="no pixels"):
        write_png(tmp_path / "none.png", np.zeros((0, 5, 3), np.uint8))
    with pytest.raises(InputError, match=r"nowhere.*create the folder first"):
        write_png(tmp_path / "nowhere" / "picture.png", RGB)
