"""Which piece of a sweep is which board of its image: the assignment that one rigid pose explains in most frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from p2o import Float, se3

from p2o_baselines.boards.board_in_picture import BoardInPicture
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.holes_in_picture import pattern_turns
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.target_method import Sight


def turned(to: Float, of: Float, weight: Float | None = None) -> Float:
    """Return the rotation (3, 3) that takes directions `of` (N, 3) nearest to those `to` (N, 3); least squares."""
    weighted = to if weight is None else to * weight[:, None]
    u, _, vt = np.linalg.svd(weighted.T @ of)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def from_planes(to_normal: Float, to_offset: Float, of_normal: Float, of_offset: Float) -> Float:
    """Return the pose (4, 4) that takes planes normal . x = offset onto planes, three at least and not parallel."""
    rotation = turned(to_normal, of_normal)
    # A point on the plane moves by t: n_to . (R x + t) = d_to, and n_to . R x is d_of where the normals agree.
    shift = np.linalg.lstsq(to_normal, to_offset - of_offset, rcond=None)[0]
    return se3.make(rotation, shift)


def from_points(to: Float, of: Float) -> Float:
    """Return the pose (4, 4) that aligns points (N, 3) with others by least squares."""
    rotation = turned(to - to.mean(axis=0), of - of.mean(axis=0))
    return se3.make(rotation, to.mean(axis=0) - rotation @ of.mean(axis=0))


def from_middles(to: Float, of: Float, to_normal: Float, of_normal: Float, lever_m: float = 1.0) -> Float:
    """Return the pose (4, 4) that aligns centres (N, 3) and normals (N, 3), which count as points `lever_m` away."""
    a, b = to - to.mean(axis=0), of - of.mean(axis=0)
    rotation = turned(np.concatenate([a, lever_m * to_normal]), np.concatenate([b, lever_m * of_normal]))
    return se3.make(rotation, to.mean(axis=0) - rotation @ of.mean(axis=0))


_WIDE, _NARROW = (0.6, 15.0), (0.2, 8.0)
"""Middle (m) and normal (deg) of a piece are within this of its board's: before and after the pose is refined."""
_FIT_MARGIN = 3.0  # poses whose misfits differ by less, in squares of deviations a board, fit about as well
_MIDDLE_M, _NORMAL_DEG = 0.03, 1.5
_START_DEG, _START_M = 10.0, 0.3
_APART_DEG, _APART_M = 4.0, 0.25
_MIRRORED = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Pair:
    """A board of the image of a frame with its piece of the sweep, whose own frame is rotated by `turn` (4, 4)."""

    frame: int
    board: BoardInPicture
    patch: BoardInSweep
    turn: Float

    @property
    def lidar_from_board(self) -> Float:
        """The pose (4, 4) of the board in the LiDAR frame by its outline, in the board frame of the image."""
        return np.asarray(self.patch.lidar_from_board @ self.turn)


@dataclass(frozen=True)
class Pairing:
    """The pairs that a pose explains, that rough pose (4, 4), and other poses that explain equally many pairs."""

    pairs: tuple[Pair, ...]
    camera_from_lidar: Float
    others: tuple[Float, ...]


Hypotheses = Callable[[Sequence[Sight], Float], Iterable[Float]]


def by_outline(sights: Sequence[Sight], start: Float) -> Iterable[Float]:
    """Yield a pose for each board with each segment of its size, in each symmetry."""
    for sight in sights:
        for board in sight.in_image:
            for patch in of_size(sight, board):
                for turn in turns_of(patch):
                    yield facing(board.camera_from_board) @ se3.inverse(patch.lidar_from_board @ turn)


def turns(size_m: tuple[float, float]) -> list[Float]:
    """Return the rotations (4, 4) about the normal that keep an outline: two, or four for a square."""
    steps = 4 if abs(size_m[0] - size_m[1]) < 0.03 * max(size_m) else 2
    return [se3.exp(np.array([0, 0, 2 * np.pi * k / steps, 0, 0, 0])) for k in range(steps)]


def turns_of(patch: BoardInSweep) -> list[Float]:
    """Return the rotations (4, 4) that keep a segment, including its holes."""
    if not isinstance(patch, HoleBoardInSweep):
        return turns(patch.size_m)
    same = turns(patch.size_m)
    return [turn for turn in pattern_turns(patch.target) if any(np.allclose(turn, each, atol=1e-6) for each in same)]


def facing(sensor_from_board: Float) -> Float:
    """Return the pose of a board turned about its x axis, if need be, so that z looks away from the sensor."""
    if sensor_from_board[:3, 2] @ sensor_from_board[:3, 3] > 0:
        return sensor_from_board
    return np.asarray(sensor_from_board @ _MIRRORED)


