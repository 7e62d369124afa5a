"""Tables of Arrow that are small as files and large in memory are refused before they are unpacked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from p2o import InputError
from p2o_datasets import arrow_file
from p2o_datasets.arrow_file import ParquetTable, read_feather
from p2o_datasets.arrow_size import stream_size
from pyarrow import feather, parquet

from .opened import refused

ROWS = 1 << 17


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrow_file, "_MAX_BYTES", ROWS)


def unreadable(*_: Any, **__: Any) -> None:
    raise AssertionError("the table was unpacked")


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("kind", ["number", "words"])
def test_feather_is_measured_first(
    tmp_path: Path, compression: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, values = tmp_path / "sweep.feather", pa.array(np.zeros(ROWS))
    if kind == "words":
        values = pa.DictionaryArray.from_arrays(pa.array([0, 0]), pa.array(["a" * 8 * ROWS]))
    feather.write_feather(pa.table({"x": values}), path, compression=compression)
    assert path.stat().st_size < ROWS / 10
    monkeypatch.setattr(pa.ipc, "open_stream", unreadable)
    with refused(r"the sweep is too large; expected at most 131072 bytes .*got 104\d\d\d\d bytes"):
        read_feather(path, "sweep", {"x": "number"})


@pytest.mark.parametrize("compression", ["lz4", "zstd", "uncompressed"])
def test_the_size_that_is_measured_is_that_of_the_table(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "sweep.feather"
    table = pa.table({"x": np.arange(1000.0), "word": pa.array(["a", "bc"] * 500), "i": np.arange(1000, dtype=np.int8)})
    feather.write_feather(table, path, compression=compression, chunksize=300)
    rows, size = stream_size(pa.py_buffer(path.read_bytes())[8:])
    assert rows == 1000
    assert table.nbytes <= size < 1.2 * table.nbytes
    read = read_feather(path, "sweep", {"x": "number", "word": "text"})
    assert np.array_equal(read["x"], np.arange(1000.0))
    assert read["word"] == ["a", "bc"] * 500


def test_rows_without_bytes_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "sweep.feather"
    feather.write_feather(pa.table({"x": pa.nulls(1 << 25)}), path, chunksize=1 << 25)
    with pytest.raises(InputError, match=r"the sweep is too large.*33554432 rows"):
        read_feather(path, "sweep", {"x": "number"})
    feather.write_feather(pa.table({"word": pa.array([""] * 100)}), path)
    monkeypatch.setattr(arrow_file, "_MAX_TEXTS", 10)
    with pytest.raises(InputError, match="column word is too large"):
        read_feather(path, "sweep", {"word": "text"})


@pytest.mark.parametrize("dictionary", [False, True])
@pytest.mark.parametrize("compression", ["zstd", "snappy", "none"])
def test_parquet_is_measured_first(
    tmp_path: Path, dictionary: bool, compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lidar.parquet"
    values = pa.array([[0.0] * 4 * ROWS, [1.0]], pa.list_(pa.float32()))
    key = pa.array(np.arange(2))
    parquet.write_table(pa.table({"v": values, "k": key}), path, compression=compression, use_dictionary=dictionary)
    table = ParquetTable(path, "component")
    assert table.columns({"k": "number"})["k"].tolist() == [0, 1]
    assert table.row(1, ["k"]) == {"k": 1}
    monkeypatch.setattr(parquet.ParquetFile, "iter_batches", unreadable)
    with pytest.raises(InputError, match="the component is too large"):
        table.row(1, ["v"])


def test_rows_are_read_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, sizes = tmp_path / "lidar.parquet", []
    parquet.write_table(pa.table({"v": pa.array([[float(i)] * 3 for i in range(9)])}), path)
    iterate = parquet.ParquetFile.iter_batches

    def batches(file: Any, *options: Any, **more: Any) -> Any:
        for batch in iterate(file, *options, **more):
            sizes.append(batch.num_rows)
            yield batch

    monkeypatch.setattr(parquet.ParquetFile, "iter_batches", batches)
    assert ParquetTable(path, "component").row(7, ["v"])["v"].tolist() == [7.0] * 3
    assert set(sizes) == {1}
