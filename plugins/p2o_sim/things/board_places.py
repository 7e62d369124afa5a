"""Poses of boards and bodies: in front of the rig, in the camera's view, in free space, different in each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o import Box, Camera, Checkerboard, Float, InputError, Sphere, Target, se3

from p2o_sim.things.board_holders import Holder, holder_of
from p2o_sim.things.boards import Board, thing_of
from p2o_sim.things.bodies import turned_to
from p2o_sim.world.mesh import stacked
from p2o_sim.world.place import Thing
from p2o_sim.world.scene import Class, Scene

NEAR_M, FAR_M = 2.0, 8.0
"""Range of distances from the camera; smaller if the pattern would be too small in the image."""
_SQUARE_PX, _HOLE_PX = 9.0, 16.0
# Smallest size in pixels of a square, and of a hole, which limits the distance of a board.
_BODY_FAR = 20.0
# Largest distance of a body in units of half its size: farther away, only few rings of a LiDAR hit it.
_TURN_DEG, _TILT_DEG, _ROLL_DEG = 40.0, 25.0, 15.0
# Largest rotation of boards about the vertical, tilt and roll relative to facing the camera.
_MARGIN = 0.015
# Share of the image's width that is free around boards, because the true mounting may differ from the nominal one.
_BEHIND_M = 0.8
_GROUND = (Class.ROAD, Class.PAVEMENT, Class.TERRAIN)
_TRIES = 400
# Steps of the sequence that fills a square evenly for any length (Roberts' R2).
_EVEN = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True, eq=False)
class Rig:
    """A camera and a LiDAR that observe the boards, `world_from_camera` and `world_from_lidar` (4, 4)."""

    camera: Camera
    world_from_camera: Float
    world_from_lidar: Float


def boards_in_view(
    scene: Scene, rig: Rig, targets: tuple[Target, ...], holder: Holder, *, number: int, seed: tuple[int, ...]
) -> tuple[tuple[Board, ...], tuple[Thing, ...]]:
    """Return the boards of frame `number`, and the things of boards and holders.

    One `seed` gives one series: the same holders, and boards that are evenly distributed over distance and direction
    in its frames.

    Raises InputError if there is no free space in the scene.
    """
    series = np.random.default_rng(seed)
    even = (series.random(2) + number * _EVEN) % 1.0
    rng = np.random.default_rng([*seed, number])
    boards: list[Board] = []
    things: list[Thing] = []
    for index, target in enumerate(targets):
        share = np.array([even[0], (even[1] + index) / len(targets)])
        board, ground_m = _free_place(scene, rig, target, holder, share, boards, len(targets), rng)
        boards.append(board)
        person = np.random.default_rng([*seed, 2**20 + index])
        things += [thing_of(board, index), holder_of(holder, board, ground_m, person)]
    return tuple(boards), tuple(things)


def _free_place(
    scene: Scene,
    rig: Rig,
    target: Target,
    holder: Holder,
    share: Float,
    others: list[Board],
    count: int,
    rng: np.random.Generator,
) -> tuple[Board, float]:
    """Return a board in free space and the height of the ground below it; `share` (2,) is of distance and width."""
    far = min(FAR_M, _far_m(target, rig.camera))
    for attempt in range(_TRIES):
        # First the position of the even distribution, then positions near it, then any position.
        if attempt < 20:
            chosen = share
        elif attempt < 120:
            chosen = share + rng.uniform(-0.5, 0.5, 2) * [1.0, 0.6 / count]
        else:
            chosen = rng.random(2)
        distance, across = np.clip(chosen, 0.0, 1.0) * [max(far - NEAR_M, 0.5), 0.8] + [NEAR_M, 0.1]
        board = _drawn(rig, target, float(distance), float(across), rng)
        ground_m = _ground_m(scene, board)
        if ground_m is not None and _is_free(scene, rig, board, ground_m, holder, others):
            return board, ground_m
    where = f"board {len(others) + 1} of {count}"
    expected = f"a free position {NEAR_M:g} to {far:.1f} m ahead, completely in the image"
    hint = "use fewer or smaller boards, another camera, or the place 'yard'"
    raise InputError("there is no free space for the board", where=where, expected=expected, hint=hint)


def _far_m(target: Target, camera: Camera) -> float:
    if isinstance(target, Checkerboard):
        return camera.focal_px * target.square_m / _SQUARE_PX
    if isinstance(target, Sphere | Box):
        half_m = target.radius_m if isinstance(target, Sphere) else float(np.median(target.size_m)) / 2
        return _BODY_FAR * half_m
    return camera.focal_px * 2 * min(radius for *_, radius in target.holes) / _HOLE_PX


def _drawn(rig: Rig, target: Target, distance: float, across: float, rng: np.random.Generator) -> Board:
    """Return a randomly rotated board at `distance` ahead, at the share `across` of the image width."""
    camera = rig.camera
    pixel = [across * (camera.width - 1), rng.uniform(0.2, 0.8) * (camera.height - 1)]
    ray = np.nan_to_num(camera.rays(np.array([pixel]))[0])
    centre = se3.apply(rig.world_from_camera, distance * ray[None] / max(ray[2], 0.3))[0]
    if isinstance(target, Sphere):
        return Board(target, se3.make(translation=centre))
    if isinstance(target, Box):
        towards = rig.world_from_camera[:3, 3] - centre
        return Board(target, se3.make(turned_to(towards / np.linalg.norm(towards), rng), centre))
    away = (centre - rig.world_from_camera[:3, 3]) * [1.0, 1.0, 0.0]
    away /= np.linalg.norm(away)
    down = np.array([0.0, 0.0, -1.0])
    facing = np.column_stack([np.cross(down, away), down, away])
    turn, tilt, roll = np.radians(rng.uniform(-1, 1, 3) * [_TURN_DEG, _TILT_DEG, _ROLL_DEG])
    rotation = np.eye(3)
    for axis, angle in ((1, turn), (0, tilt), (2, roll)):
        rotation = rotation @ se3.exp(angle * np.eye(6)[axis])[:3, :3]
    return Board(target, se3.make(facing @ rotation, centre))


def _ground_m(scene: Scene, board: Board) -> float | None:
    """Return the height of the ground below a board, None if there is another surface."""
    hit = scene.cast(board.centre, np.array([[0.0, 0.0, -1.0]]))
    if hit.face[0] < 0 or scene.class_of_part[scene.part_of_face[hit.face[0]]] not in _GROUND:
        return None
    return float(board.centre[2] - hit.distance_m[0])


def _is_free(scene: Scene, rig: Rig, board: Board, ground_m: float, holder: Holder, others: list[Board]) -> bool:
    """Return whether a board has a plausible height, is completely in the image, unoccluded and not too close."""
    outline, camera = board.outline, rig.camera
    if not 0.75 < board.centre[2] - ground_m < 1.7 or outline[:, 2].min() < ground_m + 0.25:
        return False
    uv = camera.project(se3.apply(se3.inverse(rig.world_from_camera), outline))
    if not camera.in_image(uv, margin_px=-_MARGIN * camera.width).all():
        return False
    rig_at = rig.world_from_camera[:3, 3]
    points = _room(board, ground_m, holder, rig_at)
    taken = [_room(other, ground_m, holder, rig_at) for other in others]
    for origin in (rig.world_from_camera[:3, 3], rig.world_from_lidar[:3, 3]):
        ways, length = _ways(points, origin)
        if (scene.cast(origin, ways).distance_m < length).any():
            return False
        for room in taken:
            # Separate as seen from the sensor: no board or holder occludes another.
            its_ways, _ = _ways(room, origin)
            middle = its_ways.mean(axis=0) / np.linalg.norm(its_ways.mean(axis=0))
            if (ways @ middle).max() > (its_ways @ middle).min():
                return False
    return True


def _room(board: Board, ground_m: float, holder: Holder, rig_at: Float) -> Float:
    """Return points (N, 3) around a board and its holder, down to the ground."""
    if isinstance(board.target, Sphere | Box):
        front = board.centre + 1.2 * (board.outline - board.centre)
        feet = stacked(front[:, :2], ground_m + 0.15)
        away = (board.centre - rig_at) * [1.0, 1.0, 0.0]
    else:
        beside = 0.7 if holder == "person" and not isinstance(board.target, Checkerboard) else 0.15
        half = np.array([board.target.width_m / 2 + beside, board.target.height_m / 2 + 0.05])
        grid = np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 5)), -1).reshape(-1, 2) * half
        front = se3.apply(board.world_from_board, stacked(grid, 0.0))
        feet = stacked(front[:7, :2], ground_m)
        away = board.world_from_board[:3, 2] * [1.0, 1.0, 0.0]
    points = np.concatenate([front, feet, front + _BEHIND_M * away / np.linalg.norm(away)])
    points[:, 2] = np.maximum(points[:, 2], ground_m + 0.15)
    return points


def _ways(points: Float, origin: Float) -> tuple[Float, Float]:
    """Return unit directions (N, 3) and distances (N,) from an origin to points."""
    offsets = points - origin
    length = np.linalg.norm(offsets, axis=1)
    return offsets / length[:, None], length
