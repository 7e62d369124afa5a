"""What a study has found is kept whole, can be read by anyone, and survives edits, kills and other processes."""

from __future__ import annotations

import math
import multiprocessing
import os
import sqlite3
import tempfile
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o.results.verdict import Trust
from p2o.solving import Round
from p2o_study.columns import METRICS, figure_columns
from p2o_study.store import Planned, Store, StoredRow, StoredStudy

POSE = np.array([[0.1 + 0.2, -1.0, 0, 1 / 3], [0, 0, -1, 1e-300], [1, 0, 0, -0.0], [0, 0, 0, 1]])
STUDY = StoredStudy("table2", 'name = "table2"\n', {"kitti": "kitti-raw:x"}, ({"label": "RGGNet", "values": {}},))


FIGURES = {"odds_ratio": 7.1 / 3, "cells": 9, "rival_unit": "edges", "predicted_rotation_deg_95": float("inf")}


def row(key: str = "k", label: str = "ours", **values: object) -> StoredRow:
    return StoredRow(key, "table2", label, **{"frames": ("a/1",), "status": "converged", **values})


def planned(*keys: str, label: str = "ours") -> list[Planned]:
    return [Planned(key, "table2", label) for key in keys]


def test_a_row_comes_back_with_every_bit_of_every_field(tmp_path: Path) -> None:
    numbers = dict(zip(METRICS, np.random.default_rng(0).normal(size=8), strict=True))
    full = row(
        section="single",
        dataset="kitti",
        extractor="stereo/rings",
        matcher="ogm-lr",
        solver="lm",
        init="search",
        joint=3,
        seed=7,
        perturb="2deg 0.15m",
        reason="because",
        frames=("a/1", "ü 2"),
        start_rotation_deg=2.0,
        start_translation_m=0.15,
        estimate=POSE,
        start=POSE,
        trust=Trust.AMBIGUOUS,
        why="another pose fits as well",
        figures={**dict.fromkeys(figure_columns()), **FIGURES},
        rounds=(Round("refine", math.inf, {"L": 3}, 0.1 / 3, 2.5, 0.0, -0.0, accepted=True),),
        matches={"L": 3},
        seconds={"extract": 0.1},
        recipe={"options": {"matcher": {"sides": "LR"}}},
        versions={"numpy": "2"},
        inputs={"a/1": {"image": "00"}},
        finished="2026-01-01T00:00:00Z",
        **{name: float(value) for name, value in numbers.items()},
    )
    with Store.open(tmp_path) as store:
        store.begin(STUDY, [Planned(**{name: getattr(full, name) for name in Planned.__dataclass_fields__})])
        store.put(full)
    with Store.open(tmp_path, create=False) as store:
        [back] = store.rows("table2")
        [study] = store.studies()
    assert study == STUDY
    for name in StoredRow.__dataclass_fields__:
        mine, theirs = getattr(full, name), getattr(back, name)
        if isinstance(mine, np.ndarray):
            assert mine.tobytes() == theirs.tobytes()
        else:
            assert mine == theirs, name


def test_anyone_reads_the_rows_with_one_line_of_sql(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("k"))
        store.put(row(rotation_deg=0.25))
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        connection.row_factory = sqlite3.Row
        [found] = connection.execute("select * from rows").fetchall()
    connection.close()
    assert dict(found)["row"] == "ours"
    assert dict(found)["rotation_deg"] == 0.25
    assert dict(found)["frames"] == '["a/1"]'


