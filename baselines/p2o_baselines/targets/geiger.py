"""Match several checkerboards by combinations of planes, `--calibrator geiger`, after Geiger et al. 2012.

One frame with several boards is enough: three boards of the image and the three matching planes of the sweep give a
pose (rotation from normals, translation from offsets). Combinations of three are sampled within a frame or across
frames; those with different angles between normals are rejected, the others are scored by the number of boards with a
plane at the predicted position. Iterated closest points refine the best one.

Departures: the paper has a stereo pair and dense points of its boards; here each board is the rectangle given by its
corners and size, and the closest point of a return lies in that rectangle. OpenCV's detector and the shared package
`boards` replace its corner filters and region growing. Of several poses that fit equally well, the one nearest to the
initial extrinsic is returned, where the paper returns all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import p2o
from p2o import Float, field, se3

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import Block
from p2o_baselines.boards.board_in_picture import BoardInPicture
from p2o_baselines.boards.board_in_sweep import BoardInSweep
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod, same_cost
from p2o_baselines.boards.pairing import Pair, from_middles, from_planes, of_size
from p2o_baselines.boards.residuals import by_update_along, joined, off_plane
from p2o_baselines.target_method import Sight, TargetOptions

_MOST_ANGLE_DEG = 6.0  # angles between normals of a combination differ by less in both sensors
_LEAST_VOLUME = 0.02  # minimum determinant of three normals: smaller ones are nearly coplanar
_COMBINATIONS = 2000  # combinations of three boards that are tried at most


class GeigerOptions(TargetOptions):
    """Options of `geiger`."""

    seed: int = field(0, ge=0, help="Seed of the sampled combinations.")


@dataclass(frozen=True)
class Combinations:
    """Poses from combinations of three boards."""

    most: int
    seed: int

    def __call__(self, sights: Sequence[Sight], start: Float) -> Iterable[Float]:
        """Give the pose (4, 4) of each combination whose normals enclose the same angles in both sensors."""
        del start
        choices = [(board, pieces) for s in sights for board in s.in_image if (pieces := of_size(s, board))]
        if len(choices) < 3:
            return
        rng, tried = np.random.default_rng(self.seed), 0
        seen: set[tuple[int, ...]] = set()
        for _ in range(4 * self.most):
            three = tuple(sorted(rng.choice(len(choices), 3, replace=False).tolist()))
            if three in seen:
                continue
            seen.add(three)
            for combination in product(*(choices[at][1] for at in three)):
                if len({id(piece) for piece in combination}) < 3:
                    continue
                pose = posed([choices[at][0] for at in three], combination)
                if pose is not None:
                    yield pose
                tried += 1
                if tried >= self.most:
                    return


def posed(boards: Sequence[BoardInPicture], pieces: Sequence[BoardInSweep]) -> Float | None:
    """Return the pose (4, 4) of three boards and planes; None if they cannot match or do not determine it."""
    to, of = np.array([b.normal for b in boards]), np.array([p.normal for p in pieces])
    angles = [np.degrees(np.arccos(np.clip((n @ n.T)[np.triu_indices(3, 1)], -1, 1))) for n in (to, of)]
    if np.abs(angles[0] - angles[1]).max() > _MOST_ANGLE_DEG:
        return None
    if abs(np.linalg.det(of)) < _LEAST_VOLUME:  # the offsets leave a direction open, the middles do not
        middles = np.array([b.camera_from_board[:3, 3] for b in boards]), np.array([p.middle for p in pieces])
        return from_middles(*middles, to, of)
    return from_planes(to, np.array([b.offset_m for b in boards]), of, np.array([p.offset_m for p in pieces]))


def residuals(pair: Pair, pose: Float) -> Block:
    """Return the distances of returns from their closest points in the board: from its plane and beyond its sides."""
    board_from_camera = se3.inverse(pair.board.camera_from_board)
    camera = se3.apply(pose, pair.patch.xyz)
    at = se3.apply(board_from_camera, camera)
    blocks = [off_plane(pair, pose)]
    for axis, half in ((0, pair.patch.size_m[0] / 2), (1, pair.patch.size_m[1] / 2)):
        beyond = np.sign(at[:, axis]) * np.maximum(np.abs(at[:, axis]) - half, 0.0)
        out = beyond != 0
        if out.any():
            by_update = by_update_along(camera[out], pair.board.camera_from_board[:3, axis])
            noise = np.full(int(out.sum()), pair.patch.sigma_m**2)
            blocks.append(Block(beyond[out], by_update, np.zeros(int(out.sum())), noise))
    return joined(*blocks)


def build(options: GeigerOptions) -> p2o.Calibrator:
    """Return the calibrator; the closed form is the pose of the best combination, as it came."""
    hypotheses = Combinations(_COMBINATIONS, options.seed)
    algorithm = BoardAlgorithm(3, True, lambda pairs, rough: rough, same_cost(residuals), hypotheses=hypotheses)
    return BoardMethod(options, algorithm)


METHOD = p2o.Method(
    name="geiger",
    build=build,
    options=GeigerOptions,
    summary="Several checkerboards: combinations of three planes, then closest points; one shot can do.",
    needs=frozenset({"targets"}),
    cite="Geiger, Moosmann, Car and Schuster, Automatic camera and range sensor calibration using a single shot, "
    "ICRA 2012",
    example=examples.checkerboards("0.9deg 0.06m"),
)
