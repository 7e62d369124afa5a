"""The store of a fleet: nothing finished is lost, nothing is counted twice, whoever writes and whenever it ends."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from p2o.errors import InputError
from p2o_fleet.checks import Checks
from p2o_fleet.evidence import COLUMNS, Verdict
from p2o_fleet.store import Store

from tests.p2o_fleet.fleet_data import BEGIN, POSE, SIGMA, drive, evidence, filled


def only(store: Store) -> Checks:
    [checks] = store.checks()
    return checks


def test_evidence_is_read_as_it_was_stored(tmp_path: Path) -> None:
    store = Store(tmp_path)
    error = np.arange(6) / 7
    covariance = np.diag(SIGMA**2) + 1e-5
    with store.writer() as writer:
        writer.put(evidence(drive(temperature_c=21.5), error, covariance=covariance))
    checks = only(store)
    assert (checks.time == [BEGIN]).all()
    assert (checks.error == error).all()
    assert (checks.covariance == covariance).all()
    assert (checks.pose == POSE).all()
    assert checks.temperature_c == [21.5]
    assert {name: values[0] for name, values in checks.texts.items()}["verdict"] == "holds"


def test_files_lie_by_vehicle_and_month_as_one_partitioned_data_set_with_the_documented_columns(tmp_path: Path) -> None:
    import pyarrow.dataset
    import pyarrow.parquet

    store = Store(tmp_path)
    filled(store, "van/7 ü", np.zeros((312, 6)))
    paths = store.parts("van/7 ü")
    assert [path.parent.relative_to(tmp_path).as_posix() for path in paths] == [
        "checks/vehicle=van%2F7%20%C3%BC/day=2026-01",
        "checks/vehicle=van%2F7%20%C3%BC/day=2026-02",
    ]
    assert pyarrow.parquet.read_schema(paths[0]).names == list(COLUMNS)
    assert store.vehicles() == ["van/7 ü"]
    assert not list(store.journals.iterdir())
    filled(store, "b", np.zeros((312, 6)))
    read = pyarrow.dataset.dataset(tmp_path / "checks", format="parquet", partitioning="hive")
    second = pyarrow.dataset.field("day") == "2026-02"
    assert read.count_rows() == 624
    assert read.to_table(filter=second & (pyarrow.dataset.field("vehicle") == "b")).num_rows == 2


def test_a_log_is_counted_once_if_it_is_checked_again_or_under_another_path(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writer() as writer:
        writer.put(evidence(drive("a", 0)))
        writer.put(evidence(drive("a", 0)))
        writer.put(evidence(drive("a", 0, data="folder:copy"), log="log of folder:a/0"))
        writer.put(evidence(drive("b", 0), log="log of folder:a/0"))
    assert [len(checks) for checks in store.checks()] == [1, 1]


def test_an_unreadable_log_is_tried_again_and_replaced_by_its_evidence(tmp_path: Path) -> None:
    import pyarrow.parquet

    store, bad = Store(tmp_path), {"verdict": Verdict.UNREADABLE, "reason": "cut off", "log": ""}
    with store.writer() as writer:
        writer.put(evidence(drive("a"), **bad))
        assert not writer.finished(drive("a"), drive("a").key())
    with store.writer() as writer:
        writer.put(evidence(drive("a"), **bad))
    [path] = store.parts("a")
    assert pyarrow.parquet.read_metadata(path).num_rows == 1, "the same reason is one row"
    assert only(store).texts["verdict"].tolist() == ["unreadable"]
    with store.writer() as writer:
        writer.put(evidence(drive("a")))
        assert writer.finished(drive("a"), drive("a").key())
    assert only(store).texts["verdict"].tolist() == ["holds"]


def test_what_a_killed_writer_finished_is_read_at_once_and_stored_by_the_next(tmp_path: Path) -> None:
    store = Store(tmp_path)
    killed = store.writer()
    for number in range(3):
        killed.put(evidence(drive("a", number)))
    [journal] = store.journals.iterdir()
    assert len(only(store)) == 3
    killed._journal.close()  # type: ignore[union-attr]  # as the end of its process does
    with journal.open("ab") as file:
        file.write(b'{"key": "half of a li')
    with store.writer() as writer:
        assert writer.finished(drive("a", 2), drive("a", 2).key())
        assert not list(store.journals.iterdir())
    assert len(only(store)) == 3


def test_the_journal_of_a_writer_that_works_is_left_alone(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writer() as first, store.writer() as both:
        first.put(evidence(drive("a", 0)))
        with store.writer() as later:
            assert later.finished(drive("a", 0), drive("a", 0).key()), "evidence of others is known before it is folded"
            later.put(evidence(drive("b", 0)))
        both.put(evidence(drive("a", 0), seconds=9.0))  # it began before the other one finished this check
        assert len(list(store.journals.iterdir())) == 2
    assert [len(checks) for checks in store.checks()] == [1, 1]


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    writer = store.writer()
    writer.put(evidence(drive("a", 0)))

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("p2o_fleet.store.os.fsync", full)
        with pytest.raises(InputError, match="No space left on device"):
            writer.put(evidence(drive("a", 1)))
    assert len(only(store)) == 1, "no half line is left"
    writer.put(evidence(drive("a", 1)))
    with monkeypatch.context() as patch:
        patch.setattr("p2o_fleet.store.sync_folder", full)
        with pytest.raises(InputError, match="No space left on device"):
            writer.fold()
    assert len(only(store)) == 2, "the journal is kept until its files are written"
    writer.fold()
    assert len(only(store)) == 2
    assert not list(store.journals.iterdir())


@pytest.fixture
def operations(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Return the operations on files from now on, in their order: the kind, and the inode of the file or folder."""
    done: list[tuple[str, int]] = []
    fsync, replace, unlink = os.fsync, Path.replace, Path.unlink

    def synced(handle: int) -> None:
        fsync(handle)
        done.append(("fsync", os.fstat(handle).st_ino))

    def replaced(self: Path, target: Path) -> Path:
        done.append(("name", self.stat().st_ino))
        return replace(self, target)

    def removed(self: Path, missing_ok: bool = False) -> None:
        if self.exists():
            done.append(("remove", self.stat().st_ino))
        unlink(self, missing_ok)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    monkeypatch.setattr(Path, "unlink", removed)
    return done


