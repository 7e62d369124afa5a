"""Cars, vans, trucks and buses: bodies drawn over cross-sections, with glass, wheels and lights. Front along +x."""

from __future__ import annotations

import numpy as np
from p2o import Bool, Float

from p2o_sim.world import palette
from p2o_sim.world.mesh import Mesh, boxes, join, sized, stacked, wheel
from p2o_sim.world.palette import CLOTH, DARK_STEEL, GLASS, HEADLIGHT, PLATE, RIM, SIGNS, TAIL_LIGHT, TRIM, TYRE, pick
from p2o_sim.world.place import Plan, Thing, placed
from p2o_sim.world.scene import Class, Material, Part, built

# Outline of the top as seen from the side: share of the length from the nose, height in metres, width of the top as a
# share of the full width. Windows fill what lies between the belt and the top where the top is above the belt.
_HATCHBACK = (
    (0.0, 0.50, 0.80), (0.015, 0.68, 0.86), (0.06, 0.76, 0.88), (0.25, 0.93, 0.86), (0.42, 1.40, 0.72),
    (0.55, 1.47, 0.70), (0.80, 1.43, 0.70), (0.90, 1.30, 0.70), (0.97, 0.95, 0.80), (0.99, 0.85, 0.82),
    (1.0, 0.55, 0.82),
)  # fmt: skip
_SALOON = (
    (0.0, 0.48, 0.80), (0.012, 0.66, 0.86), (0.05, 0.74, 0.88), (0.27, 0.92, 0.86), (0.40, 1.36, 0.70),
    (0.52, 1.43, 0.68), (0.68, 1.40, 0.68), (0.83, 1.05, 0.78), (0.86, 1.02, 0.82), (0.985, 0.97, 0.84),
    (1.0, 0.55, 0.84),
)  # fmt: skip
_ESTATE = (
    (0.0, 0.48, 0.80), (0.012, 0.66, 0.86), (0.05, 0.74, 0.88), (0.26, 0.93, 0.86), (0.39, 1.38, 0.70),
    (0.52, 1.46, 0.69), (0.88, 1.42, 0.69), (0.925, 1.34, 0.70), (0.985, 0.98, 0.82), (0.992, 0.9, 0.82),
    (1.0, 0.55, 0.84),
)  # fmt: skip
_OFF_ROAD = (
    (0.0, 0.55, 0.84), (0.012, 0.85, 0.88), (0.05, 0.97, 0.90), (0.24, 1.08, 0.88), (0.36, 1.60, 0.76),
    (0.50, 1.72, 0.75), (0.90, 1.68, 0.75), (0.935, 1.58, 0.76), (0.985, 1.10, 0.86), (0.992, 1.0, 0.86),
    (1.0, 0.6, 0.86),
)  # fmt: skip
_VAN = (
    (0.0, 0.55, 0.84), (0.01, 0.85, 0.88), (0.04, 1.0, 0.90), (0.16, 1.22, 0.90), (0.29, 1.98, 0.82),
    (0.34, 2.12, 0.84), (0.66, 2.15, 0.84), (0.95, 2.13, 0.84), (0.98, 2.0, 0.84), (0.995, 1.05, 0.9),
    (1.0, 0.6, 0.9),
)  # fmt: skip
_CAB = (
    (0.0, 0.75, 0.90), (0.02, 1.35, 0.94), (0.05, 1.45, 0.94), (0.16, 2.45, 0.90), (0.30, 2.72, 0.90),
    (0.60, 2.78, 0.90), (0.90, 2.76, 0.90), (1.0, 2.70, 0.90),
)  # fmt: skip
_COACH = (
    (0.0, 0.95, 0.92), (0.008, 1.15, 0.95), (0.012, 1.2, 0.95), (0.03, 2.75, 0.92), (0.06, 2.98, 0.90),
    (0.3, 3.05, 0.90), (0.6, 3.05, 0.90), (0.95, 3.02, 0.90), (0.98, 2.8, 0.92), (0.995, 1.5, 0.95),
    (1.0, 0.9, 0.95),
)  # fmt: skip


def car(rng: np.random.Generator) -> list[Part]:
    """Return a hatchback, saloon, estate or off-roader."""
    outline = (_HATCHBACK, _SALOON, _ESTATE, _OFF_ROAD, _HATCHBACK)[rng.integers(5)]
    long, wide = rng.uniform(3.8, 4.8), rng.uniform(1.7, 1.86)
    high = rng.uniform(0.96, 1.05)
    belt = 0.92 * high if outline is not _OFF_ROAD else 1.08
    return _vehicle(rng, outline, Class.CAR, long, wide, high, belt, pillars=(0.56, 0.74), wheel_m=0.32)


