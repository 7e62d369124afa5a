"""Align the centres of four round holes, `--calibrator velo2cam`, after Beltran et al. 2022 and Guindel et al. 2017.

A board with four round holes is shown in one pose or more. In the sweep, the ends of rings at the holes' rims give the
centres of circles of known size and spacing in its plane; in the image the same centres have a 3D position, since size
and spacing are known. The pose aligns all centres in closed form by singular value decomposition.

Departures: the camera of 2022 detects four ArUco markers on the board, that of 2017 is a stereo pair. Here the holes
themselves are detected (`boards.holes_in_picture`: ellipses in a uniform area are candidates, edges along all rims
decide), so that boards need no print. In the sweep all four circles are fitted together to the rays that return from
the board or pass through it (`boards.holes_in_sweep`), where the papers fit each circle by RANSAC and reject wrong
spacings. One sweep per pose, where they average thirty. The paper of 2022 recommends three poses; one is accepted if
its predicted error is small enough. A predicted error is reported, which the papers do not have.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import Float

from p2o_baselines import examples
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod, hole_sight_of, same_cost
from p2o_baselines.boards.pairing import Pair, from_points
from p2o_baselines.boards.residuals import in_picture, in_sweep, off_centres
from p2o_baselines.target_method import TargetOptions


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) of the least sum of squares between centres: by singular values."""
    del rough
    to = np.concatenate([in_picture(pair) for pair in pairs])
    return from_points(to, np.concatenate([in_sweep(pair)[0] for pair in pairs]))


ALGORITHM = BoardAlgorithm(
    least=1,
    planes_only=False,
    closed=closed,
    cost=same_cost(off_centres),
    kind="board with holes",
    feature=" and through whose holes rays go",
    sight=hole_sight_of,
)


METHOD = p2o.Method(
    name="velo2cam",
    build=lambda options: BoardMethod(options, ALGORITHM),
    options=TargetOptions,
    summary="Boards with round holes: aligns centres of image and sweep in closed form.",
    needs=frozenset({"targets"}),
    cite="Beltran, Guindel, de la Escalera and Garcia, Automatic extrinsic calibration method for LiDAR and camera "
    "sensor setups, T-ITS 2022; Guindel, Beltran, Martin and Garcia, ITSC 2017",
    example=examples.hole_boards("0.9deg 0.06m"),
)
