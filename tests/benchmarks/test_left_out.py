"""The error model that `python benchmarks/left_out.py fit` fits is that of `p2o.confidence.accuracy`."""

from __future__ import annotations

from dataclasses import replace

import left_out
import numpy as np
import pytest
from left_out import USUAL, Row, compared
from p2o.confidence.accuracy import DEFAULT_ERROR_MODEL, ErrorBudget, likely_covariance
from p2o.results.evidence import Agreement

from tests.edge_scene import TRUTH

AGREEMENT = Agreement(0.5, 0.1, 1000, 100)


def row(rig: str, rng: np.random.Generator, *, intervals: bool = False, is_right: bool = True) -> Row:
    """A result whose errors follow the default model."""
    matrices = [m @ m.T * 1e-6 for m in rng.normal(size=(4, 6, 6))]
    pairs, beams, objects, cameras = (np.diag(np.diag(matrix)) for matrix in matrices)
    budget = ErrorBudget(pairs, beams, objects, np.full(6, 1e-3), views=2.0, intervals=intervals, cameras=cameras)
    covariance = likely_covariance(budget, TRUTH, AGREEMENT, DEFAULT_ERROR_MODEL)
    error = rng.normal(size=6) * np.sqrt(np.diag(covariance))
    size = float(np.degrees(np.linalg.norm(error[:3]))), float(np.linalg.norm(error[3:]))
    return Row(rig, 1, is_right, True, False, intervals, error, size, (0.0, 0.0), TRUTH, budget, AGREEMENT, None)


def rows() -> list[Row]:
    rng = np.random.default_rng(0)
    return [row(rig, rng, intervals=intervals) for rig in "abc" for intervals in (False, True) for _ in range(8)]


def test_the_variances_of_the_fit_are_those_of_the_predicted_error() -> None:
    results = rows()[:4]
    model = {name: getattr(DEFAULT_ERROR_MODEL, name) for name in USUAL}
    variances = left_out._Errors.of(results).variance(model)
    for result, variance in zip(results, variances, strict=True):
        assert result.budget is not None
        covariance = likely_covariance(result.budget, TRUTH, AGREEMENT, DEFAULT_ERROR_MODEL)
        assert variance == pytest.approx(np.diag(covariance), rel=1e-9)


def test_the_choice_for_a_rig_is_the_one_that_is_best_on_all_others() -> None:
    """One choice is far better on one rig only, which must not choose for itself."""
    good, better = rows(), [replace(result, size=(2 * result.size[0], 2 * result.size[1])) for result in rows()]
    better = [replace(r, size=(1e-4, 1e-5)) if r.rig == "a" else r for r in better]
    lines = [line.split("|") for line in compared({"good": good, "better": better}).splitlines()]
    assert lines[0][2].strip() == "good"
    chosen = {line[1].strip(): line[-2].strip() for line in lines[2:]}
    assert chosen == {
        "a": "good",
        "b": "better",
        "c": "better",
        "all but references in question, geometric mean": "better",
    }
