"""Messages of ONNX models in the wire format of protobuf: what a graph of nodes and constants needs of onnx.proto.

Only the tests need the package onnx, of 30 MB. The numbers of fields and types are those of onnx.proto, ONNX 1.12.
A message is a list of pieces, which are joined once, because constants are large.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

FLOAT, UINT8 = 1, 2
"""Numbers of types of numbers."""
_TYPES = {np.dtype(np.float32): FLOAT, np.dtype(np.uint8): UINT8, np.dtype(np.int64): 7}
_INT, _STRING, _INTS = 2, 3, 7
_IR_VERSION = 8
Message = list[bytes]


def _field(number: int, value: int | str | Message) -> Message:
    """Return one field of a message: an integer >= 0, a text or a message."""
    if isinstance(value, int):
        return [_varint(number << 3) + _varint(value)]
    content = [value.encode()] if isinstance(value, str) else value
    return [_varint(number << 3 | 2) + _varint(sum(map(len, content))), *content]


def _varint(value: int) -> bytes:
    """Return an integer >= 0 in groups of 7 bits, the lowest first."""
    groups = [value >> shift & 127 for shift in range(0, max(value.bit_length(), 1), 7)]
    return bytes([*(group | 128 for group in groups[:-1]), groups[-1]])


def _fields(number: int, values: Iterable[int | str | Message]) -> Message:
    return [piece for value in values for piece in _field(number, value)]


def node(kind: str, inputs: Sequence[str], output: str, **attributes: int | str | Sequence[int]) -> Message:
    """Return a node (NodeProto) with one output."""
    described: Message = []
    for name, value in sorted(attributes.items()):
        if isinstance(value, int):
            content = _field(3, value) + _field(20, _INT)
        elif isinstance(value, str):
            content = _field(4, value) + _field(20, _STRING)
        else:
            content = _fields(8, value) + _field(20, _INTS)
        described += _field(5, _field(1, name) + content)
    return _fields(1, inputs) + _field(2, output) + _field(4, kind) + described


def constant(name: str, values: Any) -> Message:
    """Return a constant (TensorProto), an array of float32, uint8 or int64; scalars have the size (1,)."""
    array = np.ascontiguousarray(values)
    content = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
    return _fields(1, array.shape) + _field(2, _TYPES[array.dtype]) + _field(8, name) + _field(9, [content])


def tensor(name: str, kind: int, size: Sequence[int]) -> Message:
    """Return the description of an input or output (ValueInfoProto) of a type and size."""
    shape = _fields(1, (_field(1, length) for length in size))
    return _field(1, name) + _field(2, _field(1, _field(1, kind) + _field(2, shape)))


def model(
    name: str, nodes: Iterable[Message], constants: Iterable[Message], ends: Sequence[Message], opset: int
) -> bytes:
    """Return a model (ModelProto) of a graph with one input and one output, `ends`, for a version of the operators."""
    graph = _fields(1, nodes) + _field(2, name) + _fields(5, constants) + _field(11, ends[0]) + _field(12, ends[1])
    return b"".join(_field(1, _IR_VERSION) + _field(7, graph) + _field(8, _field(1, "") + _field(2, opset)))
