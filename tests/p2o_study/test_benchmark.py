"""Rows of the benchmark, suites, and what is measured again when."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o.errors import InputError
from p2o_study.benchmark.outcomes import Outcomes
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import MAX_LINE_BYTES, METHODS_FILE, FrameData, Row, latest, parsed_line, read_records
from p2o_study.benchmark.suite import FOLDER, find_suite, suite_names

from tests.p2o_study.benchmark_board import QUICK_ROW, STUDY, SUITE, Board
from tests.p2o_study.source_edits import Edit

ROOT = Path(__file__).parents[2]
OWN_ROW = '[[row]]\nlabel = "a"\nextractor = "p2ornet/rings"\n'


def row(**values: Any) -> Row:
    """Return a row of a fixed calibration with other values."""
    pose = np.eye(4).tolist()
    plain = {
        "suite": "tiny",
        "row": "quick",
        "dataset": "tiny",
        "frames": [{"name": "tiny/000", "digest": "0" * 64}],
        "joint": False,
        "protocol": "1deg 0.05m",
        "seed": 0,
        "start": pose,
        "method": {"words": {"calibrator": "quick"}},
        "digest": "1" * 64,
        "commit": "abc",
        "estimate": pose,
        "status": "converged",
        "verdict": "trusted",
        "predicted": {"rotation_deg": 0.1, "translation_m": "inf", "rotation_deg_95": 0.3, "translation_m_95": "inf"},
        "seconds": 0.5,
        "machine": {"processor": "p", "cores": 2, "load": 0.5},
        "measured_by": "tests",
        "finished": "2026-01-01T00:00:00+00:00",
    }
    return Row.model_validate(plain | values)


# ---- rows


def test_a_row_is_one_line_that_reads_back_bit_by_bit() -> None:
    turned = p2o.se3.exp(np.array([0.1, 0.2, -0.3, 1e-17, 2, 3]))
    before = row(estimate=turned.tolist(), row="ä | b")
    after = parsed_line(Row, before.line.encode(), "x:1")
    assert "\n" not in before.line
    assert after.line == before.line
    assert np.array_equal(np.asarray(after.estimate), turned)


def frame(truth: Any) -> FrameData:
    """Return the frame of `row`; its content is not that of any image."""
    plain = {"dataset": "tiny", "name": "tiny/000", "image": "0" * 64, "sweep": "1" * 64, "calibration": "2" * 64}
    return FrameData.model_validate(plain | {"truth": truth.tolist()})


def outcomes(folder: Path, rows: list[Row], truth: Any) -> Outcomes:
    """Return the arrays of rows that are written to a folder of results."""
    known = frame(truth)
    named = [{"name": known.name, "digest": known.digest}]
    Results(folder).add(
        "tiny", [Row.model_validate(r.model_dump(mode="json") | {"frames": named}) for r in rows], [known]
    )
    return Outcomes.read(Results(folder), "tiny", Results(folder).frames)


def test_errors_are_those_of_the_pose_and_never_of_the_file(tmp_path: Path) -> None:
    truth = p2o.se3.make(p2o.se3.exp(np.array([0, 0, np.radians(2), 0, 0, 0]))[:3, :3], [0.3, 0, 0])
    refused = row(row="refused", estimate=None, status="no-edges", verdict="refused", start=truth.tolist())
    raised = row(row="raised", estimate=None, status="stage-failed", verdict=None)
    runs = outcomes(tmp_path, [row(), refused, raised], truth).runs
    assert runs["rotation_deg"] == pytest.approx([2.0, np.nan, 0.0], abs=1e-6, nan_ok=True)
    assert runs["translation_m"] == pytest.approx([0.3, np.nan, 0.0], nan_ok=True)


def test_arrays_hold_the_rows_in_the_order_of_the_file_whatever_the_order_of_the_lines(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    days = ("2026-01-02T00:00:00+00:00", "2026-01-01T00:00:00+00:00")
    truth, rows = p2o.se3.exp(np.array([0.1, 0, 0, 0, 0, 0])), []
    for label, seed, finished, commit in itertools.product(("b", "a"), (10, 9), days, ("x", "y")):
        estimate = p2o.se3.exp(random.normal(size=6))
        rows.append(row(row=label, seed=seed, finished=finished, commit=commit, estimate=estimate.tolist()))
    its = outcomes(tmp_path, rows, truth)
    path = its.path
    path.write_text("".join(path.read_text().splitlines(keepends=True)[::-1] * 2))
    its = Outcomes.read(Results(tmp_path), "tiny", Results(tmp_path).frames)
    last = latest(Results(tmp_path).rows("tiny"))
    runs = its.runs[its.latest]
    errors = [Results(tmp_path).frames.error_of(known) for known in last]
    assert runs["rotation_deg"] == pytest.approx([error.rotation_deg for error in errors if error is not None])
    assert runs["translation_m"] == pytest.approx([error.translation_m for error in errors if error is not None])
    assert [known.line for known in map(its.row, np.flatnonzero(its.latest))] == [known.line for known in last]
    assert its.measured(last[0].identity)[0].line == last[0].line
    assert its.measured(("tiny", "tiny", "c", *last[0].identity[3:])) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"seed":0', '"seed":0,"rotation_deg":0.01', "rows:2: the line states an error: rotation_deg"),
        ('"seed":0', '"seed":0,"__class__":"os"', "rows:2: unknown key '__class__'"),
        ('"seed":0', '"seed":-1', "rows:2: seed is out of bounds"),
        ('"version":1', '"version":2', "rows:2: version is not valid; expected 1"),
        ('"estimate":[[1.0', '"estimate":[[1.1', "rows:2: estimate is not valid; expected a rigid transform"),
        ('"estimate":[[1.0', '"estimate":[[NaN', "rows:2: "),
        ('"estimate":[[1.0', '"estimate":[["1.0"', "rows:2: estimate"),
        ('"start":[[1.0', '"start":[[-1.0', "rows:2: start is not valid; expected a rigid transform"),
        ('"seed":0', '"seed":"\\ud800"', "rows:2: "),
        ('"options":{}', '"options":{"a":' + "[" * 80 + "]" * 80 + "}", "rows:2: the line is nested too deeply"),
        ('"status":"converged"', '"status":"no-edges"', "an estimate if, and only if"),
        ('"digest":"1', '"digest":"x', "rows:2: digest is not valid"),
        ("{", "[", "rows:2: the line is not JSON"),
        ('"reason":""', f'"reason":"{"x" * MAX_LINE_BYTES}"', "rows:2: the line is too long"),
    ],
)
def test_an_invalid_line_is_refused_in_one_line_with_its_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "tiny.jsonl"
    assert old in row().line
    file.write_text(f"{row(row='first').line}\n{row().line.replace(old, new, 1)}\n")
    for read in (lambda: read_records(Row, file), lambda: Outcomes.read(Results(tmp_path), "tiny")):
        with pytest.raises(InputError) as problem:
            read()
        assert message.replace("rows:", "tiny.jsonl:") in str(problem.value)
        assert len(str(problem.value)) < 4000


def test_files_merge_to_the_same_bytes_in_any_order(tmp_path: Path) -> None:
    another = row(seed=0, row="another", method={"external": True})
    parts = [[row(seed=2), row(seed=0)], [row(seed=1), row(seed=0)], [another]]
    contents = set()
    for number, order in enumerate(itertools.permutations(parts)):
        results = Results(tmp_path / str(number))
        added = sum(results.add("tiny", part, []) for part in order)
        assert added == 4
        contents.add((results.path("tiny").read_bytes(), (results.folder / METHODS_FILE).read_bytes()))
    assert len(contents) == 1


# ---- methods


OTHER = {"external": True, "source": "a paper"}
"""The method of some rows."""


def test_a_file_of_rows_names_methods_by_their_digest_and_each_is_stored_once(tmp_path: Path) -> None:
    results = Results(tmp_path)
    rows = [row(seed=seed, row=label, **its) for seed in (0, 1) for label, its in (("a", {}), ("b", {"method": OTHER}))]
    results.add("tiny", rows, [])
    results.add("other", [row(suite="other")], [])
    assert results.suites == ["other", "tiny"]
    listed = [json.loads(line)["method"] for line in (tmp_path / METHODS_FILE).read_text().splitlines()]
    assert sorted(listed, key=str) == sorted((rows[n].method.model_dump() for n in (0, 1)), key=str)
    for known, text in zip(results.rows("tiny"), results.path("tiny").read_text().splitlines(), strict=True):
        plain = json.loads(known.line)
        assert json.loads(text) == plain | {"method": known.method.digest}
        assert plain["method"] in listed
    after = results.rows("tiny")
    assert {known.line for known in after} == {known.line for known in rows}
    assert len({id(known.method) for known in after}) == 2


def test_a_row_that_contains_its_method_equals_one_that_names_it(tmp_path: Path) -> None:
    results, named, old = Results(tmp_path), row(), row(seed=1, method=OTHER)
    results.add("tiny", [named], [])
    path = results.path("tiny")
    path.write_text(f"{old.line}\n{path.read_text()}{named.line}\n")
    assert [known.line for known in results.rows("tiny")] == [named.line, old.line]
    its = Outcomes.read(results, "tiny")
    assert [its.row(number).line for number in np.flatnonzero(its.latest)] == [named.line, old.line]
    assert results.add("tiny", [old, named], []) == 0
    assert results.add("tiny", [row(seed=2)], []) == 1
    assert old.line not in path.read_text()
    assert [known.line for known in results.rows("tiny")] == [named.line, old.line, row(seed=2).line]


def test_joined_files_of_two_machines_contain_the_rows_of_both(tmp_path: Path) -> None:
    here, there, both = (Results(tmp_path / name) for name in ("here", "there", "both"))
    here.add("tiny", [row(), row(seed=1)], [])
    there.add("tiny", [row(), row(seed=1, method=OTHER)], [])
    both.folder.mkdir()
    for name in ("tiny.jsonl", METHODS_FILE):
        (both.folder / name).write_text("".join((part.folder / name).read_text() for part in (there, here)))
    expected = {known.line for part in (here, there) for known in part.rows("tiny")}
    assert len(both.rows("tiny")) == len(expected) == 3
    assert {known.line for known in both.rows("tiny")} == expected


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("methods.jsonl", '"quick"', '"slow"', "tiny.jsonl:1: the row names a method that is not listed; expected a "),
        ("tiny.jsonl", '"method":"', '"method":"0', "a line of methods.jsonl with this digest; got 0"),
        ("tiny.jsonl", '"method":"', '"method":7,"x":"', "tiny.jsonl:1: method is not valid; expected a valid dict"),
        ("methods.jsonl", '"quick"', "7", "methods.jsonl:1: method.words.calibrator is not valid; expected a valid st"),
        ("methods.jsonl", '"external"', '"outside"', "methods.jsonl:1: unknown key 'outside'"),
        ("methods.jsonl", "{", "[", "methods.jsonl:1: the line is not JSON"),
        ("methods.jsonl", '"options":{}', '"options":{"a":' + "[" * 80 + "]" * 80 + "}", "is nested too deeply"),
    ],
)
def test_a_method_that_is_not_listed_or_not_valid_is_refused_in_one_line_with_its_place(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    results = Results(tmp_path)
    results.add("tiny", [row()], [])
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    for read in (results.rows, lambda suite: Outcomes.read(results, suite)):
        with pytest.raises(InputError) as problem:
            read("tiny")
        assert message in str(problem.value)
        assert "\n" not in str(problem.value)


def test_the_last_measured_row_of_a_calibration_counts() -> None:
    rows = [row(finished=f"2026-01-0{day}T00:00:00+00:00", commit=str(day)) for day in (2, 3, 1)]
    assert [known.commit for known in latest([*rows, row(seed=1)])] == ["3", "abc"]


def test_the_digest_of_a_frame_covers_content_and_truth() -> None:
    plain = {"dataset": "d", "name": "n", "image": "0" * 64, "sweep": "1" * 64, "calibration": "2" * 64}
    base = FrameData.model_validate(plain | {"truth": np.eye(4).tolist()})
    moved = p2o.se3.make(np.eye(3), [0.01, 0, 0]).tolist()
    others = [{"image": "3" * 64}, {"sweep": "3" * 64}, {"calibration": "3" * 64}, {"truth": moved}, {"truth": None}]
    digests = {FrameData.model_validate(base.model_dump(mode="json") | other).digest for other in others}
    assert len(digests | {base.digest}) == 6


# ---- suites


def test_every_suite_of_the_repository_is_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    registry = p2o.Registry.load(environ={})
    assert {"smoke", "single-frames", "joint-frames", "initial-error", "rigs"} <= set(suite_names())
    for name in suite_names():
        file = find_suite(name, registry)
        assert file.name == name
        for study_row in file.rows:
            study_row.resolve(registry, study_row.seeds[0])
        assert file.suite.question
    frames = {study_row.joint for study_row in find_suite("joint-frames", registry).rows}
    assert frames == {0, 2, 4, 10, 24}
    assert FOLDER.is_dir()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SUITE + "seeds = 4\n", "the same seeds for all rows, at least 5"),
        (SUITE + f"{QUICK_ROW}seeds = 6\n{QUICK_ROW.replace('quick', 'other', 1)}", "seeds of row 'other'"),
        (SUITE + f'{OWN_ROW}init = "search"\n', "lacks rows: synthetic weights, without prior"),
        (SUITE + OWN_ROW, "lacks rows: synthetic weights;"),
        (SUITE + "sedes = 5\n", "unknown key 'sedes'"),
        (SUITE.replace("study.toml", "nothing.toml"), "the study file is missing"),
    ],
)  # fmt: skip
def test_a_suite_that_compares_unfairly_or_is_wrong_is_refused(
    board: Board, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    board.write(suite=text)
    assert board.command("run") == 2
    assert message in capsys.readouterr().err


def test_rows_of_a_suite_have_the_same_initial_guesses(board: Board) -> None:
    by_label: dict[str, dict[tuple[str, int], bytes]] = {}
    for known in board.measured():
        starts = by_label.setdefault(known.row, {})
        starts[known.frames[0].name, known.seed] = np.asarray(known.start).tobytes()
    assert set(by_label) == {"quick", "nearest"}
    assert by_label["quick"] == by_label["nearest"]
    assert len(set(by_label["quick"].values())) == 15


# ---- run and status


def test_a_suite_is_measured_once_and_its_rows_state_how(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    assert board.outdated(capsys) == [("quick", "missing")] * 15 + [("nearest", "missing")] * 15
    rows = board.measured("--by", "A. Name")
    assert len(rows) == 30
    assert board.calls()["quick"] == 15
    first = rows[-1]
    assert (first.measured_by, first.protocol, first.row) == ("A. Name", "1deg 0.05m", "quick")
    assert first.method.words["calibrator"] == "quick"
    assert first.method.options["calibrator"]["gain"] == 0.5
    assert first.machine.cores > 0
    assert board.results.frames.truth_of(first) is not None
    assert board.outdated(capsys) == []
    assert board.measured() == []
    assert board.calls()["quick"] == 0


def test_only_what_is_missing_is_computed_and_the_rest_kept(board: Board) -> None:
    rows = board.measured()
    kept = [known for known in rows if not (known.row == "quick" and known.seed in (1, 3))]
    board.results.path("tiny").write_text("".join(f"{known.line}\n" for known in kept))
    for file in (board.root / "store").iterdir():
        file.unlink()
    board.calls()
    again = board.measured()
    assert {(known.row, known.seed) for known in again} == {("quick", 1), ("quick", 3)}
    assert board.calls()["quick"] == 6


def test_a_calibration_that_another_suite_has_measured_is_not_computed_again(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    known = {(row.row, row.frames[0].name, row.seed): row for row in board.measured()}
    first = board.root / "results" / "tiny.jsonl"
    first.write_text(first.read_text().replace('"suite":"tiny"', '"suite":"earlier"'))
    first.rename(first.with_name("earlier.jsonl"))
    board.write(study=STUDY.replace('label = "quick"', 'label = "renamed"'))
    board.calls()
    again = board.measured()
    assert board.calls()["quick"] == 0
    assert "30 rows added (30 measured for other suites)" in capsys.readouterr().out
    for row in again:
        before = known[row.row.replace("renamed", "quick"), row.frames[0].name, row.seed]
        assert np.array_equal(np.asarray(row.estimate), np.asarray(before.estimate))
        assert (row.finished, row.seconds) == (before.finished, before.seconds)
    board.write(study=STUDY.replace('label = "quick"', 'label = "alone"'), suite=SUITE + "share = false\n")
    assert {row.row for row in board.measured()} == {"alone"}


def test_a_run_that_measures_nothing_leaves_no_empty_file(board: Board) -> None:
    board.write(study=STUDY.replace('label = "quick"\n', 'label = "quick"\noptions.calibrator.interrupt_after = 1\n'))
    assert board.command("run", "--section", "") == 130
    assert not board.results.path("tiny").exists()


def test_one_section_is_measured_alone(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.write(study=STUDY.replace("calibrator", 'section = "whole methods"\ncalibrator', 1))
    assert {row.row for row in board.measured("--section", "whole methods")} == {"quick"}
    assert {row.row for row in board.measured()} == {"nearest"}
    assert board.command("run", "--section", "hole methods") == 2
    assert "unknown section 'hole methods'" in capsys.readouterr().err


def test_an_interrupted_run_continues(board: Board) -> None:
    label = 'label = "quick"\n'
    board.write(study=STUDY.replace(label, f"{label}options.calibrator.interrupt_after = 4\n"))
    assert board.command("run") == 130
    assert len([known for known in board.results.rows("tiny") if known.row == "quick"]) == 3
    assert len(board.measured()) == 27


def test_a_changed_constant_of_one_method_makes_exactly_its_rows_stale(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    edit("p2o_baselines/edges/nearest.py", "-weight, *place.T", "-2 * weight, *place.T")
    assert board.outdated(capsys) == [("nearest", "method changed")] * 15
    assert {known.row for known in board.measured()} == {"nearest"}
    assert len(board.results.rows("tiny")) == 45


def test_changed_data_make_the_rows_of_these_frames_stale(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.measured()
    board.write(study=STUDY.replace("frames = 3 }", "frames = 3, salt = 1 }"))
    assert board.outdated(capsys) == [("quick", "data changed")] * 15 + [("nearest", "data changed")] * 15


def test_a_calibration_that_raises_is_one_row_and_is_tried_again(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    failing = STUDY.replace('label = "quick"\n', 'label = "quick"\noptions.calibrator.fail_on = "tiny/001"\n')
    board.write(study=failing)
    for _ in range(2):
        assert board.command("run") == 1
        crashed = [known for known in board.results.rows("tiny") if known.crashed]
        assert len(crashed) == 5
        assert "raised ValueError" in crashed[0].reason
    assert board.outdated(capsys) == [("quick", "crashed")] * 5
