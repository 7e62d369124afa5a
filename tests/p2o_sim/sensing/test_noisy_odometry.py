"""Odometry: poses from the first one on, and errors that add up."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from p2o import se3
from p2o_sim import odometry

RNG = np.random.default_rng(3)
DRIVE = [se3.exp(np.concatenate([0.3 * RNG.normal(size=3), [2.0 * i, 0.0, 0.0]])) for i in range(6)]


def test_without_noise_poses_are_those_of_the_drive_seen_from_the_first() -> None:
    for pose, found in zip(DRIVE, odometry(DRIVE, np.random.default_rng(0)), strict=True):
        np.testing.assert_allclose(found, se3.inverse(DRIVE[0]) @ pose, atol=1e-12)


def test_errors_of_steps_have_their_size_and_add_up() -> None:
    still = [np.eye(4)] * 1501
    poses = odometry(still, np.random.default_rng(1), noise_deg=0.1, noise_m=0.02)
    steps = np.array([se3.log(se3.inverse(a) @ b) for a, b in pairwise(poses)])
    np.testing.assert_allclose(steps.std(axis=0), [np.radians(0.1)] * 3 + [0.02] * 3, rtol=0.08)
    assert se3.distance_m(poses[-1]) > 0.1
