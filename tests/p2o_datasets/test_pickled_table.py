"""Pickled tables are read without running anything: real ones of four versions of pandas, and attacks."""

from __future__ import annotations

import gzip
import os
import pickle
import random
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets.pickled_table import read_pickled_table

from tests.p2o_datasets.opened import refused

from .pandas_pickles import PICKLES, D, T, X
from .pandaset_files import pickled

COLUMNS = ("x", "t", "d")


def read(folder: Path, data: bytes, columns: tuple[str, ...] = COLUMNS) -> dict[str, Any]:
    path = folder / "00.pkl"
    path.write_bytes(data)
    return read_pickled_table(path, "sweep", columns)


@pytest.mark.parametrize("label", [label for label in PICKLES if not label.startswith("3")])
@pytest.mark.parametrize("packed", [False, True])
def test_tables_of_pandas_1_and_2_are_read(tmp_path: Path, label: str, packed: bool) -> None:
    found = read(tmp_path, gzip.compress(PICKLES[label]) if packed else PICKLES[label])
    chosen = [0, 2] if "d = 0" in label else [0, 1, 2]
    assert found["x"].tolist() == [X[i] for i in chosen]
    assert found["t"].tolist() == [T[i] for i in chosen]
    assert found["d"].tolist() == [D[i] for i in chosen]
    assert found["d"].dtype == np.int64


def test_tables_of_pandas_3_are_refused_with_a_way_out(tmp_path: Path) -> None:
    label = next(label for label in PICKLES if label.startswith("3"))
    with refused(r"the name pandas.DataFrame.*write its numeric columns again"):
        read(tmp_path, PICKLES[label])


def test_a_table_in_the_order_of_fortran_and_one_of_single_numbers_are_read(tmp_path: Path) -> None:
    columns = {"x": np.array([1.5, 2.5], np.float32), "d": np.array([3, 4], np.int16)}
    for order in ("C", "F"):
        found = read(tmp_path, pickled(columns, order=order), ("x", "d"))
        assert found["x"].tolist() == [1.5, 2.5]
        assert found["d"].tolist() == [3, 4]


class Attack:
    """What runs a command or makes a folder when it is unpickled."""

    def __init__(self, call: Any, argument: str) -> None:
        self.call, self.argument = call, argument

    def __reduce__(self) -> tuple[Any, ...]:
        return self.call, (self.argument,)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(("call", "text"), [(os.system, "touch {}"), (os.mkdir, "{}")])
def test_a_pickle_that_runs_something_runs_nothing(tmp_path: Path, protocol: int, call: Any, text: str) -> None:
    target = tmp_path / "run"
    data = pickle.dumps({"x": Attack(call, text.format(target))}, protocol)
    with refused("other pickles are never loaded"):
        read(tmp_path, data)
    assert not target.exists()
    pickle.loads(data)  # noqa: S301  (so that the attack is one)
    assert target.exists()


