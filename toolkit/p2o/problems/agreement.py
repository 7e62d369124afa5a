"""Measure whether the edges of both sensors match more often than expected under random alignment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from p2o.arrays import Bool, Float, Int, Int8
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.problems.directed_cost import distance_maps
from p2o.problems.distinct_views import view_count
from p2o.problems.point_to_line import OUTLINE_CELL_PX
from p2o.results.evidence import Agreement, odds_ratio

NEAR_PX = 3.0
SURE = 0.5
"""Minimum confidence of image edges; weak ones are so dense that they match any edge under random alignment."""


def agreement_of(views: Sequence[View], camera_from_lidar: Float, *, intervals: bool = False) -> Agreement | None:
    """Return the agreement of both sensors' edges at a pose (4, 4), on demand as intervals; None without edges."""
    if not any(view.count("image-edges") and view.count("cloud-edges") for view in views):
        return None
    return interval_agreement(views, camera_from_lidar) if intervals else agreement(views, camera_from_lidar)


def agreement(views: Sequence[View], camera_from_lidar: Float) -> Agreement:
    """Compute the agreement of all views at a pose (4, 4).

    A wrong pair of image and sweep can be fitted to an odds ratio of 1 to 5; correct pairs at a correct pose have more
    (docs/benchmarks.md). The agreement tests whether the edges correspond, not how accurate the pose is. Views count
    with their weights, and places that several views of a static rig contain count once.
    """
    near, chance, total, points, places = 0.0, 0.0, 0.0, 0, 0
    by_side = {side: np.zeros(3) for side in SIDES}
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
            counts = view.weight * np.array([meets[v, u].sum(), meets[low : high + 1].mean() * len(v), len(v)])
            near, chance, total = np.array([near, chance, total]) + counts
            points += len(v)
            if number in by_side:
                by_side[number] += counts
            rows = np.flatnonzero(side == number)[meets[v, u]]
            places += len(np.unique(np.floor(uv[rows] / OUTLINE_CELL_PX), axis=0))
            met_at.append((xyz[rows], side[rows], np.full(len(rows), number_of_view)))
    if not points:
        return Agreement(0.0, 0.0, 0)
    # A static rig matches the same edges again: only the share of distinct views counts.
    xyz, side, frame = map(np.concatenate, zip(*met_at, strict=True))
    distinct = view_count(xyz, side, frame) / max(1, len(np.unique(frame)))
    return Agreement(float(near / total), float(chance / total), points, round(places * distinct), *_least(by_side))


_LEAST_EDGES, _LEAST_CHANCE = 50, 5.0
"""Smallest number of LiDAR edges of a direction, and of those that agree under random alignment, to judge it alone."""


def _least(by_side: Mapping[Side, Float]) -> tuple[float | None, str]:
    """Return the smallest odds ratio of a direction and its letter; None where no direction has enough edges.

    `by_side` are, for each direction, the LiDAR edges that agree, those that agree under random alignment, and all.
    """
    judged = {
        side: odds_ratio(near / points, chance / points)
        for side, (near, chance, points) in by_side.items()
        if points >= _LEAST_EDGES and chance >= _LEAST_CHANCE
    }
    if not judged:
        return None, ""
    side = min(judged, key=lambda number: judged[number])
    return judged[side], side.letter


_DRAWS = 16
"""Random positions of every interval, at which the agreement under random alignment is counted."""


def interval_agreement(views: Sequence[View], camera_from_lidar: Float) -> Agreement:
    """Compute the agreement of edges as intervals at a pose (4, 4): an edge agrees if its interval has an image edge.

    Intervals are wider by `NEAR_PX` on both sides. Under random alignment they are elsewhere in the rows of the image
    that have LiDAR edges of their side. Everything else is as in `agreement`.
    """
    rng, near, chance, total, points, places = np.random.default_rng(0), 0.0, 0.0, 0.0, 0, 0
    met_at: list[tuple[Float, Int8, Int]] = []
    for number, view in enumerate(map(_surest, views)):
        edges, size = view.cloud_edges, np.array([view.camera.width, view.camera.height])
        ends = np.stack([view.camera.project(se3.apply(camera_from_lidar, xyz)) for xyz in edges.ends], axis=1)
        inside = view.camera.in_image(ends.mean(axis=1))
        for side in (side for side in SIDES if (edges.side[inside] == side).any()):
            rows = np.flatnonzero(inside & (edges.side == side))
            along = 0 if side in (Side.LEFT, Side.RIGHT) else 1
            middle = ends[rows].mean(axis=1)
            half = 0.5 * np.abs(ends[rows, 1, along] - ends[rows, 0, along]) + NEAR_PX
            count = _counts(view, side, along)
            meets = _meets(count, middle, half, along)
            low, high = np.percentile(middle[:, 1], [2, 98])
            drawn = rng.uniform((0.0, low), (size[0] - 1.0, high), (_DRAWS, len(rows), 2))
            by_chance = float(np.mean([_meets(count, uv, half, along) for uv in drawn])) * len(rows)
            near, chance = near + view.weight * float(meets.sum()), chance + view.weight * by_chance
            total, points = total + view.weight * len(rows), points + len(rows)
            places += len(np.unique(np.floor(middle[meets] / OUTLINE_CELL_PX), axis=0))
            met_at.append((edges.xyz[rows[meets]], edges.side[rows[meets]], np.full(int(meets.sum()), number)))
    if not points:
        return Agreement(0.0, 0.0, 0)
    xyz, side_of, frame = map(np.concatenate, zip(*met_at, strict=True))
    distinct = view_count(xyz, side_of, frame) / max(1, len(np.unique(frame)))
    return Agreement(near / total, chance / total, points, round(places * distinct))


def _counts(view: View, side: Side, along: int) -> Int:
    """Return the number of image edges of a side before each pixel along rows or columns: (W + 1, H) or (H + 1, W)."""
    marked = np.zeros((view.camera.height, view.camera.width), np.int64)
    uv = view.image_edges.uv[view.image_edges.index.get(side, np.zeros(0, np.int64))]
    column, row = np.clip(np.rint(uv).astype(np.int64), 0, [view.camera.width - 1, view.camera.height - 1]).T
    marked[row, column] = 1
    marked = marked if along == 1 else marked.T
    return np.concatenate([np.zeros((1, marked.shape[1]), np.int64), np.cumsum(marked, axis=0)])


def _meets(count: Int, middle: Float, half: Float, along: int) -> Bool:
    """Return whether intervals of half a length (N,) around pixels (N, 2) contain an edge."""
    across = np.clip(np.rint(middle[:, 1 - along]).astype(np.int64), 0, count.shape[1] - 1)
    first, last = (np.rint(middle[:, along] + sign * half).astype(np.int64) for sign in (-1, 1))
    first, last = np.clip(first, 0, len(count) - 1), np.clip(last + 1, 0, len(count) - 1)
    return np.asarray(count[last, across] > count[first, across])


def _surest(view: View) -> View:
    """Keep the image edges of a view that reach the confidence `SURE`; keep all if none does."""
    edges = view.image_edges
    sure = edges.weight >= SURE
    if sure.all() or not sure.any():
        return view
    return replace(view, image=view.image.having(edges.select(sure)))
