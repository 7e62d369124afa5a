"""Detect boards with round holes in a sweep: segments of their size, and rays that pass through the holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import p2o
from p2o import Bool, Float, HoleBoard, Int, se3

from p2o_baselines.boards.board_in_sweep import BoardInSweep, Rays, pieces_of, rays_of, ring_gap_m, within_hull
from p2o_baselines.boards.rectangle import averaged, in_frame, minimised

_SIGMAS, _THIN_M = 3.0, 0.03
_CAP_M = 0.06  # a ray that is on the wrong side of a rim by more counts as that: a hand, an echo between two surfaces
_MOVES, _TURNS, _TURN_RAD = 7, 7, np.radians(9.0)
_INSETS_M = np.linspace(-0.01, 0.03, 9)
_FLOOR_M = 0.002  # of the standard deviation of the pattern: a sweep does not show the angular errors of beams
_MOST_COVERED, _LEAST_EXPLAINED = 0.3, 0.7
"""Largest share of returns in holes, relative to a solid board, and least share of rays that pass through them."""
_LEAST_RIM = 2  # least number of samples on the rim of every hole: without them a pattern may be shifted


@dataclass(frozen=True)
class HoleBoardInSweep(BoardInSweep):
    """A plane segment of a sweep that may be a board with holes.

    `lidar_from_board` is determined by the holes, `covariance` (6, 6) is that of a left update of it (rad, m).
    """

    target: HoleBoard
    covariance: Float


def hole_boards_in_sweep(
    cloud: p2o.Cloud, targets: Sequence[HoleBoard], *, farthest_m: float, sigma_m: float
) -> tuple[HoleBoardInSweep, ...]:
    """Return what may be boards of these kinds; `sigma_m` is how much ranges may scatter about a board at most."""
    rays = rays_of(cloud, farthest_m)
    boards = (
        _by_holes(rays, piece, target)
        for target in dict.fromkeys(targets)
        for piece in pieces_of(
            rays, [(target.width_m, target.height_m)], farthest_m=farthest_m, sigma_m=sigma_m, holes=target.holes
        )
    )
    return tuple(board for board in boards if board is not None)


def _by_holes(rays: Rays, piece: BoardInSweep, target: HoleBoard) -> HoleBoardInSweep | None:
    """Return a segment moved in its plane so that rays pass through its holes; None if they do not."""
    hits, cosine = rays.meet(piece.normal, piece.offset_m)
    own = se3.apply(se3.inverse(piece.lidar_from_board), hits)[:, :2]
    off = rays.xyz @ piece.normal - piece.offset_m
    within = max(_SIGMAS * piece.sigma_m, _THIN_M)
    half = np.array(piece.size_m) / 2
    # Objects in front of the board occlude it: such a ray is not informative.
    near = (np.abs(own) < half + 0.1).all(axis=1) & (cosine < -0.02) & (off < within)
    on = near & (off > -within)
    if on.sum() < 10:
        return None
    inner = on & (np.abs(own) < half).all(axis=1)
    index = np.flatnonzero(near & within_hull(own, own[inner]))
    xy, hit = own[index], on[index]
    gap = float(np.clip(ring_gap_m(own[on], rays.ring[on], 0.25), 0.02, 0.25))
    best = fitted_pattern(xy, hit, target, max(0.05, 0.7 * gap), np.random.default_rng(len(index)))
    if best is None:
        return None
    place, covariance, _ = best
    lidar_from_board = moved_in_plane(piece, place)
    rims = rim_samples(rays, piece, lidar_from_board, target, on)
    if not (np.bincount(rims, minlength=len(target.holes)) >= _LEAST_RIM).all():
        return None
    sure = pose_covariance(piece, lidar_from_board, covariance)
    base = {**vars(piece), "lidar_from_board": lidar_from_board}
    return HoleBoardInSweep(**base, target=target, covariance=sure)


def moved_in_plane(piece: BoardInSweep, place: Float) -> Float:
    """Return the pose (4, 4) of a piece after a shift and a rotation (3,) m and rad in its plane."""
    moved = se3.exp(np.array([0, 0, place[2], 0, 0, 0]))
    moved[:2, 3] = place[:2]
    return np.asarray(piece.lidar_from_board @ moved)


def pose_covariance(piece: BoardInSweep, lidar_from_board: Float, in_plane: Float) -> Float:
    """Return the covariance (6, 6) of a left update of the pose: its place in the plane, and the plane itself."""
    x_axis, y_axis, normal, origin = lidar_from_board[:3].T
    off = piece.xyz - piece.middle
    off = off - np.outer(off @ normal, normal)
    values, vectors = np.linalg.eigh(off.T @ off)
    moves = [np.r_[0.0, 0, 0, x_axis], np.r_[0.0, 0, 0, y_axis], np.r_[normal, -np.cross(normal, origin)]]
    # A plane tilts about an axis by the noise over the spread of its points across that axis.
    moves += [np.r_[axis, -np.cross(axis, piece.middle)] for axis in (vectors[:, 1], vectors[:, 2])]
    moves.append(np.r_[0.0, 0, 0, normal])
    whole = np.zeros((6, 6))
    whole[:3, :3] = in_plane + np.diag([_FLOOR_M, _FLOOR_M, 2 * _FLOOR_M]) ** 2
    whole[3:, 3:] = np.diag(piece.sigma_m**2 / np.array([values[2], values[1], len(off)]))
    tangents = np.array(moves).T
    return np.asarray(tangents @ whole @ tangents.T)


def fitted_pattern(
    xy: Float, on: Bool, target: HoleBoard, reach_m: float, rng: np.random.Generator
) -> tuple[Float, Float, float] | None:
    """Return the pose of holes: x, y and rotation (3,) in m and rad, covariance (3, 3), and inset of rims in m.

    `xy` (N, 2) are the intersections of rays with the plane in the frame of the outline, `on` (N,) those that return
    from it; the search range is `reach_m`. None if rays pass through elsewhere, or return from within holes.
    """
    holes = np.array(target.holes)
    offsets = np.linspace(-reach_m, reach_m, _MOVES)
    small = np.linspace(-_TURN_RAD, _TURN_RAD, _TURNS)
    turns = np.concatenate([start + small for start in quarter_turns(target)])
    grid = np.stack([each.ravel() for each in np.meshgrid(offsets, offsets, turns, indexing="ij")], axis=1)
    costs = wrong_m(xy, on, grid, holes, 0.0)
    inset, place = 0.0, grid[np.argmin(costs)]
    steps = [reach_m / 3, reach_m / 3, 0.03]
    for _ in range(2):
        place = np.asarray(minimised(partial(wrong_m, xy, on, holes=holes, inset_m=inset), place, steps).x)
        insets = [float(wrong_m(xy, on, place, holes, each)) for each in _INSETS_M]
        inset = float(_INSETS_M[np.argmin(insets)])
    if np.abs(place[:2]).max() > 1.5 * reach_m:  # away from the board, where nothing contradicts
        return None
    sizes = np.array([reach_m, reach_m, 2 * reach_m / max(target.width_m, target.height_m)])
    place, covariance = averaged(lambda at: wrong_m(xy, on, at, holes, inset), place, sizes, rng)
    deep = inside_m(xy, place, holes) - inset
    area = float(np.pi * (holes[:, 2] ** 2).sum())
    share = area / (target.width_m * target.height_m - area)
    covered = (on & (deep > 0.01)).sum() / max(share * on.sum(), 1.0)
    through = ~on
    explained = (deep[through] > -0.02).mean() if through.any() else 1.0
    if covered > _MOST_COVERED or explained < _LEAST_EXPLAINED:
        return None
    return place, covariance, inset


def quarter_turns(target: HoleBoard) -> list[float]:
    """Return the rotations in rad about the normal that keep the outline and move the holes; 0 is included."""
    square = abs(target.width_m - target.height_m) < 0.03 * max(target.width_m, target.height_m)
    holes = np.array(target.holes)
    out: list[float] = []
    known: list[Float] = []
    for quarter in range(0, 4, 1 if square else 2):
        turn = np.pi / 2 * quarter
        rotation = se3.exp(np.array([0, 0, turn, 0, 0, 0]))
        moved = np.column_stack([se3.apply(rotation, target.centres)[:, :2], holes[:, 2]])
        if not any(np.abs(moved[:, None] - each[None]).max(axis=2).min(axis=1).max() < 0.005 for each in known):
            known.append(moved)
            out.append(float(turn))
    return out


def inside_m(xy: Float, place: Float, holes: Float) -> Float:
    """Return the depth of points (N, 2) within the nearest hole at poses (..., 3), negative outside: (..., N) m."""
    own_x, own_y = in_frame(xy, place)
    deep = np.full(own_x.shape, -np.inf)
    for u, v, radius in holes:
        np.maximum(deep, radius - np.sqrt((own_x - u) ** 2 + (own_y - v) ** 2), out=deep)
    return deep


def wrong_m(xy: Float, on: Bool, place: Float, holes: Float, inset_m: float) -> Float:
    """Return the summed distances of rays on the wrong side of rims at poses (..., 3): (...) m."""
    deep = inside_m(xy, place, holes) - inset_m
    return np.asarray(np.clip(np.where(on, deep, -deep), 0.0, _CAP_M).sum(axis=-1))


def rim_samples(rays: Rays, piece: BoardInSweep, lidar_from_board: Float, target: HoleBoard, on: Bool) -> Int:
    """Return the hole (K,) of each end of a ring, half a step beyond the last return, that is at a rim."""
    hits, cosine = rays.meet(piece.normal, piece.offset_m)
    own = se3.apply(se3.inverse(lidar_from_board), hits)[:, :2]
    holes = np.array(target.holes)
    which = []
    for ring in np.unique(rays.ring[on]):
        members = np.flatnonzero(rays.ring == ring)
        mine = members[on[members]]
        usual = np.linalg.norm(hits[mine], axis=1) * rays.step_rad / np.maximum(np.abs(cosine[mine]), 0.2)
        place = np.searchsorted(members, mine)
        for last, at, step in zip(mine, place, usual, strict=True):
            for side in (-1, 1):
                if not 0 <= at + side < len(members):
                    continue
                following = members[at + side]
                size = float(np.linalg.norm(hits[following] - hits[last]))
                if (on[following] and size < 2.5 * step) or size < 1e-9:
                    continue
                spot = own[last] + (own[following] - own[last]) / size * min(size, step) / 2
                away = np.hypot(holes[:, 0] - spot[0], holes[:, 1] - spot[1]) - holes[:, 2]
                nearest = int(np.argmin(np.abs(away)))
                if abs(away[nearest]) < 0.05:
                    which.append(nearest)
    return np.array(which, np.int64)
