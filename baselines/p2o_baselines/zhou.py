"""Planes and border lines of checkerboards, `--calibrator zhou`, after Zhou, Li and Kaess 2018.

    p2o run --data folder:BOARDS --joint --calibrator zhou

Each board gives a plane and up to four lines to both sensors, and one board can do: its normal and two directions
tell the rotation, points in the plane and on the lines the rest. The closed form of the paper (rotation by singular
values of directions and normals, translation by linear least squares) starts Levenberg and Marquardt on the distances
of points from planes and lines, every plane and every line with one vote.

Departures: the picture's lines come from the board's size and its corners, not from edges in the picture. The sweep's
board is found by its size (`boards.board_in_sweep`), its lines through where rings leave it, half a step beyond the
last return; a side that fewer than three rings cross gives none. The LiDAR's spot moves all ends outwards: by how
much is told by opposite sides, and taken off. Frames may differ in what they show; pairs are those that one pose
explains in most of them. The board's size is known: the paper's similarity transform is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Bool, Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.closed_form import turned
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.point_to_plane import joined, off_plane
from p2o_baselines.boards.sight import BoardOptions

_LEAST_ENDS = 3


def sides(pair: Pair) -> Iterator[tuple[Bool, Float, Float, Float]]:
    """Give each side that enough rings cross.

    That is which ends (K,) are its own, and in the camera frame a point of the line (3,), its direction (3,) and the
    direction across it in the board (3,).
    """
    width, height = pair.patch.size_m
    # Sides in the board frame of the sweep: their middles and directions, told to the picture's by the turn.
    middles = np.array([[0, -height / 2, 0], [width / 2, 0, 0], [0, height / 2, 0], [-width / 2, 0, 0]])
    along = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]])
    camera_from_patch = pair.board.camera_from_board @ se3.inverse(pair.turn)
    rotation = camera_from_patch[:3, :3]
    for side in range(4):
        mine = pair.patch.side == side
        if mine.sum() >= _LEAST_ENDS:
            at = se3.apply(camera_from_patch, middles[side][None])[0]
            yield mine, at, rotation @ along[side], rotation @ along[1 - side % 2 if side % 2 == 0 else 0]


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
        return rough  # one plane and no line: what follows says that it is open
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
    """Return by how much ends lie outside of the outline where rings cross opposite sides; 0 where none do.

    A spot that touches the board comes back from it: that widens a board, and moves one with one side seen.
    """
    found = []
    for pair in pairs:
        middle = pair.board.camera_from_board[:3, 3]
        outwards: dict[int, list[float]] = {}
        for mine, at, _, across in sides(pair):
            sign = np.sign((at - middle) @ across)
            off = sign * ((se3.apply(pose, pair.patch.ends[mine]) - at) @ across)
            outwards.setdefault(int(pair.patch.side[mine][0]) % 2, []).append(float(np.median(off)))
        found += [sum(pair_of) / 2 for pair_of in outwards.values() if len(pair_of) == 2]
    return float(np.median(found)) if found else 0.0


def misfits(pair: Pair, pose: Float, outset: float = 0.0) -> Block:
    """Return distances of points from the plane and of ends from their lines, each set with one vote.

    Lines are taken to lie `outset` m beyond the sides.
    """
    blocks = [off_plane(pair, pose, 1 / np.sqrt(len(pair.patch.xyz)))]
    middle = pair.board.camera_from_board[:3, 3]
    for mine, side, _, across in sides(pair):
        at = side + np.sign((side - middle) @ across) * outset * across
        ends = se3.apply(pose, pair.patch.ends[mine])
        rays = pair.patch.ends[mine] @ pose[:3, :3].T
        rays = rays / np.linalg.norm(rays, axis=1)[:, None]
        vote = 1 / np.sqrt(mine.sum())
        for way, sigma in ((across, pair.patch.ends_m[mine]), (pair.board.normal, pair.patch.sigma_m)):
            by_update = np.concatenate([np.cross(ends, way), np.broadcast_to(way, ends.shape)], axis=1)
            blocks.append(
                Block(
                    vote * ((ends - at) @ way),
                    vote * by_update,
                    vote * (rays @ way),
                    np.eye(len(ends)) * (vote * np.broadcast_to(sigma, len(ends))) ** 2,
                )
            )
    return joined(*blocks)


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost of the paper, with the width of the LiDAR's spot as it is at a pose."""
    outset = outset_m(pairs, pose)
    return lambda pair, at: misfits(pair, at, outset)


WAY = Way(least=1, planes_only=False, closed=closed, cost=cost, rounds=2)


def build(options: BoardOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return BoardMethod(options, WAY)


_BOARDS = "targets=checkerboard&place=yard&frames_per_scene=5&width_px=621&height_px=350&right=false&lidar=hdl-64e"
METHOD = p2o.Method(
    name="zhou",
    build=build,
    options=BoardOptions,
    summary="Planes and border lines of checkerboards: closed form, then least squares; one pose can do.",
    needs=frozenset({"targets"}),
    cite="Zhou, Li and Kaess, Automatic extrinsic calibration of a camera and a 3D LiDAR using line and plane "
    "correspondences, IROS 2018",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.8deg 0.06m", joint=True),
)
