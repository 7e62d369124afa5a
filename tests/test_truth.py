"""The truth never reaches a stage: a dataset that lies about it gives the same estimate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from p2o import Frame, Kind, Result, se3
from p2o.geometry.perturb import wrong_start
from p2o.host.registry import Registry
from p2o.run.run import calibrate


@cache
def frame() -> Frame:
    dataset = Registry.load().find(Kind.DATASET, "synthetic").method
    return dataset.build(dataset.options(scenes=1, seed=3))[0]


@cache
def honest(init: str) -> Result:
    return estimate(init, frame().camera_from_lidar)


def estimate(init: str, truth: np.ndarray | None) -> Result:
    """Calibrate the frame with this for its truth, from one and the same start."""
    start = wrong_start(frame().camera_from_lidar, 1.0, 0.05, np.random.default_rng(0))
    return calibrate(replace(frame(), camera_from_lidar=truth), start=start, init=init).result


LIES = {
    "turned": se3.exp(np.array([0.5, -0.4, 1.0, 3.0, 2.0, 1.0])),
    "slightly off": se3.exp(np.array([0.01, 0, 0, 0, 0, 0.1])),
}


@pytest.mark.parametrize("init", ["given", "search"])
@pytest.mark.parametrize("lie", [*LIES, "unknown"])
def test_a_wrong_or_unknown_truth_changes_no_bit_of_the_estimate(init: str, lie: str) -> None:
    lying = estimate(init, None if lie == "unknown" else LIES[lie] @ frame().camera_from_lidar)
    assert honest(init).status.solved
    assert honest(init).camera_from_lidar.tobytes() == lying.camera_from_lidar.tobytes()
    assert repr(honest(init).rounds) == repr(lying.rounds)
