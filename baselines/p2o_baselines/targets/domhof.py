"""Estimate extrinsic and board poses jointly, `--calibrator domhof`, after Domhof, Kooij and Gavrila 2019, 2021.

Each board is an unknown pose. Each sensor observes the centres of its four holes with a covariance: the sweep in 3D,
the camera in pixels. Extrinsic and board poses maximise the likelihood of all detections (pose and structure estimation
with known structure, the dimensions of the board). Board poses are eliminated in each step, so the cost is a function
of the extrinsic alone.

Departures: the original boards also carry a radar reflector, and three or more sensors are calibrated with loops
between them; this is the case of one LiDAR and one camera, in which minimally and fully connected graphs are equal. The
original camera is a stereo pair, or one in which the centre of an ellipse is used as the image of the hole's centre,
which is wrong by a fraction of a pixel for oblique boards; here pixels are those of the pose that fits all rims.
Covariances are per detection instead of per sensor. Boards are detected by the shared package `boards`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import p2o
from p2o import Float, se3

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.residuals import bearings_by_point, in_picture, in_sweep, moved
from p2o_baselines.target_method import TargetOptions
from p2o_baselines.targets.velo2cam import ALGORITHM as CLOSED_FORM

_OWN_M, _OWN_PX = 0.002, 0.1  # independent noise of each centre, in addition to the noise common to a board
_STEPS = 4


def whitener(covariance: Float) -> Float:
    """Return W with W covariance W' = 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def detections_of(pair: Pair) -> tuple[Float, Float, Float, Float]:
    """Return centres (N, 3) m with whitening matrix, and bearings x / z, y / z (N, 2) of any lens with theirs."""
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
    detected = {id(pair): detections_of(pair) for pair in pairs}

    def residuals(pair: Pair, pose: Float) -> Block:
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
        # Components that the board's own pose can absorb contain no information on the extrinsic.
        basis = np.linalg.qr(by_board)[0]
        keep = np.eye(len(off)) - basis @ basis.T
        return Block(keep @ off, keep @ by_pose, keep @ by_bias, keep, whole=True)

    return residuals


ALGORITHM = replace(CLOSED_FORM, cost=cost)


METHOD = p2o.Method(
    name="domhof",
    build=lambda options: BoardMethod(options, ALGORITHM),
    options=TargetOptions,
    summary="Boards with round holes: joint estimation of extrinsic and board poses with covariances of detections.",
    needs=frozenset({"targets"}),
    cite="Domhof, Kooij and Gavrila, An extrinsic calibration tool for radar, camera and lidar, ICRA 2019; A joint "
    "extrinsic calibration tool for radar, camera and lidar, T-IV 2021",
    example=examples.hole_boards("0.9deg 0.06m"),
)
