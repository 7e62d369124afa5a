"""Weather: its effect on the light and the surfaces of a scene, on the air and on an image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from p2o import Camera, Float, UnknownNameError, se3

from p2o_sim.sensing.lidar import CLEAR_AIR, Air
from p2o_sim.sensing.photo import Single
from p2o_sim.world.lighting import Lamp, Lighting, triple
from p2o_sim.world.palette import GLASS, HEADLIGHT, SIGN_BACK, TAIL_LIGHT
from p2o_sim.world.scene import Class, Material, Part, Scene

WEATHERS = ("clear", "overcast", "rain", "fog", "night")
"""Names of the kinds of weather; `any` draws one of them."""
_SHARES = (0.35, 0.2, 0.15, 0.12, 0.18)
_LAMPS_AT_NIGHT = 8
_STREET_LAMPS = ((1.0, 0.6, 0.25), (1.0, 0.92, 0.8), (0.85, 0.95, 1.0))
"""Sodium, warm white and cold white."""
_LIT = {id(HEADLIGHT): 12.0, id(TAIL_LIGHT): 3.0, id(SIGN_BACK): 15.0}
"""Glow at night of lamps, which are identified by their material."""
_FALL_M_S, _SHUTTER_S, _DROP_M = 7.0, 0.01, 0.002
_STREAKS_FROM_M, _STREAKS_TO_M = 0.4, 5.0


@dataclass(frozen=True)
class Weather:
    """The weather of one scene; the default is a clear day without effects.

    `sun`, `sky`, `overcast` as in Lighting; contrast decreases to 5 % over `visibility_m`; `rain` in 0..1 is from none
    to a downpour; `exposure_ev` (stops) and `grain` (a factor) are the effects of little light on a camera.
    """

    name: str = "clear"
    sun: float = 1.0
    sky: tuple[float, float, float] = (1.0, 1.0, 1.0)
    overcast: float = 0.0
    visibility_m: float = 4500.0
    rain: float = 0.0
    exposure_ev: float = 0.0
    grain: float = 1.0
    wet_lens: float = 0.0
    air: Air = CLEAR_AIR


def weather_of(name: str, rng: np.random.Generator) -> Weather:
    """Return weather of a kind, or of a random kind for "any"; intensities of rain, fog and so on are drawn.

    Raises UnknownNameError for an unknown kind.
    """
    if name not in (*WEATHERS, "any"):
        raise UnknownNameError("weather", name, ["any", *WEATHERS])
    kind = str(rng.choice(WEATHERS, p=_SHARES)) if name == "any" else name
    grey = rng.uniform(0.45, 0.9)
    if kind == "clear":
        return Weather()
    if kind == "overcast":
        return Weather(kind, rng.uniform(0.0, 0.1), (grey,) * 3, rng.uniform(0.75, 1.0), rng.uniform(1500.0, 4500.0))
    if kind == "rain":
        rain = float(rng.uniform(0.15, 1.0))
        air = Air(0.0004 + 0.0022 * rain**0.6, 0.001 + 0.009 * rain, 5.0)
        return Weather(
            kind, 0.0, (0.8 * grey,) * 3, 1.0, 4000.0 / (1 + 8 * rain), rain, exposure_ev=-0.2, grain=1.4,
            wet_lens=float(rng.uniform(0.2, 1.0)) if rng.random() < 0.4 else 0.0, air=air,
        )  # fmt: skip
    if kind == "fog":
        visibility = float(np.exp(rng.uniform(np.log(40.0), np.log(300.0))))
        air = Air(3.0 / visibility, min(0.06, 2.0 / visibility), 2.0 + visibility / 50.0)
        return Weather(kind, 0.0, (grey + 0.1,) * 3, 1.0, visibility, air=air)
    glow = rng.uniform(0.003, 0.02) * np.array([1.0, 0.95, rng.uniform(0.8, 1.5)])
    overcast, ev, grain = rng.uniform(0.0, 1.0), rng.uniform(-2.0, -0.5), rng.uniform(2.0, 4.5)
    return Weather(kind, 0.0, triple(glow), overcast, exposure_ev=ev, grain=grain)


def in_weather(scene: Scene, weather: Weather, rng: np.random.Generator) -> Scene:
    """Return a scene in other weather: its light, wet ground, lamps, and lit windows at night.

    Inside a building there is no rain or fog; only the light through the windows changes.
    """
    if weather.name == "clear":
        return scene
    lighting = scene.lighting
    inside, indoors = lighting.inside, lighting.inside is not None
    if inside is not None and weather.name == "night":
        inside = replace(inside, ambient=triple(0.6 * share for share in inside.ambient))
    day = max(weather.sky)
    lamps = tuple(
        replace(lamp, colour=triple(day * share for share in lamp.colour)) if lamp.daylight else lamp
        for lamp in lighting.lamps
    )

    def change(part: Part) -> Part:
        if weather.rain > 0:
            material = _wet(part, weather.rain, indoors=indoors)
        else:
            material = _at_night(part, rng) if weather.name == "night" else part.material
        return part if material is part.material else replace(part, material=material)

    parts = tuple(map(change, scene.parts))
    movers = tuple(replace(mover, parts=tuple(map(change, mover.parts))) for mover in scene.movers)
    if weather.name == "night":
        lamps += _street_lamps(rng, scene.parts)
    haze_m, wet = lighting.haze_m if indoors else weather.visibility_m / 3.0, weather.rain > 0 and not indoors
    changed = Lighting(weather.sun, weather.sky, weather.overcast, inside, lamps, haze_m, wet)
    return replace(scene, parts=parts, movers=movers, lighting=changed)


def _wet(part: Part, rain: float, *, indoors: bool) -> Material:
    """Return the material of a part in rain: the ground is darker, reflects, and returns less energy to a LiDAR."""
    material = part.material
    if part.kind not in (Class.ROAD, Class.PAVEMENT, Class.TERRAIN) or (indoors and part.kind == Class.ROAD):
        return material
    gloss, dark = 0.1 + 0.16 * rain, 0.72 - 0.2 * rain
    if part.kind == Class.TERRAIN:  # grass and soil do not mirror
        gloss, dark = 0.0, 0.5 + 0.5 * dark
    colour, reflectance = triple(dark * share for share in material.colour), dark * material.reflectance
    return replace(material, colour=colour, gloss=max(gloss, material.gloss), reflectance=reflectance)


def _at_night(part: Part, rng: np.random.Generator) -> Material:
    """Return the material of a lamp that is on, of a lit window, or the unchanged one."""
    material = part.material
    glow = _LIT.get(id(material))
    if glow is not None:
        return replace(material, glow=glow)
    if material is GLASS and part.kind == Class.BUILDING and rng.random() < 0.35:
        warm, glow = (0.9, 0.66, 0.36), float(rng.uniform(0.08, 0.6))
        return replace(material, name="lit window", colour=warm, contrast=0.5, pattern="slabs", glow=glow)
    return material


def _street_lamps(rng: np.random.Generator, parts: tuple[Part, ...]) -> tuple[Lamp, ...]:
    """Return the light of the street lamps of a scene, which are identified by the material of their heads."""
    tint, strength = _STREET_LAMPS[rng.integers(3)], rng.uniform(10.0, 30.0)
    colour = triple(share * strength for share in tint)
    out = []
    for part in parts:
        if part.material is SIGN_BACK:
            x, y, _ = part.mesh.vertices.mean(axis=0)
            below = float(part.mesh.vertices[:, 2].min()) - 0.05
            out.append(Lamp((float(x), float(y), below), colour, 0.5, (0.0, 0.0, -1.0), 0.8))
    return tuple(out)


def headlights(world_from_lidar: Float, height_m: float) -> tuple[Lamp, ...]:
    """Return both headlights of the vehicle whose LiDAR is at world_from_lidar (4, 4), `height_m` above the road."""
    ahead = world_from_lidar[:3, :3] @ np.array([1.0, 0.0, -0.06])
    places = se3.apply(world_from_lidar, np.array([[1.6, y, 0.65 - height_m] for y in (-0.6, 0.6)]))
    # A low beam is brighter at a distance, like a larger lamp.
    return tuple(Lamp(triple(place), (60.0, 58.0, 52.0), 7.0, triple(ahead), 14.0) for place in places)


def lit_near(scene: Scene, world_from_lidar: Float, more: tuple[Lamp, ...] = ()) -> Scene:
    """Return a scene with the lamps nearest to the point 12 m ahead of the rig, and additional lamps."""
    lighting = scene.lighting
    ahead = se3.apply(world_from_lidar, np.array([[12.0, 0.0, 0.0]]))[0]
    order = sorted(lighting.lamps, key=lambda lamp: float(np.linalg.norm(np.array(lamp.place) - ahead)))
    return scene.lit(replace(lighting, lamps=(*order[:_LAMPS_AT_NIGHT], *more)))


def rained_on(
    light: Single, depth_m: Float, camera: Camera, camera_from_world: Float, weather: Weather, rng: np.random.Generator
) -> Single:
    """Return the light (H, W, 3) of an image with falling drops, and with drops on the lens.

    A drop in front of the surface appears as a streak of the sky's colour, as long as its fall during the exposure.
    """
    import cv2

    if weather.rain <= 0:
        return light
    height, width = light.shape[:2]
    count = int(weather.rain * 0.0035 * height * width)
    uv = rng.uniform(0.0, 1.0, (count, 2)) * [width - 1.0, height - 1.0]
    # Uniform density: the share within z would grow with its cube, but far drops are too faint to be visible.
    low, high = _STREAKS_FROM_M**2, _STREAKS_TO_M**2
    z = np.sqrt(low + rng.uniform(0.0, 1.0, count) * (high - low))
    fall = camera_from_world[:3, :3] @ np.array([0.15, 0.1, -1.0]) * _FALL_M_S * _SHUTTER_S
    rays = camera.rays(uv)
    start = rays * (z / np.maximum(rays[:, 2], 0.2))[:, None]
    ends = camera.project(start + fall)
    behind = depth_m[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    shown = np.isfinite(ends).all(axis=1) & np.isfinite(rays).all(axis=1) & (behind > z)
    veil = np.zeros((height, width), np.uint8)
    for a, b, near in zip(uv[shown], ends[shown], z[shown], strict=True):
        wide = _DROP_M * camera.focal_px / near
        # A drop covers a pixel during a small part of its fall only.
        alpha = 255 * min(1.0, wide) * min(0.6, 6.0 * wide / max(float(np.hypot(*(b - a))), 1.0))
        begin, stop = (tuple(int(v) for v in np.rint(np.clip(p, -1e4, 1e4) * 16)) for p in (a, b))
        cv2.line(veil, begin, stop, int(alpha), max(1, round(wide)), cv2.LINE_AA, 4)
    share = cv2.GaussianBlur(veil, (0, 0), 0.7).astype(np.float32)[..., None] / 255
    bright = np.float32(max(float(np.percentile(light, 90)), 1e-3))
    out = light + share * (bright - light)
    return _through_drops(out, weather.wet_lens, rng) if weather.wet_lens > 0 else out


def _through_drops(light: Single, share: float, rng: np.random.Generator) -> Single:
    """Return the light (H, W, 3) behind drops on the lens, which blur the covered region."""
    import cv2

    height, width = light.shape[:2]
    mask = np.zeros((height, width), np.uint8)
    for _ in range(int(6 + 30 * share)):
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        radius = max(2, int(width * rng.uniform(0.003, 0.02)))
        cv2.ellipse(mask, centre, (radius, int(radius * rng.uniform(0.8, 1.4))), 0, 0, 360, 255, -1)
    blend = cv2.GaussianBlur(mask, (0, 0), 0.002 * width + 0.5).astype(np.float32)[..., None] / 255
    # A drop acts as a lens: it shows the scene upside down and out of focus.
    blurred = cv2.GaussianBlur(light[::-1], (0, 0), 0.012 * width)
    seen = 0.5 * (blurred + cv2.GaussianBlur(light, (0, 0), 0.01 * width))
    return np.asarray(light + np.float32(0.8) * blend * (seen - light), np.float32)
