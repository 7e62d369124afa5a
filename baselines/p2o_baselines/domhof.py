"""Extrinsic and board poses in one least squares, `--calibrator domhof`, after Domhof, Kooij and Gavrila 2019, 2021.

    p2o run --data folder:BOARDS --joint --calibrator domhof

Each board is an unknown pose, each sensor sees the centres of its four holes with a covariance: the sweep in space, the
camera as pixels. Extrinsic and board poses together make all detections most likely (their pose and structure
estimation, with the structure known: the board's drawing). Board poses are solved for inside of each step, so what is
minimised is a function of the extrinsic alone.

Departures: their boards also carry a corner reflector for a radar, and they calibrate three sensors or more at once,
with loops between them; this is the part of one LiDAR and one camera, where their minimally and fully connected graphs
are the same. Their camera is a stereo pair, or one whose ellipses' middles are taken for the pictures of centres, which
they are not (off by a part of a pixel for oblique boards); here pixels are those of the pose that fits all rims.
Covariances are those of each detection, theirs a figure for each sensor. Boards are found by the shared room `boards`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.centres import bearings_by_point, in_picture, in_sweep, moved
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.sight import BoardOptions, hole_sight_of
from p2o_baselines.velo2cam import closed

_OWN_M, _OWN_PX = 0.002, 0.1
"""Noise that each centre has for itself, beside that of its whole board."""
_STEPS = 4


def whitener(covariance: Float) -> Float:
    """Return W with W covariance W' = 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def misfits_of(pair: Pair) -> tuple[Float, Float, Float, Float]:
    """Return what a board's detections are: centres (N, 3) m and their whitener, bearings (N, 2) and theirs.

    Bearings are x / z and y / z of the camera, so that no lens model is in the way.
    """
    centres, noise = in_sweep(pair)
    by_lidar = whitener(noise + _OWN_M**2 * np.eye(len(noise)))
    seen = in_picture(pair)
    by_update = bearings_by_point(seen) @ moved(seen)
    spread = by_update @ pair.board.covariance @ by_update.T
    by_camera = whitener(spread + (_OWN_PX / pair.board.px_per_rad) ** 2 * np.eye(len(spread)))
    return centres, by_lidar, seen[:, :2] / seen[:, 2:], by_camera


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost with every board at the pose that suits its detections best."""
    del pose
    detected = {id(pair): misfits_of(pair) for pair in pairs}

    def misfits(pair: Pair, pose: Float) -> Block:
        centres, by_lidar, bearings, by_camera = detected[id(pair)]
        drawing = cast(HoleBoardInSweep, pair.patch).target.centres
        board = pair.lidar_from_board
        for turn in range(_STEPS + 1):
            xyz = se3.apply(board, drawing)
            seen = se3.apply(pose, xyz)
            off = np.r_[by_lidar @ (xyz - centres).ravel(), by_camera @ (seen[:, :2] / seen[:, 2:] - bearings).ravel()]
            by_point = by_camera @ bearings_by_point(seen)
            turned = np.kron(np.eye(len(xyz)), pose[:3, :3])
            by_board = np.concatenate([by_lidar @ moved(xyz), by_point @ turned @ moved(xyz)])
            if turn < _STEPS:
                board = se3.exp(-np.linalg.lstsq(by_board, off, rcond=None)[0]) @ board
        by_pose = np.concatenate([np.zeros((len(by_lidar), 6)), by_point @ moved(seen)])
        rays = centres / np.linalg.norm(centres, axis=1)[:, None]
        by_bias = np.r_[-by_lidar @ rays.ravel(), np.zeros(len(by_camera))]
        # What the board's own pose can take up says nothing of the extrinsic.
        basis = np.linalg.qr(by_board)[0]
        keep = np.eye(len(off)) - basis @ basis.T
        return Block(keep @ off, keep @ by_pose, keep @ by_bias, keep, whole=True)

    return misfits


WAY = Way(
    least=1,
    planes_only=False,
    closed=closed,
    cost=cost,
    kind="board with holes",
    beside=" and through whose holes rays go",
    sight=hole_sight_of,
)


def build(options: BoardOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return BoardMethod(options, WAY)


_BOARDS = (
    "targets=holes&place=yard&frames_per_scene=3&width_px=621&height_px=350&right=false&lidar=vlp-16&exposure_ev=0"
)
METHOD = p2o.Method(
    name="domhof",
    build=build,
    options=BoardOptions,
    summary="Boards with round holes: extrinsic and board poses together, each detection with its covariance.",
    needs=frozenset({"targets"}),
    cite="Domhof, Kooij and Gavrila, An extrinsic calibration tool for radar, camera and lidar, ICRA 2019; A joint "
    "extrinsic calibration tool for radar, camera and lidar, T-IV 2021",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.9deg 0.06m", joint=True),
)
