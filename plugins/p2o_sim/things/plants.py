"""Trees, hedges, bushes and grass: many small leaves, so that their outlines are as irregular as real ones."""

from __future__ import annotations

import numpy as np
from p2o import Float

from p2o_sim.world.lighting import triple
from p2o_sim.world.mesh import Mesh, boxes, leaves, stacked, tubes
from p2o_sim.world.palette import BARK
from p2o_sim.world.scene import Class, Material, Part

_NEAR_M = 14.0
"""Largest distance for leaves with four corners; farther ones cover few pixels and are triangles."""
_GREENS = ((0.05, 0.085, 0.016), (0.075, 0.11, 0.02), (0.035, 0.06, 0.018), (0.1, 0.11, 0.025), (0.055, 0.07, 0.03))


def leaf(rng: np.random.Generator) -> Material:
    """Return the material of the leaves of one plant; one in eight is turning brown."""
    colour = np.array(_GREENS[rng.integers(len(_GREENS))]) * rng.uniform(0.75, 1.35)
    if rng.random() < 0.12:
        colour = colour * np.array([2.0, 1.0, 0.6])
    return Material("leaves", triple(colour), contrast=0.9, reflectance=float(rng.uniform(0.35, 0.6)), thin=True)


def tree(rng: np.random.Generator, distance_m: float, *, height: float = 0.0, forest: bool = False) -> list[Part]:
    """Return a tree about the z axis; the nearer it is to the road's viewer, the smaller and more its leaves."""
    high = height or rng.uniform(5.0, 11.0)
    slim = rng.uniform(0.16, 0.26) if forest else rng.uniform(0.22, 0.4)
    stem = high * (rng.uniform(0.3, 0.55) if forest else rng.uniform(0.22, 0.35))
    spread, tall = slim * high, (high - stem) / 2
    centre = np.array([0.0, 0.0, high - tall])
    # Crowns are clumps of leaves on twigs, with gaps between them.
    clumps = int(np.clip(26 * spread * tall / 6, 14, 60))
    direction = rng.normal(size=(clumps, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = rng.uniform(0.25, 1.0, clumps) ** 0.5
    middle = centre + direction * reach[:, None] * np.array([spread, spread, tall])
    area = 3.0 * 4 * np.pi * spread * (spread + 2 * tall) / 3
    count, size = _detail(area, distance_m, 9000 if distance_m < _NEAR_M else 3000)
    owner = rng.integers(clumps, size=count)
    width = 0.3 * (spread * spread * tall) ** (1 / 3)
    place = middle[owner] + rng.normal(size=(count, 3)) * width * rng.uniform(0.5, 1.2, (count, 1)) * [1, 1, 0.7]
    place[:, 2] = np.maximum(place[:, 2], 0.55 * stem)
    crown = _crown(rng, place, size, centre, np.array([spread, spread, tall]), distance_m)

    thick = 0.02 * high + rng.uniform(0.03, 0.1)
    lean = rng.normal(size=2) * 0.02 * high
    knots = np.array([[0, 0, -0.3], [*0.3 * lean, 0.5 * stem], [*lean, stem], [*lean * 1.5, high * 0.85]])
    twigs = middle[: min(clumps, 10)]
    forks = np.column_stack([np.tile(lean, (len(twigs), 1)), rng.uniform(stem * 0.8, high * 0.7, len(twigs))])
    trunk = tubes(knots[:-1], knots[1:], np.array([[1.25, 1.0], [1.0, 0.75], [0.75, 0.2]]) * thick, sides=8)
    trunk += tubes(forks, twigs, np.array([[0.35, 0.1]]) * thick, sides=4)
    return [Part(trunk, BARK, kind=Class.TRUNK), crown]


def bush(rng: np.random.Generator, distance_m: float, *, radius: float = 0.0) -> list[Part]:
    """Return a bush about the z axis."""
    wide = radius or rng.uniform(0.5, 1.4)
    half = np.array([wide, wide, wide * rng.uniform(0.7, 1.3)])
    count, size = _detail(24 * wide**2, distance_m, 1800)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    bumps = 1 + 0.3 * np.sin(direction @ rng.normal(size=(3, 5)) * 3 + rng.uniform(0, 6, 5)).mean(axis=1)
    place = direction * (rng.uniform(0.5, 1.0, count) ** 0.4 * bumps)[:, None] * half + [0, 0, 0.75 * half[2]]
    place = place[place[:, 2] > 0.05]
    return [_crown(rng, place, size, np.array([0, 0, 0.6 * half[2]]), half, distance_m)]


def hedge(rng: np.random.Generator, length: float, distance_m: float, *, height: float = 0.0) -> list[Part]:
    """Return a hedge along x from 0 to `length`, about y = 0: leaves around a dark core that lets nothing through."""
    high, wide = height or rng.uniform(1.0, 2.4), rng.uniform(0.6, 1.1)
    count, size = _detail(2.6 * (length + wide) * (2 * high + wide), distance_m, 3500)
    around = rng.uniform(0, 2 * high + wide, count)
    x = rng.uniform(-0.1, length + 0.1, count)
    y = np.clip(around - high, 0, wide) - wide / 2
    z = np.minimum(np.minimum(around, 2 * high + wide - around), high)
    bumps = 0.16 * np.sin(2.1 * x + rng.uniform(0, 6)) + 0.1 * np.sin(5.3 * x + rng.uniform(0, 6))
    place = np.column_stack([x, y, z]) + rng.normal(size=(count, 3)) * [0.1, 0.09, 0.1]
    place[:, 2] *= 1 + bumps * (z > 0.6 * high)
    place[:, 2] = np.maximum(place[:, 2], 0.03)
    core = boxes([[0.15, -0.3 * wide, -0.2]], [[length - 0.15, 0.3 * wide, 0.72 * high]])
    material = leaf(rng)
    green = _foliage(rng, place, size, material, distance_m)
    return [green, Part(core, _shadow(material), kind=Class.FOLIAGE, openness=0.5)]


def tufts(rng: np.random.Generator, place: Float, height_m: float) -> list[Part]:
    """Return blades of long grass at places (N, 3) of the ground."""
    size = height_m * rng.uniform(0.4, 1.2, len(place))
    centre = place + np.column_stack([np.zeros((len(place), 2)), 0.25 * size])
    blades = leaves(centre, size, rng, corners=3, upright=0.85)
    colour = np.array([0.11, 0.13, 0.035]) * rng.uniform(0.8, 1.3)
    material = Material("long grass", triple(colour), 0.6, reflectance=0.45, thin=True)
    return [Part(blades, material, kind=Class.FOLIAGE, openness=rng.uniform(0.5, 1.0, len(place)))]


def thicket(rng: np.random.Generator, length: float, depth: float, height: float, distance_m: float) -> list[Part]:
    """Return the edge of a wood along x from 0 to `length`, towards +y: a dark mass behind rugged leaves."""
    count, size = _detail(3.2 * length * height, distance_m, 3000)
    x, share = rng.uniform(0, length, count), rng.uniform(0, 1, count)
    top = height * (0.72 + 0.16 * np.sin(0.55 * x + rng.uniform(0, 6)) + 0.12 * np.sin(1.7 * x + rng.uniform(0, 6)))
    y = depth * (0.25 + 0.2 * np.sin(0.8 * x + 6 * share) + 0.5 * share**2) + rng.normal(size=count) * 0.3
    place = np.column_stack([x, y, np.maximum(top * share, 0.1)]) + rng.normal(size=(count, 3)) * 0.25
    material = leaf(rng)
    green = _foliage(rng, place, size, material, distance_m)
    steps = np.linspace(0, length, max(2, int(length / 3)) + 1)
    tops = height * rng.uniform(0.42, 0.7, len(steps) - 1)
    low = stacked(steps[:-1], 0.62 * depth, -1.5)
    high = stacked(steps[1:], depth, tops)
    return [green, Part(boxes(low, high), _shadow(material), kind=Class.FOLIAGE, openness=0.35)]


def _detail(area_m2: float, distance_m: float, most: int) -> tuple[int, float]:
    """Return number and size of the leaves that cover an area: 8 pixels each, or larger if limited by `most`."""
    size = float(np.clip(0.011 * distance_m, 0.08, 0.8))
    count = int(np.clip(area_m2 / (0.28 * size**2), 120, most))
    return count, float(np.clip(np.sqrt(area_m2 / (0.28 * count)), size, 1.5 * size))


def _crown(rng: np.random.Generator, place: Float, size: float, centre: Float, half: Float, distance_m: float) -> Part:
    """Return leaves at positions (N, 3); low ones and those deep inside the ellipsoid see less of the sky."""
    inside = (place - centre) / half
    depth = np.clip(1.1 - np.linalg.norm(inside, axis=1), 0, 1)
    openness = np.clip(0.95 - 0.8 * depth + 0.2 * inside[:, 2], 0.12, 1.0)
    return _foliage(rng, place, size, leaf(rng), distance_m, openness)


def _foliage(
    rng: np.random.Generator, place: Float, size: float, material: Material, sight_m: float, openness: Float | float = 1
) -> Part:
    """Return leaves at positions (N, 3), seen from `sight_m` metres, with random changes of size and shade."""
    corners = 4 if sight_m < _NEAR_M else 3
    mesh: Mesh = leaves(place, size * rng.uniform(0.7, 1.3, len(place)), rng, corners=corners)
    shade = openness * rng.uniform(0.45, 1.05, len(place))
    return Part(mesh, material, kind=Class.FOLIAGE, openness=np.repeat(shade, corners - 2))


def _shadow(material: Material) -> Material:
    """Return the material of the interior of a plant."""
    return Material("undergrowth", triple(0.6 * share for share in material.colour), 0.9, 0.3, pattern="grass")
