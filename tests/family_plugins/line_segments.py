"""A plugin of the tests: line segments of image and sweep as features of their own, with residuals of their own."""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import p2o

WORDS = ("image-lines", "cloud-lines")


@dataclass(frozen=True, eq=False)
class ImageLines(p2o.ImageFeature):
    """Segments of the image: `ends` (N, 2, 2) px."""

    word: ClassVar[str] = "image-lines"
    ends: np.ndarray

    def __len__(self):
        return len(self.ends)

    def select(self, keep):
        """Return the segments of a mask or index."""
        return replace(self, ends=self.ends[keep])


@dataclass(frozen=True, eq=False)
class CloudLines(p2o.CloudFeature):
    """Segments of the sweep: `ends` (N, 2, 3) m in the LiDAR frame."""

    word: ClassVar[str] = "cloud-lines"
    ends: np.ndarray
    __len__, select = ImageLines.__len__, ImageLines.select

    def moved(self, b_from_lidar):
        """Return the segments in another frame b, by a (4, 4) rigid transform."""
        return CloudLines(p2o.se3.apply(b_from_lidar, self.ends))


class Options(p2o.Options):
    """Options of the two extractors and of the matcher."""

    least_px: float = p2o.field(8.0, gt=1, le=1000, help="Shortest segment, in pixels of the picture it is found in.")
    gap: float = p2o.field(0.08, gt=0, le=2, help="Least jump of the range across a segment, as a share of it.")
    fit_m: float = p2o.field(0.03, gt=0, le=1, help="Median distance of points from their line, at most.")
    max_angle_deg: float = p2o.field(10.0, gt=0, le=90, help="Largest angle between segments that are paired.")


Method = partial(p2o.Method, options=Options)


def lsd(picture, least_px):
    """Return the segments (N, 2, 2) of at least such a length that OpenCV finds in a picture (H, W) uint8."""
    import cv2

    found = cv2.createLineSegmentDetector().detect(picture)[0]
    ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(float)
    return ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= least_px]


def range_picture(cloud):
    """Return ranges (rings, columns) m, inf for none, and unit directions (rings, columns, 3); the top ring first."""
    ring, size = np.unique(cloud.ring, return_inverse=True, return_counts=True)[1:]
    distance, azimuth = np.linalg.norm(cloud.xyz, axis=1), np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    up = np.bincount(ring, cloud.xyz[:, 2] / distance) / size
    turns = np.sort(azimuth[ring == size.argmax()])
    step = np.median(np.diff(turns)) if len(turns) > 1 else 2 * np.pi
    picture = np.full((len(up), round(2 * np.pi / step)), np.inf)
    first = np.pi + turns[0] % step
    column = np.round((first - azimuth) / step).astype(int) % picture.shape[1]
    np.minimum.at(picture, (np.argsort(np.argsort(-up))[ring], column), distance)
    turn, up = first - np.arange(picture.shape[1]) * step, np.sort(up)[::-1, None]
    flat = np.sqrt(1 - up**2)
    return picture, np.stack(np.broadcast_arrays(flat * np.cos(turn), flat * np.sin(turn), up), axis=-1)


def lifted(picture, directions, ends, options):
    """Return the segment (2, 3) m on the near side of a jump of the range, from one of the picture, or None."""
    along = ends[1] - ends[0]
    across = np.arange(-2, 3)[:, None] * ([0, 1] if abs(along[0]) > abs(along[1]) else [1, 0])
    at = ends[0] + np.linspace(0, 1, int(np.abs(along).max()) + 1)[:, None] * along
    cells = np.clip(np.round(at).astype(int)[:, None] + across, 0, np.array(picture.shape)[::-1] - 1)
    ranges, seen = (a[cells[..., 1], cells[..., 0]] for a in (picture, directions))
    jump = np.abs(np.diff(np.log(np.minimum(ranges, 1e3)), axis=1))
    row, place = np.arange(len(at)), jump.argmax(axis=1)
    near = np.minimum(ranges[row, place], ranges[row, place + 1])
    # The edge lies between the last pulse on the near surface and the first beside it.
    middle = (seen[row, place] + seen[row, place + 1]) / 2
    xyz = (near[:, None] * middle)[(jump[row, place] > options.gap) & np.isfinite(near)]
    for _ in range(3):
        if len(xyz) < options.least_px / 2:
            return None
        centre = xyz.mean(axis=0)
        axis = np.linalg.svd(xyz - centre)[2][0]
        reach = (xyz - centre) @ axis
        off = np.linalg.norm(xyz - centre - reach[:, None] * axis, axis=1)
        xyz = xyz[off <= max(2 * np.median(off), options.fit_m)]
    return centre + np.outer([reach.min(), reach.max()], axis) if np.median(off) <= options.fit_m else None


