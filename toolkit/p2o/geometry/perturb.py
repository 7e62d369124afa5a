"""Wrong starting poses of a stated size, for experiments (paper Sec. IV-A: T_gt T_e)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3

_UNIFORM = "uniform"
_EXAMPLES = 'text such as "2deg 0.15m", or "uniform 3deg 0.15m" for each axis in [-3, 3] deg and [-0.15, 0.15] m'


@dataclass(frozen=True)
class Perturbation:
    """How wrong a start is.

    Ordinary: a rotation of exactly `angle_deg` about any axis and a shift of exactly `distance_m` anywhere. With
    `uniform` (the paper's box plot): each component of the rotation vector is uniform in [-angle_deg, angle_deg], each
    of the shift in [-distance_m, distance_m].
    """

    angle_deg: float
    distance_m: float
    uniform: bool = False

    def __str__(self) -> str:
        return f"{_UNIFORM} " * self.uniform + f"{self.angle_deg:g}deg {self.distance_m:g}m"

    def start(self, truth: Float, rng: np.random.Generator) -> Float:
        """Return a start, truth @ T_e, (4, 4); T_e acts in the LiDAR frame (paper Sec. IV-A.1)."""
        wrong = wrong_start_per_axis if self.uniform else wrong_start
        return wrong(truth, self.angle_deg, self.distance_m, rng)


def parse_perturbation(text: str, where: str = "--perturb") -> Perturbation:
    """Return the perturbation that a text such as "2deg 0.15m" (or "2deg,15cm") states; a missing part is zero.

    "uniform 3deg 0.15m" states bounds for each axis instead of the size of the whole.

    Raises InputError, naming `where`, for anything else, for negative sizes and for angles above 180 degrees.
    """
    amounts = {"deg": 0.0, "m": 0.0}
    parts = [p for p in re.split(r"[\s,;]+", text.strip()) if p]
    uniform = parts[:1] == [_UNIFORM]
    parts = parts[uniform:]
    for part in parts:
        match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)(deg|m|cm|mm)", part)
        if match is None:
            raise InputError("cannot read the size", where=where, expected=_EXAMPLES, got=repr(text))
        value, unit = float(match[1]), match[2]
        amounts["deg" if unit == "deg" else "m"] = value * {"deg": 1, "m": 1, "cm": 0.01, "mm": 0.001}[unit]
    if not parts or amounts["deg"] > 180:
        raise InputError("the size is out of bounds", where=where, expected="0..180 deg", got=repr(text))
    return Perturbation(amounts["deg"], amounts["m"], uniform)


def wrong_start(truth: Float, angle_deg: float, distance_m: float, rng: np.random.Generator) -> Float:
    """Return truth @ T_e, (4, 4): T_e turns by `angle_deg` about a random axis and shifts by `distance_m` anywhere.

    Axis and direction are uniform on the sphere; T_e acts in the LiDAR frame (paper Sec. IV-A.1).
    """
    axis, direction = rng.normal(size=(2, 3))
    return _moved(truth, axis / np.linalg.norm(axis) * angle_deg, direction / np.linalg.norm(direction) * distance_m)


def wrong_start_per_axis(truth: Float, angle_deg: float, distance_m: float, rng: np.random.Generator) -> Float:
    """Return truth @ T_e, (4, 4): rotation vector and shift of T_e are uniform in cubes of these half sides.

    T_e acts in the LiDAR frame (paper, the figure of per-axis errors: [-3, 3] deg and [-0.15, 0.15] m).
    """
    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return _moved(truth, turn * angle_deg, shift * distance_m)


def _moved(truth: Float, rotation_vector_deg: Float, shift_m: Float) -> Float:
    rotation = se3.exp(np.concatenate([np.radians(rotation_vector_deg), np.zeros(3)]))
    return np.asarray(truth @ se3.make(rotation[:3, :3], shift_m))
