"""Interior of a building: floor, walls with doorways and windows, ceiling, and the free area of the floor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from p2o import Float

from p2o_sim.things.buildings import town_house
from p2o_sim.things.ground import stations, strips
from p2o_sim.things.plants import bush, tree
from p2o_sim.world.lighting import Inside, Lamp, Lighting, triple
from p2o_sim.world.mesh import boxes
from p2o_sim.world.palette import ASPHALT, GRASS, PAVING
from p2o_sim.world.place import BEHIND_M, Plan, Thing, backdrop, on_side, placed
from p2o_sim.world.scene import Class, Material, Part

WALL_M = 0.22
"""Thickness of walls."""
RIG_ROOM_M = 1.15
"""Free space of the rig to either side of its path, and behind its start."""
_DAY = np.array([0.95, 1.0, 1.1])


@dataclass(frozen=True)
class Opening:
    """A hole in a wall: from `start` to `stop` along it, from `low` to `high` above the floor, metres."""

    start: float
    stop: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Hall:
    """Interior of a building: x from `back` to `end`, y from `right` to `left`, `height` metres high."""

    back: float
    end: float
    right: float
    left: float
    height: float

    @property
    def walls(self) -> dict[str, tuple[float, float, float, float]]:
        """Start (x, y), yaw in degrees and length of each wall, which runs to the right seen from inside.

        A thing at (s, -d) in the frame of a wall is d metres in front of it: walls are seen from their -y.
        """
        deep, wide = self.end - self.back, self.left - self.right
        return {
            "left": (self.back, self.left, 0.0, deep),
            "end": (self.end, self.left, -90.0, wide),
            "right": (self.end, self.right, 180.0, deep),
            "back": (self.back, self.right, 90.0, wide),
        }

    def on_wall(self, name: str, thing: Thing, along: float, away: float = 0.0, z: float = 0.0) -> Thing:
        """Return a thing with its back at y = 0, seen from -y, `along` a wall and `away` from it, metres."""
        x, y, turn, _ = self.walls[name]
        return placed([part.moved(along, -away, z) for part in thing], x, y, yaw_deg=turn)

    def spot(self, name: str, along: float, away: float) -> tuple[float, float]:
        """Return the position (x, y) on the floor `along` a wall and `away` from it, metres."""
        x, y, turn, _ = self.walls[name]
        cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        return float(x + cos * along + sin * away), float(y + sin * along - cos * away)

    def lighting(self, ambient: Float, lean: Float, lamps: Sequence[Lamp]) -> Lighting:
        """Return the light of the interior, with ambient light (3,) and its `lean` (3,)."""
        low, high = (self.back, self.right, 0.0), (self.end, self.left, self.height)
        return Lighting(inside=Inside(low, high, triple(ambient), triple(lean)), lamps=tuple(lamps))


@dataclass(eq=False)
class FloorPlan:
    """Occupied rectangles of a floor in x and y, the first around the rig's path."""

    hall: Hall
    travel_m: float
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.taken.append((-RIG_ROOM_M, self.travel_m + RIG_ROOM_M + 0.4, -RIG_ROOM_M, RIG_ROOM_M))

    def take(self, x: float, y: float, half_x: float, half_y: float, *, gap: float = 0.08) -> bool:
        """Occupy the rectangle about (x, y) if it is inside and free, and return whether it was."""
        low_x, high_x, low_y, high_y = x - half_x, x + half_x, y - half_y, y + half_y
        hall = self.hall
        if low_x < hall.back or high_x > hall.end or low_y < hall.right or high_y > hall.left:
            return False
        free = all(
            low_x >= b + gap or a >= high_x + gap or low_y >= d + gap or c >= high_y + gap for a, b, c, d in self.taken
        )
        if free:
            self.taken.append((low_x, high_x, low_y, high_y))
        return free

    def take_turned(self, x: float, y: float, wide: float, deep: float, yaw_deg: float, *, gap: float = 0.08) -> bool:
        """Occupy `wide` x `deep` metres about (x, y), turned to the nearest quarter, and return whether it was free."""
        half = (wide / 2, deep / 2) if round(yaw_deg / 90.0) % 2 == 0 else (deep / 2, wide / 2)
        return self.take(x, y, *half, gap=gap)

    def take_before(self, name: str, along: float, wide: float, deep: float) -> bool:
        """Occupy floor in front of a wall, `wide` metres about `along` and `deep`, and return whether it was free."""
        half = (deep / 2, wide / 2) if name in ("end", "back") else (wide / 2, deep / 2)
        return self.take(*self.hall.spot(name, along, deep / 2 + 0.02), *half, gap=0.0)

    def spots(self, rng: np.random.Generator, count: int) -> Iterator[tuple[float, float]]:
        """Yield random positions on the floor, more of them ahead of the rig's start than behind it."""
        hall = self.hall
        for _ in range(count):
            back = hall.back if rng.random() < 0.35 else min(-0.5, hall.end)
            yield float(rng.uniform(back, hall.end)), float(rng.uniform(hall.right, hall.left))


