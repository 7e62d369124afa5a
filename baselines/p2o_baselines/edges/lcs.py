"""Keep the edges that form lines, circles and squares, `--extractor lcs/CLOUD`: a filter of Canny's edges.

After Tafrishi et al., Line-circle-square (LCS): a multilayered geometric filter for edge-based detection, RAS 2021. It
is not a calibration method: it removes clutter (leaves, gravel, texture) from the edges before a matcher of edges
without direction uses them, `nearest` or `gmm`.

Only the idea is from the paper: layers of shapes, each of which keeps the edges that it explains. Its text was not at
hand; the detection of each shape and all constants are ours.

1. Edges of `canny`, linked to chains and split at bends (after Kovesi; Douglas and Peucker).
2. Lines: pieces of a chain of 30 px and more that fit a straight line.
3. Circles: runs of pieces that fit one circle over 180 deg and more.
4. Squares: pieces too short for a line are kept if four of them meet at right angles, end to end, and opposite ones are
   parallel. Oblique views are quadrilaterals, hence `_SQUARE_DEG` and `_MAX_ASPECT`.

The filter of the paper also tracks shapes over the frames of a video; this one processes single images.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from math import hypot
from typing import NamedTuple

import numpy as np
import p2o
from p2o import Bool, Float, Int
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from p2o_baselines.edges.canny import CannyOptions, check_thresholds, edge_pixels, edges_of

_AROUND = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""The eight neighbours of a pixel, those that share a side first."""
_BEYOND = tuple((dv, du) for dv in range(-2, 3) for du in range(-2, 3) if max(abs(dv), abs(du)) == 2)
"""The sixteen pixels around those."""
_STRAIGHT = 0.9  # cosine of the largest turn of a chain across a junction
_LOOK_BACK = 5  # number of last pixels that determine the direction of a chain


def chains(pixels: Bool) -> list[Int]:
    """Return the 8-connected chains (M, 2), u and v, of edge pixels (H, W), each pixel in one, through junctions."""
    # A border of zeros makes bounds checks unnecessary.
    free = np.pad(np.asarray(pixels, np.bool_), 1)
    around = np.stack([np.roll(free, step, axis=(0, 1)) for step in _AROUND]).sum(axis=0)
    v, u = np.nonzero(free)
    ends_first = np.argsort(around[v, u] > 1, kind="stable")
    left = set(zip(v.tolist(), u.tolist(), strict=True))
    linked = []
    for pixel in zip(v[ends_first].tolist(), u[ends_first].tolist(), strict=True):
        if pixel not in left:
            continue
        left.discard(pixel)
        chain = _walk([pixel], left)[::-1]
        linked.append(np.array(_walk(chain, left), np.int64)[:, ::-1] - 1)
    return linked