def test_content_and_names_of_files_are_on_the_disk_before_what_they_replace_is_removed(
    tmp_path: Path, operations: list[tuple[str, int]]
) -> None:
    store = Store(tmp_path)
    with store.writer() as writer:
        writer.put(evidence(drive("a", 0)))
        [journal] = store.journals.iterdir()
        removed = journal.stat().st_ino
        assert {("fsync", removed), ("fsync", store.journals.stat().st_ino)} <= set(operations)
    for _ in range(2):
        [path] = store.parts("a")
        inode, removal = path.stat().st_ino, operations.index(("remove", removed))
        content, name = operations.index(("fsync", inode)), operations.index(("name", inode))
        assert content < name < removal
        for folder in (path.parent, path.parent.parent, store.checks_folder):
            assert ("fsync", folder.stat().st_ino) in operations[name:removal], folder.name
        removed = inode  # the second time, a file with more checks replaces this one
        store.add([evidence(drive("a", 5)).row()])


def test_runs_of_many_days_leave_one_file_for_each_month_with_every_check_in_order_of_time(tmp_path: Path) -> None:
    store = Store(tmp_path)
    errors = np.random.default_rng(0).normal(size=(400, 6))
    for first in (80, 0, 160, 240, 320):
        with store.writer() as writer:
            for number in range(first, first + 80):
                writer.put(evidence(drive("a", number), errors[number]))
    assert [path.parent.name for path in store.parts("a")] == ["day=2026-01", "day=2026-02"]
    assert (only(store).error == errors).all()
    before = {path: path.read_bytes() for path in store.parts("a")}
    with store.writer() as writer:
        assert writer.finished(drive("a", 7), drive("a", 7).key()), "a check in the file of a month is finished"
    assert {path: path.read_bytes() for path in store.parts("a")} == before


def test_files_by_day_and_year_of_earlier_versions_are_read(tmp_path: Path) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((330, 6)))
    for month, before in (("day=2026-01", "day=2026"), ("day=2026-02", "day=2026-02-01")):
        (store.folder("a") / month).rename(store.folder("a") / before)
    with store.writer() as writer:
        assert all(writer.finished(drive("a", number), drive("a", number).key()) for number in (7, 315))
        writer.put(evidence(drive("a", 325, data="folder:late")))
    assert len(only(store)) == 331


def test_a_writer_that_is_killed_while_it_replaces_a_file_counts_no_check_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((20, 6)))

    def killed(path: Path, missing_ok: bool = False) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", killed)
        with pytest.raises(KeyboardInterrupt):
            filled(store, "a", np.zeros((30, 6)))
    assert len(store.parts("a")) == 2
    assert len(only(store)) == 30
    filled(store, "a", np.zeros((31, 6)))
    assert len(only(store)) == 31
    assert len(store.parts("a")) == 1


def test_two_processes_that_replace_the_same_file_lose_no_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((20, 6)))
    before = store.parts("a")
    filled(store, "a", np.zeros((30, 6)))
    with monkeypatch.context() as patch:
        patch.setattr(Store, "parts", lambda self, vehicle, day="*": before)
        store.add([evidence(drive("a", 35)).row()])
    assert len(store.parts("a")) == 2, "the file that was listed is gone"
    assert len(only(store)) == 31


def test_a_reader_that_lists_folders_while_files_are_merged_reads_every_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((30, 6)))
    real, listings = Store.parts, list[str]()

    def parts(self: Store, vehicle: str, day: str = "*") -> list[Path]:
        listings.append(vehicle)
        # The first listing saw the folders before a file was replaced, and their content after it.
        return [] if len(listings) == 1 else real(self, vehicle, day)

    monkeypatch.setattr(Store, "parts", parts)
    assert len(only(store)) == 30


