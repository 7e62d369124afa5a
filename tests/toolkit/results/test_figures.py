"""A figure of a result is described in one place; JSON, terminal, page, and columns and page of a study follow."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o.cli.summary import describe
from p2o.page.run_page import run_page
from p2o.results import figures
from p2o.results.evidence import Agreement, Judged, Rival
from p2o.results.figures import FIGURES, Figure, accuracy_text, figure_lines, figure_values, result_lines
from p2o.results.result import Result, Status, TimeOffset
from p2o.results.result_json import result_from_json, result_to_json
from p2o.run.outcome import Row
from p2o.solving import Accuracy
from p2o_study.row import METRICS
from p2o_study.rows import Rows
from p2o_study.worker import _filled
from p2o_testing.same import difference

from tests.fake_study import run_of
from tests.page_description import blocks, description


def result(**values: object) -> Result:
    return Result(("a",), np.eye(4), np.eye(4), Status.CONVERGED, "no further change", **values)


def line(label: str, **values: object) -> str:
    return dict(result_lines(result(**values)))[label]


def test_a_figure_is_in_json_terminal_page_and_store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    glare = Figure("glare_px", lambda result: len(result.frames) / 8, "glare", "blinded {} of the image", "px", ".3f")
    monkeypatch.setattr(figures, "FIGURES", (*FIGURES, glare))
    calibrated = result(matches={"L": 3})
    text = result_to_json(calibrated)
    assert json.loads(text)["figures"]["glare_px"] == 0.125
    assert difference(result_from_json(text), calibrated) == ""
    row = Row(calibrated, None, None, None)
    assert "\n  glare     blinded 0.125 px of the image\n" in describe(row)
    evidence = blocks(description(run_page(tmp_path, {"results": [row.as_dict()]})), "facts")
    assert ["glare", "blinded 0.125 px of the image"] in [line for one in evidence for line in one["rows"]]
    rows = Rows(tmp_path)
    rows.put("s", _filled(replace(run_of("ours", "f", 0, 1.0, 0.1), figures={}), calibrated))
    [stored] = rows.each("s")
    assert stored.figures == {name: value for name, value in figure_values(calibrated).items() if value is not None}
    assert ("glare", "blinded 0.125 px of the image") in figure_lines(stored.figures)


def test_every_figure_has_a_name_of_its_own_and_is_worded_by_itself_or_by_another_one() -> None:
    names = [figure.name for figure in FIGURES]
    assert len(set(names)) == len(names)
    assert not set(names) & {"predicted", *METRICS}, "names of fields of rows"
    for figure in FIGURES:
        others = " ".join(other.text for other in FIGURES if other is not figure)
        assert figure.text or f"{{{figure.name}" in others, figure.name


def test_an_unknown_figure_is_left_out_and_a_warning_of_several_frames_is_one_line() -> None:
    values = figure_values(result())
    assert {name for name, value in values.items() if value is not None} == {"moved_deg", "moved_m"}
    assert result_lines(result()) == [("moved", "0.000 deg, 0.000 m from the initial guess")]
    without_points = figure_values(result(agreement=Agreement(0.0, 0.0, 0)))
    assert without_points["odds_ratio"] is None, "NaN is unknown"
    assert line("predicted", matches={"L": 3}) == "unknown"
    assert accuracy_text(None) == "unknown"
    warnings = ("a: dark", "b: dark", "a: blurred", "general: remark")
    joint = Result(("a", "b"), np.eye(4), np.eye(4), Status.CONVERGED, "", warnings=warnings)
    texts = [text for label, text in result_lines(joint) if label == "warning"]
    assert texts == ["2 frames: dark", "a: blurred", "general: remark"]


def test_the_wording_of_the_evidence_has_no_sign_of_a_difference() -> None:
    agreement = Agreement(0.3, 0.05, 900, 64)
    odds = 0.3 / 0.7 / (0.05 / 0.95)
    assert line("agreement", agreement=agreement) == (
        "30 % of LiDAR edges at an image edge, 5 % expected under random alignment, "
        f"odds ratio {odds:.1f}, 64 independent cells, evidence {8 * math.log(odds):.1f}"
    )
    assert line("next best", rival=Rival(1.25, "edges", 1.5, 0.2)) == (
        "pose at a distance of 1.50 deg, 0.20 m, cost higher by 1.2 edges"
    )
    assert line("cost", judged=Judged("mutual-information", "bit", -0.5, -0.75)) == (
        "-0.5 bit at the initial guess, -0.75 bit at the result, by mutual-information"
    )
    assert line("time", time=TimeOffset(-0.0004, 0.0012, False)) == (
        "images later than their timestamps by -0.4 ms, sigma 1.2 ms, not corrected"
    )
    accuracy = Accuracy(0.2, 0.05, math.inf, 0.12, 0.1, 0.1, 0.1, 0.01, 0.02, 0.03)
    assert line("predicted", accuracy=accuracy) == accuracy_text(accuracy)
    assert accuracy_text(accuracy) == (
        "rotation error 0.20 deg (67 %), inf deg (95 %), translation error 0.050 m (67 %), 0.120 m (95 %)"
    )
    assert line("by axis", accuracy=accuracy).startswith("roll 0.10 deg, pitch 0.10 deg, yaw 0.10 deg, x 0.010 m, ")
    lower = line("next best", rival=Rival(-3.04, "edges", 1.0, 0.1))
    assert lower.endswith("cost lower by 3.0 edges")
    assert line("next best", rival=Rival(3.04, "edges", 1.0, 0.1)).endswith("cost higher by 3.0 edges")
    costs = line("cost", judged=Judged("directed-distance", "px", 4.0, 2.0, -0.25))
    assert "0.25 px less at the truth" in costs
