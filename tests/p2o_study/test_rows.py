"""Rows are kept as lines of JSON: they survive kills, edits and other processes, and merging is joining files."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.cli import main
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o.solving import Round
from p2o_study.row import PREDICTED, Case, Environment, Frame, Method, Row
from p2o_study.rows import MAX_LINE_BYTES, PlanRow, Rows, StoredStudy, latest, plan_of

from tests.fake_study import TRUTH, run_of, table2, write_store

POSE = se3.exp(np.array([0.1, 0.2, -0.3, 1e-12, 2, 3]))
ROW = run_of("ours", "a/1", 0, 0.3, 0.05)


def keyed(key: str, **values: Any) -> Row:
    return replace(ROW, key=key, **values)


def planned(*rows: Row, name: str = "table2") -> StoredStudy:
    return StoredStudy(name, {}, plan_of(rows))


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, poses as far as they are stored."""
    if isinstance(one, np.ndarray):
        return bool(np.allclose(one, other, rtol=0, atol=1e-9))
    if isinstance(one, Case | Frame | Method | Environment):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, tuple) and one and isinstance(one[0], Frame):
        return all(map(same, one, other))
    return bool(one == other)


def test_a_row_comes_back_with_every_field(tmp_path: Path) -> None:
    frames = (Frame("kitti", "a/1", "abc", TRUTH), Frame("kitti", "\udcfc 2", "def"))
    case = Case("kitti", frames, 7, POSE, "2deg 0.15m", 2, rig=True, data="kitti-raw", options={"camera": "image_02"})
    figures = {**dict.fromkeys(PREDICTED, 0.25), PREDICTED[1]: math.inf, "cells": 9, "rival_unit": "edges"}
    row = Row(
        "key",
        "ours | <b>",
        case,
        Method("0" * 64, {"matcher": "ogm"}, {"matcher": {"sides": "LR"}}),
        "single",
        status=Status.ROUNDS_SPENT,
        reason="because",
        exception="Traceback:\n  ü",
        estimate=POSE,
        trust=Trust.AMBIGUOUS,
        why="another pose fits as well",
        figures=figures,
        matches={"L": 3},
        rounds=(Round("refine", math.inf, {"L": 3}, 0.1 / 3, 2.5, 0.0, -0.0, accepted=True),),
        seconds={"extract": 0.1},
        environment=Environment({"processor": "p", "cores": 2}, {"numpy": "2"}, "commit", "me"),
        load=0.5,
        finished="2026-01-01T00:00:00+00:00",
    )
    Rows(tmp_path).put("table2", row)
    [read] = Rows(tmp_path).each("table2")
    assert type(read.figures["cells"]) is int
    for field in fields(Row):
        assert same(getattr(row, field.name), getattr(read, field.name)), field.name
    assert se3.check_rigid("the estimate", read.estimate, tolerance=1e-14) is not None


def test_anyone_reads_the_rows_as_lines_of_json(tmp_path: Path) -> None:
    Rows(tmp_path).put("table2", ROW)
    [line] = (tmp_path / "table2.jsonl").read_text().splitlines()
    plain = json.loads(line)
    assert (plain["row"], plain["status"], len(plain["estimate"])) == ("ours", "converged", 12)
    assert plain["predicted" if "predicted" in plain else "matches"]


