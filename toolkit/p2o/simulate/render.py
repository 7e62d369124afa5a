"""A picture of a scene through any camera: colour with sun, shadows and texture, and exact depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Bool, Float, UInt8
from p2o.camera import Camera
from p2o.simulate.scene import Hits, Scene
from p2o.simulate.texture import texture, value_noise

_SUN = np.array([1.0, 0.91, 0.76]) * 2.6
_SKY_HIGH = np.array([0.11, 0.29, 0.72])
_SKY_LOW = np.array([0.62, 0.76, 0.92])
_HAZE_M = 900.0
# Four places in a pixel, all on different rows and columns: near-vertical and near-horizontal outlines get four steps.
_SUBPIXELS = np.array([[-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]])


@dataclass(frozen=True, eq=False)
class Picture:
    """`rgb` (H, W, 3) uint8, `depth_m` (H, W) along the optical axis at the pixel centres: +inf sky, NaN unseen.

    `seen` (H, W) is False where the camera model maps no ray to the pixel (outside of a fisheye's circle).
    """

    rgb: UInt8
    depth_m: Float
    seen: Bool


def render(scene: Scene, camera: Camera, world_from_camera: Float) -> Picture:
    """Return the picture that a camera at world_from_camera (4, 4) takes.

    One ray a pixel; four where neighbours show different surfaces, so that outlines are smooth. Colours are box
    averages of a pixel, depth is that of its centre ray.
    """
    height, width = camera.height, camera.width
    uv = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2).astype(np.float64)
    rays = camera.rays(uv)
    seen = np.isfinite(rays).all(axis=1)
    rays[~seen] = (0.0, 0.0, 1.0)
    hits, colour = _look(scene, rays, world_from_camera, camera.focal_px)

    edges = np.flatnonzero(_differs(scene, hits, height, width).ravel() & seen)
    fine = camera.rays(uv[edges, None] + _SUBPIXELS)
    fine = np.where(np.isfinite(fine), fine, rays[edges, None])  # at the rim of a fisheye's circle
    _, fine_colour = _look(scene, fine.reshape(-1, 3), world_from_camera, camera.focal_px)
    colour[edges] = fine_colour.reshape(len(edges), len(_SUBPIXELS), 3).mean(axis=1)

    colour[~seen] = 0.0
    depth = np.where(seen, hits.distance_m * rays[:, 2], np.nan)
    return Picture(
        _to_srgb(colour).reshape(height, width, 3), depth.reshape(height, width), seen.reshape(height, width)
    )


def _look(scene: Scene, rays: Float, world_from_camera: Float, focal_px: float) -> tuple[Hits, Float]:
    """Cast camera rays (N, 3) and return their hits with linear colours (N, 3)."""
    directions = rays @ world_from_camera[:3, :3].T
    hits = scene.cast(world_from_camera[:3, 3], directions)
    colour = np.empty_like(directions)
    away, met = np.flatnonzero(hits.face < 0), np.flatnonzero(hits.face >= 0)
    colour[away] = _sky(directions[away])
    picked = Hits(hits.distance_m[met], hits.face[met])
    colour[met] = _shade(scene, world_from_camera[:3, 3], directions[met], picked, focal_px)
    return hits, colour


def _sky(directions: Float) -> Float:
    """Return the colour (N, 3) of the sky: deep above, pale at the horizon, with clouds."""
    height = np.clip(directions[:, 2:], 0.0, 1.0)
    colour = _SKY_LOW + (_SKY_HIGH - _SKY_LOW) * np.clip(2.2 * height, 0.0, 1.0) ** 0.7
    layer = directions / np.maximum(directions[:, 2:], 0.05)
    cloud = sum(w * value_noise(layer + 7.3 * w, s) for s, w in ((3.1, 0.5), (1.3, 0.3), (0.6, 0.2), (0.27, 0.1)))
    return np.asarray(colour + (0.96 - colour) * np.clip(1.6 * np.asarray(cloud) + 0.1, 0.0, 0.85)[:, None])


def _shade(scene: Scene, origin: Float, directions: Float, hits: Hits, focal_px: float) -> Float:
    """Return linear colours (N, 3) of hits: texture, sun with cast shadows, sky light, mirrored sky, haze."""
    colour, contrast, gloss = scene.material_table(("colour", "contrast", "gloss"))
    part = scene.part_of_face[hits.face]
    points = origin + hits.distance_m[:, None] * directions
    normal = scene.face_normals[hits.face]
    facing = np.abs(np.einsum("ni,ni->n", normal, directions))
    normal = normal * np.where(np.einsum("ni,ni->n", normal, directions) > 0, -1.0, 1.0)[:, None]

    # A pixel seen at a slant covers more of the surface one way only: the geometric mean of both ways.
    footprint = hits.distance_m / focal_px / np.sqrt(np.maximum(facing, 0.02))
    thing = np.array([p.thing for p in scene.parts])[part]
    shift = np.column_stack([(thing * step) % 61.0 for step in (7.31, 3.17, 11.9)])
    albedo = colour[part] * np.exp(contrast[part] * texture(points + shift, footprint))[:, None]

    to_sun = np.array(scene.to_sun) / np.linalg.norm(scene.to_sun)
    sunlit = np.clip(normal @ to_sun, 0.0, None)
    lit = np.flatnonzero(sunlit > 0)
    blocked = scene.cast(points[lit] + 2e-3 * normal[lit], np.tile(to_sun, (len(lit), 1))).face >= 0
    sunlit[lit[blocked]] = 0.0
    ambient = 0.42 + 0.18 * normal[:, 2] + 0.06 * normal[:, 1]
    light = ambient[:, None] * (0.6 * _SKY_LOW + 0.4 * _SKY_HIGH) + sunlit[:, None] * _SUN

    shown = albedo * light
    shiny = np.flatnonzero(gloss[part] > 0)
    share = (gloss[part] * (0.25 + 0.75 * (1 - facing) ** 3))[shiny, None]
    mirrored = directions[shiny] + 2 * facing[shiny, None] * normal[shiny]
    shown[shiny] += share * (0.8 * _sky(mirrored) - shown[shiny])
    haze = 1 - np.exp(-hits.distance_m / _HAZE_M)
    return np.asarray(shown + haze[:, None] * (_SKY_LOW - shown))


def _differs(scene: Scene, hits: Hits, height: int, width: int) -> Bool:
    """Return which pixels (H, W) have a neighbour on another part or on a face of another direction."""
    face = hits.face.reshape(height, width)
    part = np.where(face < 0, -1, scene.part_of_face[face])
    normal = scene.face_normals[face]
    across, down = (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])
    out = np.zeros((height, width), bool)
    for a, b in (across, down):
        turns = (part[a] >= 0) & ((normal[a] * normal[b]).sum(axis=-1) < 0.99)
        change = (part[a] != part[b]) | turns
        out[a] |= change
        out[b] |= change
    return out


def _to_srgb(linear: Float) -> UInt8:
    """Return 8-bit sRGB of linear light, rolled off softly above one half."""
    shown = 1 - np.exp(-1.15 * np.clip(linear, 0.0, None))
    curve = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    return np.asarray(np.clip(255 * curve + 0.5, 0, 255), np.uint8)
