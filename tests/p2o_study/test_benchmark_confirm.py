"""A change of code that alters no outcome is confirmed by a sample of rows; one that alters an outcome is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import p2o
import p2o_baselines.edges.nearest
import pytest
from p2o_study.benchmark.confirm import by_version, difference_of, drawn
from p2o_study.benchmark.equivalences import EQUIVALENCES_FILE, Equivalence, Equivalences
from p2o_study.benchmark.row import Row

from tests.p2o_study.benchmark_board import STUDY, Board
from tests.p2o_study.source_edits import Edit
from tests.p2o_study.test_benchmark import row
from tests.p2o_study.test_benchmark_bundle import edited

NEAREST = ("p2o_baselines/edges/nearest.py", "place[order]", "place[order, :]")
"""An edit of one method, as hashes see it; what is computed stays the same."""
ALL = ("p2o/geometry/se3.py", "_FARTHEST_M = ", "_FARTHEST_M = 0.0 + ")
"""The same of every method."""
OLD, MIDDLE, NEW = (digit * 64 for digit in "abc")


def equivalence(old: str, new: str, confirmed: int = 30, **values: Any) -> Equivalence:
    plain = {
        "label": "quick",
        "digests": {old: new},
        "places": [["tiny", "tiny"]],
        "confirmed": confirmed,
        "of": 100,
        "seed": 0,
        "commit": "abc",
        "machine": {},
        "measured_by": "tests",
        "finished": "2026-01-01T00:00:00+00:00",
    }
    return Equivalence.model_validate(plain | values)


def altered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the method `nearest` shift the edges of images by a pixel from here on."""
    assemble = p2o_baselines.edges.nearest.assemble

    def shifted(*values: Any, **words: Any) -> Any:
        problem = assemble(*values, **words)
        return replace(problem, centre=problem.centre + 1.0)

    monkeypatch.setattr(p2o_baselines.edges.nearest, "assemble", shifted)


def confirm(board: Board, *words: str) -> int:
    return board.command("confirm", "--sample", "5", "--seed", "0", *words)


@pytest.fixture
def equivalences(board: Board) -> Path:
    return board.results.folder / EQUIVALENCES_FILE


# ---- the command


def test_a_change_that_alters_no_outcome_is_confirmed_and_its_rows_are_fresh(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str], equivalences: Path
) -> None:
    rows = board.measured()
    edit(*ALL)
    assert board.outdated(capsys) == [("quick", "method changed")] * 15 + [("nearest", "method changed")] * 15
    board.calls()
    assert confirm(board) == 0
    assert board.calls()["quick"] == 5
    text = capsys.readouterr().out
    bound = "none differs: at most 60 % of the rows differ (95 % bound, 3/n)"
    for label in ("quick", "nearest"):
        digest = min(known.digest for known in rows if known.row == label)
        assert f"{label} ({digest[:8]}): 5 of 15 rows computed again (seed 0), {bound}" in text
    assert "2 methods with 30 rows confirmed, 0 differ" in text
    assert board.outdated(capsys) == []
    assert board.command("status") == 0
    assert "tiny: 30 fresh (of them 30 confirmed by a sample of 5 rows)" in capsys.readouterr().out
    assert board.measured() == []
    first = Equivalence.model_validate_json(equivalences.read_text().splitlines()[0])
    assert set(first.digests) <= {known.digest for known in rows}
    assert (first.confirmed, first.of, first.seed, first.places) == (5, 15, 0, (("tiny", "tiny"),))
    assert first.commit == rows[0].commit
    assert confirm(board) == 0
    assert "0 methods with 0 rows confirmed" in capsys.readouterr().out


def test_a_change_that_alters_an_outcome_is_refused_and_the_row_is_named(
    board: Board, edit: Edit, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], equivalences: Path
) -> None:
    board.measured()
    edit(*ALL)
    altered(monkeypatch)
    assert confirm(board) == 1
    text = capsys.readouterr().out
    assert "1 of 15 rows computed again (seed 0), no equivalence; this row differs:\n  tiny, nearest, " in text
    assert "pose changed by" in text
    assert "1 methods with 15 rows confirmed, 1 differ" in text
    assert [Equivalence.model_validate_json(line).label for line in equivalences.read_text().splitlines()] == ["quick"]
    assert board.outdated(capsys) == [("nearest", "method changed")] * 15


