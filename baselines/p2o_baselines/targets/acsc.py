"""Calibrate with checkerboard corners from reflectances, `--calibrator acsc`, after Cui, Niu, Ouyang, He and Li 2020.

White squares reflect more than black ones. In the plane of a detected board, the position and rotation of the pattern
are estimated by minimising the number of returns on squares of the other colour, each weighted by its depth inside that
square. This gives the inner corners in 3D. The corners of all boards and their pixels give the pose by PnP with RANSAC,
followed by Levenberg-Marquardt on bearings.

Departures: the original is for LiDARs with a non-repetitive pattern (Livox) and accumulates many sweeps of one scene.
Here a board is detected by its rings in one sweep (`boards.board_in_sweep`; accumulate sweeps of one scene before), so
rosette patterns are refused. The board detector is the shared one. Frames do not state which colour comes first; the
rotation of a board by 180 deg is resolved by the one pose that explains all frames, or by the initial extrinsic. The
sweep needs intensities. Squares must be about as large as the distance between two rings: 3.5 cm per metre of range for
a VLP-16 (2 deg), 0.7 cm for an HDL-64E (0.4 deg).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import p2o
from p2o import Checkerboard, Float, Result, se3

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import Block
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod, same_cost, sight_of
from p2o_baselines.boards.holes_in_sweep import moved_in_plane, pose_covariance
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.rectangle import averaged, in_frame, minimised
from p2o_baselines.boards.residuals import bearings_by_point, moved
from p2o_baselines.outcome import refused
from p2o_baselines.target_method import Sight, TargetOptions, unsolved

_MOVES, _TURNS, _TURN_RAD = 13, 7, np.radians(6.0)
_LEAST_POINTS, _LEAST_CONTRAST, _LEAST_RIGHT = 40, 1.5, 0.75
"""Least number of returns with two reflectances, their separation in deviations, and the least share in place."""


@dataclass(frozen=True)
class SquaresInSweep(BoardInSweep):
    """A checkerboard in a sweep, its pose by its squares, and the covariance (6, 6) of a left update (rad, m)."""

    target: Checkerboard
    covariance: Float


def squares_of(cloud: p2o.Cloud, piece: BoardInSweep, target: Checkerboard) -> SquaresInSweep | None:
    """Return a segment moved in its plane so that dark returns lie on squares of one colour; None if it fails."""
    from scipy.spatial import cKDTree

    if cloud.intensity is None:
        return None
    index = cKDTree(cloud.xyz).query(piece.xyz)[1]
    bright = two_levels(cloud.intensity[index])
    if bright is None:
        return None
    xy = se3.apply(se3.inverse(piece.lidar_from_board), piece.xyz)[:, :2]
    pattern = fitted_squares(xy, bright, target, np.random.default_rng(len(xy)))
    if pattern is None:
        return None
    place, covariance, _ = pattern
    pose = moved_in_plane(piece, place)
    sure = pose_covariance(piece, pose, covariance)
    return SquaresInSweep(**{**vars(piece), "lidar_from_board": pose}, target=target, covariance=sure)


def two_levels(intensity: Float) -> Float | None:
    """Return the brightness (N,) of returns between both levels of a board by Otsu, -1 to 1; None without two."""
    values = np.sort(np.asarray(intensity, np.float64))
    if len(values) < _LEAST_POINTS or values[-1] <= values[0]:
        return None
    count = np.arange(1, len(values))
    low, high = np.cumsum(values)[:-1] / count, (values.sum() - np.cumsum(values)[:-1]) / (len(values) - count)
    at = int(np.argmax(count * (len(values) - count) * (high - low) ** 2))
    dark, light = np.median(values[: at + 1]), np.median(values[at + 1 :])
    noise = 1.4826 * np.median(np.abs(np.concatenate([values[: at + 1] - dark, values[at + 1 :] - light])))
    if light - dark < _LEAST_CONTRAST * max(float(noise), 1e-9):
        return None
    return np.asarray(np.clip((2 * intensity - dark - light) / (light - dark), -1, 1))


def wrong_m(xy: Float, bright: Float, place: Float, target: Checkerboard) -> Float:
    """Return the summed distances (...) m of returns on squares of the other colour, weighted by brightness."""
    colour, away = colours(xy, place, target)
    inside = colour != 0
    sums = [(np.abs(bright - sign * colour) / 2 * away * inside).sum(axis=-1) for sign in (1, -1)]
    return np.asarray(np.minimum(*sums))


def colours(xy: Float, place: Float, target: Checkerboard) -> tuple[Float, Float]:
    """Return the colour (..., N) of the squares of points (N, 2), 1, -1, or 0 outside, and its distance from lines."""
    across, down = in_frame(xy, place)
    u, v = across / target.square_m + (target.columns + 1) / 2, down / target.square_m + (target.rows + 1) / 2
    inside = (u >= 0) & (u < target.columns + 1) & (v >= 0) & (v < target.rows + 1)
    colour = np.where(inside, 1.0 - 2.0 * ((np.floor(u) + np.floor(v)) % 2), 0.0)
    away = target.square_m * np.minimum(np.abs(u - np.rint(u)), np.abs(v - np.rint(v)))
    return colour, away


def fitted_squares(
    xy: Float, bright: Float, target: Checkerboard, rng: np.random.Generator
) -> tuple[Float, Float, float] | None:
    """Return the pose x, y, rotation (3,) of the pattern near returns (N, 2), covariance, and share in place."""
    reach = 0.5 * target.square_m
    offsets = np.linspace(-reach, reach, _MOVES)
    turns = np.linspace(-1, 1, _TURNS) * _TURN_RAD
    grid = np.stack([each.ravel() for each in np.meshgrid(offsets, offsets, turns)], axis=1)
    costs = np.concatenate([wrong_m(xy, bright, part, target) for part in np.array_split(grid, 24)])
    best = grid[np.argmin(costs)]
    steps = [reach / 5, reach / 5, 0.02]
    end = minimised(lambda at: wrong_m(xy, bright, at, target), best, steps, fatol=1e-6)
    sizes = np.array([reach, reach, _TURN_RAD])
    place, covariance = averaged(lambda at: wrong_m(xy, bright, at, target), np.asarray(end.x), sizes, rng)
    colour, away = colours(xy, place, target)
    clear = (colour != 0) & (away > 0.1 * target.square_m)
    if clear.sum() < _LEAST_POINTS:
        return None
    agree = float(np.mean(np.sign(bright[clear]) == colour[clear]))
    right = max(agree, 1 - agree)
    return (place, covariance, right) if right >= _LEAST_RIGHT else None


def with_squares(cloud: p2o.Cloud, piece: BoardInSweep, targets: list[Checkerboard]) -> tuple[SquaresInSweep, ...]:
    """Return a piece as each of the checkerboards of its size that its reflectances show."""
    mine = [target for target in targets if np.allclose((target.width_m, target.height_m), piece.size_m)]
    segments = [squares_of(cloud, piece, target) for target in mine]
    return tuple(each for each in segments if each is not None)


_RANSAC_PX = 10.0


@dataclass(frozen=True)
class Marked:
    """One frame: its boards, those of the sweep by their squares, and whether the sweep has intensities."""

    sight: Sight
    has_intensity: bool


def marked(frame: p2o.Frame, options: TargetOptions) -> Marked:
    """Return what a frame shows of its checkerboards, by squares in both sensors."""
    sight = sight_of(frame, options)
    targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Checkerboard)))
    patches = tuple(each for piece in sight.in_sweep for each in with_squares(frame.cloud, piece, targets))
    return Marked(replace(sight, in_sweep=patches), frame.cloud.intensity is not None)


def corners(pair: Pair) -> tuple[Float, Float]:
    """Return the corners (N, 3) m of the sweep, and of the image in the camera frame."""
    drawing = cast(Checkerboard, pair.board.target).corners
    return se3.apply(pair.lidar_from_board, drawing), se3.apply(pair.board.camera_from_board, drawing)


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) from 3D corners and their bearings by OpenCV's RANSAC; `rough` if it fails."""
    import cv2

    xyz, seen = (np.concatenate(each) for each in zip(*map(corners, pairs), strict=True))
    if (seen[:, 2] <= 0).any():
        return rough
    scale = float(np.median([pair.board.px_per_rad for pair in pairs]))
    cv2.setRNGSeed(0)
    solved, turn, shift, _ = cv2.solvePnPRansac(
        xyz,
        seen[:, :2] / seen[:, 2:],
        np.eye(3),
        None,
        cv2.Rodrigues(rough[:3, :3])[0],
        rough[:3, 3].copy(),
        useExtrinsicGuess=True,
        iterationsCount=200,
        reprojectionError=_RANSAC_PX / scale,
    )
    return se3.make(cv2.Rodrigues(turn)[0], shift.ravel()) if solved else rough


