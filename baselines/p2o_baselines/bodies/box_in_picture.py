"""Detect boxes in an image of any camera: the six corners of their outline and the nearest corner inside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import p2o
from p2o import Box, Camera, Float, Int, se3

from p2o_baselines.bodies.box_in_sweep import around, near_corner, symmetries
from p2o_baselines.bodies.colour_regions import Region, Single, at_border, linear_light, regions, step_at

_LEAST_AREA_PX = 900.0
_REACH_PX, _STEPS_A_PX = 5.0, 4
_ENDS = 0.08  # this share of an edge is left out at either end, where another edge is near
_LEAST_PLACES, _LEAST_SHARE = 6, 0.35
"""Least number of samples of an edge, and least share of them, with a colour step on one line."""
_LEAST_SIDES, _ROUGH_PX = 4, 1.5
"""Least number of the outline's six sides that are detected as edges; the others are those of the region."""
_MOST_ROUGH_PX, _MOST_RMS_PX, _FLOOR_PX = 4.0, 1.0, 0.1  # largest residual of corners at first, and in the end
_LEAST_CORNERS = 5
_SMOOTH = 5
_TOGETHER_PX = 5.0  # places nearer to each other than this share one error
_INNER_STEP = 0.003  # of linear light: tones of one colour may be near each other


@dataclass(frozen=True)
class Flat:
    """A pinhole view of a region, in which straight edges are straight: `flat_from_camera` (3, 3), `scale_px`."""

    flat_from_camera: Float
    scale_px: float

    def seen(self, xyz: Float) -> Float:
        """Return places (N, 2) px of points (N, 3) of the camera frame, about the middle of the region."""
        local = xyz @ self.flat_from_camera.T
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = self.scale_px * local[..., :2] / local[..., 2:]
        return np.asarray(np.where(local[..., 2:] > 1e-6, uv, np.nan))

    def rays(self, uv: Float) -> Float:
        """Return unit rays (..., 3) of places (..., 2) px."""
        local = np.concatenate([uv / self.scale_px, np.ones((*uv.shape[:-1], 1))], axis=-1)
        rays = local @ self.flat_from_camera
        return np.asarray(rays / np.linalg.norm(rays, axis=-1)[..., None])


@dataclass(frozen=True)
class Line:
    """A straight edge in a flat view through `at` along `along` (2,), with the deviations there and of direction."""

    at: Float
    along: Float
    across_px: float
    turn_rad: float

    @property
    def normal(self) -> Float:
        """The direction (2,) across it."""
        return np.array([-self.along[1], self.along[0]])


@dataclass(frozen=True)
class BoxInPicture:
    """A box in an image: the corners of its outline and, if its edges are visible, the nearest corner.

    `uv` (K, 2) px are corners in the view `flat`, `covariance` (K, 2, 2) px^2 theirs, `vertex` (K,) their numbers;
    `edges` are the three lines of the nearest corner, None if they are not visible. `camera_from_box` (4, 4) is the
    pose that fits the corners, to `rms_px`; the rotations of `symmetries` fit equally well.
    """

    target: Box
    flat: Flat
    uv: Float
    covariance: Float
    vertex: Int
    camera_from_box: Float
    rms_px: float
    edges: tuple[Line, Line, Line] | None

    @property
    def corner_rays(self) -> Float:
        """Unit rays (K, 3) of the corners in the camera frame."""
        return self.flat.rays(self.uv)


def boxes_in_picture(image: p2o.Image, targets: Sequence[p2o.Target]) -> tuple[BoxInPicture, ...]:
    """Return what may be boxes of `targets` in an image: regions of one colour whose outline is that of a corner."""
    sizes = list(dict.fromkeys(target for target in targets if isinstance(target, Box)))
    if not sizes:
        return ()
    light = linear_light(image.rgb)
    detected: list[BoxInPicture] = []
    for region in regions(image.rgb, _LEAST_AREA_PX):
        if any(box.edges is not None and _covers(box, image.camera, region) for box in detected):
            continue
        outline = _outline(light, image.camera, region)
        if outline is None:
            continue
        for size in sizes:
            box = _posed(light, image.camera, size, *outline)
            if box is None:
                continue
            same = [n for n, b in enumerate(detected) if b.target == size and _near(b, box)]
            if not same:
                detected.append(box)
            elif (len(box.uv), -box.rms_px) > (len(detected[same[0]].uv), -detected[same[0]].rms_px):
                detected[same[0]] = box
    return tuple(detected)


