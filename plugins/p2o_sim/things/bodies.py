"""Calibration targets that are solid bodies: spheres and boxes of one matt colour each, and the pole below them."""

from __future__ import annotations

import numpy as np
from p2o import Box, Float, Sphere, se3

from p2o_sim.world.lighting import triple
from p2o_sim.world.mesh import Mesh, quads, stacked, tubes
from p2o_sim.world.palette import DARK_STEEL
from p2o_sim.world.place import Thing
from p2o_sim.world.scene import Class, Material, Part

COLOURS = {
    "magenta": (0.55, 0.04, 0.36), "blue": (0.05, 0.11, 0.6), "green": (0.05, 0.42, 0.08), "red": (0.6, 0.05, 0.05),
    "orange": (0.65, 0.21, 0.02), "teal": (0.02, 0.36, 0.4), "violet": (0.24, 0.07, 0.58), "lime": (0.3, 0.48, 0.02),
}  # fmt: skip
"""Colours of bodies, linear RGB, in the order of the bodies of a frame."""
TONES = (1.0, 0.74, 0.55)
"""Brightness of the faces of a box normal to its x, y and z axis, so that each edge is visible in any light."""
_HALVINGS = 6
"""Subdivisions of an octahedron: the faces of a sphere then deviate by at most 0.02 % of its radius."""


def body_parts(target: Sphere | Box, number: int) -> list[tuple[Mesh, Material]]:
    """Return the meshes of a body in its own frame, with materials in the colour of body `number`."""
    name = list(COLOURS)[number % len(COLOURS)]
    if isinstance(target, Sphere):
        return [(ball(target.radius_m), _matt(f"{name} ball", COLOURS[name], 1.0))]
    corners = target.outline
    # Faces of a box as bits of its corners, at -x and +x, -y and +y, -z and +z, counter-clockwise seen from outside.
    rings = [[(0, 4, 6, 2), (1, 3, 7, 5)], [(0, 1, 5, 4), (2, 6, 7, 3)], [(0, 2, 3, 1), (4, 5, 7, 6)]]
    return [
        (quads(corners[np.array(pair)]), _matt(f"{name} box {axis}", COLOURS[name], tone))
        for axis, pair, tone in zip("xyz", rings, TONES, strict=True)
    ]


def _matt(name: str, colour: tuple[float, float, float], tone: float) -> Material:
    return Material(name, triple(tone * share for share in colour), 0.03, reflectance=0.6, pattern="plain")


def ball(radius_m: float) -> Mesh:
    """Return a sphere of 32,768 faces; its corners have the radius to within 1e-12 of it."""
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
    """Return a rotation (3, 3) of a box that turns one of its corners approximately to a direction (3,) of the world.

    All three faces of that corner are visible at similar angles, with a deviation of up to 15 degrees.
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
    """Return a tripod that ends at the centre (3,) of a body in the world."""
    return tripod(centre[None], ground_m, (0.018,), foot_m=0.35, low_m=0.05, knee_m=0.2, sides=12)


def tripod(
    rods: Float, ground_m: float, radii_m: tuple[float, ...], *, foot_m: float, low_m: float, knee_m: float, sides: int
) -> Thing:
    """Return a tripod below the first of the points `rods` (N, 3), which its pole, from `low_m` above ground, joins."""
    foot = np.array([rods[0, 0], rods[0, 1], ground_m])
    turn = 2 * np.pi * np.arange(3) / 3 + 0.3
    toes = foot + foot_m * stacked(np.cos(turn), np.sin(turn), 0.0)
    start = np.concatenate([[foot + [0, 0, low_m]], rods[:-1], np.tile(foot + [0.0, 0.0, knee_m], (3, 1))])
    poles = tubes(start, np.concatenate([rods, toes]), np.array([*radii_m, 0.012, 0.012, 0.012]), sides=sides)
    return [Part(poles, DARK_STEEL, kind=Class.POLE)]
