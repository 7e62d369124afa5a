"""How many different views frames show: a rig that stands still sees the same outlines again and again."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from p2o.arrays import Float, Int, Int8

_SAME_BEARING, _SAME_RANGE = 0.02, 0.04
"""Edges of one direction so near in bearing (about 1 deg) and range (4 %) are of one outline."""
_LEAST_M = 0.1
_FEW = 0.5
"""Where less than this share of the frames are views of their own, a user should know."""
_MOST_LOOKED_UP = 2_000_000
"""So many edges are looked up in frames at most; where there are more, some that are drawn."""


def view_count(xyz: Float, side: Int8, frame: Int) -> float:
    """Return how many different views the frames of edges are: all of them, or down to 1 where a rig stands still.

    `xyz` (K, 3) are places of edges in m in the LiDAR frame, `side` (K,) their directions and `frame` (K,) the numbers
    of their frames. The mean over all edges of 1 / (in how many frames one of its direction lies where it does), times
    the number of frames; 0 without edges. Of very many the mean is over some, always the same.
    """
    frames = np.unique(frame)
    if len(frames) < 2:
        return float(len(frames))
    range_m = np.maximum(np.linalg.norm(xyz, axis=1), _LEAST_M)
    bearing = xyz / range_m[:, None] / _SAME_BEARING
    # Sides lie so far apart that no other one is within 1.
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
    """Return a warning where `frames` frames show few different views, else nothing."""
    if frames < 2 or views >= _FEW * frames:
        return ()
    text = f"{frames} frames show about {views:.1f} different views, and count as so many: the rig stood still"
    return (f"{text}; frames of other places make the result surer, more of these do not",)