def van(rng: np.random.Generator) -> list[Part]:
    """Return a delivery van; only its cabin has windows, as a rule."""
    long, wide, high = rng.uniform(4.6, 6.0), rng.uniform(1.9, 2.05), rng.uniform(0.9, 1.15)
    until = 0.5 if rng.random() < 0.7 else 0.9
    paint = None if rng.random() < 0.5 else Material("white lacquer", (0.68, 0.68, 0.67), 0.15, 0.6, 0.2, "plain")
    sizes, pillars = (long, wide, high, 1.2 * high), (0.45, 0.68)
    return _vehicle(rng, _VAN, Class.VAN, *sizes, pillars=pillars, wheel_m=0.35, windows_to=until, paint=paint)


def bus(rng: np.random.Generator) -> list[Part]:
    """Return a bus with a row of windows."""
    long = rng.uniform(10.0, 13.0)
    pillars = tuple(float(p) for p in np.arange(0.14, 0.95, 1.45 / long))
    paint = Material("livery", pick(rng, (*SIGNS, (0.7, 0.7, 0.68))), 0.2, 0.5, 0.2, "plain")
    return _vehicle(rng, _COACH, Class.BUS, long, 2.5, 1.0, 1.2, pillars=pillars, wheel_m=0.48, paint=paint)


def truck(rng: np.random.Generator) -> list[Part]:
    """Return a truck: a cab, and behind it a box, a tarpaulin, a tank or a flat bed."""
    cab = _vehicle(rng, _CAB, Class.TRUCK, 2.3, 2.4, 1.0, 1.55, pillars=(), wheel_m=0.0, windows_to=0.8)
    load, high = rng.uniform(5.0, 9.5), rng.uniform(3.2, 3.9)
    paint = Material("tarpaulin", pick(rng, (*SIGNS, *CLOTH, (0.7, 0.7, 0.68), (0.66, 0.66, 0.66))), 0.25, 0.5)
    back, front = -1.35 - load, -1.35
    chassis = boxes([[back, -0.45, 0.55], [back + 0.1, -1.15, 0.35]], [[1.0, 0.45, 0.95], [back + 0.2, 1.15, 0.6]])
    kind = rng.integers(3)
    if kind == 0:
        cargo = boxes([[back, -1.25, 1.05]], [[front, 1.25, high]])
    elif kind == 1:
        cargo = wheel(1.05, load, sides=20).moved(yaw_deg=90.0).moved((back + front) / 2, 0.0, 2.1)
    else:
        cargo = boxes([[back, -1.24, 1.0]], [[front, 1.24, 1.12]])
        cargo += sized(stacked(np.arange(back, front, 0.6), -1.27, 1.05), [0.08, 2.54, 0.85])
        cargo += boxes([[back + 0.3, -1.0, 1.1]], [[front - 0.5, 1.0, rng.uniform(1.7, 2.4)]])
    lights = boxes([[back - 0.02, s - 0.15, 0.8] for s in (-1, 1)], [[back + 0.1, s + 0.15, 1.0] for s in (-1, 1)])
    return [
        *cab,
        Part(cargo, paint, kind=Class.TRUCK),
        Part(chassis, DARK_STEEL, kind=Class.TRUCK, openness=0.5),
        *_wheels(Class.TRUCK, [-0.2 + 0.6, -1.9, back + 1.2, back + 2.5], 2.4, 0.48),
        Part(lights, TAIL_LIGHT, kind=Class.TRUCK),
    ]


def any_vehicle(rng: np.random.Generator, heavy: float = 0.12) -> list[Part]:
    """Return a vehicle of any kind; a share of `heavy` are trucks and buses."""
    draw = rng.random()
    if draw < heavy:
        return truck(rng) if rng.random() < 0.7 else bus(rng)
    return van(rng) if draw < heavy + 0.16 else car(rng)


def traffic(
    plan: Plan, heavy: float, y: float, start: float, stop: float, gap: tuple[float, float], *, yaw_deg: float = 0.0
) -> list[Thing]:
    """Return vehicles in a lane at y from x = `start` to `stop`; a share of `heavy` are trucks and buses."""
    rng = plan.rng
    return [placed(any_vehicle(rng, heavy), at, y, yaw_deg=yaw_deg) for at in plan.along(start, stop, gap)]


