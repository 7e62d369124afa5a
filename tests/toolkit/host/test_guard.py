"""The guard around stages: methods receive frames without ground truth, and what they return is checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Frame, Kind, Method, PluginError, Result, Status
from p2o.frames.frame import LazyFrames
from p2o.host.guard import build
from p2o.host.registry import Offer
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


def guarded(kind: Kind, method: Any) -> Any:
    offer = Offer(kind, Method(name="fake", build=lambda _: method, summary="A test."), "acme", "1", "")
    return build(offer, p2o.Options())


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
