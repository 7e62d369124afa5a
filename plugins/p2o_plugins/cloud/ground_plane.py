"""Estimate the ground plane of a sweep by RANSAC (paper Sec. III-C)."""

from __future__ import annotations

import numpy as np
from p2o import Float

from p2o_plugins.cloud.sweep import Returns

# Sampled returns, RANSAC hypotheses, half thickness of the ground, range within which roads are approximately flat,
# least-squares steps, and the maximum fraction of returns well below the ground (ditches, embankments).
_SAMPLE, _TRIALS, _BAND_M, _REACH_M, _POLISH, _MOST_UNDER = 3000, 200, 0.15, 40.0, 3, 0.25


def ground_plane(sweep: Returns, seed: int = 0, max_tilt_deg: float = 30.0, min_share: float = 0.1) -> Float | None:
    """Return the plane (4,) n, d with |n| = 1 and n . x + d the height in metres above the ground, or None.

    The inclination to the sensor's xy plane is at most `max_tilt_deg`; the plane contains at least `min_share` of the
    returns within 40 m, and most other returns are on one side of it; otherwise None. For an upside-down sensor the
    ground is above it. LiDAR frame, metres.
    """
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(sweep.flat_m < _REACH_M)
    if len(rows) < 10:
        return None
    picked = sweep.xyz(rows[rng.integers(len(rows), size=_SAMPLE)] if len(rows) > _SAMPLE else rows)
    upright = np.cos(np.radians(max_tilt_deg))
    a, b, c = picked[rng.integers(len(picked), size=(3, _TRIALS))]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    good = (length > 1e-3) & (np.abs(normal[:, 2]) > upright * length)
    if not good.any():
        return None
    normal = normal[good] / length[good, None]
    offset = -np.einsum("ij,ij->i", normal, a[good])
    height = picked.astype(np.float32) @ normal.T.astype(np.float32) + offset.astype(np.float32)
    best = int(np.count_nonzero(np.abs(height) < _BAND_M, axis=0).argmax())
    plane = np.append(normal[best], offset[best])
    for _ in range(_POLISH):
        inside = picked[np.abs(picked @ plane[:3] + plane[3]) < _BAND_M]
        centre = inside.mean(axis=0)
        axes = np.linalg.eigh((inside - centre).T @ (inside - centre))[1]
        plane = np.append(axes[:, 0], -axes[:, 0] @ centre)
    # The sensor is above the ground, also if it is mounted upside down.
    plane = plane if plane[3] > 0 else -plane
    height = picked @ plane[:3] + plane[3]
    share = float(np.mean(np.abs(height) < _BAND_M))
    under = float(np.mean(height < -2 * _BAND_M))
    if share < min_share or under > _MOST_UNDER or abs(plane[2]) < upright:
        return None
    return plane
