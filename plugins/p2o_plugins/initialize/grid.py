"""Initializer `grid`: a grid of rotations, then all six parameters in the best basins (the paper's MBS)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from p2o import Float, Initializer, Method, Options, View, field, se3
from p2o.solving import DirectedCost

from p2o_plugins.initialize.search import MAX_POINTS, MOST_VIEWS, NARROWEST_PX, coarse_maps, narrow

_GRID_PX = 40.0  # truncation of the distances on the grid
_GRID_POINTS = 1500  # LiDAR edge points used on the grid, evenly thinned over all frames
_BASINS = 5  # best separate cells of the grid that are narrowed
_SIGMA_DEG = 1.0  # standard deviation about each axis when a basin is narrowed


class GridOptions(Options):
    """Options of the grid."""

    max_angle_deg: float = field(12.0, gt=0, le=45, help="Half width of the grid about each axis.")
    step_deg: float = field(1.5, gt=0.05, le=10, help="Step of the grid about each axis (the paper: 1 deg).")
    seed: int = field(0, ge=0, help="Seed of the random generator.")


def build(options: GridOptions) -> Initializer:
    """Return an initializer that proposes the refined basins, best first."""

    def initialize(views: Sequence[View], camera_from_lidar: Float) -> list[Float]:
        rng = np.random.default_rng(options.seed)
        # Large rotations project points that are not visible at the initial guess: keep those within the largest
        # rotation.
        margin = max(view.camera.focal_px for view in views) * np.tan(np.radians(options.max_angle_deg))
        cost = partial(DirectedCost.of, views, camera_from_lidar, margin_px=float(margin), max_views=MOST_VIEWS)
        coarse = cost(_GRID_PX, scale=4, max_points=_GRID_POINTS)
        if not coarse.points:
            return [camera_from_lidar]
        starts = [se3.exp(t) @ camera_from_lidar for t in _basins(coarse, camera_from_lidar, options)]
        maps = [coarse_maps(views, start) for start in starts]  # together, so that they share distance maps
        narrowed = [narrow(each, start, _SIGMA_DEG, rng) for each, start in zip(maps, starts, strict=True)]
        judge = cost(NARROWEST_PX, max_points=MAX_POINTS)
        order = np.argsort(judge(np.stack(narrowed)), kind="stable")
        return [narrowed[i] for i in order]

    return initialize


def _basins(cost: DirectedCost, start: Float, options: GridOptions) -> list[Float]:
    """Return tangent vectors (6,) of the best grid cells, no two within two steps of each other."""
    axis = np.arange(-options.max_angle_deg, options.max_angle_deg + 1e-9, options.step_deg)
    turns = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    turns = turns[np.linalg.norm(turns, axis=1) <= options.max_angle_deg + options.step_deg]
    tangents = np.concatenate([np.radians(turns), np.zeros_like(turns)], axis=1)
    values = np.concatenate(
        [cost(se3.exp(part) @ start) for part in np.array_split(tangents, len(tangents) // 300 + 1)]
    )
    chosen: list[int] = []
    for i in np.argsort(values, kind="stable"):
        if all(np.linalg.norm(turns[i] - turns[j]) > 2 * options.step_deg for j in chosen):
            chosen.append(int(i))
        if len(chosen) == _BASINS:
            break
    return [tangents[i] for i in chosen]


METHOD = Method(
    name="grid",
    build=build,
    options=GridOptions,
    summary="Grid of rotations, then all six parameters in the best basins (wide starts; the paper's MBS).",
    needs={"image-edges", "cloud-edges"},
    cite="P2O-Calib, Sec. IV-C (MBS)",
)
