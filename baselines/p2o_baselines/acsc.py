"""Corners of checkerboards in reflectances, `--calibrator acsc`, after Cui, Niu, Ouyang, He and Li 2020.

    p2o run --data folder:BOARDS --joint --calibrator acsc

White squares send back more than black ones. In the plane of a board that the sweep shows, the pattern is laid where
the fewest returns are on squares of the other colour, each by how far it is inside of one (turn and shift in the
plane, minimised by numbers): that gives the inner corners in space. Corners of all boards and their pixels are a pose
from points (PnP) with RANSAC, then Levenberg and Marquardt on bearings.

Departures: theirs is for LiDARs without a repeated pattern (Livox), of which many sweeps of one scene are added up.
Here a board is found by rings, in one sweep (`boards.board_in_sweep`; join sweeps of a scene before, if frames are of
one), so a rosette is refused. Their search of the board in the cloud is that shared room's. Which colour comes first
is left open, since a frame does not say it; half a turn of the board is told by what one pose explains in all frames,
or by the start. Needs intensities. Squares have to be about as large as two rings lie apart: on a VLP-16 (2 deg) 3.5 cm
a metre of distance, on an HDL-64E (0.4 deg) 0.7 cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import p2o
from p2o import Checkerboard, Result, Status, se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.centres import bearings_by_point, moved
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.sight import BoardOptions, Sight, sight_of
from p2o_baselines.boards.squares_in_sweep import SquaresInSweep, with_squares

_RANSAC_PX = 10.0


@dataclass(frozen=True)
class Marked:
    """One frame: its boards, those of the sweep by their squares, and whether the sweep has intensities."""

    sight: Sight
    has_intensity: bool


def marked(frame: p2o.Frame, options: BoardOptions) -> Marked:
    """Return what a frame shows of its checkerboards, by squares in both sensors."""
    sight = sight_of(frame, options)
    targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Checkerboard)))
    patches = tuple(each for piece in sight.patches for each in with_squares(frame.cloud, piece, targets))
    return Marked(replace(sight, patches=patches), frame.cloud.intensity is not None)


def corners(pair: Pair) -> tuple[Float, Float]:
    """Return the corners (N, 3) m of the sweep, and of the picture in the camera frame."""
    drawing = cast(Checkerboard, pair.board.target).corners
    return se3.apply(pair.lidar_from_board, drawing), se3.apply(pair.board.camera_from_board, drawing)


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) of corners in space and their bearings: OpenCV's RANSAC, and `rough` where it fails."""
    import cv2

    both = [corners(pair) for pair in pairs]
    xyz = np.concatenate([each for each, _ in both])
    seen = np.concatenate([each for _, each in both])
    if (seen[:, 2] <= 0).any():
        return rough
    scale = float(np.median([pair.board.px_per_rad for pair in pairs]))
    cv2.setRNGSeed(0)
    found, turn, shift, _ = cv2.solvePnPRansac(
        xyz,
        seen[:, :2] / seen[:, 2:],
        np.eye(3),
        None,
        cv2.Rodrigues(rough[:3, :3])[0],
        rough[:3, 3].copy(),
        useExtrinsicGuess=True,
        iterationsCount=200,
        reprojectionError=_RANSAC_PX / scale,
    )
    return se3.make(cv2.Rodrigues(turn)[0], shift.ravel()) if found else rough


def kept(pairs: Sequence[Pair], pose: Float) -> list[Pair]:
    """Return the boards whose corners lie within half a square of where a pose has them; all where hardly any do.

    A pattern that was laid one square beside its own would pull the pose: RANSAC has left it out.
    """
    good = []
    for pair in pairs:
        of, to = corners(pair)
        off = float(np.median(np.linalg.norm(se3.apply(pose, of) - to, axis=1)))
        if off < 0.5 * cast(Checkerboard, pair.board.target).square_m:
            good.append(pair)
    return good if 2 * len(good) > len(pairs) else list(pairs)


def misfits(pair: Pair, pose: Float) -> Block:
    """Return by how much (2N,) in rad bearings of the sweep's corners are off those of the picture."""
    of, to = corners(pair)
    at = se3.apply(pose, of)
    by_point = bearings_by_point(at)
    by_update = moved(of)
    patch = cast(SquaresInSweep, pair.patch)
    turn = np.kron(np.eye(len(of)), pose[:3, :3])
    noise = by_point @ turn @ by_update
    rays = of / np.linalg.norm(of, axis=1)[:, None]
    return Block(
        (at[:, :2] / at[:, 2:] - to[:, :2] / to[:, 2:]).ravel(),
        by_point @ moved(at),
        by_point @ turn @ rays.ravel(),
        noise @ patch.covariance @ noise.T,
    )


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost of the paper: every corner has one vote."""
    del pairs, pose
    return misfits


WAY = Way(
    least=1,
    planes_only=False,
    closed=closed,
    cost=cost,
    kept=kept,
    beside=" and whose reflectances show its squares",
)


@dataclass(frozen=True)
class Acsc:
    """The calibrator."""

    options: BoardOptions

    def prepare(self, frame: p2o.Frame) -> Marked:
        """Return the boards of both sensors, by their squares."""
        return marked(frame, self.options)

    def solve(self, prepared: Sequence[Marked], camera_from_lidar: Float) -> Result:
        """Return the pose at which corners of the sweep are seen where those of the picture are."""
        sights = [each.sight for each in prepared]
        if prepared and not any(each.has_intensity for each in prepared):
            start = np.asarray(camera_from_lidar, np.float64)
            reason = "no sweep has intensities, from which squares of checkerboards are told"
            return Result(tuple(sight.name for sight in sights), start, start, Status.NO_FEATURES, reason)
        return BoardMethod(self.options, WAY).solve(sights, camera_from_lidar)


def build(options: BoardOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return Acsc(options)


_BOARDS = "targets=checkerboard&place=yard&frames_per_scene=6&width_px=621&height_px=350&right=false&lidar=vlp-16"
METHOD = p2o.Method(
    name="acsc",
    build=build,
    options=BoardOptions,
    summary="Checkerboard corners from reflectances of the sweep, then a pose from points.",
    needs=frozenset({"targets", "intensity"}),
    cite="Cui, Niu, Ouyang, He and Li, ACSC: Automatic calibration for non-repetitive scanning solid-state LiDAR and "
    "camera systems, arXiv:2011.08516, 2020",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.9deg 0.06m", joint=True),
)
