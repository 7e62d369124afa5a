"""The common result of a rig: what exact, noisy and contradicting results of its cameras make of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from p2o import Result, Status, se3
from p2o.arrays import Float
from p2o.confidence.fusion import Fusion, Opinion, rig_result
from p2o.geometry.pose_error import deviations
from p2o.solving import Accuracy, Doubt, Reason, Trust, Verdict

PLACES = {
    "front": se3.exp(np.array([1.2, -1.2, 1.2, 0.1, -0.2, 0.4])),
    "left": se3.exp(np.array([0.3, -2.0, 0.4, -0.6, 0.1, 0.2])),
    "back": se3.exp(np.array([-0.2, 0.1, 2.8, 0.5, 0.3, -1.0])),
}
TRUTH = se3.exp(np.array([0.02, -0.01, 0.3, 0.9, 0.1, 1.6]))
"""body_from_lidar."""
SPREAD = np.diag([2e-3, 1e-3, 1e-3, 0.02, 0.03, 0.05])


def result(pose: Float, spread: Float = SPREAD, **values: Any) -> Result:
    """Return a solved result whose errors are left updates with these deviations (6, 6)."""
    return Result(("a",), pose, pose, Status.CONVERGED, "", **{"covariance": spread @ spread.T, **values})


def results(*steps: Float, spread: Float = SPREAD) -> dict[str, Result]:
    """Return the results of the cameras, each a left update away from the truth."""
    steps = steps or (np.zeros(6),) * 3
    return {
        name: result(se3.exp(step) @ place @ TRUTH, spread)
        for (name, place), step in zip(PLACES.items(), steps, strict=True)
    }


def test_exact_results_give_the_truth_whatever_their_weights() -> None:
    exact = results()
    exact["left"] = result(PLACES["left"] @ TRUTH, 10 * SPREAD)
    common = rig_result(exact, PLACES)
    np.testing.assert_allclose(common.body_from_lidar, TRUTH, atol=1e-12)
    assert common.chi_square == pytest.approx(0, abs=1e-9)
    assert common.p_value == pytest.approx(1)
    assert common.degrees == 12
    assert common.verdict.trusted
    for camera in common.cameras:
        np.testing.assert_allclose(camera.camera_from_lidar, PLACES[camera.name] @ TRUTH, atol=1e-12)
        assert camera.rotation_deg == pytest.approx(0, abs=1e-6)
    # A wrong transform between cameras is reported although every result is exact.
    slipped = {**PLACES, "back": se3.exp(np.array([0, 0, 0, 0.5, 0, 0])) @ PLACES["back"]}
    common = rig_result(results(), slipped)
    assert [reason.doubt for reason in common.verdict.reasons] == [Doubt.CONTRADICTION]
    assert "most of all back" in common.verdict.why


def test_the_common_result_does_not_depend_on_the_choice_of_the_body_frame() -> None:
    rng = np.random.default_rng(3)
    noisy = results(*(SPREAD @ rng.normal(size=6) for _ in PLACES))
    other_from_body = se3.exp(np.array([0.4, 1.0, -2.0, 3.0, -5.0, 1.0]))
    moved = {name: place @ se3.inverse(other_from_body) for name, place in PLACES.items()}
    here, there = rig_result(noisy, PLACES), rig_result(noisy, moved)
    np.testing.assert_allclose(there.body_from_lidar, other_from_body @ here.body_from_lidar, atol=1e-7)
    assert there.chi_square == pytest.approx(here.chi_square, rel=1e-4)
    assert there.accuracy.translation_m == pytest.approx(here.accuracy.translation_m, rel=1e-4)


def test_two_opinions_are_weighted_by_their_variances_and_results_that_scatter_so_have_the_right_chi_square() -> None:
    rng = np.random.default_rng(5)
    drawn = [rig_result(results(*(SPREAD @ rng.normal(size=6) for _ in PLACES)), PLACES) for _ in range(60)]
    # 12 degrees of freedom: mean 12, variance 24; the mean of 60 is within 4 deviations.
    assert np.mean([common.chi_square for common in drawn]) == pytest.approx(12, abs=4 * np.sqrt(24 / 60))
    assert np.mean([Doubt.CONTRADICTION in [r.doubt for r in common.verdict.reasons] for common in drawn]) < 0.05
    off = [se3.inverse(TRUTH) @ common.body_from_lidar for common in drawn]
    within = [se3.angle_deg(o) <= common.accuracy.rotation_deg for o, common in zip(off, drawn, strict=True)]
    assert 0.5 < np.mean(within) < 0.85
    single = deviations(SPREAD @ SPREAD.T, PLACES["front"] @ TRUTH)[1]
    assert np.sqrt(np.mean([se3.distance_m(step) ** 2 for step in off])) < 0.7 * single, "better than one alone"
    # 1 m apart along x, variances 1 and 3: the mean lies at 1/4, its variance is 3/4, and chi-square 1 / (1 + 3).
    near, far = (Opinion("c", se3.make(translation=[x, 0, 0]), v * np.eye(6)) for x, v in ((0, 1), (1, 3)))
    mean = Fusion.of([near, far])
    np.testing.assert_allclose(mean.body_from_lidar, se3.make(translation=[0.25, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(mean.covariance, 0.75 * np.eye(6))
    assert mean.chi_square == pytest.approx(0.25)


def test_a_camera_that_contradicts_the_fixed_transforms_is_named_and_widens_the_likely_error() -> None:
    wrong = results(np.zeros(6), np.array([0, 0.03, 0, 0, 0, 0]), np.zeros(6))
    common, agreeing = rig_result(wrong, PLACES), rig_result(results(), PLACES)
    [reason] = common.verdict.reasons
    assert (common.verdict.trust, reason.doubt) == (Trust.DOUBTFUL, Doubt.CONTRADICTION)
    assert "contradict the fixed transforms" in reason.text
    assert "most of all left, 1.72 deg" in reason.text
    assert common.accuracy.rotation_deg > 2 * agreeing.accuracy.rotation_deg


def test_the_likely_error_weighs_more_than_the_noise_of_pairs_and_leaves_no_direction_out() -> None:
    """Both cameras say the same covariance, but the edges of the second agree little: it is likely 30 times as bad."""
    accuracies = {"front": Accuracy(0.1, 0.05, 0.2, 0.1), "left": Accuracy(3.0, 1.5, 6.0, 3.0)}
    said = {
        name: result(se3.make(translation=[x, 0, 0]) @ PLACES[name] @ TRUTH, accuracy=accuracies[name])
        for x, name in enumerate(accuracies)
    }
    common = rig_result(said, {name: PLACES[name] for name in said})
    assert se3.distance_m(se3.inverse(TRUTH) @ common.body_from_lidar) < 0.02
    assert common.accuracy.translation_m < 0.051, "no worse than the better one"
    needle = np.diag([1e-3, 1e-3, 1e-3, 1e-6, 0.02, 0.02])
    own = result(PLACES["front"] @ TRUTH, needle, accuracy=Accuracy(0.4, 0.1, 0.9, 0.2))
    opinion = Opinion.of("front", own, PLACES["front"])
    assert deviations(opinion.covariance, opinion.body_from_lidar) == pytest.approx((0.4, 0.1))
    place = np.hstack([-se3.skew(opinion.body_from_lidar[:3, 3]), np.eye(3)])
    least = np.sqrt(np.linalg.eigvalsh(place @ opinion.covariance @ place.T)[0])
    assert least > 0.02, "a few pairs do not know one direction to a micrometre"


@pytest.mark.parametrize(
    ("left", "why"),
    [
        (Result(("a",), np.eye(4), np.eye(4), Status.NO_EDGES, "none seen"), "no-edges: none seen"),
        (result(PLACES["left"] @ TRUTH, covariance=None), "its result has no covariance"),
        (result(PLACES["left"] @ TRUTH, np.diag([1e-3, 1e-3, 1e-3, 0.02, 0.02, 0])), "its covariance is singular"),
        (result(PLACES["left"] @ TRUTH, np.full((6, 6), np.nan)), "its covariance is singular"),
        (None, "it has no result"),
    ],
)
def test_cameras_that_cannot_be_weighed_are_left_out_with_the_reason(left: Result | None, why: str) -> None:
    said = {name: one for name, one in {**results(), "left": left}.items() if one is not None}
    common = rig_result(said, PLACES)
    assert [camera.left_out for camera in common.cameras] == ["", why, ""]
    np.testing.assert_allclose(common.body_from_lidar, TRUTH, atol=1e-12)
    del said["back"]
    alone = rig_result(said, PLACES)
    assert (alone.body_from_lidar, alone.verdict.trust) == (None, Trust.REFUSED)
    assert alone.reason == "1 of 3 cameras have a pose with a covariance, and it takes two"


def test_a_common_result_is_trusted_where_two_cameras_are() -> None:
    doubt = Verdict((Reason(Doubt.LITTLE_AGREEMENT, "little"),))
    said = results()
    said["left"] = result(PLACES["left"] @ TRUTH, verdict=doubt)
    assert rig_result(said, PLACES).verdict.trusted
    said["back"] = result(PLACES["back"] @ TRUTH, verdict=doubt)
    common = rig_result(said, PLACES)
    assert common.verdict.trust is Trust.DOUBTFUL
    assert common.verdict.why == "1 of 3 cameras are trusted on their own, and it takes two"
    assert not common.reaches(10, 10)
