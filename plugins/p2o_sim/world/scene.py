"""A scene: triangles with materials, a sun, and ray casting, which all simulated sensors share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Float, InputError, Int, MethodUnavailable, se3
from p2o.reading import moved, pose_at

from p2o_sim.world.lighting import DAY, Lighting
from p2o_sim.world.mesh import Mesh, join


class Class(IntEnum):
    """Semantic class of a part; SKY if a ray hits nothing."""

    SKY = 0
    ROAD = 1
    PAVEMENT = 2
    TERRAIN = 3
    BUILDING = 4
    WALL = 5
    FENCE = 6
    GUARD_RAIL = 7
    POLE = 8
    SIGN = 9
    TRAFFIC_LIGHT = 10
    FOLIAGE = 11
    TRUNK = 12
    CAR = 13
    VAN = 14
    TRUCK = 15
    BUS = 16
    PERSON = 17
    CYCLIST = 18
    FURNITURE = 19
    BOARD = 20


@dataclass(frozen=True)
class Material:
    """Appearance of a surface: `colour` linear RGB in 0..1, `contrast` of its texture, `reflectance` for the LiDAR.

    `gloss` in 0..1 is the share of light that a smooth surface (glass, lacquer) reflects specularly, for camera and
    LiDAR. `pattern` names the texture (see texture.PATTERNS). A `thin` surface (a leaf, cloth) is lit from both sides.
    `glow` is the emitted light relative to its colour.
    """

    name: str
    colour: tuple[float, float, float]
    contrast: float = 0.35
    reflectance: float = 0.4
    gloss: float = 0.0
    pattern: str = "rough"
    thin: bool = False
    glow: float = 0.0


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh with one material and class. Parts of one thing share their `thing` number, the instance.

    `openness` is the visible share of the sky, a number or one per face (F,): 1 in the open, less inside a crown.
    """

    mesh: Mesh
    material: Material
    thing: int = 0
    kind: Class = Class.FURNITURE
    openness: float | Float = 1.0

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw_deg: float = 0.0) -> Part:
        """Return the part rotated about z by `yaw_deg` degrees, then shifted by (x, y, z) metres."""
        return replace(self, mesh=self.mesh.moved(x, y, z, yaw_deg=yaw_deg))


def built(kind: Class, *solids: tuple[Mesh, Material]) -> list[Part]:
    """Return parts of one class: meshes with their materials."""
    return [Part(mesh, material, kind=kind) for mesh, material in solids]


@dataclass(frozen=True, eq=False)
class Mover:
    """Parts that move with constant `twist` (6,), rad/s and m/s in the world frame, from their pose at time 0."""

    parts: tuple[Part, ...]
    twist: Float


@dataclass(frozen=True, eq=False)
class Hits:
    """First surfaces along rays: `distance_m` (N,), +inf without a hit, and `face` (N,), -1 without a hit.

    `normal` (N, 3) is the outward unit normal of the surface in the world frame, zero without a hit; `body` (N,) is 0
    for static parts, i for mover i - 1.
    """

    distance_m: Float
    face: Int
    normal: Float
    body: Int

    def take(self, rows: Int) -> Hits:
        """Return the hits of a subset of rays."""
        return Hits(self.distance_m[rows], self.face[rows], self.normal[rows], self.body[rows])


