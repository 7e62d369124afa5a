"""A run is solved if it has results, all of them are solved, and no frame failed."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, Result, Status, se3
from p2o.geometry.pose_error import pose_error
from p2o.run.outcome import FailedFrame, Row, Run


def row(name: str, status: Status = Status.CONVERGED, shift_m: float = 0.0) -> Row:
    result = Result((name,), np.eye(4), np.eye(4), status, "")
    start, error = (pose_error(se3.make(translation=[x_m, 0, 0]), np.eye(4)) for x_m in (2 * shift_m, shift_m))
    return Row(result, np.eye(4), start, error)


BAD = FailedFrame("b", "the image is truncated")


@pytest.mark.parametrize(
    ("run", "solved"),
    [
        (Run((row("a"), row("b", Status.ROUNDS_SPENT))), True),
        (Run((row("a"), row("b", Status.NO_EDGES))), False),
        (Run((row("a"),), failed=(BAD,)), False),
        (Run((), failed=(BAD,)), False),
        (Run(()), False),
    ],
)
def test_a_run_is_solved_if_every_frame_is(run: Run, solved: bool) -> None:
    assert run.solved is solved


def test_errors_of_solved_results_are_summarised_every_result_is_counted_and_a_run_with_one_has_it() -> None:
    rows = (row("a", shift_m=0.1), row("b", shift_m=0.3), row("c", Status.NO_EDGES, shift_m=5.0))
    summary = Run(rows, failed=(BAD,)).summary
    assert (summary["count"], summary["solved"], summary["failed"]) == (3, 2, 1)
    assert summary["status"] == {"converged": 2, "no-edges": 1}
    assert summary["error"]["translation_m_mean"] == pytest.approx(0.2)
    assert summary["start"]["translation_m_mean"] == pytest.approx(0.4)
    assert Run((row("a"),)).result.frames == ("a",)
    with pytest.raises(InputError, match=r"this run has 2 results; expected one; look at \.rows"):
        _ = Run((row("a"), row("b"))).result
