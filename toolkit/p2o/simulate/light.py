"""Light: the sky, and what surfaces send to the eye under sun, sky and haze. Linear RGB, sunlit white is about 1."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from p2o.arrays import Float, Int
from p2o.geometry.motion import pose_at
from p2o.simulate.scene import Hits, Scene
from p2o.simulate.texture import PATTERNS, clouds, texture

Single = NDArray[np.float32]

_SUN = np.array([1.0, 0.93, 0.8], np.float32) * 3.0
_SKY_HIGH = np.array([0.16, 0.36, 0.8], np.float32)
_SKY_LOW = np.array([0.7, 0.85, 1.0], np.float32)
_AMBIENT = np.array([0.68, 0.78, 0.92], np.float32)
_WHITE = np.array([1.0, 1.0, 1.0], np.float32)
_HAZE_M = np.float32(1500.0)
_SHADOW_BIAS_M = 2e-3


def sky(scene: Scene, directions: Float) -> Single:
    """Return the colour (N, 3) of the sky: deep above, pale at the horizon, with clouds and a glow around the sun."""
    d = np.asarray(directions, np.float32)
    height = np.clip(d[:, 2], 0.0, 1.0)
    blue = _SKY_LOW + (_SKY_HIGH - _SKY_LOW) * np.sqrt(np.clip(2.0 * height, 0.0, 1.0))[:, None]
    layer = np.asarray(d[:, :2] / np.maximum(height, np.float32(0.03))[:, None], np.float32)
    cover = np.clip(1.4 * clouds(layer) + 2.6 * np.float32(scene.cloudiness) - 1.3, 0.0, 1.0)
    blue += (_WHITE * 1.15 - blue) * (cover * np.clip(12 * height, 0.0, 1.0))[:, None]
    glow = np.clip(d @ _to_sun(scene), 0.0, 1.0) ** 8
    return np.asarray(blue * (0.8 + 1.2 * (1 - np.float32(scene.cloudiness)) * glow)[:, None], np.float32)


def shade(scene: Scene, origin: Float, directions: Float, hits: Hits, focal_px: float, time_s: float) -> Single:
    """Return linear colours (N, 3) of what rays from origin (3,) along directions (N, 3) hit, none of them the sky.

    Texture, sun with cast shadows, light of the sky, mirrored sky, haze. `focal_px` tells the size of a pixel.
    """
    colour, contrast, gloss, pattern, thin = _looks(scene)
    part = scene.part_of_face[hits.face]
    points = origin + hits.distance_m[:, None] * directions
    d, normal = directions.astype(np.float32), hits.normal.astype(np.float32)
    distance = hits.distance_m.astype(np.float32)
    slant = np.einsum("ni,ni->n", normal, d)
    facing = np.abs(slant)
    normal *= -np.sign(slant)[:, None]

    # A pixel seen at a slant covers more of the surface one way only: the geometric mean of both ways.
    footprint = distance / np.float32(focal_px) / np.sqrt(np.maximum(facing, np.float32(0.02)))
    place = _places(scene, points, hits, time_s)
    place += ((scene.thing_of_part[part] * 7) % 61).astype(np.float32)[:, None] * np.float32(1.37)
    albedo = colour[part] * np.exp(contrast[part] * texture(pattern[part], place, footprint))[:, None]

    to_sun, leafy = _to_sun(scene), thin[part]
    towards = normal @ to_sun
    sunlit = np.where(leafy, np.float32(0.15) + np.float32(0.6) * np.abs(towards), np.maximum(towards, 0.0))
    lit = np.flatnonzero(sunlit > 0)
    side = np.where(towards[lit] < 0, -_SHADOW_BIAS_M, _SHADOW_BIAS_M)[:, None]
    blocked = scene.blocked(points[lit] + side * normal[lit], np.asarray(to_sun, np.float64), time_s)
    sunlit[lit[blocked]] = 0.0

    open_sky = scene.openness[hits.face]
    veil = np.float32(scene.cloudiness)
    ambient = (np.float32(0.25) + np.float32(0.17) * normal[:, 2]) * open_sky * (1 + veil)
    light = ambient[:, None] * _AMBIENT
    light += (sunlit * (1 - np.float32(0.75) * veil**2))[:, None] * _SUN
    shown = albedo * light

    shiny = np.flatnonzero(gloss[part] > 0)
    if len(shiny):
        share = (gloss[part[shiny]] * (np.float32(0.12) + np.float32(0.88) * (1 - facing[shiny]) ** 3))[:, None]
        mirrored = d[shiny] + 2 * facing[shiny, None] * normal[shiny]
        # Below the horizon a mirror shows the street: dark, without detail.
        reflection = np.where(mirrored[:, 2:] > 0.02, sky(scene, mirrored), np.float32(0.08))
        shown[shiny] += share * (np.float32(0.8) * reflection - shown[shiny])
    haze = 1 - np.exp(-distance / _HAZE_M)
    return np.asarray(shown + haze[:, None] * (_SKY_LOW - shown), np.float32)


def _places(scene: Scene, points: Float, hits: Hits, time_s: float) -> Single:
    """Return texture coordinates (N, 2) in metres: the surface seen along the axis nearest to its normal."""
    local, normal = points, hits.normal
    if hits.body.any():
        local, normal = points.copy(), normal.copy()
        for number, mover in enumerate(scene.movers, start=1):
            rows = np.flatnonzero(hits.body == number)
            back = pose_at(mover.twist, -time_s)
            local[rows] = local[rows] @ back[:3, :3].T + back[:3, 3]
            normal[rows] = normal[rows] @ back[:3, :3].T
    x, y, z = np.abs(normal.T)
    upright = z < np.maximum(x, y)
    along_x = x > y
    u = np.where(upright & along_x, local[:, 1], local[:, 0])
    v = np.where(upright, local[:, 2], local[:, 1])
    return np.stack([u, v], axis=1).astype(np.float32)


@lru_cache(maxsize=4)
def _looks(scene: Scene) -> tuple[Single, Single, Single, Int, NDArray[np.bool_]]:
    """Return colour (P, 3), contrast, gloss, pattern and thinness (P,) of each part."""
    colour, contrast, gloss = (a.astype(np.float32) for a in scene.material_table(("colour", "contrast", "gloss")))
    pattern = np.array([PATTERNS.index(part.material.pattern) for part in scene.all_parts], np.int64)
    thin = np.array([part.material.thin for part in scene.all_parts], bool)
    return colour, contrast, gloss, pattern, thin


def _to_sun(scene: Scene) -> Single:
    """Return the unit vector (3,) towards the sun."""
    towards = np.asarray(scene.to_sun, np.float64)
    return np.asarray(towards / np.linalg.norm(towards), np.float32)
