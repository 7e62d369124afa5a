"""A plugin of the tests: occlusion edges of a dense cloud, as many sweeps of a drive make it (`--accumulate`)."""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Float, Int
from scipy.ndimage import grey_closing


class DenseEdgesOptions(p2o.Options):
    """Options of `dense-edges`."""

    cell_deg: float = p2o.field(0.4, gt=0, le=10, help="Width of a cell of the picture that the cloud makes.")
    gap: float = p2o.field(
        0.15, gt=0, le=2, help="Least step back to what lies behind an edge, as a share of the range."
    )
    min_gap_m: float = p2o.field(0.5, gt=0, le=50, help="Least such step in metres.")
    max_range_m: float = p2o.field(50.0, gt=1, le=1000, help="Edges farther off are left out.")
    eye: tuple[float, float, float] = p2o.field(
        (0.0, 0.0, 0.0), help="Where the cloud is seen from, LiDAR frame, metres."
    )


def build(options: DenseEdgesOptions) -> p2o.CloudExtractor:
    """Return the extractor of edges without direction: of each cell that hides others, its outermost point."""
    cell = np.radians(options.cell_deg)

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        xyz = cloud.xyz[np.lexsort(cloud.xyz.T)]  # points in another order are the same cloud
        ray = xyz - options.eye
        distance = np.linalg.norm(ray, axis=1)
        # Columns from left to right, rows downwards.
        place = np.column_stack([-np.arctan2(ray[:, 1], ray[:, 0]), -np.arcsin(ray[:, 2] / np.maximum(distance, 1e-9))])
        at = np.floor((place - [-np.pi, -np.pi / 2]) / cell).astype(np.int64)
        picture = np.full((int(np.pi / cell) + 1, int(2 * np.pi / cell) + 1), np.inf)
        np.minimum.at(picture, (at[:, 1], at[:, 0]), distance)
        # Gaps between points of one surface do not show what is behind it.
        whole = -grey_closing(np.where(np.isfinite(picture), -picture, -1e3), size=(3, 3), mode="nearest")
        found = [_outermost(place, distance, at, whole, axis, sign, options) for axis in (0, 1) for sign in (-1, 1)]
        rows = np.unique(np.concatenate(found))
        sigma_m = cell / np.sqrt(12) / 2 * distance[rows]
        return p2o.CloudFeatures(p2o.CloudEdges(xyz[rows], np.full(len(rows), p2o.Side.NONE), sigma_m=sigma_m))

    return extract


def _outermost(
    place: Float, distance: Float, at: Int, whole: Float, axis: int, sign: int, options: DenseEdgesOptions
) -> Int:
    """Return the rows of the points nearest to the background in each cell with background on one side of it."""
    step = np.array([sign, 0] if axis == 0 else [0, sign])
    size = np.array(whole.shape)[::-1]

    def beside(count: int) -> Float:
        u, v = np.clip(at + count * step, 0, size - 1).T
        return whole[v, u]

    limit = np.maximum(distance * (1 + options.gap), distance + options.min_gap_m)
    front = distance <= beside(0) * (1 + options.gap / 3)
    # Two cells of background that was seen, and surface on the other side.
    edge = front & (beside(1) > limit) & (beside(2) > limit) & (beside(2) < 1e3) & (beside(-1) < limit)
    rows = np.flatnonzero(edge & (distance <= options.max_range_m))
    # Points that are equally far out are told apart by their places, not by their order in the cloud.
    keys = (distance[rows], place[rows, 1 - axis], -sign * place[rows, axis], at[rows, 0], at[rows, 1])
    order = rows[np.lexsort(keys)]
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(at[order], axis=0) != 0).any(axis=1)
    return order[first]


@p2o.hookimpl
def p2o_cloud_extractors():
    """Offer the LiDAR side."""
    yield p2o.Method(
        name="dense-edges",
        build=build,
        options=DenseEdgesOptions,
        summary="Steps back in the picture that a dense cloud makes, without direction.",
        needs={"dense"},
        gives={"cloud-edges"},
    )
