"""Pictures of long focal lengths are looked at smaller, and nothing else of a calibration changes."""

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, CloudFeatures, Image, ImageFeatures, View, occlusion
from p2o.confidence.verdict import at_full_size
from p2o.frames.scale import LONGEST_FOCAL_PX, camera_at_scale, image_at_scale
from p2o.reading import RadialError
from p2o.results.result import CameraCheck

TELE = Camera("OPENCV", 1920, 1080, (2000.0, 2010.0, 950.0, 540.0, -0.1, 0.02, 1e-3, -2e-3))


def test_long_focal_lengths_are_looked_at_smaller_and_short_ones_as_they_are() -> None:
    seen = camera_at_scale(TELE)
    assert seen.focal_px == pytest.approx(LONGEST_FOCAL_PX, rel=2e-3)
    wide = Camera.pinhole(720.0, 720.0, 600.0, 180.0, 1242, 375)
    assert camera_at_scale(wide) is wide
    picture = Image(np.zeros((375, 1242, 3), np.uint8), wide)
    assert image_at_scale(picture) is picture
    # A very flat picture keeps some rows.
    for width, height, small in ((1000, 40, (50, 32)), (10, 4, (10, 4))):
        flat = camera_at_scale(Camera.pinhole(20_000.0, 20_000.0, width / 2, height / 2, width, height))
        assert (flat.width, flat.height) == small


def test_a_picture_comes_smaller_with_all_that_belongs_to_it_and_once_only() -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (1080, 1920, 3)).astype(np.uint8)
    depth = np.full((1080, 1920), 5.0)
    depth[:, 960:] = np.inf
    masked = np.zeros((1080, 1920), bool)
    masked[:540] = True
    whole = Image(rgb, TELE, depth_m=depth, masked=masked, right=rgb, baseline_m=0.5)
    small = image_at_scale(whole)
    assert small.camera == camera_at_scale(TELE)
    assert small.rgb.shape == (small.camera.height, small.camera.width, 3)
    assert set(np.unique(small.depth_m)) == {5.0, np.inf}  # nothing between two depths
    assert np.mean(small.masked) == pytest.approx(0.5, abs=0.01)
    assert small.right is not None
    assert small.baseline_m == 0.5
    assert image_at_scale(whole) is small


def test_what_was_found_out_about_a_camera_is_told_of_the_one_that_was_given() -> None:
    small = camera_at_scale(TELE)
    error = RadialError(0.01, 0.02)
    check = CameraCheck(1, small, error.corrected(small), 0.01, 0.001, 0.02, 0.002, 3.0, 0.5, True)
    view = View("a", small, ImageFeatures(), CloudFeatures(), full_size=TELE)
    [told] = at_full_size([check], [view])
    assert told.camera == TELE
    assert told.better == error.corrected(TELE)
    assert told.shift_px == pytest.approx(6.0, rel=5e-3)
    assert told.shift_sigma_px == pytest.approx(1.0, rel=5e-3)
    [same] = at_full_size([check], [replace(view, full_size=None)])
    assert same is check


@pytest.mark.parametrize("focal_px", [1010.0, 1500.0, 2170.0])
def test_a_distant_road_has_no_occlusions_at_any_scale(focal_px: float) -> None:
    """A plane at a grazing angle, a wall in front of it, and sky: only the outline of the wall is an edge."""
    camera = Camera.pinhole(focal_px, focal_px, 300.3, 100.2, 640, 400)
    v, u = np.mgrid[:400, :640]
    road = np.where(v > 101.0, 1.5 * focal_px / np.maximum(v - 100.2, 1e-9), np.inf)
    depth_m = np.where((abs(u - 320) < 50) & (abs(v - 200) < 90), 5.0, road)
    image = image_at_scale(Image(np.zeros((400, 640, 3), np.uint8), camera, depth_m=depth_m))
    small, shorter = image.camera, focal_px / 1000
    assert image.depth_m is not None
    orders = occlusion.occlusion_orders(image.depth_m, small)
    row, column = np.nonzero((orders.south != 0) | (orders.east != 0))
    u, v = (column + 0.5) * shorter - 0.5, (row + 0.5) * shorter - 0.5
    assert len(row) > 500 / shorter
    off_wall = (abs(u - 320) > 50 + 3 * shorter) | (abs(v - 200) > 90 + 3 * shorter)
    assert (abs(v[off_wall] - 101) < 3 * shorter).all(), "but for the horizon"
    plane = np.isfinite(image.depth_m) & (image.depth_m > 5)
    rays = small.rays(np.stack(np.meshgrid(np.arange(small.width), np.arange(small.height)), axis=-1))
    height_m = (rays[..., 1] / rays[..., 2] * image.depth_m)[plane]
    assert np.median(abs(height_m - 1.5)) < 1e-9
