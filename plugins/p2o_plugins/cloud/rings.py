"""Directed occlusion edges of a spinning LiDAR's sweep (paper Sec. III-C)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from p2o import Cloud, CloudEdges, CloudExtractor, CloudFeatures, CloudRemarks, Method, Options, Side, field
from p2o.arrays import Bool, Float, Int
from p2o.frames.rings import RingsUnknownError
from scipy.spatial import cKDTree

from p2o_plugins.cloud.ground_plane import ground_plane
from p2o_plugins.cloud.open_sky import FAR_M, opened
from p2o_plugins.cloud.sensor_place import in_sensor_frame, sensor_place
from p2o_plugins.cloud.sweep import Neighbours, Returns, Sweep, across_rings, along_ring, order_sweep


class JumpOptions(Options):
    """What counts as an occlusion edge between neighbouring returns."""

    min_jump_m: float = field(0.4, gt=0, help="Smallest step in range between neighbouring beams, in metres.")
    min_jump_share: float = field(0.02, ge=0, help="Added to that step: this share of the nearer range.")
    slant_ratio: float = field(
        3.0,
        ge=0,
        help="The jump exceeds this many times the one of a plane that goes on from the nearer surface; 0: off.",
    )
    grazing_share: float = field(
        0.6, ge=0, help="The background falls away by at most this share of the jump after it; 0: off."
    )
    ground_height_m: float = field(0.25, ge=0, help="Edges lower than this over the ground plane are dropped; 0: off.")
    min_support: float = field(
        0.4,
        ge=0,
        le=1,
        help="Share of the seven signs of a clean outline that an edge shows at least (leaves: few); upright edges "
        "show less where rings are further apart than those of an HDL-64E, and are asked for less.",
    )
    weigh: bool = field(True, help="Weigh edges by that share; otherwise all edges weigh 1.")
    min_neighbours: int = field(
        2, ge=0, help="Other edges of the same direction that an edge has around it (upright ones as above); 0: off."
    )
    neighbour_m: float = field(0.8, gt=0, help="Radius in which they are counted, in metres.")
    neighbour_share: float = field(
        0.02, ge=0, help="The radius is at least this share of the range, and reaches the second next ring."
    )
    shift_beams: float = field(
        0.5, ge=0, le=1, help="Move edges by this share of the gap to the passing beam; the outline lies halfway."
    )
    max_points: int = field(40_000, ge=0, help="Surface points kept for hidden-surface tests, at most.")
    seed: int = field(0, ge=0, help="Seed of the ground plane's random samples.")


class RingsOptions(JumpOptions):
    """What counts as an occlusion edge of a sweep whose rings are known."""

    max_gap_deg: float = field(0.6, gt=0, lt=90, help="Widest azimuth gap on a ring that is not a missing return.")
    max_step_deg: float = field(3.0, gt=0, lt=90, help="Widest elevation gap between rings that are neighbours.")
    open_weight: float = field(
        1.0, ge=0, le=1, help="Weight of edges against the open sky, of others' weights; 0: none of them."
    )
    open_least_deg: float = field(
        5.0,
        ge=-90,
        le=90,
        help="None of them where the highest ring looks up by less: it meets something nearly always.",
    )
    open_range_m: float = field(60.0, gt=0, help="Farthest edge against the open sky: far returns are lost.")
    open_gap_deg: float = field(1.0, gt=0, le=90, help="Narrowest gap on a ring that can be the open sky.")
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
        "range-view", help="Clouds that do not tell their rings: as `range-view` does, with a warning, or an error."
    )


def build(options: RingsOptions) -> CloudExtractor:
    """Return the extractor."""
    # Imported here: it is made of what this file holds.
    from p2o_plugins.cloud.range_view import RangeViewOptions, range_view_edges

    common = {name: getattr(options, name) for name in JumpOptions.model_fields}

    def extract(cloud: Cloud) -> CloudFeatures:
        try:
            return ring_edges(cloud, options)
        except RingsUnknownError as problem:
            if options.without_rings == "refuse":
                raise
            found = range_view_edges(cloud, RangeViewOptions(**common))
            said = found.get(CloudRemarks.word)
            texts = (f"{problem.what}: its edges are those of range-view", *(() if said is None else said.texts))
            return found.having(CloudRemarks(texts))

    return extract


def ring_edges(cloud: Cloud, options: RingsOptions) -> CloudFeatures:
    """Return the occlusion edges and thinned surface points of one sweep, LiDAR frame, metres.

    Sides are named as a viewer at the sensor with its +z axis up would name them: left is rising azimuth, upper is
    rising elevation. The edge point is the nearer return, moved half a gap towards the background beam; a return may
    carry several sides and then gives several rows. Missing returns make no edge. A sensor that is elsewhere than at
    the origin (see `sensor_place`) names them from where it is. Raises RingsUnknownError where the rings cannot be told
    (see `order_sweep`).
    """
    sweep = order_sweep(cloud)
    place = sensor_place(sweep) if options.find_sensor else None
    if place is not None:
        there = options.model_copy(update={"find_sensor": False})
        return _moved(ring_edges(in_sensor_frame(cloud, place), there), place)
    left, right = along_ring(sweep, options.max_gap_deg)
    upper, lower = (across_rings(sweep, s, 0.5 * options.max_gap_deg, options.max_step_deg) for s in (-1, 1))
    plane = ground_plane(sweep, options.seed) if options.ground_height_m > 0 else None
    beam = float(np.median(left.gap[left.known][::8])) if left.known.any() else 0.0
    step = float(np.median(lower.gap[lower.known][::8])) if lower.known.any() else 0.0
    every = slice(None, None, -(-len(sweep) // max(options.max_points, 1)))
    surface = sweep.xyz(every) if options.max_points and len(sweep) else np.zeros((0, 3))
    looks_up = len(sweep) > 0 and np.degrees(np.arctan(sweep.slope[0])) >= options.open_least_deg
    if options.open_weight > 0 and beam > 0 and looks_up:
        sweep = opened(sweep, beam, options.open_gap_deg, plane, options.open_range_m)
        left, right = along_ring(sweep, options.max_gap_deg)
        upper, lower = (across_rings(sweep, s, 0.5 * options.max_gap_deg, options.max_step_deg) for s in (-1, 1))
    neighbours = {Side.LEFT: left, Side.RIGHT: right, Side.UPPER: upper, Side.BOTTOM: lower}
    jumps = {side: jumps_of(sweep, neighbours, side, options) for side in neighbours}
    jumps = {side: _sure(sweep, neighbours, side, rows, options) for side, rows in jumps.items()}
    # The edges of a sweep that was corrected for motion are where they are, whenever they were seen.
    measured_s = cloud.time_s if cloud.twist is None else None
    parts = []
    for side, rows in jumps.items():
        support = support_of(sweep, neighbours, side, rows, options)
        met = share_met(side, step)
        keep = support >= options.min_support * met
        if plane is not None:
            keep &= sweep.xyz(rows) @ plane[:3] + plane[3] > options.ground_height_m
        rows, support = rows[keep], support[keep]
        # Even one upright edge needs another.
        others = options.min_neighbours and max(1, round(options.min_neighbours * met))
        keep = in_company(sweep, rows, others, step, options)
        rows, support = rows[keep], support[keep]
        into_open = sweep.range_m[neighbours[side].row[rows]] == FAR_M
        wider = np.where(into_open, options.open_wider_beams * beam, 0.0)
        xyz, sigma = outline(sweep, neighbours[side], side, rows, beam, options.shift_beams, wider)
        weight = support if options.weigh else np.ones(len(rows))
        weight = np.where(into_open, options.open_weight, 1.0) * weight
        time_s = np.zeros(len(rows)) if measured_s is None else measured_s[sweep.point[rows]]
        parts.append((xyz, np.full(len(rows), side), weight, sigma, towards_background(xyz, side), time_s))
    edges = CloudEdges(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return CloudFeatures(edges, surface)


def _moved(found: CloudFeatures, cloud_from_sensor: Float) -> CloudFeatures:
    """Return what was found in the frame of the sensor in that of the cloud, with a remark that says where it is."""
    x, y, z = cloud_from_sensor[:3, 3]
    tilt = np.degrees(np.arccos(np.clip(cloud_from_sensor[2, 2], -1, 1)))
    said = f"the rings say that their sensor is at ({x:.2f}, {y:.2f}, {z:.2f}) m in the frame of the cloud"
    said += f", tilted by {tilt:.0f} deg" if tilt >= 1 else ""
    remark = CloudRemarks((f"{said}, and not at its origin: edges are those that are seen from there",))
    return found.moved(cloud_from_sensor).having(remark)


def _sure(sweep: Sweep, neighbours: dict[Side, Neighbours], side: Side, rows: Int, options: RingsOptions) -> Int:
    """Return the rows whose background is a return, or that surely end before the open.

    A surface that recedes, or is far away, may only have become too faint. One that ends goes on the other way at about
    its own distance.
    """
    behind, own, r = neighbours[side], neighbours[_OPPOSITE[side]], sweep.range_m
    into_open = r[behind.row[rows]] == FAR_M
    before = own.row[rows]
    step, least = r[before] - r[rows], options.min_jump_m + options.min_jump_share * r[rows]
    ends = np.abs(step) < 0.5 * least
    if side in (Side.LEFT, Side.RIGHT):
        # Poles are a beam or two wide: their other outline is next.
        ends |= step > least
    return rows[~into_open | (own.known[rows] & ends & (r[rows] < options.open_range_m))]


_OPPOSITE = {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT, Side.UPPER: Side.BOTTOM, Side.BOTTOM: Side.UPPER}
_SIGNS = 7
_USUAL_STEP = np.radians(0.45)
"""Rings up to this far apart (those of an HDL-64E are) are what `min_support` and `min_neighbours` are meant for."""


def jumps_of(sweep: Sweep, neighbours: dict[Side, Neighbours], side: Side, options: RingsOptions) -> Int:
    """Return the rows whose neighbour on `side` lies further away by a step that no single surface explains."""
    behind, own, r = neighbours[side], neighbours[_OPPOSITE[side]], sweep.range_m
    jump = r[behind.row] - r
    rows = np.flatnonzero(behind.known & (jump > options.min_jump_m + options.min_jump_share * r))
    jump, back, near = jump[rows], behind.row[rows], r[rows]
    if options.slant_ratio > 0:
        # On a plane the inverse range is linear in the angle (to second order): continue it past the edge.
        inverse = 1 / near.astype(np.float64)
        before = 1 / r[own.row[rows]]
        inverse += (inverse - before) * behind.gap[rows] / np.maximum(own.gap[rows], 1e-6)
        predicted = np.where(inverse > 1e-6, 1 / np.maximum(inverse, 1e-6), 1e6) - near
        keep = ~own.known[rows] | (jump > options.slant_ratio * predicted)
        rows, jump, back = rows[keep], jump[keep], back[keep]
    if options.grazing_share > 0:
        fall = np.where(behind.known[back], r[behind.row[back]] - r[back], 0)
        rows = rows[fall <= options.grazing_share * jump]
    return rows


def support_of(
    sweep: Returns, neighbours: dict[Side, Neighbours], side: Side, rows: Int, options: JumpOptions
) -> Float:
    """Return the share of seven signs of a clean outline that each edge shows, in [0, 1].

    Foreground, background and the jump between them each go on both ways along the outline (six), and the background
    goes on behind it. Leaves and grass, whose edges have no counterpart in the picture, show few.
    """
    behind, r = neighbours[side], sweep.range_m
    back = behind.row[rows]
    along = (Side.UPPER, Side.BOTTOM) if side in (Side.LEFT, Side.RIGHT) else (Side.LEFT, Side.RIGHT)

    def goes_on(start: Int, step: Neighbours) -> Bool:
        reach = 0.5 * (options.min_jump_m + options.min_jump_share * r[start])
        on: Bool = step.known[start] & (np.abs(r[step.row[start]] - r[start]) < reach)
        return on

    marked = np.zeros(len(sweep), bool)
    marked[rows] = True
    if along[0] is Side.UPPER:
        # The next ring meets a leaning outline one beam to the side.
        marked[neighbours[Side.LEFT].row[rows]] = marked[neighbours[Side.RIGHT].row[rows]] = True
    signs = goes_on(back, behind).astype(np.int64)
    for way in along:
        step = neighbours[way]
        signs += goes_on(rows, step)
        signs += goes_on(back, step)
        signs += step.known[rows] & marked[step.row[rows]]
    return signs / _SIGNS


def share_met(side: Side, step: float) -> float:
    """Return the share of an upright outline's usual edges that rings `step` radians apart meet; 1 for the others.

    A car that ten rings of an HDL-64E meet is met by three of an HDL-32E: what is asked of the rings above and below
    has to be asked for less.
    """
    return min(1.0, _USUAL_STEP / max(step, 1e-9)) if side in (Side.LEFT, Side.RIGHT) else 1.0


def in_company(sweep: Returns, rows: Int, others: int, step: float, options: JumpOptions) -> Bool:
    """Return which edges have enough others of their direction around them (the paper's radius filter).

    The radius reaches the second next ring, `step` radians being the way to the next.
    """
    if others == 0 or len(rows) <= others:
        return np.full(len(rows), others == 0)
    xyz = sweep.xyz(rows)
    share = max(options.neighbour_share, 2.2 * step)
    radius = np.maximum(options.neighbour_m, share * sweep.range_m[rows])
    tree = cKDTree(xyz, balanced_tree=False, compact_nodes=False)
    distance = np.asarray(tree.query(xyz, k=[others + 1], distance_upper_bound=float(radius.max()) * 1.001)[0])
    keep: Bool = distance[:, 0] <= radius
    return keep


def outline(
    sweep: Sweep, behind: Neighbours, side: Side, rows: Int, beam: float, share: float, wider: Float
) -> tuple[Float, Float]:
    """Return xyz (M, 3) m moved by a share towards the passing beam, at the own distance, and sigma_m (M,).

    `wider` (M,) rad is how much wider than it is a thing seems to this side.
    """
    xyz, flat = sweep.xyz(rows), sweep.flat_m[rows].astype(np.float64)
    if side in (Side.LEFT, Side.RIGHT):
        # Lasers beside the axis see near and far under slightly different azimuths (HDL-64E: 0.05 degrees between
        # 5 m and 6 m), so the gap is counted in whole beams.
        turn = np.maximum(np.rint(behind.gap[rows] / beam), 1) * beam
        angle = share * turn - wider
        angle = angle if side is Side.LEFT else -angle
        cos, sin = np.cos(angle), np.sin(angle)
        xyz[:, 0], xyz[:, 1] = cos * xyz[:, 0] - sin * xyz[:, 1], sin * xyz[:, 0] + cos * xyz[:, 1]
        return xyz, turn * flat / np.sqrt(12)
    # The passing beam at this distance, from its cone: its elevation seen from the origin changes with range.
    beyond = sweep.ring[behind.row[rows]]
    lift = sweep.slope[beyond] * flat + sweep.offset[beyond] - xyz[:, 2]
    xyz[:, 2] += share * lift - np.sign(lift) * wider * sweep.range_m[rows] ** 2 / flat
    return xyz, np.abs(lift) * flat / sweep.range_m[rows] / np.sqrt(12)


def towards_background(xyz: Float, side: Side) -> Float:
    """Return unit directions (M, 3) across the view of the sensor, from edges at `xyz` (M, 3) to their background."""
    flat = np.maximum(np.hypot(xyz[:, 0], xyz[:, 1]), 1e-9)
    zero = np.zeros(len(xyz))
    if side in (Side.LEFT, Side.RIGHT):
        rising = np.column_stack([-xyz[:, 1] / flat, xyz[:, 0] / flat, zero])
        return rising if side is Side.LEFT else -rising
    far = np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
    rising = np.column_stack([-xyz[:, 0] * xyz[:, 2] / flat, -xyz[:, 1] * xyz[:, 2] / flat, flat]) / far[:, None]
    return rising if side is Side.UPPER else -rising


METHOD = Method(
    name="rings",
    build=build,
    options=RingsOptions,
    summary="Occlusion edges with direction from range jumps along rings and columns of a spinning LiDAR.",
    gives=frozenset({"cloud-edges", "side", "cloud-points"}),
    parallel=True,
    cite="Wang et al., P2O-Calib, 2023, Sec. III-C",
)
