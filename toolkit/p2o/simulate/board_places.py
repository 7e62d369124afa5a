"""Where boards and bodies stand: before the rig, in its camera's view, in free space, elsewhere in each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.target import Box, Checkerboard, Sphere, Target
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.simulate.board_holders import Holder, held_by
from p2o.simulate.boards import Board, thing_of
from p2o.simulate.bodies import turned_to
from p2o.simulate.classes import Class
from p2o.simulate.place import Thing
from p2o.simulate.scene import Scene

NEAR_M, FAR_M = 2.0, 8.0
"""How far from the camera boards stand; nearer where their pattern would be too small in the picture."""
_SQUARE_PX = 9.0
_HOLE_PX = 16.0
# Pixels of a square across, and of a hole, which have to be left at the distance of a board.
_BODY_FAR = 20.0
# Bodies stand no farther than so many times half of their size: few rings of a LiDAR meet them there.
_TURN_DEG, _TILT_DEG, _ROLL_DEG = 40.0, 25.0, 15.0
# Boards are turned about the vertical, tilted and rolled by at most so much from facing the camera.
_MARGIN = 0.015
# Share of the image's width that stays free around boards: the mounting may be a little off from the drawing.
_BEHIND_M = 0.8
_GROUND = (Class.ROAD, Class.PAVEMENT, Class.TERRAIN)
_TRIES = 400
# Steps of the sequence that fills a square evenly, whatever its length (Roberts' R2).
_EVEN = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True, eq=False)
class Rig:
    """A camera and a LiDAR that shall see the boards, `world_from_camera` and `world_from_lidar` (4, 4)."""

    camera: Camera
    world_from_camera: Float
    world_from_lidar: Float


def boards_in_view(
    scene: Scene, rig: Rig, targets: tuple[Target, ...], holder: Holder, *, number: int, seed: tuple[int, ...]
) -> tuple[tuple[Board, ...], tuple[Thing, ...]]:
    """Return boards where frame `number` shows them, and the things they and their holders are.

    One `seed` makes one series: the same holders, and boards that are spread evenly, near and far, left and right,
    over its frames.

    Raises InputError where there is no room in the scene.
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
        things += [thing_of(board, index), held_by(holder, board, ground_m, person)]
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
    """Return a board in free space and the height of the ground below it; `share` (2,) of the distance and width."""
    far = min(FAR_M, _far_m(target, rig.camera))
    for attempt in range(_TRIES):
        # The even place first, then about it, then anywhere.
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
    raise InputError(
        "there is no room for the board",
        where=f"board {len(others) + 1} of {count}",
        expected=f"a free place {NEAR_M:g} to {far:.1f} m ahead, wholly in the picture",
        hint="take fewer or smaller boards, another camera, or the place 'yard'",
    )


def _far_m(target: Target, camera: Camera) -> float:
    if isinstance(target, Checkerboard):
        return camera.focal_px * target.square_m / _SQUARE_PX
    if isinstance(target, Sphere | Box):
        return _BODY_FAR * _half_m(target)
    return camera.focal_px * 2 * min(radius for *_, radius in target.holes) / _HOLE_PX


def _half_m(target: Sphere | Box) -> float:
    """Return the radius of a sphere, half of the middle side of a box."""
    return target.radius_m if isinstance(target, Sphere) else float(np.median(target.size_m)) / 2


def _drawn(rig: Rig, target: Target, distance: float, across: float, rng: np.random.Generator) -> Board:
    """Return a board whose middle is `distance` ahead, at the share `across` of the width, turned at random."""
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
    """Return the height of the ground below a board, None where something else lies there."""
    hit = scene.cast(board.centre, np.array([[0.0, 0.0, -1.0]]))
    if hit.face[0] < 0 or scene.class_of_part[scene.part_of_face[hit.face[0]]] not in _GROUND:
        return None
    return float(board.centre[2] - hit.distance_m[0])


def _is_free(scene: Scene, rig: Rig, board: Board, ground_m: float, holder: Holder, others: list[Board]) -> bool:
    """Whether a board hangs at a height to hold, is wholly in the picture, and nothing hides it or is too near."""
    outline, centre, camera = board.outline, board.centre, rig.camera
    if not 0.75 < centre[2] - ground_m < 1.7 or outline[:, 2].min() < ground_m + 0.25:
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
            # Apart as seen from the sensor: no board or holder hides another.
            its_ways, _ = _ways(room, origin)
            its_middle = its_ways.mean(axis=0) / np.linalg.norm(its_ways.mean(axis=0))
            if (ways @ its_middle).max() > (its_ways @ its_middle).min():
                return False
    return True


def _room(board: Board, ground_m: float, holder: Holder, rig_at: Float) -> Float:
    """Return points (N, 3) around a board and its holder, down to the ground."""
    if isinstance(board.target, Sphere | Box):
        around = board.centre + 1.2 * (board.outline - board.centre)
        feet = np.column_stack([around[:, :2], np.full(len(around), ground_m + 0.15)])
        away = (board.centre - rig_at) * [1.0, 1.0, 0.0]
        points = np.concatenate([around, feet, around + _BEHIND_M * away / np.linalg.norm(away)])
        points[:, 2] = np.maximum(points[:, 2], ground_m + 0.15)
        return points
    beside = 0.7 if holder == "person" and not isinstance(board.target, Checkerboard) else 0.15
    half = np.array([board.target.width_m / 2 + beside, board.target.height_m / 2 + 0.05])
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 5)), -1).reshape(-1, 2) * half
    front = se3.apply(board.world_from_board, np.column_stack([grid, np.zeros(len(grid))]))
    feet = np.column_stack([front[:7, :2], np.full(7, ground_m)])
    away = board.world_from_board[:3, 2] * [1.0, 1.0, 0.0]
    points = np.concatenate([front, feet, front + _BEHIND_M * away / np.linalg.norm(away)])
    points[:, 2] = np.maximum(points[:, 2], ground_m + 0.15)
    return points


def _ways(points: Float, origin: Float) -> tuple[Float, Float]:
    """Return unit directions (N, 3) and distances (N,) from a place to points."""
    way = points - origin
    length = np.linalg.norm(way, axis=1)
    return way / length[:, None], length
