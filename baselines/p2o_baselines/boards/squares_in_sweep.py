"""The black and white squares of a checkerboard in the reflectances of a sweep."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import p2o
from p2o import Checkerboard, se3
from p2o.arrays import Float

from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.holes_in_sweep import pose_covariance
from p2o_baselines.boards.rectangle import averaged

_MOVES, _TURNS, _TURN_RAD = 13, 7, np.radians(6.0)
_LEAST_POINTS, _LEAST_CONTRAST, _LEAST_RIGHT = 40, 1.5, 0.75
"""So many returns of two reflectances so many deviations apart, of which such a share has to be where it should."""


@dataclass(frozen=True)
class SquaresInSweep(BoardInSweep):
    """A checkerboard in a sweep whose pose is told by its squares.

    `covariance` (6, 6) is that of a left update of `lidar_from_board` (rad, m), `right` the share of returns that are
    as bright as their square, `bright` (N,) in -1..1 how bright each return is.
    """

    target: Checkerboard
    covariance: Float
    right: float
    bright: Float

    @property
    def corners(self) -> Float:
        """The inner corners (M, 3) m of the pattern in the LiDAR frame."""
        return se3.apply(self.lidar_from_board, self.target.corners)


def squares_of(cloud: p2o.Cloud, piece: BoardInSweep, target: Checkerboard) -> SquaresInSweep | None:
    """Return a piece moved in its plane so that dark returns lie on one colour of squares; None where none do."""
    from scipy.spatial import cKDTree

    if cloud.intensity is None:
        return None
    index = cKDTree(cloud.xyz).query(piece.xyz)[1]
    bright = two_levels(cloud.intensity[index])
    if bright is None:
        return None
    xy = se3.apply(se3.inverse(piece.lidar_from_board), piece.xyz)[:, :2]
    found = fitted_squares(xy, bright, target, np.random.default_rng(len(xy)))
    if found is None:
        return None
    place, covariance, right = found
    moved = se3.exp(np.array([0, 0, place[2], 0, 0, 0]))
    moved[:2, 3] = place[:2]
    pose = np.asarray(piece.lidar_from_board @ moved)
    base = {field.name: getattr(piece, field.name) for field in fields(BoardInSweep)}
    return SquaresInSweep(
        **{**base, "lidar_from_board": pose},
        target=target,
        covariance=pose_covariance(piece, pose, covariance),
        right=right,
        bright=bright,
    )


def two_levels(intensity: Float) -> Float | None:
    """Return how bright returns (N,) are between the two levels of a board, -1 to 1; None where there are not two.

    The threshold is Otsu's, what lies between the levels is between -1 and 1: a spot that meets two squares.
    """
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
    """Return by how much returns lie on squares of the other colour at places (..., 3), summed: (...) m.

    A return counts with how much it differs in brightness, times its distance from the nearest line of the pattern;
    which colour comes first is open, the better one counts.
    """
    colour, away = colours(xy, place, target)
    inside = colour != 0
    sums = [(np.abs(bright - sign * colour) / 2 * away * inside).sum(axis=-1) for sign in (1, -1)]
    return np.asarray(np.minimum(*sums))


def colours(xy: Float, place: Float, target: Checkerboard) -> tuple[Float, Float]:
    """Return the colour (..., N) of the square that each point (N, 2) is on, 1 or -1, 0 beside the pattern.

    With it comes how far it is in m from the nearest line.
    """
    x, y, turn = np.moveaxis(np.asarray(place, np.float64), -1, 0)
    cosine, sine = np.cos(turn)[..., None], np.sin(turn)[..., None]
    across, down = xy[:, 0] - x[..., None], xy[:, 1] - y[..., None]
    u = (cosine * across + sine * down) / target.square_m + (target.columns + 1) / 2
    v = (cosine * down - sine * across) / target.square_m + (target.rows + 1) / 2
    inside = (u >= 0) & (u < target.columns + 1) & (v >= 0) & (v < target.rows + 1)
    colour = np.where(inside, 1.0 - 2.0 * ((np.floor(u) + np.floor(v)) % 2), 0.0)
    away = target.square_m * np.minimum(np.abs(u - np.rint(u)), np.abs(v - np.rint(v)))
    return colour, away


def fitted_squares(
    xy: Float, bright: Float, target: Checkerboard, rng: np.random.Generator
) -> tuple[Float, Float, float] | None:
    """Return where the pattern is: x, y and turn (3,) in m and rad, their covariance (3, 3), and the share in place.

    `xy` (N, 2) are returns in the board's frame by its outline, half a square at most from the pattern's own.
    """
    from scipy.optimize import minimize

    reach = 0.5 * target.square_m
    offsets = np.linspace(-reach, reach, _MOVES)
    grid = np.stack(
        [each.ravel() for each in np.meshgrid(offsets, offsets, np.linspace(-1, 1, _TURNS) * _TURN_RAD)], axis=1
    )
    costs = np.concatenate([wrong_m(xy, bright, part, target) for part in np.array_split(grid, 24)])
    best = grid[np.argmin(costs)]
    step = np.diag([reach / 5, reach / 5, 0.02])
    end = minimize(
        lambda place: float(wrong_m(xy, bright, place, target)),
        best,
        method="Nelder-Mead",
        options={"xatol": 1e-4, "fatol": 1e-6, "initial_simplex": np.vstack([best, best + step])},
    )
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
    found = [squares_of(cloud, piece, target) for target in mine]
    return tuple(each for each in found if each is not None)
