"""Detect directed occlusion edges in the sweep of a spinning LiDAR (paper Sec. III-C)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from p2o import Cloud, CloudExtractor, CloudFeatures, CloudRemarks, Float, Int, Method, Side, field
from p2o.reading import RingsUnknownError, neighbour_gap

from p2o_plugins.cloud.firing_order import rings_in_firing_order
from p2o_plugins.cloud.ground_plane import ground_plane
from p2o_plugins.cloud.jumps import (
    GRAZING_SHARE,
    MAX_POINTS,
    MIN_JUMP_SHARE,
    SLANT_RATIO,
    JumpOptions,
    edges_of,
    reliable_jumps,
    towards_background,
)
from p2o_plugins.cloud.open_sky import FAR_M, opened
from p2o_plugins.cloud.range_view import RangeViewOptions, range_view_edges
from p2o_plugins.cloud.sensor_place import in_sensor_frame, sensor_place
from p2o_plugins.cloud.sweep import Neighbours, Sweep, across_rings, along_ring, order_sweep

_MAX_STEP_DEG = 3.0  # widest elevation gap between rings that are neighbours
_OPEN_LEAST_DEG = 5.0  # least elevation of the highest ring for edges against the open sky; lower ones hit
_OPEN_RANGE_M = 60.0  # farthest edge against the open sky: far returns are lost
_OPEN_GAP_DEG = 1.0  # narrowest gap on a ring that can be the open sky


class RingsOptions(JumpOptions):
    """Criteria for an occlusion edge of a sweep with known rings."""

    max_gap_deg: float = field(
        0.6,
        gt=0,
        lt=90,
        help="Widest azimuth gap on a ring that is not a missing return; 1.4 azimuth steps of the sweep if these are "
        "wider.",
    )
    open_weight: float = field(
        1.0, ge=0, le=1, help="Weight of edges against the open sky, of others' weights; 0: none of them."
    )
    open_wider_beams: float = field(
        0.4,
        ge=0,
        le=2,
        help="Things against the open sky seem wider on each side by this share of the step along a ring: beams that "
        "graze them still come back.",
    )
    find_sensor: bool = field(
        True,
        help="Ask the rings where their sensor is, and see edges from there; false: at the origin of the cloud, z up.",
    )
    without_rings: Literal["range-view", "refuse"] = field(
        "range-view", help="Clouds whose rings are unknown: as `range-view` does, with a warning, or an error."
    )


def build(options: RingsOptions) -> CloudExtractor:
    """Return the extractor."""
    common = {name: getattr(options, name) for name in JumpOptions.model_fields}

    def extract(cloud: Cloud) -> CloudFeatures:
        try:
            return ring_edges(cloud, options)
        except RingsUnknownError as problem:
            if options.without_rings == "refuse":
                raise
            features = range_view_edges(cloud, RangeViewOptions(**common))
            remarks = features.get(CloudRemarks.word)
            texts = (f"{problem.what}: its edges are those of range-view", *(() if remarks is None else remarks.texts))
            return features.having(CloudRemarks(texts))

    return extract


def ring_edges(cloud: Cloud, options: RingsOptions) -> CloudFeatures:
    """Return the occlusion edges and thinned surface points of one sweep, LiDAR frame, metres.

    Sides are named from the viewpoint of the sensor with its +z axis up: left is increasing azimuth, upper is
    increasing elevation. The edge point is the nearer return, shifted by half a gap towards the background beam; a
    return with several sides gives several rows. Missing returns give no edge. If the sensor is not at the origin (see
    `sensor_place`), sides are named from its position. Raises RingsUnknownError if the rings cannot be determined (see
    `order_sweep`).
    """
    sweep = order_sweep(cloud)
    place = sensor_place(sweep) if options.find_sensor else None
    if place is not None:
        at_origin = options.model_copy(update={"find_sensor": False})
        return _moved(ring_edges(in_sensor_frame(cloud, place), at_origin), place)
    neighbours = neighbours_of(sweep, options)
    paired = float(np.mean(neighbours[Side.LEFT].known)) if len(sweep) else 1.0
    plane = ground_plane(sweep) if options.ground_height_m > 0 else None
    beam, step = neighbours[Side.LEFT].median_gap, neighbours[Side.BOTTOM].median_gap
    surface = sweep.xyz(slice(None, None, -(-len(sweep) // MAX_POINTS))) if len(sweep) else np.zeros((0, 3))
    looks_up = len(sweep) > 0 and np.degrees(np.arctan(sweep.slope[0])) >= _OPEN_LEAST_DEG
    if options.open_weight > 0 and beam > 0 and looks_up:
        sweep = opened(sweep, beam, _OPEN_GAP_DEG, plane, _OPEN_RANGE_M)
        neighbours = neighbours_of(sweep, options)
    jumps = {side: jumps_of(sweep, neighbours, side, options) for side in neighbours}
    jumps = {side: _sure(sweep, neighbours, side, rows, options) for side, rows in jumps.items()}
    parts = []
    for side, rows in jumps.items():
        rows, support = reliable_jumps(sweep, neighbours, side, rows, plane, step, options)
        into_open = sweep.range_m[neighbours[side].row[rows]] == FAR_M
        wider = np.where(into_open, options.open_wider_beams * beam, 0.0)
        xyz, sigma = outline(sweep, neighbours[side], side, rows, beam, options.shift_beams, wider)
        weight = np.where(into_open, options.open_weight, 1.0) * support
        parts.append((rows, side, xyz, weight, sigma, towards_background(xyz, side)))
    features = CloudFeatures(edges_of(sweep, parts), surface)
    return features if paired >= _FEWEST_PAIRED else features.having(CloudRemarks((_unpaired(paired),)))


_FEWEST_PAIRED = 0.1


def _unpaired(share: float) -> str:
    """Return a warning about rings of which only this share of the returns have a neighbour."""
    text = f"only {100 * share:.0f} % of the returns have a neighbour on their ring (cloud.max_gap_deg)"
    return f"{text}, so that there are hardly any left and right edges: check that `ring` is the beam of each point"


def neighbours_of(sweep: Sweep, options: RingsOptions) -> dict[Side, Neighbours]:
    """Return the neighbours of each return on all four sides."""
    max_gap_deg = float(np.degrees(neighbour_gap(sweep.gaps(), np.radians(options.max_gap_deg))))
    left, right = along_ring(sweep, max_gap_deg)
    upper, lower = (across_rings(sweep, s, 0.5 * max_gap_deg, _MAX_STEP_DEG) for s in (-1, 1))
    return {Side.LEFT: left, Side.RIGHT: right, Side.UPPER: upper, Side.BOTTOM: lower}


def _moved(features: CloudFeatures, cloud_from_sensor: Float) -> CloudFeatures:
    """Return features transformed from the sensor frame to that of the cloud, with a warning on the sensor's place."""
    x, y, z = cloud_from_sensor[:3, 3]
    tilt = np.degrees(np.arccos(np.clip(cloud_from_sensor[2, 2], -1, 1)))
    text = f"the rings say that their sensor is at ({x:.2f}, {y:.2f}, {z:.2f}) m in the frame of the cloud"
    text += f", tilted by {tilt:.0f} deg" if tilt >= 1 else ""
    remark = CloudRemarks((f"{text}, and not at its origin: edges are those that are seen from there",))
    others = features.get(CloudRemarks.word)
    remark = remark if others is None else CloudRemarks((*remark.texts, *others.texts))
    return features.moved(cloud_from_sensor).having(remark)


