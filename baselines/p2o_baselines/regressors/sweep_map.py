"""A sweep as a sparse picture: nearness, reflectance and places of the nearest point in each cell, at any pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from p2o.arrays import Float

Channel = Literal["nearness", "reflectance", "x", "y", "z"]
NEAREST_M, FARTHEST_M = 2.0, 80.0
"""Depths between which nearness falls from 1 to `FAINTEST`; LCCNet leaves out what is farther than 80 m."""
FAINTEST = 0.05
_PLACE_M = 40.0
"""What coordinates count in, so that networks see numbers of about 1."""


def nearness(depth_m: Float) -> Float:
    """Return 1 for depths up to 2 m, falling with their logarithm to 0.05 at 80 m and beyond; nothing is 0."""
    along = np.log(np.maximum(depth_m, NEAREST_M) / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)
    return np.asarray(np.maximum(1.0 - (1.0 - FAINTEST) * along, FAINTEST))


def depth_of(near: Float) -> Float:
    """Return the depth in metres that a nearness > 0 tells."""
    return np.asarray(NEAREST_M * (FARTHEST_M / NEAREST_M) ** ((1.0 - np.asarray(near)) / (1.0 - FAINTEST)))


def drawn(
    uv: Float,
    depth_m: Float,
    size: tuple[int, int],
    channels: Sequence[Channel] = ("nearness",),
    reflectance: Float | None = None,
    xyz: Float | None = None,
) -> Float:
    """Return the map (C, h, w) float32 of points at pixels (N, 2) of a grid of `size` (h, w), the nearest on top.

    Points that are not seen (NaN), outside, or farther than 80 m are left out; empty cells are 0 in all channels.
    `xyz` (N, 3) is in the LiDAR's frame.
    """
    height, width = size
    u, v = uv[:, 0], uv[:, 1]
    with np.errstate(invalid="ignore"):
        seen = (u >= -0.5) & (v >= -0.5) & (u < width - 0.5) & (v < height - 0.5) & (depth_m <= FARTHEST_M)
    rows = np.flatnonzero(seen)
    rows = rows[np.argsort(-depth_m[rows], kind="stable")]
    place = (v[rows] + 0.5).astype(np.int64) * width + (u[rows] + 0.5).astype(np.int64)
    out = np.zeros((len(channels), height * width), np.float32)
    for number, channel in enumerate(channels):
        if channel == "nearness":
            out[number, place] = nearness(depth_m[rows])
        elif channel == "reflectance":
            out[number, place] = 0.0 if reflectance is None else reflectance[rows]
        elif xyz is not None:
            out[number, place] = xyz[rows, "xyz".index(channel)] / _PLACE_M
    return np.asarray(out.reshape(len(channels), height, width))
