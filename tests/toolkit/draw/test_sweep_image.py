"""The sweep on the image: nearer is redder, brighter is yellower, and what is out of the image is not drawn."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Cloud, InputError
from p2o.draw.sweep_image import draw_sweep

CAMERA = Camera.pinhole(100.0, 100.0, 150.0, 50.0, 300, 100)
RGB = np.full((100, 300, 3), 120, np.uint8)


def _at(u: float, depth_m: float) -> list[float]:
    return [(u - 150) / 100 * depth_m, -0.2 * depth_m, depth_m]


def test_by_range_near_is_red_and_far_is_blue_by_reflectance_high_is_yellow_wherever_it_is() -> None:
    picture = draw_sweep(RGB, Cloud(np.array([_at(50, 5.0), _at(250, 50.0)])), CAMERA, np.eye(4))
    near, far = picture[30, 50].astype(int), picture[30, 250].astype(int)
    assert near[0] > near[2] + 50
    assert far[2] > far[0]
    assert (picture[10, 150] == draw_sweep(RGB, Cloud(np.array([_at(50, 5.0)])), CAMERA, np.eye(4))[10, 150]).all()
    cloud = Cloud(np.array([_at(50, 5.0), _at(250, 50.0)]), intensity=np.array([0.9, 0.1]))
    picture = draw_sweep(RGB, cloud, CAMERA, np.eye(4), "reflectance")
    high, low = picture[30, 50].astype(int), picture[30, 250].astype(int)
    assert min(high[0], high[1]) > high[2] + 50
    assert low[1] < 60
    with pytest.raises(InputError, match="has no reflectance"):
        draw_sweep(RGB, Cloud(np.array([_at(50, 5.0)])), CAMERA, np.eye(4), "reflectance")


def test_near_points_are_drawn_over_far_ones_and_what_is_not_in_the_image_is_not_drawn() -> None:
    points = np.array([_at(100, 5.0), _at(100, 50.0), _at(200, 5.0), _at(250, 50.0)])
    picture = draw_sweep(RGB, Cloud(points), CAMERA, np.eye(4))
    np.testing.assert_array_equal(picture[30, 100], picture[30, 200])
    picture = draw_sweep(RGB, Cloud([[0.0, 0.0, -5.0], [100.0, 0.0, 5.0]]), CAMERA, np.eye(4))
    assert (picture == picture[0, 0]).all()


def test_dots_grow_with_the_image() -> None:
    """The share of the picture that one point takes is about the same."""
    shares = []
    for scale in (1, 10):
        camera = Camera.pinhole(100.0 * scale, 100.0 * scale, 150.0 * scale, 50.0 * scale, 300 * scale, 100 * scale)
        rgb = np.full((camera.height, camera.width, 3), 120, np.uint8)
        top = draw_sweep(rgb, Cloud(np.array([_at(100, 5.0)])), camera, np.eye(4))[: camera.height // 2]
        shares.append((top != top[0, 0]).any(axis=2).sum())
    assert shares[1] > 4 * shares[0]
