"""A made-up street, another one for every seed: facades, parked cars, poles, signs, trees, barriers.

World frame: x along the street, y left, z up, the road's surface at z = 0, the rig at x = y = 0 in the right lane.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from p2o.simulate.mesh import Mesh, blob, box, cylinder, loft, rectangle, wheel
from p2o.simulate.scene import Material, Part, Scene

ROAD = (-4.8, 6.6)
"""The kerbs' y in metres, right and left of the rig."""
FRONTS = (-8.2, 10.4)
"""The y of the house fronts in metres, right and left."""
END_M = 74.0
"""Where a building across closes the street."""

_ASPHALT = Material("asphalt", (0.075, 0.077, 0.08), contrast=0.4, reflectance=0.25)
_PAVING = Material("paving", (0.24, 0.225, 0.2), contrast=0.4, reflectance=0.35)
_PAINT = Material("road paint", (0.72, 0.72, 0.70), contrast=0.22, reflectance=0.8)
_GLASS = Material("glass", (0.035, 0.045, 0.055), contrast=0.5, reflectance=0.08, gloss=0.55)
_FRAME = Material("window frame", (0.62, 0.61, 0.57), contrast=0.15, reflectance=0.6)
_STONE = Material("stone", (0.34, 0.32, 0.29), contrast=0.3, reflectance=0.45)
_TYRE = Material("tyre", (0.025, 0.025, 0.027), contrast=0.3, reflectance=0.06)
_RIM = Material("rim", (0.38, 0.39, 0.4), contrast=0.25, reflectance=0.6)
_TRIM = Material("trim", (0.03, 0.03, 0.032), contrast=0.3, reflectance=0.1)
_HEADLIGHT = Material("headlight", (0.7, 0.7, 0.68), contrast=0.2, reflectance=0.8, gloss=0.2)
_TAIL_LIGHT = Material("tail light", (0.42, 0.02, 0.02), contrast=0.2, reflectance=0.7, gloss=0.2)
_PLATE = Material("plate", (0.7, 0.7, 0.66), contrast=0.15, reflectance=0.95)
_STEEL = Material("steel", (0.26, 0.28, 0.29), contrast=0.25, reflectance=0.5)
_BARK = Material("bark", (0.13, 0.095, 0.065), contrast=0.6, reflectance=0.35)
_WOOD = Material("wood", (0.3, 0.19, 0.1), contrast=0.5, reflectance=0.5)
_SKIN = Material("skin", (0.55, 0.36, 0.27), contrast=0.1, reflectance=0.5)

_WALLS = (
    (0.55, 0.42, 0.28),
    (0.48, 0.2, 0.13),
    (0.58, 0.54, 0.44),
    (0.36, 0.37, 0.38),
    (0.6, 0.48, 0.36),
    (0.3, 0.36, 0.34),
)
_LACQUER = (
    (0.5, 0.5, 0.5),
    (0.35, 0.03, 0.03),
    (0.04, 0.09, 0.26),
    (0.62, 0.62, 0.6),
    (0.05, 0.055, 0.06),
    (0.1, 0.2, 0.16),
)
_SIGNS = ((0.5, 0.03, 0.03), (0.03, 0.12, 0.42), (0.75, 0.74, 0.7), (0.68, 0.5, 0.04))
_CLOTH = ((0.1, 0.12, 0.2), (0.4, 0.1, 0.08), (0.5, 0.47, 0.4), (0.08, 0.2, 0.16))

Thing = list[tuple[Mesh, Material]]
"""Meshes about the z axis with the material of each; the front looks along +x."""


def street(rng: np.random.Generator) -> Scene:
    """Return a street with a rig's place at the origin; the same generator state gives the same street."""
    things: list[Thing] = [_ground(), *_houses(rng), *_far_end(rng), *_parked_cars(rng), *_pavements(rng)]
    return Scene(
        tuple(Part(mesh, material, number) for number, thing in enumerate(things) for mesh, material in thing),
        to_sun=(-0.45, float(rng.choice([-1.0, 1.0])) * rng.uniform(0.35, 0.6), 0.75),
    )


def _placed(thing: Thing, x: float, y: float, z: float = 0.0, *, yaw_deg: float = 0.0) -> Thing:
    return [(mesh.moved(x, y, z, yaw_deg=yaw_deg), material) for mesh, material in thing]


def _along(rng: np.random.Generator, start: float, stop: float, gap: tuple[float, float]) -> Iterator[float]:
    """Yield rising places between start and stop, metres apart within `gap`."""
    place = start + rng.uniform(0.0, gap[0])
    while place < stop:
        yield place
        place += rng.uniform(*gap)