def _sure(sweep: Sweep, neighbours: dict[Side, Neighbours], side: Side, rows: Int, options: RingsOptions) -> Int:
    """Return the rows whose background is a return, or that certainly end before open space.

    A surface that recedes, or is far away, may only have become too faint for a return. A surface that ends continues
    to the opposite side at about its own distance.
    """
    behind, own, r = neighbours[side], neighbours[_OPPOSITE[side]], sweep.range_m
    into_open = r[behind.row[rows]] == FAR_M
    before = own.row[rows]
    step, least = r[before] - r[rows], options.min_jump_m + MIN_JUMP_SHARE * r[rows]
    ends = np.abs(step) < 0.5 * least
    if side in (Side.LEFT, Side.RIGHT):
        # Poles are one or two beams wide: the next return may belong to their other outline.
        ends |= step > least
    return np.asarray(rows[~into_open | (own.known[rows] & ends & (r[rows] < _OPEN_RANGE_M))])


_OPPOSITE = {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT, Side.UPPER: Side.BOTTOM, Side.BOTTOM: Side.UPPER}


def jumps_of(sweep: Sweep, neighbours: dict[Side, Neighbours], side: Side, options: RingsOptions) -> Int:
    """Return the rows whose neighbour on `side` is farther away by a step that no single surface explains."""
    behind, own, r = neighbours[side], neighbours[_OPPOSITE[side]], sweep.range_m
    jump = r[behind.row] - r
    rows = np.flatnonzero(behind.known & (jump > options.min_jump_m + MIN_JUMP_SHARE * r))
    jump, back, near = jump[rows], behind.row[rows], r[rows]
    # On a plane the inverse range is linear in the angle (to second order): extrapolate it beyond the edge.
    inverse = 1 / near.astype(np.float64)
    before = 1 / r[own.row[rows]]
    inverse += (inverse - before) * behind.gap[rows] / np.maximum(own.gap[rows], 1e-6)
    predicted = np.where(inverse > 1e-6, 1 / np.maximum(inverse, 1e-6), 1e6) - near
    keep = ~own.known[rows] | (jump > SLANT_RATIO * predicted)
    rows, jump, back = rows[keep], jump[keep], back[keep]
    fall = np.where(behind.known[back], r[behind.row[back]] - r[back], 0)
    return rows[fall <= GRAZING_SHARE * jump]


