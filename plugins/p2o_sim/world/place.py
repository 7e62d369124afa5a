"""Parts that all kinds of scenes share: plan, layout and backdrop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from p2o_sim.world.lighting import DAY, Lighting
from p2o_sim.world.mesh import stacked, swept
from p2o_sim.world.palette import GRASS
from p2o_sim.world.scene import Class, Material, Part

Thing = list[Part]
BEHIND_M = -40.0
"""Start of scenes along x; the rig starts at x = 0."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Input for drawing a scene: random generator, and length `travel_m` of the drive along y = 0.

    With `around`, cameras may look in any direction, not only ahead.
    """

    rng: np.random.Generator
    travel_m: float = 0.0
    around: bool = False

    @property
    def far_m(self) -> float:
        """Largest x of the ground."""
        return self.travel_m + 230.0

    def sight_m(self, x: float, y: float) -> float:
        """Return the smallest distance from which the camera may see a thing at (x, y), with 41 degrees to each side.

        Things that the camera never sees only need the detail of the LiDAR, for which coarse leaves suffice.
        """
        if self.around:
            return max(4.0, float(np.hypot(max(-x, x - self.travel_m, 0.0), y)))
        return 40.0 if x < 0.8 * abs(y) else max(1.3 * abs(y), x - self.travel_m, 4.0)

    def along(self, start: float, stop: float, gap: tuple[float, float]) -> Iterator[float]:
        """Yield increasing positions between start and stop, with random distances within `gap` in metres."""
        place = start + self.rng.uniform(0.0, gap[0])
        while place < stop:
            yield place
            place += self.rng.uniform(*gap)


@dataclass(frozen=True, eq=False)
class Layout:
    """A scene on a straight road: static things, oncoming and preceding traffic, and lighting."""

    things: list[Thing]
    oncoming: list[Thing]
    ahead: list[Thing]
    curvature: tuple[float, float] = (-0.004, 0.004)
    lighting: Lighting = DAY


def placed(thing: Thing, x: float, y: float, z: float = 0.0, *, yaw_deg: float = 0.0) -> Thing:
    """Return the parts of a thing, rotated about z and shifted."""
    return [part.moved(x, y, z, yaw_deg=yaw_deg) for part in thing]


def on_side(thing: Thing, side: int, x: float, y: float, length: float, z: float = 0.0) -> Thing:
    """Return a thing of a `length` along x built for the left side (+1); on the right, it is turned by half a turn."""
    return placed(thing, x, y, z) if side > 0 else placed(thing, x + length, y, z, yaw_deg=180.0)


def treeline(rng: np.random.Generator, length: float, height: float) -> Thing:
    """Return the silhouette of a distant wood along x from 0 to `length` with an irregular top."""
    x = np.arange(0.0, length, 0.7)
    steps = rng.normal(size=len(x)).cumsum()
    broad = np.interp(x, x[::12], rng.uniform(0.6, 1.0, len(x[::12])))
    top = height * (broad + 0.02 * (steps - np.interp(x, x[::6], steps[::6])) + 0.03 * rng.normal(size=len(x)))
    line = np.stack([stacked(0.0 * x, -3.0), stacked(1.0, top)], 1)
    green = rng.uniform(0.7, 1.3)
    leaves = Material("far wood", (0.04 * green, 0.06 * green, 0.02), 0.9, 0.4, pattern="grass", thin=True)
    return [Part(swept(line, x), leaves, kind=Class.FOLIAGE, openness=0.7)]


def backdrop(plan: Plan, *, high: tuple[float, float] = (5.0, 14.0), sides_m: float = 100.0) -> list[Thing]:
    """Return distant woods around a scene, which hide the end of the ground."""
    rng, far = plan.rng, plan.far_m
    out = [placed(treeline(rng, far + 60.0, rng.uniform(*high)), BEHIND_M, side * sides_m) for side in (-1, 1)]
    out.append(placed(treeline(rng, 2 * sides_m + 20, rng.uniform(*high)), far - 8.0, -sides_m - 10, yaw_deg=90.0))
    return out


def land_behind(plan: Plan, *, far_m: float = 130.0) -> list[Thing]:
    """Return ground and a distant wood behind the start of a scene, for cameras that look back."""
    x = np.array([BEHIND_M - far_m - 40.0, BEHIND_M - 0.5 * far_m, BEHIND_M + 0.5])
    sheet = swept(np.array([[110.0, -0.005], [0.0, -0.005], [-110.0, -0.005]]), x)
    wood = treeline(plan.rng, 240.0, plan.rng.uniform(6.0, 16.0))
    return [[Part(sheet, GRASS, kind=Class.TERRAIN)], placed(wood, BEHIND_M - far_m, -120.0, yaw_deg=90.0)]
