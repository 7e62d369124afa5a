"""What to do next, by the reasons of a verdict."""

from __future__ import annotations

import numpy as np
from p2o import Result, Status
from p2o.results.advice import BY_DOUBT, next_steps
from p2o.results.verdict import Doubt, Reason, Verdict


def advice(*doubts: Doubt) -> tuple[str, ...]:
    verdict = Verdict(tuple(Reason(doubt, "A test.") for doubt in doubts))
    return next_steps(Result(("frame",), np.eye(4), np.eye(4), Status.CONVERGED, "A test.", verdict=verdict))


def test_a_camera_in_doubt_comes_first_and_more_frames_are_not_advised() -> None:
    steps = advice(Doubt.TOO_UNSURE, Doubt.CAMERA)
    assert steps[0] == BY_DOUBT[Doubt.CAMERA][0]
    assert not any("more frames jointly" in step for step in steps)
    assert any("more frames jointly" in step for step in advice(Doubt.TOO_UNSURE))
