"""Suites of the benchmark: which of their rows are measured, stale, removed and computed again."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o.results.verdict import Trust
from p2o_study.benchmark.suite import Suite, find_suite, suites
from p2o_study.row import Environment, frame_digest

from tests.p2o_study.benchmark_board import QUICK_ROW, STUDY, SUITE, Board
from tests.p2o_study.source_edits import Edit

ROOT = Path(__file__).parents[2]


# ---- suites


NEAREST = ("p2o_baselines/edges/nearest.py", "-weight, *place.T", "-2 * weight, *place.T")
FEWER = STUDY.replace("frames = 3 }", "frames = 2 }")
RENAMED = ('"quick"\ncalibrator', '"renamed"\ncalibrator')


def test_the_digest_of_a_frame_covers_content_and_truth() -> None:
    digests = {"image": "0", "sweep": "1", "calibration": "2"}
    moved = p2o.se3.make(np.eye(3), [0.01, 0, 0])
    others = [{**digests, name: "3"} for name in digests]
    known = {frame_digest(digests, np.eye(4)), frame_digest(digests, moved), frame_digest(digests, None)}
    known |= {frame_digest(other, np.eye(4)) for other in others}
    assert len(known) == 6
    assert frame_digest(digests, np.eye(4)) == frame_digest(digests, np.eye(4) + 1e-12)


def assert_without_prior(suite: Suite) -> None:
    """Where our method uses the prior on the initial guess, the suite also has it without, on the same cases."""
    priors: dict[object, set[bool]] = {}
    for row in suite.all_rows():
        recipe = row.recipe(row.seeds[0])
        if recipe.calibrator is None and recipe.extractor.startswith("p2ornet/") and recipe.matcher == "ogm":
            options = recipe.options
            without = options.get("init", {}).get("prior") == 0 and "start_sigma" not in options.get("pipeline", {})
            if without or recipe.init == "search":
                case = row.dataset.name, row.joint, recipe.perturb, recipe.accumulate
                priors.setdefault(case, set()).add(not without)
    assert {True} not in priors.values(), f"{suite.name} lacks a row without prior"


def test_every_suite_that_is_shipped_is_valid() -> None:
    registry = p2o.Registry.load(environ={})
    known = suites(registry)
    assert {"smoke", "single-frames", "joint-frames", "initial-error", "rigs"} <= known.keys()
    for name in known:
        file = find_suite(name, registry)
        assert file.name == name
        for study_row in file.all_rows():
            study_row.resolve(registry, study_row.seeds[0])
        assert file.question
        assert_without_prior(file)
    frames = {study_row.joint for study_row in find_suite("joint-frames", registry).all_rows()}
    assert frames == {0, 2, 4, 10, 24}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SUITE + f"{QUICK_ROW}seeds = 6\n{QUICK_ROW.replace('quick', 'other', 1)}", "seeds of row 'other'"),
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


# ---- run and status


def test_a_suite_is_measured_once_and_its_rows_state_how(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    assert board.outdated(capsys) == [("quick", "missing")] * 15 + [("nearest", "missing")] * 15
    rows = board.measured("--by", "A. Name")
    assert len(rows) == 30
    assert board.calls()["quick"] == 15
    first = rows[-1]
    assert (first.environment.measured_by, first.case.protocol, first.row) == ("A. Name", "1deg 0.05m", "nearest")
    first = rows[0]
    assert first.row == "quick"
    assert first.method.words["calibrator"] == "quick"
    assert first.method.options["calibrator"]["gain"] == 0.5
    assert first.environment.machine["cores"] > 0
    assert first.case.truth is not None
    assert (first.rounds, first.matches) == ((), {}), "rows of suites are brief"
    assert board.outdated(capsys) == []
    assert board.measured() == []
    assert board.calls()["quick"] == 0


def test_a_calibration_that_another_suite_has_measured_is_not_computed_again(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    known = {(row.row, row.frames[0], row.seed): row for row in board.measured()}
    board.results.path("tiny").rename(board.results.path("earlier"))
    board.write(study=STUDY.replace('label = "quick"', 'label = "renamed"'))
    board.calls()
    again = board.measured()
    assert board.calls()["quick"] == 0
    assert "30 rows added (30 measured for other suites)" in capsys.readouterr().out
    for row in again:
        before = known[row.row.replace("renamed", "quick"), row.frames[0], row.seed]
        assert np.allclose(row.estimate, before.estimate, rtol=0, atol=1e-9)
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
    assert len([known for known in board.rows() if known.row == "quick"]) == 3
    assert len(board.measured()) == 27


def test_a_changed_constant_of_one_method_makes_exactly_its_rows_stale(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    edit(*NEAREST)
    assert board.outdated(capsys) == [("nearest", "method changed")] * 15
    assert {known.row for known in board.measured()} == {"nearest"}
    assert len(board.rows()) == 45


def test_changed_data_make_the_rows_of_these_frames_stale(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.measured()
    board.write(study=STUDY.replace("frames = 3 }", "frames = 3, salt = 1 }"))
    assert board.outdated(capsys) == [("quick", "data changed")] * 15 + [("nearest", "data changed")] * 15


def test_a_calibration_that_raises_is_one_row_and_is_tried_again(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    failing = STUDY.replace('label = "quick"\n', 'label = "quick"\noptions.calibrator.fail_on = "tiny/001"\n')
    board.write(study=failing)
    for number in (1, 2):
        assert board.command("run") == 1
        crashed = [known for known in board.rows() if known.crashed]
        assert len(crashed) == 5 * number
        assert "raised ValueError" in crashed[0].reason
    assert board.outdated(capsys) == [("quick", "crashed")] * 5


def test_two_rows_of_a_suite_that_are_one_calibration_are_computed_once(board: Board) -> None:
    board.write(study=STUDY + QUICK_ROW.replace('"quick"', '"same"', 1))
    rows = board.measured()
    assert Counter(row.row for row in rows) == {"quick": 15, "nearest": 15, "same": 15}
    assert board.calls()["quick"] == 15
    assert board.measured() == []


# ---- pruning


def pruned(board: Board, capsys: pytest.CaptureFixture[str], *words: str) -> Counter[str]:
    """Prune, and return the number of removed rows by label; the file loses as many rows."""
    before = len(board.rows())
    capsys.readouterr()
    assert board.command("prune", "--json", *words) == 0
    removed = json.loads(capsys.readouterr().out)["rows"]
    assert len(board.rows()) == before - (0 if "--dry-run" in words else len(removed))
    return Counter(entry["row"] for entry in removed)


def test_rows_of_labels_and_frames_that_the_suite_no_longer_asks_for_are_removed(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    assert pruned(board, capsys) == {}
    board.write(study=FEWER.replace(*RENAMED))
    expected = {"nearest": 5, "quick": 15}
    assert pruned(board, capsys, "--dry-run") == expected
    assert board.command("prune", "--dry-run") == 0
    assert "tiny: 20 rows would be removed" in capsys.readouterr().out
    assert pruned(board, capsys) == expected
    assert {(row.row, row.frames[0]) for row in board.rows()} == {("nearest", "tiny/000"), ("nearest", "tiny/001")}
    methods = (board.results.folder / "_methods.jsonl").read_text().splitlines()
    assert len(methods) == 1, "what no row names is removed"


def test_a_stale_row_is_removed_when_a_later_one_of_its_calibration_is_there(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    edit(*NEAREST)
    assert pruned(board, capsys) == {}
    new = {row.key for row in board.measured()}
    assert pruned(board, capsys) == {"nearest": 15}
    assert new <= {row.key for row in board.rows()}
    assert board.outdated(capsys) == []


def test_a_fresh_row_is_kept_beside_a_later_stale_one_and_a_row_beside_a_crash(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    for row in board.measured():
        board.results.put("tiny", replace(row, key=f"other {row.key}", method=replace(row.method, revision="other")))
        board.results.put("tiny", replace(row, key=f"crash {row.key}", status=p2o.Status.STAGE_FAILED, estimate=None))
    assert sum(pruned(board, capsys).values()) == 60
    assert board.outdated(capsys) == []


@pytest.mark.parametrize(
    "study",
    [FEWER.replace('data = "tiny:"', 'data = "tiny:"\noptional = true'), STUDY.replace("= 3 }", "= 3, bad = 1 }")],
    ids=["no data", "a frame that cannot be read"],
)
def test_rows_whose_frames_are_not_at_hand_are_kept(
    board: Board, capsys: pytest.CaptureFixture[str], study: str
) -> None:
    board.measured()
    board.write(study=study)
    assert pruned(board, capsys) == {}


# ---- computing again


def rechecked(board: Board, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    capsys.readouterr()
    code = board.command("recheck", *words)
    return code, capsys.readouterr().out


def test_rows_that_are_computed_again_with_the_same_outcome_are_confirmed_with_a_bound(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    board.calls()
    code, text = rechecked(board, capsys, "--sample", "30", "--seed", "1")
    assert code == 0
    assert "tiny: 30 of 30 fresh rows computed again (seed 1), none differs: at most 10 % of the rows differ" in text
    assert board.calls()["quick"] == 15, "nothing is taken from the results"
    assert len(board.rows()) == 30, "nothing is added"


def with_first(board: Board, change: dict[str, object]) -> None:
    """Change the first row of the results."""
    first, *others = board.rows()
    board.results.rewrite("tiny", [replace(first, **change), *others])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trust": Trust.TRUSTED}, "verdict doubtful instead of trusted"),
        ({"estimate": p2o.se3.make(translation=[1e-4, 0, 0])}, "deg and"),
        ({"figures": {"predicted_rotation_deg": 0.5}}, "predicted_rotation_deg None instead of 0.5"),
        ({"status": p2o.Status.NO_EDGES, "estimate": None}, "status converged instead of no-edges"),
    ],
)
def test_a_row_that_was_changed_is_found_and_named(
    board: Board, capsys: pytest.CaptureFixture[str], change: dict[str, object], message: str
) -> None:
    board.write(study=STUDY.partition('[[row]]\nlabel = "nearest"')[0])
    board.measured()
    with_first(board, change)
    code, text = rechecked(board, capsys)
    assert code == 1
    assert "15 of 15 fresh rows computed again" in text
    assert "1 differ" in text
    assert message in text
    assert "quick, tiny tiny/00" in text


def test_rows_of_another_processor_may_differ_in_the_last_digits(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write(study=STUDY.partition('[[row]]\nlabel = "nearest"')[0])
    [first, *_] = board.measured()
    there = Environment({"processor": "another"})
    near = p2o.se3.make(translation=[1e-3, 0, 0]) @ first.estimate
    with_first(board, {"environment": there, "estimate": near})
    assert rechecked(board, capsys)[0] == 0
    with_first(board, {"environment": there, "estimate": p2o.se3.make(translation=[0.01, 0, 0]) @ first.estimate})
    code, text = rechecked(board, capsys)
    assert code == 1
    assert "the row is of another processor (another)" in text


def test_doubled_and_missing_calibrations_are_named(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.write(study=STUDY.partition('[[row]]\nlabel = "nearest"')[0])
    [first, *others] = board.measured()
    board.results.rewrite("tiny", others[:-1])
    for x_m in (0.0, 0.1):
        moved = p2o.se3.make(translation=[x_m, 0, 0]) @ others[0].estimate
        board.results.put("tiny", replace(others[0], estimate=moved))
    code, text = rechecked(board, capsys, "--sample", "0")
    assert code == 1
    assert "measured twice: pose 0 deg and 0.1 m apart" in text
    assert f"not checked: 2 missing, such as , quick, tiny {first.place}" in text
