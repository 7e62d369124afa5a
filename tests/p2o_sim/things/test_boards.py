"""Boards: exact geometry, seen alike by camera and LiDAR, in poses that a calibration can use."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from p2o import Camera, InputError, se3
from p2o.frames.frame import Checkerboard, HoleBoard
from p2o_sim.places.catalog import scene_of
from p2o_sim.sensing.rendering import render
from p2o_sim.sensing.scanning import sweep
from p2o_sim.sensing.sensors import LIDARS
from p2o_sim.things.board_holders import holder_of
from p2o_sim.things.board_places import Rig, boards_in_view
from p2o_sim.things.boards import TARGETS, Board, thing_of
from p2o_sim.world.scene import Class, Part, Scene

from tests.p2o_sim.walls import FORWARD, GREY, ON_A_CAR, before_a_wall, box, in_frame, volume

CAMERA = Camera.pinhole(360.0, 360.0, 310.0, 130.0, 621, 260)
WORLD_FROM_CAMERA, WORLD_FROM_LIDAR = ON_A_CAR


def tilted(target: Checkerboard | HoleBoard, *, x: float = 4.0, y: float = 0.6) -> Board:
    """Return the board, turned about all axes, `x` metres ahead."""
    turn = se3.exp(np.array([0.25, -0.4, 0.15, 0.0, 0.0, 0.0]))[:3, :3]
    return Board(target, se3.make(FORWARD @ turn, (x, y, 1.5)))


@cache
def swept(kind: str) -> tuple[Board, np.ndarray, np.ndarray]:
    """Return a board with the points of an OS1-128 in its frame, without noise across the beams, and intensities."""
    board = tilted(TARGETS[kind]["a0"])
    cloud = sweep(before_a_wall(board), LIDARS["os1-128"], WORLD_FROM_LIDAR, np.random.default_rng(0))
    return board, in_frame(board, cloud.xyz), cloud.intensity


def test_the_corners_of_the_pattern_are_where_four_squares_meet_and_the_first_is_black() -> None:
    target = Checkerboard(4, 3, 0.2, 1.2, 0.9)
    board = Board(target, se3.make(FORWARD, (3.0, 0.0, 1.5)))
    scene = before_a_wall(board)
    names = np.array([part.material.name for part in scene.all_parts])

    def colours(shift: tuple[float, float]) -> np.ndarray:
        spots = se3.apply(board.world_from_board, target.corners + [*shift, -0.5])
        hits = scene.cast(spots, np.tile(FORWARD[:, 2], (len(spots), 1)))
        np.testing.assert_allclose(hits.distance_m, 0.5, atol=1e-9)
        return names[scene.part_of_face[hits.face]]

    row, column = np.divmod(np.arange(12), 4)
    even = (row + column) % 2 == 0
    for shift, black in (((-0.03, -0.03), even), ((0.03, 0.03), even), ((0.03, -0.03), ~even), ((-0.03, 0.03), ~even)):
        np.testing.assert_array_equal(colours(shift) == "board black", black)


def test_a_pattern_that_its_board_cuts_keeps_its_corners() -> None:
    target = Checkerboard(4, 3, 0.2, 0.7, 0.5)
    front = [part for part in thing_of(Board(target, np.eye(4))) if part.material.name != "board back"]
    area = sum(_area(part) for part in front)
    assert area == pytest.approx(0.7 * 0.5)
    assert all(np.abs(part.mesh.vertices[:, :2]).max(axis=0) == pytest.approx([0.35, 0.25]) for part in front)


def _area(part: Part) -> float:
    a, b, c = (part.mesh.vertices[part.mesh.faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("kind", ["checkerboard", "holes"])
def test_every_edge_of_a_board_joins_two_faces_that_look_outwards(kind: str) -> None:
    target = (
        HoleBoard(1.0, 0.8, ((-0.2, 0.1, 0.15), (0.25, -0.1, 0.1)))
        if kind == "holes"
        else Checkerboard(4, 3, 0.1, 0.8, 0.6)
    )
    thing = thing_of(Board(target, np.eye(4)))
    holes = np.pi * (0.15**2 + 0.1**2) if kind == "holes" else 0.0
    assert volume([part.mesh for part in thing]) == pytest.approx(
        (target.width_m * target.height_m - holes) * 0.008, rel=1e-3
    )


def test_holes_that_overlap_are_refused() -> None:
    with pytest.raises(InputError, match="overlap"):
        thing_of(Board(HoleBoard(1.0, 0.8, ((-0.1, 0.0, 0.12), (0.1, 0.0, 0.12))), np.eye(4)))


def test_points_on_the_board_lie_in_its_plane_within_the_noise_of_the_range() -> None:
    board, xyz, _ = swept("checkerboard")
    inside = (np.abs(xyz[:, :2]) < np.array([0.55, 0.38])).all(axis=1) & (np.abs(xyz[:, 2]) < 0.3)
    along = xyz[inside] - in_frame(board, np.zeros((1, 3)))
    slant = np.abs(along[:, 2]) / np.linalg.norm(along, axis=1)
    assert inside.sum() > 800
    assert (xyz[inside, 2] / slant).std() == pytest.approx(LIDARS["os1-128"].range_noise_m, rel=0.1)
    assert abs((xyz[inside, 2] / slant).mean()) < 0.003


def test_black_squares_send_back_less_than_white_ones() -> None:
    board, xyz, intensity = swept("checkerboard")
    target = board.target
    square = xyz[:, :2] / target.square_m + np.array([target.columns + 1, target.rows + 1]) / 2
    on = (
        (np.abs(xyz[:, 2]) < 0.1)
        & (square > 0).all(axis=1)
        & (square < [target.columns + 1, target.rows + 1]).all(axis=1)
    )
    inner = on & (np.abs(square % 1 - 0.5) < 0.25).all(axis=1)
    black = np.floor(square).sum(axis=1) % 2 == 0
    assert (inner & black).sum() > 100
    assert intensity[inner & black].max() < 0.5 * intensity[inner & ~black].min()


def test_beams_go_through_the_holes_and_nowhere_else() -> None:
    board, xyz, _ = swept("holes")
    eye = in_frame(board, np.zeros((1, 3)))[0]
    share = -eye[2] / (xyz[:, 2] - eye[2])
    crossing = eye + share[:, None] * (xyz - eye)
    towards = xyz[:, 2] > -0.3
    off = np.stack([np.hypot(*(crossing[:, :2] - [x, y]).T) - r for x, y, r in board.target.holes]).min(axis=0)
    through = towards & (off < -0.03)
    on_board = towards & (off > 0.03) & (np.abs(crossing[:, :2]) < np.array([0.55, 0.38])).all(axis=1)
    assert through.sum() > 60
    assert xyz[through, 2].min() > 0.5
    assert np.abs(xyz[on_board, 2]).max() < 0.1


def test_the_camera_sees_the_background_through_the_holes() -> None:
    board = tilted(TARGETS["holes"]["a0"], x=3.0)
    rendered = render(before_a_wall(board), CAMERA, WORLD_FROM_CAMERA)
    camera_from_board = se3.inverse(WORLD_FROM_CAMERA) @ board.world_from_board
    for centre, inside in ((board.target.centres, False), (np.array([[0.0, 0.0, 0.0]]), True)):
        u, v = np.rint(CAMERA.project(se3.apply(camera_from_board, centre))).astype(int).T
        assert ((rendered.classes[v, u] == Class.BOARD) == inside).all()
        # The wall is 6 m behind the board.
        assert ((rendered.depth_m[v, u] > 5.0) != inside).all()


@cache
def series(holder: str, kind: str) -> tuple[Scene, Rig, tuple[Board, ...]]:
    """Return a yard and the boards of ten frames in it, one each."""
    scene, _ = scene_of("yard", np.random.default_rng(2))
    rig = Rig(CAMERA, WORLD_FROM_CAMERA, WORLD_FROM_LIDAR)
    targets = (TARGETS[kind]["a0"],)
    found = [boards_in_view(scene, rig, targets, holder, number=n, seed=(0, 1)) for n in range(10)]
    return scene, rig, tuple(boards[0] for boards, _ in found)


@pytest.mark.parametrize("holder", ["person", "stand"])
@pytest.mark.parametrize("kind", ["checkerboard", "holes"])
def test_nothing_hides_a_board_from_either_sensor(holder: str, kind: str) -> None:
    scene, rig, boards = series(holder, kind)
    for board in boards:
        full = scene.plus([thing_of(board), holder_of(holder, board, 0.0, np.random.default_rng(0))])
        inner = 0.93 * board.target.outline
        spots = se3.apply(board.world_from_board, np.vstack([inner, [[0.0, 0.0, 0.0]]]))
        for origin in (rig.world_from_camera[:3, 3], rig.world_from_lidar[:3, 3]):
            way = spots - origin
            length = np.linalg.norm(way, axis=1)
            np.testing.assert_allclose(full.cast(origin, way / length[:, None]).distance_m, length, atol=1e-6)


def test_ten_boards_are_near_and_far_left_and_right_turned_and_tilted() -> None:
    _, rig, boards = series("person", "checkerboard")
    in_camera = [se3.inverse(rig.world_from_camera) @ board.world_from_board for board in boards]
    centre = np.array([pose[:3, 3] for pose in in_camera])
    normal = np.array([pose[:3, 2] for pose in in_camera])
    assert centre[:, 2].min() < 3.0
    assert centre[:, 2].max() > 3.8
    assert np.ptp(centre[:, 0] / centre[:, 2]) > 0.7
    assert np.linalg.svd(normal - normal.mean(axis=0))[1][1] > 0.3
    for pose in in_camera:
        assert CAMERA.in_image(CAMERA.project(se3.apply(pose, boards[0].target.outline))).all()


def test_a_scene_with_more_things_keeps_what_it_has() -> None:
    scene, _ = scene_of("yard", np.random.default_rng(2))
    board = tilted(TARGETS["checkerboard"]["a1"])
    more = scene.plus([thing_of(board)])
    assert more.parts == scene.parts
    plain, changed = (render(s, CAMERA, WORLD_FROM_CAMERA) for s in (scene, more))
    on = changed.classes == Class.BOARD
    assert len(np.unique(changed.instance[on])) == 1
    assert changed.instance[on][0] not in plain.instance
    np.testing.assert_array_equal(changed.instance[~on], plain.instance[~on])


def test_a_board_that_finds_no_room_is_refused() -> None:
    wall = Part(box(1.0, 60.0, -1.0, 12.0).moved(2.0), GREY, 0)
    narrow = Scene((wall, Part(box(80.0, 80.0, -1.0, 0.0), GREY, 1, Class.ROAD)))
    rig = Rig(CAMERA, WORLD_FROM_CAMERA, WORLD_FROM_LIDAR)
    with pytest.raises(InputError, match="no free space"):
        boards_in_view(narrow, rig, (TARGETS["checkerboard"]["a0"],), "stand", number=0, seed=(0,))
