"""Maximise the consistency of points within each mask: `mask-consistency`, after CalibAnything.

    p2o run --extractor masks/attributes --matcher mask-consistency --solver random-shrink --init given
            --set pipeline.rounds=1

Each mask has three scores of the points projected into it, and each frame costs 2 - 0.3 S_n - 0.2 S_r - 0.5 S_s -
0.0001 (number of valid masks), where the scores are means over masks weighted by points: S_n is the mean |n_a . n_b|
over all pairs of normals, S_r one minus the standard deviation of reflectance, S_s the sum of the segments' shares,
largest first, times 1, 1/2, 1/4 and so on. A mask is valid with at least 10 points and a tenth of the points expected
for its size. A frame costs 2 without valid masks, or if the lowest tenth of the image covered by points has less than a
tenth of the usual density.

Departures from the paper and its code (OpenCalib/CalibAnything): masks are OpenCV's graph segments if `masks` names no
folder (the paper uses SAM); normals are counted in cells of about 15 deg, each with the mean direction of its normals,
so that S_n is exact for flat surfaces and has an error of some thousandths elsewhere; segments beyond the sixth largest
of a mask are ignored in S_s (they have 1/64 of the weight or less); at most 8000 points are used; the image rows
covered by points are measured, in the original they are a setting. The weights, and all thresholds not named above, are
those of the code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Float, Int, field
from p2o.solving import Objective

from p2o_baselines.segments.cloud_segments import CloudSegments
from p2o_baselines.segments.masks import ImageMasks, masks_of, read_masks

_MARGIN_PX = 300.0  # points so far outside of the image may be brought in by another pose (code)
_LARGEST = 6  # number of segments of a mask that S_s evaluates
_AT_ONCE = 1 << 18  # number of points of several poses that are sampled in one call
_MASK_WEIGHT = 1e-4  # reduction of the cost for each valid mask
_LEAST_POINTS = 10  # masks with fewer points do not count
_LEAST_DENSITY = 0.1  # masks with a smaller share of the usual density are ignored
_POINTS = 8000  # largest number of points per frame, evenly sampled
_NORMAL_WEIGHT = 0.3  # weight of the agreement of normals
_STRENGTH_WEIGHT = 0.2  # weight of the agreement of reflectance
_SEGMENT_WEIGHT = 0.5  # weight of the agreement of segments


class MaskOptions(p2o.Options):
    """Options of `mask-consistency`."""

    masks: str = field("", help="Folder of masks instead of the extractor's: NAME.png, or NAME/*.png with one each.")


@dataclass(frozen=True)
class Scores:
    """Agreement (..., M) of the points of each of M masks, 0 to 1, and the number of points (..., M)."""

    normal: Float
    strength: Float
    segment: Float
    count: Float
    segmented: Float


def scores_of(cell: Float, cosines: Float, strength: Float, squared: Float, segment: Float) -> Scores:
    """Return the agreement of masks from points by direction cell (..., M, K), reflectance, and segment."""
    count = cell.sum(axis=-1)
    many = np.maximum(count, 1.0)
    normal = np.sum((cell @ cosines) * cell, axis=-1) / many**2
    mean = strength / many
    deviation = np.sqrt(np.maximum(squared / many - mean**2, 0.0))
    segmented = segment.sum(axis=-1)
    most = min(_LARGEST, segment.shape[-1])
    largest = np.sort(np.partition(segment, segment.shape[-1] - most, axis=-1)[..., -most:], axis=-1)[..., ::-1]
    single = largest @ 0.5 ** np.arange(most) / np.maximum(segmented, 1.0)
    return Scores(normal, 1.0 - deviation, single, count, segmented)


def cells_of(normal: Float, across: int = 6) -> tuple[Int, Float]:
    """Return the direction cell (N,) of each normal (N, 3) on a cube, up to its sign, and |n_a . n_b| of all cells."""
    axis = np.argmax(np.abs(normal), axis=1)
    rows = np.arange(len(normal))
    upright = normal * np.where(normal[rows, axis] < 0, -1.0, 1.0)[:, None]
    high = np.maximum(upright[rows, axis], 1e-12)
    angles = (np.arctan(upright[rows, (axis + step) % 3] / high) / (np.pi / 2) for step in (1, 2))
    u, v = (np.clip(((angle + 0.5) * across).astype(np.int64), 0, across - 1) for angle in angles)
    _, cell = np.unique((axis * across + u) * across + v, return_inverse=True)
    count = int(cell.max(initial=0)) + 1
    mean = np.stack([np.bincount(cell, upright[:, k], count) for k in range(3)], axis=1)
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    return cell, np.minimum(np.abs(mean @ mean.T), 1.0)


@dataclass(frozen=True, eq=False)
class MaskedView:
    """One frame: masks, points, their usual number per pixel, and the rows (2,) of the lowest tenth they cover."""

    camera: p2o.Camera
    masks: ImageMasks
    points: CloudSegments
    cell: Int
    cosines: Float
    segment: Int
    segments: int
    per_px: float
    floor_v: tuple[float, float]

    @classmethod
    def of(cls, camera: p2o.Camera, masks: ImageMasks, points: CloudSegments, pose: Float) -> MaskedView | None:
        """Return the frame projected at a pose; None if no point is in the image."""
        near = camera.in_image(camera.project(p2o.se3.apply(pose, points.xyz)), _MARGIN_PX)
        points = points.select(near).thinned(_POINTS)
        uv = camera.project(p2o.se3.apply(pose, points.xyz)) if len(points) else np.zeros((0, 2))
        v = uv[camera.in_image(uv), 1]
        if not len(v):
            return None
        top, bottom = np.quantile(v, [0.01, 0.99])
        per_px = len(v) / max((bottom - top) * camera.width, 1.0)
        floor = (bottom - 0.1 * camera.height, bottom)
        known, number = np.unique(points.segment, return_inverse=True)
        none = int(known[0] == -1)
        segments = max(len(known) - none, 1)
        cell, cosines = cells_of(points.normal)
        return cls(camera, masks, points, cell, cosines, number - none, segments, per_px, floor)

    def cost(self, poses: Float) -> Float:
        """Return the cost (B,) of poses (B, 4, 4)."""
        size = max(1, _AT_ONCE // len(self.points))
        return np.concatenate([self._cost(poses[i : i + size]) for i in range(0, len(poses), size)])

    def scores(self, poses: Float) -> tuple[Scores, Float]:
        """Return the agreement of each mask at poses (B, 4, 4), and how many points (B,) are in the lowest tenth."""
        uv = self.camera.project(p2o.se3.apply(poses, self.points.xyz))
        inside = self.camera.in_image(uv)
        pose, point = np.nonzero(inside)
        u, v = np.rint(uv[inside]).astype(np.int64).T
        height, width = self.masks.labels.shape[:2]
        label = self.masks.labels[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
        low, high = self.floor_v
        floor = np.bincount(pose[(v > low) & (v < high)], minlength=len(poses)).astype(np.float64)
        row, layer = np.nonzero(label >= 0)
        group, point = pose[row] * len(self.masks) + label[row, layer], point[row]
        shape = (len(poses), len(self.masks))

        def summed(values: Float | None, place: Int = group, *count: int) -> Float:
            total = np.bincount(place, values, int(np.prod((*shape, *count))))
            return total.astype(np.float64).reshape(*shape, *count)

        strength, segment, kinds = self.points.strength[point], self.segment[point], len(self.cosines)
        known = segment >= 0
        cell = summed(None, group * kinds + self.cell[point], kinds)
        by_segment = summed(None, group[known] * self.segments + segment[known], self.segments)
        return scores_of(cell, self.cosines, summed(strength), summed(strength**2), by_segment), floor

    def _cost(self, poses: Float) -> Float:
        scores, floor = self.scores(poses)
        usual = self.masks.area_px * self.per_px
        counts = (scores.count >= _LEAST_POINTS) & (scores.count >= _LEAST_DENSITY * usual)
        weight, segmented = np.where(counts, scores.count, 0.0), np.where(counts, scores.segmented, 0.0)
        total, per_mask = weight.sum(axis=1), segmented.sum(axis=1)
        gain = _NORMAL_WEIGHT * np.sum(scores.normal * weight, axis=1)
        gain += _STRENGTH_WEIGHT * np.sum(scores.strength * weight, axis=1)
        gain /= np.maximum(total, 1.0)
        gain += _SEGMENT_WEIGHT * np.sum(scores.segment * segmented, axis=1) / np.maximum(per_mask, 1.0)
        gain += _MASK_WEIGHT * counts.sum(axis=1)
        enough = floor >= 0.1 * self.per_px * 0.1 * self.camera.height * self.camera.width
        return np.asarray(np.where((total > 0) & (per_mask > 0) & enough, 2.0 - gain, 2.0))


def build(options: MaskOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: the mean cost of the frames."""
    read: dict[tuple[str, tuple[int, int]], ImageMasks] = {}

    def masks(view: p2o.View) -> ImageMasks | None:
        if not options.masks:
            shapes = view.get(ImageMasks.word)
            assert shapes is None or isinstance(shapes, ImageMasks)
            return shapes
        shape = (view.camera.height, view.camera.width)
        if (view.name, shape) not in read:
            least_px = min(shape[0] * shape[1] / 1200, 2000)
            read[view.name, shape] = masks_of(read_masks(options.masks, view.name, shape), shape, 255, least_px)
        return read[view.name, shape]

    def masked(view: p2o.View, pose: Float) -> MaskedView | None:
        shapes, points = masks(view), view.get(CloudSegments.word)
        if shapes is None or points is None or not len(shapes):
            return None
        return MaskedView.of(view.camera, shapes, points, pose)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        known = [masked(view, camera_from_lidar) for view in views]

        def cost(poses: Float) -> Float:
            costs = [np.full(len(poses), 2.0) if each is None else each.cost(poses) for each in known]
            return np.asarray(np.mean(costs, axis=0))

        return Objective(cost)

    return match


METHOD = p2o.Method(
    name="mask-consistency",
    build=build,
    options=MaskOptions,
    summary="Points within one mask of the image agree in normal, reflectance and segment.",
    needs={"image-masks", "cloud-segments"},
    gives={"objective"},
    cite="Luo et al., Calib-Anything: zero-training LiDAR-camera extrinsic calibration, arXiv 2306.02656, 2023",
)
