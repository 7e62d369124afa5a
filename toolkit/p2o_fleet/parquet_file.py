"""Open Parquet files with limited memory: a small file of equal values can expand to any size."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import naming, read_bytes

from p2o_fleet.drive import MAX_TEXT

_MAX_BYTES, _MAX_UNPACKED = 256 << 20, 1 << 30
"""Maximum size of a file, and of its content without compression."""
_MAX_VALUES = 64
"""Maximum number of values of a list, on average."""


@contextlib.contextmanager
def open_parquet(path: Path, what: str, most_rows: int) -> Iterator[Any]:
    """Open a Parquet file as `pyarrow.parquet.ParquetFile`; equal texts are read once, as dictionaries.

    Raises InputError as `read_bytes`, if it has more than `most_rows` rows or unpacks to more than 1 GiB, and for
    errors of Arrow inside the block.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    data = pa.BufferReader(read_bytes(path, what, _MAX_BYTES))
    try:
        about = pq.read_metadata(data)
        groups = [about.row_group(number) for number in range(about.num_row_groups)]
        columns = [(group, group.column(number)) for group in groups for number in range(group.num_columns)]
        size = sum(column.total_uncompressed_size for _, column in columns)
        long = any(column.num_values > _MAX_VALUES * group.num_rows for group, column in columns)
        if size > _MAX_UNPACKED or about.num_rows > most_rows or long:
            expected = f"at most {_MAX_UNPACKED} bytes and {most_rows} rows, with lists of about {_MAX_VALUES} values"
            got = f"{size} bytes, {about.num_rows} rows"
            raise InputError(f"the unpacked {what} is too large", where=path, expected=expected, got=got)
        schema = about.schema
        leaves = [schema.column(number) for number in range(len(schema))]
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
        data.seek(0)
        with pq.ParquetFile(data, read_dictionary=texts) as file, naming(path):
            yield file
    except (pa.ArrowException, OSError) as problem:
        raise InputError(f"the {what} cannot be read", where=path, expected="Parquet", got=problem) from problem


def check_texts(table: Any) -> None:
    """Raise InputError if a text of an Arrow table, read by `open_parquet`, is too long to be repeated."""
    import pyarrow as pa
    import pyarrow.compute as pc

    for name, column in zip(table.schema.names, table.columns, strict=True):
        for chunk in column.chunks:
            values = chunk.flatten() if pa.types.is_list(chunk.type) else chunk
            if isinstance(values, pa.DictionaryArray):
                longest = pc.max(pc.binary_length(values.dictionary)).as_py() or 0
                if longest > 4 * MAX_TEXT:
                    expected = f"texts of at most {MAX_TEXT} characters"
                    raise InputError(f"{name} is not valid", expected=expected, got=f"{longest} bytes")
