"""Tables of numbers that pandas has pickled, read without unpickling: no name is looked up, nothing is called.

A pickle is a program. Here its steps are read by `pickletools.genops`, which decodes and does not run them, and what it
would build is written down: names stay names, and calls become records of what would be called with what. From these
records the arrays of NumPy and the blocks of pandas are told by their form, as pandas 1.0 to 2.2 write them by the
protocols 2 to 5 (compared with files of pandas 1.0.5, 1.2.5, 1.5.3 and 2.2.3). Any other name, step or form is refused.
"""

from __future__ import annotations

import gzip
import io
import pickletools
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from p2o import InputError
from p2o.files.input_file import read_bytes

_MAX_BYTES = 256 << 20
_MAX_STEPS = 100_000
_GZIP = b"\x1f\x8b"
_PLAIN = re.compile(r"(b1|[iu][1248]|f[248])")

_FRAME, _MANAGER, _BLOCK, _INDEX, _ARRAY, _BUFFER, _DTYPE, _SLICE, _ENCODE, _KIND = (
    *("frame", "manager", "block", "index", "array", "buffer", "dtype", "slice", "encode", "kind"),
)
_NAMES = {
    "pandas.core.frame.DataFrame": _FRAME,
    "pandas.core.internals.managers.BlockManager": _MANAGER,
    "pandas._libs.internals._unpickle_block": _BLOCK,
    "pandas.core.indexes.base._new_Index": _INDEX,
    "pandas.core.indexes.base.Index": _KIND,
    "pandas.core.indexes.range.RangeIndex": _KIND,
    "pandas.core.indexes.numeric.Int64Index": _KIND,
    "pandas.core.indexes.numeric.Float64Index": _KIND,
    "pandas.core.indexes.numeric.UInt64Index": _KIND,
    "numpy.core.multiarray._reconstruct": _ARRAY,
    "numpy._core.multiarray._reconstruct": _ARRAY,
    "numpy.core.numeric._frombuffer": _BUFFER,
    "numpy._core.numeric._frombuffer": _BUFFER,
    "numpy.ndarray": _KIND,
    "numpy.dtype": _DTYPE,
    "builtins.slice": _SLICE,
    "__builtin__.slice": _SLICE,
    "_codecs.encode": _ENCODE,
}
"""What the names mean that a table of numbers needs. They are compared, never looked up."""


@dataclass(frozen=True)
class _Name:
    """A name, and what it means here."""

    meaning: str


@dataclass
class _Made:
    """What a call of a name with arguments would make; `state` is what would be put into it afterwards."""

    meaning: str
    args: Any
    state: Any = None


# Whatever damage makes of the steps.
_DAMAGED = (*(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, MemoryError, RecursionError),)


class _OddError(Exception):
    """The pickle is no table of numbers; the text says why."""


def read_pickled_table(path: Path, what: str, columns: Sequence[str]) -> dict[str, Any]:
    """Return columns of a pickled table by name, each (N,) of numbers; the file may be packed by gzip.

    Raises InputError for a file that is missing, too large or damaged, for pickles of anything else, which are never
    loaded, and for columns that are missing or hold no numbers.
    """
    data = _unpacked(read_bytes(path, what, _MAX_BYTES), path, what)
    try:
        return _columns(_result(data), columns)
    except _OddError as problem:
        got = str(problem)
    except _DAMAGED as problem:
        got = str(problem) or type(problem).__name__
    raise InputError(
        f"the {what} is no table of numbers that pandas has pickled; other pickles are never loaded",
        where=path,
        expected=f"a DataFrame of pandas 1.0 to 2.2 with the columns {' '.join(columns)}",
        got=got[:200],
        hint="if you trust the file, read it with pandas and write its columns of numbers anew, with pandas below 3",
    )