@dataclass(frozen=True, eq=False)
class Scene:
    """Parts in the world frame (x forward, y left, z up, metres) with a sun in the direction `to_sun` (3,).

    `movers` move relative to the static parts; faces, parts and things are numbered through all of them. `cloudiness`
    in 0..1 is the covered share of the sky; it also softens the sun. `lighting` is all other light.

    Raises InputError for a scene without parts.
    """

    parts: tuple[Part, ...]
    to_sun: tuple[float, float, float] = (0.3, 0.5, 0.8)
    movers: tuple[Mover, ...] = ()
    cloudiness: float = 0.4
    lighting: Lighting = DAY

    def __post_init__(self) -> None:
        if not self.parts:
            raise InputError("the scene is empty", expected="at least one part")

    @cached_property
    def all_parts(self) -> tuple[Part, ...]:
        """The static parts, then those of each mover."""
        return self.parts + tuple(part for mover in self.movers for part in mover.parts)

    @cached_property
    def mesh(self) -> Mesh:
        """All parts as one mesh, at time 0."""
        return join([part.mesh for part in self.all_parts])

    @cached_property
    def part_of_face(self) -> NDArray[np.int32]:
        """Index into `all_parts` of each face (F,)."""
        faces = [len(part.mesh.faces) for part in self.all_parts]
        return np.repeat(np.arange(len(self.all_parts), dtype=np.int32), faces)

    @cached_property
    def planes(self) -> Float:
        """Plane (F, 4) of each face at time 0: outward unit normal n and offset n . x; 0 for degenerate triangles."""
        a, b, c = (self.mesh.vertices[self.mesh.faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        return np.column_stack([normals, np.einsum("ni,ni->n", normals, a)])

    @cached_property
    def openness(self) -> NDArray[np.float32]:
        """Visible share of the sky of each face (F,)."""
        return np.concatenate(
            [np.broadcast_to(np.asarray(p.openness, np.float32), len(p.mesh.faces)) for p in self.all_parts]
        )

    @cached_property
    def _trees(self) -> tuple[tuple[Any, int], ...]:
        """Ray trees of the static parts and of each mover, with the index of their first face."""
        trees, first = [], 0
        for parts in (self.parts, *(mover.parts for mover in self.movers)):
            mesh = join([part.mesh for part in parts])
            trees.append((_ray_tree(mesh), first))
            first += len(mesh.faces)
        return tuple(trees)

    def prepare(self) -> Scene:
        """Build the cached data for ray casting and return the scene; threads share these data."""
        for name in ("_trees", "planes", "part_of_face", "openness", "all_parts"):
            getattr(self, name)
        return self

    def lit(self, lighting: Lighting) -> Scene:
        """Return the scene with other light; it shares the ray trees of this one."""
        self.prepare()
        scene = replace(self, lighting=lighting)
        vars(scene).update({name: value for name, value in vars(self).items() if name not in vars(scene)})
        return scene

    def plus(self, things: Sequence[Sequence[Part]]) -> Scene:
        """Return the scene with additional static things; it shares the ray trees of this one.

        They have the last numbers, as a mover without motion, so that other numbers do not change.
        """
        first = int(self.thing_of_part.max()) + 1
        parts = tuple(replace(part, thing=first + i) for i, thing in enumerate(things) for part in thing)
        scene = replace(self, movers=(*self.movers, Mover(parts, np.zeros(6))))
        tree = _ray_tree(join([part.mesh for part in parts]))
        # The other trees have not changed, and building them is expensive with many leaves.
        vars(scene)["_trees"] = (*self._trees, (tree, len(self.part_of_face)))
        return scene.prepare()

    def cast(self, origins: Float, directions: Float, time_s: float | Float = 0.0) -> Hits:
        """Return the first hits of rays from origins (N, 3) or (3,) along unit directions (N, 3) at time(s) (N,).

        Embree identifies the triangle in single precision; the distance to its plane is in double precision.
        """
        count = len(directions)
        distance, face = np.full(count, np.inf), np.full(count, -1, np.int64)
        normal, body = np.zeros((count, 3)), np.zeros(count, np.int64)
        rows, *hits = self._cast_body(0, origins, directions)
        distance[rows], face[rows], normal[rows] = hits
        for number, mover in enumerate(self.movers, start=1):
            local_origins, local_directions, back = _seen_from(mover.twist, origins, directions, time_s)
            rows, near, its_face, its_normal = self._cast_body(number, local_origins, local_directions)
            first = np.flatnonzero(near < distance[rows])
            rows = rows[first]
            distance[rows], face[rows], body[rows] = near[first], its_face[first], number
            normal[rows] = back(its_normal[first], rows)
        return Hits(distance, face, normal, body)

    def blocked(self, origins: Float, direction: Float, time_s: float = 0.0, reach_m: Float | None = None) -> Bool:
        """Return the mask (N,) of rays from origins (N, 3) along a unit direction (3,), or (N, 3), that hit anything.

        With `reach_m` (N,), only nearer surfaces count.
        """
        out = self._any(0, origins, direction, reach_m)
        for number, mover in enumerate(self.movers, start=1):
            here = pose_at(mover.twist, -time_s)
            rows = np.flatnonzero(~out)
            ways = direction if direction.ndim == 1 else direction[rows]
            reach = None if reach_m is None else reach_m[rows]
            out[rows] = self._any(number, se3.apply(here, origins[rows]), ways @ here[:3, :3].T, reach)
        return out

    def _any(self, body: int, origins: Float, direction: Float, reach_m: Float | None) -> Bool:
        tree, _ = self._trees[body]
        rays = [origins, np.atleast_2d(direction)] + ([] if reach_m is None else [reach_m])
        return np.asarray(tree.run(*(np.ascontiguousarray(a, np.float32) for a in rays), query="OCCLUDED") != -1)

    def _cast_body(self, body: int, origins: Float, directions: Float) -> tuple[Int, Float, Int, Float]:
        """Return the rays that hit one body (M,), and distance (M,), face (M,) and normal (M, 3) of the first face."""
        tree, first = self._trees[body]
        single = np.ascontiguousarray(directions, np.float32)
        start = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), np.float32)
        hit_face = tree.run(start, single)
        rows = np.flatnonzero(hit_face >= 0)
        face = hit_face[rows].astype(np.int64) + first
        plane = self.planes.take(face, axis=0)
        normal = plane[:, :3]
        begin = np.ravel(origins) if np.size(origins) == 3 else origins[rows]
        along = normal @ np.ravel(begin) if np.size(begin) == 3 else np.einsum("ni,ni->n", normal, begin)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (plane[:, 3] - along) / np.einsum("ni,ni->n", normal, directions[rows])
        met = (distance > 0) & np.isfinite(distance)
        if met.all():
            return rows, distance, face, normal
        return rows[met], distance[met], face[met], normal[met]

    def material_table(self, names: Sequence[str]) -> tuple[Float, ...]:
        """Return one array per attribute of Material, with one row per part."""
        return tuple(np.array([getattr(part.material, name) for part in self.all_parts], np.float64) for name in names)

    @cached_property
    def thing_of_part(self) -> NDArray[np.int32]:
        """Instance number of each part (P,)."""
        return np.array([part.thing for part in self.all_parts], np.int32)

    @cached_property
    def class_of_part(self) -> NDArray[np.uint8]:
        """Class of each part (P,)."""
        return np.array([part.kind for part in self.all_parts], np.uint8)


