"""Whether the edges of both sensors meet more often than by chance: a first answer to "is my result good?"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from p2o.arrays import Float, Int, Int8
from p2o.calibration.different_views import view_count
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.problems.directed_cost import distance_maps
from p2o.results.evidence import Agreement

NEAR_PX = 3.0
SURE = 0.5
"""Image edges of at least this confidence are asked; weak ones are everywhere, and meet any edge by chance."""
CELL_PX = 64.0
"""Edges of one direction within such a cell of the picture are one outline, and meet together or not at all."""


def agreement(views: Sequence[View], camera_from_lidar: Float) -> Agreement:
    """Return the agreement of all views at a pose (4, 4).

    A wrong pair of image and sweep can be fitted to an odds ratio of 1 to 5; right pairs at a right pose have more
    (docs/benchmarks.md). It is a test of whether the edges belong together, not of how accurate the pose is. Places
    that several views show, since the rig stood still, count once.
    """
    near, chance, points, places = 0.0, 0.0, 0, 0
    met_at: list[tuple[Float, Int8, Int]] = []
    for number_of_view, view in enumerate(map(_surest, views)):
        uv = view.camera.project(se3.apply(camera_from_lidar, view.cloud_edges.xyz))
        inside = view.camera.in_image(uv)
        uv, xyz, side = uv[inside], view.cloud_edges.xyz[inside], view.cloud_edges.side[inside]
        pixel = np.clip(np.rint(uv).astype(np.int64), 0, [view.camera.width - 1, view.camera.height - 1])
        sides = [Side(int(s)) for s in np.unique(side)]
        for number, meets in zip(sides, distance_maps(view, sides, NEAR_PX + 1, 1) <= NEAR_PX, strict=True):
            u, v = pixel[side == number].T
            low, high = np.percentile(v, [2, 98]).astype(np.int64)
            near += float(meets[v, u].sum())
            chance += float(meets[low : high + 1].mean()) * len(v)
            points += len(v)
            its = np.flatnonzero(side == number)[meets[v, u]]
            places += len(np.unique(np.floor(uv[its] / CELL_PX), axis=0))
            met_at.append((xyz[its], side[its], np.full(len(its), number_of_view)))
    if not points:
        return Agreement(0.0, 0.0, 0)
    return Agreement(near / points, chance / points, points, round(places * _share_of_different(met_at)))


def _share_of_different(met: Sequence[tuple[Float, Int8, Int]]) -> float:
    """Return the share of the views that are of their own: a rig that stands still meets the same edges again."""
    xyz, side, frame = map(np.concatenate, zip(*met, strict=True))
    return view_count(xyz, side, frame) / max(1, len(np.unique(frame)))


def _surest(view: View) -> View:
    """Return the view with its sure image edges alone, or with all where none is sure."""
    edges = view.image_edges
    sure = edges.weight >= SURE
    if sure.all() or not sure.any():
        return view
    return replace(view, image=view.image.having(edges.select(sure)))
