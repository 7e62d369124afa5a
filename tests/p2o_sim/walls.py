"""A scene whose every distance is known in closed form: a wall, a floor, and a box between them and the sensor."""

from __future__ import annotations

import numpy as np
from p2o import se3
from p2o_sim import Material, Part, Scene
from p2o_sim.world.mesh import box

GREY = Material("grey", (0.5, 0.5, 0.5), contrast=0.3, reflectance=0.5)
WALL_X = 10.0
FLOOR_Z = -1.5
BOX_X = 5.0
"""The box is the cube from (5, -1, -1) to (7, 1, 1)."""

WORLD_FROM_CAMERA = se3.make([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""A camera at the origin that looks along +x, with z up."""


def walls(*, with_box: bool = True, to_sun: tuple[float, float, float] = (-1.0, 0.3, 1.0)) -> Scene:
    parts = [
        Part(box(1.0, 200.0, -50.0, 100.0).moved(WALL_X + 0.5), GREY, 0),
        Part(box(300.0, 300.0, FLOOR_Z - 1.0, FLOOR_Z), GREY, 1),
    ]
    if with_box:
        parts.append(Part(box(2.0, 2.0, -1.0, 1.0).moved(BOX_X + 1.0), GREY, 2))
    return Scene(tuple(parts), to_sun=to_sun)


def down_axis(camera_height: float) -> np.ndarray:
    """Return world_from_camera of a camera above the origin that looks straight down, image x along world x."""
    return se3.make([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]], (0.0, 0.0, camera_height))
