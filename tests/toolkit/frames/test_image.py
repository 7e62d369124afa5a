from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Image, InputError

CAMERA = Camera.pinhole(5, 5, 3, 2, 7, 5)
RGB = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def test_an_image_cannot_be_changed_and_depth_may_be_unknown_or_sky_but_not_zero() -> None:
    image = Image(RGB, CAMERA, depth_m=np.ones((5, 7)), masked=np.zeros((5, 7), bool))
    for array in (image.rgb, image.depth_m, image.masked):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    depth = np.full((5, 7), 2.0)
    depth[0, 0], depth[0, 1] = np.nan, np.inf
    image = Image(RGB, CAMERA, depth_m=depth)
    assert np.array_equal(image.depth_m, depth, equal_nan=True)
    depth[1, 1] = 0
    with pytest.raises(InputError, match=r"depth is not positive; .*got 0"):
        Image(RGB, CAMERA, depth_m=depth)


@pytest.mark.parametrize("name", ["rgb", "right"])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 1), (5, 7, 4)])
def test_a_picture_that_is_not_rgb_is_refused_with_what_to_do(name: str, shape: tuple[int, ...]) -> None:
    pictures = {"rgb": RGB, "right": RGB, "baseline_m": 0.5, name: np.zeros(shape, np.uint8)}
    with pytest.raises(InputError, match=rf"the image \({name}\) is not RGB; .*repeat a grey image on three channels"):
        Image(camera=CAMERA, **pictures)


@pytest.mark.parametrize("name", ["rgb", "right", "depth_m", "masked"])
def test_a_size_that_does_not_fit_the_camera_is_refused(name: str) -> None:
    values = {"rgb": RGB, "right": RGB, "baseline_m": 0.5, "depth_m": np.ones((5, 7)), "masked": np.zeros((5, 7), bool)}
    values[name] = values[name][:4]
    with pytest.raises(
        InputError, match=rf"the image size \({name}\) does not fit the camera; expected 7x5 px; got 7x4"
    ):
        Image(camera=CAMERA, **values)
    with pytest.raises(InputError, match=r"the image \(rgb\) is not 8 bit; expected uint8; got float64"):
        Image(RGB / 255, CAMERA)
    with pytest.raises(InputError, match="expected 7x5 px; got 5x7 px"):
        Image(RGB.transpose(1, 0, 2), CAMERA)


@pytest.mark.parametrize("half", [{"right": RGB}, {"baseline_m": 0.5}])
def test_a_pair_needs_both_its_picture_and_its_baseline(half: dict[str, object]) -> None:
    with pytest.raises(InputError, match="a rectified pair needs both"):
        Image(RGB, CAMERA, **half)


def test_grey_is_luma() -> None:
    pixels = np.zeros((5, 7, 3), np.uint8)
    pixels[0, 0], pixels[0, 1], pixels[0, 2], pixels[0, 3] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
    grey = Image(pixels, CAMERA).grey
    assert grey[0, :5].tolist() == [76, 150, 29, 255, 0]
    assert grey.shape == (5, 7)
    # A picture that does not fit into one band.
    rgb = np.random.default_rng(0).integers(0, 256, (600, 5, 3), dtype=np.uint8)
    grey = Image(rgb, Camera.pinhole(5, 5, 2, 300, 5, 600)).grey
    wanted = np.floor(rgb @ np.array([0.299, 0.587, 0.114]) + 0.5)
    assert np.array_equal(grey, wanted)


def test_an_undistorted_image_shows_a_point_where_its_pinhole_camera_does() -> None:
    camera = Camera("OPENCV", 200, 100, (120.0, 118.0, 95.0, 52.0, -0.3, 0.1, 0.002, -0.001))
    place = np.array([[0.4, -0.2, 1.0]])
    v, u = np.indices((100, 200))
    blob = np.exp(-((np.stack([u, v], -1) - camera.project(place)[0]) ** 2).sum(-1) / 8)
    shown = Image(np.repeat(np.uint8(255 * blob)[..., None], 3, axis=2), camera).undistorted()
    weight = shown.rgb[..., 0].astype(float)
    centre = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    assert shown.camera.is_pinhole
    np.testing.assert_allclose(centre, shown.camera.project(place)[0], atol=0.1)
    assert np.abs(centre - camera.project(place)[0]).max() > 3
    assert np.array_equal(shown.undistorted().rgb, shown.rgb)
