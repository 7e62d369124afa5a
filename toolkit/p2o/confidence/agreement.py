"""Measure whether the edges of both sensors match more often than expected under random alignment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from p2o.arrays import Bool, Float, Int, Int8
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.problems.directed_cost import distance_maps
from p2o.problems.point_to_line import OUTLINE_CELL_PX
from p2o.results.evidence import Agreement, odds_ratio

NEAR_PX = 3.0
SURE = 0.5
"""Minimum confidence of image edges; weak ones are so dense that they match any edge under random alignment."""


def agreement(views: Sequence[View], camera_from_lidar: Float) -> Agreement:
    """Compute the agreement of all views at a pose (4, 4).

    A wrong pair of image and sweep can be fitted to an odds ratio of 1 to 5; correct pairs at a correct pose have more
    (docs/benchmarks.md). The agreement tests whether the edges correspond, not how accurate the pose is. Places that
    several views of a static rig contain count once.
    """
    near, chance, points, places = 0.0, 0.0, 0, 0
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
            counts = np.array([meets[v, u].sum(), meets[low : high + 1].mean() * len(v), len(v)])
            near, chance, points = near + float(counts[0]), chance + float(counts[1]), points + len(v)
            if number in by_side:
                by_side[number] += counts
            its = np.flatnonzero(side == number)[meets[v, u]]
            places += len(np.unique(np.floor(uv[its] / OUTLINE_CELL_PX), axis=0))
            met_at.append((xyz[its], side[its], np.full(len(its), number_of_view)))
    if not points:
        return Agreement(0.0, 0.0, 0)
    # A static rig matches the same edges again: only the share of distinct views counts.
    xyz, side, frame = map(np.concatenate, zip(*met_at, strict=True))
    distinct = view_count(xyz, side, frame) / max(1, len(np.unique(frame)))
    return Agreement(near / points, chance / points, points, round(places * distinct), *_least(by_side))


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
    side = min(judged, key=lambda its: judged[its])
    return judged[side], side.letter


_DRAWS = 16
"""Random positions of every interval, at which the agreement under random alignment is counted."""


def interval_agreement(views: Sequence[View], camera_from_lidar: Float) -> Agreement:
    """Compute the agreement of edges as intervals at a pose (4, 4): an edge agrees if its interval has an image edge.

    Intervals are wider by `NEAR_PX` on both sides. Under random alignment they are elsewhere in the rows of the image
    that have LiDAR edges of their side. Everything else is as in `agreement`.
    """
    rng, points, near, chance, places = np.random.default_rng(0), 0, 0.0, 0.0, 0
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
            chance += float(np.mean([_meets(count, uv, half, along) for uv in drawn])) * len(rows)
            near, points = near + float(meets.sum()), points + len(rows)
            places += len(np.unique(np.floor(middle[meets] / OUTLINE_CELL_PX), axis=0))
            met_at.append((edges.xyz[rows[meets]], edges.side[rows[meets]], np.full(int(meets.sum()), number)))
    if not points:
        return Agreement(0.0, 0.0, 0)
    xyz, side_of, frame = map(np.concatenate, zip(*met_at, strict=True))
    distinct = view_count(xyz, side_of, frame) / max(1, len(np.unique(frame)))
    return Agreement(near / points, chance / points, points, round(places * distinct))


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


_SAME_BEARING, _SAME_RANGE = 0.02, 0.04
"""Differences in bearing (about 1 deg) and range (4 %) up to which edges of one direction are of one outline."""
_LEAST_M = 0.1
_FEW = 0.5
"""Share of distinct views among the frames below which the user is warned."""
_MOST_LOOKED_UP = 2_000_000
"""Maximum number of nearest-neighbour queries; if there are more edges, a random subset is evaluated."""


def view_count(xyz: Float, side: Int8, frame: Int) -> float:
    """Count the distinct views of the frames of edges: all frames, or down to 1 for a static rig.

    `xyz` (K, 3) are edges in m in the LiDAR frame, `side` (K,) their directions, `frame` (K,) their frames. The count
    is the number of frames times the mean over edges of 1 / (number of frames that contain it), on a subset for large
    K.
    """
    frames = np.unique(frame)
    if len(frames) < 2:
        return float(len(frames))
    range_m = np.maximum(np.linalg.norm(xyz, axis=1), _LEAST_M)
    bearing = xyz / range_m[:, None] / _SAME_BEARING
    # The distance between sides exceeds the search radius of 1.
    place = np.column_stack([bearing, np.log(range_m) / _SAME_RANGE, 10.0 * side])
    most = max(1, _MOST_LOOKED_UP // len(frames))
    some = slice(None) if len(place) <= most else np.random.default_rng(0).permutation(len(place))[:most]
    asked, own = place[some], frame[some]
    seen_in = np.ones(len(asked))
    for number in frames:
        others = own != number
        tree = KDTree(place[frame == number])
        seen_in[others] += np.isfinite(tree.query(asked[others], distance_upper_bound=1.0)[0])
    return float(len(frames) * np.mean(1.0 / seen_in))


def standing_still(views: float, frames: int) -> tuple[str, ...]:
    """Return a warning if `frames` frames contain few distinct views, else an empty tuple."""
    if frames < 2 or views >= _FEW * frames:
        return ()
    text = f"{frames} frames show about {views:.1f} different views, and count as that number: the rig was static"
    return (f"{text}; frames of other places make the result surer, more of these do not",)
