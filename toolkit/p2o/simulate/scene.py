"""A scene: triangles with materials, a sun, and rays cast into it. Every simulated sensor looks at the same one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from p2o.arrays import Float, Int
from p2o.errors import InputError, MethodUnavailable
from p2o.simulate.mesh import Mesh, join


@dataclass(frozen=True)
class Material:
    """How a surface looks: `colour` linear RGB in 0..1, `contrast` of its texture, `reflectance` for the LiDAR.

    `gloss` in 0..1 mixes in the sky that a smooth surface (glass, lacquer) mirrors.
    """

    name: str
    colour: tuple[float, float, float]
    contrast: float = 0.35
    reflectance: float = 0.4
    gloss: float = 0.0


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh of one material. Parts of one thing share their `thing` number, which picks the texture."""

    mesh: Mesh
    material: Material
    thing: int = 0


@dataclass(frozen=True, eq=False)
class Hits:
    """First surfaces along rays: `distance_m` (N,), +inf where there is nothing, and `face` (N,), -1 there."""

    distance_m: Float
    face: Int


@dataclass(frozen=True, eq=False)
class Scene:
    """Parts in the world frame (x forward, y left, z up, metres) under a sun that shines from `to_sun` (3,).

    Raises InputError for a scene without parts.
    """

    parts: tuple[Part, ...]
    to_sun: tuple[float, float, float] = (0.3, 0.5, 0.8)

    def __post_init__(self) -> None:
        if not self.parts:
            raise InputError("the scene is empty", expected="at least one part")

    @cached_property
    def mesh(self) -> Mesh:
        """All parts as one mesh."""
        return join([part.mesh for part in self.parts])

    @cached_property
    def part_of_face(self) -> Int:
        """Index into `parts` of each face (F,)."""
        return np.repeat(np.arange(len(self.parts)), [len(part.mesh.faces) for part in self.parts])

    @cached_property
    def face_normals(self) -> Float:
        """Outward unit normals (F, 3)."""
        a, b, c = np.moveaxis(self.mesh.vertices[self.mesh.faces], 1, 0)
        normals = np.cross(b - a, c - a)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    @cached_property
    def _intersector(self) -> Any:
        try:
            import trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector
        except ImportError as problem:
            raise MethodUnavailable(
                "the simulator casts rays with trimesh and embreex", hint="pip install trimesh embreex"
            ) from problem
        mesh = trimesh.Trimesh(self.mesh.vertices, self.mesh.faces, process=False)
        return RayMeshIntersector(mesh, scale_to_box=False)

    def cast(self, origins: Float, directions: Float) -> Hits:
        """Return what rays from origins (N, 3) along unit directions (N, 3) meet first.

        Embree finds the triangle in single precision; the distance is to the triangle's plane in double precision.
        """
        origins = np.broadcast_to(origins, directions.shape)
        face = np.asarray(self._intersector.intersects_first(origins, directions), np.int64)
        normal = self.face_normals[face]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("ni,ni->n", normal, self.mesh.vertices[self.mesh.faces[face, 0]] - origins)
            distance /= np.einsum("ni,ni->n", normal, directions)
        missed = (face < 0) | ~(distance > 0)
        return Hits(np.where(missed, np.inf, distance), np.where(missed, -1, face))

    def material_table(self, names: Sequence[str]) -> tuple[Float, ...]:
        """Return one array a name of Material, a row a part: how renderers look materials up."""
        return tuple(np.array([getattr(part.material, name) for part in self.parts], np.float64) for name in names)
