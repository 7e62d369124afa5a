"""Several checkerboards, told apart by trying combinations of planes, `--calibrator geiger`, after Geiger et al. 2012.

    p2o run --data folder:BOARDS --joint --calibrator geiger

One shot of several boards is enough: three boards of pictures and three plane pieces of sweeps that are theirs give a
pose (rotation by normals, translation by offsets). Combinations of three are drawn at random, in one frame or across
frames; those whose angles between normals differ are dropped, the others judged by how many boards find a piece where
they should be. From the best, iterated closest points move the returns onto the boards.

Departures: the paper has a stereo pair and dense points of its boards; here each board is the rectangle that its
corners and size give, and a return's closest point lies in that rectangle. Its prototype filters for corners and its
growing of regions are OpenCV's detector and the shared room `boards`; of several poses that fit about as well the one
nearest to the start is given, where the paper gives them all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_in_picture import BoardInPicture
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.closed_form import from_middles, from_planes
from p2o_baselines.boards.pairing import Pair, of_size
from p2o_baselines.boards.point_to_plane import joined, off_plane
from p2o_baselines.boards.sight import BoardOptions, Sight

_MOST_ANGLE_DEG = 6.0  # angles between normals of a combination differ by less in both sensors
_LEAST_VOLUME = 0.02  # of three normals: less is three that lie in a plane


class GeigerOptions(BoardOptions):
    """Options of `geiger`."""

    combinations: int = p2o.field(2000, ge=1, le=1_000_000, help="Combinations of three boards that are tried at most.")
    seed: int = p2o.field(0, ge=0, help="Seed of the combinations, where there are more.")


@dataclass(frozen=True)
class Combinations:
    """Poses from combinations of three boards."""

    most: int
    seed: int

    def __call__(self, sights: Sequence[Sight], start: Float) -> Iterable[Float]:
        """Give the pose (4, 4) of each combination whose normals enclose the same angles in both sensors."""
        del start
        choices = [(board, pieces) for s in sights for board in s.boards if (pieces := of_size(s, board))]
        if len(choices) < 3:
            return
        rng, tried = np.random.default_rng(self.seed), 0
        seen: set[tuple[int, ...]] = set()
        for _ in range(4 * self.most):
            three = tuple(sorted(rng.choice(len(choices), 3, replace=False).tolist()))
            if three in seen:
                continue
            seen.add(three)
            for pieces in product(*(choices[at][1] for at in three)):
                if len({id(piece) for piece in pieces}) < 3:
                    continue
                pose = posed([choices[at][0] for at in three], pieces)
                if pose is not None:
                    yield pose
                tried += 1
                if tried >= self.most:
                    return


def posed(boards: Sequence[BoardInPicture], pieces: Sequence[BoardInSweep]) -> Float | None:
    """Return the pose (4, 4) of three boards and pieces; None where these cannot be the same or leave it open."""
    to, of = np.array([b.normal for b in boards]), np.array([p.normal for p in pieces])
    angles = [np.degrees(np.arccos(np.clip((n @ n.T)[np.triu_indices(3, 1)], -1, 1))) for n in (to, of)]
    if np.abs(angles[0] - angles[1]).max() > _MOST_ANGLE_DEG:
        return None
    if abs(np.linalg.det(of)) < _LEAST_VOLUME:  # the offsets leave a direction open, the middles do not
        middles = np.array([b.camera_from_board[:3, 3] for b in boards]), np.array([p.middle for p in pieces])
        return from_middles(*middles, to, of)
    return from_planes(to, np.array([b.offset_m for b in boards]), of, np.array([p.offset_m for p in pieces]))


def misfits(pair: Pair, pose: Float) -> Block:
    """Return how far returns are from their closest points in the board: off its plane, and beyond its sides."""
    plane = off_plane(pair, pose)
    board_from_camera = se3.inverse(pair.board.camera_from_board)
    camera = se3.apply(pose, pair.patch.xyz)
    at = se3.apply(board_from_camera, camera)
    blocks = [plane]
    for axis, half in ((0, pair.patch.size_m[0] / 2), (1, pair.patch.size_m[1] / 2)):
        beyond = np.sign(at[:, axis]) * np.maximum(np.abs(at[:, axis]) - half, 0.0)
        out = beyond != 0
        if out.any():
            way = pair.board.camera_from_board[:3, axis]
            by_update = np.concatenate([np.cross(camera[out], way), np.broadcast_to(way, (out.sum(), 3))], axis=1)
            noise = np.eye(int(out.sum())) * pair.patch.sigma_m**2
            blocks.append(Block(beyond[out], by_update, np.zeros(int(out.sum())), noise))
    return joined(*blocks)


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost of closest points, in which every return has one vote."""
    del pairs, pose
    return misfits


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose of the best combination, as it came."""
    del pairs
    return rough


def build(options: GeigerOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    hypotheses: Callable[[Sequence[Sight], Float], Iterable[Float]] = Combinations(options.combinations, options.seed)
    return BoardMethod(options, Way(3, True, closed, cost, hypotheses=hypotheses))


_BOARDS = "targets=checkerboard&place=yard&frames_per_scene=5&width_px=621&height_px=350&right=false&lidar=hdl-64e"
METHOD = p2o.Method(
    name="geiger",
    build=build,
    options=GeigerOptions,
    summary="Several checkerboards: combinations of three planes, then closest points; one shot can do.",
    needs=frozenset({"targets"}),
    cite="Geiger, Moosmann, Car and Schuster, Automatic camera and range sensor calibration using a single shot, "
    "ICRA 2012",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.9deg 0.06m", joint=True),
)
