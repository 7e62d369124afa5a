"""A plugin of the tests: line segments of image and sweep as features of their own, with residuals of their own."""

from dataclasses import dataclass, replace

import numpy as np
import p2o

LEAST_PX, GAP, FIT_M = 8.0, 0.08, 0.03  # shortest segment, least jump as a share of the range, deviation from a line


@dataclass(frozen=True, eq=False)
class ImageLines(p2o.ImageFeature):
    """Segments of the image: `ends` (N, 2, 2) px."""

    word = "image-lines"
    ends: np.ndarray

    def __len__(self):
        return len(self.ends)

    def select(self, keep):
        return replace(self, ends=self.ends[keep])


@dataclass(frozen=True, eq=False)
class CloudLines(p2o.CloudFeature):
    """Segments of the sweep: `ends` (N, 2, 3) m in the LiDAR frame."""

    word = "cloud-lines"
    ends: np.ndarray
    __len__, select = ImageLines.__len__, ImageLines.select

    def moved(self, b_from_lidar):
        return replace(self, ends=p2o.se3.apply(b_from_lidar, self.ends))


def lsd(picture):
    """Return the segments (N, 2, 2), not too short, that OpenCV finds in a picture (H, W) of 0 to 255."""
    import cv2

    found = cv2.createLineSegmentDetector().detect(np.array(picture, np.uint8))[0]
    ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(float)
    return ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= LEAST_PX]


def rows_of_pulses(cloud):
    """Return the points (rings, columns, 3) m as a picture, the top ring first; infinite where nothing came back."""
    ring, size = np.unique(cloud.ring, return_inverse=True, return_counts=True)[1:]
    distance, azimuth = np.linalg.norm(cloud.xyz, axis=1), np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])
    turns = np.sort(azimuth[ring == size.argmax()])
    step = np.median(np.diff(turns, append=turns[0] + 2 * np.pi))
    column = np.round((turns[0] - azimuth) / step).astype(int)
    rank = np.argsort(np.argsort(-np.bincount(ring, cloud.xyz[:, 2] / distance) / size))[ring]
    cells, far_first = np.full((len(size), round(2 * np.pi / step)), -1), np.argsort(-distance)
    cells[rank[far_first], column[far_first] % cells.shape[1]] = far_first
    return np.append(cloud.xyz, np.full((1, 3), np.inf), axis=0)[cells]


def lifted(picture, ends):
    """Return the segment (2, 3) m on the near side of a jump of the range, from one of the picture, if there is one."""
    along = ends[1] - ends[0]
    across = np.arange(-2, 3)[:, None] * (np.abs(along) < np.abs(along).max())
    at = ends[0] + np.linspace(0, 1, int(np.abs(along).max()) + 1)[:, None] * along
    u, v = np.moveaxis(np.round(at).astype(int)[:, None] + across, 2, 0)
    beside = picture[np.clip(v, 0, len(picture) - 1), u % picture.shape[1]]
    ranges = np.minimum(np.linalg.norm(beside, axis=2), 1e3)
    jump = np.abs(np.diff(np.log(ranges)))
    row, pair = np.arange(len(at))[:, None], jump.argmax(axis=1)[:, None] + [0, 1]
    # Between the last pulse on the near surface and the first beside it.
    xyz = ranges[row, pair].min(axis=1, keepdims=True) * (beside / ranges[..., None])[row, pair].mean(axis=1)
    xyz = xyz[(jump.max(axis=1) > GAP) & np.isfinite(xyz).all(axis=1)]
    for _ in range(3 if len(xyz) > 3 else 0):
        centre, axis = xyz.mean(axis=0), np.linalg.svd(xyz - xyz.mean(axis=0))[2][0]
        reach = (xyz - centre) @ axis
        off = np.linalg.norm(xyz - centre - reach[:, None] * axis, axis=1)
        xyz = xyz[off <= max(2 * np.median(off), FIT_M)]
    return [centre + np.outer([reach.min(), reach.max()], axis)] if len(xyz) > 3 and np.median(off) <= FIT_M else []


