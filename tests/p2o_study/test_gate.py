"""The gate closes on what is worse, missing or crashed, says which rows and frames moved, and is written on request."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from p2o import InputError
from p2o.cli import main
from p2o.results.verdict import Trust
from p2o_study.gate import judge, make_reference, read_reference, write_reference
from p2o_study.row import Row
from p2o_study.rows import PlanRow
from p2o_study.study import Study, parse_study
from p2o_study.summary import summarised
from p2o_study.tables import terminal_text

from tests.fake_study import run_of

PLUGIN = Path(__file__).parents[1] / "study_plugin.py"
TEXT = """name = "s"
title = "S"
[[dataset]]
name = "tiny"
data = "tiny:"
[[row]]
label = "a"
calibrator = "quick"
[[row]]
label = "b"
section = "more"
calibrator = "quick"
"""
STUDY = parse_study(TEXT)


def run(label: str, frame: int, rotation_deg: float = 0.1, translation_m: float = 0.02, **values: Any) -> Row:
    values = {"trust": None, "dataset": "tiny", "figures": {}, "section": {"b": "more"}.get(label, ""), **values}
    return run_of(label, f"f/{frame}", 0, rotation_deg, translation_m, **values)


def rows(**changes: Any) -> list[Row]:
    """Return two calibrations of each row; `changes` are of the first."""
    return [run("a", 0, **changes), run("a", 1, 0.2), run("b", 0), run("b", 1, 0.2)]


MISSING = PlanRow("a", "", "tiny", ("a0",))
REFERENCE = make_reference(STUDY, rows())


def test_what_is_unchanged_or_a_little_worse_passes() -> None:
    same = judge(STUDY, rows(), [], REFERENCE)
    assert same.open
    assert str(same) == "gate: open"
    # The mean of 0.1 and 0.2 deg may grow by 0.05: the first by 0.1.
    assert judge(STUDY, rows(rotation_deg=0.199), [], REFERENCE).open
    closed = judge(STUDY, rows(rotation_deg=0.201), [], REFERENCE)
    assert closed.failures == ("a: mean rotation_deg 0.2005, was 0.1500 and may be 0.2000",)


def test_better_passes_and_is_shown() -> None:
    ruling = judge(STUDY, rows(rotation_deg=0.0), [], REFERENCE)
    assert ruling.open
    assert ruling.moved == ("a: mean rotation_deg 0.1500 -> 0.1000", "  a, f/0, seed 0: rotation_deg 0.1000 -> 0.0000")


def test_a_row_that_crashed_is_missing_or_new_closes_it() -> None:
    crashed = rows(status="stage-failed", reason="no such luck", exception="Traceback")
    assert "a: 1 of 2 crashed, such as: no such luck" in judge(STUDY, crashed, [], REFERENCE).failures
    absent = judge(STUDY, rows()[1:], [MISSING], REFERENCE).failures
    assert "a: 1 calibrations are missing" in absent
    assert "a: 1 calibrations of the reference are missing, such as f/0, seed 0" in absent
    assert judge(STUDY, rows()[:2], [], REFERENCE).failures == ("b: in the reference, but not in the study",)
    renamed = [replace(row, row="c") if row.row == "b" else row for row in rows()]
    assert "c: not in the reference (write it with --update)" in judge(STUDY, renamed, [], REFERENCE).failures
    other = REFERENCE.model_copy(update={"study": "t"})
    assert "the reference is of study t, not of s" in judge(STUDY, rows(), [], other).failures
    assert not judge(STUDY, [], [MISSING], REFERENCE).open


def test_errors_that_are_no_numbers_close_it() -> None:
    unknown = [run(row.row, int(row.frames[0][-1]), truth=None) for row in rows()]
    assert any("mean rotation_deg nan" in line for line in judge(STUDY, unknown, [], REFERENCE).failures)


def test_more_refused_calibrations_than_may_be_close_it() -> None:
    refused = rows(status="too-few-matches", start=run("a", 0).estimate)
    ruling = judge(STUDY, refused, [], REFERENCE)
    assert ruling.failures == ("a: 1 of 2 calibrations were refused, was 0",)
    assert ruling.moved == ("  a, f/0, seed 0: was solved, now refused or crashed",)
    tolerance = REFERENCE.tolerance.model_copy(update={"failures": 1})
    assert judge(STUDY, refused, [], REFERENCE.model_copy(update={"tolerance": tolerance})).open
    assert judge(STUDY, rows(), [], make_reference(STUDY, refused)).open


def test_a_refusal_is_no_improvement_and_cannot_hide_a_loss() -> None:
    # The initial guess of the second calibration has an error of 0.05 deg, its estimate in the reference 0.2 deg.
    tolerance = REFERENCE.tolerance.model_copy(update={"failures": 1})
    reference = REFERENCE.model_copy(update={"tolerance": tolerance})
    first, _, *others = rows()
    refused = run("a", 1, status="no-improvement", start=run("a", 1, 0.05).estimate)
    ruling = judge(STUDY, [first, refused, *others], [], reference)
    assert ruling.open
    assert ruling.moved == ("  a, f/1, seed 0: was solved, now refused or crashed",)
    worse = judge(STUDY, [run("a", 0, 0.25), refused, *others], [], reference)
    assert worse.failures == ("a: mean rotation_deg 0.2250, was 0.1500 and may be 0.2000",)
    bad_guess = run("a", 1, status="no-improvement")
    assert not judge(STUDY, [first, bad_guess, *others], [], reference).open


def test_verdicts_that_changed_are_shown_and_do_not_close_it(tmp_path: Path) -> None:
    trusted = [replace(row, trust=Trust.TRUSTED) for row in rows()]
    reference = make_reference(STUDY, trusted)
    write_reference(tmp_path / "r.json", reference)
    assert read_reference(tmp_path / "r.json") == reference
    assert str(judge(STUDY, trusted, [], reference)) == "gate: open"
    changed = judge(STUDY, [replace(trusted[0], trust=Trust.DOUBTFUL), *trusted[1:]], [], reference)
    assert changed.open
    assert changed.moved == ("a: 2 trusted -> 1 trusted, 1 doubtful",)
    assert str(judge(STUDY, trusted, [], REFERENCE)) == "gate: open", (
        "a reference without verdicts says nothing of them"
    )


def test_a_reference_comes_back_and_an_update_keeps_the_tolerances_that_were_edited(tmp_path: Path) -> None:
    path = tmp_path / "reference.json"
    write_reference(path, REFERENCE)
    assert read_reference(path) == REFERENCE
    content = json.loads(path.read_text())
    content["tolerance"]["mean"]["rotation_deg"] = 1.5
    path.write_text(json.dumps(content))
    again = make_reference(STUDY, rows(rotation_deg=0.5), read_reference(path))
    assert again.tolerance.mean == {"rotation_deg": 1.5, "translation_m": 0.01}
    assert again.rows["a"].mean["rotation_deg"] == pytest.approx(0.35)
    lines = Path(path).read_text().count("\n"), len(rows())
    write_reference(path, again)
    assert path.read_text().count("\n") > lines[1], "a line for each calibration, so that a diff can be read"


def _with(path: str, value: object) -> bytes:
    """Return the reference with another value at a place such as "rows.a.count"."""
    content = REFERENCE.model_dump(mode="json")
    *outer, last = path.split(".")
    inside = content
    for key in outer:
        inside = inside[key]
    inside[last] = value
    return json.dumps(content).encode()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe{",
        b"[" * 100_000,
        b"[1]",
        b'{"study": "s"}',
        b"9" * 5000,
        _with("rows.a", None),
        _with("rows.a.count", "many"),
        _with("rows.a.mean", {"rotation_deg": float("nan")}),
        _with("rows.a.mean", {"rotation_deg": -0.1}),
        _with("rows.a.mean", {"\x1b[2J": 1}),
        _with("rows.a.trust", {"splendid": 1}),
        _with("rows.a.runs", {"f/0, seed 0": {"speed": 3}}),
        _with("tolerance.rows", {"c": {}}),
        _with("colour", "red"),
        _with("rows.a.count", "\ud800"),
    ],
)
def test_a_file_that_is_no_reference_is_one_line_that_names_it(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "reference.json"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_reference(path)
    assert str(caught.value).startswith(str(path))
    assert "write it with --update" in str(caught.value)
    assert len(str(caught.value)) < 1000
    with pytest.raises(InputError, match=r"the reference is missing.*--update"):
        read_reference(tmp_path / "gone.json")


def test_a_metric_that_is_no_longer_measured_closes_it() -> None:
    """What is not compared would pass for ever."""
    study = parse_study('metrics = ["translation_m"]\n' + TEXT)
    assert "a: mean rotation_deg is not measured, was 0.1500" in judge(study, rows(), [], REFERENCE).failures


def test_names_in_a_reference_do_not_reach_the_terminal_as_they_are() -> None:
    row = REFERENCE.rows["a"]
    ruling = judge(STUDY, rows(), [], REFERENCE.model_copy(update={"rows": {**REFERENCE.rows, "\x1b[2Jx\n": row}}))
    assert "FAIL  \\x1b[2Jx\\n: in the reference, but not in the study" in str(ruling)


def test_a_row_may_have_a_tolerance_of_its_own() -> None:
    own = REFERENCE.tolerance.model_copy(update={"rows": {"a": {"rotation_deg": 0.2}}})
    reference = REFERENCE.model_copy(update={"tolerance": own})
    assert judge(STUDY, rows(rotation_deg=0.499), [], reference).open
    assert not judge(STUDY, rows(rotation_deg=0.501), [], reference).open
    assert not judge(STUDY, rows(rotation_deg=0.499, translation_m=0.041), [], reference).open, "others hold on"
    both = [run(label, frame, 0.21) for label in "ab" for frame in (0, 1)]
    assert not judge(STUDY, both, [], reference).open, "of row b, too"
    again = make_reference(STUDY, rows(), reference)
    assert again.tolerance.rows == own.rows
    assert make_reference(STUDY, rows()[2:], reference).tolerance.rows == {}, "it goes with its row"


@pytest.mark.parametrize("tolerance", ['{"c": {"rotation_deg": 1.0}}', '{"a": {"yaw_deg": 1.0}}'])
def test_a_tolerance_of_what_is_not_there_is_told(tmp_path: Path, tolerance: str) -> None:
    path = tmp_path / "reference.json"
    write_reference(path, REFERENCE)
    path.write_text(path.read_text().replace('"rows": {}', f'"rows": {tolerance}'))
    with pytest.raises(InputError, match=r"tolerance of .*row '[ac]': .* is not"):
        read_reference(path)


def text_of(study: Study, made: Sequence[Row]) -> str:
    return terminal_text(summarised(study, made))


def test_a_study_of_errors_by_axis_prints_them_below() -> None:
    study = parse_study(TEXT.replace('title = "S"', 'title = "S"\nmetrics = ["yaw_deg", "x_m"]'))
    lines = [line.split() for line in text_of(study, rows()).splitlines()]
    below = lines[lines.index(["yaw", "mean", "[deg]", "x", "mean", "[cm]"]) + 1 :]
    assert [line for line in below if len(line) == 3] == [["a", "0.100", "0.7"], ["b", "0.100", "0.7"]]


def test_the_command_writes_the_reference_passes_it_and_fails_when_a_method_gets_worse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("P2O_CACHE", str(tmp_path))
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    file, reference = tmp_path / "s.toml", tmp_path / "reference.json"
    plain = TEXT.replace('title = "S"', 'title = "S"\nperturb = "1deg 0.05m"')
    file.write_text(plain)
    words = ["ablate", str(file), "--plugin", str(PLUGIN), "--out", str(tmp_path / "out"), "--quiet"]
    words += ["--jobs", "1", "--no-isolate"]
    assert main([*words, "--gate", str(reference)]) == 2
    assert "--update" in capsys.readouterr().err
    assert main([*words, "--gate", str(reference), "--update"]) == 0
    assert main([*words, "--gate", str(reference)]) == 0
    assert capsys.readouterr().out.endswith("gate: open\n")

    file.write_text(plain.replace('label = "a"\n', 'label = "a"\noptions.calibrator.gain = 0.9\n'))
    assert main([*words, "--gate", str(reference)]) == 1
    out = capsys.readouterr().out
    assert "FAIL  a: mean rotation_deg 0.9000, was 0.5000 and may be 0.5500" in out
    assert "a, tiny/001, seed 0: rotation_deg 0.5000 -> 0.9000" in out

    file.write_text(plain + 'options.calibrator.fail_on = "tiny/001"\n')
    assert main([*words, "--gate", str(reference)]) == 1
    assert "b: 1 of 3 crashed" in capsys.readouterr().out
    assert main([*words, "--gate", str(reference), "--update"]) == 2
    assert main([*words, "--gate", str(reference), "--frames", "0"]) == 1
    assert "2 calibrations of the reference are missing, such as tiny/001, seed 0" in capsys.readouterr().out


def test_the_reference_of_the_small_study_fits_it_and_leaves_no_row_out() -> None:
    path = Path(__file__).parents[2] / "baselines" / "p2o_baselines" / "studies" / "smoke-reference.json"
    study = parse_study(path.with_name("smoke.toml").read_text(encoding="utf-8"))
    reference = read_reference(path)
    assert reference.study == study.name
    assert set(reference.rows) == {row.label for row in study.rows()}
    assert all(row.failures == 0 for row in reference.rows.values())
    # The search is worth its row: without it the start of 4 deg is left as it is.
    assert reference.rows["ogm, search"].mean["rotation_deg"] < 0.2
