"""Rows that a suite no longer asks for are removed, stale ones only if they were measured again, fresh ones never."""

from __future__ import annotations

import json
from typing import Any

import pytest
from p2o_study.benchmark.row import Row

from tests.p2o_study.benchmark_board import STUDY, Board
from tests.p2o_study.source_edits import Edit

NEAREST = ("p2o_baselines/edges/nearest.py", "-weight, *place.T", "-2 * weight, *place.T")
FEWER = STUDY.replace("frames = 3 }", "frames = 2 }")
RENAMED = ('"quick"\ncalibrator', '"renamed"\ncalibrator')
_MEASURED: dict[str, bytes] = {}


def measured(board: Board) -> list[Row]:
    """Return the rows of the suite, which are computed by the first test and written by the others."""
    if not _MEASURED:
        board.measured()
        _MEASURED.update({path.name: path.read_bytes() for path in board.results.folder.glob("*.jsonl")})
    board.results.folder.mkdir(exist_ok=True)
    for name, content in _MEASURED.items():
        (board.results.folder / name).write_bytes(content)
    return board.results.rows("tiny")


def changed(row: Row, /, **values: Any) -> Row:
    return Row.model_validate({**row.model_dump(mode="json"), **values})


def pruned(board: Board, capsys: pytest.CaptureFixture[str], *words: str) -> list[tuple[str, str]]:
    """Prune, and return label and reason of each row that is removed; the file loses as many rows."""
    before = len(board.results.rows("tiny"))
    capsys.readouterr()
    assert board.command("prune", "--json", *words) == 0
    removed = json.loads(capsys.readouterr().out)["rows"]
    assert len(board.results.rows("tiny")) == before - (0 if "--dry-run" in words else len(removed))
    return [(found["row"], found["why"]) for found in removed]


def test_rows_of_labels_and_frames_that_the_suite_no_longer_asks_for_are_removed(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(board)
    assert pruned(board, capsys) == []
    board.write(study=FEWER.replace(*RENAMED))
    expected = [("nearest", "not in the suite")] * 5 + [("quick", "not in the suite")] * 15
    assert pruned(board, capsys, "--dry-run") == expected
    assert pruned(board, capsys) == expected
    left = {(row.row, row.frames[0].name) for row in board.results.rows("tiny")}
    assert left == {("nearest", "tiny/000"), ("nearest", "tiny/001")}


def test_a_stale_row_is_removed_when_a_later_one_of_its_calibration_is_there(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(board)
    edit(*NEAREST)
    assert pruned(board, capsys) == []
    new = {row.line for row in board.measured()}
    assert pruned(board, capsys) == [("nearest", "stale, and measured again")] * 15
    assert new <= {row.line for row in board.results.rows("tiny")}
    assert board.outdated(capsys) == []


def test_a_fresh_row_is_kept_beside_a_later_one_and_a_stale_one_beside_a_crash(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    later = {"finished": "2099-01-01T00:00:00+00:00"}
    fresh = measured(board)
    board.results.add("tiny", [changed(row, **later, digest="0" * 64) for row in fresh], [])
    assert pruned(board, capsys) == []
    crash = {"status": "stage-failed", "estimate": None, "verdict": None, "predicted": None}
    stale = [changed(row, digest="0" * 64) for row in fresh]
    crashed = [changed(row, **later, **crash) for row in fresh]
    board.results.path("tiny").write_text("".join(f"{row.line}\n" for row in (*stale, *crashed)))
    assert pruned(board, capsys) == []


def test_without_data_the_frames_of_a_row_are_not_compared(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    measured(board)
    absent = FEWER.replace('data = "tiny:"', 'data = "tiny:"\noptional = true')
    board.write(study=absent)
    assert pruned(board, capsys) == []
    board.write(study=absent.replace(*RENAMED))
    assert pruned(board, capsys) == [("quick", "not in the suite")] * 15


def test_a_frame_that_cannot_be_read_leaves_its_rows_in_the_file(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(board)
    board.write(study=STUDY.replace("frames = 3 }", "frames = 3, bad = 1 }"))
    assert pruned(board, capsys) == []


def test_rows_of_external_methods_are_kept_as_long_as_their_frames_are_in_the_suite(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    own = [row for row in measured(board) if row.row == "quick"]
    board.results.add("tiny", [changed(row, row="mine", method={"external": True}) for row in own], [])
    assert pruned(board, capsys) == []
    board.write(study=FEWER)
    assert pruned(board, capsys).count(("mine", "not in the suite")) == 5


def test_methods_that_no_row_of_any_suite_names_are_removed(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row.row: row for row in measured(board)}
    board.results.add("other", [changed(rows["nearest"], suite="other")], [])
    board.write(study=STUDY.replace('"nearest"\nmatcher', '"other"\nmatcher').replace(*RENAMED))
    quick = rows["quick"].method.digest
    for words, left in ((["--dry-run"], 2), ([], 1)):
        capsys.readouterr()
        assert board.command("prune", "--json", *words) == 0
        assert json.loads(capsys.readouterr().out)["methods"] == [quick]
        assert len(board.results.methods) == left
    assert board.results.methods == {rows["nearest"].method.digest: rows["nearest"].method}
    assert [row.line for row in board.results.rows("other")] == [changed(rows["nearest"], suite="other").line]
    assert board.results.rows("tiny") == []
    board.results.path("other").unlink()
    assert board.command("prune") == 0
    assert "tiny: 0 rows and 1 unused methods removed" in capsys.readouterr().out
    assert board.results.methods == {}


def test_the_command_names_what_it_removes_and_refuses_an_unknown_suite(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(board)
    board.write(study=FEWER)
    assert board.command("prune", "--dry-run") == 0
    text = capsys.readouterr().out
    assert "  not in the suite: nearest, tiny/002, 1deg 0.05m, seed 0\n" in text
    assert "tiny: 10 rows would be removed" in text
    (board.root / "tiny.toml").unlink()
    assert board.command("prune") == 2
    assert capsys.readouterr().err.count("\n") == 1
