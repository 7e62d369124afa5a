"""Detect trihedra: three intersecting planes in a sweep, and the three edges between them, in an image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from p2o import Float, se3

from p2o_baselines.bodies.box_in_picture import BoxInPicture, Flat, Line, intersection
from p2o_baselines.bodies.box_in_sweep import Face, near_corner


@dataclass(frozen=True)
class TrihedronInSweep:
    """Planes normal . x = offset of three faces: `normals` (3, 3) towards the LiDAR, `offsets` (3,) m.

    `middles` (3, 3) m are the centroids of their points, `roots` (3, 3, 3) convert (two rotations in rad, a translation
    in m) of each plane about its centroid to standard deviations. `ways` (3, 3) are the directions of the edges, away
    from the corner: edge k lies in the planes that are not k.
    """

    normals: Float
    offsets: Float
    middles: Float
    roots: Float
    ways: Float

    @property
    def corner(self) -> Float:
        """Return the intersection of the three planes (3,) m."""
        return np.asarray(np.linalg.solve(self.normals, self.offsets))

    @cached_property
    def _across(self) -> Float:
        return np.array([tangents(normal) for normal in self.normals])

    @cached_property
    def _feet(self) -> Float:
        """Return the points of the planes nearest to the centroids of their points (3, 3)."""
        off = self.offsets - np.einsum("ki,ki->k", self.normals, self.middles)
        return np.asarray(self.middles + off[:, None] * self.normals)

    def moved(self, own: Float) -> TrihedronInSweep:
        """Return it with its planes moved by `own` (9,): two turns in rad and a shift in m of each, one by one."""
        normals, offsets = self.normals.copy(), self.offsets.copy()
        for k, (one, two, shift) in enumerate(own.reshape(3, 3)):
            first, second = self._across[k]
            normal = self.normals[k] + one * first + two * second
            normals[k] = normal / np.sqrt(normal @ normal)
            offsets[k] = normals[k] @ self._feet[k] + shift
        ways = edges_of(normals, self.ways)
        return TrihedronInSweep(normals, offsets, self.middles, self.roots, ways)


@dataclass(frozen=True)
class TrihedronInPicture:
    """The three edges of a corner in a flat view, `ways` (3, 2) along them from the corner out."""

    flat: Flat
    lines: tuple[Line, Line, Line]
    ways: Float

    @cached_property
    def corner(self) -> Float:
        """Return the intersection of the edges (2,) px."""
        place = intersection(self.lines)
        assert place is not None
        return place[0]

    @cached_property
    def places(self) -> tuple[Float, Float]:
        """Return unit rays (3, 2, 3) of two points of each edge with independent errors, and these (3,) in rad."""
        ends = []
        for line in self.lines:
            half = line.across_px / max(line.turn_rad, 1e-9)
            ends.append([line.at - half * line.along, line.at + half * line.along])
        across = np.array([line.across_px for line in self.lines])
        return self.flat.rays(np.array(ends)), np.sqrt(2) * across / self.flat.scale_px

    @cached_property
    def interpretation(self) -> Float:
        """Unit normals (3, 3) in the camera frame of the planes through the camera and each edge."""
        rays = self.flat.rays(np.array([[line.at, line.at + 100.0 * line.along] for line in self.lines]))
        normal = np.cross(rays[:, 0], rays[:, 1])
        return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])


def tangents(normal: Float) -> tuple[Float, Float]:
    """Return two unit vectors (3,) orthogonal to a normal and to each other."""
    x, y, z = normal
    sign = 1.0 if z >= 0 else -1.0  # Duff et al. 2017
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([1.0 + sign * x * x * a, sign * b, -sign * x]), np.array([b, sign + y * y * a, -y])


def edges_of(normals: Float, like: Float | None = None) -> Float:
    """Return the unit edges (3, 3) of three planes, each of the two others; towards `like`, else seen from outside."""
    ways = np.cross(np.roll(normals, -1, axis=0), np.roll(normals, -2, axis=0))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    side = -np.einsum("ki,ki->k", ways, normals) if like is None else np.einsum("ki,ki->k", ways, like)
    return np.asarray(ways * np.where(side < 0, -1.0, 1.0)[:, None])


def of_faces(faces: tuple[Face, Face, Face]) -> TrihedronInSweep:
    """Return the trihedron of three faces of a solid, each plane by its own points."""
    normals = np.array([face.normal for face in faces])
    middles = np.array([face.xyz.mean(axis=0) for face in faces])
    roots = []
    for face, middle in zip(faces, middles, strict=True):
        first, second = tangents(face.normal)
        off = face.xyz - middle
        rows = np.column_stack([off @ first, off @ second, np.ones(len(off))]) / face.sigma_m
        roots.append(np.linalg.cholesky(rows.T @ rows).T)
    offsets = np.array([face.offset_m for face in faces])
    return TrihedronInSweep(normals, offsets, middles, np.array(roots), edges_of(normals))


def of_picture(box: BoxInPicture) -> TrihedronInPicture | None:
    """Return the trihedron of the box corner facing the camera; None if one of its edges is not visible."""
    corner = near_corner(se3.inverse(box.camera_from_box)[:3, 3], box.target.size_m)
    if corner is None or box.edges is None:
        return None
    seen = box.flat.seen(se3.apply(box.camera_from_box, box.target.outline))
    out = np.array([seen[corner ^ (1 << axis)] - seen[corner] for axis in range(3)])
    ways = np.array([line.along * np.sign(line.along @ edge) for line, edge in zip(box.edges, out, strict=True)])
    return TrihedronInPicture(box.flat, box.edges, ways)
