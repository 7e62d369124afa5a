"""A study.sqlite may come from anywhere: what no study wrote ends in one line that names the file and the way out."""

from __future__ import annotations

import contextlib
import json
import math
import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from p2o import InputError
from p2o.cli import main
from p2o.results.json_types import Schema
from p2o.results.result import Round
from p2o_study import columns
from p2o_study.store import Store

from tests.fake_study import run_of, table2, write_store

PLUGIN = Path(__file__).parents[1] / "study_plugin.py"
STUDY = """name = "table2"
title = "T"
[[dataset]]
name = "tiny"
data = "tiny:"
options = { frames = 1 }
[[row]]
label = "a"
calibrator = "quick"
witness = "none"
"""


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with a few rows, in one file."""
    folder = write_store(tmp_path_factory.mktemp("good"), [*table2(3, 1), run_of("last", "f", 0, 1.0, 0.1)])
    with sqlite3.connect(folder / "study.sqlite") as connection:
        connection.execute("pragma journal_mode = delete")
    connection.close()
    return folder / "study.sqlite"


@pytest.fixture
def store(good: Path, tmp_path: Path) -> Path:
    """Return a copy of the good store."""
    return Path(shutil.copy(good, tmp_path / "study.sqlite"))


def sql(store: Path, *statements: str) -> None:
    with sqlite3.connect(store) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()


def told(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the lines that `p2o report` and `p2o ablate` end with."""
    monkeypatch.setenv("P2O_CACHE", str(folder.parent / "cache"))
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    file = folder.parent / f"{folder.name}.toml"
    file.write_text(STUDY)
    lines = []
    for words in (
        ["report", str(folder)],
        ["ablate", str(file), "--plugin", str(PLUGIN), "--out", str(folder), "--jobs", "1", "--quiet"],
    ):
        assert main(words) == 2, words
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith("p2o: error: ")
        assert line.isprintable()
        lines.append(line)
    return lines


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def a_pipe_for_its_log(path: Path) -> None:
    os.mkfifo(path.with_name("study.sqlite-wal"))


def a_text(path: Path) -> None:
    path.write_text("not a database at all, but long enough to be looked at" * 40)


