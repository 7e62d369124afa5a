"""Distinct views among the frames of a joint calibration: frames of one view count as one view, not as frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from p2o.arrays import Float, Int, Int8
from p2o.features.view import View
from p2o.geometry import se3

_SAME_BEARING, _SAME_RANGE = 0.02, 0.04
"""Differences in bearing (about 1 deg) and range (4 %) up to which edges of one direction are of one outline."""
_LEAST_M = 0.1
_MOST_LOOKED_UP, _LEAST_ASKED = 2_000_000, 8
"""Maximum number of nearest-neighbour queries, and the fewest edges of each frame that are looked up in all others."""
_SAME_EDGES, _SAME_POINTS = 0.5, 0.85
"""Share of the edges, or of the points, of a frame that another one contains from which both show one scene: points of
a flat road are the same in all frames.
"""
_MARGIN_PX = 30.0
"""Edges this far outside the image take part: the initial guess has an error."""


def distinct_views(
    xyz: Float, side: Int8, frame: Int, frames: int, *, same_scene: float = _SAME_EDGES
) -> tuple[Float, Int]:
    """Return how much each of `frames` frames shows that others do not (F,), and their scenes (F,).

    The edges are `xyz` (K, 3) in m in the LiDAR frame, `side` (K,), `frame` (K,). The weight of a frame is the mean
    over its edges of 1 / (number of frames that contain the edge): 1 for a frame of a place of its own, 1/N for N
    frames of a static rig. An edge is in another frame if that has an edge of the same direction within 1 deg and 4 %
    of the range. For many frames, a random subset of the edges of each frame is looked up. Frames that share
    `same_scene` of their edges show one scene; its number is that of the first of them.
    """
    rng, place = np.random.default_rng(0), _places(xyz, side)
    rows = [np.flatnonzero(frame == number) for number in range(frames)]
    most = max(_LEAST_ASKED, _MOST_LOOKED_UP // max(frames, 1) ** 2)
    asked = [its if len(its) <= most else rng.permutation(its)[:most] for its in rows]
    index = np.concatenate([np.zeros(0, np.int64), *asked])
    owner = np.repeat(np.arange(frames), [len(its) for its in asked])
    number_of = np.maximum(np.bincount(owner, minlength=frames), 1)
    seen_in, shares = np.ones(len(index)), np.eye(frames)
    for other, its in enumerate(rows):
        others = np.flatnonzero(owner != other)
        if len(its) and len(others):
            contained = np.isfinite(KDTree(place[its]).query(place[index[others]], distance_upper_bound=1.0)[0])
            seen_in[others] += contained
            of_others = np.bincount(owner[others], contained, frames) / number_of
            shares[:, other] = np.where(np.arange(frames) == other, 1.0, of_others)
    weights = np.bincount(owner, 1.0 / seen_in, frames) / number_of
    weights = np.where(np.bincount(owner, minlength=frames) > 0, weights, 1.0)
    return weights, _scenes(shares, same_scene)


def view_count(xyz: Float, side: Int8, frame: Int) -> float:
    """Count the distinct views of the frames of edges: all frames, or down to 1 for a static rig.

    `xyz` (K, 3) are edges in m in the LiDAR frame, `side` (K,) their directions, `frame` (K,) their frames. The count
    is the sum of the weights of `distinct_views`.
    """
    numbers, of = np.unique(frame, return_inverse=True)
    return float(distinct_views(xyz, side, of.reshape(-1), len(numbers))[0].sum())


def weighted(views: Sequence[View], camera_from_lidar: Float) -> list[View]:
    """Return the views with their weights and scenes, from what the cameras see at a pose (4, 4).

    Directed edges are compared; without edges, the positions of the other LiDAR features.
    """
    if len(views) < 2:
        return list(views)
    xyz, side, frame = [np.zeros((0, 3))], [np.zeros(0, np.int8)], [np.zeros(0, np.int64)]
    for number, view in enumerate(views):
        for places, sides in _features(view):
            visible = view.camera.in_image(view.camera.project(se3.apply(camera_from_lidar, places)), _MARGIN_PX)
            xyz.append(places[visible])
            side.append(sides[visible])
            frame.append(np.full(int(visible.sum()), number))
    same = _SAME_EDGES if any(len(view.cloud_edges) for view in views) else _SAME_POINTS
    columns = np.concatenate(xyz), np.concatenate(side), np.concatenate(frame)
    weights, scenes = distinct_views(*columns, len(views), same_scene=same)
    shares = zip(views, weights.tolist(), scenes.tolist(), strict=True)
    return [replace(view, weight=weight, scene=scene) for view, weight, scene in shares]


def _features(view: View) -> list[tuple[Float, Int8]]:
    """Return positions (K, 3) and directions (K,) of the edges of a view, or of its other LiDAR features."""
    edges = view.cloud_edges
    if len(edges):
        return [(edges.xyz, edges.side)]
    positions = (feature.places for feature in view.cloud)
    return [(xyz, np.zeros(len(xyz), np.int8)) for xyz in positions if xyz is not None]


def view_weights(views: Sequence[View]) -> Float:
    """Return the weights (F,) of views, with a mean of 1."""
    weights = np.array([view.weight for view in views])
    return weights / weights.mean() if len(weights) else weights


def scenes_of(views: Sequence[View]) -> Int:
    """Return the scenes (F,) of views; a view of unknown scene has one of its own."""
    return np.array([len(views) + at if view.scene is None else view.scene for at, view in enumerate(views)], np.int64)


def one_per_scene(views: Sequence[View]) -> Sequence[View]:
    """Return the first view of each scene: for costs that do not weight views."""
    _, first = np.unique(scenes_of(views), return_index=True)
    return views if len(first) == len(views) else [views[number] for number in np.sort(first)]


def evenly_chosen(weights: Float, most: int) -> Int:
    """Return the numbers of at most `most` views of given weights (F,), evenly spread over their cumulative weight."""
    if len(weights) <= most:
        return np.arange(len(weights))
    total = np.cumsum(weights)
    return np.unique(np.searchsorted(total, np.arange(most) * total[-1] / most, side="right"))


def _places(xyz: Float, side: Int8) -> Float:
    """Return coordinates (K, 5) in which edges of one outline are less than 1 apart; directions are farther apart."""
    range_m = np.maximum(np.linalg.norm(xyz, axis=1), _LEAST_M)
    bearing = xyz / range_m[:, None] / _SAME_BEARING
    return np.column_stack([bearing, np.log(range_m) / _SAME_RANGE, 10.0 * side])


def _scenes(shares: Float, same_scene: float) -> Int:
    """Return the number of the first frame of the scene of each frame; `shares` (F, F) of its edges are in others.

    A frame belongs to the scene of the first earlier one that contains enough of it and leads a scene.
    """
    leaders: list[int] = []
    scenes = np.empty(len(shares), np.int64)
    for number in range(len(shares)):
        same = [leader for leader in leaders if shares[number, leader] >= same_scene]
        scenes[number] = same[0] if same else number
        if not same:
            leaders.append(number)
    return scenes
