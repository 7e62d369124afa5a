"""Select the range jumps that are occlusion edges: criteria and checks shared by `rings` and `range-view`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from p2o import Bool, CloudEdges, Float, Int, Options, Side, field
from scipy.spatial import cKDTree

from p2o_plugins.cloud.sweep import Neighbours, Returns

MIN_JUMP_SHARE = 0.02  # share of the nearer range that is added to `min_jump_m`
SLANT_RATIO = 3.0  # the jump exceeds this many times the one of a plane that goes on from the nearer surface
GRAZING_SHARE = 0.6  # the background falls away by at most this share of the jump after it
_NEIGHBOUR_M, _NEIGHBOUR_SHARE = 0.8, 0.02  # radius around an edge: in metres, at least this share of the range


MAX_POINTS = 40_000  # surface points kept for hidden-surface tests, at most


class JumpOptions(Options):
    """Criteria for an occlusion edge between neighbouring returns."""

    min_jump_m: float = field(0.4, gt=0, help="Smallest step in range between neighbouring beams, in metres.")
    ground_height_m: float = field(0.25, ge=0, help="Edges lower than this over the ground plane are dropped; 0: off.")
    min_support: float = field(
        0.4,
        ge=0,
        le=1,
        help="Share of the seven signs of a clean outline that an edge shows at least (leaves: few); upright edges "
        "show less where rings are further apart than those of an HDL-64E, and are asked for less.",
    )
    min_neighbours: int = field(
        2, ge=0, help="Other edges of the same direction that an edge has around it (upright ones as above); 0: off."
    )
    shift_beams: float = field(
        0.5, ge=0, le=1, help="Move edges by this share of the gap to the passing beam; the outline lies halfway."
    )


_SIGNS = 7
_HDL64E_STEP = np.radians(0.45)
"""Step between the rings of an HDL-64E, for which `min_support` and `min_neighbours` were tuned."""


def reliable_jumps(
    sweep: Returns,
    neighbours: dict[Side, Neighbours],
    side: Side,
    rows: Int,
    plane: Float | None,
    step: float,
    options: JumpOptions,
) -> tuple[Int, Float]:
    """Return the jumps at `rows` that belong to an outline, with their support (M,) in [0, 1].

    They have enough signs of an outline, are above the ground `plane` (4,) and have other edges of their direction
    around them. `step` is the angle in rad to the next ring.
    """
    support = support_of(sweep, neighbours, side, rows, options)
    # A vertical outline crosses fewer rings if the rings are more widely spaced: ten of an HDL-64E, three of an
    # HDL-32E.
    share = min(1.0, _HDL64E_STEP / max(step, 1e-9)) if side in (Side.LEFT, Side.RIGHT) else 1.0
    keep = support >= options.min_support * share
    if plane is not None:
        keep &= sweep.xyz(rows) @ plane[:3] + plane[3] > options.ground_height_m
    rows, support = rows[keep], support[keep]
    # A vertical edge requires at least one other edge.
    others = options.min_neighbours and max(1, round(options.min_neighbours * share))
    keep = _has_neighbours(sweep, rows, others, step)
    return rows[keep], support[keep]


def support_of(
    sweep: Returns, neighbours: dict[Side, Neighbours], side: Side, rows: Int, options: JumpOptions
) -> Float:
    """Return the share (M,) of seven signs of a clean outline that each edge has, in [0, 1].

    Foreground, background and the jump between them each continue in both directions along the outline (six signs), and
    the background continues behind it. Leaves and grass, whose edges have no counterpart in the image, have few signs.
    """
    behind, r = neighbours[side], sweep.range_m
    back = behind.row[rows]
    along = (Side.UPPER, Side.BOTTOM) if side in (Side.LEFT, Side.RIGHT) else (Side.LEFT, Side.RIGHT)

    def continues(start: Int, step: Neighbours) -> Bool:
        reach = 0.5 * (options.min_jump_m + MIN_JUMP_SHARE * r[start])
        on: Bool = step.known[start] & (np.abs(r[step.row[start]] - r[start]) < reach)
        return on

    marked = np.zeros(len(sweep), bool)
    marked[rows] = True
    if along[0] is Side.UPPER:
        # An inclined outline crosses the next ring one beam to the side.
        marked[neighbours[Side.LEFT].row[rows]] = marked[neighbours[Side.RIGHT].row[rows]] = True
    signs = continues(back, behind).astype(np.int64)
    for direction in along:
        step = neighbours[direction]
        signs += continues(rows, step)
        signs += continues(back, step)
        signs += step.known[rows] & marked[step.row[rows]]
    return signs / _SIGNS


def _has_neighbours(sweep: Returns, rows: Int, others: int, step: float) -> Bool:
    """Return which edges have enough others of their direction around them (the paper's radius filter).

    The radius reaches the second next ring, at `step` radians from ring to ring.
    """
    if others == 0 or len(rows) <= others:
        return np.full(len(rows), others == 0)
    xyz = sweep.xyz(rows)
    share = max(_NEIGHBOUR_SHARE, 2.2 * step)
    radius = np.maximum(_NEIGHBOUR_M, share * sweep.range_m[rows])
    tree = cKDTree(xyz, balanced_tree=False, compact_nodes=False)
    distance = np.asarray(tree.query(xyz, k=[others + 1], distance_upper_bound=float(radius.max()) * 1.001)[0])
    keep: Bool = distance[:, 0] <= radius
    return keep


def edges_of(sweep: Returns, parts: Iterable[tuple[Int, Side, Float, Float, Float, Float]]) -> CloudEdges:
    """Return the edges of all sides: rows (M,), side, xyz (M, 3), weight (M,), sigma_m (M,), background (M, 3) each."""
    # Edges of a motion-corrected sweep need no correction by their time.
    measured_s = sweep.cloud.time_s if sweep.cloud.twist is None else None
    columns = []
    for rows, side, xyz, *rest in parts:
        time_s = np.zeros(len(rows)) if measured_s is None else measured_s[sweep.point[rows]]
        columns.append((xyz, np.full(len(rows), side), *rest, time_s))
    return CloudEdges(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def towards_background(xyz: Float, side: Side) -> Float:
    """Return unit directions (M, 3) perpendicular to the rays, from edges at `xyz` (M, 3) to their background."""
    flat = np.maximum(np.hypot(xyz[:, 0], xyz[:, 1]), 1e-9)
    zero = np.zeros(len(xyz))
    if side in (Side.LEFT, Side.RIGHT):
        rising = np.column_stack([-xyz[:, 1] / flat, xyz[:, 0] / flat, zero])
        return rising if side is Side.LEFT else -rising
    far = np.maximum(np.linalg.norm(xyz, axis=1), 1e-9)
    rising = np.column_stack([-xyz[:, 0] * xyz[:, 2] / flat, -xyz[:, 1] * xyz[:, 2] / flat, flat]) / far[:, None]
    return np.asarray(rising if side is Side.UPPER else -rising)
