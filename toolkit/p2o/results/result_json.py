"""A result as JSON and back, without loss: floats keep every bit, arrays are lists, a status is its word.

The dataclasses are the schema: what is read follows from the types of their fields. JSON has no word for what is not
finite: NaN is null, infinities are the texts "inf" and "-inf".
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from p2o.arrays import checked, parts
from p2o.errors import InputError
from p2o.files.parsed_text import parse_json
from p2o.geometry import se3
from p2o.geometry.pose_error import AXES
from p2o.results.accuracy import Accuracy
from p2o.results.check import Check, Watch
from p2o.results.evidence import Agreement
from p2o.results.result import Result
from p2o.results.rig import RigResult
from p2o.results.verdict import Verdict

_SAID: Mapping[type, tuple[str, ...]] = {Verdict: ("trust",), Agreement: ("odds_ratio", "strength")}
"""Properties that are written for the reader; they follow from the fields, and are not read."""

_POSES = ("start", "camera_from_lidar", "found")
_SHAPES: dict[str, tuple[int, ...]] = {**dict.fromkeys(_POSES, (4, 4)), "covariance": (6, 6), "twist": (6,)}

_LATER: Mapping[type, tuple[str, ...]] = {
    Accuracy: AXES,
    Agreement: ("places",),
    Result: ("start_weight", "intrinsics"),
}
"""Fields that results written before there were any do not have; they are then what they are by default."""

_KINDS = {str: "a text", bool: "true or false", int: "a whole number"}


def result_to_dict(result: Result) -> dict[str, Any]:
    """Return a result as dicts, lists, numbers, texts and None, in the order of its fields; JSON takes it as it is.

    The word of the verdict and the odds ratio of the agreement are written too, though they follow from the rest.
    Raises InputError if the recipe holds something that JSON has no form for.
    """
    return {name: _plain(name, value) for name, value in parts(result) or ()}


def rig_to_dict(result: RigResult) -> dict[str, Any]:
    """Return the common result of a rig as dicts, lists, numbers, texts and None, in the order of its fields."""
    return {name: _plain(name, value) for name, value in parts(result) or ()}


def check_to_dict(check: Check | Watch) -> dict[str, Any]:
    """Return what edges say of an extrinsic as dicts, lists, numbers, texts and None, in the order of its fields."""
    return {name: _plain(name, value) for name, value in parts(check) or ()}


def check_from_dict(value: Any) -> Check:
    """Return the check of what `check_to_dict` gave; raises InputError as `result_from_dict`."""
    found: Check = _read("the check", Check, value)
    return found


def watch_from_dict(value: Any) -> Watch:
    """Return the watch of what `check_to_dict` gave; raises InputError as `result_from_dict`."""
    found: Watch = _read("the watch", Watch, value)
    return found


def result_from_dict(value: Any) -> Result:
    """Return the result of what `result_to_dict` gave; every number is the same to the last bit.

    An object of `p2o run` is taken too; the name of its camera and its errors against the truth, which are no part of a
    Result, are left out.
    Tuples within the recipe come back as lists. Raises InputError for a missing or unknown field, a value of another
    kind, a pose that is not rigid, or a result of an earlier version of p2o; the text names the field.
    """
    if isinstance(value, Mapping):
        if "directed_cost_px" in value and "verdict" not in value:
            raise InputError(
                "the result was written by an earlier version of p2o",
                expected="a result with a verdict",
                got=f"versions {value.get('versions')}",
                hint="calibrate again, or read it with the version that wrote it",
            )
        value = {key: part for key, part in value.items() if key not in ("camera", "error", "start_error")}
    result: Result = _read("the result", Result, value)
    return result


def result_to_json(result: Result) -> str:
    """Return a result as JSON text of one line a field or round, ending in a newline."""
    return json.dumps(result_to_dict(result), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def result_from_json(text: str) -> Result:
    """Return the result of JSON text; raises InputError as `result_from_dict`, and for text that is not JSON."""
    value = parse_json(text, "result")
    return result_from_dict(value)


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    inner = parts(value)
    if inner is not None:
        said = {word: _plain(word, getattr(value, word)) for word in _SAID.get(type(value), ())}
        plain = said | {str(key): _plain(f"{name}.{key}", part) for key, part in inner}
        return list(plain.values()) if isinstance(value, Sequence) else plain
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, str):
        return str(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    raise InputError(f"{name} has no form in JSON", expected="numbers, texts, lists, dicts", got=type(value).__name__)


def _read(name: str, kind: Any, value: Any) -> Any:
    """Return the value of a field of this type; `name` is what errors call it."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        [kind] = [one for one in inner if one is not NoneType]
        return None if value is None else _read(name, kind, value)
    if origin is tuple:
        [length] = _SHAPES.get(name.rpartition(".")[2], (None,))
        entries = _list(name, value, length)
        return tuple(_read(f"{name}.{place}", inner[0], entry) for place, entry in enumerate(entries))
    if origin is Mapping:
        return {key: _read(f"{name}.{key}", inner[1], part) for key, part in _object(name, value).items()}
    if origin is np.ndarray:
        return _array(name, value)
    if is_dataclass(kind):
        return _dataclass(name, kind, _object(name, value))
    if kind is float:
        return _number(name, value)
    if kind in _KINDS:
        if type(value) is not kind:
            raise _wrong(name, _KINDS[kind], value)
        return value
    if kind is Any:
        return value
    assert issubclass(kind, StrEnum), f"{kind} of {name} has no form in JSON"
    if value not in list(kind):
        raise InputError(f"{name} is unknown", expected=" or ".join(kind), got=repr(value)[:60])
    return kind(value)