def wall(length: float, height: float, openings: Sequence[Opening], material: Material) -> Part:
    """Return a wall along x from 0 to `length`, its inner side y = 0 seen from -y, as boxes around its openings.

    It is WALL_M longer at both ends, so that corners are closed.
    """
    low, high, at = [], [], -WALL_M
    for hole in sorted(openings, key=lambda hole: hole.start):
        low.append([at, 0.0, -0.3])
        high.append([hole.start, WALL_M, height])
        if hole.low > 0:
            low.append([hole.start, 0.0, -0.3])
            high.append([hole.stop, WALL_M, hole.low])
        if hole.high < height:
            low.append([hole.start, 0.0, hole.high])
            high.append([hole.stop, WALL_M, height])
        at = hole.stop
    return Part(boxes([*low, [at, 0.0, -0.3]], [*high, [length + WALL_M, WALL_M, height]]), material, kind=Class.WALL)


def plinth(length: float, openings: Sequence[Opening], material: Material, *, deep: float, high: float) -> Part:
    """Return a plinth or skirting board `deep` metres in front of a wall, `high` metres, with gaps at doorways."""
    stops = [0.0, *(edge for hole in openings if hole.low == 0 for edge in (hole.start, hole.stop)), length]
    mesh = boxes([[a, -deep, 0.0] for a in stops[::2]], [[b, 0.0, high] for b in stops[1::2]])
    return Part(mesh, material, kind=Class.WALL)


def slab(hall: Hall, low: float, high: float, material: Material, kind: Class) -> Part:
    """Return a floor or ceiling between two heights, out to the outer sides of the walls."""
    corner = [[hall.back - WALL_M, hall.right - WALL_M, low]]
    other = [[hall.end + WALL_M, hall.left + WALL_M, high]]
    return Part(boxes(corner, other), material, kind=kind)


def outside(plan: Plan, hall: Hall) -> list[Thing]:
    """Return the surroundings seen through windows and doorways: ground, trees, hedges, houses, distant woods."""
    rng = plan.rng
    x = stations(BEHIND_M - 60.0, max(plan.far_m, hall.end + 80.0), 20.0)
    ground = (GRASS, ASPHALT, PAVING)[rng.integers(3)]
    things = [strips([(112.0, -0.03), (-112.0, -0.03)], [(ground, Class.TERRAIN)], x), *backdrop(plan)]
    for side, edge in ((1, hall.left), (-1, hall.right)):
        for at in plan.along(hall.back, hall.end, (9.0, 22.0)):
            away = edge + side * rng.uniform(9.0, 35.0)
            draw = rng.random()
            if draw < 0.4:
                things.append(placed(tree(rng, 45.0), at, away))
            elif draw < 0.6:
                things.append(placed(bush(rng, 30.0), at, edge + side * rng.uniform(4.0, 12.0)))
            else:
                length = rng.uniform(8.0, 14.0)
                things.append(on_side(town_house(rng, length), side, at, away, length))
    for at in plan.along(hall.right, hall.left, (5.0, 12.0)):
        if rng.random() < 0.7:
            things.append(placed(town_house(rng, 10.0), hall.end + rng.uniform(12.0, 35.0), at + 5.0, yaw_deg=-90.0))
        else:
            things.append(placed(tree(rng, 40.0), hall.end + rng.uniform(8.0, 25.0), at))
    return things


def daylight(hall: Hall, name: str, hole: Opening, strength: float) -> Lamp:
    """Return the light of the sky through an opening of a wall, as a lamp in its centre."""
    x, y = hall.spot(name, (hole.start + hole.stop) / 2, 0.0)
    turn = np.radians(hall.walls[name][2])
    inwards = float(np.sin(turn)), float(-np.cos(turn))
    return Lamp(
        (x + 0.05 * inwards[0], y + 0.05 * inwards[1], (hole.low + hole.high) / 2),
        triple(_DAY * strength * (hole.stop - hole.start) * (hole.high - hole.low)),
        size_m=max(hole.stop - hole.start, hole.high - hole.low),
        aim=(*inwards, -0.35),
        clear_m=0.12,
        daylight=True,
    )
