"""What stands by itself in a sweep: short runs of returns before what lies behind them, and those near each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from p2o.arrays import Bool, Float, Int

from p2o_baselines.boards.board_in_sweep import Rays

_BEFORE_M = 0.12  # a run ends where its neighbour in the ring is farther by so much, or where nothing comes back
_LEAST_RUN_M, _LEAST_RINGS = 0.06, 3
_MOST_SEEDS = 400


def standing(rays: Rays, farthest_m: float, longest_m: float, used: Bool) -> Iterator[Int]:
    """Give the points (N,) of runs no longer than `longest_m` within that of the middle of each, longest runs first.

    What the caller marks in `used` (N,) on the way is left out from then on.
    """
    xyz, run = rays.xyz, rays.run
    if not len(xyz):
        return
    distance = np.linalg.norm(xyz, axis=1)
    first = np.flatnonzero(np.r_[True, np.diff(run) != 0])
    last = np.r_[first[1:], len(run)] - 1
    length = np.linalg.norm(xyz[last] - xyz[first], axis=1)
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(run) - 1)
    behind = np.ones(len(first), np.bool_)
    for end, neighbour in ((first, before), (last, after)):
        gap = np.abs(rays.azimuth[neighbour] - rays.azimuth[end]) > 3.5 * rays.step_rad
        behind &= gap | (rays.ring[neighbour] != rays.ring[end]) | (distance[neighbour] > distance[end] + _BEFORE_M)
    kept = behind & (length < longest_m) & (length > _LEAST_RUN_M) & (last - first >= 2)
    kept &= np.minimum(distance[first], distance[last]) < farthest_m
    first, last, length = first[kept], last[kept], length[kept]
    if not len(first):
        return
    points = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    middle = np.array([xyz[a : b + 1].mean(axis=0) for a, b in zip(first, last, strict=True)])
    tried: list[Float] = []
    seeds = 0
    for at in np.argsort(-length, kind="stable"):
        here = middle[at]
        if used[first[at] : last[at] + 1].mean() > 0.5 or any(
            np.linalg.norm(here - m) < 0.15 * longest_m for m in tried
        ):
            continue
        about = points[np.linalg.norm(xyz[points] - here, axis=1) < longest_m]
        about = about[~used[about]]
        if len(np.unique(rays.ring[about])) < _LEAST_RINGS:
            continue
        tried.append(here)
        yield about
        seeds += 1
        if seeds >= _MOST_SEEDS:
            return
