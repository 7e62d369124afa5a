"""Which piece of a sweep is which board of its picture: the choice that one rigid pose explains in most frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.board_in_picture import BoardInPicture
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.closed_form import from_middles
from p2o_baselines.boards.holes_in_picture import pattern_turns
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.boards.sight import Sight

_WIDE, _NARROW = (0.6, 15.0), (0.2, 8.0)
"""Middle (m) and normal (deg) of a piece are within this of its board's: before and after the pose is refined."""
_ALIKE = 3.0
"""Poses whose misfits differ by less, in squares of deviations a board, fit about as well."""
_MIDDLE_M, _NORMAL_DEG = 0.03, 1.5
_START_DEG, _START_M = 10.0, 0.3
_APART_DEG, _APART_M = 4.0, 0.25


@dataclass(frozen=True)
class Pair:
    """A board of a picture with the piece of the sweep that is it; `frame` is the number of its frame.

    `turn` (4, 4) is how the piece's own board frame is turned to be the picture's: lidar_from_board = its own @ turn.
    """

    frame: int
    board: BoardInPicture
    patch: BoardInSweep
    turn: Float

    @property
    def lidar_from_board(self) -> Float:
        """The pose (4, 4) of the board in the LiDAR frame by its outline, in the board frame of the picture."""
        return np.asarray(self.patch.lidar_from_board @ self.turn)


@dataclass(frozen=True)
class Pairing:
    """The pairs that a pose explains, that rough pose (4, 4), and other poses that explain as many as well."""

    pairs: tuple[Pair, ...]
    camera_from_lidar: Float
    others: tuple[Float, ...]


Hypotheses = Callable[[Sequence[Sight], Float], Iterable[Float]]


def by_outline(sights: Sequence[Sight], start: Float) -> Iterable[Float]:
    """Give a pose for each board with each piece of its size, in each way it may be turned."""
    for sight in sights:
        for board in sight.boards:
            for patch in of_size(sight, board):
                for turn in turns_of(patch):
                    yield facing(board.camera_from_board) @ se3.inverse(patch.lidar_from_board @ turn)


def turns(size_m: tuple[float, float]) -> list[Float]:
    """Return the turns (4, 4) about its normal that leave an outline as it is: two, or four of a square."""
    steps = 4 if abs(size_m[0] - size_m[1]) < 0.03 * max(size_m) else 2
    return [se3.exp(np.array([0, 0, 2 * np.pi * k / steps, 0, 0, 0])) for k in range(steps)]


def turns_of(patch: BoardInSweep) -> list[Float]:
    """Return the turns (4, 4) that leave a piece as it is, holes and all."""
    if not isinstance(patch, HoleBoardInSweep):
        return turns(patch.size_m)
    same = turns(patch.size_m)
    return [turn for turn in pattern_turns(patch.target) if any(np.allclose(turn, each, atol=1e-6) for each in same)]


def facing(sensor_from_board: Float) -> Float:
    """Return the pose of a board turned about its x axis, if need be, so that z looks away from the sensor."""
    if sensor_from_board[:3, 2] @ sensor_from_board[:3, 3] > 0:
        return sensor_from_board
    return np.asarray(sensor_from_board @ np.diag([1.0, -1.0, -1.0, 1.0]))


def paired(sights: Sequence[Sight], start: Float, hypotheses: Hypotheses = by_outline) -> Pairing | None:
    """Return the pairs that most frames agree on; None where no piece may be a board.

    Of poses that fit about as well the one nearest to the start (4, 4) is taken.
    """
    found: list[tuple[int, float, Float, list[tuple[int, BoardInPicture, BoardInSweep]]]] = []
    for pose in hypotheses(sights, start):
        if any(_close(pose, known[2]) and known[0] == sum(len(s.boards) for s in sights) for known in found):
            continue
        near = _matches(sights, pose, *_WIDE)
        for _ in range(2):
            if len(near) > 1:
                pose = _refined(near, pose)
            near = _matches(sights, pose, *_NARROW) or near
        found.append((len(near), _misfit(near, pose), pose, near))
    most = max((count for count, *_ in found), default=0)
    if not most:
        return None
    least = min(misfit for count, misfit, *_ in found if count == most)
    alike = [each for each in found if each[0] == most and each[1] < least + _ALIKE * most]
    _, _, pose, near = min(alike, key=lambda each: (_from_start(each[2], start), each[1]))
    others: list[Float] = []
    for each in alike:
        if not any(_close(each[2], known) for known in (pose, *others)):
            others.append(each[2])
    return Pairing(tuple(_pair(*match, pose) for match in near), pose, tuple(others))


