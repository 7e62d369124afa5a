"""Images of synthetic scenes: depth in closed form, shadows, sky, any camera model."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera
from p2o_sim.sensing.rendering import render
from p2o_sim.world.scene import Class, Material, Mover, Part, Scene

from tests.p2o_sim.walls import BOX_X, FLOOR_Z, GREY, WALL_X, WORLD_FROM_CAMERA, box, down_axis, walls

PINHOLE = Camera.pinhole(120.0, 120.0, 80.0, 50.0, 161, 101)
DISTORTED = Camera("OPENCV", 161, 101, (120.0, 121.0, 80.0, 50.0, -0.2, 0.05, 0.001, -0.001))
FISHEYE = Camera("OPENCV_FISHEYE", 161, 101, (70.0, 70.0, 80.0, 50.0, 0.02, -0.005, 0.001, 0.0))


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED, FISHEYE], ids=lambda c: c.model)
def test_every_pixel_has_the_depth_of_the_first_surface_on_its_ray(camera: Camera) -> None:
    rendered = render(walls(), camera, WORLD_FROM_CAMERA)
    uv = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).astype(float)
    x, y = np.moveaxis(camera.rays(uv)[..., :2] / camera.rays(uv)[..., 2:], -1, 0)
    with np.errstate(divide="ignore"):
        floor = np.where(y > 0, -FLOOR_Z / y, np.inf)
    # The box shows its front; its sides lie behind the front's outline, for a viewer on its axis.
    front = np.where((abs(x) < 1 / BOX_X) & (abs(y) < 1 / BOX_X), BOX_X, np.inf)
    expected = np.minimum(np.minimum(floor, WALL_X), front)
    on_outline = np.minimum(abs(abs(x) - 1 / BOX_X), abs(abs(y) - 1 / BOX_X)) < 1e-4
    assert rendered.seen.all()
    np.testing.assert_allclose(rendered.depth_m[~on_outline], expected[~on_outline], rtol=1e-9)
    assert (expected == BOX_X).sum() > 100
    assert (expected < BOX_X).any()


def test_sky_is_infinitely_far_and_blue_and_has_no_normal_no_instance_and_its_own_class() -> None:
    scene = Scene((Part(box(1.0, 1.0, -9.0, -8.0), GREY),))
    rendered = render(scene, PINHOLE, WORLD_FROM_CAMERA)
    assert np.isposinf(rendered.depth_m[:50]).all()
    red, _, blue = rendered.rgb[:50].reshape(-1, 3).mean(axis=0)
    assert blue > red
    assert (rendered.classes[:50] == Class.SKY).all()
    assert (rendered.instance[:50] == 0).all()
    assert (rendered.normals[:50] == 0).all()


def test_pixels_outside_of_a_fisheye_circle_are_black_and_their_depth_is_unknown() -> None:
    narrow = Camera("OPENCV_FISHEYE", 201, 201, (40.0, 40.0, 100.0, 100.0, 0.0, 0.0, 0.0, 0.0))
    rendered = render(walls(), narrow, WORLD_FROM_CAMERA)
    # Equidistant: 90 degrees are 40 * pi / 2 = 62.8 px from the centre.
    radius = np.hypot(*np.meshgrid(np.arange(201) - 100.0, np.arange(201) - 100.0))
    assert rendered.seen[radius < 60].all()
    assert not rendered.seen[radius > 64].any()
    assert np.isnan(rendered.depth_m[radius > 64]).all()
    assert (rendered.rgb[radius > 64] == 0).all()


def test_a_plate_under_the_sun_casts_its_shadow_where_the_sun_says() -> None:
    # The sun stands at 45 degrees towards -x: a plate 2 m above the floor shades the floor 2 m further along +x.
    floor = Part(box(60.0, 60.0, -1.0, 0.0), Material("floor", (0.5, 0.5, 0.5), contrast=0.0), 0)
    plate = Part(box(2.0, 2.0, 1.98, 2.0), GREY, 1)
    scene = Scene((floor, plate), to_sun=(-1.0, 0.0, 1.0))
    camera = Camera.pinhole(100.0, 100.0, 100.0, 100.0, 201, 201)
    rendered = render(scene, camera, down_axis(10.0))
    grey = rendered.rgb.mean(axis=2)
    # On the floor, 10 px are 1 m. The shadow spans x from 1 to 3 m; the plate covers pixels up to 1.25 m.
    shadow, lit = grey[95:106, 115:128], grey[95:106, 134:160]
    assert np.percentile(shadow, 95) < 0.8 * np.percentile(lit, 5)
    np.testing.assert_allclose(grey[130:160, 60:90].mean(), lit.mean(), atol=2.0)


def test_outlines_are_blended_and_surfaces_are_not() -> None:
    black = Material("black", (0.0, 0.0, 0.0), contrast=0.0)
    white = Material("white", (0.2, 0.2, 0.2), contrast=0.0)
    wall = Part(box(1.0, 99.0, -50.0, 50.0).moved(10.5), white, 0)
    # The edge of the screen crosses the image at a quarter of a pixel's width in every row.
    screen = Part(box(0.1, 40.0, -50.0, 50.0).moved(5.05, 20.0 + 5.0 * (80.0 - 79.75) / 120.0), black, 1)
    rendered = render(Scene((wall, screen), to_sun=(-1.0, 0.0, 0.0)), PINHOLE, WORLD_FROM_CAMERA)
    middle = rendered.rgb[20:80].mean(axis=(0, 2))
    assert middle[75] < middle[80] < middle[85]
    assert middle[79] == pytest.approx(middle[70], abs=3)
    assert middle[81] == pytest.approx(middle[90], abs=3)


def test_every_pixel_has_the_normal_instance_and_class_of_its_surface() -> None:
    rendered = render(walls(), PINHOLE, WORLD_FROM_CAMERA)
    floor, wall = rendered.instance == 2, rendered.instance == 1
    # Camera axes: x right, y down, z ahead. The floor looks up, wall and box look at the camera.
    np.testing.assert_allclose(rendered.normals[floor], np.tile([0, -1, 0], (floor.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(rendered.normals[wall], np.tile([0, 0, -1], (wall.sum(), 1)), atol=1e-12)
    front = (rendered.instance == 3) & (rendered.normals[..., 2] < -0.5)
    np.testing.assert_allclose(rendered.depth_m[front], BOX_X, atol=1e-9)
    assert front.sum() > 100
    assert set(np.unique(rendered.classes)) == {Class.FURNITURE}


def test_the_number_of_cores_does_not_change_a_single_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    images = []
    for cores in (1, 3):
        monkeypatch.setattr("p2o_sim.sensing.threads.cores", lambda cores=cores: cores)
        images.append(render(walls(), Camera.pinhole(300.0, 300.0, 200.0, 100.0, 401, 201), WORLD_FROM_CAMERA))
    assert images[0].light.tobytes() == images[1].light.tobytes()


def test_what_drives_is_seen_where_it_is_at_the_time_of_the_picture() -> None:
    plate = Part(box(0.2, 30.0, -20.0, 20.0).moved(8.1), GREY, 0)
    scene = Scene(
        (Part(box(1.0, 1.0, -90.0, -89.0), GREY, 1),), movers=(Mover((plate,), np.array([0, 0, 0, -10.0, 0, 0])),)
    )
    for time_s in (0.0, 0.2):
        depth = render(scene, PINHOLE, WORLD_FROM_CAMERA, time_s).depth_m
        np.testing.assert_allclose(depth[50, 80], 8.0 - 10.0 * time_s, atol=1e-9)