def _covers(box: BoxInPicture, camera: Camera, region: Region) -> bool:
    """Return whether a region is about the outline of a box that was detected before."""
    corners = camera.project(se3.apply(box.camera_from_box, box.target.outline))
    low, high = corners.min(axis=0), corners.max(axis=0)
    off = np.abs(np.concatenate([region.contour.min(axis=0) - low, region.contour.max(axis=0) - high]))
    return bool(off.max() < 0.15 * np.max(high - low) + 3)


def _near(a: BoxInPicture, b: BoxInPicture) -> bool:
    rays = [box.camera_from_box[:3, 3] / np.linalg.norm(box.camera_from_box[:3, 3]) for box in (a, b)]
    size = np.ptp(a.uv, axis=0).max() / a.flat.scale_px
    return bool(np.arccos(np.clip(rays[0] @ rays[1], -1, 1)) < 0.4 * size)


def _outline(light: Single, camera: Camera, region: Region) -> tuple[Flat, list[Line]] | None:
    """Return a flat view of a region and the six sides of its outline, in order; None if it has no six sides."""
    import cv2

    if at_border(region.contour, camera.width, camera.height).mean() > 0.02:
        return None
    low, high = region.contour.min(axis=0), region.contour.max(axis=0)
    if max(high - low) > 4 * min(high - low + 1) or region.area < 0.35 * np.prod(high - low + 1):
        return None
    flat = flat_at(camera, (low + high) / 2)
    if flat is None:
        return None
    uv = flat.seen(camera.rays(region.contour))
    if not np.isfinite(uv).all():
        return None
    hull = cv2.convexHull(uv.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    hull_area = float(cv2.contourArea(hull.astype(np.float32)))
    if region.area < 0.85 * hull_area:
        return None
    six = _six(hull)
    if six is None or abs(_area(six)) > 1.15 * hull_area:
        return None
    for _ in range(2):
        middle = six.mean(axis=0)
        sides, shown = [], 0
        for first, last in zip(six, np.roll(six, -1, axis=0), strict=True):
            line = edge_line(light, camera, flat, first, last, middle)
            shown += line is not None
            sides.append(_rough(first, last) if line is None else line)
        if shown < _LEAST_SIDES:
            return None
        meets = [intersection([sides[k - 1], sides[k]]) for k in range(6)]
        new = np.array([place[0] for place in meets if place is not None])
        if len(new) < 6:
            return None
        if np.abs(new - six).max() > 0.25 * np.sqrt(hull_area):
            return None
        six = new
    return flat, sides


def _rough(first: Float, last: Float) -> Line:
    """Return the side of a region's outline without refinement, accurate to some pixels."""
    length = max(float(np.linalg.norm(last - first)), 1.0)
    return Line((first + last) / 2, (last - first) / length, _ROUGH_PX, 4 * _ROUGH_PX / length)


def flat_at(camera: Camera, uv: Float) -> Flat | None:
    """Return the flat view around a pixel (2,) with the scale of the image there; None outside the lens."""
    rays = camera.rays(uv + np.array([[0.0, 0], [1, 0], [0, 1]]))
    if not np.isfinite(rays).all():
        return None
    ahead = rays[0]
    across = rays[1] - (rays[1] @ ahead) * ahead
    across /= np.linalg.norm(across)
    scale = np.sqrt(1 / (np.linalg.norm(rays[1] - ahead) * np.linalg.norm(rays[2] - ahead)))
    return Flat(np.stack([across, np.cross(ahead, across), ahead]), float(scale))


def _area(ring: Float) -> float:
    x, y = ring.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _six(hull: Float) -> Float | None:
    """Return the hexagon (6, 2) around a convex ring (N, 2): sides whose removal adds the least area are removed."""
    ring = [np.asarray(point) for point in hull]
    while len(ring) > 6:
        best: tuple[float, int, Float] | None = None
        for k in range(len(ring)):
            before, a, b, after = (ring[(k + step) % len(ring)] for step in (-1, 0, 1, 2))
            rows = np.stack([a - before, after - b], axis=1)
            if abs(np.linalg.det(rows)) < 1e-9:
                continue
            share = np.linalg.solve(rows, b - a)
            if (share <= 0).any():
                continue
            where = a + share[0] * (a - before)
            added = abs(_area(np.array([a, where, b])))
            if best is None or added < best[0]:
                best = (added, k, where)
        if best is None:
            return None
        _, k, where = best
        ring[k] = where
        del ring[(k + 1) % len(ring)]
    return np.array(ring) if len(ring) == 6 else None


def edge_line(
    light: Single,
    camera: Camera,
    flat: Flat,
    first: Float,
    last: Float,
    inside: Float,
    *,
    least_step: float = 0.006,
    reach_px: float = _REACH_PX,
) -> Line | None:
    """Return the line of an edge near a segment (2,) of a flat view, sampled from the side of `inside`, or None."""
    along = last - first
    length = float(np.linalg.norm(along))
    if length < 8.0:
        return None
    along = along / length
    across = np.array([-along[1], along[0]])
    across = -across if across @ (inside - first) > 0 else across
    count = int(np.clip(length, 12, 240))
    share = np.linspace(_ENDS, 1 - _ENDS, count)
    reach = min(reach_px, 0.12 * length)
    steps = np.linspace(-reach, reach, 2 * round(reach * _STEPS_A_PX) + 1)
    middles = first + share[:, None] * length * along
    places = camera.project(flat.rays(middles[:, None] + steps[:, None] * across))
    if not np.isfinite(places).all():
        return None
    at = step_at(light, places, 0.5 * (len(steps) - 1) * 0.85, least_step=least_step, smooth=_SMOOTH)
    known = np.isfinite(at)
    if known.sum() < max(_LEAST_PLACES, _LEAST_SHARE * count):
        return None
    uv = middles[known] + np.interp(at[known], np.arange(len(steps)), steps)[:, None] * across
    return line_through(uv, length / count, _LEAST_SHARE * count)


def line_through(uv: Float, apart_px: float, least: float) -> Line | None:
    """Return the line nearest to points (N, 2) without outliers; None if fewer than `least` are inliers."""
    on = np.ones(len(uv), np.bool_)
    for _ in range(6):
        at = uv[on].mean(axis=0)
        along = np.linalg.svd(uv[on] - at)[2][0]
        off = (uv - at) @ np.array([-along[1], along[0]])
        spread = 1.4826 * float(np.median(np.abs(off[on])))
        on = np.abs(off) < max(2.5 * spread, 0.25)
        if on.sum() < max(_LEAST_PLACES, least):
            return None
    rms = float(np.sqrt(np.mean(off[on] ** 2)))
    if rms > 0.8:
        return None
    independent = max(1.0, on.sum() * min(1.0, apart_px / _TOGETHER_PX))
    sigma = max(rms, _FLOOR_PX)
    reach = float(np.sqrt(np.mean(((uv[on] - at) @ along) ** 2)))
    across_px = sigma / float(np.sqrt(independent))
    return Line(at, along, across_px, across_px / max(reach, 1.0))


def intersection(lines: Sequence[Line]) -> tuple[Float, Float] | None:
    """Return the intersection of lines (2,) by least squares and its covariance (2, 2); None if nearly parallel."""
    normal, offset = np.array([line.normal for line in lines]), np.array([line.normal @ line.at for line in lines])
    if np.linalg.svd(normal)[1][1] < 0.15:
        return None
    place = np.linalg.lstsq(normal, offset, rcond=None)[0]
    for _ in range(2):
        sigma = np.array([np.hypot(line.across_px, line.turn_rad * ((place - line.at) @ line.along)) for line in lines])
        rows = normal / sigma[:, None]
        place = np.linalg.lstsq(rows, offset / sigma, rcond=None)[0]
    # Lenses and blur leave no corner better known than this.
    return place, np.linalg.inv(rows.T @ rows) + np.eye(2) * (0.5 * _FLOOR_PX) ** 2


def _posed(light: Single, camera: Camera, size: Box, flat: Flat, sides: list[Line]) -> BoxInPicture | None:
    """Return the box at the pose that fits its outline and has edges at the projected positions."""
    import cv2

    meets = [place for k in range(6) if (place := intersection([sides[k - 1], sides[k]])) is not None]
    if len(meets) < 6:
        return None
    uv, covariance = (np.array(each) for each in zip(*meets, strict=True))
    options: list[tuple[float, int, BoxInPicture]] = []
    for parity in (0, 1):
        for order in permutations(range(3)):
            vertex = _numbered(parity, order, _area(uv) > 0)
            xyz = size.outline[vertex]
            solved, turn, shift = cv2.solvePnP(xyz, uv / flat.scale_px, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            if not solved:
                continue
            rough = (xyz @ cv2.Rodrigues(turn)[0].T) + shift.ravel()
            if (rough[:, 2] < 0.1).any():
                continue
            off = flat.scale_px * rough[:, :2] / rough[:, 2:] - uv
            if np.sqrt(np.mean(np.sum(off**2, axis=1))) > 3 * _MOST_ROUGH_PX:
                continue
            rotation = np.eye(4)
            rotation[:3, :3] = flat.flat_from_camera.T
            pose = rotation @ se3.make(cv2.Rodrigues(turn)[0], shift.ravel())
            box = fitted_box(BoxInPicture(size, flat, uv, covariance, vertex, pose, np.inf, None))
            if box is None or box.rms_px > _MOST_ROUGH_PX:
                continue
            again: BoxInPicture | None = box
            for _ in range(2):
                again = None if again is None else _again(light, camera, again)
            if again is not None and again.rms_px < _MOST_RMS_PX:
                options.append(_with_edges(light, camera, again))
    if not options:
        return None
    # Three visible edges identify the near corner; otherwise the outline alone has to.
    best = min(options, key=lambda each: (-each[1], each[0]))
    rivals = [each for each in options if each[1] == best[1] and each is not best]
    if best[1] < 3 and any(each[0] < 2 * best[0] + 0.3 and _other(each[2], best[2]) for each in rivals):
        return None
    return best[2]


def _again(light: Single, camera: Camera, box: BoxInPicture) -> BoxInPicture | None:
    """Return the box fitted to the sides of its outline, each refined separately near its projected position."""
    corner = near_corner(se3.inverse(box.camera_from_box)[:3, 3], box.target.size_m)
    if corner is None:
        return None
    ring = around(corner)[0]
    six = box.flat.seen(se3.apply(box.camera_from_box, box.target.outline))[ring]
    reach = float(np.clip(2 * box.rms_px, 2.5, _REACH_PX))
    middle = six.mean(axis=0)
    sides = [edge_line(light, camera, box.flat, six[k], six[(k + 1) % 6], middle, reach_px=reach) for k in range(6)]
    corners = []
    for k in range(6):
        two = [line for line in (sides[k - 1], sides[k]) if line is not None]
        place = intersection(two) if len(two) == 2 else None
        if place is not None and np.linalg.norm(place[0] - six[k]) < 3 * reach:
            corners.append((*place, ring[k]))
    if len(corners) < _LEAST_CORNERS - 1:
        return None
    uv, covariance, vertex = (np.array(each) for each in zip(*corners, strict=True))
    return fitted_box(replace(box, uv=uv, covariance=covariance, vertex=vertex, edges=None))


def _other(a: BoxInPicture, b: BoxInPicture) -> bool:
    turned = (a.camera_from_box @ turn @ se3.inverse(b.camera_from_box) for turn in symmetries(a.target.size_m))
    return min(se3.angle_deg(step) for step in turned) > 5.0


def _numbered(parity: int, order: tuple[int, ...], rightward: bool) -> Int:
    """Return the vertices of an outline's corners from the axes and parity of the nearest corner's edges."""
    even = order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    corner = 7 if even != rightward else 0
    ends = [corner ^ (1 << axis) for axis in order]
    between = [corner ^ (1 << order[k]) ^ (1 << order[(k + 1) % 3]) for k in range(3)]
    ring = [each for pair in zip(ends, between, strict=True) for each in pair]
    return np.roll(np.array(ring), parity)


def fitted_box(box: BoxInPicture) -> BoxInPicture | None:
    """Return the box at the pose next to its own that fits its corners best, by their covariances."""
    pose, xyz = box.camera_from_box, box.target.outline[box.vertex]
    whiten = np.linalg.inv(np.linalg.cholesky(box.covariance))

    def off(at: Float) -> Float:
        return np.asarray(np.einsum("kij,kj->ki", whiten, box.flat.seen(se3.apply(at, xyz)) - box.uv).ravel())

    for _ in range(30):
        here = off(pose)
        if not np.isfinite(here).all():
            return None
        steps = 1e-6 * np.eye(6)
        jacobian = np.stack([(off(se3.exp(s) @ pose) - off(se3.exp(-s) @ pose)) / 2e-6 for s in steps], axis=1)
        if not np.isfinite(jacobian).all():
            return None
        step = np.asarray(np.linalg.lstsq(jacobian, -here, rcond=None)[0])
        step *= min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-12))
        pose = se3.exp(step) @ pose
        if np.abs(step).max() < 1e-10:
            break
    rms = float(np.sqrt(np.mean(np.sum((box.flat.seen(se3.apply(pose, xyz)) - box.uv) ** 2, axis=1))))
    if not np.isfinite(rms):
        return None
    corner = near_corner(se3.inverse(pose)[:3, 3], box.target.size_m)
    if corner is None or not set(box.vertex.tolist()) <= {*around(corner)[0], corner}:
        return None
    return replace(box, camera_from_box=pose, rms_px=rms)