def cloud_lines(cloud):
    """Return the segments along jumps of the range: found in a picture of it, fitted to the near side."""
    picture = rows_of_pulses(cloud)
    found = lsd(np.clip(60 * np.log(np.linalg.norm(picture, axis=2)), 0, 255))
    lines = np.reshape([line for ends in found for line in lifted(picture, ends)], (-1, 2, 3))
    return p2o.CloudFeatures(features=[CloudLines(lines)])


@dataclass(frozen=True, eq=False)
class PointsOnLines(p2o.solving.LeastSquares):
    """Points with lines of the picture: `rows` (K, 7) hold xyz m, unit normal, offset px and number of the view."""

    rows: np.ndarray
    cameras: list
    huber, far = 2.0, 100.0
    weight = property(lambda self: np.ones(len(self.rows)))
    frame = property(lambda self: self.rows[:, 6].astype(int))

    def residuals(self, camera_from_lidar):
        xyz = p2o.se3.apply(camera_from_lidar, self.rows[:, :3])
        uv = [camera.project(xyz[..., self.frame == view, :]) for view, camera in enumerate(self.cameras)]
        return (np.concatenate(uv, axis=-2) * self.rows[:, 3:5]).sum(axis=-1) - self.rows[:, 5]


class Options(p2o.Options):
    max_angle_deg: float = p2o.field(10.0, gt=0, le=90, help="Largest angle between segments that are paired.")


def paired(view, pose, reach_px, number, max_angle_deg):
    """Return rows (K, 7) of `PointsOnLines`: five points of each segment that has one of its direction near by."""
    image, cloud = view.get("image-lines"), view.get("cloud-lines")
    if not image or not cloud:
        return np.zeros((0, 7))
    uv, at = view.camera.project(p2o.se3.apply(pose, cloud.ends)), image.ends.mean(axis=1)
    along, turn = (ends[:, 1] - ends[:, 0] for ends in (image.ends, uv))
    length, turn = np.linalg.norm(along, axis=1), turn / np.linalg.norm(turn, axis=1, keepdims=True)
    normal = along[:, ::-1] * [-1, 1] / length[:, None]
    line = np.column_stack([normal, (normal * at).sum(axis=1), np.full(len(at), number)])
    off = np.abs(uv @ normal.T - line[:, 2]).max(axis=1)  # (cloud, image)
    good = (off <= reach_px) & (np.abs(turn @ normal.T) <= np.sin(np.radians(max_angle_deg)))
    good &= np.linalg.norm(uv.mean(axis=1)[:, None] - at, axis=2) <= length / 2 + reach_px
    rows = np.flatnonzero(good.any(axis=1) & view.camera.in_image(uv).all(axis=1))
    line = line[np.where(good, off, np.inf)[rows].argmin(axis=1)]
    points = [(1 - share) * cloud.ends[rows, 0] + share * cloud.ends[rows, 1] for share in np.linspace(0, 1, 5)]
    return np.column_stack([np.concatenate(points), np.tile(line, (5, 1))])


def build(options):
    def match(views, *near):
        rows = [paired(view, *near, i, options.max_angle_deg) for i, view in enumerate(views)]
        return PointsOnLines(np.concatenate(rows), [view.camera for view in views])

    return match


@p2o.hookimpl
def p2o_image_extractors():
    image_lines = lambda _: lambda image: p2o.ImageFeatures(features=[ImageLines(lsd(image.grey))])  # noqa: E731
    yield p2o.Method(name="segments", build=image_lines, summary="Segments of the picture.", gives={"image-lines"})


@p2o.hookimpl
def p2o_cloud_extractors():
    words = {"summary": "Segments along jumps of the range.", "needs": {"rings"}, "gives": {"cloud-lines"}}
    yield p2o.Method(name="jumps", build=lambda _: cloud_lines, **words)


@p2o.hookimpl
def p2o_matchers():
    words = {"summary": "Nearest segments.", "needs": {"image-lines", "cloud-lines"}, "gives": {"residuals"}}
    yield p2o.Method(name="segments", build=build, options=Options, **words)
