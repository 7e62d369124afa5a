"""Match the nearest image edges as lines of the same direction, `--matcher knn-line`.

The matcher of Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera in Targetless
Environments, RA-L 2021, after hku-mars/livox_camera_calib: the principal direction of the five nearest image edges
within the reach is the line; that of the five nearest projected cloud edges has to be within 30 deg of it; cloud edges
in the same pixel are averaged. Residual: the distance across the line (their 2D residual has no more information).
Solver `lm`. The original shrinks the reach from 30 to 11 px in steps of one; here the pipeline shrinks it.

Departures: lines go through the nearest image edge, as in the original; a Huber kernel of 2 px, where the released code
has none; no weights by beam and pixel noise (their code computes none either); all lens models of p2o, where the
original ignores k3. Its rough stage, a search over rotations, corresponds to `--init search`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import Float
from p2o.solving import Pairs, PointToLine, assemble, fit_lines
from scipy.spatial import cKDTree

_NEIGHBOURS = 5  # nearest edges, of image and cloud, that determine a direction
_MAX_ANGLE_DEG = 30.0  # largest angle between the two directions
_HUBER_PX = 2.0  # residual from which a pair counts linearly and no longer squared


def build(options: p2o.Options) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> PointToLine`."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> PointToLine:
        pairs = [_pairs(view, camera_from_lidar, reach_px) for view in views]
        return assemble(views, pairs, _HUBER_PX, False)

    return match


def _pairs(view: p2o.View, pose: Float, reach_px: float) -> Pairs:
    cloud, image = one_a_pixel(view, pose), view.image_edges.uv
    count = _NEIGHBOURS
    if len(cloud) < count or len(image) < count:
        return _paired(cloud.select(np.zeros(0, np.int64)), np.zeros((0, 2)), np.zeros((0, 2)))
    uv = view.camera.project(p2o.se3.apply(pose, cloud.xyz))
    limit = np.nextafter(reach_px, np.inf)  # the tree's own bound is exclusive
    distance, neighbours = cKDTree(image).query(uv, k=count, distance_upper_bound=limit)
    rows = np.flatnonzero(np.asarray(distance)[:, -1] <= reach_px)
    lines = fit_lines(image[np.asarray(neighbours)[rows]])
    own = fit_lines(uv[np.asarray(cKDTree(uv).query(uv, k=count)[1])[rows]])
    parallel = np.abs((lines.normal * own.normal).sum(axis=1)) >= np.cos(np.radians(_MAX_ANGLE_DEG))
    parallel &= (lines.along > 0) & (own.along > 0)
    rows, normal = rows[parallel], lines.normal[parallel]
    return _paired(cloud.select(rows), image[np.asarray(neighbours)[rows, 0]], normal)


def one_a_pixel(view: p2o.View, pose: Float) -> p2o.CloudEdges:
    """Return the cloud edges that a pose brings into the image, those of one pixel as one at their mean."""
    edges = view.cloud_edges
    uv = view.camera.project(p2o.se3.apply(pose, edges.xyz))
    seen = view.camera.in_image(uv)
    edges, cell = edges.select(seen), np.rint(uv[seen]).astype(np.int64)
    _, first, whose, count = np.unique(cell, axis=0, return_index=True, return_inverse=True, return_counts=True)
    whose = whose.reshape(-1)

    def mean(values: Float) -> Float:
        columns = [np.bincount(whose, column, len(first)) for column in values.reshape(len(values), -1).T]
        return np.asarray(np.stack(columns, axis=1) / count[:, None]) if columns else values

    if not len(first):
        return edges
    side = np.full(len(first), p2o.Side.NONE, np.int8)
    return p2o.CloudEdges(mean(edges.xyz), side, mean(edges.weight)[:, 0], time_s=mean(edges.time_s)[:, 0])


def _paired(cloud: p2o.CloudEdges, centre: Float, normal: Float) -> Pairs:
    side = np.full(len(cloud), p2o.Side.NONE, np.int8)
    return Pairs(cloud.xyz, centre, normal, cloud.weight, side, cloud.time_s, np.zeros(len(cloud)))


METHOD = p2o.Method(
    name="knn-line",
    build=build,
    summary="Lines through the five nearest image edges that run as the projected cloud edges do.",
    needs={"image-edges", "cloud-edges"},
    gives={"pairs"},
    cite="Yuan et al., Pixel-level Extrinsic Self Calibration of High Resolution LiDAR and Camera, RA-L 2021",
)
