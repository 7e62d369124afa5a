"""Problems and judges of matchers are checked: their errors name the matcher and end one frame only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Kind, Method, PluginError, Status
from p2o.host.guard import build
from p2o.host.registry import Offer
from p2o.problems.normal_equations import linearise
from p2o.solving import LeastSquares, Objective, PointToLine, Problem
from p2o_plugins.solve import bfgs, lm, nelder_mead
from p2o_testing import stage

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import NEAR, pairs
from tests.toolkit.offered import registry_with

COUNT = 30
POSES = np.stack([np.eye(4)] * 3)


@dataclass(frozen=True, eq=False)
class Distances(LeastSquares):
    """Distances of points from their true places in the camera frame, one residual for each coordinate."""

    xyz: np.ndarray
    place: np.ndarray
    huber: float = 0.05

    @property
    def weight(self) -> np.ndarray:  # type: ignore[override]
        return np.ones(self.xyz.size)

    @property
    def frame(self) -> np.ndarray:  # type: ignore[override]
        return np.zeros(self.xyz.size, np.int64)

    def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
        moved = p2o.se3.apply(camera_from_lidar, self.xyz) - self.place
        return moved.reshape(*moved.shape[:-2], -1)


def distances(kind: type[Distances] = Distances) -> Distances:
    xyz = np.random.default_rng(0).uniform(-10, 10, (COUNT, 3))
    return kind(xyz, p2o.se3.apply(TRUTH, xyz))


def guarded(problem: object) -> Any:
    """Return the problem as the solver receives it from a guarded matcher."""
    offer = Offer(
        Kind.MATCHER, Method(name="fake", build=lambda _: lambda *_: problem, summary="A test."), "acme", "1", ""
    )
    return build(offer, p2o.Options())([], np.eye(4), 1.0)


class Raising(Distances):
    def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
        raise ZeroDivisionError("no residuals today")


class Short(Distances):
    def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
        return super().residuals(camera_from_lidar)[..., :-1]


class FlatJacobian(Distances):
    def residuals_with_jacobian(self, camera_from_lidar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.residuals(camera_from_lidar), np.zeros(540)


class NaNJacobian(Distances):
    def residuals_with_jacobian(self, camera_from_lidar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.residuals(camera_from_lidar), np.full((90, 6), np.nan)


class NaNCost(Distances):
    def cost(self, poses: np.ndarray) -> np.ndarray:
        return np.full(len(poses), np.nan)


class Odd(Distances):
    def cost(self, poses: np.ndarray) -> np.ndarray:
        return np.zeros(2)


class Deepless(Distances):
    def depth_m(self, camera_from_lidar: np.ndarray) -> float:
        raise KeyError("depth")


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Raising, "raised ZeroDivisionError while computing residuals"),
        (Short, r"residuals returned shape \(12, 89\); expected \(12, 90\)"),
        (FlatJacobian, r"the Jacobian returned shape \(540,\); expected \(90, 6\)"),
        (NaNJacobian, "the Jacobian of visible measurements contains NaN"),
        (Deepless, "raised KeyError while computing the mean depth"),
    ],
)
def test_a_solver_is_not_blamed_for_the_residuals_of_a_matcher(kind: type[Distances], message: str) -> None:
    offer = Offer(Kind.SOLVER, lm.METHOD, "ours", "1", "")
    with pytest.raises(PluginError, match=f"plugin acme: matcher 'fake'.*{message}"):
        build(offer, lm.METHOD.options())(guarded(distances(kind)), NEAR)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Raising, "raised ZeroDivisionError"),
        (Short, r"residuals returned shape \(3, 89\); expected \(3, 90\)"),
        (NaNCost, "cost returned NaN"),
        (Odd, r"cost returned shape \(2,\)"),
    ],
)
def test_the_cost_of_residuals_and_of_any_problem_is_checked(kind: type[Distances], message: str) -> None:
    with pytest.raises(PluginError, match=f"matcher 'fake'.*{message}"):
        guarded(distances(kind)).cost(POSES)


def test_a_guarded_problem_keeps_its_class_its_fields_and_its_numbers() -> None:
    plain = distances()
    problem = guarded(plain)
    assert isinstance(problem, Distances)
    assert problem.xyz is plain.xyz
    assert type(plain) is Distances  # the plugin's own object stays as it was
    np.testing.assert_array_equal(problem.cost(POSES), plain.cost(POSES))
    for ours, theirs in zip(problem.residuals_with_jacobian(NEAR), plain.residuals_with_jacobian(NEAR), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    solve = lm.METHOD.build(lm.METHOD.options())
    np.testing.assert_array_equal(solve(problem, NEAR).camera_from_lidar, solve(plain, NEAR).camera_from_lidar)


def test_a_subclass_of_pairs_and_a_copy_are_guarded_and_pairs_themselves_are_passed_on() -> None:
    class RaisingPairs(PointToLine):
        def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
            raise ValueError

    plain = pairs()
    assert guarded(plain) is plain
    problem = guarded(
        RaisingPairs(plain.xyz, plain.centre, plain.normal, plain.weight, plain.side, plain.frame, plain.cameras)
    )
    with pytest.raises(PluginError, match="matcher 'fake' raised ValueError"):
        problem.residuals(NEAR)
    problem = replace(guarded(distances(Raising)), huber=0.1)
    with pytest.raises(PluginError, match="matcher 'fake'"):
        problem.residuals(NEAR)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weight": np.full(90, -1.0)}, "weight is negative"),
        ({"weight": np.full(90, np.nan)}, "weight is negative, NaN"),
        ({"frame": np.zeros(3, np.int64)}, r"frame has shape \(3,\)"),
        ({"huber": 0.0}, "huber is 0"),
        ({"huber": property(lambda self: 1 / 0)}, "raised ZeroDivisionError while describing its residuals"),
    ],
    ids=["negative", "nan", "short", "zero", "raising"],
)
def test_weights_frames_and_widths_are_checked_when_the_problem_is_posed(change: dict[str, Any], message: str) -> None:
    class Base(LeastSquares):
        weight = np.ones(90)
        frame = np.zeros(90, np.int64)
        huber = 0.05

        def residuals(self, camera_from_lidar: np.ndarray) -> np.ndarray:
            return np.zeros((*np.shape(camera_from_lidar)[:-2], 90))

    assert guarded(Base()).cost(POSES).tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(PluginError, match=f"matcher 'fake'.*{message}"):
        guarded(type("Changed", (Base,), change)())


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (lambda pose: 1 / 0, "raised ZeroDivisionError while computing its covariance"),
        (lambda pose: np.eye(5), r"covariance returned shape \(5, 5\)"),
        (lambda pose: np.full((6, 6), np.nan), "covariance returned NaN or infinity"),
    ],
)
def test_the_covariance_of_an_objective_is_checked(covariance: Callable[[Any], Any], message: str) -> None:
    problem = guarded(Objective(lambda poses: np.zeros(len(poses)), covariance=covariance))
    solve = build(Offer(Kind.SOLVER, bfgs.METHOD, "ours", "1", ""), bfgs.METHOD.options())
    with pytest.raises(PluginError, match=f"plugin acme: matcher 'fake'.*{message}"):
        solve(problem, TRUTH)
    none = guarded(Objective(lambda poses: np.zeros(len(poses)), covariance=lambda pose: None))
    assert none.covariance(TRUTH) is None


class FromTruth:
    """A problem as the documentation describes it: any object with a cost over poses."""

    def cost(self, poses: np.ndarray) -> np.ndarray:
        return np.array([np.sum(p2o.se3.log(pose @ p2o.se3.inverse(TRUTH)) ** 2) for pose in poses])


def test_anything_with_a_cost_is_a_problem_that_solvers_minimise() -> None:
    problem = guarded(FromTruth())
    assert isinstance(problem, Problem)
    solution = nelder_mead.METHOD.build(nelder_mead.METHOD.options())(problem, NEAR)
    assert p2o.pose_error(solution.camera_from_lidar, TRUTH).rotation_deg < 0.01


def test_unseen_measurements_may_be_nan_and_arrays_of_a_plugin_stay_as_they_are() -> None:
    """A plugin may return arrays that it keeps, even read-only ones."""

    class Kept(Distances):
        def residuals_with_jacobian(self, camera_from_lidar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return KEPT

    residuals, jacobian = distances().residuals_with_jacobian(NEAR)
    residuals[:6], jacobian[:6] = np.nan, np.nan
    KEPT = residuals.copy(), jacobian.copy()
    for array in KEPT:
        array.setflags(write=False)
    found, derivatives = linearise(guarded(distances(Kept)), NEAR)
    np.testing.assert_array_equal(KEPT[0], residuals)
    np.testing.assert_array_equal(KEPT[1], jacobian)
    np.testing.assert_array_equal(found[:6], distances().far)
    assert not derivatives[:6].any()
    np.testing.assert_array_equal(derivatives[6:], jacobian[6:])


# ---- judges


class OwnJudge:
    """A judge by the distance from the truth, with a fault to be set."""

    name, unit = "distance", "rad and m"

    def __init__(self, costs: Callable[[Sequence[Any]], Any] | None = None, lead: Any = None, on: Any = None) -> None:
        self._costs, self._lead, self._on = costs, lead, on

    def costs(self, poses: Sequence[np.ndarray]) -> Any:
        return FromTruth().cost(np.stack(poses)).tolist() if self._costs is None else self._costs(poses)

    def lead(self, best: float, other: float) -> Any:
        return (other - best, self.unit) if self._lead is None else self._lead(best, other)

    def on(self, views: Sequence[p2o.View]) -> Any:
        return self if self._on is None else self._on(views)


def judge_of(judge: Any) -> Any:
    class Judging(p2o.MatcherBase):
        def __call__(self, views: Any, pose: Any, reach_px: float) -> Any:
            return FromTruth()

        def judge(self, views: Any, start: Any, poses: Any) -> Any:
            return judge(views, start, poses)

    offer = Offer(Kind.MATCHER, Method(name="fake", build=lambda _: Judging(), summary="A test."), "acme", "1", "")
    return build(offer, p2o.Options()).judge([], np.eye(4), [])


def fails(*_: Any) -> Any:
    raise RuntimeError("judge is out")


@pytest.mark.parametrize(
    ("judge", "use", "message"),
    [
        (fails, lambda judge: None, "raised RuntimeError while making its judge"),
        (lambda *_: 3, lambda judge: None, "judge returned int; expected p2o.Judge"),
        (lambda *_: OwnJudge(costs=fails), lambda judge: judge.costs(POSES), "raised RuntimeError while judging poses"),
        (lambda *_: OwnJudge(costs=lambda p: [0.0]), lambda judge: judge.costs(POSES), r"shape \(1,\); .* \(3,\)"),
        (lambda *_: OwnJudge(costs=lambda p: [np.nan] * 3), lambda judge: judge.costs(POSES), "returned NaN"),
        (lambda *_: OwnJudge(lead=fails), lambda judge: judge.lead(0.0, 1.0), "raised RuntimeError while comparing"),
        (lambda *_: OwnJudge(on=fails), lambda judge: judge.on([]), "raised RuntimeError while moving its judge"),
        (lambda *_: OwnJudge(on=lambda _: OwnJudge(fails)), lambda j: j.on([]).costs(POSES), "while judging poses"),
    ],
)
def test_what_an_own_judge_does_wrong_names_the_matcher(judge: Any, use: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(PluginError, match=f"plugin acme: matcher 'fake'.*{message}"):
        use(judge_of(judge))


def test_a_judge_without_faults_is_passed_on() -> None:
    judge = judge_of(lambda *_: OwnJudge())
    assert (judge.name, judge.unit) == ("distance", "rad and m")
    assert judge.costs([TRUTH])[0] == pytest.approx(0.0, abs=1e-12)
    assert judge.on([]).lead(1.0, 3.0) == (2.0, "rad and m")
    assert judge_of(lambda *_: None) is None, "then the pipeline judges"


# ---- a whole run


class Failing(p2o.MatcherBase):
    """A matcher whose problem fails on the second frame of a run, and its judge on the third one."""

    def __call__(self, views: Sequence[p2o.View], pose: Any, reach_px: float) -> Any:
        return Objective(fails) if views[0].name.endswith("1") else FromTruth()

    def judge(self, views: Sequence[p2o.View], start: Any, poses: Any) -> Any:
        return OwnJudge(fails if views[0].name.endswith("2") else None)


def test_a_frame_that_fails_in_a_problem_or_judge_ends_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("P2O_STRICT", raising=False)  # which would raise every fault of a plugin

    needs, gives = {"image-edges", "cloud-edges"}, {"objective"}
    method = Method(name="failing", build=lambda _: Failing(), summary="A test.", needs=needs, gives=gives)
    run = p2o.calibrate(
        stage.drive(),
        registry=registry_with((Kind.MATCHER, method)),
        extractor="depth/rings",
        matcher="failing",
        solver="nelder-mead",
        init="given",
        witness="none",
        start=stage.camera_from_lidar() @ p2o.se3.exp(np.full(6, 0.01)),
        options={"pipeline": {"rounds": 1}},
    )
    fine, *failed = (row.result for row in run.rows)
    assert fine.status is not Status.STAGE_FAILED
    for result in failed:
        assert result.status is Status.STAGE_FAILED
        assert "matcher 'failing' raised RuntimeError" in result.reason
