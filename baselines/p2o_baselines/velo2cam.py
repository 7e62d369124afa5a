"""Centres of four round holes onto centres, `--calibrator velo2cam`, after Beltran et al. 2022 and Guindel et al. 2017.

    p2o run --data folder:BOARDS --joint --calibrator velo2cam

A board with four round holes is shown in one pose or more. In the sweep rings leave it at the holes' rims, which gives
the centres of circles of the known size and spacing in its plane; in the picture the same centres have a place in
space, since size and spacing are known. The pose brings all centres onto centres, in closed form by singular values.

Departures: 2022's single camera sees four ArUco markers on the board, 2017's is a stereo pair. Here the holes
themselves are found (`boards.holes_in_picture`: gaps in a plain area that are ellipses propose, edges along all rims
together decide), so that boards need no print. In the sweep all four circles are laid at once, as rays that come back
from the board or go through it allow (`boards.holes_in_sweep`), where the papers fit circle by circle by RANSAC and
drop what has the wrong spacing. One sweep a pose, where they average thirty. 2022 advises three poses; one is not
refused, if its likely error is in bounds. A likely error is told, the papers have none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.centres import in_picture, in_sweep, off_centres
from p2o_baselines.boards.closed_form import turned
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.sight import BoardOptions, hole_sight_of


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) of the least sum of squares between centres: by singular values."""
    del rough
    to = np.concatenate([in_picture(pair) for pair in pairs])
    of = np.concatenate([in_sweep(pair)[0] for pair in pairs])
    rotation = turned(to - to.mean(axis=0), of - of.mean(axis=0))
    return se3.make(rotation, to.mean(axis=0) - rotation @ of.mean(axis=0))


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the cost that the closed form is the least of: every centre has one vote."""
    del pairs, pose
    return off_centres


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
    name="velo2cam",
    build=build,
    options=BoardOptions,
    summary="Boards with round holes: centres of picture and sweep onto each other, closed form.",
    needs=frozenset({"targets"}),
    cite="Beltran, Guindel, de la Escalera and Garcia, Automatic extrinsic calibration method for LiDAR and camera "
    "sensor setups, T-ITS 2022; Guindel, Beltran, Martin and Garcia, ITSC 2017",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.9deg 0.06m", joint=True),
)