def _with_edges(light: Single, camera: Camera, box: BoxInPicture) -> tuple[float, int, BoxInPicture]:
    """Return the residual of a box, the number of visible edges of its nearest corner, and the box with that corner."""
    corner = near_corner(se3.inverse(box.camera_from_box)[:3, 3], box.target.size_m)
    if corner is None:
        return box.rms_px, 0, box
    ring, ends = around(corner)
    seen = box.flat.seen(se3.apply(box.camera_from_box, box.target.outline))
    lines, reach = [], max(_REACH_PX, 2 * box.rms_px)
    for number, (start, end) in enumerate(ends):
        inside, first, last = seen[ring[2 * number - 1]], seen[start], seen[end]  # a corner of a face beside the edge
        line = edge_line(light, camera, box.flat, first, last, inside, least_step=_INNER_STEP, reach_px=reach)
        if line is not None:
            lines.append(line)
    place = intersection(lines) if len(lines) >= 2 else None
    if place is None or np.linalg.norm(place[0] - seen[corner]) > 3 + 2 * box.rms_px:
        return box.rms_px, 0, box
    more = replace(
        box,
        uv=np.vstack([box.uv, place[0]]),
        covariance=np.concatenate([box.covariance, place[1][None]]),
        vertex=np.r_[box.vertex, corner],
        edges=(lines[0], lines[1], lines[2]) if len(lines) == 3 else None,
    )
    better = fitted_box(more)
    if better is None or better.rms_px > _MOST_RMS_PX:
        return box.rms_px, 0, box
    return better.rms_px, len(lines), better