def test_an_interrupted_command_keeps_the_methods_that_are_confirmed(
    board: Board, edit: Edit, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured()
    edit(*ALL)

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(p2o_baselines.edges.nearest, "pair", interrupted)
        assert confirm(board) == 130
    assert board.outdated(capsys) == [("nearest", "method changed")] * 15


def test_equivalences_form_chains(
    board: Board,
    edit: Edit,
    capsys: pytest.CaptureFixture[str],
    equivalences: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board.measured()
    edit(*NEAREST)
    assert confirm(board) == 0
    path = board.results.path("tiny")
    path.write_text("".join(f"{known.line}\n" for known in board.results.rows("tiny") if known.seed))
    monkeypatch.setattr("p2o_study.benchmark.measure.source_version", lambda: "a later commit")
    assert {known.seed for known in board.measured()} == {0}
    edit(NEAREST[0], NEAREST[1], "place[order][:, :]")
    assert board.outdated(capsys) == [("nearest", "method changed")] * 15
    assert confirm(board) == 0
    # Each version is compared with the last one directly.
    text = capsys.readouterr().out
    assert "): 5 of 12 rows computed again (seed 0), none differs" in text
    assert "): 3 of 3 rows computed again (seed 0), none differs\n" in text
    lines = [Equivalence.model_validate_json(text) for text in equivalences.read_text().splitlines()]
    by_size = {known.of: f"{known.line}\n" for known in lines}
    assert set(by_size) == {15, 12, 3}
    equivalences.write_text(by_size[15] + by_size[3])
    assert board.command("status") == 0
    assert "30 fresh (of them 15 confirmed by a sample of 3 rows)" in capsys.readouterr().out
    equivalences.write_text(by_size[3])
    assert board.outdated(capsys) == [("nearest", "method changed")] * 12


def test_rows_that_are_stale_for_another_reason_are_not_confirmed(
    board: Board, edit: Edit, capsys: pytest.CaptureFixture[str]
) -> None:
    board.measured("--section", "")
    edit(*ALL)
    board.write(study=STUDY.replace("frames = 3 }", "frames = 3, salt = 1 }"))
    assert confirm(board) == 0
    gain = STUDY.replace('label = "quick"\n', 'label = "quick"\noptions.calibrator.gain = 0.25\n')
    board.write(study=gain)
    assert confirm(board) == 0
    text = capsys.readouterr().out
    assert "0 methods with 0 rows confirmed" in text
    assert "1 methods with 15 rows confirmed" in text
    assert "quick (" not in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"seed":', '"sede":0,"seed":', "unknown key 'sede'"),
        ('"confirmed":30', '"confirmed":101', "at most `of` confirmed rows"),
        (f'"{OLD}":"{NEW}"', f'"{OLD}":"{OLD}"', "two different digests"),
        (f'"{OLD}"', '"x"', "digests"),
        ('"places":[["tiny","tiny"]]', '"places":[["tiny"]]', "places"),
        ("{", "[", "the line is not JSON"),
    ],
)
def test_an_edited_line_is_refused_in_one_line_with_its_place(
    board: Board, capsys: pytest.CaptureFixture[str], equivalences: Path, old: str, new: str, message: str
) -> None:
    line = equivalence(OLD, NEW).line
    assert old in line
    equivalences.parent.mkdir(exist_ok=True)
    equivalences.write_text(f"{line}\n{line.replace(old, new, 1)}\n")
    for word in ("status", "run", "confirm"):
        assert board.command(word) == 2
        [error] = capsys.readouterr().err.splitlines()
        assert message in error
        assert f"{EQUIVALENCES_FILE}:2" in error


# ---- bundles


@pytest.fixture
def confirmed(board: Board, edit: Edit) -> Path:
    """Return a bundle of rows of which a half is of an earlier version of its method."""
    board.measured()
    edit(*NEAREST)
    assert confirm(board) == 0
    path = board.root / "tiny.zip"
    assert board.command("bundle", "--out", str(path)) == 0
    return path


