"""Holders of boards: a person behind or beside the board, or a stand below it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from p2o import Box, Checkerboard, HoleBoard, Sphere, se3

from p2o_sim.things.boards import THICKNESS_M, Board
from p2o_sim.things.bodies import pole_below, tripod
from p2o_sim.things.people import holder
from p2o_sim.world.place import Thing, placed

Holder = Literal["person", "stand"]


def holder_of(kind: Holder, board: Board, ground_m: float, rng: np.random.Generator) -> Thing:
    """Return the holder of a board above the ground at height `ground_m`, which never covers the pattern.

    A person is behind a checkerboard, but beside a board with holes, through which the background must be visible.
    Spheres and boxes are always on a pole.
    """
    if isinstance(board.target, Sphere | Box):
        return pole_below(board.centre, ground_m)
    if kind == "stand":
        return _stand(board, board.target, ground_m)
    return _person(board, board.target, ground_m, rng)


def _person(board: Board, target: Checkerboard | HoleBoard, ground_m: float, rng: np.random.Generator) -> Thing:
    tall, side = rng.uniform(1.6, 1.9), float(rng.choice([-1.0, 1.0]))
    away = board.world_from_board[:3, 2] * [1.0, 1.0, 0.0]
    away /= np.linalg.norm(away)
    yaw = float(np.arctan2(-away[1], -away[0]))
    half, middle = target.width_m / 2 + 0.015, THICKNESS_M / 2
    if isinstance(target, Checkerboard):
        # Far enough behind that a tilted board only touches the hands.
        deep = abs(float(board.world_from_board[:3, 1] @ away)) * target.height_m / 2
        feet = board.centre + (0.32 + deep) * away
        grips = np.array([[half, 0.05, middle], [-half, 0.05, middle]])  # the board's right is the person's left
    else:
        across = board.world_from_board[:3, 0] * [1.0, 1.0, 0.0]
        feet = board.centre + side * (target.width_m / 2 + 0.38) * across + 0.12 * away
        height = 0.22 * target.height_m
        grips = np.array([[side * half, side * height, middle], [side * half, -side * height, middle]])
    turn = se3.exp(np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0]))
    world_from_person = se3.make(translation=(feet[0], feet[1], ground_m)) @ turn
    hands = se3.apply(se3.inverse(world_from_person) @ board.world_from_board, grips)
    return placed(holder(rng, tall, hands), feet[0], feet[1], ground_m, yaw_deg=float(np.degrees(yaw)))


def _stand(board: Board, target: Checkerboard | HoleBoard, ground_m: float) -> Thing:
    """Return a tripod below the centre of the board, and a bar along its back."""
    behind = THICKNESS_M + 0.02
    # Straight down to the rim of the board.
    down = -board.world_from_board[2, :2]
    half = np.array([target.width_m, target.height_m]) / 2
    reach = float((half / np.maximum(np.abs(down), 1e-9)).min())
    rim = np.append(reach * down, behind)
    # The bar ends at the rim of boards with holes, so that the holes are free.
    inner = np.array([0.0, 0.0, behind]) if isinstance(target, Checkerboard) else np.append(0.94 * reach * down, behind)
    rods = se3.apply(board.world_from_board, np.array([rim, inner]))
    knee_m = min(0.35, 0.7 * (rods[0, 2] - ground_m))
    return tripod(rods, ground_m, (0.016, 0.014), foot_m=0.38, low_m=0.08, knee_m=knee_m, sides=8)
