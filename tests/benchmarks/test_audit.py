"""The cases of `python benchmarks/audit.py` are correct by construction, and its tables count what a check reports."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from audit import ANGLES_DEG, CORRECT, GROUPS, RIGS, SHIFTS_M, Case, Judged, cases_of
from p2o.confidence.audit import AXES
from p2o.geometry.pose_error import pose_error
from p2o.results.check import AxisCheck, Check, CheckStatus

from tests import edge_scene

NAMES = [f"{at}" for at in range(30)]


def test_the_reference_of_all_frames_comes_first_and_every_axis_gets_every_error_of_a_group() -> None:
    first, *others = cases_of(RIGS["sim-hdl64"], NAMES)
    assert first == Case("sim-hdl64", tuple(range(30)))
    for count, errors in GROUPS.items():
        cases = [case for case in others if len(case.frames) == count]
        assert sum(case.axis is None for case in cases) == pytest.approx(CORRECT, abs=2)  # equal draws count once
        sizes = Counter((case.axis, abs(case.size)) for case in cases if case.axis is not None)
        for axis in range(6):
            for number in set(errors):
                assert sizes[axis, (ANGLES_DEG if axis < 3 else SHIFTS_M)[number]] == errors.count(number)
    assert {np.sign(case.size) for case in others if case.axis is not None} == {-1, 1}


@pytest.mark.parametrize("axis", range(6))
def test_a_case_has_the_error_that_it_states(axis: int) -> None:
    size = -0.5 if axis < 3 else 0.05
    error = pose_error(Case("rig", (0,), axis, size).extrinsic(edge_scene.TRUTH), edge_scene.TRUTH)
    expected = [size if at == axis else 0.0 for at in range(6)]
    assert list(error.per_axis.values()) == pytest.approx(expected, abs=1e-3)


def judged(reason: str, axis: int | None, holding: CheckStatus = CheckStatus.OFF) -> Judged:
    axes = tuple(AxisCheck(name, unit, holding, 0.0, 0.1, 0.4) for name, unit in AXES)
    check = Check((), np.eye(4), holding, reason, axes, 0.01, 0.95, 1.0, 0.3)
    return Judged("sim-hdl64", 20, axis, 0.0 if axis is None else 0.5, check)


@pytest.mark.parametrize(
    ("reason", "named"),
    [
        ("off by about yaw +0.52 deg", "only"),
        ("off by about yaw +0.52 deg or x -9.1 cm: not distinguishable on these frames", "among"),
        ("off by about x -9.1 cm, and a search found that edges agree far better there", "other"),
        ("off, on axes that cannot be distinguished on these frames", "none"),
    ],
)
def test_the_axes_that_a_report_names_are_read_from_its_reason(reason: str, named: str) -> None:
    assert judged(reason, 2).named == named