def test_a_bundle_contains_its_equivalences_and_their_rows_are_computed_again(
    board: Board, confirmed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Equivalences of this machine have no effect.
    (board.results.folder / EQUIVALENCES_FILE).unlink()
    capsys.readouterr()
    assert board.command("verify", str(confirmed), "--sample", "30") == 0
    text = capsys.readouterr().out
    assert "30 rows compared with the data here, 30 computed again" in text
    assert "15 of an earlier version of their method, declared equal by samples of at least 5 rows" in text
    altered(monkeypatch)
    assert board.command("verify", str(confirmed), "--sample", "30") == 1
    assert "computed again the pose is" in capsys.readouterr().out


def test_a_bundle_has_the_equivalences_that_its_rows_need_and_no_changed_ones(
    board: Board, confirmed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = confirmed.read_bytes()
    path = board.results.folder / EQUIVALENCES_FILE
    path.write_text(path.read_text() + equivalence(OLD, NEW).line + "\n")
    assert board.command("bundle", "--out", str(confirmed)) == 0
    assert confirmed.read_bytes() == before

    def more(contents: dict[str, str]) -> None:
        contents[EQUIVALENCES_FILE] = contents[EQUIVALENCES_FILE].replace('"of":15', '"of":16')

    def none(contents: dict[str, str]) -> None:
        del contents[EQUIVALENCES_FILE]

    for edit in (more, none):
        edited(confirmed, edit)
        assert board.command("verify", str(confirmed)) == 1
        assert "equivalences.jsonl: the equivalences were changed after they were packed" in capsys.readouterr().out


# ---- parts


def test_a_chain_counts_with_its_smallest_sample_and_only_where_rows_were_sampled() -> None:
    links = [equivalence(OLD, MIDDLE, 30), equivalence(MIDDLE, NEW, 12), equivalence(MIDDLE, OLD, 40)]
    known = Equivalences(links)
    assert known.sample(OLD, OLD, "tiny", "tiny") == 0
    assert known.sample(OLD, MIDDLE, "tiny", "tiny") == 30
    assert known.sample(OLD, NEW, "tiny", "tiny") == 12
    assert known.sample(NEW, OLD, "tiny", "tiny") is None
    assert known.sample(OLD, NEW, "tiny", "other") is None
    assert known.sample(OLD, NEW, "other", "tiny") is None
    elsewhere = equivalence(MIDDLE, NEW, places=[["tiny", "other"]])
    assert Equivalences([links[0], elsewhere]).sample(OLD, NEW, "tiny", "tiny") is None


def test_digests_of_one_commit_are_one_version_and_others_have_a_sample_of_their_own() -> None:
    def stale(digest: str, commit: str, seed: int = 0, gain: float = 0.5) -> Any:
        method = {"options": {"calibrator": {"gain": gain, "seed": seed}}}
        return SimpleNamespace(row=row(digest=digest * 64, commit=commit, seed=seed, method=method))

    rows = [stale("a", "x"), stale("b", "x", 1), stale("a", "y"), stale("c", "z"), stale("d", "y", 1)]
    rows += [stale("a", "x", gain=0.25), stale("e", "w+changes"), stale("f", "w+changes", 1)]
    groups = {"".join(sorted(each.row.digest[0] for each in version)) for version in by_version(rows)}
    assert groups == {"aabd", "c", "a", "e", "f"}


def test_a_sample_is_spread_in_proportion_and_repeated_by_its_seed() -> None:
    sizes = {"a": 60, "b": 30, "c": 10}
    rows: Any = [SimpleNamespace(position=(name, i)) for name, size in sizes.items() for i in range(size)]

    def sample(seed: int, count: int = 20) -> list[tuple[str, int]]:
        return [stale.position for stale in drawn(rows, count, np.random.default_rng(seed))]

    for seed in range(20):
        assert Counter(name for name, _ in sample(seed)) == {"a": 12, "b": 6, "c": 2}
    assert sample(1) == sample(1) != sample(2)
    assert len({position for seed in range(200) for position in sample(seed)}) == 100
    assert sample(0, 100) == sample(0, 1000) == [stale.position for stale in rows]


def moved(translation_m: float, rotation_rad: float = 0.0) -> list[list[float]]:
    pose: list[list[float]] = p2o.se3.exp(np.array([0, 0, rotation_rad, translation_m, 0, 0])).tolist()
    return pose


BOUNDS = {"rotation_deg": 0.1, "translation_m": "inf", "rotation_deg_95": 0.3, "translation_m_95": "inf"}
REFUSED = {"estimate": None, "status": "no-edges", "verdict": "refused", "predicted": None}


@pytest.mark.parametrize(
    ("before", "after", "difference"),
    [
        ({}, {"seconds": 9.0, "reason": "other words", "digest": "2" * 64}, ""),
        (REFUSED, REFUSED, ""),
        ({}, {"estimate": moved(5e-7, 5e-7)}, ""),
        ({}, {"estimate": moved(2e-6)}, "pose changed by 0 rad and 2e-06 m"),
        ({}, {"estimate": moved(0.0, 2e-6)}, "pose changed by 2e-06 rad and 0 m"),
        ({}, {"verdict": "doubtful"}, "verdict doubtful instead of trusted"),
        ({}, {"status": "rounds-spent"}, "status rounds-spent instead of converged"),
        ({}, {"predicted": BOUNDS | {"rotation_deg": 0.1 * (1 + 5e-7)}}, ""),
        ({}, {"predicted": BOUNDS | {"rotation_deg": 0.1001}}, "predicted rotation_deg 0.1001 instead of 0.1"),
        ({}, {"predicted": BOUNDS | {"translation_m": 1.0}}, "predicted translation_m 1.0 instead of inf"),
        ({}, {"predicted": None}, "predicted rotation_deg None instead of 0.1"),
        ({}, REFUSED, "status no-edges instead of converged, verdict refused instead of trusted"),
        ({}, {"verdict": None, "machine": {"processor": "q"}}, "the row is of another processor (p)"),
    ],
)
def test_outcomes_are_the_same_within_the_stated_tolerances(
    before: dict[str, Any], after: dict[str, Any], difference: str
) -> None:
    changes: Callable[..., Row] = row
    text = difference_of(changes(**before), changes(**after))
    assert difference in text
    assert bool(difference) == bool(text)
