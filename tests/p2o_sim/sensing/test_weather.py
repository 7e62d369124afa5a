"""Weather: what it takes from images and sweeps, what it adds, and that the place stays what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, UnknownNameError, se3
from p2o_sim.places.catalog import scene_of
from p2o_sim.sensing.lidar import Air
from p2o_sim.sensing.rendering import render
from p2o_sim.sensing.scanning import sweep
from p2o_sim.sensing.sensors import LIDARS
from p2o_sim.sensing.weather import WEATHERS, Weather, headlights, in_weather, lit_near, rained_on, weather_of
from p2o_sim.world.lighting import Lighting
from p2o_sim.world.scene import Class, Material, Part, Scene

from tests.p2o_sim.walls import FLOOR_Z, GREY, WALL_X, WORLD_FROM_CAMERA, box, down_axis, walls

CAMERA = Camera.pinhole(120.0, 120.0, 80.0, 50.0, 161, 101)
BLACK = Material("black", (0.0, 0.0, 0.0), contrast=0.0, reflectance=0.1)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_clear_day_leaves_the_scene_as_it_is() -> None:
    scene = walls()
    assert in_weather(scene, weather_of("clear", _rng()), _rng()) is scene


def test_any_weather_draws_each_of_them_and_an_unknown_one_is_refused() -> None:
    rng = _rng()
    assert {weather_of("any", rng).name for _ in range(100)} == set(WEATHERS)
    with pytest.raises(UnknownNameError, match="fog"):
        weather_of("hail", rng)


@pytest.mark.parametrize("name", WEATHERS)
def test_weather_moves_nothing(name: str) -> None:
    scene, _ = scene_of("street", _rng(), speed_m_s=8.0)
    other = in_weather(scene, weather_of(name, _rng()), _rng())
    assert other.mesh.vertices.tobytes() == scene.mesh.vertices.tobytes()
    assert [part.thing for part in other.all_parts] == [part.thing for part in scene.all_parts]


def test_over_the_visibility_a_black_wall_comes_to_95_percent_of_the_fog() -> None:
    scene = Scene((Part(box(1.0, 200.0, -50.0, 100.0).moved(WALL_X + 0.5), BLACK),))
    sky_only = Scene((Part(box(1.0, 1.0, -9.0, -8.0).moved(-50.0), BLACK),))
    fog = Weather("fog", 0.0, (0.8, 0.8, 0.8), 1.0, visibility_m=WALL_X)
    wall, sky = (render(in_weather(s, fog, _rng()), CAMERA, WORLD_FROM_CAMERA).light[50, 80] for s in (scene, sky_only))
    np.testing.assert_allclose(wall, (1 - np.exp(-3.0)) * sky, rtol=0.01)


def test_without_sun_nothing_casts_a_shadow() -> None:
    plain = replace(GREY, contrast=0.0)
    ground, post = Part(box(40.0, 40.0, -1.0, 0.0), plain), Part(box(1.0, 1.0, 0.0, 3.0), plain)
    sunny = Scene((ground, post), to_sun=(-1.0, 0.0, 1.0))
    dull = in_weather(sunny, Weather("overcast", 0.0, (0.7, 0.7, 0.7), 1.0), _rng())
    # The shadow of the post reaches 3 m to the right; from 10 m above a metre has 12 px.
    shadow, beside = np.s_[50, 80 + 24], np.s_[50, 80 - 24]
    bright, grey = (render(scene, CAMERA, down_axis(10.0)).light[..., 1] for scene in (sunny, dull))
    assert bright[shadow] < 0.5 * bright[beside]
    assert grey[shadow] == pytest.approx(grey[beside], rel=1e-3)


def test_fog_takes_far_returns_and_adds_near_ones() -> None:
    lidar = replace(LIDARS["vlp-16"], range_noise_m=0.0, dark_range_m=20.0)
    clear, fog = (sweep(walls(), lidar, np.eye(4), _rng(), air=air) for air in (Air(), Air(0.05, 0.02)))
    far, near = (
        [int(count(np.linalg.norm(cloud.xyz, axis=1)).sum()) for cloud in (clear, fog)]
        for count in (lambda r: r > 10, lambda r: r < 1.4)
    )
    assert 0 < far[1] < 0.8 * far[0]
    # Nothing of the scene is nearer than the floor below.
    assert near[0] == 0
    assert near[1] > 50
    drops = np.linalg.norm(fog.xyz, axis=1) < 1.4
    assert fog.intensity[drops].max() < 0.1


def test_drops_do_not_move_what_they_leave() -> None:
    lidar = replace(LIDARS["vlp-16"], dark_range_m=50.0)
    clear, rain = (sweep(walls(), lidar, np.eye(4), _rng(), air=air) for air in (Air(), Air(0.0, 0.01)))
    places = {tuple(row) for row in clear.xyz}
    same = np.array([tuple(row) in places for row in rain.xyz])
    assert 0.97 < same.mean() < 1.0


def test_rain_makes_roads_dark_and_mirrors_but_not_the_floor_of_a_room() -> None:
    rain = weather_of("rain", _rng())
    street, room = (scene_of(place, _rng())[0] for place in ("street", "room"))

    def roads(scene: Scene) -> list[Material]:
        return [part.material for part in scene.parts if part.kind == Class.ROAD]

    for dry, wet in zip(roads(street), roads(in_weather(street, rain, _rng())), strict=True):
        assert max(wet.colour) < 0.8 * max(dry.colour)
        assert wet.reflectance < 0.8 * dry.reflectance
        assert wet.gloss > dry.gloss
    assert roads(in_weather(room, rain, _rng())) == roads(room)


def test_streaks_of_rain_fall_before_what_is_far_and_not_before_what_is_near() -> None:
    rain, light = Weather("rain", rain=1.0), np.full((101, 161, 3), 0.2, np.float32)
    light[:15] = 1.0
    far, near = (
        rained_on(light, np.full((101, 161), depth), CAMERA, se3.inverse(WORLD_FROM_CAMERA), rain, _rng())
        for depth in (50.0, 0.3)
    )
    assert (far[20:] > 0.203).mean() > 0.01
    np.testing.assert_array_equal(near, light)
    # They fall: a streak goes on from one row to the next, not to the next column.
    seen = far[20:, :, 1] - 0.2
    down, across = (float((seen * np.roll(seen, 2, axis=axis)).sum()) for axis in (0, 1))
    assert down > 1.5 * across


def test_at_night_headlights_show_the_road_ahead_and_leave_the_rest_dark() -> None:
    night = Lighting(sun=0.0, sky=(0.0, 0.0, 0.0))
    scene = replace(walls(with_box=False), lighting=night)
    pose = se3.make(translation=(0.0, 0.0, FLOOR_Z + 1.73))
    lit = lit_near(scene, pose, headlights(pose, 1.73))
    rendered = render(lit, CAMERA, WORLD_FROM_CAMERA).light[..., 1]
    assert rendered[80, 80] > 10 * rendered[80, 2]
    assert rendered[80, 80] > 0.01
    behind = WORLD_FROM_CAMERA.copy()
    behind[:2, :3] *= -1
    assert render(lit, CAMERA, behind).light.max() < 1e-3


def test_at_night_street_lamps_shine_where_their_heads_are() -> None:
    scene, _ = scene_of("street", np.random.default_rng(3), speed_m_s=8.0)
    night = in_weather(scene, weather_of("night", _rng()), _rng())
    heads = [p.mesh.vertices.mean(axis=0) for p in night.parts if p.kind == Class.POLE and p.material.glow > 0]
    assert len(heads) == len(night.lighting.lamps) > 0
    for head, lamp in zip(heads, night.lighting.lamps, strict=True):
        np.testing.assert_allclose(head[:2], lamp.place[:2])
        assert 0 < head[2] - lamp.place[2] < 0.3


def test_light_that_is_changed_leaves_the_rays_as_they_are() -> None:
    scene = walls().prepare()
    other = scene.lit(Lighting(sun=0.0))
    assert other._trees is scene._trees
    ways = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_array_equal(other.cast(np.zeros(3), ways).distance_m, scene.cast(np.zeros(3), ways).distance_m)
    assert GREY in [part.material for part in other.parts]
