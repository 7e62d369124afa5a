"""Wrong starting poses of a stated size, for experiments: the paper's draw, and those of other publications."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3

EXACT = "exact"
FIBONACCI = 200
"""Directions of the draw `fibonacci`; the seed says which."""
FARTHEST_M = 100.0
"""No calibration starts farther off; a start beyond would only overflow."""

_EXAMPLES = 'text such as "2deg 0.15m", or "uniform 3deg 0.15m" for each axis in [-3, 3] deg and [-0.15, 0.15] m'

Draw = Callable[[np.random.Generator, float, float, int], Float]
"""`(rng, angle_deg, distance_m, number) -> T_e (4, 4)`."""


@dataclass(frozen=True)
class Perturbation:
    """How wrong a start is: truth @ T_e, or T_e @ truth with `in_camera`.

    `draw` names how T_e is drawn (`DRAWS` explains each) from `angle_deg` and `distance_m`; `z_m` bounds its shift
    along z where that differs from the other axes.
    """

    angle_deg: float
    distance_m: float
    draw: str = EXACT
    in_camera: bool = False
    z_m: tuple[float, float] | None = None

    def __str__(self) -> str:
        words = [word for word in (self.draw,) if word != EXACT] + ["camera"] * self.in_camera
        words += [f"{self.angle_deg:g}deg", f"{self.distance_m:g}m"]
        return " ".join(words + ([] if self.z_m is None else [f"z={self.z_m[0]:g}..{self.z_m[1]:g}m"]))

    @property
    def exact(self) -> bool:
        """True where both parts are exactly as large as said."""
        return self.draw == EXACT and self.z_m is None

    def start(self, truth: Float, rng: np.random.Generator, number: int = 0) -> Float:
        """Return a start (4, 4); T_e acts in the LiDAR frame (paper Sec. IV-A.1) or in the camera's.

        `number` says which of its directions the draw `fibonacci` takes.
        """
        wrong = DRAWS[self.draw](rng, self.angle_deg, self.distance_m, number)
        if self.z_m is not None:
            wrong[2, 3] = rng.uniform(*self.z_m)
        return np.asarray(wrong @ truth if self.in_camera else truth @ wrong)


@lru_cache(maxsize=256)
def parse_perturbation(text: str, where: str = "--perturb") -> Perturbation:
    """Return the perturbation that a text such as "2deg 0.15m" (or "2deg,15cm") states; a missing part is zero.

    A word before says how it is drawn ("uniform 3deg 0.15m"), "camera" that it acts in the camera's frame, and
    "z=-1.5..1m" behind it bounds the shift along z. Raises InputError, naming `where`, for anything else, for negative
    sizes, for angles above 180 degrees and for lengths above 100 m.
    """
    amounts = {"deg": 0.0, "m": 0.0}
    parts = [p for p in re.split(r"[\s,;]+", text.strip()) if p]
    said = Perturbation(0.0, 0.0)
    if parts and parts[0] in DRAWS:
        said, parts = replace(said, draw=parts[0]), parts[1:]
    if parts[:1] == ["camera"]:
        said, parts = replace(said, in_camera=True), parts[1:]
    if parts and (bounds := re.fullmatch(r"z=(-?[0-9.]+)\.\.(-?[0-9.]+)m", parts[-1])):
        said, parts = replace(said, z_m=_bounds(bounds[1], bounds[2], text, where)), parts[:-1]
    for part in parts:
        match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)(deg|m|cm|mm)", part, re.ASCII)
        if match is None:
            raise InputError("cannot read the size", where=where, expected=_EXAMPLES, got=repr(text))
        value, unit = float(match[1]), match[2]
        amounts["deg" if unit == "deg" else "m"] = value * {"deg": 1, "m": 1, "cm": 0.01, "mm": 0.001}[unit]
    if not parts or amounts["deg"] > 180 or amounts["m"] > FARTHEST_M:
        raise InputError(
            "the size is out of bounds", where=where, expected=f"0..180 deg and 0..{FARTHEST_M:g} m", got=repr(text)
        )
    return replace(said, angle_deg=amounts["deg"], distance_m=amounts["m"])


def _bounds(low: str, high: str, text: str, where: str) -> tuple[float, float]:
    try:
        bounds = float(low), float(high)
    except ValueError:
        bounds = 1.0, 0.0
    if not -FARTHEST_M <= bounds[0] <= bounds[1] <= FARTHEST_M:
        raise InputError("the bounds of z are wrong", where=where, expected="z=LOW..HIGHm", got=repr(text))
    return bounds


def wrong_start(truth: Float, angle_deg: float, distance_m: float, rng: np.random.Generator) -> Float:
    """Return truth @ T_e, (4, 4): T_e turns by `angle_deg` about a random axis and shifts by `distance_m` anywhere.

    Axis and direction are uniform on the sphere; T_e acts in the LiDAR frame (paper Sec. IV-A.1).
    """
    return np.asarray(truth @ _exact(rng, angle_deg, distance_m))


def _exact(rng: np.random.Generator, angle_deg: float, distance_m: float, _: int = 0) -> Float:
    axis, direction = rng.normal(size=(2, 3))
    return _turned(_unit(axis) * angle_deg, _unit(direction) * distance_m)


def _uniform(rng: np.random.Generator, angle_deg: float, distance_m: float, _: int = 0) -> Float:
    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return _turned(turn * angle_deg, shift * distance_m)


def _euler(rng: np.random.Generator, angle_deg: float, distance_m: float, _: int = 0) -> Float:
    from scipy.spatial.transform import Rotation

    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return se3.make(Rotation.from_euler("xyz", turn * angle_deg, degrees=True).as_matrix(), shift * distance_m)


def _norm(rng: np.random.Generator, angle_deg: float, distance_m: float, _: int = 0) -> Float:
    axis, direction = rng.normal(size=(2, 3))
    size = rng.uniform(0, 1, size=2)
    return _turned(_unit(axis) * angle_deg * size[0], _unit(direction) * distance_m * size[1])


def _cube(rng: np.random.Generator, angle_deg: float, distance_m: float, _: int = 0) -> Float:
    axis, direction = rng.uniform(-1, 1, size=(2, 3))
    size = rng.uniform(0, 1, size=2)
    return _turned(_unit(axis) * angle_deg * size[0], _unit(direction) * distance_m * size[1])


def _fibonacci(rng: np.random.Generator, angle_deg: float, distance_m: float, number: int = 0) -> Float:
    direction = fibonacci_directions(FIBONACCI)[number % FIBONACCI]
    return _turned(direction * angle_deg, _unit(rng.normal(size=3)) * distance_m)


DRAWS: Mapping[str, Draw] = {
    EXACT: _exact,
    "uniform": _uniform,
    "euler": _euler,
    "norm": _norm,
    "cube": _cube,
    "fibonacci": _fibonacci,
}
"""How wrong starts are drawn from an angle and a length.

