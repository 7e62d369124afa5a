"""Extract straight 3D lines, `--extractor lsd/plane-lines`: plane intersections and borders of surfaces.

The LiDAR side of Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013, who
use the dense cloud of a spinning 2D laser indoors.

- Plane intersections: the edges of `voxel-planes`, one segment per voxel.
- Depth borders: the points of `line-points`, grown into segments: from each unused point, the direction of its
  neighbours, then every free point near that line without a gap; a segment has at least 4
  points and is 0.5 m long.

All constants except those of the voxels are ours. Departures: the borders of the original are the edges of segmented
planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o import Float
from p2o.solving import checked
from scipy.spatial import cKDTree

from p2o_baselines.edges import line_points, voxel_planes


@dataclass(frozen=True, eq=False)
class CloudLines(p2o.CloudFeature):
    """Line segments of a sweep: `ends` (N, 2, 3) m in the LiDAR frame."""

    word: ClassVar[str] = "cloud-lines"

    ends: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", checked("ends of the cloud lines", self.ends, (None, 2, 3), np.float64))

    def __len__(self) -> int:
        return len(self.ends)

    def select(self, keep: Any) -> CloudLines:
        """Return the segments of a mask or index."""
        return replace(self, ends=self.ends[keep])

    def moved(self, b_from_lidar: Float) -> CloudLines:
        """Return the segments in another frame b, by a (4, 4) rigid transform."""
        return replace(self, ends=p2o.se3.apply(b_from_lidar, self.ends.reshape(-1, 3)).reshape(-1, 2, 3))

    @property
    def places(self) -> Float:
        """Both ends of all segments, (2N, 3)."""
        return self.ends.reshape(-1, 3)


_RADIUS_M = 1.0  # radius around a point that determines the direction of a border
_LINE_M = 0.06  # largest distance of a point from its line
_GAP_M = 0.8  # largest gap between the points of a border
_MIN_POINTS = 4  # least number of points of a border
_MIN_LENGTH_M = 0.5  # least length of a border
_MAX_RANGE_M = 40.0  # drop lines farther than this


def build(options: p2o.Options) -> p2o.CloudExtractor:
    """Return the extractor."""
    voxels, borders = voxel_planes.VoxelPlanesOptions(), line_points.LinePointsOptions()

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        segments = [ends for _, ends in voxel_planes.plane_edges(cloud.xyz, voxels, _MAX_RANGE_M)]
        edges = line_points.extract(cloud, borders, _MAX_RANGE_M).edges
        assert edges is not None
        segments += list(grown(edges.xyz))
        return p2o.CloudFeatures(features=[CloudLines(np.reshape(segments, (-1, 2, 3)))])

    return extract


def grown(xyz: Float) -> Iterator[Float]:
    """Yield the ends (2, 3) m of segments along points (N, 3), each point in one of them at most."""
    if len(xyz) < _MIN_POINTS:
        return
    xyz = xyz[np.lexsort(xyz.T)]
    tree, free = cKDTree(xyz), np.ones(len(xyz), np.bool_)
    for seed in range(len(xyz)):
        if not free[seed]:
            continue
        near = np.array(tree.query_ball_point(xyz[seed], _RADIUS_M, return_sorted=True))
        near = near[free[near]]
        if len(near) < _MIN_POINTS:
            continue
        centre, along = xyz[seed], _direction(xyz[near])
        rows = np.zeros(0, np.int64)
        for _ in range(3):
            rows = _along(xyz, free, centre, along, seed)
            if len(rows) < _MIN_POINTS:
                break
            centre, along = xyz[rows].mean(axis=0), _direction(xyz[rows])
        if len(rows) < _MIN_POINTS:
            continue
        reach = (xyz[rows] - centre) @ along
        if np.ptp(reach) < _MIN_LENGTH_M:
            continue
        free[rows] = False
        yield centre + np.outer([reach.min(), reach.max()], along)


def _direction(xyz: Float) -> Float:
    return np.asarray(np.linalg.svd(xyz - xyz.mean(axis=0), full_matrices=False)[2][0])


def _along(xyz: Float, free: Any, centre: Float, along: Float, seed: int) -> Any:
    """Return the free points near the line that are joined with the one nearest to the seed without a gap."""
    offset = xyz - centre
    along_m = offset @ along
    off = np.linalg.norm(offset - along_m[:, None] * along, axis=1)
    rows = np.flatnonzero(free & (off <= _LINE_M))
    if not len(rows):
        return rows
    rows = rows[np.argsort(along_m[rows], kind="stable")]
    piece = np.concatenate([[0], np.cumsum(np.diff(along_m[rows]) > _GAP_M)])
    nearest = np.abs(along_m[rows] - along_m[seed]).argmin()
    return rows[piece == piece[nearest]]


METHOD = p2o.Method(
    name="plane-lines",
    build=build,
    summary="Line segments at intersections of planes and at borders of surfaces.",
    gives={"cloud-lines"},
    cite="Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013",
)