def test_what_rows_have_in_common_is_stored_once(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    for row in table2(2, 2):
        rows.put("table2", row)
    names = {path.name: len(path.read_text().splitlines()) for path in tmp_path.iterdir()}
    assert names == {
        "table2.jsonl": 14,
        "_frames.jsonl": 2,
        "_cases.jsonl": 6,
        "_methods.jsonl": 1,
        "_environments.jsonl": 1,
    }


def test_rows_are_those_the_study_asks_for_now_in_its_order_and_under_its_labels(tmp_path: Path) -> None:
    rows, a, b = Rows(tmp_path), keyed("a"), keyed("b")
    rows.begin(planned(a, b))
    rows.put("table2", b)
    assert [row.key for row in rows.planned("table2")] == ["b"]
    assert rows.missing("table2") == [PlanRow("ours", "", "kitti", ("a",))]
    rows.put("table2", a)
    assert [row.key for row in rows.planned("table2")] == ["a", "b"]
    renamed = replace(b, row="renamed", section="new", case=replace(b.case, dataset="other"))
    rows.begin(planned(keyed("c"), renamed))
    [row] = rows.planned("table2")
    assert (row.key, row.row, row.section, row.dataset) == ("b", "renamed", "new", "other")
    assert [rows.finished(key) for key in "abc"] == [True, True, False], "rows that are not asked for are kept"
    rows.begin(planned(keyed("a", row="again"), name="second"))
    assert [row.row for row in rows.planned("second")] == ["again"], "a second study takes rows of the first"


def test_two_rows_of_one_recipe_share_a_calibration(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    rows.begin(planned(keyed("a", row="first"), keyed("a", row="second")))
    rows.put("table2", keyed("a"))
    assert [row.row for row in rows.planned("table2")] == ["first", "second"]


def test_a_row_that_raised_is_there_but_not_finished_until_it_succeeds(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    crashed = keyed("a", status=Status.STAGE_FAILED, estimate=None, exception="Traceback: no such luck")
    rows.begin(planned(crashed))
    rows.put("table2", crashed)
    [read] = rows.planned("table2")
    assert (read.crashed, read.solved, read.error, rows.finished("a"), rows.missing("table2")) == (
        *(True, False, None, False),
        [],
    )
    rows.put("table2", keyed("a"))
    assert rows.finished("a")
    assert [row.crashed for row in Rows(tmp_path).planned("table2")] == [False]


def test_the_last_measurement_of_a_calibration_counts_unless_it_raised(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    later = keyed("new", finished="2026-01-02T00:00:00+00:00")
    crash = keyed("c", status=Status.STAGE_FAILED, estimate=None, finished="2026-01-03T00:00:00+00:00")
    for row in (later, ROW, crash):
        rows.put("table2", row)
    assert [row.key for row in latest(rows.each("table2"))] == ["new"]


# ---- incomplete files


def test_an_incomplete_last_line_is_dropped_and_the_next_row_has_a_line_of_its_own(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    for key in "ab":
        rows.put("table2", keyed(key))
    path = rows.path("table2")
    whole = path.read_bytes()
    for end in (2, 20, len(whole) // 4):
        path.write_bytes(whole[:-end])
        later = Rows(tmp_path)
        assert [row.key for row in later.each("table2")] == ["a"]
        assert not later.refresh().keys() >= {"b"}
        later.put("table2", keyed("c"))
        again = Rows(tmp_path)
        assert [row.key for row in again.each("table2")] == ["a", "c"]


def test_a_row_whose_shared_part_is_lost_is_counted_and_measured_again(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    rows.put("table2", keyed("a"))
    cases = tmp_path / "_cases.jsonl"
    cases.write_bytes(cases.read_bytes()[:-10])
    later = Rows(tmp_path)
    assert list(later.each("table2")) == []
    later.put("table2", keyed("a"))
    assert [row.key for row in Rows(tmp_path).each("table2")] == ["a", "a"]


def test_merging_two_folders_is_joining_the_lines_of_their_files_in_any_order(tmp_path: Path) -> None:
    parts = [tmp_path / name for name in ("one", "two")]
    for folder, runs in zip(parts, (table2(3, 2), [*table2(2, 3), run_of("other", "x", 5, 1.0, 0.1)]), strict=True):
        write_store(folder, runs)
    merged: list[list[Any]] = []
    for name, order in (("ab", parts), ("ba", parts[::-1]), ("aab", [parts[0], *parts])):
        (folder := tmp_path / name).mkdir()
        for file in ("table2.jsonl", "_frames.jsonl", "_cases.jsonl", "_methods.jsonl", "_environments.jsonl"):
            (folder / file).write_bytes(b"".join((part / file).read_bytes() for part in order))
        merged.append(sorted(str(row.identity) for row in latest(Rows(folder).each("table2"))))
    assert merged[0] == merged[1] == merged[2]
    assert len(merged[0]) == len({str(row.identity) for row in (*table2(3, 2), *table2(2, 3))}) + 1


def _fill(folder: Path, first: int) -> None:
    rows = Rows(folder)
    for number in range(first, first + 60):
        rows.put("table2", keyed(str(number), case=replace(ROW.case, seed=number)))


def test_several_processes_write_to_one_new_folder_at_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_fill, args=(tmp_path, first)) for first in (0, 40, 80)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    assert [writer.exitcode for writer in writers] == [0, 0, 0]
    rows = Rows(tmp_path)
    assert {row.seed for row in rows.each("table2")} == set(range(140))
    assert len(rows.refresh()) == 140


def test_rows_that_another_process_adds_are_noticed(tmp_path: Path) -> None:
    rows, other = Rows(tmp_path), Rows(tmp_path)
    rows.put("table2", keyed("a"))
    assert rows.refresh().keys() == {"a"}
    other.put("table2", keyed("b"))
    other.put("second", keyed("c"))
    assert rows.refresh().keys() == {"a", "b", "c"}


# ---- pruning


def test_rewritten_rows_are_sorted_and_unused_parts_go(tmp_path: Path) -> None:
    rows = Rows(tmp_path)
    runs = table2(3, 2)
    for row in runs[::-1]:
        rows.put("table2", row)
    rows.put("second", runs[0])
    rows.rewrite("table2", [row for row in rows.each("table2") if row.seed])
    assert rows.remove_unused() > 0
    later = Rows(tmp_path)
    kept = list(later.each("table2"))
    assert [row.identity for row in kept] == sorted(row.identity for row in runs if row.seed)
    assert len(list(later.each("second"))) == 1
    rows.rewrite("table2", [])
    assert not rows.path("table2").exists()


# ---- foreign files


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def a_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def edited(old: str, new: str) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return edit


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("table2.jsonl", a_folder, "the file of rows is a folder"),
        ("table2.jsonl", a_device, "the file of rows is a device"),
        ("table2.json", a_device, "the plan of the study is a device"),
        ("table2.json", edited('"plan": [', '"plan": ["x", '), "the plan of the study is not valid"),
        ("table2.json", edited('"published"', '"publisht"'), "publisht"),
        ("table2.jsonl", edited("{", "7\n{"), "table2.jsonl:1: the line is no row"),
        ("table2.jsonl", edited('"key"', '"__class__":"os","key"'), "table2.jsonl:1: the line is no valid record"),
        ("table2.jsonl", edited('"converged"', '"verged"'), "status"),
        ("table2.jsonl", edited('"estimate":[', '"estimate":[9,'), "twelve numbers"),
        ("table2.jsonl", edited('"reason":"the', f'"reason":"{"x" * MAX_LINE_BYTES}the'), "the line is too long"),
        ("table2.jsonl", edited('"matches":{"L":', '"matches":{"L":0.'), "matches"),
        ("_cases.jsonl", edited('"seed":0', '"seed":-1'), "_cases.jsonl:1: the line is no valid record"),
    ],
)
def test_what_no_study_wrote_is_one_line_with_its_place(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    file: str,
    change: Callable[[Path], None],
    message: str,
) -> None:
    write_store(tmp_path, [run_of("ours", "f", 0, 1.0, 0.1, trust=Trust.TRUSTED)])
    change(tmp_path / file)
    assert main(["report", str(tmp_path)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("p2o: error: ")
    assert line.isprintable()
    assert message in line
    assert len(line) < 4000


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_a_pose_that_is_not_finite_is_refused(tmp_path: Path, number: str) -> None:
    Rows(tmp_path).put("table2", ROW)
    path = tmp_path / "table2.jsonl"
    head, _, rest = path.read_text().partition('"estimate":[')
    path.write_text(f'{head}"estimate":[{number},{rest.partition(",")[2]}')
    with pytest.raises(InputError, match=r"table2\.jsonl:1: the line is no valid record.*estimate"):
        list(Rows(tmp_path).each("table2"))


def test_a_mirrored_or_scaled_pose_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table2.jsonl"
    for factor in (-1.0, 1.1):
        Rows(tmp_path).put("table2", replace(ROW, estimate=np.diag([factor, factor, factor, 1.0])))
        with pytest.raises(InputError, match="a rigid transform"):
            list(Rows(tmp_path).each("table2"))
        path.unlink()


def test_a_folder_without_a_study_is_named_and_one_of_an_earlier_version_explained(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the folder has no rows of a study.*expected a folder that `p2o ablate"):
        Rows.existing(tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()
    (tmp_path / "study.sqlite").write_bytes(b"")
    with pytest.raises(InputError, match=r"was written by p2o 0\.2"):
        Rows.existing(tmp_path)


# ---- folders that cannot be written


def test_a_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in ("file", "file/below"):
        with pytest.raises(InputError, match="the results cannot be written; expected a writable folder"):
            Rows(tmp_path / folder).begin(planned(ROW))


@contextmanager
def _as_nobody() -> Iterator[None]:
    """Act as a user without permissions if this one has all."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs file permissions")
def test_a_folder_that_is_read_only_is_named() -> None:
    # The folders of pytest let nobody else in at all.
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o555)
        try:
            with _as_nobody(), pytest.raises(InputError, match="the results cannot be written"):
                Rows(folder).put("table2", ROW)
        finally:
            os.chmod(folder, 0o755)
