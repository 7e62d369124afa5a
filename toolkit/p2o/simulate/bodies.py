"""Calibration targets that are solid bodies: balls and boxes of one matt colour each, and the pole that carries one."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.frames.target import Box, Sphere
from p2o.geometry import se3
from p2o.simulate.classes import Class
from p2o.simulate.mesh import Mesh, quads, tubes
from p2o.simulate.palette import DARK_STEEL
from p2o.simulate.place import Thing
from p2o.simulate.scene import Material, Part

COLOURS = {
    "magenta": (0.55, 0.04, 0.36),
    "blue": (0.05, 0.11, 0.6),
    "green": (0.05, 0.42, 0.08),
    "red": (0.6, 0.05, 0.05),
    "orange": (0.65, 0.21, 0.02),
    "teal": (0.02, 0.36, 0.4),
    "violet": (0.24, 0.07, 0.58),
    "lime": (0.3, 0.48, 0.02),
}
"""Colours of bodies, linear RGB: the first body of a frame has the first one, and so on."""
TONES = (1.0, 0.74, 0.55)
"""How light the faces of a box across its x, y and z axis are, so that each edge shows in any light."""
_HALVINGS = 6
"""Of the edges of an octahedron's faces: the faces of a ball then lie at most 0.02 % of its radius inside of it."""
_POLE_M, _FOOT_M = 0.018, 0.35


def body_parts(target: Sphere | Box, number: int) -> list[tuple[Mesh, Material]]:
    """Return the meshes of a body in its own frame, with materials of the colour of body `number`."""
    name = list(COLOURS)[number % len(COLOURS)]
    if isinstance(target, Sphere):
        return [(ball(target.radius_m), _matt(f"{name} ball", COLOURS[name], 1.0))]
    corners = target.outline
    # Faces of a box by the bits of its corners, at -x and +x, -y and +y, -z and +z, counter-clockwise from outside.
    rings = [[(0, 4, 6, 2), (1, 3, 7, 5)], [(0, 1, 5, 4), (2, 6, 7, 3)], [(0, 2, 3, 1), (4, 5, 7, 6)]]
    return [
        (quads(corners[np.array(pair)]), _matt(f"{name} box {axis}", COLOURS[name], tone))
        for axis, pair, tone in zip("xyz", rings, TONES, strict=True)
    ]


def _matt(name: str, colour: tuple[float, float, float], tone: float) -> Material:
    red, green, blue = (tone * share for share in colour)
    return Material(name, (red, green, blue), contrast=0.03, reflectance=0.6, pattern="plain")


def ball(radius_m: float) -> Mesh:
    """Return a ball of 32,768 faces; its corners lie on the sphere to within 1e-12 of its radius."""
    signs = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    octants = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    triangles = signs[np.array(octants)]
    for _ in range(_HALVINGS):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = (_unit(p + q) for p, q in ((a, b), (b, c), (c, a)))
        triangles = np.concatenate(
            [np.stack(corners, 1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return Mesh(radius_m * triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def _unit(vectors: Float) -> Float:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def turned_to(towards: Float, rng: np.random.Generator) -> Float:
    """Return a rotation (3, 3) of a box that turns one of its corners about to a direction (3,) of the world.

    All three faces of that corner are seen at about the same slant, up to 15 degrees off.
    """
    corner = rng.choice([-1.0, 1.0], 3) / np.sqrt(3)
    helper = np.eye(3)[int(np.argmin(np.abs(towards)))]
    frames = []
    for axis, other in ((towards, helper), (corner, np.array([1.0, 0.0, 0.0]))):
        side = np.cross(axis, other)
        side /= np.linalg.norm(side)
        frames.append(np.stack([axis, side, np.cross(axis, side)], axis=1))
    roll = se3.exp(np.r_[rng.uniform(-np.pi, np.pi) * towards, 0, 0, 0])[:3, :3]
    lean = rng.normal(size=3)
    lean *= np.radians(rng.uniform(0, 15)) / np.linalg.norm(lean)
    return np.asarray(se3.exp(np.r_[lean, 0, 0, 0])[:3, :3] @ roll @ frames[0] @ frames[1].T)


def pole_below(centre: Float, ground_m: float) -> Thing:
    """Return a pole on three feet that ends in the middle of a body, at a place (3,) of the world."""
    foot = np.array([centre[0], centre[1], ground_m])
    turn = 2 * np.pi * np.arange(3) / 3 + 0.3
    toes = foot + _FOOT_M * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    knee = foot + [0.0, 0.0, 0.2]
    start = np.concatenate([[foot + [0, 0, 0.05]], np.tile(knee, (3, 1))])
    poles = tubes(start, np.concatenate([[centre], toes]), np.array([_POLE_M, 0.012, 0.012, 0.012]), sides=12)
    return [Part(poles, DARK_STEEL, kind=Class.POLE)]
