"""What every kind of place is drawn with: a plan, a layout of things, and a backdrop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from p2o.simulate.classes import Class
from p2o.simulate.lighting import DAY, Lighting
from p2o.simulate.mesh import swept
from p2o.simulate.palette import GRASS
from p2o.simulate.scene import Material, Part

Thing = list[Part]
BEHIND_M = -40.0
"""Where scenes begin; the rig starts at x = 0."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a place is drawn with: randomness, and how far the rig will drive, `travel_m`, along y = 0.

    With `around` its cameras may look anywhere, not only ahead.
    """

    rng: np.random.Generator
    travel_m: float = 0.0
    around: bool = False

    @property
    def far_m(self) -> float:
        """Where the ground ends."""
        return self.travel_m + 230.0

    def sight_m(self, x: float, y: float) -> float:
        """Return from how near the camera may see a thing at (x, y): it looks ahead, over 41 degrees to each side.

        What it never sees is for the LiDAR alone, which does not mind coarse leaves.
        """
        if self.around:
            return max(4.0, float(np.hypot(max(-x, x - self.travel_m, 0.0), y)))
        return 40.0 if x < 0.8 * abs(y) else max(1.3 * abs(y), x - self.travel_m, 4.0)

    def along(self, start: float, stop: float, gap: tuple[float, float]) -> Iterator[float]:
        """Yield rising places between start and stop, metres apart within `gap`."""
        place = start + self.rng.uniform(0.0, gap[0])
        while place < stop:
            yield place
            place += self.rng.uniform(*gap)


@dataclass(frozen=True, eq=False)
class Layout:
    """A place on a straight road: things that stand, and things that drive towards us or with us, and its lighting."""

    things: list[Thing]
    oncoming: list[Thing]
    ahead: list[Thing]
    curvature: tuple[float, float] = (-0.004, 0.004)
    lighting: Lighting = DAY


def placed(thing: Thing, x: float, y: float, z: float = 0.0, *, yaw_deg: float = 0.0) -> Thing:
    """Return the parts of a thing, turned about z and shifted."""
    return [part.moved(x, y, z, yaw_deg=yaw_deg) for part in thing]


def treeline(rng: np.random.Generator, length: float, height: float) -> Thing:
    """Return the silhouette of a far wood along x from 0 to `length`, ragged on top."""
    x = np.arange(0.0, length, 0.7)
    steps = rng.normal(size=len(x)).cumsum()
    broad = np.interp(x, x[::12], rng.uniform(0.6, 1.0, len(x[::12])))
    top = height * (broad + 0.02 * (steps - np.interp(x, x[::6], steps[::6])) + 0.03 * rng.normal(size=len(x)))
    line = np.stack(
        [np.column_stack([np.full(len(x), 0.0), np.full(len(x), -3.0)]), np.column_stack([np.full(len(x), 1.0), top])],
        1,
    )
    green = rng.uniform(0.7, 1.3)
    leaves = Material("far wood", (0.04 * green, 0.06 * green, 0.02), 0.9, 0.4, pattern="grass", thin=True)
    return [Part(swept(line, x), leaves, kind=Class.FOLIAGE, openness=0.7)]


def backdrop(plan: Plan, *, high: tuple[float, float] = (5.0, 14.0), sides_m: float = 100.0) -> list[Thing]:
    """Return far woods around a place, so that land does not end in the sky."""
    rng, far = plan.rng, plan.far_m
    out = [placed(treeline(rng, far + 60.0, rng.uniform(*high)), BEHIND_M, side * sides_m) for side in (-1, 1)]
    out.append(placed(treeline(rng, 2 * sides_m + 20, rng.uniform(*high)), far - 8.0, -sides_m - 10, yaw_deg=90.0))
    return out


def land_behind(plan: Plan, *, far_m: float = 130.0) -> list[Thing]:
    """Return land and a far wood behind where places begin, for cameras that look back."""
    x = np.array([BEHIND_M - far_m - 40.0, BEHIND_M - 0.5 * far_m, BEHIND_M + 0.5])
    sheet = swept(np.array([[110.0, -0.005], [0.0, -0.005], [-110.0, -0.005]]), x)
    wood = treeline(plan.rng, 240.0, plan.rng.uniform(6.0, 16.0))
    return [[Part(sheet, GRASS, kind=Class.TERRAIN)], placed(wood, BEHIND_M - far_m, -120.0, yaw_deg=90.0)]
