"""A result goes to JSON and back without loss; anything else is refused by name."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from p2o import Camera, InputError, Result, Status, se3
from p2o.arrays import parts
from p2o.reading import RadialError
from p2o.results.evidence import Agreement, Judged, Rival, StartWeight
from p2o.results.result import CameraCheck, SweepMotion
from p2o.results.result_json import result_from_dict, result_from_json, result_to_dict, result_to_json
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.solving import Accuracy, Round, TimeOffset

PINHOLE = Camera.pinhole(700.0, 1e3 / 3, 600.0, 180.0, 1242, 375)
BETTER = RadialError(0.1 / 3, 0.01).corrected(PINHOLE)
BARE = Result(("a",), np.eye(4), np.eye(4), Status.NO_EDGES, "no edges")


def _result(seed: int = 0) -> Result:
    rng = np.random.default_rng(seed)
    rounds = tuple(
        Round("refine", reach, {"L": 3, "U": 7}, rng.uniform() / 3, rng.uniform() / 7, 1e-300, 0.1 + 0.2, accepted)
        for reach, accepted in ((50.0, True), (1 / 3, False))
    )
    return Result(
        frames=("drive/0000000005", "scène-0001"),
        start=se3.exp(rng.normal(size=6)),
        camera_from_lidar=se3.exp(rng.normal(size=6)),
        status=Status.ROUNDS_SPENT,
        reason='all 10 rounds were used: "so\nbe it"',
        rounds=(*rounds, replace(rounds[0], mean_residual=math.nan, cost=math.inf, step_m=-0.0)),
        covariance=rng.normal(size=(6, 6)),
        accuracy=Accuracy(0.1 / 3, math.inf, 1e-300, math.nan),
        matches={"L": 3},
        residual_px={"L": 0.1, "U": math.nan},
        judged=Judged("directed-distance", "px", 4.0, -math.inf),
        agreement=Agreement(1 / 3, 0.1 / 3, 4000),
        rival=Rival(1.5, "edges", math.inf, 0.1 / 3),
        verdict=Verdict((Reason(Doubt.RIVAL_POSE, "another pose"), Reason(Doubt.CAMERA, 'it is "off"'))),
        cameras=(CameraCheck(4, PINHOLE, BETTER, -0.1 / 3, 1e-9, 0.01, math.nan, 2.5, math.inf, False),),
        motions=(SweepMotion("drive/0000000005", 8.1, math.inf, 0.1 / 3, math.nan, (0.0, 0.0, 1e-3, 8.1, -0.0, 0.0)),),
        time=TimeOffset(-0.1 / 3, math.inf, True),
        seconds={"extract": 1.5},
        warnings=("three points dropped",),
        recipe={
            "extractor": "depth/rings",
            "options": {"matcher": {"angle_deg": 40.0, "on": True, "k": None, "l": [1]}},
        },
        seed=7,
        versions={"p2o-calib": "0.1.0"},
    )


def _bits(value: Any) -> Any:
    """Return a value in which equal means equal in every bit and kind."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, float):
        return np.float64(value).tobytes() if value == value else "nan"
    inner = parts(value)
    return type(value), value if inner is None else [(key, _bits(part)) for key, part in inner]


def _same(a: Result, b: Result) -> bool:
    return _bits(a) == _bits(b)


@pytest.mark.parametrize("seed", range(2))
def test_a_result_comes_back_bit_by_bit(seed: int) -> None:
    result = _result(seed)
    assert _same(result_from_json(result_to_json(result)), result)
    assert not _same(result, replace(result, residual_px={"L": np.nextafter(0.1, 1.0), "U": math.nan}))
    assert _same(result_from_json(result_to_json(BARE)), BARE)


def test_the_text_is_json_for_every_reader_without_nan() -> None:
    def refuse(word: str) -> None:
        raise AssertionError(word)

    value = json.loads(result_to_json(_result()), parse_constant=refuse)
    assert value["status"] == "rounds-spent"
    assert value["rounds"][2]["mean_residual"] is None
    assert value["rounds"][2]["cost"] == "inf"
    assert list(value) == [*(f.name for f in fields(Result)), "figures"]


def test_the_word_of_the_verdict_and_the_odds_are_there_for_who_reads_the_file_alone() -> None:
    value = result_to_dict(_result())
    assert value["verdict"] == {
        "trust": "doubtful",
        "reasons": [{"doubt": "rival-pose", "text": "another pose"}, {"doubt": "camera", "text": 'it is "off"'}],
    }
    assert value["agreement"]["odds_ratio"] == pytest.approx((1 / 2) / ((0.1 / 3) / (1 - 0.1 / 3)))
    assert list(value["rival"].values()) == [1.5, "edges", "inf", 0.1 / 3]
    bare = result_to_dict(BARE)
    reasons = [{"doubt": "not-solved", "text": "no edges"}]
    assert bare["verdict"] == {"trust": "refused", "reasons": reasons}
    assert (bare["agreement"], bare["rival"], bare["judged"]) == (None, None, None)


def test_a_word_of_the_verdict_that_somebody_changed_is_not_believed() -> None:
    value = result_to_dict(_result())
    value["verdict"]["trust"] = "trusted"
    assert not result_from_dict(value).verdict.trusted
    del value["verdict"]["trust"], value["agreement"]["odds_ratio"]
    assert _same(result_from_dict(value), _result())
    # Without a verdict it is refused, though the verdict has a default.
    del value["verdict"], value["judged"]
    with pytest.raises(InputError, match="the result lacks fields; expected judged, verdict"):
        result_from_dict(value)


