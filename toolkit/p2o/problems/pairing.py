"""Common parts of point-to-line matchers: options, search for lines, weights, and construction of the problem."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Bool, Float, Int, Int8
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.options import Options, field
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
    """Pairs of one view, rows as in `p2o.solving.PointToLine`."""

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
        distance, nearby = map(np.asarray, tree.query(uv[rows], k=options.neighbours, distance_upper_bound=limit))
        near = distance[:, -1] <= reach_px
        chosen.append(rows[near])
        nearest.append(index[nearby[near]])
    rows, neighbours = np.concatenate(chosen), np.concatenate(nearest)
    lines = fit_lines(image.uv[neighbours])
    good = faces(lines, uv[rows], options.max_angle_deg, options.angle_free_px)
    good &= straight(lines, options.min_straightness)
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
    names = ("xyz", "centre", "normal", "time_s", "sigma_px")
    columns: dict[str, Float] = {name: np.concatenate([getattr(p, name) for p in pairs]) for name in names}
    frame = np.repeat(np.arange(len(pairs)), [len(p.weight) for p in pairs])
    return PointToLine(**columns, weight=weight, side=side, frame=frame, cameras=cameras, huber_px=huber_px)


def edge_pairs(views: Sequence[View], camera_from_lidar: Float, reach_px: float) -> PointToLine:
    """Return the pairs of the edges of views at a pose (4, 4), each direction with its own, with default options."""
    options, sides = PairingOptions(), [Side(side) for side in Side]
    pairs = [pair(v.camera, v.image_edges, v.cloud_edges, sides, camera_from_lidar, reach_px, options) for v in views]
    return assemble(views, pairs, options.huber_px, False)


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of K candidate edges: `centre` (K, 2) px, unit `normal` (K, 2), variances in px^2 along and across."""

    centre: Float
    normal: Float
    along: Float
    across: Float


def fit_lines(points: Float) -> Lines:
    """Return the lines through K sets of n points (K, n, 2) in pixels: centre of gravity and direction of least spread.

    The eigenvectors of the 2x2 covariance are taken in closed form. A set of equal points gets normal (0, 1) and no
    spread; `straight` refuses it.
    """
    # One row for each of the n: sums over rows are quick.
    u, v = np.ascontiguousarray(points.T)
    centre = np.stack([u.mean(axis=0), v.mean(axis=0)], axis=1)
    du, dv = u - centre[:, 0], v - centre[:, 1]
    uu, vv, uv = (du * du).mean(axis=0), (dv * dv).mean(axis=0), (du * dv).mean(axis=0)
    mean, half = 0.5 * (uu + vv), np.hypot(0.5 * (uu - vv), uv)
    direction = 0.5 * np.arctan2(2 * uv, uu - vv)
    normal = np.stack([-np.sin(direction), np.cos(direction)], axis=1)
    return Lines(centre, normal, mean + half, np.maximum(mean - half, 0.0))


def straight(lines: Lines, min_ratio: float) -> Bool:
    """Return which lines (K,) have a variance along them `min_ratio` times that across (lambda_c of the paper)."""
    return (lines.along > 0) & (lines.along >= min_ratio * lines.across)


def faces(lines: Lines, uv: Float, max_angle_deg: float, free_px: float) -> Bool:
    """Return which pixels uv (K, 2) lie across their line rather than beyond its end (lambda_a of the paper).

    The angle between centre-to-pixel and normal, whatever its sign, must not exceed `max_angle_deg`. Pixels within
    `free_px` of the centre always pass: there the direction is that of the pixel grid.
    """
    offset = uv - lines.centre
    distance = np.hypot(offset[:, 0], offset[:, 1])
    across = np.abs((offset * lines.normal).sum(axis=1))
    # The slack admits the limit itself in spite of rounding.
    good: Bool = (distance <= free_px) | (across >= distance * (np.cos(np.radians(max_angle_deg)) - 1e-12))
    return good
