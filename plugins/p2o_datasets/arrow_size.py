"""Measure a stream of Apache Arrow (IPC) before it is unpacked: pyarrow unpacks without a bound.

The format follows apache/arrow: format/Message.fbs and docs/source/format/Columnar.rst (compressed buffers start with
their uncompressed length).
"""

from __future__ import annotations

from struct import unpack_from
from typing import Any

_DICTIONARY, _BATCH = 2, 3
"""Numbers of the kinds of messages that contain buffers."""


def stream_size(stream: Any) -> tuple[int, int]:
    """Return the number of rows and of unpacked bytes of a stream, which includes dictionaries.

    Raises exceptions of pyarrow, struct.error and ValueError for damaged streams.
    """
    import pyarrow as pa

    rows = size = 0
    for message in pa.ipc.MessageReader.open_stream(stream):
        batch_rows, batch_size = _batch_size(bytes(message.metadata), message.body)
        rows, size = rows + batch_rows, size + batch_size
    return rows, size


def _batch_size(head: bytes, body: Any) -> tuple[int, int]:
    message = _position(head, 0)
    kind_at, header_at = _field(head, message, 1), _field(head, message, 2)
    kind = head[kind_at] if kind_at else 0
    if kind not in (_DICTIONARY, _BATCH) or not header_at:
        return 0, 0
    batch = _position(head, header_at)
    if kind == _DICTIONARY:
        batch = _position(head, _required(_field(head, batch, 1)))
    rows_at, buffers_at = _field(head, batch, 0), _field(head, batch, 2)
    rows = unpack_from("<q", head, rows_at)[0] if rows_at else 0
    if not buffers_at:
        return rows, 0
    buffers, is_packed, size = _position(head, buffers_at), _field(head, batch, 3) > 0, 0
    for number in range(unpack_from("<I", head, buffers)[0]):
        start, length = unpack_from("<qq", head, buffers + 4 + 16 * number)
        if start < 0 or length < 0 or start + length > (body.size if body else 0):
            raise ValueError("a buffer outside of its message")
        unpacked = unpack_from("<q", body, start)[0] if is_packed and length else -1
        size += length if unpacked < 0 else unpacked
    return max(rows, 0), size


def _position(head: bytes, at: int) -> int:
    """Return the position to which the offset at a position of a flatbuffer points."""
    return at + int(unpack_from("<I", head, at)[0])


def _field(head: bytes, table: int, number: int) -> int:
    """Return the position of a field of a table of a flatbuffer, 0 without it."""
    fields = table - unpack_from("<i", head, table)[0]
    if fields < 0 or 4 + 2 * number >= unpack_from("<H", head, fields)[0]:
        return 0
    offset = unpack_from("<H", head, fields + 4 + 2 * number)[0]
    return table + int(offset) if offset else 0


def _required(position: int) -> int:
    if not position:
        raise ValueError("a dictionary without values")
    return position
