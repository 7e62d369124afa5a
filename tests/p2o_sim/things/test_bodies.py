"""Balls and boxes: exact geometry, seen alike by camera and LiDAR."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from p2o import Box, Camera, Cloud, InputError, Sphere, se3
from p2o_sim.places.catalog import scene_of
from p2o_sim.sensing.rendering import render
from p2o_sim.sensing.scanning import sweep
from p2o_sim.sensing.sensors import LIDARS
from p2o_sim.things.board_places import Rig, boards_in_view
from p2o_sim.things.boards import TARGETS, Board, thing_of
from p2o_sim.things.bodies import TONES
from p2o_sim.world.scene import Class

from tests.p2o_sim.walls import FORWARD, ON_A_CAR, before_a_wall, in_frame, volume

CAMERA = Camera.pinhole(360.0, 360.0, 310.0, 170.0, 621, 340)
FISHEYE = Camera("OPENCV_FISHEYE", 621, 340, (240.0, 240.0, 310.0, 170.0, -0.03, 0.01, 0.0, 0.0))
WORLD_FROM_CAMERA, WORLD_FROM_LIDAR = ON_A_CAR
BALL = Board(Sphere(0.3), se3.make(translation=(3.0, 0.4, 1.5)))
CUBOID = Board(
    Box(0.9, 0.7, 0.5), se3.make(FORWARD @ se3.exp(np.r_[0.5, -0.7, 0.3, 0, 0, 0])[:3, :3], (3.0, -0.3, 1.6))
)


@cache
def swept(board: Board) -> Cloud:
    return sweep(before_a_wall(board), LIDARS["os1-128"], WORLD_FROM_LIDAR, np.random.default_rng(0))


@pytest.mark.parametrize("board", [BALL, CUBOID], ids=["ball", "box"])
def test_the_volume_of_a_body_is_that_of_its_size(board: Board) -> None:
    parts = thing_of(board)
    corners = np.concatenate([p.mesh.vertices[p.mesh.faces] for p in parts]) - board.centre
    size = board.target
    exact = 4 / 3 * np.pi * size.radius_m**3 if isinstance(size, Sphere) else np.prod(size.size_m)
    assert volume([part.mesh for part in parts]) == pytest.approx(exact, rel=1e-3)
    if isinstance(size, Sphere):
        assert np.linalg.norm(corners.reshape(-1, 3), axis=1) == pytest.approx(size.radius_m, abs=1e-9)
        assert np.linalg.norm(corners.mean(axis=1), axis=1).min() > (1 - 3e-4) * size.radius_m


def test_points_of_a_ball_lie_on_it_within_the_noise_of_the_range() -> None:
    xyz = in_frame(BALL, swept(BALL).xyz)
    eye = in_frame(BALL, np.zeros((1, 3)))[0]
    way = xyz - eye
    way /= np.linalg.norm(way, axis=1)[:, None]
    miss = np.linalg.norm(np.cross(way, -eye), axis=1)  # how far the ray passes from the middle
    on = miss < 0.8 * 0.3
    expected = way @ -eye - np.sqrt(np.maximum(0.3**2 - miss**2, 0))
    off = (np.linalg.norm(xyz - eye, axis=1) - expected)[on]
    assert on.sum() > 200
    assert off.std() == pytest.approx(LIDARS["os1-128"].range_noise_m, rel=0.15)
    assert abs(off.mean()) < 0.004
    beside = (miss > 1.1 * 0.3) & (miss < 1.5 * 0.3)
    assert np.linalg.norm(xyz[beside], axis=1).min() > 0.9  # nothing of it is beside it


def test_points_of_a_box_lie_on_its_faces() -> None:
    xyz = in_frame(CUBOID, swept(CUBOID).xyz)
    half = CUBOID.target.size_m / 2
    near = (np.abs(xyz) < half + 0.1).all(axis=1)
    off = (np.abs(xyz[near]) - half).max(axis=1)
    assert near.sum() > 200
    assert np.abs(np.median(off)) < 0.005
    assert np.percentile(np.abs(off), 90) < 3 * LIDARS["os1-128"].range_noise_m


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_the_picture_of_a_ball_is_the_cone_that_touches_it(camera: Camera) -> None:
    rendered = render(before_a_wall(BALL), camera, WORLD_FROM_CAMERA)
    centre = se3.apply(se3.inverse(WORLD_FROM_CAMERA), BALL.centre[None])[0]
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = camera.rays(np.stack([u, v], -1).reshape(-1, 2))
    far = np.linalg.norm(centre)
    inside = np.nan_to_num(rays @ centre / far, nan=-1.0) > np.sqrt(1 - (0.3 / far) ** 2)
    shown = (rendered.classes == Class.BOARD).ravel()
    assert inside.sum() > 1000
    assert (shown != inside).sum() <= 4  # rays that graze it


def test_the_picture_of_a_box_lies_within_its_corners_and_reaches_them() -> None:
    rendered = render(before_a_wall(CUBOID), CAMERA, WORLD_FROM_CAMERA)
    corners = se3.apply(se3.inverse(WORLD_FROM_CAMERA) @ CUBOID.world_from_board, CUBOID.target.outline)
    uv = CAMERA.project(corners)
    v, u = np.nonzero(rendered.classes == Class.BOARD)
    assert [u.min(), u.max()] == pytest.approx([uv[:, 0].min(), uv[:, 0].max()], abs=1.0)
    assert [v.min(), v.max()] == pytest.approx([uv[:, 1].min(), uv[:, 1].max()], abs=1.0)


def test_a_box_has_one_colour_in_three_tones_and_bodies_of_a_frame_have_colours_of_their_own() -> None:
    colours = [np.array([part.material.colour for part in thing_of(CUBOID, number)]) for number in range(3)]
    for tones in colours:
        assert tones == pytest.approx(np.outer(TONES, tones[0]))
    assert len({tuple(tones[0]) for tones in colours}) == 3


@pytest.mark.parametrize("kind", ["sphere", "box"])
def test_nothing_hides_a_body_and_a_box_shows_three_faces_to_both_sensors(kind: str) -> None:
    scene, _ = scene_of("yard", np.random.default_rng(2))
    rig = Rig(CAMERA, WORLD_FROM_CAMERA, WORLD_FROM_LIDAR)
    targets = (TARGETS[kind]["a1"],) * 2
    for number in range(4):
        boards, things = boards_in_view(scene, rig, targets, "person", number=number, seed=(0, 1))
        full = scene.plus(things)
        first = int(full.thing_of_part.max()) - 2 * len(boards) + 1
        for index, board in enumerate(boards):
            for origin in (rig.world_from_camera[:3, 3], rig.world_from_lidar[:3, 3]):
                way = board.centre - origin
                length = np.linalg.norm(way)
                hit = full.cast(origin, way[None] / length)
                assert full.thing_of_part[full.part_of_face[hit.face[0]]] == first + 2 * index
                assert length - hit.distance_m[0] > 0.15  # on its near side
                if isinstance(board.target, Box):
                    local = se3.apply(se3.inverse(board.world_from_board), origin[None])[0]
                    assert (np.abs(local) > board.target.size_m / 2).all()


def test_bodies_have_positive_sizes() -> None:
    for size in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="size of the sphere is not positive"):
            Sphere(size)
        with pytest.raises(InputError, match="size of the box is not positive"):
            Box(1.0, size, 1.0)