def _vehicle(
    rng: np.random.Generator,
    outline: tuple[tuple[float, float, float], ...],
    kind: Class,
    long: float,
    wide: float,
    high: float,
    belt: float,
    *,
    pillars: tuple[float, ...],
    wheel_m: float,
    windows_to: float = 0.92,
    paint: Material | None = None,
) -> list[Part]:
    """Return a body with glass and lights; `belt` is the height of the lower edge of the windows."""
    share, top, slim = (np.array(c) for c in zip(*outline, strict=True))
    cuts = np.array([p + d for p in pillars for d in (-0.012, 0.012)])
    stations = np.unique(np.concatenate([share, cuts]))
    top, slim = np.interp(stations, share, top) * high, np.interp(stations, share, slim)
    x = long * (0.5 - stations)
    sill = (0.2 if wheel_m < 0.4 else 0.32) + 0.12 * (np.abs(stations - 0.5) > 0.46)
    nose = 1 - 0.16 * np.clip((np.abs(stations - 0.5) - 0.40) / 0.1, 0, 1) ** 2
    half, edge = 0.5 * wide * nose, np.minimum(belt, top - 0.02)
    rim, roof = np.maximum(top - 0.07, edge + 0.005), half * slim
    side = np.where(top > edge + 0.1, roof, half * 0.95)
    # Rows of the section from the left sill over the top to the right sill.
    rows = [(half * 0.93, sill), (half, 0.5 * (sill + edge)), (half * 0.985, edge), (side, rim), (roof * 0.86, top)]
    ring = [stacked(x, y, z) for y, z in rows] + [stacked(x, -y, z) for y, z in rows[::-1]]
    body, is_glass = _skin(np.stack(ring, axis=1), stations, top, edge, cuts, windows_to)
    front, back = 0.5 * long, -0.5 * long
    z = 0.62 * high if wheel_m < 0.4 else 0.8
    at, mirror = 0.36 * wide, 0.15 * long
    plates = boxes(
        [[front - 0.1, -0.26, 0.36], [back - 0.015, -0.26, z - 0.06]],
        [[front + 0.012, 0.26, 0.47], [back + 0.1, 0.26, z + 0.05]],
    )
    trim = boxes(
        [[front - 0.2, -0.36 * wide, 0.26], [back - 0.008, -0.42 * wide, 0.3], [mirror, 0.5 * wide, belt],
         [mirror, -0.5 * wide - 0.16, belt]],
        [[front + 0.008, 0.36 * wide, 0.34], [back + 0.2, 0.42 * wide, 0.4],
         [mirror + 0.1, 0.5 * wide + 0.16, belt + 0.14], [mirror + 0.1, -0.5 * wide, belt + 0.14]],
    )  # fmt: skip
    solids = (
        (Mesh(body.vertices, body.faces[~is_glass]), paint or palette.lacquer(rng)),
        (Mesh(body.vertices, body.faces[is_glass]), GLASS),
        (sized([[front - 0.12, s * at - 0.16, z - 0.07] for s in (-1, 1)], [0.13, 0.32, 0.14]), HEADLIGHT),
        (sized([[back - 0.012, s * at - 0.14, z - 0.02] for s in (-1, 1)], [0.12, 0.28, 0.2]), TAIL_LIGHT),
        (plates, PLATE),
        (trim, TRIM),
    )
    wheels = _wheels(kind, [0.32 * long, -0.29 * long], wide, wheel_m) if wheel_m > 0 else []
    return [*built(kind, *solids), *wheels]


def _skin(
    section: Float, stations: Float, top: Float, belt: Float, cuts: Float, windows_to: float
) -> tuple[Mesh, Bool]:
    """Return the closed body through sections (S, R, 3) from nose to tail, and which faces are glass."""
    count, rows = section.shape[:2]
    s, r = (g.ravel() for g in np.meshgrid(np.arange(count - 1), np.arange(rows), indexing="ij"))
    after = (r + 1) % rows
    a, b, c, d = s * rows + r, s * rows + after, (s + 1) * rows + after, (s + 1) * rows + r
    glazed = top > belt + 0.25
    both, one = glazed[s] & glazed[s + 1], glazed[s] ^ glazed[s + 1]
    pillar = np.isin(stations[s], cuts[::2]) if len(cuts) else np.zeros(len(s), bool)
    within = stations[s] < windows_to
    window = both & within & ~pillar & np.isin(r, (2, rows - 4))
    # The windscreen and the rear window slope between a station below the belt and one at the roof.
    screen = one & np.isin(r, (3, 4, 5)) & (within | (windows_to > 0.85))
    faces = np.stack([np.column_stack([a, b, c]), np.column_stack([a, c, d])], axis=1).reshape(-1, 3)
    is_glass = np.repeat(window | screen, 2)
    fan = np.arange(1, rows - 1)
    zero, last = np.zeros_like(fan), (count - 1) * rows
    caps = [np.column_stack([zero, fan + 1, fan]), np.column_stack([zero + last, last + fan, last + fan + 1])]
    faces = np.concatenate([faces, *caps])
    return Mesh(section.reshape(-1, 3), faces), np.concatenate([is_glass, np.zeros(2 * len(fan), bool)])


def _wheels(kind: Class, places: list[float], wide: float, radius: float) -> list[Part]:
    """Return wheels at both ends of axles at x = `places`, in dark arches."""
    ends = [(x, side * (0.5 * wide - 0.09)) for x in places for side in (-1, 1)]
    arches = join([wheel(1.17 * radius, 0.185, sides=16).moved(x, y, 1.02 * radius) for x, y in ends])
    tyres = join([wheel(radius, 0.205, sides=18).moved(x, y, radius) for x, y in ends])
    rims = join([wheel(0.62 * radius, 0.215, sides=10).moved(x, y, radius) for x, y in ends])
    return [Part(arches, TRIM, kind=kind, openness=0.3), Part(tyres, TYRE, kind=kind), Part(rims, RIM, kind=kind)]
