"""Shading of surfaces under sun, sky, lamps and haze. Linear RGB, in which sunlit white is about 1."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from p2o import Float, Int
from p2o.reading import pose_at

from p2o_sim.sensing.photo import Single
from p2o_sim.sensing.texture import PATTERNS, clouds, texture
from p2o_sim.world.lighting import Inside, Lamp
from p2o_sim.world.scene import Hits, Scene

_SUN = np.array([1.0, 0.93, 0.8], np.float32) * 3.0
_SKY_HIGH = np.array([0.16, 0.36, 0.8], np.float32)
_SKY_LOW = np.array([0.7, 0.85, 1.0], np.float32)
_AMBIENT = np.array([0.68, 0.78, 0.92], np.float32)
_WHITE = np.array([1.0, 1.0, 1.0], np.float32)
_GREY = np.array([0.92, 0.96, 1.0], np.float32)
_LOW = np.float32(0.75)
"""Brightness of the horizon of an overcast sky relative to the zenith."""
_FAINT = np.float32(0.004)
"""Imperceptible light of a lamp, at which it fades to zero."""
_WAVES = 0.1
"""Roughness of wet ground, as the tangent of a slope."""
_CORNER, _CORNER_M = np.float32(0.32), np.float32(0.4)
"""Darkening of the interior of a building in its corners, and its range."""
_SHADOW_BIAS_M = 2e-3


def sky(scene: Scene, directions: Float) -> Single:
    """Return the colour (N, 3) of the sky: blue above, pale at the horizon, with clouds and a glow around the sun."""
    d = np.asarray(directions, np.float32)
    height = np.clip(d[:, 2], 0.0, 1.0)
    blue = _SKY_LOW + (_SKY_HIGH - _SKY_LOW) * np.sqrt(np.clip(2.0 * height, 0.0, 1.0))[:, None]
    layer = np.asarray(d[:, :2] / np.maximum(height, np.float32(0.03))[:, None], np.float32)
    cover = np.clip(1.4 * clouds(layer) + 2.6 * np.float32(scene.cloudiness) - 1.3, 0.0, 1.0)
    blue += (_WHITE * 1.15 - blue) * (cover * np.clip(12 * height, 0.0, 1.0))[:, None]
    lighting = scene.lighting
    glow = np.clip(d @ _to_sun(scene), 0.0, 1.0) ** 8 * np.float32(lighting.sun)
    out = np.asarray(blue * (0.8 + 1.2 * (1 - np.float32(scene.cloudiness)) * glow)[:, None], np.float32)
    if lighting.overcast > 0:
        out += (_GREY * (_LOW + (1 - _LOW) * height)[:, None] - out) * np.float32(lighting.overcast)
    return np.asarray(out * np.array(lighting.sky, np.float32), np.float32)


def shade(scene: Scene, origin: Float, directions: Float, hits: Hits, focal_px: float, time_s: float) -> Single:
    """Return the linear colours (N, 3) of surfaces that rays from origin (3,) along directions (N, 3) hit.

    The result includes texture, sun and lamps with shadows, sky light, reflections and haze. All rays must hit a
    surface; `focal_px` defines the size of a pixel.
    """
    colour, contrast, gloss, pattern, thin, glow = _looks(scene)
    lighting = scene.lighting
    day = np.array(lighting.sky, np.float32)
    part = scene.part_of_face[hits.face]
    points = origin + hits.distance_m[:, None] * directions
    d, normal = directions.astype(np.float32), hits.normal.astype(np.float32)
    distance = hits.distance_m.astype(np.float32)
    slant = np.einsum("ni,ni->n", normal, d)
    facing = np.abs(slant)
    normal *= -np.sign(slant)[:, None]

    # At grazing incidence a pixel covers more of the surface in one direction: use the geometric mean of both.
    footprint = distance / np.float32(focal_px) / np.sqrt(np.maximum(facing, np.float32(0.02)))
    place = _places(scene, points, hits, time_s)
    place += ((scene.thing_of_part[part] * 7) % 61).astype(np.float32)[:, None] * np.float32(1.37)
    albedo = colour[part] * np.exp(contrast[part] * texture(pattern[part], place, footprint))[:, None]

    to_sun, leafy = _to_sun(scene), thin[part]
    towards = normal @ to_sun
    sunlit = np.where(leafy, np.float32(0.15) + np.float32(0.6) * np.abs(towards), np.maximum(towards, 0.0))
    lit = np.flatnonzero(sunlit > 0) if lighting.sun > 0 else np.zeros(0, np.int64)
    side = np.where(towards[lit] < 0, -_SHADOW_BIAS_M, _SHADOW_BIAS_M)[:, None]
    blocked = scene.blocked(points[lit] + side * normal[lit], np.asarray(to_sun, np.float64), time_s)
    sunlit[lit[blocked]] = 0.0
    sunlit *= np.float32(lighting.sun)

    open_sky = scene.openness[hits.face]
    veil = np.float32(scene.cloudiness)
    ambient = (np.float32(0.25) + np.float32(0.17) * normal[:, 2]) * open_sky * (1 + veil)
    light = ambient[:, None] * (_AMBIENT * day)
    within = _within(lighting.inside, points)
    if lighting.inside is not None:
        light[within] = _indoors(lighting.inside, points[within].astype(np.float32), normal[within])
    light += (sunlit * (1 - np.float32(0.75) * veil**2))[:, None] * _SUN
    for lamp in lighting.lamps:
        _add_lamp(scene, lamp, points, normal, leafy, time_s, light)
    shown = albedo * light

    shiny = np.flatnonzero(gloss[part] > 0)
    if len(shiny):
        share = (gloss[part[shiny]] * (np.float32(0.12) + np.float32(0.88) * (1 - facing[shiny]) ** 3))[:, None]
        mirrored = d[shiny] + 2 * facing[shiny, None] * normal[shiny]
        # Below the horizon a mirror reflects the street: dark, without detail.
        reflection = np.where(mirrored[:, 2:] > 0.02, sky(scene, mirrored), np.float32(0.08) * day)
        if lighting.wet:
            # Wet ground reflects the objects on it.
            ground = np.flatnonzero(normal[shiny, 2] > 0.9)
            rows = shiny[ground]
            reflected = mirrored[ground].astype(np.float64)
            for axis in (0, 1):  # the film of water is not flat
                wave = texture(np.zeros(len(rows), np.int64), 3 * place[rows] + 7 * axis, footprint[rows])
                reflected[:, axis] += _WAVES * wave
            reflected /= np.linalg.norm(reflected, axis=1, keepdims=True)
            met = scene.cast(points[rows] + _SHADOW_BIAS_M * normal[rows], reflected, time_s)
            hit = np.flatnonzero(met.face >= 0)
            its = scene.part_of_face[met.face[hit]]
            reflection[ground[hit]] = colour[its] * (np.float32(0.6) * _AMBIENT * day + glow[its, None])
        if lighting.inside is not None:
            # Walls and furniture, without detail; lamps above are brighter.
            room = np.array(lighting.inside.ambient, np.float32) * (0.5 + np.clip(mirrored[:, 2:], 0.0, 1.0))
            reflection = np.where(within[shiny, None], room, reflection)
        shown[shiny] += share * (np.float32(0.8) * reflection - shown[shiny])
    if glow.any():
        shown += glow[part, None] * albedo
    haze = 1 - np.exp(-distance / np.float32(lighting.haze_m))
    veil_colour = (_SKY_LOW + (_LOW * _GREY - _SKY_LOW) * np.float32(lighting.overcast)) * day
    return np.asarray(shown + haze[:, None] * (veil_colour - shown), np.float32)


def _within(inside: Inside | None, points: Float) -> NDArray[np.bool_]:
    """Return the mask (N,) of points (N, 3) inside the building; the outer sides of its walls do not belong to it."""
    if inside is None:
        return np.zeros(len(points), bool)
    low, high = (np.array(corner) for corner in (inside.low, inside.high))
    return np.asarray(((points > low - 0.05) & (points < high + 0.05)).all(axis=1))


def _indoors(inside: Inside, points: Single, normal: Single) -> Single:
    """Return the ambient light (N, 3) on surfaces at points (N, 3) inside a building, reduced in its corners."""
    low, high = (np.array(corner, np.float32) for corner in (inside.low, inside.high))
    share = 1 + normal @ np.array(inside.lean, np.float32)
    gap = np.maximum(np.minimum(points - low, high - points), 0.0)
    # A wall does not darken itself: only the distance to walls that are not coplanar with the surface counts.
    near = _CORNER * (1 - np.abs(normal)) * np.exp(-gap / _CORNER_M)
    share *= np.prod(1 - near, axis=1)
    return np.asarray(share[:, None] * np.array(inside.ambient, np.float32), np.float32)


def _add_lamp(
    scene: Scene, lamp: Lamp, points: Float, normal: Single, thin: NDArray[np.bool_], time_s: float, light: Single
) -> None:
    """Add, in place, the light of a lamp to that on surfaces (N, 3), except in shadows."""
    towards_lamp = (np.array(lamp.place) - points).astype(np.float32)
    distance = np.maximum(np.linalg.norm(towards_lamp, axis=1), np.float32(1e-3))
    towards_lamp /= distance[:, None]
    towards = np.einsum("ni,ni->n", normal, towards_lamp)
    lit = np.where(thin, np.float32(0.15) + np.float32(0.6) * np.abs(towards), np.maximum(towards, 0.0))
    lit /= distance**2 + np.float32(lamp.size_m) ** 2
    if lamp.aim is not None:
        aim = np.array(lamp.aim, np.float32)
        cosine = -(towards_lamp @ (aim / np.linalg.norm(aim)))
        lit *= np.clip(cosine, 0.0, 1.0) ** np.float32(lamp.sharpness)
    faint = _FAINT / np.float32(max(lamp.colour))
    rows = np.flatnonzero(lit > faint)
    if not len(rows):
        return
    lit[rows] *= 1 - (faint / lit[rows]) ** 2
    side = np.where(towards[rows] < 0, -_SHADOW_BIAS_M, _SHADOW_BIAS_M)[:, None]
    reach = np.maximum(distance[rows] - np.float32(lamp.clear_m), np.float32(1e-3))
    rays = towards_lamp[rows].astype(np.float64)
    rows = rows[~scene.blocked(points[rows] + side * normal[rows], rays, time_s, reach.astype(np.float64))]
    light[rows] += lit[rows, None] * np.array(lamp.colour, np.float32)


def _places(scene: Scene, points: Float, hits: Hits, time_s: float) -> Single:
    """Return texture coordinates (N, 2) in metres: the projection along the axis nearest to the normal."""
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
def _looks(scene: Scene) -> tuple[Single, Single, Single, Int, NDArray[np.bool_], Single]:
    """Return colour (P, 3), contrast, gloss, pattern, thinness and glow (P,) of each part."""
    names = ("colour", "contrast", "gloss", "glow")
    colour, contrast, gloss, glow = (a.astype(np.float32) for a in scene.material_table(names))
    pattern = np.array([PATTERNS.index(part.material.pattern) for part in scene.all_parts], np.int64)
    thin = np.array([part.material.thin for part in scene.all_parts], bool)
    return colour, contrast, gloss, pattern, thin, glow


def _to_sun(scene: Scene) -> Single:
    """Return the unit vector (3,) towards the sun."""
    towards = np.asarray(scene.to_sun, np.float64)
    return np.asarray(towards / np.linalg.norm(towards), np.float32)
