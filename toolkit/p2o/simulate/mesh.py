"""Triangle meshes and the few solids that streets are built of. Metres; x forward, y left, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from p2o import se3
from p2o.arrays import Float, Int


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: `vertices` (V, 3) m and `faces` (F, 3) rows of them, counter-clockwise seen from outside."""

    vertices: Float
    faces: Int

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw_deg: float = 0.0) -> Mesh:
        """Return the mesh turned about z by `yaw_deg` degrees, then shifted by (x, y, z) metres."""
        turn = se3.exp(np.array([0.0, 0.0, np.radians(yaw_deg), 0.0, 0.0, 0.0]))
        turn[:3, 3] = (x, y, z)
        return Mesh(se3.apply(turn, self.vertices), self.faces)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh of several, faces in the order given."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=False)]),
    )


def loft(rings: Sequence[Float]) -> Mesh:
    """Return the closed solid through rings (K, 3) of equal length, counter-clockwise seen from above, low to high."""
    sides, count = len(rings[0]), len(rings)
    this = np.arange(sides)
    after = (this + 1) % sides
    walls = []
    for low in np.arange(count - 1) * sides:
        a, b, c, d = low + this, low + after, low + sides + after, low + sides + this
        walls += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    fan = this[1:-1]
    top = (count - 1) * sides
    caps = [
        np.column_stack([np.zeros_like(fan), fan + 1, fan]),
        np.column_stack([np.full_like(fan, top), top + fan, top + fan + 1]),
    ]
    return Mesh(np.concatenate([np.asarray(r, np.float64) for r in rings]), np.concatenate(walls + caps))


def rectangle(length: float, width: float, z: float, *, x: float = 0.0, y: float = 0.0) -> Float:
    """Return the ring (4, 3) of a rectangle centred on (x, y) at height z, `length` along x, `width` along y."""
    corners = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    return np.column_stack([corners + np.array([x, y]), np.full(4, z)])


def box(length: float, width: float, low: float, high: float) -> Mesh:
    """Return a box centred on the z axis from height `low` to `high`."""
    return loft([rectangle(length, width, low), rectangle(length, width, high)])


def circle(radius: float, z: float, sides: int = 16) -> Float:
    """Return the ring (sides, 3) of a circle about the z axis at height z."""
    turn = 2 * np.pi * np.arange(sides) / sides
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, z)])


def cylinder(radius: float, low: float, high: float, *, top_radius: float | None = None, sides: int = 16) -> Mesh:
    """Return an upright cylinder, or a cone's stump with another radius at the top."""
    return loft([circle(radius, low, sides), circle(radius if top_radius is None else top_radius, high, sides)])


def wheel(radius: float, width: float, sides: int = 20) -> Mesh:
    """Return a cylinder whose axis is y, centred on the origin."""
    upright = cylinder(radius, -0.5 * width, 0.5 * width, sides=sides)
    x, y, z = upright.vertices.T
    return Mesh(np.column_stack([x, -z, y]), upright.faces)


def blob(radius: float, rng: np.random.Generator, *, roughness: float = 0.25) -> Mesh:
    """Return a lumpy ball about the origin (a crown, a bush): radius varies by `roughness` of itself."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    unit = np.asarray(ball.vertices, np.float64)
    bumps = np.zeros(len(unit))
    for frequency in (2.0, 4.0, 7.0):
        direction = rng.normal(size=(3, 4))
        bumps += np.sin(frequency * unit @ direction + rng.uniform(0, 2 * np.pi, 4)).sum(axis=1) / (4 * frequency**0.5)
    return Mesh(unit * (radius * (1 + roughness * bumps))[:, None], np.asarray(ball.faces, np.int64))
