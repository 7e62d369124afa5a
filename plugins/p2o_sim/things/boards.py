"""Calibration targets as things: thin boards with squares or holes, spheres and boxes, with exact geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from p2o import Box, Checkerboard, Float, HoleBoard, InputError, Sphere, Target, se3

from p2o_sim.things.bodies import body_parts
from p2o_sim.world.mesh import Mesh, join, quads, stacked
from p2o_sim.world.place import Thing
from p2o_sim.world.scene import Class, Material, built

THICKNESS_M = 0.008
"""Distance between front and back of every board."""


def _holes_of(width_m: float, height_m: float, pitch_m: float, radius_m: float) -> HoleBoard:
    """Return a board with four holes whose neighbours are `pitch_m` apart."""
    places = (-pitch_m / 2, pitch_m / 2)
    return HoleBoard(width_m, height_m, tuple((u, v, radius_m) for v in places for u in places))


TARGETS: Mapping[str, Mapping[str, Target]] = {
    "checkerboard": {
        "a0": Checkerboard(9, 6, 0.108, 1.189, 0.841),
        "a1": Checkerboard(7, 4, 0.095, 0.841, 0.594),
        "a2": Checkerboard(7, 4, 0.066, 0.594, 0.420),
    },
    "holes": {
        "a0": _holes_of(1.189, 0.841, 0.4, 0.12),
        "a1": _holes_of(0.841, 0.594, 0.28, 0.085),
        "a2": _holes_of(0.594, 0.420, 0.2, 0.06),
    },
    "sphere": {"a0": Sphere(0.3), "a1": Sphere(0.2), "a2": Sphere(0.125)},
    "box": {"a0": Box(0.9, 0.7, 0.5), "a1": Box(0.65, 0.5, 0.35), "a2": Box(0.45, 0.35, 0.25)},
}
"""Targets of each kind by the size of their paper; each checkerboard differs from itself rotated by 180 degrees."""
_SIDES = 96  # of the polygon that approximates a hole, to 0.05 % of its radius

WHITE = Material("board white", (0.75, 0.75, 0.74), contrast=0.1, reflectance=0.8, pattern="plain")
BLACK = Material("board black", (0.03, 0.03, 0.032), contrast=0.1, reflectance=0.1, pattern="plain")
_BACK = Material("board back", (0.35, 0.27, 0.18), contrast=0.3, reflectance=0.5, pattern="streaks")


@dataclass(frozen=True, eq=False)
class Board:
    """A target at its pose `world_from_board` (4, 4), with the board frame of `p2o.frames.frame`."""

    target: Target
    world_from_board: Float

    @property
    def centre(self) -> Float:
        """Centre (3,) in m of a board's front, or of a body, in the world."""
        return self.world_from_board[:3, 3]

    @property
    def outline(self) -> Float:
        """Corners in the world in m: four (4, 3) of a board, or eight (8, 3) of a body's bounding box."""
        return se3.apply(self.world_from_board, self.target.outline)


def thing_of(board: Board, number: int = 0) -> Thing:
    """Return the parts of a board or body at its pose; `number` selects the colour of a body.

    Raises InputError for holes that overlap, or nearly touch one another or the rim.
    """
    target, pose = board.target, board.world_from_board
    if isinstance(target, Checkerboard):
        solids = _checkerboard(target)
    else:
        solids = _holes(target) if isinstance(target, HoleBoard) else body_parts(target, number)
    return built(Class.BOARD, *((Mesh(se3.apply(pose, mesh.vertices), mesh.faces), paint) for mesh, paint in solids))


def _checkerboard(target: Checkerboard) -> list[tuple[Mesh, Material]]:
    """Return the disjoint white and black squares of the front, and the body behind them."""
    half = np.array([target.width_m, target.height_m]) / 2
    counts = np.array([target.columns, target.rows]) + 1  # squares each way
    lines = []
    for count, reach in zip(counts, half, strict=True):
        pattern = (np.arange(count + 1) - count / 2) * target.square_m
        lines.append(np.unique(np.concatenate([np.clip(pattern, -reach, reach), [-reach, reach]])))
    low = np.stack(np.meshgrid(lines[0][:-1], lines[1][:-1]), -1).reshape(-1, 2)
    high = np.stack(np.meshgrid(lines[0][1:], lines[1][1:]), -1).reshape(-1, 2)
    square = np.floor((low + high) / 2 / target.square_m + counts / 2)
    black = ((square >= 0) & (square < counts)).all(axis=1) & (square.sum(axis=1) % 2 == 0)
    corner, other = np.column_stack([low[:, 0], high[:, 1]]), np.column_stack([high[:, 0], low[:, 1]])
    corners = np.stack([low, corner, high, other], 1)
    front = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)
    ring = target.outline[:, :2]
    body = quads(stacked(ring, THICKNESS_M)[None]) + _wall(ring)
    return [(quads(front[~black]), WHITE), (quads(front[black]), BLACK), (body, _BACK)]


def _holes(target: HoleBoard) -> list[tuple[Mesh, Material]]:
    """Return the front with its holes, and the back with the walls of rim and holes."""
    from scipy.spatial import Delaunay

    turn = 2 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    rings = [target.outline[:, :2], *(np.array([x, y]) + r * circle for x, y, r in target.holes)]
    points = np.concatenate(rings)
    ring_of = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    triangles = Delaunay(points).simplices
    of = ring_of[triangles]
    # The points of a hole are so close that its rim is among the edges; triangles with three of them are the hole.
    faces = triangles[~((of[:, 0] > 0) & (of == of[:, :1]).all(axis=1))]
    a, b, c = (points[faces[:, i]] for i in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    hole_area = sum(0.5 * _SIDES * np.sin(2 * np.pi / _SIDES) * r**2 for *_, r in target.holes)
    if abs(np.abs(twice).sum() / 2 - (target.width_m * target.height_m - hole_area)) > 1e-9:
        problem = "the holes overlap, or nearly touch one another or the rim"
        raise InputError(problem, expected="a few centimetres of board between them")
    upward = np.where((twice > 0)[:, None], faces, faces[:, ::-1])  # normal along +z: away from the viewer
    front = Mesh(stacked(points, 0.0), upward[:, ::-1])
    back = Mesh(stacked(points, THICKNESS_M), upward)
    walls = [_wall(rings[0]), *(_wall(ring[::-1]) for ring in rings[1:])]
    return [(front, WHITE), (join([back, *walls]), _BACK)]


def _wall(ring: Float) -> Mesh:
    """Return the outward-facing sides between front and back along a ring (K, 2) that turns from x to y."""
    front, back = (stacked(ring, z) for z in (0.0, THICKNESS_M))
    return quads(np.stack([front, np.roll(front, -1, axis=0), np.roll(back, -1, axis=0), back], 1))
