"""Score directed image edges against exact labels, and their agreement with the edges of a LiDAR.

**Exact labels, as in the papers** (`judge_boundary`; P2ORM, DOOBNet, BSDS): edges are made pixels, predictions above a
threshold are matched one-to-one with true pixels at most 0.0075 image diagonals away, for 99 thresholds. There an edge
pixel has an angle, and its direction is right if it is at most 90 degrees off. Here a point has one of four sides, so
the direction of a pixel is the sum of the steps to the background of its points (as the papers get their angle from
the orders): a pixel that is both L and U points up and left. At most 90 degrees off then means: L, U and B agree with
L, only R does not. A pixel whose sides cancel (a pole one pixel wide, L and R) agrees with every direction.

The papers judge the direction of a pixel by its partner in a minimum-cost assignment. We judge it by the nearest true
pixel (the best of those equally near) and match what agrees: that depends on no choice between equally good
assignments, and a predictor that names the opposite sides scores nothing, also on thin objects.

**Exact labels, strictly** (`judge_sides`): points, not pixels, within 2 px, and the same side; so every point of a
diagonal outline, where L and U alternate, needs its own side. A tolerance of 9.7 px is irrelevant to calibration.

**Ignored edges** (foliage, specks) are neither true nor false: they do not count as missed, and a prediction without a
true partner does not count as wrong if an ignored edge is within reach, and nearer than every true one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from edge_matching import Pairs, matched_rows, pairs_within
from p2o import se3
from p2o.arrays import Bool, Float, Int8
from p2o.errors import InputError
from p2o.features.edges import ImageEdges
from p2o.features.occlusion import edges_from_maps, occlusion_orders, side_maps, without_short
from p2o.features.side import SIDES, Side
from p2o.features.view import View
from p2o.geometry.camera import Camera
from p2o.geometry.visibility import hidden
from scipy.spatial import cKDTree

THRESHOLDS: Float = np.arange(1, 100) / 100
"""The 99 thresholds of the papers, on confidence."""
STRICT_PX = 2.0
"""How near the strict scores ask a point to be, in pixels."""
NEAR_PX = 3.0
"""How near an edge of the other sensor has to be, in pixels."""
_STEP: Float = np.array([Side(s).background for s in (*SIDES, Side.NONE)], np.float64)


@dataclass(frozen=True, eq=False)
class EdgeTruth:
    """The true edges of an image, `edges`, and `ignored` ones, which are neither true nor false."""

    edges: ImageEdges
    ignored: ImageEdges


def edge_truth(
    depth_m: Float,
    camera: Camera,
    *,
    normals: Float | None = None,
    masked: Bool | None = None,
    min_jump_m: float = 0.4,
    relative_jump: float = 0.0,
    min_length_px: int = 5,
) -> EdgeTruth:
    """Return the edges of a depth map (H, W), half a pixel outside of the foreground pixel: where silhouettes lie.

    `normals` (H, W, 3) where they are known; see `occlusion_orders`. Ignored are edges whose foreground is `masked`
    (H, W) and those of fewer than `min_length_px` connected pixels. Raises InputError as `occlusion_orders`.
    """
    orders = occlusion_orders(depth_m, camera, min_jump_m=min_jump_m, relative_jump=relative_jump, normals=normals)
    maps = side_maps(orders)
    kept = without_short(maps if masked is None else maps & ~np.asarray(masked, bool), min_length_px)

    def outlines(chosen: Bool) -> ImageEdges:
        uv, side = edges_from_maps(chosen)
        return ImageEdges(uv + 0.5 * _STEP[side], side)

    return EdgeTruth(outlines(kept), outlines(maps & ~kept))


@dataclass(frozen=True, eq=False)
class Judged:
    """The predictions of one image, judged: `weight` (N,), `hit` (N,) which are right, `counted` (N,) which count.

    `truth` is the number of true edges. Predictions of ignored edges do not count. For every threshold the
    hits among the predictions above it are the maximum of all one-to-one matchings.
    """

    weight: Float
    hit: Bool
    counted: Bool
    truth: int

    def above(self, thresholds: Float) -> tuple[Float, Float]:
        """Return how many are right and how many are predicted, each (K,), at or above each threshold (K,)."""
        hit, counted = (
            np.array(rows.sum() - np.searchsorted(np.sort(self.weight[rows]), thresholds), np.float64)
            for rows in (self.hit, self.counted)
        )
        return hit, counted


def judge_boundary(found: ImageEdges, truth: EdgeTruth, reach_px: float) -> tuple[Judged, Judged]:
    """Return two judgements of the edge pixels: is there an edge within `reach_px`, and is its direction right, too?

    Edges are made pixels as described at the top of this module; points that share a pixel are one prediction, with
    the largest of their weights. Edges without a direction agree with all, which makes the second worthless for them.
    """
    pixel, direction, weight = _edge_pixels(found)
    true_pixel, true_direction, _ = _edge_pixels(truth.edges)
    pairs = pairs_within(pixel, true_pixel, reach_px)
    ignored = _is_nearer(pixel, _edge_pixels(truth.ignored)[0], true_pixel, reach_px)
    agrees = np.einsum("ei,ei->e", direction[pairs.row], true_direction[pairs.column]) >= 0
    nearest, nearest_agreeing = np.full(len(pixel), np.inf), np.full(len(pixel), np.inf)
    np.minimum.at(nearest, pairs.row, pairs.distance_px)
    np.minimum.at(nearest_agreeing, pairs.row[agrees], pairs.distance_px[agrees])
    well_directed = nearest_agreeing <= nearest
    return (
        _judged(pairs, weight, ignored),
        _judged(pairs.select(agrees & well_directed[pairs.row]), weight, ignored),
    )


def judge_sides(found: ImageEdges, truth: EdgeTruth, reach_px: float = STRICT_PX) -> dict[Side, Judged]:
    """Return a judgement of the points of each of the four directions: is there a true one of its own within reach?"""
    judged = {}
    for side in SIDES:
        own, true, ignored = (edges.select(edges.side == side) for edges in (found, truth.edges, truth.ignored))
        pairs = pairs_within(own.uv, true.uv, reach_px)
        judged[side] = _judged(pairs, own.weight, _is_nearer(own.uv, ignored.uv, truth.edges.uv, reach_px))
    return judged


def together(judged: Iterable[Judged]) -> Judged:
    """Return the judgements of several images or directions as one."""
    parts = list(judged)
    weight, hit, counted = (
        np.concatenate([np.zeros(0, dtype), *(getattr(part, name) for part in parts)])
        for name, dtype in (("weight", np.float64), ("hit", np.bool_), ("counted", np.bool_))
    )
    return Judged(weight, hit, counted, sum(part.truth for part in parts))


def within(found: ImageEdges, edges: ImageEdges, reach_px: float = STRICT_PX) -> Bool:
    """Return which points (N,) have one of `edges` of their own side within reach; without a side, any of them."""
    near = np.zeros(len(found), bool)
    for side, rows in found.index.items():
        others = edges.uv if side is Side.NONE else edges.uv[edges.side == side]
        near[rows] = _is_near(found.uv[rows], others, reach_px)
    return near


def _edge_pixels(edges: ImageEdges) -> tuple[Float, Float, Float]:
    """Return the foreground pixels (N, 2) of edges, each once, their directions (N, 2) and weights (N,).

    The foreground pixel is the first one whose centre the outline encloses, so that points on the outline and points
    on the foreground pixel give the same.
    """
    step = _STEP[edges.side]
    uv = np.where(step < 0, np.ceil(edges.uv), np.where(step > 0, np.floor(edges.uv), np.rint(edges.uv)))
    uv += 0.0  # turns -0 into 0
    # Sides of a pixel count once, however many points there are.
    points, place = np.unique(np.column_stack([uv, edges.side]), axis=0, return_inverse=True)
    weight = np.zeros(len(points))
    np.maximum.at(weight, place.ravel(), edges.weight)
    pixel, place = np.unique(points[:, :2], axis=0, return_inverse=True)
    direction, strongest = np.zeros_like(pixel), np.zeros(len(pixel))
    np.add.at(direction, place.ravel(), _STEP[points[:, 2].astype(np.int64)])
    np.maximum.at(strongest, place.ravel(), weight)
    return pixel, direction, strongest


def _judged(pairs: Pairs, weight: Float, ignored: Bool) -> Judged:
    # Of equally confident predictions those that have no ignored edge to go to are matched first.
    group = 2 * np.searchsorted(THRESHOLDS, weight, side="right") + ~ignored
    hit = matched_rows(pairs, group)
    return Judged(weight, hit, hit | ~ignored, pairs.columns)


def _is_near(uv: Float, others: Float, reach_px: float) -> Bool:
    return np.asarray(_distance(uv, others, reach_px) <= reach_px)


def _is_nearer(uv: Float, ignored: Float, true: Float, reach_px: float) -> Bool:
    """Return which points (N, 2) have an ignored point within reach, and no true one as near (of any direction)."""
    distance = _distance(uv, ignored, reach_px)
    return np.asarray((distance <= reach_px) & (distance < _distance(uv, true, reach_px)))


def _distance(uv: Float, others: Float, reach_px: float) -> Float:
    """Return the distance (N,) to the nearest of other points, infinite beyond reach."""
    if not len(uv) or not len(others):
        return np.full(len(uv), np.inf)
    distance, _ = cKDTree(others).query(uv, distance_upper_bound=np.nextafter(reach_px, np.inf))
    return np.asarray(distance)


@dataclass(frozen=True)
class Score:
    """Figures of a set of images; all are 0 where nothing was predicted, NaN where nothing is true.

    `ods` is the best F over one threshold for the whole set, at `threshold`, where `precision` and `recall` are
    reached; `ois` the F with the best threshold of each image; `ap` the average precision.
    """

    ods: float
    ois: float
    ap: float
    threshold: float
    precision: float
    recall: float


def score(precise: Sequence[Judged], recalled: Sequence[Judged] | None = None) -> Score:
    """Return the figures of a set of images with precision from `precise` and recall from `recalled` (default: same).

    The papers' oriented figures take precision from directed hits, but recall from hits of any direction (OPR); with
    one argument both are of the same hits. F is interpolated between thresholds, as in BSDS. For `ap` precision is
    interpolated over recall 0, 0.01, ..., 1 and is 0 beyond what is reached; below the smallest recall that is
    reached it stays what it is there (dropping edges at random keeps it), where BSDS has 0: extractors that give all
    edges one weight would get nothing.
    """
    recalled = precise if recalled is None else recalled
    truth = sum(part.truth for part in recalled)
    if not truth:
        return Score(*(float("nan"),) * 6)
    pairs = list(zip(precise, recalled, strict=True))
    # (images, 3, K): right, predicted, recalled.
    counts = np.array([(*own.above(THRESHOLDS), other.above(THRESHOLDS)[0]) for own, other in pairs])
    total = counts.sum(axis=0)
    reached = total[1] > 0
    if not reached.any():
        return Score(*(0.0,) * 6)
    precision, recall = total[0, reached] / total[1, reached], total[2, reached] / truth
    threshold, precision_there, recall_there = _best(THRESHOLDS[reached], precision, recall)

    best = np.zeros(3)
    for image, (_, other) in zip(counts, pairs, strict=True):
        own_precision, own_recall = image[0] / np.maximum(image[1], 1), image[2] / max(other.truth, 1)
        best += image[:, np.argmax(_f(own_precision, own_recall))]
    best_f = float(_f(best[0] / max(best[1], 1.0), best[2] / truth))

    return Score(
        float(_f(precision_there, recall_there)),
        best_f,
        _average_precision(precision, recall),
        threshold,
        precision_there,
        recall_there,
    )


def precision_recall(judged: Judged, threshold: float = 0.0) -> tuple[float, float]:
    """Return precision and recall at a threshold; by default of all predictions. NaN is 0 of 0."""
    hit, predicted = (float(n[0]) for n in judged.above(np.array([threshold])))
    return (hit / predicted if predicted else float("nan")), (hit / judged.truth if judged.truth else float("nan"))


def _f(precision: Float | float, recall: Float | float) -> Float:
    """Return the harmonic mean, 0 where both are 0."""
    return np.asarray(2 * precision * recall / np.maximum(precision + recall, 1e-300))


def _best(thresholds: Float, precision: Float, recall: Float) -> tuple[float, float, float]:
    """Return threshold, precision and recall of the best F, linearly interpolated between thresholds."""
    fine = np.linspace(0, len(thresholds) - 1, 100 * (len(thresholds) - 1) + 1)
    t, p, r = (np.interp(fine, np.arange(len(thresholds)), values) for values in (thresholds, precision, recall))
    at = int(np.argmax(_f(p, r)))
    return float(t[at]), float(p[at]), float(r[at])


def _average_precision(precision: Float, recall: Float) -> float:
    levels, place = np.unique(recall, return_inverse=True)
    best = np.zeros(len(levels))
    np.maximum.at(best, place.ravel(), precision)
    return float(np.interp(np.arange(101) / 100, levels, best, right=0.0).mean())


@dataclass(frozen=True, eq=False)
class AgainstLidar:
    """Image edges and LiDAR edges of one or several views at a pose.

    Of LiDAR edges that the camera sees: `lidar_side` (M,), `found` (M,) which have an image edge of their side near,
    `offset_px` (M,) LiDAR minus nearest image edge, along x for L and R, along y for U and B, NaN without a pair. Of
    image edges where the LiDAR could see them: `image_side` (N,), `weight` (N,), `confirmed` (N,) which have a LiDAR
    edge of their side near.
    """

    lidar_side: Int8
    found: Bool
    offset_px: Float
    image_side: Int8
    weight: Float
    confirmed: Bool

    @classmethod
    def joined(cls, parts: Sequence[AgainstLidar]) -> AgainstLidar:
        """Return the edges of at least one view as one."""
        names = ("lidar_side", "found", "offset_px", "image_side", "weight", "confirmed")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def of(self, side: Side) -> AgainstLidar:
        """Return the edges of one direction; image edges without a direction count for each."""
        lidar = self.lidar_side == side
        image = (self.image_side == side) | (self.image_side == Side.NONE)
        return AgainstLidar(
            self.lidar_side[lidar],
            self.found[lidar],
            self.offset_px[lidar],
            self.image_side[image],
            self.weight[image],
            self.confirmed[image],
        )


def seen_by_camera(view: View, camera_from_lidar: Float) -> View:
    """Return the view with the LiDAR edges that the camera sees at a pose (4, 4), their sides told in image axes."""
    view = view.as_seen_from(camera_from_lidar)
    edges, surface = view.cloud_edges, view.cloud.points
    keep = view.camera.in_image(view.camera.project(se3.apply(camera_from_lidar, edges.xyz)))
    if surface is not None:
        keep &= ~hidden(edges.xyz, surface, view.camera, camera_from_lidar)
    return View(view.name, view.camera, view.image, type(view.cloud)(edges.select(keep), surface))


def against_lidar(
    view: View,
    camera_from_lidar: Float,
    *,
    returns: Float | None = None,
    near_px: float = NEAR_PX,
    pair_px: float = 5.0,
    cover_px: float = 8.0,
) -> AgainstLidar:
    """Return how the edges of both sensors meet at the true pose (4, 4), within `near_px`.

    The LiDAR could see an image edge if one of its `returns` (K, 3), by default the view's surface points, lies within
    `cover_px` of it and, if the edge has a direction, of the place `cover_px` further towards its background: against
    the sky there is no second return, and so no LiDAR edge. Signed distances are those of pairs nearer than `pair_px`.
    Image edges without a direction meet LiDAR edges of any. Raises InputError without returns.
    """
    surface = view.cloud.points if returns is None else returns
    if surface is None:
        raise InputError("no LiDAR returns", where=view.name, expected="returns (K, 3), or a view with surface points")
    view = seen_by_camera(view, camera_from_lidar)
    image, camera = view.image_edges, view.camera
    lidar_uv = camera.project(se3.apply(camera_from_lidar, view.cloud_edges.xyz))
    lidar = ImageEdges(lidar_uv, view.cloud_edges.side)

    found, offset = np.zeros(len(lidar), bool), np.full(len(lidar), np.nan)
    for side, rows in lidar.index.items():
        mine = image.uv[(image.side == side) | (image.side == Side.NONE)]
        if not len(mine):
            continue
        distance, nearest = cKDTree(mine).query(lidar.uv[rows])
        found[rows] = distance <= near_px
        axis = 1 if side in (Side.UPPER, Side.BOTTOM) else 0
        signed = lidar.uv[rows, axis] - mine[nearest, axis]
        offset[rows] = np.where(distance < pair_px, signed, np.nan)

    uv = camera.project(se3.apply(camera_from_lidar, surface))
    uv = uv[camera.in_image(uv, 2 * cover_px)]
    covered = _is_near(image.uv, uv, cover_px) & _is_near(image.uv + cover_px * _STEP[image.side], uv, cover_px)
    image = image.select(covered)
    return AgainstLidar(lidar.side, found, offset, image.side, image.weight, within(image, lidar, near_px))
