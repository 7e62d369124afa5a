"""Depth discontinuities along the rings of a spinning LiDAR, `--extractor IMAGE/ring-discontinuity`.

Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013, Sec. III: each point weighs
X_i = max(d_(i-1) - d_i, d_(i+1) - d_i, 0)^0.5, d the range and i - 1, i + 1 its neighbours on the ring, so that only
the nearer side of a jump counts; points whose jump is 0.3 m or less are left out (the figure is theirs as we know it).

Departures: neighbours further apart than `max_gap_deg` are no neighbours (a pulse that did not come back makes no
jump); of points of one ring under one azimuth the nearest counts.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float, Int


class RingDiscontinuityOptions(p2o.Options):
    """Options of `ring-discontinuity`."""

    min_jump_m: float = p2o.field(0.3, ge=0, help="Smallest step back in range to a neighbour on the ring, in metres.")
    power: float = p2o.field(0.5, gt=0, le=2, help="Power of the step that a point weighs.")
    max_gap_deg: float = p2o.field(0.6, gt=0, lt=90, help="Points further apart in azimuth are no neighbours.")
    max_range_m: float = p2o.field(100.0, gt=1, help="Points farther than this are left out.")


def ring_jumps(cloud: p2o.Cloud, min_jump_m: float, max_gap_deg: float) -> tuple[Int, Float]:
    """Return the points (M,) from which the range steps back by more than `min_jump_m` along their ring, and the steps.

    Points come ring by ring, by rising azimuth. Rings are closed; ranges and azimuths are those that were measured.
    """
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
    back = range_m[order[after]] - range_m[order]  # positive where the next point lies behind
    back[(step > np.radians(max_gap_deg)) | (after == np.arange(len(order)))] = 0.0
    jump = np.maximum(back, 0.0)
    np.maximum.at(jump, after, -back)
    keep = jump > min_jump_m
    return order[keep], jump[keep]


def edges_at(cloud: p2o.Cloud, rows: Int, weight: Float) -> p2o.CloudEdges:
    """Return points of a cloud as edges without direction, with their times where the sweep is raw."""
    time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[rows]
    none = np.full(len(rows), p2o.Side.NONE, np.int8)
    return p2o.CloudEdges(cloud.xyz[rows], none, weight, time_s=time_s)  # type: ignore[arg-type]  # None means 0


def build(options: RingDiscontinuityOptions) -> p2o.CloudExtractor:
    """Return the extractor."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        rows, jump_m = ring_jumps(cloud, options.min_jump_m, options.max_gap_deg)
        near = np.linalg.norm(cloud.xyz[rows], axis=1) <= options.max_range_m
        return p2o.CloudFeatures(edges_at(cloud, rows[near], jump_m[near] ** options.power))

    return extract


METHOD = p2o.Method(
    name="ring-discontinuity",
    build=build,
    options=RingDiscontinuityOptions,
    summary="Points before a step back in range along their ring, weighed by the root of the step.",
    needs={"rings"},
    gives={"cloud-edges"},
    cite="Levinson and Thrun, Automatic Online Calibration of Cameras and Lasers, RSS 2013",
)