def _walk(chain: list[tuple[int, int]], left: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Extend the chain from its last pixel, removing the pixels from `left`, and return it."""
    while True:
        (row, column), back = chain[-1], chain[max(len(chain) - _LOOK_BACK, 0)]
        direction = (row - back[0], column - back[1])
        near = [step for step in _AROUND if (row + step[0], column + step[1]) in left]
        if not near and len(chain) >= _LOOK_BACK:
            # A chain that crosses has taken the pixel between.
            beyond = [step for step in _BEYOND if (row + step[0], column + step[1]) in left]
            near = [step for step in beyond if _along(direction, step) > _STRAIGHT]
        if not near:
            return chain
        # Straight on; of equals the one that shares a side, so that no corner of a staircase is left behind.
        step = max(near, key=lambda step: _along(direction, step)) if len(near) > 1 else near[0]
        chain.append((row + step[0], column + step[1]))
        left.discard(chain[-1])


def _along(direction: tuple[int, int], step: tuple[int, int]) -> float:
    """Return the cosine of the angle between a step and the direction of a chain; 0 if the chain has none yet."""
    product = direction[0] * step[0] + direction[1] * step[1]
    return product / (hypot(*direction) * hypot(*step) or 1.0)


def cut(chain: Int, off_px: float) -> tuple[Int, Int]:
    """Return a chain (M, 2), if closed from a bend, and the indices (K,) of its corners: no pixel is `off_px` off."""
    corners = _bends(chain, off_px)
    closed = len(chain) > 8 and np.abs(chain[0] - chain[-1]).max() <= 2
    if closed and len(corners) > 2:
        chain = np.roll(chain, -int(corners[1]), axis=0)
        corners = _bends(chain, off_px)
    return chain, corners


def _bends(chain: Int, off_px: float) -> Int:
    """Return the indices (K,) of Douglas and Peucker's corners of a chain (M, 2), its first and last among them."""
    keep, open_yet = {0, len(chain) - 1}, [(0, len(chain) - 1)]
    while open_yet:
        first, last = open_yet.pop()
        if last - first < 2:
            continue
        chord, between = chain[last] - chain[first], chain[first + 1 : last] - chain[first]
        length = float(np.hypot(*chord))
        # From the point itself where both ends are one.
        across = np.abs(chord[0] * between[:, 1] - chord[1] * between[:, 0])
        off = across / length if length > 2 else np.hypot(*between.T)
        far = int(np.argmax(off))
        if off[far] >= off_px:
            keep.add(first + 1 + far)
            open_yet += [(first, first + 1 + far), (first + 1 + far, last)]
    return np.array(sorted(keep), np.int64)


def line_rms_px(uv: Float | Int) -> float:
    """Return the root mean square distance of pixels (M, 2) from the line that fits them best."""
    offset = uv - uv.mean(axis=0)
    return float(np.sqrt(max(np.linalg.eigvalsh(offset.T @ offset)[0], 0.0) / len(uv)))


class Arc(NamedTuple):
    """A circle fitted to pixels: its radius, the residual, and the angle that the arc covers."""

    radius_px: float
    rms_px: float
    angle_deg: float


def arc_of(uv: Float | Int) -> Arc:
    """Return the circle that fits pixels (M, 2) of a chain best, by Kasa's fit; of infinite radius for a line."""
    middle = uv.mean(axis=0)
    offset = uv - middle
    rows = np.column_stack([2 * offset, np.ones(len(offset))])
    solution, _, rank, _ = np.linalg.lstsq(rows, (offset**2).sum(axis=1), rcond=1e-9)
    if rank < 3:
        return Arc(np.inf, 0.0, 0.0)
    radius = float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0)))
    spoke = offset - solution[:2]
    off = np.hypot(*spoke.T) - radius
    turn = np.diff(np.unwrap(np.arctan2(spoke[:, 1], spoke[:, 0])))
    return Arc(radius, float(np.sqrt((off**2).mean())), float(np.degrees(abs(turn.sum()))))


_CRUMB_PX = 2  # chains of so few pixels are corners of staircases; they go with the shape that they touch
_BEND_PX = 1.5  # split chains where a pixel is this far from the chord
_FIT_PX = 0.6  # largest root mean square distance of pixels from their shape
_MIN_LINE_PX = 30.0  # shortest line in pixels
_MIN_ARC_DEG = 180.0  # smallest part of a circle that counts
_MIN_RADIUS_PX = 5.0  # radius of the smallest circle, in pixels
_MAX_RADIUS_PX = 200.0  # radius of the largest circle, in pixels
_MIN_SIDE_PX = 8.0  # shortest side of a square, in pixels
_CORNER_PX = 5.0  # largest gap between the sides of a square
_SQUARE_DEG = 20.0  # largest difference of its angles from right ones
_MAX_ASPECT = 3.0  # longest side of a square over its shortest one


@dataclass(frozen=True, eq=False)
class Piece:
    """A straight run of edge pixels (M, 2)."""

    pixels: Int

    @property
    def direction(self) -> Float:
        """From the first pixel to the last (2,)."""
        return np.asarray(self.pixels[-1] - self.pixels[0], np.float64)

    @property
    def length_px(self) -> float:
        """From the first pixel to the last, straight."""
        return float(np.hypot(*self.direction))


def build(options: CannyOptions) -> p2o.ImageExtractor:
    """Return the extractor; raises InputError if `low` exceeds `high`."""
    check_thresholds(options.low, options.high, "lcs")
    return lambda image: edges_of(shapes(edge_pixels(image, options)))


