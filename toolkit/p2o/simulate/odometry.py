"""What odometry tells of a sensor's drive: poses in a world that begins where the sensor is at its first frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3


def odometry(
    world_from_sensor: Sequence[Float], rng: np.random.Generator, *, noise_deg: float = 0.0, noise_m: float = 0.0
) -> tuple[Float, ...]:
    """Return the poses (4, 4) of a sensor relative to its own first one, as its odometry has them.

    Nothing of where the sensor sits is left in them. Each step from frame to frame is wrong by `noise_deg` and
    `noise_m`, one sigma a component, and the errors of steps add up as in real odometry.
    """
    out = [np.eye(4)]
    sigma = np.concatenate([np.full(3, np.radians(noise_deg)), np.full(3, noise_m)])
    for before, after in pairwise(world_from_sensor):
        step = se3.inverse(before) @ after
        out.append(out[-1] @ step @ se3.exp(sigma * rng.standard_normal(6)))
    return tuple(out)
