"""Read Parquet files with limited memory: a small file of equal values can expand to any size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import read_bytes

_MAX_BYTES, _MAX_UNPACKED = 256 << 20, 1 << 30
"""Maximum size of a file, and of its content without compression."""
_MAX_VALUES = 64
"""Maximum number of values of a list, on average."""


def read_parquet(path: Path, what: str, names: Sequence[str], most_rows: int) -> Any:
    """Return columns of a Parquet file as an Arrow table; equal texts are one object, as dictionaries.

    Raises InputError as `read_bytes`, if a column is missing, if the file has more than `most_rows` rows or unpacks to
    more than 1 GiB, and for errors of Arrow.
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
        leaves = [about.schema.column(number) for number in range(len(about.schema))]
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
        data.seek(0)
        with pq.ParquetFile(data, read_dictionary=texts) as file:
            for name in names:
                if name not in file.schema_arrow.names:
                    raise InputError(f"there is no column {name}", where=path, expected=", ".join(names))
            return file.read(names, use_threads=False).select(names)
    except (pa.ArrowException, OSError) as problem:
        raise InputError(f"the {what} cannot be read", where=path, expected="Parquet", got=problem) from problem
