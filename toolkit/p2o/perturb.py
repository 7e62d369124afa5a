"""Wrong starting poses of a stated size, for experiments (paper Sec. IV-A: T_gt T_e)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from p2o import se3
from p2o.arrays import Float
from p2o.errors import InputError


@dataclass(frozen=True)
class Perturbation:
    """How wrong a start is: a rotation of exactly `angle_deg` and a shift of exactly `distance_m`."""

    angle_deg: float
    distance_m: float

    def __str__(self) -> str:
        return f"{self.angle_deg:g}deg {self.distance_m:g}m"


def parse_perturbation(text: str) -> Perturbation:
    """Return the perturbation that a text such as "2deg 0.15m" (or "2deg,15cm") states; a missing part is zero.

    Raises InputError for anything else, for negative sizes and for angles above 180 degrees.
    """
    amounts = {"deg": 0.0, "m": 0.0}
    parts = [p for p in re.split(r"[\s,;]+", text.strip()) if p]
    for part in parts:
        match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)(deg|m|cm|mm)", part)
        if match is None:
            raise InputError(
                "cannot read the perturbation", where="--perturb", expected='text such as "2deg 0.15m"', got=repr(text)
            )
        value, unit = float(match[1]), match[2]
        amounts["deg" if unit == "deg" else "m"] = value * {"deg": 1, "m": 1, "cm": 0.01, "mm": 0.001}[unit]
    if not parts or amounts["deg"] > 180:
        raise InputError("the perturbation is out of bounds", where="--perturb", expected="0..180 deg", got=repr(text))
    return Perturbation(amounts["deg"], amounts["m"])


def wrong_start(truth: Float, angle_deg: float, distance_m: float, rng: np.random.Generator) -> Float:
    """Return truth @ T_e, (4, 4): T_e turns by `angle_deg` about a random axis and shifts by `distance_m` anywhere.

    Axis and direction are uniform on the sphere; T_e acts in the LiDAR frame (paper Sec. IV-A.1).
    """
    axis, direction = rng.normal(size=(2, 3))
    rotation = se3.exp(np.concatenate([axis / np.linalg.norm(axis) * np.radians(angle_deg), np.zeros(3)]))
    return np.asarray(truth @ se3.make(rotation[:3, :3], direction / np.linalg.norm(direction) * distance_m))
