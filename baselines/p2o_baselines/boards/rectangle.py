"""A rectangle of known size in a plane, from which rays meet the plane inside of it and which outside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from p2o.arrays import Bool, Float

_TURNS, _MOVES = 24, 5
_CAP_M = 0.15  # a ray that is on the wrong side by more counts as that: a hand, a stand
_SAMPLES = 600
_DEPTHS_AT_ONCE = 20_000  # so many stay in the cache of one core
_SHARPNESS_M = 0.004
"""Rectangles whose rays are on the wrong side by so much more, on average of the border's rays, are e times less
likely: it is what the noise of angles and the size of a spot leave open."""


class Rectangle(NamedTuple):
    """Middle `x_m`, `y_m` and `turn_rad` of the first side in the plane, their `covariance` (3, 3), and the misfit.

    `wrong_m` is by how much rays lie on the wrong side of the border, summed.
    """

    x_m: float
    y_m: float
    turn_rad: float
    covariance: Float
    wrong_m: float


def inside_m(xy: Float, place: Float, size_m: tuple[float, float]) -> Float:
    """Return how deep points (N, 2) lie inside of rectangles (..., 3), negative outside: (..., N) in metres."""
    x, y, turn = np.moveaxis(np.asarray(place, np.float64), -1, 0)
    cosine, sine = np.cos(turn)[..., None], np.sin(turn)[..., None]
    across, down = xy[:, 0] - x[..., None], xy[:, 1] - y[..., None]
    own_x, own_y = cosine * across + sine * down, cosine * down - sine * across
    deep = np.minimum(size_m[0] / 2 - np.abs(own_x), size_m[1] / 2 - np.abs(own_y))
    return np.asarray(deep)


def wrong_m(xy: Float, on: Bool, place: Float, size_m: tuple[float, float]) -> Float:
    """Return by how much rays lie on the wrong side of rectangles (..., 3), summed over rays: (...)."""
    place = np.asarray(place, np.float64)
    at_once = max(1, _DEPTHS_AT_ONCE // max(1, len(xy)))
    if place.ndim > 1 and len(place) > at_once:
        parts = [wrong_m(xy, on, place[first : first + at_once], size_m) for first in range(0, len(place), at_once)]
        return np.concatenate(parts)
    deep = inside_m(xy, place, size_m)
    return np.asarray(np.clip(np.where(on, -deep, deep), 0.0, _CAP_M).sum(axis=-1))


def fitted(xy: Float, on: Bool, size_m: tuple[float, float], reach_m: float, rng: np.random.Generator) -> Rectangle:
    """Return the rectangle of a size that has the rays `on` the plane inside and the others outside.

    `xy` (N, 2) is where rays meet the plane, `reach_m` how far apart rays are there: the search goes as far beyond the
    middle of those on the board. All rectangles that fit about as well are averaged, since rays leave gaps; their
    spread is the covariance.
    """
    from scipy.optimize import minimize

    # Rays that no outline near here has on the wrong side say nothing.
    told = np.linalg.norm(xy - xy[on].mean(axis=0), axis=1) < 0.5 * np.hypot(*size_m) + 2 * reach_m
    xy, on = xy[told], on[told]
    middle = (xy[on].max(axis=0) + xy[on].min(axis=0)) / 2
    reach_m = max(reach_m, 0.03)
    offsets = np.linspace(-reach_m, reach_m, _MOVES)
    turns = np.linspace(0, np.pi, _TURNS, endpoint=False)
    x, y, turn = (each.ravel() for each in np.meshgrid(offsets, offsets, turns, indexing="ij"))
    grid = np.stack([middle[0] + x, middle[1] + y, turn], axis=1)
    costs = wrong_m(xy, on, grid, size_m)
    ends = [
        minimize(
            lambda place: float(wrong_m(xy, on, place, size_m)),
            grid[at],
            method="Nelder-Mead",
            options={"xatol": 1e-4, "fatol": 1e-5, "maxiter": 200, "initial_simplex": _simplex(grid[at], reach_m)},
        )
        for at in np.argsort(costs, kind="stable")[:2]
    ]
    best = min(ends, key=lambda end: float(end.fun))
    # Rays leave gaps of a ring's distance, within which every rectangle is as good: their middle is taken.
    place, sizes = np.asarray(best.x), np.array([reach_m, reach_m, 2 * reach_m / max(size_m)])
    covariance = np.diag(sizes**2)
    for _ in range(3):
        samples = place + rng.uniform(-1, 1, (_SAMPLES, 3)) * sizes
        samples[0] = best.x
        cost = wrong_m(xy, on, samples, size_m)
        weight = np.exp(-(cost - cost.min()) / (2 * _SHARPNESS_M))
        weight /= weight.sum()
        place = weight @ samples
        off = samples - place
        covariance = (weight[:, None] * off).T @ off
        sizes = np.clip(2.5 * np.sqrt(np.diag(covariance)), [1e-3, 1e-3, 1e-3], sizes)
    return Rectangle(*place.tolist(), covariance, float(wrong_m(xy, on, place, size_m)))


def _simplex(place: Float, reach_m: float) -> Float:
    return np.asarray(place + np.vstack([np.zeros(3), np.diag([reach_m / 3, reach_m / 3, 0.05])]))
