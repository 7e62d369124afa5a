"""Scenes whose every distance is known in closed form: a wall, a floor, and a box or board between them and sensors."""

from __future__ import annotations

import numpy as np
from p2o import se3
from p2o_sim.things.boards import Board, thing_of
from p2o_sim.world.mesh import Mesh, loft, rectangle
from p2o_sim.world.scene import Material, Part, Scene

GREY = Material("grey", (0.5, 0.5, 0.5), contrast=0.3, reflectance=0.5)
WALL_X = 10.0
FLOOR_Z = -1.5
BOX_X = 5.0
"""The box is the cube from (5, -1, -1) to (7, 1, 1)."""

FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Axes of a camera that looks along +x with z up, and of a board that faces it, in the world."""
WORLD_FROM_CAMERA = se3.make(FORWARD)
"""A camera at the origin that looks along +x, with z up."""


def box(length: float, width: float, low: float, high: float) -> Mesh:
    """Return a box centred on the z axis from height `low` to `high`."""
    return loft([rectangle(length, width, low), rectangle(length, width, high)])


def walls(*, with_box: bool = True, to_sun: tuple[float, float, float] = (-1.0, 0.3, 1.0)) -> Scene:
    parts = [
        Part(box(1.0, 200.0, -50.0, 100.0).moved(WALL_X + 0.5), GREY, 0),
        Part(box(300.0, 300.0, FLOOR_Z - 1.0, FLOOR_Z), GREY, 1),
    ]
    if with_box:
        parts.append(Part(box(2.0, 2.0, -1.0, 1.0).moved(BOX_X + 1.0), GREY, 2))
    return Scene(tuple(parts), to_sun=to_sun)


ON_A_CAR = se3.make(FORWARD, (0.0, 0.0, 1.65)), se3.make(translation=(0.0, 0.1, 1.7))
"""Poses of a camera and a LiDAR in the world of `before_a_wall`."""


def before_a_wall(board: Board) -> Scene:
    """Return a floor at 0 and a wall at x = 9 with the bare board or body before them."""
    grey = Material("grey", (0.3, 0.3, 0.3), reflectance=0.4)
    still = Part(box(1.0, 60.0, -1.0, 12.0).moved(9.5), grey, 0), Part(box(80.0, 80.0, -1.0, 0.0), grey, 1)
    return Scene(still, to_sun=(-1.0, 0.4, 0.7)).plus([thing_of(board)])


def in_frame(board: Board, xyz: np.ndarray) -> np.ndarray:
    """Return points of the frame of the LiDAR on a car in that of a board."""
    return se3.apply(se3.inverse(board.world_from_board) @ ON_A_CAR[1], xyz)


def volume(meshes: list[Mesh]) -> float:
    """Return the volume inside of closed surfaces by the divergence theorem: positive only if faces look outwards."""
    a, b, c = np.moveaxis(np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]), 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def down_axis(camera_height: float) -> np.ndarray:
    """Return world_from_camera of a camera above the origin that looks straight down, image x along world x."""
    return se3.make([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]], (0.0, 0.0, camera_height))
