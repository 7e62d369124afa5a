"""The guard around stages: methods receive frames without ground truth, and what they return is checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Frame, Kind, Method, PluginError, Result, Status, se3
from p2o.frames.frame import LazyFrames
from p2o.host.guard import build
from p2o.host.registry import Offer
from p2o.solving import LeastSquares
from p2o_testing import stage


class Recorder(p2o.Calibrator, p2o.InitializerBase):
    """A method that keeps the frames it receives."""

    prepares = True

    def __init__(self, prepared: Callable[[Frame], Any] = lambda frame: frame.cloud.xyz) -> None:
        self.received: list[Frame] = []
        self.prepared = prepared

    def prepare(self, frame: Frame, /) -> Any:
        self.received.append(frame)
        return self.prepared(frame)

    def solve(self, prepared: Sequence[Any], camera_from_lidar: np.ndarray, /) -> Result:
        return Result(("frame",), camera_from_lidar, camera_from_lidar, Status.CONVERGED, "")

    def __call__(self, *_: Any) -> Any:
        raise AssertionError("only frames are prepared here")


def guarded(kind: Kind, method: Any, gives: frozenset[str] = frozenset()) -> Any:
    offer = Offer(kind, Method(name="fake", build=lambda _: method, summary="A test.", gives=gives), "acme", "1", "")
    return build(offer, p2o.Options())


class Residuals(LeastSquares):
    """Residuals of other types, or of views that do not exist."""

    huber = far = 1.0
    weight = np.ones(6)

    def __init__(self, frame: int = 0, dtype: Any = float) -> None:
        self.frame, self.dtype = np.full(6, frame), dtype

    def residuals(self, camera_from_lidar: np.ndarray) -> Any:
        return np.ones((*camera_from_lidar.shape[:-2], 6), self.dtype)


def solved(**fields: Any) -> Any:
    """Return a calibrator with these fields in its result, which differs from its start."""
    pose = se3.exp(np.full(6, 0.01))
    return lambda frames, start: replace(Result(("a",), start, pose @ start, Status.CONVERGED, ""), **fields)


UNKNOWN_SIDE: Any = lambda _: p2o.ImageFeatures(edges=p2o.ImageEdges(np.ones((1, 2)), np.array([9])))  # noqa: E731


@pytest.mark.parametrize(
    ("kind", "call", "gives", "text"),
    [
        (Kind.IMAGE_EXTRACTOR, UNKNOWN_SIDE, "", "extracting: side of the image edges .* got 9"),
        (Kind.SOLVER, lambda *_: p2o.Solution(np.eye(4), "low", 1), "", "TypeError while solving; got .* not real"),  # type: ignore[arg-type]
        (Kind.SOLVER, lambda *_: p2o.Solution(np.eye(4), 0.0, 1, "done"), "", "solving: the status .* got 'done'"),  # type: ignore[arg-type]
        (Kind.MATCHER, lambda *_: Residuals(1), "residuals", "frame contains 1 to 1; expected views 0 to 0"),
        (Kind.CALIBRATOR, solved(accuracy=3), "", "calibrating: accuracy is not valid"),
        (Kind.CALIBRATOR, solved(covariance=np.eye(3)), "", "calibrating: covariance is not valid.* 3 x 3"),
        (Kind.CALIBRATOR, solved(covariance=np.full((6, 6), np.nan)), "", "covariance returned NaN"),
        (Kind.CALIBRATOR, solved(covariance=-np.eye(6)), "", "covariance has a negative variance; expected a diagonal"),
        (Kind.SOLVER, lambda *_: p2o.Solution(np.eye(4), 0.0, 1, covariance=-np.eye(6)), "", "a negative variance"),
        (Kind.CALIBRATOR, solved(status="converged"), "", "the status is 'converged'; expected a p2o.Status"),
        (Kind.CALIBRATOR, solved(reason=None), "", "calibrating: reason is not valid"),
        (Kind.CALIBRATOR, lambda frames, start: start.fill(0), "", "ValueError while calibrating.*read-only"),
        (Kind.CALIBRATOR, lambda frames, pose: pose, "", "returned ndarray; expected p2o.Result"),
        (Kind.MATCHER, lambda views, pose, reach: 3, "", "returned int; expected p2o.solving.Problem"),
        (Kind.IMAGE_EXTRACTOR, lambda image: None, "", "returned NoneType; expected p2o.ImageFeatures"),
        (Kind.IMAGE_EXTRACTOR, lambda image: p2o.ImageFeatures(), "image-edges", "gave no edges"),
        (Kind.CLOUD_EXTRACTOR, lambda cloud: [], "", "returned list; expected p2o.CloudFeatures"),
        (Kind.SOLVER, lambda p, pose: p2o.Solution(pose * np.nan, 0.0, 1), "", "no rigid transform"),
        (Kind.SOLVER, lambda p, pose: p2o.Solution(pose[:3], 0.0, 1), "", "no rigid transform"),
        (Kind.SOLVER, lambda p, pose: p2o.Solution(np.diag([1.0, 1, -1, 1]), 0.0, 1), "", "mirrors space"),
        (Kind.SOLVER, lambda p, pose: p2o.Solution(pose, np.nan, 1), "", "cost returned NaN"),
        (Kind.SOLVER, lambda p, pose: p2o.Solution(pose, 0.0, 1, covariance=np.eye(5)), "", r"expected \(6, 6\)"),
        (Kind.INITIALIZER, lambda views, pose: [], "", "proposed no start"),
        (Kind.INITIALIZER, lambda views, pose: [np.zeros((4, 4))], "", "no rigid transform"),
    ],
)
def test_wrong_values_of_a_stage_are_faults_that_name_it(kind: Kind, call: Any, gives: str, text: str) -> None:
    given = {
        Kind.IMAGE_EXTRACTOR: (stage.frame().image,),
        Kind.CLOUD_EXTRACTOR: (stage.frame().cloud,),
        Kind.MATCHER: ([stage.view()], np.eye(4), 1.0),
        Kind.SOLVER: (None, np.eye(4)),
        Kind.INITIALIZER: ([], np.eye(4)),
        Kind.CALIBRATOR: ([stage.frame()], np.eye(4)),
    }
    with pytest.raises(PluginError, match=f"plugin acme: {kind} 'fake'.*{text}"):
        guarded(kind, call, frozenset(gives.split()))(*given[kind])


@pytest.mark.parametrize("dtype", [complex, "U8"])
def test_residuals_that_are_no_real_numbers_are_a_fault(dtype: Any) -> None:
    problem = guarded(Kind.MATCHER, lambda *_: Residuals(dtype=dtype))([stage.view()], np.eye(4), 1.0)
    with pytest.raises(PluginError, match="TypeError while computing residuals; got these are not real numbers"):
        problem.residuals(np.eye(4))


def test_a_result_has_the_start_that_was_given_and_returns_it_if_it_is_refused() -> None:
    for status in (Status.CONVERGED, Status.NO_FEATURES):
        result = guarded(Kind.CALIBRATOR, solved(start=stage.camera_from_lidar(), status=status))([], np.eye(4))
        assert np.array_equal(result.start, np.eye(4))
        assert np.array_equal(result.camera_from_lidar, np.eye(4)) == (not status.solved)


@pytest.mark.parametrize("kind", [Kind.CALIBRATOR, Kind.INITIALIZER])
def test_a_method_prepares_the_frame_without_its_ground_truth(kind: Kind) -> None:
    frame, method = stage.frame(), Recorder()
    assert frame.camera_from_lidar is not None
    prepared = guarded(kind, method).prepare(frame)
    (received,) = method.received
    assert received.camera_from_lidar is None
    assert (received.name, received.cloud, received.image) == (frame.name, frame.cloud, frame.image)
    assert np.array_equal(prepared, frame.cloud.xyz)
    assert frame.camera_from_lidar is not None


def test_a_plain_function_calibrates_frames_without_their_ground_truth() -> None:
    received: list[Frame] = []

    def calibrate(frames: Sequence[Frame], start: np.ndarray) -> Result:
        received.extend(frames)
        return Result(tuple(frame.name for frame in frames), start, start, Status.CONVERGED, "")

    frame = stage.frame()
    guarded(Kind.CALIBRATOR, calibrate)([frame, replace(frame, name="other")], np.eye(4))
    assert [(f.name, f.camera_from_lidar) for f in received] == [(frame.name, None), ("other", None)]


@pytest.mark.parametrize("kind", [Kind.CALIBRATOR, Kind.INITIALIZER])
@pytest.mark.parametrize(
    ("value", "name"),
    [
        (None, "NoneType"),
        (iter([1]), "list_iterator"),
        (len, "builtin_function_or_method"),
        (lambda frame: frame, "function"),
        (np.ndarray, "type"),
    ],
)
def test_a_method_that_prepares_no_data_is_refused_with_the_frame(kind: Kind, value: Any, name: str) -> None:
    frame = stage.frame()
    with pytest.raises(PluginError, match=f"{kind} 'fake'.*prepare returned {name} for {frame.name}; expected the"):
        guarded(kind, Recorder(lambda _: value)).prepare(frame)


class Failing:
    """Raises when a property is read, which `isinstance` with a protocol does up to Python 3.11."""

    @property
    def names(self) -> Any:
        raise ZeroDivisionError

    name = unit = names

    def __len__(self) -> int:
        return 0

    __getitem__ = costs = lead = on = __len__


class Judging(p2o.MatcherBase):
    """A matcher with a judge that fails."""

    def __call__(self, *_: Any) -> Any:
        raise AssertionError("only its judge is made here")

    def judge(self, *_: Any) -> Any:
        return Failing()


def test_properties_that_raise_are_faults_of_the_plugin() -> None:
    with pytest.raises(PluginError, match="plugin acme: dataset 'fake' raised ZeroDivisionError while"):
        guarded(Kind.DATASET, Failing())
    with pytest.raises(PluginError, match="matcher 'fake' raised ZeroDivisionError while naming its judge"):
        guarded(Kind.MATCHER, Judging()).judge([stage.view()], np.eye(4), [np.eye(4)])


def test_a_dataset_may_identify_computed_frames() -> None:
    def identity(*values: Any) -> Any:
        dataset = LazyFrames({"a": 1}, lambda _: stage.frame(), identify=(lambda _: values[0]) if values else None)
        return guarded(Kind.DATASET, dataset).identity(0)

    shared = {"forget_rings": False, "keep_rings": 1}
    assert identity() is None
    assert identity(None) is None
    assert identity({"seed": 3}) == ["fake@acme", {"seed": 3}, shared]
    for value in (np.ones(3), float("nan"), {"options": p2o.Options()}):
        with pytest.raises(PluginError, match=r"fake.*: identity of frame 0: .*; expected values of JSON, or None"):
            identity(value)
