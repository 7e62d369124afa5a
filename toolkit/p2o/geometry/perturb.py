"""Random initial guesses with errors of a given size, drawn as in the paper and in other publications."""

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
"""Number of directions of the draw `fibonacci`, selected by the seed."""
FARTHEST_M = 100.0
"""Maximum translation error of an initial guess."""

_EXAMPLES = 'text such as "2deg 0.15m", or "uniform 3deg 0.15m" for each axis in [-3, 3] deg and [-0.15, 0.15] m'

Draw = Callable[[np.random.Generator, float, float, int], Float]
"""`(rng, angle_deg, distance_m, number) -> T_e (4, 4)`."""


@dataclass(frozen=True)
class Perturbation:
    """The error T_e of an initial guess: truth @ T_e, or T_e @ truth with `in_camera`.

    `draw` names the distribution of T_e (`DRAWS`) with the parameters `angle_deg` and `distance_m`; `z_m` are separate
    bounds of the translation along z.
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
        """True if rotation and translation have exactly the given sizes."""
        return self.draw == EXACT and self.z_m is None

    def start(self, truth: Float, rng: np.random.Generator, number: int = 0) -> Float:
        """Draw an initial guess (4, 4); T_e is in the LiDAR frame (paper Sec. IV-A.1) or in the camera frame.

        `number` selects the direction of the draw `fibonacci`.
        """
        wrong = DRAWS[self.draw](rng, self.angle_deg, self.distance_m, number)
        if self.z_m is not None:
            wrong[2, 3] = rng.uniform(*self.z_m)
        return np.asarray(wrong @ truth if self.in_camera else truth @ wrong)


@lru_cache(maxsize=256)
def parse_perturbation(text: str, where: str = "--perturb", expected: str = _EXAMPLES) -> Perturbation:
    """Parse a perturbation such as "2deg 0.15m" (or "2deg,15cm"); a missing part is zero.

    A leading word selects the draw ("uniform 3deg 0.15m"), "camera" the camera frame, and a trailing "z=-1.5..1m" sets
    the bounds of the translation along z. Raises InputError, with `where` and `expected`, for any other text, negative
    sizes, angles above 180 degrees and lengths above 100 m.
    """
    amounts = {"deg": 0.0, "m": 0.0}
    parts = [p for p in re.split(r"[\s,;]+", text.strip()) if p]
    perturbation = Perturbation(0.0, 0.0)
    if parts and parts[0] in DRAWS:
        perturbation, parts = replace(perturbation, draw=parts[0]), parts[1:]
    if parts[:1] == ["camera"]:
        perturbation, parts = replace(perturbation, in_camera=True), parts[1:]
    if parts and (bounds := re.fullmatch(r"z=(-?[0-9.]+)\.\.(-?[0-9.]+)m", parts[-1])):
        perturbation, parts = replace(perturbation, z_m=_bounds(bounds[1], bounds[2], text, where)), parts[:-1]
    for part in parts:
        match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)(deg|m|cm|mm)", part, re.ASCII)
        if match is None:
            raise InputError("cannot read the size", where=where, expected=expected, got=repr(text))
        value, unit = float(match[1]), match[2]
        amounts["deg" if unit == "deg" else "m"] = value * {"deg": 1, "m": 1, "cm": 0.01, "mm": 0.001}[unit]
    if not parts or amounts["deg"] > 180 or amounts["m"] > FARTHEST_M:
        limits = f"0..180 deg and 0..{FARTHEST_M:g} m"
        raise InputError("the size is out of bounds", where=where, expected=limits, got=repr(text))
    return replace(perturbation, angle_deg=amounts["deg"], distance_m=amounts["m"])


def parse_accuracy(text: str, where: str, expected: str = 'an angle and a length, "0.3deg 0.1m"') -> Perturbation:
    """Parse an angle and a length, both more than zero; raises InputError, with `where`, for any other text."""
    bound = parse_perturbation(text, where, expected)
    if not bound.exact or not (bound.angle_deg > 0 and bound.distance_m > 0):
        raise InputError("the accuracy needs two parts", where=where, expected=expected, got=repr(text))
    return bound


def _bounds(low: str, high: str, text: str, where: str) -> tuple[float, float]:
    try:
        bounds = float(low), float(high)
    except ValueError:
        bounds = 1.0, 0.0
    if not -FARTHEST_M <= bounds[0] <= bounds[1] <= FARTHEST_M:
        raise InputError("the bounds of z are not valid", where=where, expected="z=LOW..HIGHm", got=repr(text))
    return bounds


def wrong_start(truth: Float, angle_deg: float, distance_m: float, rng: np.random.Generator) -> Float:
    """Draw truth @ T_e (4, 4): T_e rotates by `angle_deg` and translates by `distance_m` in the LiDAR frame.

    Axis and direction are uniform on the sphere (paper Sec. IV-A.1).
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
"""Distributions of T_e, by an angle and a length.

exact: rotation of exactly the angle about a uniform axis, translation of exactly the length in a uniform direction
(P2O-Calib).
uniform: each component of the rotation vector and of the translation is uniform within plus and minus the size
(P2O-Calib's figure by axis).
euler: the same for Euler angles about the fixed axes x, then y, then z (LCCNet, CMRNext).
norm: uniform axis and direction, angle and length uniform from 0 to the size (BEVCalib).
cube: as norm with axis and direction drawn in a cube, which prefers diagonals (ProjFusion).
fibonacci: exactly the angle about one of 200 axes evenly distributed on the sphere, selected by the seed (Borer et
al.), translation as for exact.
"""


def fibonacci_directions(count: int) -> Float:
    """Return unit vectors (count, 3) evenly distributed on the sphere along a golden spiral."""
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
