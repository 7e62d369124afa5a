"""Built methods: what they prepare of a frame, whole methods beside stages, and witnesses that check them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Frame, InputError, Kind, Method, Recipe, Registry, Result, Status, UnknownNameError
from p2o.host.slots import WITNESS, WITNESS_STAGES
from p2o.solving import Doubt
from p2o_testing import stage

from tests.toolkit.offered import registry_with

TRUTH = stage.camera_from_lidar()
START = TRUTH @ p2o.se3.exp(np.array([0.01, 0, 0, 0.02, 0, 0]))


class Claims:
    """A whole method that says a pose, and remembers what it was shown."""

    def __init__(self, pose: np.ndarray) -> None:
        self.pose, self.shown = pose, []

    def prepare(self, frame: Frame) -> dict[str, Any]:
        self.shown.append(frame)
        return {"name": frame.name, "points": len(frame.cloud)}

    def solve(self, prepared: list[dict[str, Any]], start: np.ndarray) -> Result:
        names = tuple(entry["name"] for entry in prepared)
        return Result(names, start, self.pose, Status.CONVERGED, "it says so")


def registry(stage_of_method: Any, alone: bool = False) -> Registry:
    method = Method(name="claims", build=lambda options: stage_of_method, summary="Says a pose.")
    return registry_with((Kind.CALIBRATOR, method), alone=alone)


def result_of(stage_of_method: Any, **words: Any) -> Result:
    plan = Recipe.of(data=None, calibrator="claims", **words).resolve(registry(stage_of_method))
    return plan.assembly()([stage.frame()], START)


@pytest.mark.parametrize(
    "pose", [TRUTH, TRUTH @ p2o.se3.exp(np.array([0, 0.05, 0.05, 0, 0, 0]))], ids=["right", "wrong"]
)
def test_what_a_whole_method_claims_is_held_against_edges_and_advice_repeated_if_not_trusted(pose: np.ndarray) -> None:
    plan = Recipe.of(data=None, calibrator="claims", witness="depth/rings").resolve(registry(Claims(pose)))
    frame = replace(stage.frame(), warnings=("grey image",), advice=("try rectified=true",))
    result = plan.assembly()([frame], START)
    assert result.agreement.points > 0
    assert result.verdict.trusted == (pose is TRUTH)
    assert "witness" in result.seconds
    assert f"{frame.name}: grey image" in result.warnings
    assert (f"{frame.name}: try rectified=true" in result.warnings) == (pose is not TRUTH)


def test_a_witness_that_is_named_must_be_there_and_the_usual_one_need_not() -> None:
    with pytest.raises(UnknownNameError, match="unknown image extractor 'dept'"):
        result_of(Claims(TRUTH), witness="dept/rings")
    with pytest.raises(InputError, match="--witness is a pair of methods"):
        result_of(Claims(TRUTH), witness="depth")
    plan = Recipe.of(data=None, calibrator="claims").resolve(registry(Claims(TRUTH), alone=True))
    assert not set(plan.parts) & set(WITNESS)
    assert plan.assembly()([stage.frame()], START).verdict.reasons[0].doubt is Doubt.NOT_CHECKED


def test_a_whole_method_prepares_each_frame_once_and_without_its_truth() -> None:
    method = Claims(TRUTH)
    plan = Recipe.of(data=None, calibrator="claims", witness="none").resolve(registry(method))
    frames = [stage.frame(), replace(stage.frame(), name="second")]
    result = plan.assembly()(frames, START)
    assert result.frames == ("stage", "second")
    assert [frame.camera_from_lidar for frame in method.shown] == [None, None]
    assert [reason.doubt for reason in result.verdict.reasons] == [Doubt.NOT_CHECKED]
    assert tuple(plan.assembly().stages) == ("calibrator",)


def test_a_plain_function_of_frames_is_a_whole_method_too_and_keeps_nothing() -> None:
    def whole(frames: list[Frame], start: np.ndarray) -> Result:
        assert frames[0].camera_from_lidar is None
        return Result((frames[0].name,), start, TRUTH, Status.CONVERGED, "done")

    plan = Recipe.of(data=None, calibrator="claims", witness="none").resolve(registry(whole))
    assert tuple(plan.assembly().stages) == ()
    np.testing.assert_allclose(plan.assembly()([stage.frame()], START).camera_from_lidar, TRUTH, atol=1e-12)


class Own(p2o.InitializerBase):
    """An initializer that prepares frames, and remembers what it was shown and what it found in the views."""

    def __init__(self) -> None:
        self.shown, self.found = [], []

    def prepare(self, frame: Frame) -> str:
        self.shown.append(frame)
        return f"of {frame.name}"

    def __call__(self, views: list[p2o.View], start: np.ndarray) -> list[np.ndarray]:
        self.found.extend(view.prepared for view in views)
        return [start]


def test_an_initializer_may_prepare_frames_and_finds_that_in_its_views_and_frames_hold_what_it_needs() -> None:
    own = Own()
    method = Method(name="own", build=lambda options: own, summary="Prepares.", needs={"sequence"})
    plan = Recipe.of(data=None, extractor="depth/rings", init="own").resolve(registry_with((Kind.INITIALIZER, method)))
    assembly = plan.assembly()
    assert tuple(assembly.stages) == ("extractor", "cloud", "init")
    assembly(stage.drive(), START)
    assert [frame.camera_from_lidar for frame in own.shown] == [None, None, None]
    assert own.found[:3] == ["of stage/0", "of stage/1", "of stage/2"]
    assembly.calibrator(stage.drive()[:1], START)
    assert own.found[-1] == "of stage/0", "the pipeline by itself does the same"
    plan.check_frame(stage.drive()[0])
    with pytest.raises(InputError, match="the frame has no sequence; own needs it"):
        plan.check_frame(stage.frame())


@pytest.mark.parametrize(
    ("method", "text"), [(3, "build returned int; expected prepare"), (lambda f, s: None, "returned NoneType")]
)
def test_a_calibrator_that_is_none_names_its_plugin(method: Any, text: str) -> None:
    with pytest.raises(p2o.PluginError, match=f"calibrator 'claims'.*{text}"):
        result_of(method, witness="none")


def test_a_resolved_recipe_with_a_witness_resolves_again_and_stages_with_edges_need_none() -> None:
    plan = Recipe.of(data="synthetic:", calibrator="csc").resolve(Registry.load())
    assert set(WITNESS_STAGES.values()) <= set(plan.parts)
    again = Recipe.of(**plan.described()).resolve(Registry.load())
    assert set(again.parts) == set(plan.parts)
    plan = Recipe.of(data=None, extractor="depth/rings", init="given").resolve(registry(Claims(TRUTH)))
    assert not set(plan.parts) & set(WITNESS)
    assert tuple(plan.assembly().stages) == ("extractor", "cloud")


@pytest.mark.parametrize("turn_deg", [0.0, 1.0])
def test_edges_of_another_package_are_checked_by_the_default_ones(turn_deg: float) -> None:
    """A turn of all edges of the LiDAR turns the pose, and its own edges agree there: they alone would be trusted."""
    ours = Registry.load().find(Kind.CLOUD_EXTRACTOR, "rings").method
    turn = p2o.se3.exp(np.radians([0, 0, turn_deg, 0, 0, 0]))

    def build(options: Any) -> Any:
        extract = ours.build(options)

        def turned(cloud: p2o.Cloud) -> p2o.CloudFeatures:
            return extract(cloud).moved(turn)

        return turned

    registry = registry_with((Kind.CLOUD_EXTRACTOR, replace(ours, name="turned", build=build)))
    words = {"extractor": "p2ornet/turned", "perturb": "1deg 0.05m", "registry": registry}
    run = p2o.calibrate("example:", **words)
    assert run.result.verdict.trusted == (turn_deg == 0)
    assert run.rows[0].error.rotation_deg == pytest.approx(turn_deg, abs=0.3)
    assert p2o.calibrate("example:", **words, witness="none").result.verdict.trusted