def kept(pairs: Sequence[Pair], pose: Float) -> list[Pair]:
    """Return the boards whose median corner error is below half a square; all boards if few are."""
    good = []
    for pair in pairs:
        of, to = corners(pair)
        off = float(np.median(np.linalg.norm(se3.apply(pose, of) - to, axis=1)))
        if off < 0.5 * cast(Checkerboard, pair.board.target).square_m:
            good.append(pair)
    return good if 2 * len(good) > len(pairs) else list(pairs)


def residuals(pair: Pair, pose: Float) -> Block:
    """Return the differences (2N,) in rad between the bearings of sweep corners and image corners."""
    of, to = corners(pair)
    at = se3.apply(pose, of)
    by_point = bearings_by_point(at)
    turn = np.kron(np.eye(len(of)), pose[:3, :3])
    noise = by_point @ turn @ moved(of)
    rays = of / np.linalg.norm(of, axis=1)[:, None]
    return Block(
        (at[:, :2] / at[:, 2:] - to[:, :2] / to[:, 2:]).ravel(),
        by_point @ moved(at),
        by_point @ turn @ rays.ravel(),
        noise @ cast(SquaresInSweep, pair.patch).covariance @ noise.T,
    )


ALGORITHM = BoardAlgorithm(
    least=1,
    planes_only=False,
    closed=closed,
    cost=same_cost(residuals),
    kept=kept,
    feature=" and whose reflectances show its squares",
)


