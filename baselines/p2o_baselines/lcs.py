"""Edges that form lines, circles and squares, `--extractor lcs/CLOUD`: a filter of Canny's edges.

After Tafrishi et al., Line-circle-square (LCS): a multilayered geometric filter for edge-based detection, RAS 2021. It
is no calibration method: it takes clutter (leaves, gravel, texture) out of the edges before any matcher of edges
without direction uses them, `nearest` or `gmm`.

From the paper is the idea alone: layers of shapes, each of which keeps the edges that it explains. Its text was not at
hand; how each shape is told, and all constants, are ours.

1. Edges of `canny`, linked to chains and cut where they bend (`edge_chains`).
2. Lines: pieces of a chain of `min_line_px` and more that a straight line fits.
3. Circles: runs of pieces that one circle fits over `min_arc_deg` and more.
4. Squares: what is too short for a line still counts where four pieces meet at right angles, end to end, and opposite
   ones are parallel. Slanted views are quadrilaterals, hence `square_deg` and `max_aspect`.

The filter of the paper follows shapes over the frames of a film as well; this one looks at single pictures.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from p2o_baselines.canny import CannyOptions, check_thresholds, edge_pixels, edges_of
from p2o_baselines.edge_chains import arc_of, chains, cut, line_rms_px

_CRUMB_PX = 2
"""Chains of so few pixels are corners of staircases that a chain cut short; they go with the shape that they touch."""


class LcsOptions(CannyOptions):
    """Options of `lcs`: those of `canny`, and of each layer."""

    bend_px: float = p2o.field(1.5, ge=0.5, le=20, help="Chains are cut where a pixel is so far from the chord.")
    fit_px: float = p2o.field(
        0.6, gt=0, le=20, help="Pixels of a shape are no farther from it than this, root mean square."
    )
    min_line_px: float = p2o.field(30.0, ge=2, help="Shortest line that counts by itself, in pixels.")
    min_arc_deg: float = p2o.field(180.0, gt=0, le=360, help="Smallest part of a circle that counts.")
    min_radius_px: float = p2o.field(5.0, ge=1, help="Radius of the smallest circle, in pixels.")
    max_radius_px: float = p2o.field(200.0, ge=1, help="Radius of the largest circle, in pixels.")
    min_side_px: float = p2o.field(8.0, ge=2, help="Shortest side of a square, in pixels.")
    corner_px: float = p2o.field(5.0, ge=1, le=100, help="Sides of a square end so near to each other.")
    square_deg: float = p2o.field(20.0, gt=0, lt=45, help="Largest difference of its angles from right ones.")
    max_aspect: float = p2o.field(3.0, ge=1, help="Longest side of a square over its shortest one.")


@dataclass(frozen=True, eq=False)
class Piece:
    """A straight run of edge pixels (M, 2); `way` (2,) leads from the first to the last of them."""

    pixels: Int

    @property
    def way(self) -> Float:
        """From the first pixel to the last."""
        return np.asarray(self.pixels[-1] - self.pixels[0], np.float64)

    @property
    def length_px(self) -> float:
        """From the first pixel to the last, straight."""
        return float(np.hypot(*self.way))


def build(options: LcsOptions) -> p2o.ImageExtractor:
    """Return the extractor; raises InputError if `low` exceeds `high`."""
    check_thresholds(options, "lcs")
    return lambda image: edges_of(shapes(edge_pixels(image, options), options))


def shapes(pixels: Bool, options: LcsOptions) -> Bool:
    """Return which edge pixels (H, W) form lines, circles and squares."""
    kept = np.zeros(pixels.shape, np.bool_)
    crumbs = np.zeros(pixels.shape, np.bool_)
    pieces: list[Piece] = []
    for chain in chains(pixels):
        if len(chain) <= _CRUMB_PX:
            crumbs[chain[:, 1], chain[:, 0]] = True
            continue
        turned, corners = cut(chain, options.bend_px)
        straight = [
            piece
            for first, last in pairwise(corners.tolist())
            if (piece := Piece(turned[first : last + 1])).length_px >= options.min_side_px
            and line_rms_px(piece.pixels) <= options.fit_px
        ]
        lines = [piece for piece in straight if piece.length_px >= options.min_line_px]
        for found in (*(piece.pixels for piece in lines), *arcs(turned, corners, options)):
            kept[found[:, 1], found[:, 0]] = True
        # A line that is long enough by itself may be a side as well.
        pieces += straight
    for piece in squares(pieces, options):
        kept[piece.pixels[:, 1], piece.pixels[:, 0]] = True
    return kept | (crumbs & maximum_filter(kept, 3))


def arcs(chain: Int, corners: Int, options: LcsOptions) -> list[Int]:
    """Return the runs of pixels (M, 2) of a chain, from corner to corner, that one circle fits."""
    found, first = [], 0
    while first < len(corners) - 1:
        best, last = None, first + 1
        while last < len(corners):
            run = chain[corners[first] : corners[last] + 1]
            arc = arc_of(run)
            # Two pieces are the least that tell a circle from a line.
            if last > first + 1 and not (arc.rms_px <= options.fit_px and arc.radius_px <= options.max_radius_px):
                break
            if arc.radius_px >= options.min_radius_px and arc.angle_deg >= options.min_arc_deg:
                best = (last, run)
            last += 1
        if best is None:
            first += 1
        else:
            first = best[0]
            found.append(best[1])
    return found


def squares(pieces: list[Piece], options: LcsOptions) -> list[Piece]:
    """Return the pieces that are sides of a square: four that meet end to end at right angles."""
    if len(pieces) < 4:
        return []
    ends = np.concatenate([piece.pixels[[0, -1]] for piece in pieces]).astype(np.float64)
    pairs = cKDTree(ends).query_pairs(options.corner_px, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    # Ends 2 i and 2 i + 1 are those of piece i.
    beside: dict[int, list[int]] = defaultdict(list)
    for one, other in pairs.tolist():
        if one // 2 != other // 2 and _angle_deg(pieces[one // 2], pieces[other // 2]) >= 90 - options.square_deg:
            beside[one].append(other)
            beside[other].append(one)
    found: set[int] = set()
    for side in range(len(pieces)):
        for left in beside[2 * side]:
            for right in beside[2 * side + 1]:
                # The far ends of both neighbours meet both ends of the fourth side.
                across = {end // 2 for end in beside[left ^ 1]} & {end // 2 for end in beside[right ^ 1]}
                four = [(side, left // 2, right // 2, fourth) for fourth in across - {side}]
                found.update(
                    number for each in four if _is_square([pieces[i] for i in each], options) for number in each
                )
    return [pieces[number] for number in sorted(found)]


def _is_square(sides: list[Piece], options: LcsOptions) -> bool:
    """Return whether four sides, of which the second and third meet the first, are about equal, opposites parallel."""
    first, left, right, fourth = sides
    lengths = [side.length_px for side in sides]
    return (
        len({id(side) for side in sides}) == 4
        and max(lengths) <= options.max_aspect * min(lengths)
        and _angle_deg(left, right) <= options.square_deg
        and _angle_deg(first, fourth) <= options.square_deg
    )


def _angle_deg(one: Piece, other: Piece) -> float:
    """Return the angle between two pieces, 0 to 90 degrees."""
    a, b = one.way, other.way
    return float(np.degrees(np.arctan2(abs(a[0] * b[1] - a[1] * b[0]), abs(a @ b))))


METHOD = p2o.Method(
    name="lcs",
    build=build,
    options=LcsOptions,
    summary="Grey-level edges that form lines, circles or squares, without direction.",
    gives={"image-edges"},
    cite="Tafrishi et al., Line-circle-square (LCS): a multilayered geometric filter for edge-based detection, "
    "Robotics and Autonomous Systems 2021",
)
