"""Extract depth discontinuities along lines from one or several sweeps, `--extractor IMAGE/line-points`.

After Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021, who accumulate the
discontinuity points of three successive sweeps and keep those that form lines. All constants are ours.

- A sweep with rings: range jumps along its rings, as in `ring-discontinuity`.
- A cloud without rings, such as accumulated sweeps (`--accumulate poses --set accumulate.past=2 --set
  accumulate.future=0`): its range image from the origin with cells of 0.2 deg; the nearest point of each cell in
  front of a jump to the next cell.
- A point is kept if the neighbours within a radius are distributed along one direction: the largest eigenvalue of their
  covariance is at least 0.7 of the trace. Its weight is the square root of its jump, as in Levinson and
  Thrun.

Departures: the published filter is not known to us in detail; occlusion due to the offset between LiDAR and camera is
handled by the pipeline.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Bool, Float, Int, field
from scipy.ndimage import grey_erosion
from scipy.spatial import cKDTree

from p2o_baselines.edges.ring_discontinuity import edges_at, ring_jumps

_MIN_JUMP_SHARE = 0.03  # added to the smallest jump, as a share of the range
_MAX_GAP_DEG = 0.6  # least angle that parts neighbours on a ring
_CELL_DEG = 0.2  # width of a cell of the range image of a cloud without rings
_RADIUS_M = 0.3  # radius of the neighbourhood of a point, in metres
_RADIUS_SHARE = 0.02  # the radius is at least this share of the range
_MIN_NEIGHBOURS = 2  # least number of neighbours within the radius
_MIN_STRAIGHT = 0.7  # least share of the variance along one direction
_MAX_RANGE_M = 60.0  # drop points farther than this


class LinePointsOptions(p2o.Options):
    """Options of `line-points`."""

    min_jump_m: float = field(0.5, ge=0, help="Smallest range jump, in metres.")


def extract(cloud: p2o.Cloud, options: LinePointsOptions, max_range_m: float = _MAX_RANGE_M) -> p2o.CloudFeatures:
    """Return the points in front of range jumps along lines."""
    rows, jump_m = discontinuities(cloud, options)
    xyz = cloud.xyz[rows]
    range_m = np.linalg.norm(xyz, axis=1)
    keep = (jump_m > options.min_jump_m + _MIN_JUMP_SHARE * range_m) & (range_m <= max_range_m)
    rows, xyz, range_m = rows[keep], xyz[keep], range_m[keep]
    radius_m = np.maximum(_RADIUS_M, _RADIUS_SHARE * range_m)
    line = along_lines(xyz, radius_m, _MIN_NEIGHBOURS, _MIN_STRAIGHT)
    return p2o.CloudFeatures(edges_at(cloud, rows[line], np.sqrt(jump_m[keep][line])))


def discontinuities(cloud: p2o.Cloud, options: LinePointsOptions) -> tuple[Int, Float]:
    """Return the points (M,) before a step back in range, and the steps (M,) m: by rings, else in an image."""
    if cloud.ring is not None:
        return ring_jumps(cloud, options.min_jump_m, _MAX_GAP_DEG)
    return range_image_jumps(cloud.xyz, np.radians(_CELL_DEG), options.min_jump_m)


def range_image_jumps(xyz: Float, cell: float, min_jump_m: float) -> tuple[Int, Float]:
    """Return rows and jumps (M,) m of points before background in two cells of the range image of a cloud (N, 3)."""
    distance = np.linalg.norm(xyz, axis=1)
    rows = np.flatnonzero(distance > 0.5)
    place = np.column_stack([-np.arctan2(xyz[rows, 1], xyz[rows, 0]), -np.arcsin(xyz[rows, 2] / distance[rows])])
    at = np.floor((place - [-np.pi, -np.pi / 2]) / [cell, 2 * cell]).astype(np.int64)
    width, height = int(2 * np.pi / cell) + 1, int(np.pi / (2 * cell)) + 1
    # Far points are written first, so that the nearest of each cell remains; equal ranges are ordered by position.
    order = np.lexsort((place[:, 1], place[:, 0], -distance[rows]))
    near = np.full((height, width), np.inf)
    near[at[order, 1], at[order, 0]] = distance[rows][order]
    # An empty cell between occupied cells is a gap: it takes the nearer of the two ranges.
    shown = np.where(np.isfinite(near), near, grey_erosion(near, size=(1, 3), mode="wrap"))
    chosen_rows, steps = [], []
    for sign in (-1, 1):
        one, two = (np.roll(shown, -count * sign, axis=1)[at[:, 1], at[:, 0]] for count in (1, 2))
        beside = np.minimum(one, two)
        jump = np.where(np.isfinite(beside), beside - distance[rows], 0.0)
        front = (distance[rows] <= near[at[:, 1], at[:, 0]] + 0.5 * min_jump_m) & (jump > min_jump_m)
        some = np.flatnonzero(front)
        outward = np.lexsort((distance[rows][some], place[some, 1], -sign * place[some, 0], at[some, 0], at[some, 1]))
        some = some[outward]
        first = np.ones(len(some), np.bool_)
        first[1:] = (np.diff(at[some], axis=0) != 0).any(axis=1)
        chosen_rows.append(rows[some[first]])
        steps.append(jump[some[first]])
    chosen, where = np.unique(np.concatenate(chosen_rows), return_index=True)
    return chosen, np.concatenate(steps)[where]


def along_lines(xyz: Float, radius_m: Float, min_neighbours: int, min_straight: float) -> Bool:
    """Return the points (N, 3) whose neighbours within their radius (N,) are enough and distributed along a line."""
    if len(xyz) <= min_neighbours:
        return np.zeros(len(xyz), np.bool_)
    near = cKDTree(xyz).query_ball_point(xyz, radius_m, return_sorted=True)
    count = np.array([len(rows) for rows in near])
    owner, rows = np.repeat(np.arange(len(xyz)), count), np.concatenate(near).astype(np.int64)
    offset = xyz[rows] - xyz[owner]
    mean = np.stack([np.bincount(owner, column) for column in offset.T], axis=1) / count[:, None]
    offset -= mean[owner]
    spread = np.empty((len(xyz), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(owner, offset[:, i] * offset[:, j])
    value = np.linalg.eigvalsh(spread)
    total = value.sum(axis=1)
    return np.asarray((count > min_neighbours) & (total > 0) & (value[:, 2] >= min_straight * total))


METHOD = p2o.Method(
    name="line-points",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=LinePointsOptions,
    summary="Points in front of range jumps along lines, of one or several accumulated sweeps.",
    gives={"cloud-edges"},
    cite="Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021",
)