def _ground() -> Thing:
    low, high = ROAD
    middle, width = (low + high) / 2, high - low
    parts: Thing = [(box(260.0, width, -0.3, 0.0).moved(90.0, middle), _ASPHALT)]
    for kerb, outer in ((low, low - 30.0), (high, high + 30.0)):
        parts.append((box(260.0, abs(outer - kerb), -0.3, 0.13).moved(90.0, (kerb + outer) / 2), _PAVING))
        parts.append((box(260.0, 0.16, -0.3, 0.15).moved(90.0, kerb), _STONE))
    parts += [(box(2.6, 0.13, 0.0, 0.004).moved(x, 1.75), _PAINT) for x in np.arange(-4.0, 72.0, 5.5)]
    return parts


def _windows(rng: np.random.Generator, length: float, height: float) -> Thing:
    """Return windows on a wall from x = 0 to `length` whose outer face is y = 0, and looks along -y."""
    parts: Thing = []
    columns = max(1, int(length / rng.uniform(2.3, 3.1)))
    for level, low in enumerate(np.arange(0.9, height - 2.0, 3.1)):
        for column in range(columns):
            x = (column + 0.5) * length / columns + rng.uniform(-0.12, 0.12)
            wide, tall = rng.uniform(1.0, 1.5), rng.uniform(1.4, 1.8)
            if level == 0 and rng.random() < 0.25:  # a door
                parts.append((box(1.2, 0.14, 0.1, 2.4).moved(x, 0.0), _FRAME))
                parts.append((box(1.0, 0.18, 0.1, 2.3).moved(x, 0.0), _WOOD))
                parts.append((box(1.5, 0.5, 0.0, 0.2).moved(x, -0.25), _STONE))
                continue
            parts.append((box(wide + 0.24, 0.12, low - 0.12, low + tall + 0.12).moved(x, 0.0), _FRAME))
            for half in (-1, 1):
                pane = box(wide / 2 - 0.05, 0.16, low, low + tall).moved(x + half * wide / 4, 0.0)
                parts.append((pane, _GLASS))
            parts.append((box(wide + 0.4, 0.4, low - 0.22, low - 0.12).moved(x, -0.1), _STONE))
            if level > 0 and rng.random() < 0.12:  # a balcony
                parts.append((box(wide + 0.8, 1.0, low - 0.45, low - 0.25).moved(x, -0.5), _STONE))
                parts.append((box(wide + 0.8, 0.06, low - 0.25, low + 0.6).moved(x, -0.97), _STEEL))
    return parts


def _house(rng: np.random.Generator, length: float) -> Thing:
    """Return a house from x = 0 to `length` with its front at y = 0, seen from -y."""
    height = rng.uniform(7.5, 14.0)
    wall = Material("wall", _WALLS[rng.integers(len(_WALLS))], contrast=0.4, reflectance=rng.uniform(0.3, 0.6))
    roof = Material("roof", (0.2, 0.1, 0.08), contrast=0.4, reflectance=0.3)
    ridge = [
        rectangle(length, 9.0, height, x=length / 2, y=4.5),
        rectangle(length, 0.1, height + 3.5, x=length / 2, y=4.5),
    ]
    parts: Thing = [
        (box(length, 9.0, 0.0, height).moved(length / 2, 4.5), wall),
        (loft(ridge), roof),
        (box(length, 0.24, 0.0, 0.7).moved(length / 2, 0.0), _STONE),
        (box(length, 0.5, height - 0.25, height).moved(length / 2, 0.0), _STONE),
    ]
    parts += _windows(rng, length, height)
    if rng.random() < 0.5:  # a shop's awning
        cloth = Material("awning", _SIGNS[rng.integers(len(_SIGNS))], contrast=0.3)
        wide, x = rng.uniform(2.5, 4.0), length * rng.uniform(0.3, 0.7)
        slope = [rectangle(wide, 0.1, 2.35, x=x, y=-1.3), rectangle(wide, 0.1, 2.95, x=x, y=0.0)]
        parts.append((loft(slope), cloth))
    return parts


def _houses(rng: np.random.Generator) -> Iterator[Thing]:
    for side, front in zip((-1, 1), FRONTS, strict=True):
        x = -16.0 - rng.uniform(0.0, 8.0)
        while x < END_M - 8.0:
            length = rng.uniform(8.0, 15.0)
            y = front + side * rng.choice([0.0, 0.0, 0.9, 2.2])
            house = _house(rng, length)
            # Built for the left side; on the right the house is turned by half a turn about its middle.
            yield _placed(house, x, y) if side > 0 else _placed(house, x + length, y, yaw_deg=180.0)
            x += length + (rng.uniform(2.5, 5.0) if rng.random() < 0.3 else 0.0)