exact: a rotation of exactly the angle about any axis and a shift of exactly the length anywhere (P2O-Calib).
uniform: each component of the rotation vector, and of the shift, within plus and minus (P2O-Calib's figure by axis).
euler: each Euler angle, turned about fixed x, then y, then z, and each component of the shift alike (LCCNet, CMRNext).
norm: any axis and direction, with angle and length uniform from 0 to the size (BEVCalib).
cube: the same with axis and direction drawn in a cube, so that diagonals come more often (ProjFusion).
fibonacci: exactly the angle about one of 200 axes spread evenly over the sphere, by seed (Borer et al.); a shift of
exactly the length anywhere.
"""


def fibonacci_directions(count: int) -> Float:
    """Return unit vectors (count, 3) spread evenly over the sphere along a golden spiral."""
    number = np.arange(count) + 0.5
    z = 1 - 2 * number / count
    around = np.pi * (1 + np.sqrt(5)) * number
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(around), flat * np.sin(around), z])


def _unit(vector: Float) -> Float:
    return np.asarray(vector / np.linalg.norm(vector))


def _turned(rotation_vector_deg: Float, shift_m: Float) -> Float:
    rotation = se3.exp(np.concatenate([np.radians(rotation_vector_deg), np.zeros(3)]))
    return se3.make(rotation[:3, :3], shift_m)