def outline(
    sweep: Sweep, behind: Neighbours, side: Side, rows: Int, beam: float, share: float, wider: Float
) -> tuple[Float, Float]:
    """Return xyz (M, 3) m shifted by a fraction towards the passing beam, at the same range, and sigma_m (M,).

    `wider` (M,) rad is the apparent widening of an object to this side.
    """
    xyz, flat = sweep.xyz(rows), sweep.flat_m[rows].astype(np.float64)
    if side in (Side.LEFT, Side.RIGHT):
        # Lasers beside the axis measure near and far surfaces at slightly different azimuths (HDL-64E: 0.05 degrees
        # between 5 m and 6 m), so the gap is rounded to whole beams.
        turn = np.maximum(np.rint(behind.gap[rows] / beam), 1) * beam
        angle = share * turn - wider
        angle = angle if side is Side.LEFT else -angle
        cos, sin = np.cos(angle), np.sin(angle)
        xyz[:, 0], xyz[:, 1] = cos * xyz[:, 0] - sin * xyz[:, 1], sin * xyz[:, 0] + cos * xyz[:, 1]
        return xyz, turn * flat / np.sqrt(12)
    # Direction of the passing beam at this range, from its cone: its elevation from the origin depends on the range.
    beyond = sweep.ring[behind.row[rows]]
    lift = sweep.slope[beyond] * flat + sweep.offset[beyond] - xyz[:, 2]
    xyz[:, 2] += share * lift - np.sign(lift) * wider * sweep.range_m[rows] ** 2 / flat
    return xyz, np.abs(lift) * flat / sweep.range_m[rows] / np.sqrt(12)


def recovered_rings(cloud: Cloud) -> tuple[Int, str] | None:
    """Return the ring (N,) of each point of a cloud in firing order, and the source as text; None for other clouds."""
    ring = rings_in_firing_order(cloud)
    return None if ring is None else (ring, "the firing order of the points")


METHOD = Method(
    name="rings",
    build=build,
    options=RingsOptions,
    summary="Occlusion edges with direction from range jumps along rings and columns of a spinning LiDAR.",
    gives=frozenset({"cloud-edges", "side", "cloud-points"}),
    parallel=True,
    rings=recovered_rings,
    cite="Wang et al., P2O-Calib, 2023, Sec. III-C",
)