@dataclass(frozen=True)
class Acsc:
    """The calibrator."""

    options: TargetOptions

    def prepare(self, frame: p2o.Frame) -> Marked:
        """Return the boards of both sensors, by their squares."""
        return marked(frame, self.options)

    def solve(self, prepared: Sequence[Marked], camera_from_lidar: Float) -> Result:
        """Return the pose that projects the corners of the sweep onto those of the image."""
        sights = [each.sight for each in prepared]
        if prepared and not any(each.has_intensity for each in prepared):
            reason = "no sweep has intensities, which are needed to detect squares of checkerboards"
            return refused(unsolved(sights, np.asarray(camera_from_lidar, np.float64)), reason)
        return BoardMethod(self.options, ALGORITHM).solve(sights, camera_from_lidar)


METHOD = p2o.Method(
    name="acsc",
    build=Acsc,
    options=TargetOptions,
    summary="Checkerboard corners from reflectances of the sweep, then a pose from points.",
    needs=frozenset({"targets", "intensity"}),
    cite="Cui, Niu, Ouyang, He and Li, ACSC: Automatic calibration for non-repetitive scanning solid-state LiDAR and "
    "camera systems, arXiv:2011.08516, 2020",
    example=examples.checkerboards("0.9deg 0.06m", lidar="vlp-16", frames=6),
)