def paired(sights: Sequence[Sight], start: Float, hypotheses: Hypotheses = by_outline) -> Pairing | None:
    """Return the pairs that most frames agree on, nearest to the initial extrinsic if ambiguous; None without any."""
    explained: list[tuple[int, float, Float, list[tuple[int, BoardInPicture, BoardInSweep]]]] = []
    whole = sum(len(sight.in_image) for sight in sights)
    for pose in hypotheses(sights, start):
        if any(known[0] == whole and is_close(pose, known[2], _APART_DEG) for known in explained):
            continue
        near = _matches(sights, pose, *_WIDE)
        for _ in range(2):
            if len(near) > 1:
                pose = _refined(near, pose)
            near = _matches(sights, pose, *_NARROW) or near
        explained.append((len(near), _misfit(near, pose), pose, near))
    best = best_explained(explained, start, _FIT_MARGIN, _APART_DEG)
    if best is None:
        return None
    pose, near, others = best
    return Pairing(tuple(_pair(frame, board, patch, pose) for frame, board, patch in near), pose, others)


def best_explained(
    explained: Sequence[tuple[int, float, Float, Any]], start: Float, margin: float, apart_deg: float
) -> tuple[Float, Any, tuple[Float, ...]] | None:
    """Return the pose of most pairs nearest to `start`, its pairs, and others within `margin` a pair, or None."""
    most = max((count for count, *_ in explained), default=0)
    if not most:
        return None
    least = min(misfit for count, misfit, *_ in explained if count == most)
    similar = [each for each in explained if each[0] == most and each[1] < least + margin * most]
    _, _, pose, pairs = min(similar, key=lambda each: (_from_start(each[2], start), each[1]))
    others: list[Float] = []
    for _, _, other, _ in similar:
        if not any(is_close(other, known, apart_deg) for known in (pose, *others)):
            others.append(other)
    return pose, pairs, tuple(others)


def of_size(sight: Sight, board: BoardInPicture) -> list[BoardInSweep]:
    """Return the pieces of a sweep that have the size of a board."""
    size = (board.target.width_m, board.target.height_m)
    return [patch for patch in sight.in_sweep if np.allclose(patch.size_m, size)]


def _matches(
    sights: Sequence[Sight], pose: Float, within_m: float, within_deg: float
) -> list[tuple[int, BoardInPicture, BoardInSweep]]:
    """Return frame, board and segment for each board near a segment at a pose; each is used once."""
    out = []
    for number, sight in enumerate(sights):
        free = list(range(len(sight.in_sweep)))
        for board in sight.in_image:
            mine, near = {id(patch) for patch in of_size(sight, board)}, []
            for at in free:
                if id(patch := sight.in_sweep[at]) not in mine:
                    continue
                away, angle = _off(board, patch, pose)
                if away < within_m and angle < within_deg:
                    near.append((away / within_m + angle / within_deg, at))
            if near:
                at = min(near)[1]
                free.remove(at)
                out.append((number, board, sight.in_sweep[at]))
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
    to, of, to_direction, of_direction = [], [], [], []
    for _, board, patch in near:
        camera_from_board = facing(board.camera_from_board)
        lidar_from_board = patch.lidar_from_board @ _best_turn(board, patch, pose)
        to.append(board.camera_from_board[:3, 3])
        of.append(patch.lidar_from_board[:3, 3])
        to_direction += [board.normal, 0.3 * camera_from_board[:3, 0]]
        of_direction += [patch.normal, 0.3 * lidar_from_board[:3, 0]]
    return from_middles(np.array(to), np.array(of), np.array(to_direction), np.array(of_direction))


def _best_turn(board: BoardInPicture, patch: BoardInSweep, pose: Float) -> Float:
    """Return the turn (4, 4) of a piece that a pose brings nearest to the board's own."""
    at = pose[:3, :3] @ patch.lidar_from_board[:3, :3]
    along = facing(board.camera_from_board)[:3, 0]
    return max(turns_of(patch), key=lambda turn: float(along @ at @ turn[:3, 0]))


def _pair(frame: int, board: BoardInPicture, patch: BoardInSweep, pose: Float) -> Pair:
    turn = _best_turn(board, patch, pose)
    if facing(board.camera_from_board) is not board.camera_from_board:
        turn = turn @ _MIRRORED
    return Pair(frame, board, patch, np.asarray(turn))


def _from_start(pose: Float, start: Float) -> float:
    apart = float(np.linalg.norm(se3.inverse(pose)[:3, 3] - se3.inverse(start)[:3, 3]))
    return se3.angle_deg(pose @ se3.inverse(start)) / _START_DEG + apart / _START_M


def is_close(a: Float, b: Float, apart_deg: float) -> bool:
    """Return whether two poses (4, 4) differ by less than `apart_deg` and 0.25 m."""
    return se3.angle_deg(a @ se3.inverse(b)) < apart_deg and float(np.linalg.norm(a[:3, 3] - b[:3, 3])) < _APART_M
