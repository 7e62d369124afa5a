"""Triangle meshes and the solids from which scenes are built. Metres; x forward, y left, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from p2o import Float, Int


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: `vertices` (V, 3) m and `faces` (F, 3) rows of them, counter-clockwise seen from outside."""

    vertices: Float
    faces: Int

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw_deg: float = 0.0) -> Mesh:
        """Return the mesh rotated about z by `yaw_deg` degrees, then shifted by (x, y, z) metres."""
        cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Mesh(self.vertices @ turn.T + np.array([x, y, z]), self.faces)

    def __add__(self, other: Mesh) -> Mesh:
        """Return the union of both meshes, with the faces of this one first."""
        return join([self, other])

    def bent(self, curvature: float) -> Mesh:
        """Return the mesh in a world whose x axis is bent to the left by `curvature` in 1/m, in the x-y plane."""
        if curvature == 0.0:
            return self
        x, y, z = self.vertices.T
        angle = curvature * x
        radius = 1 / curvature - y
        return Mesh(np.column_stack([np.sin(angle) * radius, 1 / curvature - np.cos(angle) * radius, z]), self.faces)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Return the union of meshes, with faces in the given order."""
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


def boxes(low: ArrayLike, high: ArrayLike) -> Mesh:
    """Return axis-parallel boxes between corners `low` and `high` (N, 3)."""
    lower, upper = np.atleast_2d(np.asarray(low, np.float64)), np.atleast_2d(np.asarray(high, np.float64))
    pick = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    vertices = np.where(pick[None].astype(bool), upper[:, None], lower[:, None])
    return _copies(vertices, _BOX_FACES)


def sized(low: ArrayLike, size: ArrayLike) -> Mesh:
    """Return axis-parallel boxes with lower corners `low` (N, 3) and side lengths `size` (3,) or (N, 3)."""
    lower = np.asarray(low, np.float64)
    return boxes(lower, lower + np.asarray(size, np.float64))


def stacked(*values: ArrayLike) -> Float:
    """Return arrays (N,) or (N, K), and numbers, which are repeated, as the columns of one array."""
    count = next(len(value) for value in values if isinstance(value, np.ndarray) and value.ndim)
    return np.column_stack([value if np.ndim(value) else np.full(count, value) for value in values])


def tubes(start: ArrayLike, end: ArrayLike, radius: ArrayLike, sides: int = 6) -> Mesh:
    """Return closed tubes from `start` to `end` (N, 3) with `radius` (N,) or (N, 2), for start and end."""
    begin, stop = np.atleast_2d(np.asarray(start, np.float64)), np.atleast_2d(np.asarray(end, np.float64))
    width = np.asarray(radius, np.float64)
    if width.ndim < 2:
        width = np.repeat(np.broadcast_to(width, len(begin))[:, None], 2, axis=1)
    along = stop - begin
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    helper = np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(along, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(turn)[:, None] * side[:, None] + np.sin(turn)[:, None] * other[:, None]
    ends = [begin[:, None] + width[:, :1, None] * ring, stop[:, None] + width[:, 1:, None] * ring]
    return _copies(np.concatenate(ends, 1), _prism_faces(sides))


def quads(corners: Float) -> Mesh:
    """Return quadrilaterals with corners (N, 4, 3)."""
    return _copies(np.asarray(corners, np.float64), np.array([[0, 1, 2], [0, 2, 3]]))


def leaves(centre: Float, size: Float, rng: np.random.Generator, *, corners: int = 4, upright: float = 0.0) -> Mesh:
    """Return randomly rotated leaves at `centre` (N, 3) with length `size` (N,) in m; `upright` 0..1 favours vertical.

    With four corners they are lozenges of two faces, with three single triangles, for leaves of a few pixels.
    """
    long, across = rng.normal(size=(2, len(centre), 3))
    long[:, 2] += 4.0 * upright
    long /= np.linalg.norm(long, axis=1, keepdims=True)
    across -= (across * long).sum(axis=1, keepdims=True) * long
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    long *= 0.5 * np.broadcast_to(size, len(centre))[:, None]
    across *= (0.28 - 0.24 * upright) * np.broadcast_to(size, len(centre))[:, None]
    if corners == 4:
        return quads(np.stack([centre - long, centre + across, centre + long, centre - across], axis=1))
    wide = 1.4 * across
    triangles = np.stack([centre + long, centre - 0.7 * long + wide, centre - 0.7 * long - wide], 1)
    return _copies(triangles, np.array([[0, 1, 2]]))


def swept(profile: Float, x: Float) -> Mesh:
    """Return the sheet that a line `profile` (P, 2) of y, z, or (S, P, 2), sweeps along x (S,).

    Its outer side is upwards if y decreases along the profile.
    """
    line = np.broadcast_to(profile, (len(x), *np.shape(profile)[-2:]))
    stations, points = line.shape[:2]
    vertices = np.concatenate([np.broadcast_to(x[:, None, None], (stations, points, 1)), line], axis=2).reshape(-1, 3)
    first = (np.arange(stations - 1)[:, None] * points + np.arange(points - 1)).ravel()
    a, b, c, d = first, first + 1, first + points + 1, first + points
    return Mesh(vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


def _copies(vertices: Float, faces: Int) -> Mesh:
    """Return solids (N, V, 3) that share the table of faces (F, 3) of a single one."""
    count, corners = vertices.shape[:2]
    return Mesh(vertices.reshape(-1, 3), (faces + corners * np.arange(count)[:, None, None]).reshape(-1, 3))


def _prism_faces(sides: int) -> Int:
    """Return the faces of a prism, whose corners are the start ring, then the end ring, clockwise from the start."""
    this = np.arange(sides)
    after = (this + 1) % sides
    fan = this[1:-1]
    walls = [np.column_stack([this, after + sides, this + sides]), np.column_stack([this, after, after + sides])]
    zero = np.zeros_like(fan)
    caps = [np.column_stack([zero, fan + 1, fan]), np.column_stack([zero + sides, sides + fan, sides + fan + 1])]
    return np.concatenate(walls + caps)


_BOX_FACES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6],
     [3, 0, 4], [3, 4, 7]]
)  # fmt: skip


def circle(radius: float, z: float, sides: int = 16) -> Float:
    """Return the ring (sides, 3) of a circle about the z axis at height z."""
    turn = 2 * np.pi * np.arange(sides) / sides
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, z)])


def cylinder(radius: float, low: float, high: float, *, top_radius: float | None = None, sides: int = 16) -> Mesh:
    """Return an upright cylinder, or a truncated cone with another radius at the top."""
    return loft([circle(radius, low, sides), circle(radius if top_radius is None else top_radius, high, sides)])


def wheel(radius: float, width: float, sides: int = 20) -> Mesh:
    """Return a cylinder whose axis is y, centred on the origin."""
    upright = cylinder(radius, -0.5 * width, 0.5 * width, sides=sides)
    x, y, z = upright.vertices.T
    return Mesh(np.column_stack([x, -z, y]), upright.faces)
