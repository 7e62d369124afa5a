"""The start counts for what it is known to, direction by direction."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.confidence.accuracy import DEFAULT_ERROR_MODEL, with_start

from tests import edge_scene

POSE = edge_scene.TRUTH
SIGMA = (2.0, 0.1)


def away(turn_deg: tuple[float, float, float], shift_m: tuple[float, float, float]) -> np.ndarray:
    """The pose with the LiDAR turned about the camera axes and moved along them."""
    other = POSE.copy()
    other[:3, :3] = se3.exp(np.array([*np.radians(turn_deg), 0, 0, 0]))[:3, :3] @ POSE[:3, :3]
    other[:3, 3] += shift_m
    return other


def spread(turn_deg: float, shift_m: float) -> np.ndarray:
    return np.diag(np.repeat([np.radians(turn_deg), shift_m], 3) ** 2)


def test_what_the_edges_tell_surely_stays_and_a_direction_that_they_leave_open_follows_the_start() -> None:
    found = with_start(POSE, spread(1e-4, 1e-6), away((1, -1, 1), (0.05, 0.05, -0.05)), SIGMA, DEFAULT_ERROR_MODEL)
    np.testing.assert_allclose(found[0], POSE, atol=1e-6)
    likely = spread(0.01, 0.001)
    likely[4, 4] = 100.0
    found = with_start(POSE, likely, away((0, 0, 0), (0.08, 0.08, 0.08)), SIGMA, DEFAULT_ERROR_MODEL)
    np.testing.assert_allclose((found[0] - POSE)[:3, 3], (0, 0.08, 0), atol=2e-3)
    assert se3.angle_deg(found[0] @ se3.inverse(POSE)) < 0.02


def test_what_both_say_is_surer_about_every_axis() -> None:
    likely = spread(0.5, 0.05)
    likely[0, 4] = likely[4, 0] = 0.8 * np.sqrt(likely[0, 0] * likely[4, 4])
    found = with_start(POSE, likely, away((0.2, 0, 0), (0, 0.05, 0)), SIGMA, DEFAULT_ERROR_MODEL)
    assert (np.diag(found[1]) < np.diag(likely)).all()


def test_errors_become_smaller_where_both_are_as_good_as_they_say() -> None:
    # 300 poses and initial guesses, whose errors have the stated deviations.
    rng = np.random.default_rng(0)
    alone, mean = [], []
    for _ in range(300):
        turn, shift = rng.normal(0, 0.4, 3), rng.normal(0, 0.1, 3)
        pose = away(tuple(turn), tuple(shift))
        start = away(tuple(rng.normal(0, SIGMA[0], 3)), tuple(rng.normal(0, SIGMA[1], 3)))
        found = with_start(pose, spread(0.4 / 1.35, 0.1 / 1.35), start, SIGMA, DEFAULT_ERROR_MODEL)
        if found is not None:
            alone.append(np.linalg.norm(shift))
            mean.append(p2o.pose_error(found[0], POSE).translation_m)
    assert len(mean) > 290
    assert np.mean(mean) == pytest.approx(np.mean(alone) / np.sqrt(2), rel=0.08)


@pytest.mark.parametrize(
    ("likely", "start"),
    [
        pytest.param(spread(0.1, 0.02), away((0, 0, 0), (1.5, 0, 0)), id="contradiction"),
        pytest.param(np.zeros((6, 6)), POSE, id="singular"),
        pytest.param(np.full((6, 6), np.nan), POSE, id="NaN"),
    ],
)
def test_contradictions_and_empty_covariances_change_nothing(likely: np.ndarray, start: np.ndarray) -> None:
    assert with_start(POSE, likely, start, SIGMA, DEFAULT_ERROR_MODEL) is None


def solved(sigma: tuple[float, float] | None, **words: str) -> p2o.Result:
    return p2o.calibrate(
        "synthetic:?scenes=1&right=false&seed=3",
        extractor="depth/rings",
        perturb="2deg 0.15m",
        options={"pipeline": {"start_sigma": sigma}},
        **words,
    ).result


def test_the_result_says_what_the_edges_alone_say_and_what_the_start_changed() -> None:
    both, alone = solved(SIGMA), solved(None)
    assert alone.start_weight is None
    weight = both.start_weight
    np.testing.assert_array_equal(weight.camera_from_lidar, alone.camera_from_lidar)
    assert weight.accuracy == alone.accuracy
    step = se3.inverse(alone.camera_from_lidar) @ both.camera_from_lidar
    assert (se3.angle_deg(step), se3.distance_m(step)) == (weight.step_deg, weight.step_m)
    assert both.judged.estimate < both.judged.start
    nearer = [se3.distance_m(se3.inverse(both.start) @ r.camera_from_lidar) for r in (both, alone)]
    assert nearer[0] < nearer[1]
    assert solved((0.01, 0.001)).start_weight is None, "a start much worse than it was said to be"


@pytest.mark.parametrize("init", ["given", "grid"])
def test_no_method_averages_an_initial_guess_of_unknown_accuracy_and_all_can_be_told_it(init: str) -> None:
    assert solved(None, init=init).start_weight is None
    known = solved(SIGMA, init=init)
    assert not known.status.solved or known.start_weight is not None
