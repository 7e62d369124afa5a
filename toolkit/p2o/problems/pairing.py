"""What all point-to-line matchers share: their options, the search for lines, weights, and the finished problem."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float, Int, Int8
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.options import Options, field
from p2o.problems.line_fit import faces, fit_lines, straight
from p2o.problems.point_to_line import PointToLine


class PairingOptions(Options):
    """Options of matchers that pair cloud edges with lines through image edges (paper Sec. III-D and IV-A.3)."""

    neighbours: int = field(8, ge=2, help="Image edge points that make a line.")
    max_angle_deg: float = field(
        50.0, gt=0, le=90, help="Largest angle between the line normal and the way to the point (lambda_a)."
    )
    angle_free_px: float = field(
        2.0, ge=0, help="Points this near to the centre of their line skip the angle test; 0 as in the paper."
    )
    min_straightness: float = field(
        5.0, ge=1, help="Least ratio of the variances along and across a line (lambda_c); a right angle has 4.4."
    )
    margin_px: float = field(0.0, ge=0, help="How far outside the image a projected point still takes part.")
    weigh_by_sigma: bool = field(True, help="Weigh pairs by the inverse of their variance in the image.")
    image_sigma_px: float = field(1.0, gt=0, help="Standard deviation of an image edge across its direction.")
    thin_px: float = field(0.0, ge=0, help="Keep one pair per direction and image cell of this size; 0 keeps all.")
    huber_px: float = field(2.0, gt=0, help="Residual from which a pair counts linearly and no longer squared.")


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of one view, rows as in `p2o.PointToLine`."""

    xyz: Float
    centre: Float
    normal: Float
    weight: Float
    side: Int8
    time_s: Float
    sigma_px: Float


def pair(
    camera: Camera,
    image: ImageEdges,
    cloud: CloudEdges,
    sides: Iterable[Side],
    camera_from_lidar: Float,
    reach_px: float,
    options: PairingOptions,
) -> Pairs:
    """Return the pairs of one view at the pose camera_from_lidar (4, 4), each of `sides` with its own kind only.

    A cloud edge takes the line through its nearest image edges if all of these lie within `reach_px`, the point lies
    across the line (`faces`) and the line is straight (`straight`).
    """
    xyz_camera = se3.apply(camera_from_lidar, cloud.xyz)
    uv = camera.project(xyz_camera)
    visible = camera.in_image(uv, options.margin_px)
    chosen, nearest = [np.zeros(0, np.int64)], [np.zeros((0, options.neighbours), np.int64)]
    for side in sides:
        rows = np.flatnonzero(visible & (cloud.side == side))
        index = image.index.get(side)
        if index is None or len(index) < options.neighbours or not len(rows):
            continue
        limit = np.nextafter(reach_px, np.inf)  # the tree's own bound is exclusive
        tree = image.trees[side]
        distance, found = map(np.asarray, tree.query(uv[rows], k=options.neighbours, distance_upper_bound=limit))
        near = distance[:, -1] <= reach_px
        chosen.append(rows[near])
        nearest.append(index[found[near]])
    rows, neighbours = np.concatenate(chosen), np.concatenate(nearest)
    lines = fit_lines(image.uv[neighbours])
    good = straight(lines, options.min_straightness) & faces(
        lines, uv[rows], options.max_angle_deg, options.angle_free_px
    )
    rows, neighbours = rows[good], neighbours[good]
    weight = cloud.weight[rows] * image.weight[neighbours].mean(axis=1)
    lidar_px = camera.focal_px * cloud.sigma_m[rows] / xyz_camera[rows, 2]
    if options.weigh_by_sigma:
        weight = weight / (1.0 + (lidar_px / options.image_sigma_px) ** 2)
    lines_of = lines.centre[good], lines.normal[good]
    pairs = Pairs(cloud.xyz[rows], *lines_of, weight, cloud.side[rows], cloud.time_s[rows], lidar_px)
    if options.thin_px > 0:
        keep = thinned(uv[rows], pairs.side, weight, options.thin_px)
        pairs = Pairs(*(getattr(pairs, name)[keep] for name in Pairs.__dataclass_fields__))
    return pairs


def thinned(uv: Float, side: Int8, weight: Float, cell_px: float) -> Int:
    """Return rows that keep one point per direction and square cell of `cell_px`: the heaviest, then the most central.

    `uv` (N, 2) px, `side` (N,), `weight` (N,). Rows come back in rising order, so shuffling the input changes nothing.
    """
    cell = np.floor(uv / cell_px)
    off_centre = np.square(uv / cell_px - cell - 0.5).sum(axis=1)
    order = np.lexsort((off_centre, -weight, side, cell[:, 1], cell[:, 0]))
    key = np.column_stack([cell, side])[order]
    first = np.ones(len(order), bool)
    first[1:] = (key[1:] != key[:-1]).any(axis=1)
    return np.sort(order[first])


def balanced(weight: Float, side: Int8) -> Float:
    """Return weights (K,) scaled so that every direction that occurs in `side` (K,) has the same sum."""
    total = np.bincount(side, weights=weight, minlength=len(SIDES))
    share = np.divide(weight.sum(), total, out=np.zeros_like(total), where=total > 0)
    return np.asarray(weight * share[side])


def assemble(views: Sequence[View], pairs: Sequence[Pairs], huber_px: float, balance: bool) -> PointToLine:
    """Return the problem of all views, with weights scaled to a mean of one so that costs read as px^2 per pair."""
    cameras = tuple(view.camera for view in views)
    if not sum(len(p.weight) for p in pairs):
        return PointToLine.empty(cameras, huber_px)
    weight, side = np.concatenate([p.weight for p in pairs]), np.concatenate([p.side for p in pairs])
    if balance:
        weight = balanced(weight, side)
    if weight.any():
        weight = weight / weight.mean()
    return PointToLine(
        np.concatenate([p.xyz for p in pairs]),
        np.concatenate([p.centre for p in pairs]),
        np.concatenate([p.normal for p in pairs]),
        weight,
        side,
        np.repeat(np.arange(len(pairs)), [len(p.weight) for p in pairs]),
        cameras,
        huber_px,
        np.concatenate([p.time_s for p in pairs]),
        np.concatenate([p.sigma_px for p in pairs]),
    )