def _seen_from(twist: Float, origins: Float, directions: Float, time_s: float | Float) -> tuple[Float, Float, Any]:
    """Return rays in the frame of a mover at their times, and a function that rotates normals of rows back."""
    if np.ndim(time_s) == 0:
        here = pose_at(twist, -float(time_s))
        local = directions if not np.any(twist[:3]) else directions @ here[:3, :3].T
        return se3.apply(here, np.atleast_2d(origins)), local, lambda normal, _: normal @ here[:3, :3]
    back = -np.asarray(time_s, np.float64)
    start = np.broadcast_to(origins, directions.shape)
    return (
        moved(twist, back, start),
        moved(twist, back, directions, directions=True),
        lambda normal, rows: moved(twist, -back[rows], normal, directions=True),
    )


def _ray_tree(mesh: Mesh) -> Any:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as problem:
        raise MethodUnavailable("the simulator needs embreex for ray casting", hint="pip install embreex") from problem
    tree = EmbreeScene(robust=True)
    TriangleMesh(tree, np.ascontiguousarray(mesh.vertices, np.float32), np.ascontiguousarray(mesh.faces, np.int32))
    # The first ray builds the tree.
    tree.run(np.zeros((1, 3), np.float32), np.array([[1.0, 0.0, 0.0]], np.float32))
    return tree
