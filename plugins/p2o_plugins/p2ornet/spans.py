"""Sparse labels: spans of a pixel row or column that contain exactly one occlusion, or none.

If a sweep or a disparity map shows that a surface ends between two known positions, the image shows the end at one of
the pairs of pixels between them, but not at which: the label is the span. Where the surface continues, none of the
pairs is an occlusion. All other pairs are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Camera, Cloud, Float, Int, Int8, Side, se3
from p2o.solving import hidden

from p2o_plugins.cloud.ground_plane import ground_plane
from p2o_plugins.cloud.jumps import support_of
from p2o_plugins.cloud.rings import RingsOptions, jumps_of, neighbours_of, outline
from p2o_plugins.cloud.sweep import Neighbours, Sweep, order_sweep

EAST, SOUTH = 0, 1
ORDER = {Side.LEFT: -1, Side.RIGHT: 1, Side.UPPER: -1, Side.BOTTOM: 1}
"""Order of the pair across an edge: +1 if its first (left, upper) pixel occludes the second."""
AXIS = {Side.LEFT: EAST, Side.RIGHT: EAST, Side.UPPER: SOUTH, Side.BOTTOM: SOUTH}
BEAM_PX = 1.0
"""Distance in pixels of the outline of a surface from its last return, within the beam."""
_SPAN = np.dtype([("axis", "i1"), ("order", "i1"), ("line", "f4"), ("start", "f4"), ("end", "f4"), ("weight", "f4")])


@dataclass(frozen=True, eq=False)
class Spans:
    """Labels (N,): `axis` 0 along a row (east pairs), 1 along a column; `line` the row or column in px.

    `start` and `end` in px along it, start <= end. `order` 0: no pair of pixels between is an occlusion; -1 or +1:
    exactly one is, of this order. The position of the pair of pixels i and i + 1 is i + 1/2. `weight` (N,) in 0..1.
    """

    rows: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.rows)

    @classmethod
    def of(cls, axis: int, order: int, line: Float, start: Float, end: Float, weight: Float | float = 1.0) -> Spans:
        """Return labels of one axis and order, from arrays (N,); start and end are in any order."""
        rows = np.zeros(len(line), _SPAN)
        rows["axis"], rows["order"], rows["line"], rows["weight"] = axis, order, line, weight
        rows["start"], rows["end"] = np.minimum(start, end), np.maximum(start, end)
        return cls(rows)

    @classmethod
    def joined(cls, *parts: Spans) -> Spans:
        """Return all labels of several."""
        return cls(np.concatenate([np.zeros(0, _SPAN), *(part.rows for part in parts)]))

    def moved(self, scale: float, shift: tuple[float, float], mirror_width: int | None = None) -> Spans:
        """Return the labels of the image scaled, cropped at `shift` (u, v) px, then mirrored if a width is given.

        Centres of pixels are at integers, so the corner at -1/2 is invariant to scaling.
        """
        rows = self.rows.copy()
        along_u = rows["axis"] == EAST
        for name, is_u in (("line", ~along_u), ("start", along_u), ("end", along_u)):
            rows[name] = scale * (rows[name] + 0.5) - 0.5 - np.where(is_u, shift[0], shift[1])
        if mirror_width is not None:
            columns = ~along_u
            rows["line"][columns] = mirror_width - 1 - rows["line"][columns]
            start, end = rows["start"][along_u].copy(), rows["end"][along_u].copy()
            rows["start"][along_u], rows["end"][along_u] = mirror_width - 1 - end, mirror_width - 1 - start
            rows["order"][along_u] *= -1
        return Spans(rows)


def lidar_spans(cloud: Cloud, camera: Camera, camera_from_lidar: Float, *, speed_m_s: float = 0.0) -> Spans:
    """Return the labels of the pairs of pixels of an image from a sweep with known extrinsic (4, 4).

    Neighbouring returns of one surface give order 0 between them. At a range jump the outline lies between the nearer
    return and the position where the next beam passes it. Points occluded from the camera are dropped. A sweep that was
    not corrected for ego-motion is distorted by at most `speed_m_s`: spans are extended accordingly, and dropped if
    that is more than 3 px. Raises InputError if the rings cannot be determined.
    """
    options = RingsOptions()
    sweep = order_sweep(cloud)
    neighbours = neighbours_of(sweep, options)
    xyz = sweep.xyz(slice(None))
    uv = camera.project(se3.apply(camera_from_lidar, xyz))
    seen = camera.in_image(uv, margin_px=20.0)
    inside = np.flatnonzero(seen)
    seen[inside] = ~hidden(xyz[inside], xyz[inside], camera, camera_from_lidar)
    parts = [
        _continuous(sweep, neighbours[side], uv, seen, AXIS[side], _slip_px(xyz, camera, speed_m_s))
        for side in (Side.RIGHT, Side.BOTTOM)
    ]
    beam = neighbours[Side.LEFT].median_gap
    plane = ground_plane(sweep)
    for side in neighbours:
        rows = jumps_of(sweep, neighbours, side, options)
        rows = rows[seen[rows]]
        support = support_of(sweep, neighbours, side, rows, options)
        keep = support >= options.min_support
        if plane is not None:
            keep &= sweep.xyz(rows) @ plane[:3] + plane[3] > options.ground_height_m
        rows, support = rows[keep], support[keep]
        beyond, _ = outline(sweep, neighbours[side], side, rows, beam, 1.0, np.zeros(len(rows)))
        passing = camera.project(se3.apply(camera_from_lidar, beyond))
        slip = _slip_px(xyz[rows], camera, speed_m_s)
        keep = np.isfinite(passing).all(axis=1) & (slip < 3.0)
        rows, passing, support, slip = rows[keep], passing[keep], support[keep], slip[keep]
        along, across = (0, 1) if AXIS[side] == EAST else (1, 0)
        a, b = uv[rows, along], passing[:, along]
        # Beams have a width: a return may come from the last of a surface whose outline its centre has passed.
        out = np.sign(b - a)
        a, b = a - out * (BEAM_PX + slip), b + out * (0.5 + slip)
        line = 0.5 * (uv[rows, across] + passing[:, across])
        parts.append(Spans.of(AXIS[side], ORDER[side], line, a, b, support))
    return Spans.joined(*parts)


def _continuous(sweep: Sweep, step: Neighbours, uv: Float, seen: Bool, axis: int, slip: Float) -> Spans:
    """Return spans between neighbours on one surface.

    At the end of a surface, its last span is shortened by the distance of the outline from the last return within the
    beam, and by the ego-motion `slip` (N,) in px: those pairs are in the span of the occlusion.
    """
    r = sweep.range_m
    near = np.minimum(r, r[step.row])
    on = step.known & seen & seen[step.row] & (np.abs(r[step.row] - r) < 0.1 + 0.01 * near)
    first = np.flatnonzero(on)
    second = step.row[first]
    along, across = (0, 1) if axis == EAST else (1, 0)
    a, b, drift = uv[first, along], uv[second, along], np.abs(uv[first, across] - uv[second, across])
    keep = (np.abs(b - a) < 16) & (drift < 3)
    line = 0.5 * (uv[first, across] + uv[second, across])
    goes_on, came_on = on[second], np.zeros(len(r), bool)
    came_on[second] = True
    out = np.sign(b - a)
    a, b = a + out * (BEAM_PX + slip[first]) * ~came_on[first], b - out * (BEAM_PX + slip[second]) * ~goes_on
    keep &= out * (b - a) > 0
    return Spans.of(axis, 0, line[keep], a[keep], b[keep])


def _slip_px(xyz: Float, camera: Camera, speed_m_s: float) -> Float:
    """Return the displacement (N,) in px of points due to ego-motion, for a sweep at 10 Hz.

    Camera and LiDAR are synchronised straight ahead; a point at azimuth a is measured a / (2 pi) x 0.1 s earlier or
    later, and forward motion displaces it sideways by the sine of its angle.
    """
    flat = np.maximum(np.hypot(xyz[:, 0], xyz[:, 1]), 1.0)
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    moved = speed_m_s * 0.1 * np.abs(azimuth) / (2 * np.pi)
    slip: Float = camera.focal_px * moved * np.abs(np.sin(azimuth)) / flat
    return slip


def depth_spans(depth_m: Float, *, min_jump_m: float = 0.4, relative_jump: float = 0.02, reach_px: int = 4) -> Spans:
    """Return the labels of pairs of pixels from a sparse depth map (H, W) in metres, NaN if unknown.

    Known pixels at most `reach_px` apart in a row or column are compared: a smooth surface gives order 0 between them;
    a jump needs three known pixels in a row on the nearer surface (the outlines of cars in KITTI's disparity truth).
    """
    parts = []
    for axis in (EAST, SOUTH):
        z = depth_m if axis == EAST else depth_m.T
        line, place = np.nonzero(np.isfinite(z))
        here, other = np.arange(len(line) - 1), np.arange(1, len(line))
        gap = place[other] - place[here]
        near_by = (line[here] == line[other]) & (gap <= reach_px) & (gap > 0)
        here, other = here[near_by], other[near_by]
        value = z[line, place]
        a, b = value[here], value[other]
        limit = 0.05 + 0.01 * np.minimum(a, b) * (place[other] - place[here])
        flat = np.abs(a - b) < limit
        parts.append(Spans.of(axis, 0, line[here[flat]], place[here[flat]], place[other[flat]]))
        for sign in (1, -1):  # +1: the first pixel is nearer
            jump = sign * (b - a) > min_jump_m + relative_jump * np.minimum(a, b)
            near = here if sign > 0 else other
            far = other if sign > 0 else here
            solid = jump & _solid(line, place, value, near, -sign)
            solid &= value[far] - _carried_on(place, value, near, far, -sign) > min_jump_m + relative_jump * value[near]
            parts.append(
                Spans.of(axis, sign, line[near[solid]], place[near[solid]] - sign * 0.5, place[far[solid]] + sign * 0.5)
            )
    return Spans.joined(*parts)


def _solid(line: Int, place: Int, value: Float, start: Int, step: int) -> Bool:
    """Return whether the next three known pixels in the direction `step` are adjacent and on the same surface."""
    good = np.ones(len(start), bool)
    for k in (1, 2, 3):
        other = np.clip(start + k * step, 0, len(line) - 1)
        good &= (line[other] == line[start]) & (np.abs(place[other] - place[start]) == k)
        good &= np.abs(value[other] - value[start]) < 0.3 + 0.01 * value[start]
    return good


def _carried_on(place: Int, value: Float, start: Int, end: Int, step: int) -> Float:
    """Return the depth at `end` of the plane through known pixel `start` and the third one in the direction `step`.

    Inverse depth is affine over the image on a plane; a plane that recedes to infinity gives 1 km.
    """
    other = np.clip(start + 3 * step, 0, len(place) - 1)
    run = np.where(place[start] == place[other], 1, place[start] - place[other])
    slope = (1 / value[start] - 1 / value[other]) / run
    inverse = 1 / value[start] + slope * (place[end] - place[start])
    return np.asarray(1 / np.maximum(inverse, 1e-3))


def classes_of(order: Int8) -> Int8:
    """Return the network's classes of orders: 0 hidden by the next pixel, 1 neither, 2 hides it."""
    return np.asarray(order + 1, dtype=np.int8)
