"""An extrinsic is called off on the axis that it is off on, by as much as it is, and holds where it is right."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.confidence.audit import AXES, DEGREES, LEAD_EDGES, EdgeStep, Evidence, Rates, audit, edge_step
from p2o.confidence.explanation import explanations
from p2o.results.check import Check, CheckStatus
from p2o.results.evidence import Agreement
from p2o.run.recipe import Recipe
from p2o.solving import Pipeline

from tests import edge_scene
from tests.sparse_scene import sparse_view

NAMES = [axis for axis, _ in AXES]


def off(axis: str, size: float) -> np.ndarray:
    """The truth of the scene, off by `size` (deg or m) on one axis."""
    out, number = edge_scene.TRUTH.copy(), NAMES.index(axis)
    if number < 3:
        turn = np.zeros(6)
        turn[(2, 0, 1)[number]] = np.radians(size)
        out[:3, :3] = se3.exp(turn)[:3, :3] @ out[:3, :3]
    else:
        out[number - 3, 3] += size
    return out


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    found = Recipe.of(data=None).resolve(p2o.Registry.load()).calibrator()
    assert isinstance(found, Pipeline)
    return found


@pytest.fixture(scope="module")
def views() -> list[p2o.View]:
    return [edge_scene.view(boxes=40, seed=seed, noise_px=0.3, name=f"{seed}") for seed in (1, 2)]


def checked(views: list[p2o.View], pose: np.ndarray, pipeline: Pipeline) -> Check:
    return audit(Evidence.of(views, pose, pipeline), Rates())


def test_a_right_extrinsic_holds_on_axes_that_are_sure_enough(views: list[p2o.View], pipeline: Pipeline) -> None:
    evidence = Evidence.of(views, edge_scene.TRUTH, pipeline)
    found = audit(evidence, Rates())
    assert found.holding is CheckStatus.HOLDS
    assert {axis.holding for axis in found.axes} == {CheckStatus.HOLDS}
    assert found.estimate is not None
    assert se3.angle_deg(se3.inverse(edge_scene.TRUTH) @ found.estimate) < 0.1
    strict = audit(evidence, Rates(notice_deg=0.001, notice_m=0.0001))
    assert {strict.holding, *(axis.holding for axis in strict.axes)} == {CheckStatus.CANNOT_TELL}


@pytest.mark.parametrize(("axis", "size"), [("roll", 1.0), ("pitch", -1.0), ("yaw", 0.9), ("x", 0.15), ("y", -0.15)])
def test_an_error_above_the_limit_is_called_off_on_its_axis_by_its_size(
    axis: str, size: float, views: list[p2o.View], pipeline: Pipeline
) -> None:
    found = checked(views, off(axis, size), pipeline)
    assert found.holding is CheckStatus.OFF
    assert [each.axis for each in found.axes if each.holding is CheckStatus.OFF] == [axis]
    its = found.axes[NAMES.index(axis)]
    assert its.off == pytest.approx(size, rel=0.15)
    assert axis in found.reason


@pytest.fixture(scope="module")
def sparse_views() -> list[p2o.View]:
    return [replace(sparse_view(seed), name=f"{seed}") for seed in range(5)]


@pytest.mark.parametrize(("size", "word"), [(0.0, CheckStatus.HOLDS), (0.8, CheckStatus.OFF)])
def test_rings_far_apart_show_a_pitch_error_smaller_than_their_distance(
    size: float, word: CheckStatus, sparse_views: list[p2o.View], pipeline: Pipeline
) -> None:
    step = edge_step(sparse_views, off("pitch", size), pipeline.matcher, pipeline.options)
    found = audit(Evidence(("sparse",), off("pitch", size), step), Rates())
    assert found.holding is word
    assert step.error[1] == pytest.approx(size, abs=0.2)


def test_repeated_outlines_are_no_intervals(sparse_views: list[p2o.View], pipeline: Pipeline) -> None:
    static = [replace(sparse_views[0], name=f"{at}") for at in range(5)]
    by_middle = pipeline.options.model_copy(update={"interval_deg": 90.0})
    each = (pipeline.options, by_middle)
    steps = [edge_step(static, off("pitch", 0.5), pipeline.matcher, options) for options in each]
    assert steps[0].error.tolist() == steps[1].error.tolist()


def test_a_search_finds_a_slip_of_degrees_and_few_edges_tell_nothing(views: list[p2o.View], pipeline: Pipeline) -> None:
    found = checked(views, off("yaw", 4.0), pipeline)
    assert found.holding is CheckStatus.OFF
    assert found.axes[2].off == pytest.approx(4.0, abs=0.3)
    found = checked([edge_scene.view(boxes=1, seed=3)], edge_scene.TRUTH, pipeline)
    assert {found.holding, *(axis.holding for axis in found.axes)} == {CheckStatus.CANNOT_TELL}


SURE = Agreement(0.5, 0.1, 1000, 100)


def said(error: np.ndarray, covariance: np.ndarray) -> Check:
    """What is said of a step whose errors have this covariance."""
    step = EdgeStep(np.eye(4), error, covariance, SURE, 100)
    return audit(Evidence(("frame",), np.eye(4), step), Rates())


def test_errors_as_they_are_taken_to_be_spread_raise_no_more_alarms_than_asked() -> None:
    rng = np.random.default_rng(0)
    mixed = rng.normal(size=(6, 6))
    covariance = 1e-4 * (mixed @ mixed.T + np.eye(6))
    half = np.linalg.cholesky(covariance)
    gauss, scale = rng.standard_normal((2000, 6)), np.sqrt(DEGREES / rng.chisquare(DEGREES, 2000))
    words = [said(half @ (g * s), covariance).holding for g, s in zip(gauss, scale, strict=True)]
    assert sum(word is CheckStatus.OFF for word in words) / 2000 < 0.015


def test_an_error_at_the_limit_of_an_axis_is_noticed_as_often_as_said() -> None:
    rng = np.random.default_rng(0)
    covariance = np.diag([0.01, 0.02, 0.01, 1e-4, 1e-4, 2e-4])
    for axis in (1, 4):
        error = np.zeros(6)
        error[axis] = Rates().limit * np.sqrt(covariance[axis, axis])
        noise = rng.standard_normal((500, 6)) * np.sqrt(np.diag(covariance))
        words = [said(error + one, covariance).axes[axis].holding for one in noise]
        assert sum(word is CheckStatus.OFF for word in words) / 500 > 0.94


def test_a_pose_that_a_search_finds_counts_only_where_edges_clearly_meet_better_there() -> None:
    near = EdgeStep(np.eye(4), np.zeros(6), np.eye(6) * 1e-4, SURE, 100)
    far = replace(near, error=np.array([0.0, 0, 3.0, 0, 0, 0]))
    for lead, word in ((LEAD_EDGES - 1, CheckStatus.HOLDS), (LEAD_EDGES + 1, CheckStatus.OFF)):
        evidence = Evidence(("frame",), np.eye(4), near, far, lead)
        assert audit(evidence, Rates()).holding is word


LONG_LENS = p2o.Camera.pinhole(2000.0, 2000.0, 960.0, 540.0, 1920, 1080)


@pytest.mark.parametrize(("axis", "size"), [("yaw", 0.8), ("x", 0.3)])
def test_a_large_slip_of_a_long_lens_is_named_by_its_axis_alone(axis: str, size: float, pipeline: Pipeline) -> None:
    """0.8 deg are 28 px at this focal length: nearest edges of a dense scene lead to another pose."""
    view = edge_scene.view(LONG_LENS, boxes=120, seed=1, noise_px=0.3)
    found = checked([view], off(axis, size), pipeline)
    assert [each.axis for each in found.axes if each.holding is CheckStatus.OFF] == [axis]
    assert found.axes[NAMES.index(axis)].off == pytest.approx(size, rel=0.15)
    assert named(found) == [axis]


def named(check: Check) -> list[str]:
    """The axes whose errors the reason states."""
    return re.findall(r"(\w+) [+-]\d", check.reason)


def correlated(first: str, second: str, correlation: float) -> np.ndarray:
    """A covariance with standard deviations of 0.1 deg and 2 cm, and one correlation."""
    sigma, out = np.repeat([0.1, 0.02], 3), np.eye(6)
    out[NAMES.index(first), NAMES.index(second)] = out[NAMES.index(second), NAMES.index(first)] = correlation
    return sigma[:, None] * out * sigma


def test_one_axis_is_named_where_it_explains_what_noise_puts_on_two() -> None:
    """A yaw slip of 0.6 deg, and noise along the direction that yaw and x have in common."""
    error = np.array([0.0, 0, 0.6 - 0.15, 0, 0, 0])
    error[3] = -0.15 / 0.1 * 0.02
    found = said(error, correlated("yaw", "x", 0.7))
    assert [axis.axis for axis in found.axes if axis.holding is CheckStatus.OFF] == ["yaw"]
    assert named(found) == ["yaw"]


def test_axes_that_cannot_be_told_apart_are_named_as_a_group() -> None:
    error = np.zeros(6)
    error[[NAMES.index("yaw"), NAMES.index("x")]] = 0.22, 0.044
    found = said(error, correlated("yaw", "x", -0.99))
    assert found.holding is CheckStatus.OFF
    assert sorted(named(found)) == ["x", "yaw"]
    assert " or " in found.reason
    assert "not distinguishable" in found.reason
    by_name = {axis.axis: axis.holding for axis in found.axes}
    assert by_name["yaw"] is by_name["x"] is CheckStatus.CANNOT_TELL
    assert by_name["pitch"] is CheckStatus.HOLDS


def test_an_error_of_three_and_a_half_sigma_is_neither_off_nor_confirmed_and_one_on_all_axes_off_on_none() -> None:
    error = np.zeros(6)
    error[NAMES.index("x")] = 3.4 * 0.01
    found = said(error, np.eye(6) * 1e-4)
    assert found.axes[NAMES.index("x")].holding is CheckStatus.CANNOT_TELL
    assert found.holding is CheckStatus.CANNOT_TELL
    assert "x differs by 3.4 sigma" in found.reason
    assert found.axes[NAMES.index("y")].holding is CheckStatus.HOLDS
    on_six = said(np.full(6, 0.1), np.eye(6) * 1e-4)
    assert {axis.holding for axis in on_six.axes} == {CheckStatus.OFF}
    rates = Rates()
    found = said(np.full(6, 0.9 * rates.noticed * 0.01), np.eye(6) * 1e-4)
    assert found.holding is CheckStatus.OFF
    assert "cannot be distinguished" in found.reason
    assert {axis.holding for axis in found.axes} == {CheckStatus.CANNOT_TELL}


def test_all_axes_together_explain_any_error_also_of_an_ill_conditioned_covariance() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        covariance = axes @ np.diag(10.0 ** rng.uniform(-14, 2, 6)) @ axes.T
        [found] = explanations(error := rng.normal(size=6), covariance, lambda degrees: 0.0, 0.0)
        assert found.axes == tuple(range(6))
        assert np.array_equal(found.sizes, error)