def _dataclass(name: str, kind: Any, value: Mapping[str, Any]) -> Any:
    types = _types(kind)
    missing = [key for key in types if key not in value and key not in _LATER.get(kind, ())]
    unknown = [key for key in value if key not in types and key not in _SAID.get(kind, ())]
    if missing or unknown:
        said = [f"{', '.join(keys)} {word}" for keys, word in ((missing, "missing"), (unknown, "unknown")) if keys]
        raise InputError(f"{name} has other fields", expected=", ".join(types), got="; ".join(said))
    before = "" if kind in (Result, Check, Watch) else f"{name}."
    return kind(**{key: _read(before + key, type_, value[key]) for key, type_ in types.items() if key in value})


@cache
def _types(kind: Any) -> dict[str, Any]:
    """Return the type of each field of a dataclass."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _array(name: str, value: Any) -> Any:
    key = name.rpartition(".")[2]
    shape = _SHAPES[key]
    array = checked(name, _numbers(name, value, shape), shape, np.float64, finite=False)
    if key in _POSES:
        # What p2o wrote is rigid to the last digits. The cleaned rotation is not taken: bits of the file stay.
        se3.check_rigid(name, array, tolerance=1e-9)
    return array


def _numbers(name: str, value: Any, shape: Sequence[int]) -> Any:
    if not shape:
        return _number(name, value)
    return [_numbers(name, entry, shape[1:]) for entry in _list(name, value, shape[0])]


def _number(name: str, value: Any) -> float:
    if value is None:
        return math.nan
    if value in ("inf", "-inf"):
        return float(value)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise _wrong(name, "a number", value)
    return float(value)


def _list(name: str, value: Any, length: int | None = None) -> Sequence[Any]:
    if not isinstance(value, list | tuple) or length not in (None, len(value)):
        raise _wrong(name, "a list" if length is None else f"a list of {length}", value)
    return value


def _object(name: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise _wrong(name, "an object", value)
    return value


def _wrong(name: str, expected: str, got: Any) -> InputError:
    return InputError(f"{name} is not {expected}", got=repr(got)[:60])