def shapes(pixels: Bool) -> Bool:
    """Return which edge pixels (H, W) form lines, circles and squares."""
    kept, crumbs = np.zeros(pixels.shape, np.bool_), np.zeros(pixels.shape, np.bool_)
    pieces: list[Piece] = []
    for chain in chains(pixels):
        if len(chain) <= _CRUMB_PX:
            crumbs[chain[:, 1], chain[:, 0]] = True
            continue
        turned, corners = cut(chain, _BEND_PX)
        runs = (Piece(turned[first : last + 1]) for first, last in pairwise(corners.tolist()))
        straight = [run for run in runs if run.length_px >= _MIN_SIDE_PX]
        straight = [run for run in straight if line_rms_px(run.pixels) <= _FIT_PX]
        lines = [piece.pixels for piece in straight if piece.length_px >= _MIN_LINE_PX]
        for shape in (*lines, *arcs(turned, corners)):
            kept[shape[:, 1], shape[:, 0]] = True
        # A line that is long enough alone may also be a side.
        pieces += straight
    for piece in squares(pieces):
        kept[piece.pixels[:, 1], piece.pixels[:, 0]] = True
    return kept | (crumbs & maximum_filter(kept, 3))


def arcs(chain: Int, corners: Int) -> list[Int]:
    """Return the runs of pixels (M, 2) of a chain, from corner to corner, that one circle fits."""
    runs, first = [], 0
    while first < len(corners) - 1:
        best, last = None, first + 1
        while last < len(corners):
            run = chain[corners[first] : corners[last] + 1]
            arc = arc_of(run)
            # At least two pieces are needed to distinguish a circle from a line.
            if last > first + 1 and not (arc.rms_px <= _FIT_PX and arc.radius_px <= _MAX_RADIUS_PX):
                break
            if arc.radius_px >= _MIN_RADIUS_PX and arc.angle_deg >= _MIN_ARC_DEG:
                best = (last, run)
            last += 1
        if best is not None:
            runs.append(best[1])
        first = first + 1 if best is None else best[0]
    return runs


def squares(pieces: list[Piece]) -> list[Piece]:
    """Return the pieces that are sides of a square: four that meet end to end at right angles."""
    if len(pieces) < 4:
        return []
    ends = np.concatenate([piece.pixels[[0, -1]] for piece in pieces]).astype(np.float64)
    pairs = cKDTree(ends).query_pairs(_CORNER_PX, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    # Ends 2 i and 2 i + 1 are those of piece i.
    beside: dict[int, list[int]] = defaultdict(list)
    for one, other in pairs.tolist():
        if one // 2 != other // 2 and _angle_deg(pieces[one // 2], pieces[other // 2]) >= 90 - _SQUARE_DEG:
            beside[one].append(other)
            beside[other].append(one)
    members: set[int] = set()
    for side in range(len(pieces)):
        for left in beside[2 * side]:
            for right in beside[2 * side + 1]:
                # The far ends of both neighbours coincide with both ends of the fourth side.
                across = {end // 2 for end in beside[left ^ 1]} & {end // 2 for end in beside[right ^ 1]}
                fours = [(side, left // 2, right // 2, fourth) for fourth in across - {side}]
                members.update(*(four for four in fours if _is_square([pieces[k] for k in four])))
    return [pieces[number] for number in sorted(members)]


def _is_square(sides: list[Piece]) -> bool:
    """Return whether four sides, of which the second and third meet the first, are about equal, opposites parallel."""
    first, left, right, fourth = sides
    lengths = [side.length_px for side in sides]
    return (
        len({id(side) for side in sides}) == 4
        and max(lengths) <= _MAX_ASPECT * min(lengths)
        and _angle_deg(left, right) <= _SQUARE_DEG
        and _angle_deg(first, fourth) <= _SQUARE_DEG
    )


def _angle_deg(one: Piece, other: Piece) -> float:
    """Return the angle between two pieces, 0 to 90 degrees."""
    a, b = one.direction, other.direction
    return float(np.degrees(np.arctan2(abs(a[0] * b[1] - a[1] * b[0]), abs(a @ b))))


METHOD = p2o.Method(
    name="lcs",
    build=build,
    options=CannyOptions,
    summary="Grey-level edges that form lines, circles or squares, without direction.",
    gives={"image-edges"},
    cite="Tafrishi et al., Line-circle-square (LCS): a multilayered geometric filter for edge-based detection, "
    "Robotics and Autonomous Systems 2021",
)