@pytest.mark.parametrize(
    "name", ["os system", "builtins eval", "pandas.core.frame DataFrame.query", "numpy ndarray.tofile", "builtins x"]
)
def test_names_beyond_those_of_tables_are_refused(tmp_path: Path, name: str) -> None:
    for step in (f"c{name.replace(' ', chr(10))}\n", f"c{name.replace(' ', chr(10))}\n)R"):
        with pytest.raises(InputError, match=r"the name .*, which is not allowed"):
            read(tmp_path, b"\x80\x04" + step.encode() + b".")


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (b".", "no table|empty list|not a table"),
        (b"", "is empty"),
        (b"N.", "no frame at its place"),
        (b"(.", "no table|empty list|not a table"),
        (b"((t.", "no frame at its place"),
        (b"t.", "not a table"),
        (b"NR.", "a call without a tuple of arguments"),
        (b"NNR.", "a call without a tuple of arguments"),
        (b"Na.", "list index out of range"),
        (b"]]sN.", "not a table"),
        (b"}]Ns.", "unhashable"),
        (b"j\xff\xff\xff\xff.", "4294967295"),
        (b"S'x'\n.", "no frame at its place"),
        (b"cpandas.core.frame\nDataFrame\nC\x09arguments\x81.", "a call without a tuple of arguments"),
        (b"cpandas.core.frame\nDataFrame\n)}\x92.", "not a table"),
        (b"cpandas.core.frame\nDataFrame\n}b.", "not a table"),
        (b"\x96" + bytes(7) + b"\x7f.", "not a table"),
        (b"\x82\x01.", "not a table"),
        (b"})" + b"\x85" * 9_990 + b"Ns.", "no frame at its place"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.", "not a table"),
        (b"cnumpy\nndarray\n).", "no frame"),
        (b"cpandas.core.frame\nDataFrame\n)\x81.", "not a table"),
        (b"cpandas.core.frame\nDataFrame\n)\x81}b.", "no manager"),
        (b"L" + b"9" * 9999 + b"L\n.", "not a table"),
        (b"]" * 99_999 + b"a" * 99_998 + b".", "more than 10000 opcodes"),
        (b"]\x94h\x00a.", "no frame"),
    ],
)
def test_steps_that_make_no_table_are_one_line(tmp_path: Path, steps: bytes, words: str) -> None:
    with refused(words):
        read(tmp_path, b"\x80\x04" + steps if steps else b"")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": (5, 2)}, "an array of 10 numbers"),
        ({"shape": (1 << 40, 1 << 40)}, "no array"),
        ({"shape": (1 << 20, 1 << 20)}, "an array of 1099511627776 numbers"),
        ({"shape": (-1, 2)}, "no array"),
        ({"shape": ("a",)}, "no array"),
        ({"dtype": "O8"}, "an array of O8"),
        ({"dtype": "V1000000000"}, "an array of V"),
        ({"dtype": "f8,f8"}, "an array of f8,f8"),
        ({"places": (0, 9, 1)}, "is not numeric|out of range"),
        ({"labels": ["a", "d"]}, "no column x among a, d"),
    ],
)
def test_tables_whose_parts_do_not_fit_are_one_line(tmp_path: Path, change: Any, words: str) -> None:
    columns = {"x": np.array([1.5, 2.5]), "d": np.array([3, 4])}
    with refused(words):
        read(tmp_path, pickled(columns, **change), ("x", "d"))


def test_what_is_cut_off_or_too_large_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = gzip.compress(PICKLES["2.2.3, protocol 5"])
    with pytest.raises(InputError, match="the sweep is damaged or truncated"):
        read(tmp_path, whole[:-9])
    with pytest.raises(InputError, match="the sweep is missing"):
        read_pickled_table(tmp_path / "gone.pkl", "sweep", COLUMNS)
    monkeypatch.setattr("p2o_datasets.pickled_table._MAX_BYTES", 10_000)
    with pytest.raises(InputError, match="decompressed sweep is too large; expected at most 10000 bytes"):
        read(tmp_path, gzip.compress(bytes(1 << 20)))


def test_damage_anywhere_is_one_line_or_another_table_and_takes_little_memory(tmp_path: Path) -> None:
    rng = random.Random(0)
    samples = [*PICKLES.values(), pickled({"x": np.arange(5.0), "t": np.arange(5.0), "d": np.arange(5)})]
    said = []
    tracemalloc.start()
    try:
        for _ in range(500):
            data = bytearray(rng.choice(samples))
            for _ in range(rng.choice((1, 2, 8))):
                byte = rng.choice((rng.randrange(256), rng.choice(b"\x00\xff(.cR\x93b\x81}]t")))
                data[rng.randrange(len(data))] = byte
            try:
                found = read(tmp_path, bytes(data[: rng.randrange(len(data))] if rng.random() < 0.1 else data))
            except InputError as problem:
                said.append(str(problem))
            else:
                assert len({len(column) for column in found.values()}) == 1
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert said
    assert not any("\n" in text for text in said)
