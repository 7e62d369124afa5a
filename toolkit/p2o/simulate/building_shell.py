"""The inside of a building: floor, walls with doorways and windows, ceiling, and where on the floor there is room."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from p2o.simulate.buildings import town_house
from p2o.simulate.classes import Class
from p2o.simulate.ground import stations, strips
from p2o.simulate.lighting import Lamp
from p2o.simulate.mesh import boxes
from p2o.simulate.palette import ASPHALT, GRASS, PAVING
from p2o.simulate.place import BEHIND_M, Plan, Thing, backdrop, placed
from p2o.simulate.plants import bush, tree
from p2o.simulate.scene import Material, Part

WALL_M = 0.22
"""How thick walls are."""
RIG_ROOM_M = 1.15
"""How much room the rig has to either side of its way, and behind its start."""
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
    """The box of air inside of a building: x from `back` to `end`, y from `right` to `left`, `height` metres high."""

    back: float
    end: float
    right: float
    left: float
    height: float

    @property
    def walls(self) -> dict[str, tuple[float, float, float, float]]:
        """Where each wall begins, x and y, its turn in degrees, and its length; from inside it runs to the right.

        A thing at (s, -d) of a wall's own frame stands d metres before it: walls are seen from their own -y.
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
        """Return the place (x, y) on the floor `along` a wall and `away` from it, metres."""
        x, y, turn, _ = self.walls[name]
        cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        return float(x + cos * along + sin * away), float(y + sin * along - cos * away)

    def inwards(self, name: str) -> tuple[float, float, float]:
        """Return the direction (3,) that a wall looks to."""
        turn = np.radians(self.walls[name][2])
        return float(np.sin(turn)), float(-np.cos(turn)), 0.0


@dataclass(eq=False)
class FloorPlan:
    """Which parts of a floor are taken: rectangles of x and y, those of the rig's way first."""

    hall: Hall
    travel_m: float
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.taken.append((-RIG_ROOM_M, self.travel_m + RIG_ROOM_M + 0.4, -RIG_ROOM_M, RIG_ROOM_M))

    def take(self, x: float, y: float, half_x: float, half_y: float, *, gap: float = 0.08) -> bool:
        """Take the rectangle about (x, y) if it is inside and free, and return whether it was."""
        low_x, high_x, low_y, high_y = x - half_x, x + half_x, y - half_y, y + half_y
        hall = self.hall
        if low_x < hall.back or high_x > hall.end or low_y < hall.right or high_y > hall.left:
            return False
        for a, b, c, d in self.taken:
            if low_x < b + gap and a < high_x + gap and low_y < d + gap and c < high_y + gap:
                return False
        self.taken.append((low_x, high_x, low_y, high_y))
        return True

    def take_before(self, name: str, along: float, wide: float, deep: float) -> bool:
        """Take the floor before a wall, `wide` metres about `along` and `deep`, and return whether it was free."""
        x, y = self.hall.spot(name, along, deep / 2 + 0.02)
        sideways = name in ("end", "back")
        half = (deep / 2, wide / 2) if sideways else (wide / 2, deep / 2)
        return self.take(x, y, *half, gap=0.0)

    def spots(self, rng: np.random.Generator, count: int) -> Iterator[tuple[float, float]]:
        """Yield places on the floor, more of them ahead of the rig's start than behind it."""
        hall = self.hall
        for _ in range(count):
            back = hall.back if rng.random() < 0.35 else min(-0.5, hall.end)
            yield float(rng.uniform(back, hall.end)), float(rng.uniform(hall.right, hall.left))


def wall(length: float, height: float, openings: Sequence[Opening], *, overlap: float = WALL_M) -> list[Part]:
    """Return a wall along x from 0 to `length`, its inner side y = 0 seen from -y, as boxes around its openings.

    It is `overlap` longer at both ends, so that corners are closed. The material is the caller's: see `painted`.
    """
    low, high, at = [], [], -overlap
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
    low.append([at, 0.0, -0.3])
    high.append([length + overlap, WALL_M, height])
    return [Part(boxes(low, high), _BARE, kind=Class.WALL)]


_BARE = Material("bare wall", (0.5, 0.5, 0.5))


def painted(thing: Thing, material: Material) -> Thing:
    """Return a thing of another material."""
    return [Part(part.mesh, material, part.thing, part.kind, part.openness) for part in thing]


def slab(hall: Hall, low: float, high: float, material: Material, kind: Class) -> Part:
    """Return a floor or ceiling between two heights, out to the outer sides of the walls."""
    corner = [[hall.back - WALL_M, hall.right - WALL_M, low]]
    other = [[hall.end + WALL_M, hall.left + WALL_M, high]]
    return Part(boxes(corner, other), material, kind=kind)


def outside(plan: Plan, hall: Hall, *, below_m: float = 0.03) -> list[Thing]:
    """Return what is seen through windows and doorways: ground, trees, hedges and houses, far woods."""
    rng = plan.rng
    x = stations(BEHIND_M - 60.0, max(plan.far_m, hall.end + 80.0), 20.0)
    ground = (GRASS, ASPHALT, PAVING)[rng.integers(3)]
    things: list[Thing] = [strips([(112.0, -below_m), (-112.0, -below_m)], [(ground, Class.TERRAIN)], x)]
    things += backdrop(plan)
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
                house = town_house(rng, length)
                things.append(placed(house, at + (0 if side > 0 else length), away, yaw_deg=0.0 if side > 0 else 180.0))
    for at in plan.along(hall.right, hall.left, (5.0, 12.0)):
        if rng.random() < 0.7:
            things.append(placed(town_house(rng, 10.0), hall.end + rng.uniform(12.0, 35.0), at + 5.0, yaw_deg=-90.0))
        else:
            things.append(placed(tree(rng, 40.0), hall.end + rng.uniform(8.0, 25.0), at))
    return things


def daylight(hall: Hall, name: str, hole: Opening, strength: float) -> Lamp:
    """Return the light of the sky that falls in through an opening of a wall, as a lamp in the middle of it."""
    x, y = hall.spot(name, (hole.start + hole.stop) / 2, 0.0)
    towards = hall.inwards(name)
    colour = _DAY * strength * (hole.stop - hole.start) * (hole.high - hole.low)
    return Lamp(
        (x + 0.05 * towards[0], y + 0.05 * towards[1], (hole.low + hole.high) / 2),
        (float(colour[0]), float(colour[1]), float(colour[2])),
        size_m=max(hole.stop - hole.start, hole.high - hole.low),
        aim=(towards[0], towards[1], -0.35),
        clear_m=0.12,
        daylight=True,
    )
