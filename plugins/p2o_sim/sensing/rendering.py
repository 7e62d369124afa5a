"""Render a scene with any camera: light, exact depth and normals, instances and classes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Camera, Float, UInt8, occlusion

from p2o_sim.sensing.light import shade, sky
from p2o_sim.sensing.photo import Photo, Single, develop
from p2o_sim.sensing.threads import in_slices
from p2o_sim.world.scene import Class, Hits, Scene

# Four positions in a pixel, all in different rows and columns, for four steps at nearly vertical and horizontal edges.
_SUBPIXELS = np.array([[-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]])
# Leaves are too many for four positions; two on a diagonal suffice at the resolution of the lens.
_LEAFY_SUBPIXELS = np.array([[-0.25, -0.25], [0.25, 0.25]])
# Corners of boards are measured to a tenth of a pixel: sixteen positions, again in different rows and columns.
_BOARD_SUBPIXELS = np.column_stack([np.arange(16), np.arange(16) * 7 % 16]) / 16 - 15 / 32
_PIXELS_A_SLICE = 16_384


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """The rendered image of a camera, before lens and sensor effects, with its ground truth.

    `light` (H, W, 3) is linear RGB averaged over each pixel; all other arrays are those of the ray through the pixel
    centre: `depth_m` (H, W) along the optical axis, +inf for sky, NaN if unseen; `normals` (H, W, 3) outward unit
    normals in the camera frame, zero for sky; `instance` (H, W) numbers of things from 1, 0 for sky; `classes` (H, W)
    Class numbers; `seen` (H, W) is False if the camera model has no ray for the pixel (outside a fisheye's circle).
    """

    light: Single
    depth_m: Float
    normals: Float
    instance: NDArray[np.int32]
    classes: UInt8
    seen: Bool

    @cached_property
    def rgb(self) -> UInt8:
        """Image (H, W, 3) of a noiseless camera."""
        return develop(self.light, Photo(), np.random.default_rng(0))

    @cached_property
    def foliage(self) -> Bool:
        """Mask (H, W) of pixels with leaves."""
        return np.asarray(self.classes == Class.FOLIAGE)


def render(scene: Scene, camera: Camera, world_from_camera: Float, time_s: float = 0.0) -> RenderedImage:
    """Render the image of a camera at world_from_camera (4, 4) and a time.

    One ray per pixel is cast, and several at the borders of surfaces for antialiasing.
    """
    height, width = camera.height, camera.width
    rays, seen = _pixel_rays(camera)
    scene.prepare()
    count = len(rays)
    light, distance = np.empty((count, 3), np.float32), np.empty(count)
    face, normal = np.empty(count, np.int64), np.empty((count, 3))

    def look(part: slice) -> None:
        hits, light[part] = _look(scene, rays[part], world_from_camera, camera.focal_px, time_s)
        distance[part], face[part], normal[part] = hits.distance_m, hits.face, hits.normal

    in_slices(look, count, _PIXELS_A_SLICE)

    of_face = np.where(face < 0, -1, scene.part_of_face[face])
    classes = np.where(of_face < 0, np.uint8(Class.SKY), scene.class_of_part[of_face]).astype(np.uint8)
    hard, leafy = _outlines(of_face, normal, classes, height, width)
    of_board = hard & (classes == Class.BOARD).reshape(height, width)
    steps = ((hard & ~of_board, _SUBPIXELS), (of_board, _BOARD_SUBPIXELS), (leafy, _LEAFY_SUBPIXELS))
    for outline, places in steps:
        pixels = np.flatnonzero(outline.ravel() & seen)

        def refine(part: slice, pixels: NDArray[np.int64] = pixels, places: Float = places) -> None:
            """Replace the light of outlines by the mean over positions (K, 2) inside their pixels."""
            chosen = pixels[part]
            uv = np.stack([chosen % width, chosen // width], axis=1).astype(np.float64)
            fine = camera.rays(uv[:, None] + places)
            fine = np.where(np.isfinite(fine), fine, rays[chosen, None])  # at the rim of a fisheye's circle
            _, colour = _look(scene, fine.reshape(-1, 3), world_from_camera, camera.focal_px, time_s)
            light[chosen] = colour.reshape(len(chosen), len(places), 3).mean(axis=1)

        in_slices(refine, len(pixels), _PIXELS_A_SLICE // len(places))

    light[~seen] = 0.0
    size = (height, width)
    return RenderedImage(
        light.reshape(*size, 3),
        np.where(seen, distance * rays[:, 2], np.nan).reshape(size),
        (normal @ world_from_camera[:3, :3]).reshape(*size, 3),
        np.where(of_face < 0, 0, scene.thing_of_part[of_face] + 1).reshape(size).astype(np.int32),
        classes.reshape(size),
        seen.reshape(size),
    )


@lru_cache(maxsize=2)
def _pixel_rays(camera: Camera) -> tuple[Float, Bool]:
    """Return unit rays (H * W, 3) of all pixels in row-major order, and which exist; missing rays are the z axis."""
    uv = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).reshape(-1, 2)
    rays = camera.rays(uv.astype(np.float64))
    seen: Bool = np.asarray(np.isfinite(rays).all(axis=1))
    rays[~seen] = (0.0, 0.0, 1.0)
    rays.flags.writeable = seen.flags.writeable = False
    return rays, seen


def _look(scene: Scene, rays: Float, world_from_camera: Float, focal_px: float, time_s: float) -> tuple[Hits, Single]:
    """Cast camera rays (N, 3) and return their hits with linear colours (N, 3)."""
    directions = rays @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    hits = scene.cast(origin, directions, time_s)
    colour = np.empty((len(rays), 3), np.float32)
    away, met = np.flatnonzero(hits.face < 0), np.flatnonzero(hits.face >= 0)
    if len(away):
        colour[away] = sky(scene, directions[away])
    if not len(away):
        colour = shade(scene, origin, directions, hits, focal_px, time_s)
    elif len(met):
        colour[met] = shade(scene, origin, directions[met], hits.take(met), focal_px, time_s)
    return hits, colour


def _outlines(part: NDArray[np.int64], normal: Float, classes: UInt8, height: int, width: int) -> tuple[Bool, Bool]:
    """Return masks (H, W) of pixels at hard outlines, and at leafy ones, which have leaves on either side."""
    size = (height, width)
    part, classes, leaf = part.reshape(size), classes.reshape(size), (classes == Class.FOLIAGE).reshape(size)
    facing: Single = normal.astype(np.float32).reshape(*size, 3)
    hard, leafy = np.zeros(size, bool), np.zeros(size, bool)
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        other = part[a] != part[b]
        either = leaf[a] | leaf[b]
        turns = (part[a] >= 0) & (np.einsum("hwi,hwi->hw", facing[a], facing[b]) < 0.99)
        sharp, soft = (other | turns) & ~either, either & (classes[a] != classes[b])
        for outline, change in ((hard, sharp), (leafy, soft)):
            outline[a] |= change
            outline[b] |= change
    return hard, leafy & ~hard


def labels(rendered: RenderedImage, camera: Camera, *, mask_foliage: bool = False) -> occlusion.Orders:
    """Return which pixels occlude which of their neighbours (connectivity 8), optionally without edges of leaves.

    `p2o.occlusion.edges_from_orders` turns the orders into directed edge pixels.
    """
    masked = rendered.foliage if mask_foliage else None
    depth_m, normals = rendered.depth_m, rendered.normals
    return occlusion.occlusion_orders(
        depth_m, camera, min_jump_m=0.4, relative_jump=0.0, normals=normals, masked=masked, connectivity=8
    )
