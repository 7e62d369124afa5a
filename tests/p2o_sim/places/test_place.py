"""Places: ground without holes, room for the rig, edges in all directions, the same for the same seed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from p2o import SIDES, Camera, UnknownNameError, occlusion, se3
from p2o_sim.places.catalog import DIFFICULT, INDOORS, PLACES, place_of, scene_of
from p2o_sim.sensing.rendering import RenderedImage, labels, render
from p2o_sim.world.scene import Class

USUAL = [place for place in PLACES if place not in DIFFICULT]
CAMERA = Camera.pinhole(360.0, 360.0, 310.0, 93.0, 621, 188)
WORLD_FROM_CAMERA = se3.make([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.0, 0.0, 1.65))


@cache
def rendered(place: str, seed: int) -> RenderedImage:
    scene, _ = scene_of(place, np.random.default_rng(seed), speed_m_s=8.0)
    return render(scene, CAMERA, WORLD_FROM_CAMERA)


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.system) for n in (2, 5, 8))])
@pytest.mark.parametrize("place", USUAL)
def test_every_frame_has_tens_of_hard_edges_in_all_four_directions(place: str, seed: int) -> None:
    _, side = occlusion.edges_from_orders(labels(rendered(place, seed), CAMERA, mask_foliage=True))
    for direction in SIDES:
        assert (side == direction).sum() >= 30, direction.name


@pytest.mark.parametrize("place", PLACES)
def test_a_place_has_ground_everywhere_and_room_for_the_rig(place: str) -> None:
    scene, _ = scene_of(place, np.random.default_rng(1), speed_m_s=8.0, travel_m=20.0)
    rng = np.random.default_rng(1)
    from_above = np.column_stack([rng.uniform([-20, -30], [100, 30], (20_000, 2)), np.full(20_000, 60.0)])
    down = scene.cast(from_above, np.tile([0.0, 0.0, -1.0], (20_000, 1)))
    assert (down.face >= 0).all()
    assert (from_above[:, 2] - down.distance_m).min() >= -0.05
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(720)])
    for height in (0.5, 1.0, 1.65, 1.9):
        assert scene.cast(np.array([0.0, 0.0, height]), around).distance_m.min() > 0.8


@pytest.mark.parametrize("place", PLACES)
def test_the_same_seed_gives_the_same_place_and_another_seed_another(place: str) -> None:
    first, again, other = (scene_of(place, np.random.default_rng(seed))[0] for seed in (5, 5, 6))
    assert first.mesh.vertices.tobytes() == again.mesh.vertices.tobytes()
    assert first.all_parts[-1].material == again.all_parts[-1].material
    assert first.to_sun == again.to_sun
    assert first.mesh.vertices.tobytes() != other.mesh.vertices.tobytes()


def test_trees_and_streets_show_what_their_names_say() -> None:
    def shares(place: str) -> dict[Class, float]:
        classes = np.stack([rendered(place, seed).classes for seed in range(2)])
        return {kind: float((classes == kind).mean()) for kind in Class}

    trees, street = shares("trees"), shares("street")
    assert trees[Class.FOLIAGE] > 0.25
    assert trees[Class.TRUNK] > 0
    assert street[Class.BUILDING] > 0.1 > trees[Class.BUILDING]
    assert street[Class.CAR] > 0.02
    assert min(trees[Class.ROAD], street[Class.ROAD]) > 0.1


@pytest.mark.parametrize("place", INDOORS)
def test_inside_of_a_building_the_sky_is_seen_through_its_openings_only(place: str) -> None:
    shown = [rendered(place, seed).classes for seed in range(3)]
    sky = np.array([(classes == Class.SKY).mean() for classes in shown])
    assert sky.max() < 0.12
    assert sky.max() > 0
    assert np.mean([np.isin(classes, [Class.WALL, Class.BUILDING]).mean() for classes in shown]) > 0.2


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("place", INDOORS)
def test_the_way_of_a_rig_through_a_building_is_free_to_its_end(place: str, seed: int) -> None:
    scene, _ = scene_of(place, np.random.default_rng(seed), speed_m_s=1.0, travel_m=12.0)
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(360)])
    for x in (0.0, 4.0, 8.0, 12.0):
        for height in (0.3, 0.6, 1.0, 1.5, 1.8):
            assert scene.cast(np.array([x, 0.0, height]), around).distance_m.min() > 0.8


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", INDOORS)
def test_nothing_in_a_building_floats(place: str, seed: int) -> None:
    scene, _ = scene_of(place, np.random.default_rng(seed), speed_m_s=1.0)
    inside = scene.lighting.inside
    low, high = np.array(inside.low), np.array(inside.high)
    for number in np.unique(scene.thing_of_part):
        meshes = [part.mesh.vertices for part in scene.parts if part.thing == number]
        points = np.concatenate(meshes)
        # It stands, hangs from the roof, is on a wall, or is outside.
        gaps = (
            points[:, 2].min(),
            high[2] - points[:, 2].max(),
            *(points - low).min(axis=0),
            *(high - points).min(axis=0),
        )
        assert min(gaps) < 0.1, (number, points.min(axis=0), points.max(axis=0))


def test_for_cameras_that_look_around_leaves_behind_are_as_small_as_those_ahead() -> None:
    def largest_m(around: bool) -> float:
        """Return how long the leaves within 15 m behind the rig are, the 90th percentile of their longest sides."""
        scene, _ = scene_of("trees", np.random.default_rng(2), around=around)
        of_leaves = scene.class_of_part[scene.part_of_face] == Class.FOLIAGE
        corners = scene.mesh.vertices[scene.mesh.faces[of_leaves]]
        middle = corners.mean(axis=1)
        near = (middle[:, 0] < -3) & (np.linalg.norm(middle[:, :2], axis=1) < 15)
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        return float(np.percentile(sides[near], 90))

    assert largest_m(around=True) < 0.6 * largest_m(around=False)


@pytest.mark.parametrize("place", ["street", "trees"])
def test_for_cameras_that_look_around_land_goes_on_behind(place: str) -> None:
    down = np.array([[-1.0, y, -0.25] for y in np.linspace(-0.4, 0.4, 21)])
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    ends, goes_on = (
        scene_of(place, np.random.default_rng(1), around=around)[0].cast(np.array([0.0, 0.0, 30.0]), down).face
        for around in (False, True)
    )
    assert (ends < 0).any()
    assert (goes_on >= 0).all()


def test_anywhere_draws_every_kind_of_place_and_mixed_roads_only() -> None:
    rng = np.random.default_rng(0)
    assert {place_of("anywhere", rng) for _ in range(200)} == {*USUAL} - {"varied"}
    assert {place_of("mixed", rng) for _ in range(200)} == {"street", "suburb", "highway", "trees"}


@pytest.mark.parametrize("seed", range(3))
def test_a_repeated_place_has_the_same_profile_one_period_further_on(seed: int) -> None:
    scene, _ = scene_of("repeated", np.random.default_rng(seed))
    x = np.arange(0.0, 40.0, 0.05)
    profile = scene.cast(np.column_stack([x, 0 * x, 0 * x + 0.9]), np.tile([0.0, 1.0, 0.0], (len(x), 1))).distance_m
    lags = range(40, 200)
    differences = [float(np.mean(np.abs(profile[lag:] - profile[:-lag]) > 0.1)) for lag in lags]
    assert min(differences) < 0.1
    assert max(differences) > 2 * min(differences)


def test_nothing_of_an_empty_road_rises_above_the_ground_within_60_m_and_traffic_moves() -> None:
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(720)])
    bare, _ = scene_of("empty", np.random.default_rng(1), speed_m_s=8.0)
    assert bare.cast(np.array([0.0, 0.0, 1.0]), around).distance_m.min() > 39.0
    assert not bare.movers
    busy, _ = scene_of("traffic", np.random.default_rng(1), speed_m_s=8.0)
    assert len(busy.movers) == 2


def test_an_unknown_place_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="highway"):
        scene_of("moon", np.random.default_rng(0))