def build_image(options):
    """Return the extractor of segments of the picture."""
    return lambda image: p2o.ImageFeatures(features=[ImageLines(lsd(np.array(image.grey), options.least_px))])


def build_cloud(options):
    """Return the extractor of segments along jumps of the range: found in its picture, fitted to the near side."""

    def extract(cloud):
        seen = range_picture(cloud)
        found = lsd(np.clip(60 * np.log(np.minimum(seen[0], 100)), 0, 255).astype(np.uint8), options.least_px)
        lines = [line for ends in found if (line := lifted(*seen, ends, options)) is not None]
        return p2o.CloudFeatures(features=[CloudLines(np.array(lines).reshape(-1, 2, 3))])

    return extract


@dataclass(frozen=True, eq=False)
class PointsOnLines(p2o.LeastSquares):
    """Points of segments of the sweep with lines of the picture: `rows` (K, 6) xyz m, unit normal, offset px."""

    rows: np.ndarray
    frame: np.ndarray
    cameras: list
    huber, far = 2.0, 100.0
    weight = property(lambda self: np.ones(len(self.rows)))

    def residuals(self, camera_from_lidar):
        """Return the distance in px of each projected point from its line, (K,) or (B, K); NaN where unseen."""
        xyz, out = p2o.se3.apply(camera_from_lidar, self.rows[:, :3]), []
        for number, camera in enumerate(self.cameras):
            mine = self.frame == number
            out.append((camera.project(xyz[..., mine, :]) * self.rows[mine, 3:5]).sum(-1) - self.rows[mine, 5])
        return np.concatenate(out, axis=-1)


def paired(view, pose, reach_px, options):
    """Return rows (K, 6) of `PointsOnLines`: five points of each segment that has one of its direction near by."""
    image, cloud = (np.zeros((0, 2, 2 + i)) if f is None else f.ends for i, f in enumerate(map(view.get, WORDS)))
    uv = view.camera.project(p2o.se3.apply(pose, cloud))
    along = image[:, 1] - image[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    normal = along[:, ::-1] * [-1, 1]
    offset = (normal * image[:, 0]).sum(axis=1)
    turn = (uv[:, 1] - uv[:, 0]) / np.linalg.norm(uv[:, 1] - uv[:, 0], axis=1, keepdims=True)
    off = np.abs(uv @ normal.T - offset).max(axis=1)  # (cloud, image)
    beside = np.abs(uv.mean(axis=1) @ along.T - (along * image.mean(axis=1)).sum(axis=1))
    good = (off <= reach_px) & (beside <= length / 2 + reach_px)
    good &= np.abs(turn @ normal.T) <= np.sin(np.radians(options.max_angle_deg))
    rows = np.flatnonzero(good.any(axis=1) & view.camera.in_image(uv).all(axis=1))
    best = np.where(good, off, np.inf)[rows].argmin(axis=1) if len(rows) else rows
    share = np.linspace(0, 1, 5)[:, None, None]
    points = (1 - share) * cloud[rows, 0] + share * cloud[rows, 1]
    line = np.broadcast_to(np.column_stack([normal, offset])[best], points.shape)
    return np.concatenate([points, line], axis=2).reshape(-1, 6)


def build_matcher(options):
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> PointsOnLines`."""

    def match(views, pose, reach_px):
        found = [paired(view, pose, reach_px, options) for view in views]
        frame = np.repeat(np.arange(len(views)), [len(rows) for rows in found])
        return PointsOnLines(np.concatenate(found), frame, [view.camera for view in views])

    return match


@p2o.hookimpl
def p2o_image_extractors():
    yield Method(name="image-segments", build=build_image, summary="Segments of the picture.", gives=WORDS[:1])


@p2o.hookimpl
def p2o_cloud_extractors():
    words = {"summary": "Segments along jumps of the range.", "needs": {"rings"}, "gives": WORDS[1:]}
    yield Method(name="range-segments", build=build_cloud, **words)


@p2o.hookimpl
def p2o_matchers():
    yield Method(name="segments", build=build_matcher, summary="Nearest segments.", needs=WORDS, gives={"residuals"})
