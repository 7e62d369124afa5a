"""Balls and boxes of known places: what both sensors find of them without noise, and frames that are drawn of them."""

from __future__ import annotations

from functools import cache

import numpy as np
from p2o import Box, Camera, Cloud, Frame, Image, Sphere, se3
from p2o.arrays import Float
from p2o_sim.things.bodies import turned_to

from tests.baselines.board_scene import CAMERA, TRUTH, beams

BALL = Sphere(0.25)
CUBOID = Box(0.9, 0.7, 0.5)
COLOURS = np.array([[200.0, 30, 150], [30, 60, 200], [30, 160, 40]])
TONES = (1.0, 0.8, 0.6)
GREY = 120.0


def meets_ball(start: Float, way: Float, centre: Float, radius_m: float) -> Float:
    """Return how far along unit rays (N, 3) a ball is met, inf where it is not."""
    to = centre - start
    along = way @ to if to.ndim == 1 else np.einsum("ni,ni->n", way, to)
    inner = along**2 - np.sum(to**2, axis=-1) + radius_m**2
    return np.where((inner > 0) & (along > 0), along - np.sqrt(np.maximum(inner, 0)), np.inf)


def meets_box(start: Float, way: Float, sensor_from_box: Float, size_m: Float) -> tuple[Float, Float]:
    """Return how far along rays (N, 3) a box is met, inf where it is not, and across which axis its face is."""
    box_from_sensor = se3.inverse(sensor_from_box)
    begin = se3.apply(box_from_sensor, np.broadcast_to(start, way.shape))
    ways = way @ box_from_sensor[:3, :3].T
    with np.errstate(divide="ignore"):
        one, two = ((sign * size_m / 2 - begin) / ways for sign in (-1, 1))
    enter, leave = np.minimum(one, two), np.maximum(one, two).min(axis=1)
    far = enter.max(axis=1)
    return np.where((far < leave) & (far > 0), far, np.inf), enter.argmax(axis=1)


_PLACES = [(k / 4 - 3 / 8, (3 * k % 4) / 4 - 3 / 8) for k in range(4)]


@cache
def _rays(camera: Camera) -> list[Float]:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return [camera.rays(np.stack([u + x, v + y], -1).reshape(-1, 2)) for x, y in _PLACES]


def picture(camera: Camera, things: list[Float], target: Sphere | Box, noise: float = 0.0) -> Image:
    """Return a picture of bodies before grey, four rays a pixel, in sRGB.

    `things` are the middles (3,) m of balls, or camera_from_box (4, 4), each of its own colour.
    """
    total = np.zeros((camera.height * camera.width, 3))
    for rays in _rays(camera):
        light = np.full((len(rays), 3), (GREY / 255) ** 2.2)
        for index, thing in enumerate(things):
            tone: Float | float = 1.0
            if isinstance(target, Sphere):
                at = meets_ball(np.zeros(3), rays, thing, target.radius_m)
            else:
                at, axis = meets_box(np.zeros(3), rays, thing, target.size_m)
                tone = np.array(TONES)[axis][np.isfinite(at)][:, None]
            light[np.isfinite(at)] = tone * (COLOURS[index % 3] / 255) ** 2.2
        total += light / len(_PLACES)
    value = np.where(total <= 0.0031308, 12.92 * total, 1.055 * total ** (1 / 2.4) - 0.055) * 255
    value += np.random.default_rng(0).normal(0, 1, value.shape) * noise
    return Image(np.clip(np.rint(value), 0, 255).astype(np.uint8).reshape(camera.height, camera.width, 3), camera)


def sweep(things: list[Float], target: Sphere | Box, noise_m: float = 0.0, seed: int = 0, rings: int = 40) -> Cloud:
    """Return 40 rings a degree apart, four points a degree, of bodies before a wall 9 m ahead, and of a post.

    `things` are those of `picture`, in the camera frame.
    """
    rng = np.random.default_rng(seed)
    lidar_from_camera = se3.inverse(TRUTH)
    way, ring = beams(np.linspace(-20, 20, rings), np.arange(-60, 60, 0.25))
    distance = 9.0 / way[:, 0]
    distance[np.abs(np.arctan2(way[:, 1], way[:, 0]) - 0.9) < 0.02] = 4.0
    for thing in things:
        if isinstance(target, Sphere):
            at = meets_ball(np.zeros(3), way, se3.apply(lidar_from_camera, thing[None])[0], target.radius_m)
        else:
            at, _ = meets_box(np.zeros(3), way, lidar_from_camera @ thing, target.size_m)
        distance = np.minimum(distance, at)
    distance = distance + rng.normal(0, 1, len(distance)) * noise_m
    return Cloud(way * distance[:, None], ring=ring)


def frame(number: int, things: list[Float], target: Sphere | Box, noise_m: float = 0.015) -> Frame:
    """Return a frame that shows bodies to both sensors."""
    return Frame(
        f"pose{number}",
        picture(CAMERA, things, target, noise=2.0),
        sweep(things, target, noise_m, number),
        camera_from_lidar=TRUTH,
        targets=(target,) * len(things),
    )


def corner_on(count: int, seed: int = 0) -> list[Float]:
    """Return camera_from_box (4, 4) of boxes 2.5 to 4 m ahead that turn a corner to us."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        depth = rng.uniform(2.5, 4)
        centre = np.array([*(rng.uniform(-0.3, 0.3, 2) * [1.0, 0.5] * depth), depth])
        out.append(se3.make(turned_to(-centre / np.linalg.norm(centre), rng), centre))
    return out
