"""Extract depth discontinuities along the rings of a spinning LiDAR, `--extractor IMAGE/ring-discontinuity`.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013, Sec. III: the weight of a point is X_i
= max(d_(i-1) - d_i, d_(i+1) - d_i, 0)^0.5, d the range and i - 1, i + 1 its neighbours on the ring, so that only the
nearer side of a jump counts; points with a jump of at most 0.3 m are dropped (their figure, as far as we know).

Departures: points further apart than 0.6 deg and 1.4 azimuth steps are not neighbours (a pulse without a return
is no jump); of points of one ring with the same azimuth the nearest is used.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Float, Int, field, reading

from p2o_baselines.point_feature import raw_times

_MAX_GAP_DEG = 0.6  # least angle that parts neighbours on a ring
_MAX_RANGE_M = 100.0  # drop points farther than this


class RingDiscontinuityOptions(p2o.Options):
    """Options of `ring-discontinuity`."""

    min_jump_m: float = field(0.3, ge=0, help="Smallest range jump to a neighbour on the ring, in metres.")


def ring_jumps(cloud: p2o.Cloud, min_jump_m: float, max_gap_deg: float) -> tuple[Int, Float]:
    """Return the points (M,) in front of measured range jumps above `min_jump_m` on closed rings, and the jumps."""
    xyz = cloud.as_measured()
    ring = np.zeros(len(xyz), np.int64) if cloud.ring is None else cloud.ring
    range_m, azimuth = np.linalg.norm(xyz, axis=1), np.arctan2(xyz[:, 1], xyz[:, 0])
    order = np.lexsort((range_m, azimuth, ring))
    twice = np.zeros(len(order), np.bool_)
    twice[1:] = (ring[order[1:]] == ring[order[:-1]]) & (azimuth[order[1:]] == azimuth[order[:-1]])
    order = order[~twice]
    new = np.ones(len(order), np.bool_)
    new[1:] = ring[order[1:]] != ring[order[:-1]]
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(order)) - 1
    after = np.arange(1, len(order) + 1)
    after[last] = first
    step = np.mod(azimuth[order[after]] - azimuth[order], 2 * np.pi)
    back = range_m[order[after]] - range_m[order]  # positive where the next point is farther away
    back[(step > reading.neighbour_gap(step, np.radians(max_gap_deg))) | (after == np.arange(len(order)))] = 0.0
    jump = np.maximum(back, 0.0)
    np.maximum.at(jump, after, -back)
    keep = jump > min_jump_m
    return order[keep], jump[keep]


def edges_at(cloud: p2o.Cloud, rows: Int, weight: Float) -> p2o.CloudEdges:
    """Return points of a cloud as edges without direction, with their times for a raw sweep."""
    none = np.full(len(rows), p2o.Side.NONE, np.int8)
    return p2o.CloudEdges(cloud.xyz[rows], none, weight, time_s=raw_times(cloud, rows))  # type: ignore[arg-type]  # None means 0


def extract(cloud: p2o.Cloud, options: RingDiscontinuityOptions) -> p2o.CloudFeatures:
    """Return the points in front of range jumps along their ring."""
    rows, jump_m = ring_jumps(cloud, options.min_jump_m, _MAX_GAP_DEG)
    near = np.linalg.norm(cloud.xyz[rows], axis=1) <= _MAX_RANGE_M
    return p2o.CloudFeatures(edges_at(cloud, rows[near], np.sqrt(jump_m[near])))


METHOD = p2o.Method(
    name="ring-discontinuity",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=RingDiscontinuityOptions,
    summary="Points in front of range jumps along their ring, weighted by the root of the jump.",
    needs={"rings"},
    gives={"cloud-edges"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)
