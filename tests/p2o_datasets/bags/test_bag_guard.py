"""Bags whose SQLite schema computes and whose MCAP index is false are refused in one line."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets.bags import bag_guard
from p2o_datasets.bags.bag import Bag
from rosbags.rosbag2 import storage_mcap

from tests.bag_files import file_of, image, write_bag
from tests.p2o_datasets.opened import refused

START_NS = 1_700_000_000_000_000_000
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"


def bag(root: Path, form: str = "sqlite3") -> Path:
    pictures = [image("/image", START_NS + i * 100_000_000, np.full((12, 16, 3), i, np.uint8)) for i in range(3)]
    return file_of(write_bag(root, pictures, form))


@pytest.mark.parametrize(
    "script",
    [
        f"DROP TABLE schema; CREATE VIEW schema AS {ENDLESS} SELECT max(i) AS schema_version FROM n",
        "DROP TABLE message_definitions; CREATE VIEW message_definitions AS "
        f"{ENDLESS} SELECT i AS id, 'a' AS topic_type, 'a' AS encoding, 'a' AS encoded_message_definition, "
        "'a' AS type_description_hash FROM n",
        "ALTER TABLE topics RENAME TO kept; CREATE VIEW topics AS SELECT * FROM kept",
        f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS} SELECT i AS id, 1 AS topic_id, 1 AS timestamp, "
        "x'00' AS data FROM n",
        "ALTER TABLE messages DROP COLUMN data; ALTER TABLE messages ADD COLUMN data AS (zeroblob(1000000000))",
        "ALTER TABLE messages ADD COLUMN more DEFAULT 'text'",
        "ALTER TABLE topics ADD COLUMN more AS (hex(zeroblob(400000000)))",
        "CREATE TRIGGER again AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
        "CREATE VIRTUAL TABLE words USING fts5(word)",
        # The column `type` contradicts the statement.
        "PRAGMA writable_schema=ON; UPDATE sqlite_master SET "
        f"sql='CREATE VIEW schema AS {ENDLESS} SELECT max(i) AS schema_version FROM n', rootpage=0 WHERE name='schema'",
        "UPDATE topics SET name = x'ff'",
        "UPDATE message_definitions SET topic_type = x'00'",
        "DROP TABLE schema; CREATE TABLE schema(schema_version); INSERT INTO schema VALUES ('text')",
        "ALTER TABLE topics RENAME TO kept; CREATE TABLE topics AS SELECT * FROM kept UNION ALL SELECT * FROM kept",
    ],
)
def test_a_schema_that_computes_and_cells_of_other_types_are_refused(tmp_path: Path, script: str) -> None:
    file = bag(tmp_path)
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript(script)
    with refused(r"the bag cannot be read; (expected the plain|got .*malformed)"):
        Bag(file)


@pytest.mark.parametrize("column", ["data", "timestamp"])
def test_a_message_of_another_type_is_refused(tmp_path: Path, column: str) -> None:
    file = bag(tmp_path)
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript(f"UPDATE messages SET {column} = 'text'")
    with pytest.raises(InputError, match=r"drive\.db3: (a message has another type|the bag cannot be read)"):
        list(Bag(file).messages(["/image"]))


def test_queries_stop_after_a_number_of_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = bag(tmp_path)
    opened = Bag(file)
    monkeypatch.setattr(bag_guard, "_STEPS", 0)
    monkeypatch.setattr(bag_guard, "_STEPS_PER_BYTE", 0)
    monkeypatch.setattr(bag_guard, "_STEPS_PER_CALL", 10)
    with pytest.raises(InputError, match="the bag cannot be read"):
        list(opened.messages(["/image"]))
    with pytest.raises(InputError, match="the bag cannot be read"):
        Bag(file)


def test_the_file_that_is_checked_is_the_file_that_is_read(tmp_path: Path) -> None:
    file = bag(tmp_path)
    named = file.rename(file.with_name("a%41#b c?mode=memory.db3"))
    assert len(list(Bag(named).messages(["/image"]))) == 3


def test_bags_that_other_tools_have_analyzed_and_indexed_are_read(tmp_path: Path) -> None:
    file = bag(tmp_path)
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript("CREATE TABLE notes(text); CREATE INDEX more ON messages(topic_id); ANALYZE; VACUUM")
    assert len(list(Bag(file).messages(["/image"]))) == 3


def with_chunk_index(file: Path, change: str) -> None:
    """Rewrite the summary of an MCAP file: its only chunk is indexed 2,000 times, or outside of the file."""
    data = file.read_bytes()
    (summary,) = struct.unpack_from("<Q", data, len(data) - 28)
    records, at = b"", summary
    while data[at] != 0x0E:
        size = 9 + struct.unpack_from("<Q", data, at + 1)[0]
        record = bytearray(data[at : at + size])
        if data[at] == 0x08 and change == "outside":
            struct.pack_into("<Q", record, 9 + 16, len(data))
        records += bytes(record) * (2000 if data[at] == 0x08 and change == "repeated" else 1)
        at += size
    file.write_bytes(data[:summary] + records + data[at:])


@pytest.mark.parametrize("change", ["repeated", "outside"])
def test_chunks_twice_or_outside_the_file_are_refused(
    tmp_path: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = bag(tmp_path, "mcap")
    with_chunk_index(file, "none")
    assert len(list(Bag(file).messages(["/image"]))) == 3
    with_chunk_index(file, change)
    monkeypatch.setattr(storage_mcap, "msgsrc", None)
    with pytest.raises(InputError, match="the index of the bag is false; expected chunks one after another"):
        list(Bag(file).messages(["/image"]))


def test_chunks_that_would_be_in_memory_together_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = bag(tmp_path, "mcap")
    monkeypatch.setattr(bag_guard, "_MAX_OVERLAP_BYTES", 1000)
    with pytest.raises(InputError, match="too many chunks overlap in time"):
        Bag(file)


def test_a_small_chunk_that_unpacks_to_135_mb_is_refused(tmp_path: Path) -> None:
    zeros = image("/image", START_NS, np.zeros((5000, 9000, 3), np.uint8))
    path = write_bag(tmp_path, [zeros], "mcap", compression="STORAGE")
    with pytest.raises(InputError, match=r"a chunk is (too large|truncated or larger than stated)"):
        list(Bag(path).messages(["/image"]))