def _far_end(rng: np.random.Generator) -> Iterator[Thing]:
    """Yield a low wall across the end of the street, with houses and trees behind it."""
    wall = Material("far wall", _WALLS[rng.integers(len(_WALLS))], contrast=0.35, reflectance=0.4)
    yield [(box(0.6, 60.0, 0.0, 2.6).moved(END_M), wall)]
    for y in _along(rng, -30.0, 30.0, (9.0, 14.0)):
        yield _placed(_house(rng, rng.uniform(8.0, 11.0)), END_M + rng.uniform(6.0, 30.0), y + 5.0, yaw_deg=-90.0)
    for y in _along(rng, -25.0, 25.0, (5.0, 12.0)):
        yield _placed(_tree(rng, height=rng.uniform(5.0, 8.0)), END_M + 4.0, y)


def _car(rng: np.random.Generator) -> Thing:
    """Return a car: a body with bonnet and boot, a cabin of glass under a roof, wheels, lights; front along +x."""
    long, wide = rng.uniform(3.9, 4.6), rng.uniform(1.68, 1.82)
    van = rng.random() < 0.25
    shoulder, top = (1.0, 1.95) if van else (rng.uniform(0.84, 0.92), rng.uniform(1.38, 1.52))
    lacquer = Material(
        "lacquer", _LACQUER[rng.integers(len(_LACQUER))], contrast=0.2, reflectance=rng.uniform(0.15, 0.7), gloss=0.12
    )
    body = loft(
        [
            rectangle(long - 0.25, wide - 0.12, 0.22),
            rectangle(long, wide, 0.42),
            rectangle(long - 0.04, wide, 0.62),
            rectangle(long - 0.32, wide - 0.1, shoulder),
        ]
    )
    cabin, shift = (0.86 * long, -0.06 * long) if van else (rng.uniform(0.58, 0.66) * long, -0.07 * long)
    glass = loft(
        [
            rectangle(cabin, wide - 0.14, shoulder - 0.02, x=shift),
            rectangle(0.72 * cabin, wide - 0.42, top - 0.06, x=shift - 0.05 * cabin),
        ]
    )
    roof = loft(
        [
            rectangle(0.74 * cabin, wide - 0.38, top - 0.08, x=shift - 0.05 * cabin),
            rectangle(0.62 * cabin, wide - 0.55, top, x=shift - 0.05 * cabin),
        ]
    )
    pillar = loft(
        [
            rectangle(0.09, wide - 0.11, shoulder - 0.02, x=shift),
            rectangle(0.07, wide - 0.39, top - 0.06, x=shift - 0.05 * cabin),
        ]
    )
    parts: Thing = [(body, lacquer), (glass, _GLASS), (roof, lacquer), (pillar, _TRIM)]
    for x in (-0.31 * long, 0.31 * long):
        for y in (-0.5 * wide + 0.08, 0.5 * wide - 0.08):
            parts.append((wheel(0.32, 0.2).moved(x, y, 0.32), _TYRE))
            parts.append((wheel(0.19, 0.23, sides=10).moved(x, y, 0.32), _RIM))
    for y in (-0.36 * wide, 0.36 * wide):
        parts.append((box(0.12, 0.34, 0.58, 0.72).moved(0.5 * long - 0.1, y), _HEADLIGHT))
        parts.append((box(0.12, 0.3, 0.58, 0.76).moved(-0.5 * long + 0.1, y), _TAIL_LIGHT))
    for x in (-0.5 * long, 0.5 * long):
        parts.append((box(0.06, 0.5, 0.42, 0.53).moved(x), _PLATE))
        parts.append((box(0.1, wide - 0.1, 0.28, 0.38).moved(0.985 * x), _TRIM))
    return parts


def _parked_cars(rng: np.random.Generator) -> Iterator[Thing]:
    for y, start, facing in ((ROAD[0] + 1.15, 7.5, 0.0), (ROAD[1] - 1.15, 5.0, 180.0)):
        for x in _along(rng, start, 62.0, (5.2, 15.0)):
            yield _placed(_car(rng), x, y + rng.uniform(-0.12, 0.12), yaw_deg=facing + rng.uniform(-2.5, 2.5))


def _pole(rng: np.random.Generator) -> Thing:
    return [(cylinder(rng.uniform(0.06, 0.11), 0.0, rng.uniform(4.5, 8.0), top_radius=0.05), _STEEL)]