def of_size(sight: Sight, board: BoardInPicture) -> list[BoardInSweep]:
    """Return the pieces of a sweep that have the size of a board."""
    size = (board.target.width_m, board.target.height_m)
    return [patch for patch in sight.patches if np.allclose(patch.size_m, size)]


def _matches(
    sights: Sequence[Sight], pose: Float, within_m: float, within_deg: float
) -> list[tuple[int, BoardInPicture, BoardInSweep]]:
    """Return frame, board and piece where a pose brings a piece near to a board; each is used once."""
    out = []
    for number, sight in enumerate(sights):
        free = list(range(len(sight.patches)))
        for board in sight.boards:
            mine = of_size(sight, board)
            near = []
            for at in free:
                patch = sight.patches[at]
                if not any(patch is each for each in mine):
                    continue
                away, angle = _off(board, patch, pose)
                if away < within_m and angle < within_deg:
                    near.append((away / within_m + angle / within_deg, at))
            if near:
                at = min(near)[1]
                free.remove(at)
                out.append((number, board, sight.patches[at]))
    return out


def _off(board: BoardInPicture, patch: BoardInSweep, pose: Float) -> tuple[float, float]:
    """Return how far in m and deg a pose brings the middle and the normal of a piece from a board's."""
    middle = se3.apply(pose, patch.lidar_from_board[None, :3, 3])[0]
    cosine = float(np.clip(pose[:3, :3] @ patch.normal @ board.normal, -1, 1))
    away = float(np.linalg.norm(middle - board.camera_from_board[:3, 3]))
    return away, float(np.degrees(np.arccos(cosine)))


def _misfit(near: Sequence[tuple[int, BoardInPicture, BoardInSweep]], pose: Float) -> float:
    offs = [_off(board, patch, pose) for _, board, patch in near]
    return float(sum((away / _MIDDLE_M) ** 2 + (angle / _NORMAL_DEG) ** 2 for away, angle in offs))


def _refined(near: Sequence[tuple[int, BoardInPicture, BoardInSweep]], pose: Float) -> Float:
    """Return the pose that brings middles, normals and long sides of pieces onto those of their boards."""
    to, of, to_way, of_way = [], [], [], []
    for _, board, patch in near:
        turn = _turn(board, patch, pose)
        camera_from_board, lidar_from_board = facing(board.camera_from_board), patch.lidar_from_board @ turn
        to.append(board.camera_from_board[:3, 3])
        of.append(patch.lidar_from_board[:3, 3])
        to_way += [board.normal, 0.3 * camera_from_board[:3, 0]]
        of_way += [patch.normal, 0.3 * lidar_from_board[:3, 0]]
    return from_middles(np.array(to), np.array(of), np.array(to_way), np.array(of_way))


def _turn(board: BoardInPicture, patch: BoardInSweep, pose: Float) -> Float:
    """Return the turn (4, 4) of a piece that a pose brings nearest to the board's own."""
    at = pose[:3, :3] @ patch.lidar_from_board[:3, :3]
    along = facing(board.camera_from_board)[:3, 0]
    return max(turns_of(patch), key=lambda turn: float(along @ at @ turn[:3, 0]))


def _pair(frame: int, board: BoardInPicture, patch: BoardInSweep, pose: Float) -> Pair:
    turn = _turn(board, patch, pose)
    if facing(board.camera_from_board) is not board.camera_from_board:
        turn = turn @ np.diag([1.0, -1.0, -1.0, 1.0])
    return Pair(frame, board, patch, np.asarray(turn))


def _from_start(pose: Float, start: Float) -> float:
    step = pose @ se3.inverse(start)
    apart = float(np.linalg.norm(se3.inverse(pose)[:3, 3] - se3.inverse(start)[:3, 3]))
    return se3.angle_deg(step) / _START_DEG + apart / _START_M


def _close(a: Float, b: Float) -> bool:
    step = a @ se3.inverse(b)
    return se3.angle_deg(step) < _APART_DEG and float(np.linalg.norm(a[:3, 3] - b[:3, 3])) < _APART_M
