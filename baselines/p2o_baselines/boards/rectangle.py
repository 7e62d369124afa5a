"""Fit a rectangle of known size in a plane to the rays that intersect the plane inside and outside of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from p2o import Bool, Float

_TURNS, _MOVES = 24, 5
_CAP_M = 0.15  # limit of the cost of a ray on the wrong side: a hand or a stand may extend the board
_SAMPLES, _FEW = 600, 250
_HOLE_STEP_M, _HOLE_TURNS = 0.09, 16  # the search step for boards with holes is smaller than a hole
_LEAST_ON = 0.7  # minimum fraction of the rays within the best grid position that are on the plane
_RASTER_M = 0.01
_DEPTHS_AT_ONCE = 20_000  # number of rays that fit in the cache of one core
_SHARPNESS_M = 0.004  # increase of the mean residual at the border that lowers the likelihood by a factor e

Holes = Sequence[tuple[float, float, float]]
"""Holes of a rectangle: middle and radius of each in m."""


class Rectangle(NamedTuple):
    """Centre `x_m`, `y_m` and rotation `turn_rad` of the first side; `wrong_m` sums distances on the wrong side."""

    x_m: float
    y_m: float
    turn_rad: float
    wrong_m: float

    @classmethod
    def at(cls, place: Float, wrong_m: float) -> Rectangle:
        """Return the rectangle at a place (3,)."""
        x_m, y_m, turn_rad = place.tolist()
        return cls(x_m, y_m, turn_rad, wrong_m)


def in_frame(xy: Float, place: Float) -> tuple[Float, Float]:
    """Return both coordinates (..., N) of points (N, 2) in frames at places (..., 3): x, y and rotation."""
    x, y, turn = np.moveaxis(np.asarray(place, np.float64), -1, 0)
    cosine, sine = np.cos(turn)[..., None], np.sin(turn)[..., None]
    across, down = xy[:, 0] - x[..., None], xy[:, 1] - y[..., None]
    return cosine * across + sine * down, cosine * down - sine * across


def inside_m(xy: Float, place: Float, size_m: tuple[float, float], holes: Holes = ()) -> Float:
    """Return the depth of points (N, 2) in rectangles (..., 3) outside their holes, negative outside: (..., N) m."""
    own_x, own_y = in_frame(xy, place)
    deep = np.minimum(size_m[0] / 2 - np.abs(own_x), size_m[1] / 2 - np.abs(own_y))
    for u, v, radius in holes:
        np.minimum(deep, np.sqrt((own_x - u) ** 2 + (own_y - v) ** 2) - radius, out=deep)
    return np.asarray(deep)


def wrong_m(xy: Float, on: Bool, place: Float, size_m: tuple[float, float], holes: Holes = ()) -> Float:
    """Return the summed distances of rays on the wrong side of rectangles (..., 3): (...)."""
    place = np.asarray(place, np.float64)
    at_once = max(1, _DEPTHS_AT_ONCE // max(1, len(xy)))
    if place.ndim > 1 and len(place) > at_once:
        parts = (place[first : first + at_once] for first in range(0, len(place), at_once))
        return np.concatenate([wrong_m(xy, on, part, size_m, holes) for part in parts])
    deep = inside_m(xy, place, size_m, holes)
    return np.asarray(np.clip(np.where(on, -deep, deep), 0.0, _CAP_M).sum(axis=-1))


def fitted(
    xy: Float, on: Bool, size_m: tuple[float, float], reach_m: float, rng: np.random.Generator, holes: Holes = ()
) -> Rectangle:
    """Return the rectangle of a size that has the rays `on` the plane inside and the others outside.

    `xy` (N, 2) are the intersections of rays with the plane, `reach_m` their spacing there, which is the search range
    around the centre of those on the board. All rectangles that fit about equally well are averaged, since rays leave
    gaps; with `holes`, rays pass through those.
    """
    # Rays that are on the correct side for every outline near this position are not informative.
    nearby = np.linalg.norm(xy - xy[on].mean(axis=0), axis=1) < 0.5 * np.hypot(*size_m) + 2 * reach_m
    xy, on = xy[nearby], on[nearby]
    middle = (xy[on].max(axis=0) + xy[on].min(axis=0)) / 2
    reach_m = max(reach_m, 0.03)
    moves = _MOVES if not holes else max(_MOVES, 2 * int(np.ceil(reach_m / _HOLE_STEP_M)) + 1)
    offsets = np.linspace(-reach_m, reach_m, moves)
    turns = np.linspace(0, np.pi, _TURNS if not holes else _HOLE_TURNS, endpoint=False)
    x, y, turn = (each.ravel() for each in np.meshgrid(offsets, offsets, turns, indexing="ij"))
    grid = np.stack([middle[0] + x, middle[1] + y, turn], axis=1)
    if holes:
        some = slice(None, None, max(1, len(xy) // _FEW))  # enough to see where to begin
        costs = _on_raster(xy[some], on[some], middle, offsets, turns, size_m, holes)
        at = grid[np.argmin(costs)]
        deep = inside_m(xy, at, size_m, holes)
        if on[deep > 0.03].mean() < _LEAST_ON or (on & (deep > 0)).sum() < _LEAST_ON * 0.5 * on.sum():
            return Rectangle.at(at, float(wrong_m(xy, on, at, size_m, holes)))
        # Rays far from the border add no information.
        near_border = np.abs(deep) < 0.1
        xy, on = xy[near_border], on[near_border]
    else:
        costs = wrong_m(xy, on, grid, size_m)
    steps = [reach_m / 3, reach_m / 3, 0.05]
    ends = [
        minimised(lambda place: wrong_m(xy, on, place, size_m, holes), grid[at], steps, maxiter=200)
        for at in np.argsort(costs, kind="stable")[: 4 if holes else 2]
    ]
    best = min(ends, key=lambda end: float(end.fun))
    sizes = np.array([reach_m, reach_m, 2 * reach_m / max(size_m)])
    place, _ = averaged(lambda places: wrong_m(xy, on, places, size_m, holes), np.asarray(best.x), sizes, rng)
    return Rectangle.at(place, float(wrong_m(xy, on, place, size_m, holes)))


def _on_raster(
    xy: Float, on: Bool, middle: Float, offsets: Float, turns: Float, size_m: tuple[float, float], holes: Holes
) -> Float:
    """Return what `wrong_m` does at a grid of offsets and turns, but from a raster of the rectangle."""
    reach = 0.5 * float(np.hypot(*size_m)) + _CAP_M
    count = 2 * int(np.ceil(reach / _RASTER_M)) + 1
    at = (np.arange(count) - count // 2) * _RASTER_M
    cells = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)
    deep = inside_m(cells, np.zeros(3), size_m, holes).astype(np.float32)
    cost = {side: np.clip(deep if side < 0 else -deep, 0, _CAP_M).astype(np.float32) for side in (1, -1)}
    shifts = np.stack([each.ravel() for each in np.meshgrid(offsets, offsets, indexing="ij")], axis=1)
    out = np.zeros((len(shifts), len(turns)), np.float32)
    for column, turn in enumerate(turns):
        own = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        moved = (shifts @ own / _RASTER_M).astype(np.float32)
        for side, mine in ((1, on), (-1, ~on)):
            seen = ((xy[mine] - middle) @ own / _RASTER_M + count // 2 + 0.5).astype(np.float32)
            u = np.clip((seen[None, :, 0] - moved[:, :1]).astype(np.int32), 0, count - 1)
            v = np.clip((seen[None, :, 1] - moved[:, 1:]).astype(np.int32), 0, count - 1)
            out[:, column] += cost[side][u * np.int32(count) + v].sum(axis=1)
    return np.asarray(out.ravel())


def averaged(
    wrong: Callable[[Float], Float], best: Float, sizes: Float, rng: np.random.Generator
) -> tuple[Float, Float]:
    """Return mean and covariance of all poses (3,) within `sizes` that fit about as well as the best, by `wrong` m."""
    place, covariance = best, np.diag(sizes**2)
    for _ in range(3):
        samples = place + rng.uniform(-1, 1, (_SAMPLES, 3)) * sizes
        samples[0] = best
        cost = wrong(samples)
        weight = np.exp(-(cost - cost.min()) / (2 * _SHARPNESS_M))
        weight /= weight.sum()
        place = weight @ samples
        off = samples - place
        covariance = (weight[:, None] * off).T @ off
        sizes = np.clip(2.5 * np.sqrt(np.diag(covariance)), [1e-3, 1e-3, 1e-3], sizes)
    return place, covariance


def minimised(cost: Callable[[Float], Float], place: Float, steps: Sequence[float], **options: float) -> Any:
    """Return SciPy's minimum of a cost near a place (3,): Nelder and Mead, with initial `steps` (3,)."""
    from scipy.optimize import minimize

    simplex = np.vstack([place, place + np.diag(steps)])
    settings: Any = {"xatol": 1e-4, "fatol": 1e-5, "initial_simplex": simplex, **options}
    search: Any = minimize
    return search(lambda at: float(cost(at)), place, method="Nelder-Mead", options=settings)