def _sign(rng: np.random.Generator) -> Thing:
    """Return a sign that looks back along the street: a round or a square plate on a thin pole."""
    face = Material("sign", _SIGNS[rng.integers(len(_SIGNS))], contrast=0.25, reflectance=0.95)
    high = rng.uniform(1.5, 2.3)
    half = rng.uniform(0.3, 0.42)
    parts: Thing = [(cylinder(0.035, 0.0, high + half, sides=8), _STEEL)]
    if rng.random() < 0.5:
        parts.append((box(0.03, 2 * half, high - half, high + half).moved(-0.05), face))
    else:
        disc = wheel(half, 0.03)
        parts.append((disc.moved(yaw_deg=90.0).moved(-0.05, 0.0, high), face))
    return parts


def _tree(rng: np.random.Generator, *, height: float = 0.0) -> Thing:
    high = height or rng.uniform(4.2, 6.0)
    leaf = Material(
        "leaves",
        (rng.uniform(0.05, 0.12), rng.uniform(0.14, 0.22), rng.uniform(0.03, 0.06)),
        contrast=0.8,
        reflectance=0.5,
    )
    parts: Thing = [(cylinder(rng.uniform(0.14, 0.26), 0.0, high, top_radius=0.09, sides=12), _BARK)]
    for _ in range(3):
        x, y, z = rng.uniform((-0.7, -0.7, -0.5), (0.7, 0.7, 0.9))
        parts.append((blob(rng.uniform(0.9, 1.4), rng, roughness=0.5).moved(x, y, high + z), leaf))
    return parts


def _barrier(rng: np.random.Generator) -> Thing:
    """Return two boards on posts across y, with a gap to look through under and between them."""
    wide = rng.uniform(1.6, 2.4)
    red = Material("barrier", (0.6, 0.06, 0.04), contrast=0.25, reflectance=0.9)
    white = Material("barrier board", (0.75, 0.74, 0.71), contrast=0.25, reflectance=0.9)
    parts: Thing = [(box(0.06, 0.06, 0.0, 1.15).moved(0.05, y), _STEEL) for y in (-0.4 * wide, 0.4 * wide)]
    for low, first in ((0.85, red), (0.4, white)):
        cells = np.linspace(-0.5 * wide, 0.5 * wide, 6)
        for i, y in enumerate((cells[:-1] + cells[1:]) / 2):
            board = first if i % 2 == 0 else (white if first is red else red)
            parts.append((box(0.04, wide / 5, low, low + 0.24).moved(0.0, y), board))
    return parts


def _cabinet(rng: np.random.Generator) -> Thing:
    paint = Material("cabinet", _CLOTH[rng.integers(len(_CLOTH))], contrast=0.25, reflectance=0.5)
    return [(box(rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.3), 0.0, rng.uniform(0.7, 1.5)), paint)]


def _bench(rng: np.random.Generator) -> Thing:
    wide = rng.uniform(1.4, 2.0)
    parts: Thing = [(box(wide, 0.45, 0.42, 0.5), _WOOD), (box(wide, 0.05, 0.6, 0.95).moved(0.0, 0.25), _WOOD)]
    parts += [(box(0.08, 0.45, 0.0, 0.42).moved(x), _STEEL) for x in (-0.4 * wide, 0.4 * wide)]
    return parts


def _person(rng: np.random.Generator) -> Thing:
    coat, legs = (
        Material("cloth", _CLOTH[i], contrast=0.4, reflectance=0.4) for i in rng.integers(len(_CLOTH), size=2)
    )
    tall = rng.uniform(1.6, 1.85)
    hip, neck = 0.5 * tall, 0.84 * tall
    parts: Thing = [
        (cylinder(0.08, 0.0, hip, top_radius=0.1, sides=10).moved(0.08 * side, 0.1 * side), legs) for side in (-1, 1)
    ]
    parts.append(
        (loft([rectangle(0.24, 0.4, hip - 0.05), rectangle(0.26, 0.5, neck - 0.08), rectangle(0.12, 0.2, neck)]), coat)
    )
    parts.append((blob(0.12, rng, roughness=0.0).moved(0.0, 0.0, 0.93 * tall), _SKIN))
    return parts


def _pavements(rng: np.random.Generator) -> Iterator[Thing]:
    kinds = (_pole, _sign, _sign, _tree, _barrier, _cabinet, _bench, _person, _sign, _tree)
    for side, kerb, front in zip((-1, 1), ROAD, FRONTS, strict=True):
        order = rng.permutation(len(kinds))
        for i, x in enumerate(_along(rng, 8.0, 60.0, (2.2, 5.5))):
            make = kinds[order[i % len(kinds)]]
            by_the_kerb = make in (_pole, _sign, _tree)
            offset = rng.uniform(0.4, 0.8) if by_the_kerb else rng.uniform(0.9, abs(front - kerb) - 0.8)
            yaw = rng.uniform(-12.0, 12.0) if make is not _bench else 90.0 * (1 + side)
            yield _placed(make(rng), x, kerb + side * offset, 0.13, yaw_deg=yaw)