def _rewritten(path: Path, **columns: object) -> None:
    """Replace columns of a Parquet file, and leave out those that are None."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.ParquetFile(path).read()
    for name, values in columns.items():
        table = table.drop_columns(name)
        if values is not None:
            table = table.append_column(name, pa.array(values))  # type: ignore[arg-type]
    pq.write_table(table, path)


NAN = float("nan")


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"covariance": None}, "no column covariance"),
        ({"covariance": [[1.0] * 20]}, "wrong length"),
        ({"covariance": [[1.0] * 21]}, "covariance is out of range"),
        ({"covariance": [[NAN] * 21]}, "covariance is out of range"),
        ({"covariance": ["none"]}, "wrong type"),
        ({"yaw_deg": [1e9]}, "out of range"),
        ({"yaw_deg": [None]}, "out of range"),
        ({"time": [10**18]}, "time is out of range"),
        ({"time": ["yesterday"]}, "wrong type"),
        ({"camera_from_lidar": [[0.0] * 12]}, "camera_from_lidar is out of range"),
        ({"verdict": ["perhaps"]}, "verdict is out of range"),
        ({"camera": [None]}, "camera is missing"),
        ({"camera": ["a\u202eb"]}, "camera is not valid"),
        ({"reason": ["long" * 2000]}, "reason is not valid"),
        ({"vehicle": ["b"]}, "vehicle is out of range"),
        ({"frame_count": [-5]}, "frame_count is out of range"),
        ({"temperature_c": [1e300]}, "temperature_c is out of range"),
    ],
)
def test_a_file_with_values_that_no_check_has_is_skipped_and_named(
    tmp_path: Path, columns: dict[str, object], reason: str
) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((301, 6)))
    store.add([evidence(drive("a", 311)).row()])
    [_, bad] = store.parts("a")
    _rewritten(bad, **columns)
    checks = only(store)
    assert len(checks) == 301
    [text] = checks.damaged
    assert bad.name in text
    assert reason in text
    with store.writer() as writer:
        assert not writer.finished(drive("a", 311), drive("a", 311).key()), "it is checked again"
        assert bad.name in writer.damaged[0]
    store.add([evidence(drive("a", 312)).row()])
    assert bad.exists(), "a damaged file is not replaced"
    assert len(only(store)) == 302


def _special_file(path: Path, kind: str) -> None:
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"PAR1 and nothing else")


@pytest.mark.skipif(os.name == "nt", reason="needs pipes and devices")
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "damaged file"])
def test_a_part_or_journal_that_is_no_file_of_the_store_is_skipped_and_named(tmp_path: Path, kind: str) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((2, 6)))
    [path] = store.parts("a")
    _special_file(path.with_name("part-0.parquet"), kind)
    _special_file(store.journals / "0.jsonl", kind)
    with store.writer() as writer:
        assert writer.finished(drive("a", 1), drive("a", 1).key())
        assert kind == "damaged file" or any("0.jsonl" in text for text in writer.damaged)
    checks = only(store)
    assert len(checks) == 2
    assert any("part-0.parquet" in text for text in checks.damaged)
    assert kind == "damaged file" or any("0.jsonl" in text for text in checks.damaged)


def test_a_line_of_a_journal_that_is_no_row_is_skipped_and_named_and_kept(tmp_path: Path) -> None:
    store = Store(tmp_path)
    good = evidence(drive("a", 0)).row()
    bad = [7, [1], None, "text", {}, {**good, "time": "never"}, {**good, "time": 1e300}, {**good, "yaw_deg": 1e9}]
    bad += [{**good, "covariance": [1.0]}, {**good, "cells": "many"}, {**good, "vehicle": None}]
    lines = [json.dumps(row) for row in (bad[0], good, *bad[1:])]
    journal = store.journals / "killed.jsonl"
    journal.parent.mkdir()
    journal.write_text("\n".join([*lines, "half", "{"]))
    checks = only(store)
    assert len(checks) == 1
    assert len(checks.damaged) == len(bad) + 1
    assert f"{journal}, line 1: the row is not an object" in checks.damaged[0]
    assert store.vehicles() == ["a"]
    with store.writer() as writer:
        assert len(writer.damaged) == len(bad) + 1
    assert len(only(store)) == 1
    assert only(store).damaged == ()
    assert journal.with_suffix(".damaged").exists()


def test_a_small_file_that_expands_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    store = Store(tmp_path)
    filled(store, "a", np.zeros((1, 6)))
    [path] = store.parts("a")
    table = pq.ParquetFile(path).read()
    many = pa.concat_tables([table] * 1000).combine_chunks()
    many = pa.concat_tables([many] * 500)
    pq.write_table(many, path, compression="zstd", row_group_size=500_000)
    assert path.stat().st_size < 5_000_000
    filled(store, "b", np.zeros((1, 6)))
    [damaged, good] = store.checks()
    assert "too large" in damaged.damaged[0]
    assert (len(damaged), len(good)) == (0, 1)