def test_sql_can_ask_whom_to_trust(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a", "b", "c"))
        store.put(row("a", trust=Trust.TRUSTED, why="", figures={"odds_ratio": 9.5}))
        store.put(row("b", trust=Trust.DOUBTFUL, why="edges meet by chance", figures={"odds_ratio": 2.5}))
        store.put(row("c", trust=Trust.REFUSED, status="no-edges"))
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        query = "select key, why from rows where trust = 'doubtful' or odds_ratio < 3"
        assert connection.execute(query).fetchall() == [("b", "edges meet by chance")]
        assert connection.execute("select max(odds_ratio), typeof(trust) from rows").fetchone() == (9.5, "text")
    connection.close()


def _without_figures(path: Path) -> None:
    """Turn a store into one that was written before the last two figures were described."""
    with sqlite3.connect(path) as connection:
        connection.execute("drop view rows")
        for name in figure_columns()[-2:]:
            connection.execute(f"alter table runs drop column {name}")
        connection.execute("create view rows as select plan.row from plan join runs on runs.key = plan.key")
    connection.close()


def test_a_store_without_a_figure_gets_its_column_and_the_figure_is_unknown_in_its_rows(tmp_path: Path) -> None:
    last = figure_columns()[-1]
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a", "b"))
        store.put(row("a", rotation_deg=1 / 3, estimate=POSE, figures={"odds_ratio": 9.0, last: "corrected"}))
    _without_figures(tmp_path / "study.sqlite")
    for _ in range(2):
        with Store.open(tmp_path, create=False) as store:
            [back] = store.rows("table2")
            assert (back.rotation_deg, back.figures["odds_ratio"], back.figures[last]) == (1 / 3, 9.0, None)
            assert back.estimate.tobytes() == POSE.tobytes()
    with Store.open(tmp_path) as store:
        store.put(row("b", figures={last: "corrected"}))
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        assert connection.execute(f"select {last} from rows").fetchall() == [(None,), ("corrected",)]
    connection.close()


def test_a_store_with_a_figure_that_is_not_described_is_refused(tmp_path: Path) -> None:
    Store.open(tmp_path).close()
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        connection.execute("alter table runs add column glare REAL")
    connection.close()
    with pytest.raises(InputError, match=r"another version.*got columns glare.*move the file to another folder"):
        Store.open(tmp_path)


def _open(folder: Path) -> None:
    Store.open(folder).close()


def test_several_processes_add_the_columns_of_figures_to_one_store(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a"))
        store.put(row("a"))
    _without_figures(tmp_path / "study.sqlite")
    context = multiprocessing.get_context("spawn")
    openers = [context.Process(target=_open, args=(tmp_path,)) for _ in range(3)]
    for opener in openers:
        opener.start()
    for opener in openers:
        opener.join(60)
    assert [opener.exitcode for opener in openers] == [0, 0, 0]
    with Store.open(tmp_path) as store:
        assert [set(r.figures) for r in store.rows("table2")] == [set(figure_columns())]


def test_rows_are_those_the_study_asks_for_now_in_its_order(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a", "b"))
        store.put(row("b"))
        assert [r.key for r in store.rows("table2")] == ["b"]
        assert [p.key for p in store.missing("table2")] == ["a"]
        store.put(row("a"))
        assert [r.key for r in store.rows("table2")] == ["a", "b"]
        store.begin(STUDY, planned("c", "b", label="renamed"))
        assert [(r.key, r.row) for r in store.rows("table2")] == [("b", "renamed")]
        assert store.finished(["a", "b", "c"]) == {"a", "b"}, "what is no longer asked for is kept all the same"
        assert store.rows("another") == []


def test_two_rows_of_one_recipe_share_a_run(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, [*planned("a", label="first"), *planned("a", label="second")])
        store.put(row("a"))
        assert [r.row for r in store.rows("table2")] == ["first", "second"]


def test_a_row_that_raised_is_there_but_not_finished(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a"))
        store.put(row("a", status="stage-failed", exception="Traceback: no such luck"))
        [found] = store.rows("table2")
        assert found.crashed
        assert not found.solved
        assert store.finished(["a"]) == set()
        assert store.missing("table2") == []
        store.put(row("a"))
        assert store.finished(["a"]) == {"a"}


def test_a_row_that_cannot_be_written_leaves_the_store_as_it_was(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a", "b"))
        store.put(row("a"))
        with pytest.raises(InputError, match="JSON"):
            store.put(row("b", recipe={"option": object()}))
        with pytest.raises(sqlite3.Error):
            store.put(row("b", reason=object()))
        store.put(replace(row("b"), seconds={"extract": 1.0}))
        assert [r.key for r in store.rows("table2")] == ["a", "b"]


def _fill(folder: Path, first: int) -> None:
    for number in range(first, first + 60):
        with Store.open(folder) as store:
            store.put(row(str(number), seed=number))


def test_several_processes_write_to_one_new_store_at_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_fill, args=(tmp_path, first)) for first in (0, 40, 80)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    assert [writer.exitcode for writer in writers] == [0, 0, 0]
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned(*(str(n) for n in range(140))))
        assert [r.seed for r in store.rows("table2")] == list(range(140))
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        assert connection.execute("pragma integrity_check").fetchall() == [("ok",)]
    connection.close()


def test_a_folder_without_a_study_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the store is missing"):
        Store.open(tmp_path / "nothing", create=False)
    assert not (tmp_path / "nothing").exists()


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to be looked at" * 40, b"\0" * 5000])
def test_a_file_that_is_no_store_is_refused_and_left_alone(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "study.sqlite").write_bytes(content)
    with pytest.raises(InputError, match="not a store"):
        Store.open(tmp_path)
    assert (tmp_path / "study.sqlite").read_bytes() == content


@pytest.mark.parametrize("version", [1, 2, 3, 99])
def test_a_store_of_another_version_is_refused(version: int, tmp_path: Path) -> None:
    Store.open(tmp_path).close()
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        connection.execute(f"pragma user_version = {version}")
    connection.close()
    with pytest.raises(InputError, match="another version"):
        Store.open(tmp_path)


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Store.open(tmp_path / "file")


@contextmanager
def _as_nobody() -> Iterator[None]:
    """Act as a user without rights, where we have them all."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs rights of files")
@pytest.mark.parametrize("kept", [False, True], ids=["empty", "with a store"])
def test_a_folder_that_is_read_only_is_told(kept: bool) -> None:
    # The folders of pytest let nobody else in at all.
    with tempfile.TemporaryDirectory() as folder:
        if kept:
            Store.open(folder).close()
            os.chmod(Path(folder) / "study.sqlite", 0o444)
        os.chmod(folder, 0o555)
        try:
            with _as_nobody(), pytest.raises(InputError, match="cannot be written; expected a writable folder"):
                Store.open(folder)
        finally:
            os.chmod(folder, 0o755)


def test_another_kind_of_database_is_no_store(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "study.sqlite") as connection:
        connection.execute("create table runs (x)")
    connection.close()
    with pytest.raises(InputError, match="not a store"):
        Store.open(tmp_path)


def test_a_plan_says_what_is_still_to_be_computed_and_each_calibration_once(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.put(row("done"))
        store.put(row("crashed", status="stage-failed"))
        begun = store.begin(STUDY, planned("new", "done", "crashed", "new", "done", "other"))
        assert (list(begun.pending), begun.kept) == ([0, 2, 5], 1)


def test_a_plan_is_written_as_it_comes_and_never_held(tmp_path: Path) -> None:
    many = 60_000
    with Store.open(tmp_path) as store:
        tracemalloc.start()
        try:
            begun = store.begin(STUDY, (Planned(f"{number:064d}", "table2", "ours") for number in range(many)))
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert list(begun.pending) == list(range(many))
        assert peak < 50 * many, "a planned calibration alone takes 500 bytes"
        assert len(store.all_missing("table2")) == many


def test_others_write_while_a_plan_is_worked_out(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store, Store.open(tmp_path) as other:

        def slowly() -> Iterator[Planned]:
            yield from planned("a")
            other.put(row("b"))
            yield from planned("b", "c")

        assert list(store.begin(STUDY, slowly()).pending) == [0, 2]


def test_a_plan_that_cannot_be_worked_out_leaves_the_last_one(tmp_path: Path) -> None:
    def broken() -> Iterator[Planned]:
        yield from planned("x")
        raise KeyboardInterrupt

    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned("a", "b"))
        with pytest.raises(KeyboardInterrupt):
            store.begin(STUDY, broken())
        assert [p.key for p in store.missing("table2")] == ["a", "b"]
        store.begin(STUDY, planned("c"))
        assert [p.key for p in store.missing("table2")] == ["c"]


def test_rows_that_are_not_held_are_those_of_the_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("p2o_study.store._PAGE_ROWS", 3)
    keys = [f"k{number}" for number in range(8)]
    with Store.open(tmp_path) as store:
        store.begin(STUDY, planned(*keys, "missing"))
        for key in keys:
            store.put(row(key))
        rows, missing = store.all_rows("table2"), store.all_missing("table2")
    assert [r.key for r in rows] == keys
    assert len(rows) == 8
    assert [rows[0].key, rows[-1].key] == ["k0", "k7"]
    assert [r.key for r in rows[2:7:2]] == ["k2", "k4", "k6"]
    assert [r.key for r in rows[::-1]] == keys[::-1]
    assert [(p.key, len(missing)) for p in missing] == [("missing", 1)]
    with pytest.raises(IndexError):
        rows[8]