def cut_off(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def overwritten(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096 : len(content) - 4096] = random.Random(0).randbytes(len(content) - 8192)
    path.write_bytes(content)


def another_version(path: Path) -> None:
    sql(path, "pragma user_version = 7")


def another_schema(path: Path) -> None:
    path.unlink()
    sql(path, "create table photos (id integer primary key, content blob)", "insert into photos values (1, x'00')")


def with_statement(statement: str) -> Callable[[Path], None]:
    return lambda path: sql(path, statement)


def remade(table: str, of: Callable[[str], str]) -> Callable[[Path], None]:
    """Return what makes one of the tables again from other words."""

    def remake(path: Path) -> None:
        with sqlite3.connect(path) as connection:
            [(text,)] = connection.execute("select sql from sqlite_master where name = ?", (table,)).fetchall()
            connection.execute("drop view rows")
            connection.execute(f"alter table {table} rename to old")
            connection.execute(of(text))
            names = [name for _, name, *_ in connection.execute("pragma table_info(old)")]
            if "no_key" not in of(text):
                connection.execute(f"insert into {table} ({', '.join(names)}) select * from old")
            connection.execute("drop table old")
        connection.close()

    return remake


FOREIGN = {
    "a folder": a_folder,
    "a pipe": a_pipe,
    "a device": a_device,
    "a pipe for its log": a_pipe_for_its_log,
    "a text": a_text,
    "cut off": cut_off,
    "overwritten": overwritten,
    "another version": another_version,
    "another schema": another_schema,
    "a trigger": with_statement("create trigger t after insert on plan begin delete from runs; end"),
    "a trigger on studies": with_statement("create trigger t before delete on plan begin delete from studies; end"),
    "an index that computes": with_statement("create index i on plan (abs(position))"),
    "a table too many": with_statement("create table more (x)"),
    "a virtual table": with_statement("create virtual table v using fts5(x)"),
    "a check": remade("plan", lambda text: text.replace("position INTEGER", "position INTEGER check (position >= 0)")),
    "a default": remade("plan", lambda text: text.replace("position INTEGER", "position INTEGER default (random())")),
    "a generated column": remade("studies", lambda text: text.replace(")", ", x as (length(name)))")),
    "a column less": remade("studies", lambda text: text.replace("toml", "no_key")),
    "no key": remade("studies", lambda text: text.replace("PRIMARY KEY", "")),
    "a table less": with_statement("drop table plan"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_file_that_no_study_wrote_is_told_by_both_commands(
    case: str, store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    try:
        FOREIGN[case](store)
    except sqlite3.OperationalError as problem:
        pytest.skip(f"this SQLite has no {problem}")
    for line in told(store.parent, capsys, monkeypatch):
        assert str(store) in line
        assert "move the file to another folder and run again" in line


VALUES = (
    "null",
    "7",
    "-1",
    "1.5",
    "x'ff00'",
    "cast(x'80ff' as text)",
    "'?'",
    "'[1'",
    "'{}'",
    "'[[]]'",
    "'[{\"a\": []}]'",
)
WORDS = (
    "frames",
    "joint",
    "seed",
    "status",
    "rotation_deg",
    "roll_deg",
    "trust",
    "odds_ratio",
    "cells",
    "judge",
    "estimate",
)
WORDS += ("rounds", "matches", "seconds", "recipe", "versions", "inputs", "perturb", "exception", "finished", "reason")
MORE_VALUES = {
    "rotation_deg": ("9e999",),
    "estimate": (
        "'[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,NaN]]'",
        "'[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1e999]]'",
        "'[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,true]]'",
    ),
    "recipe": (f"'{'[' * 100_000}'", f"'{{\"a\": {'9' * 5000}}}'", f"'{{\"a\": 1{'0' * 400}}}'"),
    "seed": ("9e18", "9223372036854775807"),
    "rounds": ("'[{\"stage\": 3}]'", '\'[{"matches": {"L": "x"}}]\'', "'[{\"cost\": []}]'"),
    "seconds": ("'{\"extract\": []}'",),
    "matches": ("'{\"L\": null}'",),
    "versions": ("'{\"numpy\": 2}'",),
}
FINE = {
    ("joint", "7"), ("seed", "7"), ("seed", "9e18"), ("rotation_deg", "null"), ("rotation_deg", "7"),
    ("rotation_deg", "-1"), ("rotation_deg", "1.5"), ("roll_deg", "null"), ("roll_deg", "7"), ("roll_deg", "-1"),
    ("roll_deg", "1.5"), ("trust", "null"), ("odds_ratio", "null"), ("odds_ratio", "7"), ("odds_ratio", "-1"),
    ("odds_ratio", "1.5"), ("judge", "null"), ("cells", "null"), ("cells", "7"),
    ("estimate", "null"), ("matches", "'{}'"), ("seconds", "'{}'"),
    ("recipe", "'{}'"), ("versions", "'{}'"), ("inputs", "'{}'"), ("perturb", "null"), ("exception", "null"),
} - {("seed", "9e18")}  # fmt: skip
"""What is of the right type after all; numbers in a column of texts are texts."""
TEXTS = ("perturb", "judge", "exception", "finished", "reason")


def cases() -> list[tuple[str, str]]:
    found = [(column, value) for column in WORDS for value in (*VALUES, *MORE_VALUES.get(column, ()))]
    return [c for c in found if c not in FINE and not (c[0] in TEXTS and c[1][0] not in "xcn")]


@pytest.mark.parametrize(("column", "value"), cases(), ids=lambda text: text[:24])
def test_a_value_that_no_study_writes_is_told_and_never_a_crash(store: Path, column: str, value: str) -> None:
    sql(store, f"update runs set {column} = {value}")
    with pytest.raises(InputError) as caught, Store.open(store.parent) as opened:
        opened.rows("table2")
    assert str(caught.value).startswith(str(store))
    assert "move the file to another folder and run again" in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(("column", "value"), sorted(FINE))
def test_a_value_that_a_study_may_write_is_taken(store: Path, column: str, value: str) -> None:
    sql(store, f"update runs set {column} = {value}")
    with Store.open(store.parent) as opened:
        assert len(opened.rows("table2")) == 11


@pytest.mark.parametrize("value", ["null", "7", "x'80'", "'['", "'[]'", "'{\"a\": NaN}'"])
@pytest.mark.parametrize("column", ["name", "toml", "data", "published"])
def test_a_study_that_nobody_wrote_is_told(store: Path, column: str, value: str) -> None:
    sql(store, f"update studies set {column} = {value}")
    if (column in ("name", "toml") and value[0] in "7'") or (column, value) == ("published", "'[]'"):
        return  # a text after all
    with pytest.raises(InputError, match="move the file to another folder"), Store.open(store.parent) as opened:
        opened.studies()


@pytest.mark.parametrize(
    "published",
    [
        '[{"label": 3}]',
        '[{"values": 4}]',
        '[{"values": {"rotation_deg": null}}]',
        '[{"values": {"rotation_deg": "x"}}]',
        '[{"values": {"rotation_deg": [1]}}]',
        '[{"values": {"rotation_deg": true}}]',
        '[{"values": {"rotation_deg": 1e999}}]',
        '[{"source": null}]',
    ],
)
def test_a_published_row_that_nobody_wrote_is_told(store: Path, published: str) -> None:
    sql(store, f"update studies set published = '{published}'")
    with pytest.raises(InputError, match="move the file to another folder"), Store.open(store.parent) as opened:
        opened.studies()


def test_a_view_of_somebody_else_is_never_asked(store: Path) -> None:
    sql(store, "drop view rows", "create view rows as select randomblob(1e9) as key from plan, plan, plan")
    with Store.open(store.parent) as opened:
        assert len(opened.rows("table2")) == 11


def test_a_file_that_is_refused_is_left_as_it_was(store: Path) -> None:
    sql(store, "create table more (x)")
    before = store.read_bytes()
    with pytest.raises(InputError, match="not a store of studies; got the table 'more'"):
        Store.open(store.parent)
    assert store.read_bytes() == before
    assert [path.name for path in store.parent.iterdir()] == ["study.sqlite"]


def test_the_log_of_another_file_is_not_written_into_a_store(store: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("pragma journal_mode = wal")
        connection.execute("create table x (y)")
        connection.commit()
        shutil.copy(tmp_path / "other.sqlite-wal", tmp_path / "study.sqlite-wal")
    connection.close()
    before = store.read_bytes()
    with pytest.raises(InputError, match="move the file to another folder"):
        Store.open(store.parent)
    assert store.read_bytes() == before
    for suffix in ("-wal", "-shm"):
        (tmp_path / f"study.sqlite{suffix}").unlink(missing_ok=True)
    with Store.open(store.parent) as opened:
        assert len(opened.rows("table2")) == 11


def test_bytes_turned_at_random_are_rows_or_an_error(good: Path, tmp_path: Path) -> None:
    rng = random.Random(1)
    content = good.read_bytes()
    for _ in range(150):
        damaged = bytearray(content)
        for _ in range(rng.choice((1, 4, 64))):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        (tmp_path / "study.sqlite").write_bytes(damaged)
        for beside in tmp_path.glob("study.sqlite-*"):
            beside.unlink()
        with contextlib.suppress(InputError), Store.open(tmp_path) as opened:
            for study in opened.studies():
                opened.rows(study.name)
                opened.missing(study.name)


def test_a_name_that_is_no_text_is_kept_in_json_and_written_out_elsewhere(tmp_path: Path) -> None:
    """Names of files may hold bytes that are no UTF-8, which Python reads as halves of surrogates."""
    write_store(tmp_path, [run_of("a", "frame \udcff", 0, 1.0, 0.1, reason="no \udcff luck")])
    with Store.open(tmp_path) as opened:
        [row] = opened.rows("table2")
    assert row.frames == ("frame \udcff",)
    assert row.reason == "no \\udcff luck"


_ROUND = {
    "stage": "refine",
    "reach_px": 8.5,
    "matches": {"L": 3},
    "mean_residual": 1.5,
    "cost": 2.5,
    "step_deg": 0.25,
    "step_m": 0.125,
    "accepted": True,
}


def test_usual_rounds_are_read_as_the_schema_reads_them() -> None:
    """Each field is replaced by values of every type; what is not read quickly is left to the schema."""
    schema, quick = Schema(tuple[Round, ...]), 0
    values = (None, 0.5, 3, -1, True, "x", "inf", "", {}, {"L": 1.0}, {"L": True}, {"L": None}, [], 1e308, 2**70)
    rounds: list[dict[str, object]] = [{**_ROUND, name: value} for name in _ROUND for value in values]
    rounds += [{**_ROUND, "more": 1}, {k: v for k, v in _ROUND.items() if k != "cost"}]
    for entries in ([], *([entry] for entry in rounds), [_ROUND, rounds[1]]):
        found = columns._usual_rounds(json.dumps(entries))
        if found is None:
            continue
        quick += 1
        expected = schema.read(entries)
        assert repr(found) == repr(expected)
        assert [type(x) for r in found for x in vars(r).values()] == [
            type(x) for r in expected for x in vars(r).values()
        ]
    assert quick > 20
    texts = ("{}", "null", "3", '"x"', "[3]", "[null]", "[[]]", "[{}]", "[" * 100_000, "[NaN]", "")
    texts += tuple(json.dumps([{**_ROUND, "cost": number}]) for number in (math.nan, math.inf))
    assert [columns._usual_rounds(text) for text in texts] == [None] * len(texts)
    assert columns._usual_rounds(json.dumps([_ROUND]).replace("2.5", "1e999")) is None
    assert columns._usual_rounds(json.dumps([_ROUND]).encode()) is None