def test_numbers_of_numpy_are_numbers_and_a_recipe_that_json_cannot_hold_is_refused_with_its_place() -> None:
    result = replace(_result(), matches={"L": np.int64(3)}, residual_px={"L": np.float64(0.25)})
    again = result_from_json(result_to_json(result))
    assert (again.matches, again.residual_px) == ({"L": 3}, {"L": 0.25})
    with pytest.raises(InputError, match=r"recipe.options.matcher has no form in JSON.*got object"):
        result_to_dict(replace(_result(), recipe={"options": {"matcher": object()}}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("status"), "lacks fields; expected status"),
        (lambda d: d.update(colour=1), "colour is unknown"),
        (lambda d: d["rounds"][0].pop("step_m"), "rounds.0.step_m is missing"),
        (lambda d: d["rounds"][0].update(colour=1), "rounds.0.colour is unknown"),
        (lambda d: d.update(status="fine"), "status is not valid; expected 'converged'"),
        (lambda d: d.update(start=[[1.0] * 4] * 3), "start is not valid; expected 4 x 4 numbers, not 3 x 4"),
        (lambda d: d.update(start=[[1.0] * 4, [1.0] * 3]), "start is not valid.*rows of different lengths"),
        (lambda d: d.update(start=[[1.0, "x"]] * 4), "start is not valid; expected a number"),
        (lambda d: d.update(start=None), "start is not valid; expected 4 x 4 numbers, not a single number"),
        (lambda d: d["start"][0].__setitem__(0, 5.0), "start is not valid.*rigid.*(is not orthonormal|mirrors)"),
        (lambda d: d["start"][3].__setitem__(0, None), "start is not valid.*not finite"),
        (lambda d: d.update(frames="one"), "frames is not valid; expected a valid tuple; got 'one'"),
        (lambda d: d.update(frames=[1]), "frames.0 is not valid; expected a valid string; got 1"),
        (lambda d: d.update(seed=1.5), "seed is not valid; expected a valid integer; got 1.5"),
        (lambda d: d.update(seed=True), "seed is not valid; expected a valid integer; got True"),
        (lambda d: d.update(matches={"L": "3"}), "matches.L is not valid; expected a valid integer; got '3'"),
        (lambda d: d.update(residual_px={"L": "much"}), "residual_px.L is not valid; expected a number; got 'much'"),
        (lambda d: d.update(residual_px={"L": True}), "residual_px.L is not valid; expected a number; got True"),
        (lambda d: d.update(residual_px={"L": 10**400}), "residual_px.L is not valid; expected a number that fits"),
        (lambda d: d.update(seconds=[]), "seconds is not valid; expected a valid (dictionary|mapping)"),
        (lambda d: d["rounds"][0].update(accepted=1), "rounds.0.accepted is not valid; expected a valid boolean"),
        (lambda d: d.update(verdict=None), "verdict is not valid.*got None"),
        (lambda d: d["verdict"]["reasons"][1].update(doubt="mood"), "verdict.reasons.1.doubt is not valid.*rival-pose"),
        (lambda d: d["agreement"].update(points=1.5), "agreement.points is not valid; expected a valid integer"),
        (lambda d: d["judged"].pop("unit"), "judged.unit is missing"),
        (lambda d: d["motions"][0].update(twist=[0.0] * 5), "motions.0.twist is not valid.*at least 6 items"),
        (lambda d: d["cameras"][0]["better"].update(width="wide"), "cameras.0.better.width is not valid.*integer"),
        (lambda d: d.update(covariance=[[0.0] * 6] * 5), "covariance is not valid; expected 6 x 6 numbers"),
        (lambda d: d["accuracy"].pop("translation_m_95"), "accuracy.translation_m_95 is missing"),
        (lambda d: d.update(recipe=None), "recipe is not valid; expected a valid (dictionary|mapping); got None"),
    ],
)
def test_what_is_not_a_result_is_refused_by_field(change: Any, message: str) -> None:
    value = json.loads(result_to_json(_result()))
    change(value)
    with pytest.raises(InputError, match=message) as caught:
        result_from_dict(value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1, 2", "not json", "null", "[]", "3", '"x"'])
def test_text_that_is_not_json_or_no_object_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"the result is not (JSON|an object)"):
        result_from_json(text)


def test_a_result_from_before_there_were_bounds_by_axis_is_read() -> None:
    value = result_to_dict(
        replace(_result(), accuracy=Accuracy(0.1, 0.02, 0.3, 0.05), agreement=Agreement(0.3, 0.1, 9))
    )
    for name in ("roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m"):
        del value["accuracy"][name]
    del value["agreement"]["places"]
    found = result_from_dict(value)
    assert found.accuracy == Accuracy(0.1, 0.02, 0.3, 0.05)
    assert found.agreement == Agreement(0.3, 0.1, 9)


def test_a_start_that_was_weighed_in_and_the_camera_come_back() -> None:
    """Poses within parts of a result have the shape of poses, too."""
    weight = StartWeight(2.0, 0.1, np.eye(4), Accuracy(0.2, 0.05, 0.5, 0.12), 0.01, 0.002)
    camera = Camera("OPENCV", 640, 480, (500.0, 501.0, 320.0, 240.0, -0.1, 0.01, 0.001, 0.002))
    result = replace(_result(), start_weight=weight, intrinsics=camera)
    again = result_from_json(result_to_json(result))
    assert again.intrinsics == camera
    np.testing.assert_array_equal(again.start_weight.camera_from_lidar, np.eye(4))
