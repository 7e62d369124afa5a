"""Fit spheres of known radius to the points of a sweep, and check them by the rays that hit or miss them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Bool, Float, Int

from p2o_baselines.boards.board_in_sweep import Rays, rays_of, standing

_LEAST_POINTS, _LEAST_RINGS = 10, 3
_TRIPLES = 300
_LEAST_HIT, _MOST_BESIDE = 0.8, 0.4
"""Least share of rays well inside the outline that end on the sphere, and largest share of those beside it near it."""
_STEEPEST, _LEAST_FACING = 0.2, 0.3
"""Cosine to the surface that grazing rays are assumed to have, and below which a return is not used."""
_ANGLE_RAD = 0.001  # standard deviation of a beam's direction, with the effect of its footprint on a curved surface
_FLOOR_M = 0.004


@dataclass(frozen=True)
class SphereInSweep:
    """A sphere in a sweep: its points `xyz` (N, 3) m in the LiDAR frame, its `centre` (3,) and covariance (3, 3).

    `sigma_m` is the scatter of ranges, `free_radius_m` the radius fitted to the points, with its deviation.
    """

    radius_m: float
    xyz: Float
    centre: Float
    covariance: Float
    sigma_m: float
    free_radius_m: float
    radius_sigma_m: float


def off_sphere(xyz: Float, centre: Float, radius_m: float) -> tuple[Float, Float, Float]:
    """Return how much (N,) m ranges are too long for a sphere, the change (N, 3) with its centre, and cosines."""
    far = np.linalg.norm(xyz, axis=1)
    direction = xyz / np.maximum(far, 1e-9)[:, None]
    along = direction @ centre
    half = np.sqrt(np.maximum(radius_m**2 - (centre @ centre - along**2), (_STEEPEST * radius_m) ** 2))
    by_centre = ((along - half)[:, None] * direction - centre) / half[:, None]
    return far - along + half, by_centre, half / radius_m


def range_sigma(xyz: Float, facing: Float, sigma_m: float) -> Float:
    """Return standard deviations (N,) m of ranges: their noise, and that of beam angles at oblique incidence."""
    slant = np.sqrt(np.clip(1 - facing**2, 0, 1)) / facing
    return np.asarray(np.hypot(sigma_m, _ANGLE_RAD * np.linalg.norm(xyz, axis=1) * slant))


def fitted_sphere(xyz: Float, centre: Float, radius_m: float, sigma_m: float, free: bool = False) -> Float:
    """Return the centre (3,) of the nearest sphere to points (N, 3) by Gauss-Newton on ranges; with `free`, (4,)."""
    place = np.r_[centre, radius_m] if free else np.array(centre, np.float64)
    for _ in range(60):
        radius = float(place[3]) if free else radius_m
        off, rows, facing = off_sphere(xyz, place[:3], radius)
        sigma = range_sigma(xyz, facing, sigma_m)
        rows = np.column_stack([rows, 1 / facing]) if free else rows
        step = np.linalg.lstsq(rows / sigma[:, None], -off / sigma, rcond=None)[0]
        step *= min(1.0, 0.3 * radius_m / max(float(np.linalg.norm(step)), 1e-12))
        place = place + step
        if np.abs(step).max() < 1e-10:
            break
    return place


def covariance_of_fit(xyz: Float, centre: Float, radius_m: float, sigma_m: float, free: bool = False) -> Float:
    """Return the covariance (3, 3) of a centre, or with `free` (4, 4) of centre and radius, by the noise of ranges."""
    _, rows, facing = off_sphere(xyz, centre, radius_m)
    rows = np.column_stack([rows, 1 / facing]) if free else rows
    rows = rows / range_sigma(xyz, facing, sigma_m)[:, None]
    return np.asarray(np.linalg.pinv(rows.T @ rows))


def spheres_in_sweep(
    cloud: p2o.Cloud, radii_m: Sequence[float], *, farthest_m: float, sigma_m: float
) -> tuple[SphereInSweep, ...]:
    """Return what may be balls of some radii; `sigma_m` is how much ranges may scatter at most."""
    rays = rays_of(cloud, farthest_m)
    detected: list[SphereInSweep] = []
    for radius in dict.fromkeys(radii_m):
        used = np.zeros(len(rays.xyz), np.bool_)
        for about in standing(rays, farthest_m, 2.2 * radius, used):
            ball = _ball(rays, about, radius, sigma_m)
            if ball is not None:
                detected.append(ball)
                used |= np.linalg.norm(rays.xyz - ball.centre, axis=1) < 1.3 * radius
    return tuple(detected)


def _ball(rays: Rays, about: Int, radius: float, sigma_m: float) -> SphereInSweep | None:
    """Return the sphere that contains most of some points; None if rays contradict it."""
    xyz = rays.xyz[about]
    centres = _through(xyz, radius, np.random.default_rng(len(xyz)))
    if not len(centres):
        return None
    off = np.abs(np.linalg.norm(xyz[None] - centres[:, None], axis=2) - radius)
    most = int(np.argmax((off < 2 * sigma_m).sum(axis=1)))
    centre, sigma = centres[most], sigma_m
    for _ in range(5):
        away, _, facing = off_sphere(xyz, centre, radius)
        spread = range_sigma(xyz, facing, sigma)
        # Chosen by rays, which noise does not move, not by where the returns are.
        on = (np.abs(away) < np.maximum(3 * spread, 2 * _FLOOR_M)) & (facing > _LEAST_FACING)
        if on.sum() < _LEAST_POINTS or len(np.unique(rays.ring[about[on]])) < _LEAST_RINGS:
            return None
        centre = fitted_sphere(xyz[on], centre, radius, sigma)
        away, _, facing = off_sphere(xyz[on], centre, radius)
        freedom = max(int(on.sum()) - 3, 1)
        total = float(np.sum((away / range_sigma(xyz[on], facing, sigma)) ** 2))
        sigma = float(np.clip(sigma * np.sqrt(total / freedom), _FLOOR_M, sigma_m))
    if np.median(np.abs(away)) > sigma_m or not _stands(rays, centre, radius, max(4 * sigma, 0.03)):
        return None
    points = xyz[on]
    free = fitted_sphere(points, centre, radius, sigma, free=True)
    free_covariance = covariance_of_fit(points, free[:3], float(free[3]), sigma, free=True)
    covariance = covariance_of_fit(points, centre, radius, sigma)
    radius_sigma = float(np.sqrt(free_covariance[3, 3]))
    return SphereInSweep(radius, points, centre, covariance, sigma, float(free[3]), radius_sigma)


def _through(xyz: Float, radius: float, rng: np.random.Generator) -> Float:
    """Return centres (K, 3) of spheres through triples of points, on the far side from the sensor."""
    three = xyz[rng.integers(0, len(xyz), (_TRIPLES, 3))]
    a, b = three[:, 1] - three[:, 0], three[:, 2] - three[:, 0]
    normal = np.cross(a, b)
    twice = np.einsum("ni,ni->n", normal, normal)
    good = twice > (0.05 * radius**2) ** 2
    a, b, normal, twice, origin = a[good], b[good], normal[good], twice[good], three[good, 0]
    squares = np.einsum("ni,ni->n", a, a)[:, None], np.einsum("ni,ni->n", b, b)[:, None]
    foot = np.cross(squares[0] * b - squares[1] * a, normal) / (2 * twice[:, None])
    high = radius**2 - np.einsum("ni,ni->n", foot, foot)
    near = high > 0
    unit = normal[near] / np.sqrt(twice[near])[:, None]
    middle = origin[near] + foot[near]
    sign = np.sign(np.einsum("ni,ni->n", unit, middle))
    return np.asarray(middle + (sign * np.sqrt(high[near]))[:, None] * unit)


def _stands(rays: Rays, centre: Float, radius: float, within_m: float) -> bool:
    """Return whether rays well inside a sphere's outline end on it, and those beside it pass."""
    start = rays.start
    direction = rays.xyz - start
    distance = np.linalg.norm(direction, axis=1)
    direction = direction / np.maximum(distance, 1e-9)[:, None]
    to = centre - start
    along = np.einsum("ni,ni->n", direction, to)
    miss = np.sqrt(np.maximum(np.einsum("ni,ni->n", to, to) - along**2, 0)) / radius
    ahead = along > 0
    inside: Bool = ahead & (miss < 0.85)
    expected = along - radius * np.sqrt(np.maximum(1 - miss**2, 0))
    hits = np.abs(distance - expected) < within_m + 0.3 * radius * miss**4
    hidden = distance < expected - within_m - 0.05
    judged = inside & ~hidden
    beside = ahead & (miss > 1.15) & (miss < 1.7)
    near = np.abs(distance - along) < 1.5 * radius
    if judged.sum() < _LEAST_POINTS or (hidden.sum() > 0 and (inside & hidden).sum() > 0.4 * inside.sum()):
        return False
    return bool(hits[judged].mean() >= _LEAST_HIT and (not beside.any() or near[beside].mean() <= _MOST_BESIDE))
