"""Extract straight 3D lines, `--extractor lsd/plane-lines`: plane intersections and borders of surfaces.

The LiDAR side of Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013, who
use the dense cloud of a spinning 2D laser indoors.

- Plane intersections: the edges of `voxel-planes`, one segment per voxel.
- Depth borders: the points of `line-points`, grown into segments: from each unused point, the direction of its
  neighbours, then every free point within `line_m` of that line without a gap; a segment has at least `min_points`
  points and is `min_length_m` long.

All constants except those of the voxels are ours. Departures: the borders of the original are the edges of segmented
planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o import Float, field
from p2o.solving import checked
from scipy.spatial import cKDTree

from p2o_baselines import line_points, voxel_planes


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


class PlaneLinesOptions(p2o.Options):
    """Options of `plane-lines`."""

    planes: bool = field(True, help="Extract intersections of planes.")
    borders: bool = field(True, help="Extract borders of surfaces.")
    voxel_m: float = field(1.0, gt=0, le=20, help="Size of the voxels in which planes are fitted.")
    radius_m: float = field(1.0, gt=0, le=20, help="Radius around a point that determines the direction of a border.")
    line_m: float = field(0.06, gt=0, le=2, help="Largest distance of a point from its line.")
    gap_m: float = field(0.8, gt=0, le=20, help="Largest gap between the points of a border.")
    min_points: int = field(4, ge=3, help="Least number of points of a border.")
    min_length_m: float = field(0.5, gt=0, le=20, help="Least length of a border.")
    max_range_m: float = field(40.0, gt=1, help="Drop lines farther than this.")


def build(options: PlaneLinesOptions) -> p2o.CloudExtractor:
    """Return the extractor."""
    voxels = voxel_planes.VoxelPlanesOptions(voxel_m=options.voxel_m, max_range_m=options.max_range_m)
    borders = line_points.METHOD.build(line_points.LinePointsOptions(max_range_m=options.max_range_m))

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        segments = [ends for _, ends in voxel_planes.plane_edges(cloud.xyz, voxels)] if options.planes else []
        if options.borders:
            edges = borders(cloud).edges
            assert edges is not None
            segments += list(grown(edges.xyz, options))
        return p2o.CloudFeatures(features=[CloudLines(np.reshape(segments, (-1, 2, 3)))])

    return extract


def grown(xyz: Float, options: PlaneLinesOptions) -> Iterator[Float]:
    """Yield the ends (2, 3) m of segments along points (N, 3), each point in one of them at most."""
    if len(xyz) < options.min_points:
        return
    xyz = xyz[np.lexsort(xyz.T)]
    tree, free = cKDTree(xyz), np.ones(len(xyz), np.bool_)
    for seed in range(len(xyz)):
        if not free[seed]:
            continue
        near = np.array(tree.query_ball_point(xyz[seed], options.radius_m, return_sorted=True))
        near = near[free[near]]
        if len(near) < options.min_points:
            continue
        centre, along = xyz[seed], _direction(xyz[near])
        rows = np.zeros(0, np.int64)
        for _ in range(3):
            rows = _along(xyz, free, centre, along, seed, options)
            if len(rows) < options.min_points:
                break
            centre, along = xyz[rows].mean(axis=0), _direction(xyz[rows])
        if len(rows) < options.min_points:
            continue
        reach = (xyz[rows] - centre) @ along
        if np.ptp(reach) < options.min_length_m:
            continue
        free[rows] = False
        yield centre + np.outer([reach.min(), reach.max()], along)


def _direction(xyz: Float) -> Float:
    return np.asarray(np.linalg.svd(xyz - xyz.mean(axis=0), full_matrices=False)[2][0])


def _along(xyz: Float, free: Any, centre: Float, along: Float, seed: int, options: PlaneLinesOptions) -> Any:
    """Return the free points near the line that are joined with the one nearest to the seed without a gap."""
    offset = xyz - centre
    along_m = offset @ along
    off = np.linalg.norm(offset - along_m[:, None] * along, axis=1)
    rows = np.flatnonzero(free & (off <= options.line_m))
    if not len(rows):
        return rows
    rows = rows[np.argsort(along_m[rows], kind="stable")]
    piece = np.concatenate([[0], np.cumsum(np.diff(along_m[rows]) > options.gap_m)])
    nearest = np.abs(along_m[rows] - along_m[seed]).argmin()
    return rows[piece == piece[nearest]]


METHOD = p2o.Method(
    name="plane-lines",
    build=build,
    options=PlaneLinesOptions,
    summary="Line segments at intersections of planes and at borders of surfaces.",
    gives={"cloud-lines"},
    cite="Moghadam, Bosse and Zlot, Line-based Extrinsic Calibration of Range and Image Sensors, ICRA 2013",
)
