"""Align planes and border lines of checkerboards, `--calibrator zhou`, after Zhou, Li and Kaess 2018.

Each board gives a plane and up to four lines to both sensors, and one board is enough: its normal and two directions
determine the rotation, points in the plane and on the lines the translation. The closed form of the paper (rotation by
singular values of directions and normals, translation by linear least squares) initialises Levenberg-Marquardt on the
distances of points from planes and lines, with equal weights of all planes and lines.

Departures: the lines of the image follow from the board's size and its corners, not from edges. The board of the sweep
is detected by its size (`boards.board_in_sweep`), its lines by the ends of rings, half a step beyond the last return; a
side crossed by fewer than three rings has no line. The spot of the LiDAR moves all ends outwards; the offset is
estimated from opposite sides and subtracted. Frames may show different boards; pairs are those that one pose explains
in most of them. The size of the board is known: the similarity transform of the paper is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import p2o
from p2o import Bool, Float, se3

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod
from p2o_baselines.boards.pairing import Pair, turned
from p2o_baselines.boards.residuals import by_update_along, joined, off_plane
from p2o_baselines.target_method import TargetOptions

_LEAST_ENDS = 3


def sides(pair: Pair) -> Iterator[tuple[Bool, Float, Float, Float]]:
    """Give the ends (K,) on sides that enough rings cross, and in the camera frame a point, its line, across (3,)."""
    width, height = pair.patch.size_m
    # Sides in the board frame of the sweep: their middles and directions, told to the image's by the turn.
    middles = np.array([[0, -height / 2, 0], [width / 2, 0, 0], [0, height / 2, 0], [-width / 2, 0, 0]])
    along = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]])
    camera_from_patch = pair.board.camera_from_board @ se3.inverse(pair.turn)
    rotation = camera_from_patch[:3, :3]
    for side in range(4):
        mine = pair.patch.side == side
        if mine.sum() >= _LEAST_ENDS:
            at = se3.apply(camera_from_patch, middles[side][None])[0]
            yield mine, at, rotation @ along[side], rotation @ along[1 - side % 2]


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) in closed form from normals, directions of lines, and points on both."""
    to, of, lines = [], [], []
    for pair in pairs:
        to.append(pair.board.normal)
        of.append(pair.patch.normal)
        for mine, at, along, across in sides(pair):
            ends = pair.patch.ends[mine]
            direction = np.linalg.svd(ends - ends.mean(axis=0))[2][0]
            direction = direction * np.sign(rough[:3, :3] @ direction @ along)
            length = float(np.linalg.norm(np.ptp(ends, axis=0)))
            # A line through few ends near each other has hardly a direction.
            to.append(along * min(length, 1.0))
            of.append(direction)
            lines.append((ends.mean(axis=0), at, across))
    if np.linalg.matrix_rank(np.array(of), tol=0.1) < 2:
        return rough  # one plane and no line: the later check reports it as unobservable
    rotation = turned(np.array(to), np.array(of))
    # n . (R m + t) = d for planes, and the same across each line.
    rows = [(pair.board.normal, pair.board.offset_m, pair.patch.middle) for pair in pairs]
    rows += [(across, float(across @ at), middle) for middle, at, across in lines]
    directions = np.array([direction for direction, _, _ in rows])
    if np.linalg.matrix_rank(directions, tol=0.05) < 3:
        return rough
    rest = np.array([offset - direction @ rotation @ middle for direction, offset, middle in rows])
    return se3.make(rotation, np.linalg.lstsq(directions, rest, rcond=None)[0])


def outset_m(pairs: Sequence[Pair], pose: Float) -> float:
    """Return the mean outward offset of ends by the laser spot where rings cross opposite sides; 0 without any."""
    outsets = []
    for pair in pairs:
        middle = pair.board.camera_from_board[:3, 3]
        outwards: dict[int, list[float]] = {}
        for mine, at, _, across in sides(pair):
            sign = np.sign((at - middle) @ across)
            off = sign * ((se3.apply(pose, pair.patch.ends[mine]) - at) @ across)
            outwards.setdefault(int(pair.patch.side[mine][0]) % 2, []).append(float(np.median(off)))
        outsets += [sum(pair_of) / 2 for pair_of in outwards.values() if len(pair_of) == 2]
    return float(np.median(outsets)) if outsets else 0.0


def residuals(pair: Pair, pose: Float, outset: float = 0.0) -> Block:
    """Return distances of points from planes and of ends from lines `outset` m beyond sides, each with one weight."""
    blocks = [off_plane(pair, pose, 1 / np.sqrt(len(pair.patch.xyz)))]
    middle = pair.board.camera_from_board[:3, 3]
    for mine, side, _, across in sides(pair):
        at = side + np.sign((side - middle) @ across) * outset * across
        ends = se3.apply(pose, pair.patch.ends[mine])
        rays = pair.patch.ends[mine] @ pose[:3, :3].T
        rays = rays / np.linalg.norm(rays, axis=1)[:, None]
        vote = 1 / np.sqrt(mine.sum())
        for direction, sigma in ((across, pair.patch.ends_m[mine]), (pair.board.normal, pair.patch.sigma_m)):
            blocks.append(
                Block(
                    vote * ((ends - at) @ direction),
                    vote * by_update_along(ends, direction),
                    vote * (rays @ direction),
                    (vote * np.broadcast_to(sigma, len(ends))) ** 2,
                )
            )
    return joined(*blocks)


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost of the paper, with the width of the LiDAR's spot as it is at a pose."""
    outset = outset_m(pairs, pose)
    return lambda pair, at: residuals(pair, at, outset)


ALGORITHM = BoardAlgorithm(least=1, planes_only=False, closed=closed, cost=cost, rounds=2)


METHOD = p2o.Method(
    name="zhou",
    build=lambda options: BoardMethod(options, ALGORITHM),
    options=TargetOptions,
    summary="Planes and border lines of checkerboards: closed form, then least squares; one pose can do.",
    needs=frozenset({"targets"}),
    cite="Zhou, Li and Kaess, Automatic extrinsic calibration of a camera and a 3D LiDAR using line and plane "
    "correspondences, IROS 2018",
    example=examples.checkerboards("0.8deg 0.06m"),
)
