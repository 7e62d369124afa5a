"""Recover the rings of a sweep in firing order whose lasers do not intersect at the origin (Velodyne HDL-64E)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from p2o import Cloud, Float, Int

Single = NDArray[np.float32]

_ROUNDS = 6
_BLOCK, _RESULTANT = 64, 0.8
"""Successive points whose azimuths are averaged, and the least length of the mean direction in firing order."""
_HEIGHTS_M = np.arange(-0.1, 0.301, 0.01)
"""Candidate heights of lasers above the origin (HDL-64E: 0.2 m for the upper block, 0.12 m for the lower block)."""
_BIN_DEG, _LIMIT_DEG, _WINDOW_DEG = 0.02, 50.0, 6.0
_MOST_RINGS, _FEWEST_RINGS, _FEWEST_POINTS, _LEAST_SHARE = 128, 8, 50, 0.12
"""A ring has at least this number of returns, and this share of the median of all rings."""
_NEAREST_M = 1.0
"""Returns nearer than this get the ring of the nearest cone, and determine none."""
_SAME_RING_DEG, _OFF_CONE_DEG, _MOST_OFF, _UNSOLVABLE = 0.14, 0.08, 0.005, 0.1
"""Rings closer than this are one; a return is off its cone beyond this angle; the largest share of these at the end,
and after the second fit."""


def rings_in_firing_order(cloud: Cloud) -> Int | None:
    """Return the ring (N,) of each point, 0 the highest, of a raw sweep in firing order; None if they are not evident.

    In firing order a revolution is stored once, the lasers of each moment one after another; dropped returns may be
    missing. The lasers of a ring measure the cone z = slope d + height. Heights are first estimated for windows of the
    elevation, as those at which the elevations form the sharpest histogram; its maxima are the rings. Slope and height
    of each are then fitted to its returns. Motion-compensated sweeps have no such cones, unless `cloud.twist` is given.
    """
    x, y, z = cloud.as_measured().T
    flat = np.hypot(x, y)
    if len(cloud) < _FEWEST_RINGS * _FEWEST_POINTS or not _in_firing_order(x, y, flat):
        return None
    used = flat > _NEAREST_M
    near, low = flat[used], z[used]
    cones = _maxima(near, low)
    for round_number in range(_ROUNDS):
        if not _FEWEST_RINGS <= len(cones) <= 2 * _MOST_RINGS:
            return None
        cones = _fitted(cones, near, low)
        if not _FEWEST_RINGS <= len(cones) <= _MOST_RINGS:
            return None
        off = _nearest(cones, near, low)[1] > np.radians(_OFF_CONE_DEG)
        if round_number > 0 and np.mean(off) > _UNSOLVABLE:
            return None
        if round_number + 1 < _ROUNDS:
            cones = np.vstack([cones, _maxima(near[off], low[off], cones)])
    return _nearest(cones, flat, z)[0] if np.mean(off) <= _MOST_OFF else None


def _in_firing_order(x: Float, y: Float, flat: Float) -> bool:
    """Return whether successive points have similar azimuths."""
    whole = len(x) // _BLOCK * _BLOCK
    unit = np.exp(1j * np.arctan2(y, x)) * (flat > 0)
    return bool(np.median(np.abs(unit[:whole].reshape(-1, _BLOCK).mean(axis=1))) > _RESULTANT)


def _maxima(flat: Float, z: Float, known: Float | None = None) -> Float:
    """Return slope and height (R, 2) of rings from the maxima of the histogram of the elevations.

    Heights are those of `known` rings of similar elevation, else those with the sharpest histogram.
    """
    bins = round(2 * _LIMIT_DEG / _BIN_DEG)
    angle_deg = (np.arange(bins) + 0.5) * _BIN_DEG - _LIMIT_DEG
    counts = np.empty((len(_HEIGHTS_M), bins))
    for row, height in enumerate(_HEIGHTS_M):
        limits = (-_LIMIT_DEG, _LIMIT_DEG)
        counts[row] = np.histogram(np.degrees(np.arctan2(z - height, flat)), bins, limits)[0]
    window = np.ones(round(_WINDOW_DEG / _BIN_DEG))
    if known is None:
        best = np.array([np.convolve(count**2, window, "same") for count in counts]).argmax(axis=0)
    else:
        upwards = known[np.argsort(known[:, 0])]
        height = np.interp(np.tan(np.radians(angle_deg)), upwards[:, 0], upwards[:, 1])
        best = np.abs(_HEIGHTS_M[:, None] - height).argmin(axis=0)
    smooth = np.convolve(counts[best, np.arange(bins)], [0.25, 0.5, 0.25], "same")
    typical = np.convolve(smooth, window / len(window), "same")
    reach = round(_SAME_RING_DEG / _BIN_DEG)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(smooth, reach), 2 * reach + 1).max(axis=1)
    peaks = np.flatnonzero((smooth == around) & (smooth > 1.5 * typical) & (smooth >= 5))
    return np.column_stack([np.tan(np.radians(angle_deg[peaks])), _HEIGHTS_M[best[peaks]]])


def _nearest(cones: Float, flat: Float, z: Float) -> tuple[Int, Single]:
    """Return the nearest cone (N,) of each point, and the angle to it in rad."""
    d, h = np.maximum(flat, 0.1).astype(np.float32), z.astype(np.float32)
    slope, height = cones.T.astype(np.float32)
    ring, off = np.empty(len(d), np.int64), np.empty(len(d), np.float32)
    for begin in range(0, len(d), 8192):
        part = np.s_[begin : begin + 8192]
        away = np.abs(slope - (h[part, None] - height) / d[part, None])
        ring[part] = away.argmin(axis=1)
        off[part] = away[np.arange(len(away)), ring[part]]
    return ring, off / (1 + slope[ring] ** 2)


def _fitted(cones: Float, flat: Float, z: Float) -> Float:
    """Return slope and height (R, 2) of the cones fitted to the returns on them, the highest first.

    Cones with few returns are left out, and those closer than `_SAME_RING_DEG` to one with more.
    """
    ring, off = _nearest(cones, flat, z)
    on = off < np.radians(_OFF_CONE_DEG)
    label, d, count = ring[on], flat[on], len(cones)
    rise = (z[on] - cones[label, 1]) / d
    # Least squares of rise = slope + change / d, with a prior of 5 cm on the change, for errors of 0.003 rad.
    points, inverse, squared, sum_rise, product = (
        np.bincount(label, weight, count) for weight in (None, 1 / d, 1 / d**2, rise, rise / d)
    )
    with_prior = squared + (0.003 / 0.05) ** 2
    det = np.maximum(with_prior * points - inverse**2, 1e-9)
    slope = (sum_rise * with_prior - inverse * product) / det
    height = cones[:, 1] + (product * points - inverse * sum_rise) / det
    enough = max(_FEWEST_POINTS, _LEAST_SHARE * float(np.median(points)))
    kept: list[int] = []
    for row in np.argsort(-points, kind="stable"):
        if points[row] >= enough and (not kept or np.abs(slope[kept] - slope[row]).min() > np.radians(_SAME_RING_DEG)):
            kept.append(int(row))
    fitted = np.column_stack([slope, height])[kept]
    return fitted[np.argsort(-fitted[:, 0], kind="stable")]