def _unpacked(data: bytes, path: Path, what: str) -> bytes:
    if not data.startswith(_GZIP):
        return data
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
            plain = packed.read(_MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as problem:
        raise InputError(f"the {what} is damaged or cut off", where=path, expected="gzip", got=problem) from problem
    if len(plain) > _MAX_BYTES:
        raise InputError(f"the {what} unpacks to too much", where=path, expected=f"at most {_MAX_BYTES} bytes")
    return plain


@dataclass
class _Machine:
    """The stack and memo of a pickle; `marks` are the heights of the stack at which marks lie."""

    stack: list[Any] = field(default_factory=list)
    marks: list[int] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def since_mark(self) -> list[Any]:
        """Take what lies on the stack above the last mark, and the mark."""
        place = self.marks.pop()
        found = self.stack[place:]
        del self.stack[place:]
        return found

    def take(self, count: int) -> list[Any]:
        """Take some values off the stack, in the order in which they were put there; none below the last mark."""
        if len(self.stack) - (self.marks[-1] if self.marks else 0) < count:
            raise _OddError("steps that need more than there is")
        found = self.stack[-count:]
        del self.stack[-count:]
        return found

    def top(self, kind: type) -> Any:
        """Return what lies on top of the stack, of a kind."""
        if len(self.stack) <= (self.marks[-1] if self.marks else 0) or not isinstance(self.stack[-1], kind):
            raise _OddError("steps that do not fit each other")
        return self.stack[-1]


_PUSHED = frozenset(
    (
        *("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT"),
        *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
        *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    )
)
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


def _result(data: bytes) -> Any:
    """Return what a pickle would build, with records in place of objects."""
    machine = _Machine()
    for count, (step, arg, _) in enumerate(pickletools.genops(data)):
        if count > _MAX_STEPS:
            raise _OddError(f"more than {_MAX_STEPS} steps")
        if step.name == "STOP":
            [result] = machine.take(1)
            return result
        _step(machine, step.name, arg)
    raise _OddError("no end")


def _step(machine: _Machine, name: str, arg: Any) -> None:
    """Do one step of a pickle on records."""
    stack, memo = machine.stack, machine.memo
    if name in _PUSHED:
        stack.append(arg)
        return
    if name in _CONSTANTS:
        stack.append(_CONSTANTS[name])
        return
    if name in _TUPLES:
        stack.append(tuple(machine.take(_TUPLES[name])))
        return
    match name:
        case "PROTO" | "FRAME":
            pass
        case "MARK":
            machine.marks.append(len(stack))
        case "EMPTY_TUPLE":
            stack.append(())
        case "EMPTY_LIST":
            stack.append([])
        case "EMPTY_DICT":
            stack.append({})
        case "TUPLE":
            stack.append(tuple(machine.since_mark()))
        case "APPEND" | "APPENDS":
            values = machine.since_mark() if name == "APPENDS" else machine.take(1)
            machine.top(list).extend(values)
        case "SETITEM" | "SETITEMS":
            values = machine.since_mark() if name == "SETITEMS" else machine.take(2)
            machine.top(dict).update(zip(values[::2], values[1::2], strict=True))
        case "MEMOIZE":
            memo[len(memo)] = machine.top(object)
        case "BINPUT" | "LONG_BINPUT":
            memo[arg] = machine.top(object)
        case "BINGET" | "LONG_BINGET":
            stack.append(memo[arg])
        case "GLOBAL":
            stack.append(_name(str(arg).replace(" ", ".", 1)))
        case "STACK_GLOBAL":
            module, what = machine.take(2)
            stack.append(_name(f"{module}.{what}"))
        case "NEWOBJ" | "REDUCE":
            maker, args = machine.take(2)
            if not isinstance(maker, _Name) or not isinstance(args, tuple):
                raise _OddError("a call of what is no name")
            stack.append(_Made(maker.meaning, args))
        case "BUILD":
            [state] = machine.take(1)
            machine.top(_Made).state = state
        case _:
            raise _OddError(f"the step {name}")


def _name(said: str) -> _Name:
    if said not in _NAMES:
        raise _OddError(f"the name {said[:100]}, which no table of numbers needs")
    return _Name(_NAMES[said])


def _columns(made: Any, wanted: Sequence[str]) -> dict[str, Any]:
    """Return the wanted columns of a record of a DataFrame."""
    state = _is(made, _FRAME).state
    manager = _is(state.get("_mgr", state.get("_data")), _MANAGER)
    if isinstance(manager.state, tuple):  # pandas before 1.3
        inner = manager.state[3]["0.14.1"]
        axes = inner["axes"]
        blocks = [(block["values"], block["mgr_locs"]) for block in inner["blocks"]]
    else:
        made_blocks, axes = manager.args
        blocks = [_is(block, _BLOCK).args[:2] for block in made_blocks]
    labels = _labels(axes[0])
    found: dict[str, Any] = {}
    for values, places in blocks:
        rows = _places(places, len(labels))
        needed = [(row, labels[place]) for row, place in enumerate(rows) if labels[place] in wanted]
        if needed:
            array = _array(values)
            if not isinstance(array, np.ndarray) or array.ndim != 2 or len(array) != len(rows):
                raise _OddError(f"column {needed[0][1]} is none of numbers")
            found |= {label: array[row] for row, label in needed}
    lacking = next((name for name in wanted if name not in found), None)
    if lacking is not None:
        raise _OddError(f"no column {lacking} among {', '.join(map(str, labels))[:100]}")
    if len({len(column) for column in found.values()}) > 1:
        raise _OddError("columns of different lengths")
    return found


def _labels(index: Any) -> list[Any]:
    """Return the labels of a record of an Index of texts."""
    _, said = _is(index, _INDEX).args
    labels = _array(said["data"])
    if not isinstance(labels, list):
        raise _OddError("columns without names")
    return labels


def _places(said: Any, count: int) -> list[int]:
    """Return which columns the rows of a block are: a slice or an array of whole numbers."""
    if isinstance(said, _Made) and said.meaning == _SLICE:
        bounds = said.args
        if len(bounds) != 3 or not all(bound is None or type(bound) is int for bound in bounds):
            _no_array()
        return list(range(count))[slice(*bounds)]
    places = _array(said)
    if not isinstance(places, np.ndarray) or places.ndim != 1 or places.dtype.kind not in "iu" or len(places) > count:
        _no_array()
    found: list[int] = places.tolist()
    return found


def _array(made: Any) -> Any:
    """Return the array of a record; a list of objects for one of those."""
    if isinstance(made, _Made) and made.meaning == _ARRAY and isinstance(made.state, tuple) and len(made.state) == 5:
        _, shape, kind, fortran, raw = made.state
        order = "F" if fortran is True else "C"
    elif isinstance(made, _Made) and made.meaning == _BUFFER and len(made.args) == 4:
        raw, kind, shape, order = made.args
    else:
        _no_array()
    if isinstance(raw, list):
        return raw
    if isinstance(raw, _Made) and raw.meaning == _ENCODE and raw.args[1:] == ("latin1",):
        raw = raw.args[0].encode("latin1")
    dtype = _dtype(kind)
    count = 1
    for length in shape if isinstance(shape, tuple) else ():
        if type(length) is not int or length < 0:
            _no_array()
        count *= length
    if not isinstance(raw, bytes | bytearray) or order not in ("C", "F") or len(shape) not in (1, 2):
        _no_array()
    if count * dtype.itemsize != len(raw):
        raise _OddError(f"an array of {count} numbers of {dtype} in {len(raw)} bytes")
    flat = np.frombuffer(raw, dtype)
    return flat.reshape(shape, order="F") if order == "F" else flat.reshape(shape)


def _dtype(made: Any) -> np.dtype[Any]:
    """Return the type of plain numbers of a record."""
    said = _is(made, _DTYPE)
    kind = said.args[0] if said.args else None
    order = said.state[1] if isinstance(said.state, tuple) and len(said.state) > 1 else "|"
    if not isinstance(kind, str) or not _PLAIN.fullmatch(kind) or order not in ("<", ">", "|", "="):
        raise _OddError(f"an array of {str(kind)[:20]}")
    return np.dtype(order + kind)


def _is(made: Any, meaning: str) -> _Made:
    if not isinstance(made, _Made) or made.meaning != meaning:
        raise _OddError(f"no {meaning} where one should be")
    return made


def _no_array() -> NoReturn:
    raise _OddError("no array of numbers where one should be")
