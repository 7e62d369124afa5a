"""Results as JSON and back without loss: floats keep every bit, arrays are lists, a status is its word.

The dataclasses are the schema (`p2o.results.json_types`). NaN is null, infinities are the texts "inf" and "-inf".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from p2o.errors import InputError
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import json_text
from p2o.results.check import Check, Watch
from p2o.results.figures import figure_values
from p2o.results.json_types import Schema, json_tree
from p2o.results.result import Result, RigResult

_SCHEMAS: dict[type, Schema] = {kind: Schema(kind) for kind in (Result, RigResult, Check, Watch)}
_NOT_RESULT = ("camera", "error", "start_error", "figures")
"""Keys of p2o's JSON that are not fields of a Result: they follow from other values."""


def result_to_dict(result: Result) -> dict[str, Any]:
    """Return a result as dicts, lists, numbers, texts and None, in the order of its fields; JSON takes it as it is.

    Values that follow from the fields are written for readers of the file: the word of the verdict, odds ratio and
    strength of the agreement, and `figures`, the figures of `p2o.results.figures` by name. Raises InputError if the
    recipe holds something that JSON has no form for.
    """
    return {**_SCHEMAS[Result].plain(result), "figures": json_tree("figures", figure_values(result))}


def to_dict(value: RigResult | Check | Watch) -> dict[str, Any]:
    """Return the common result of a rig, or a check, as dicts, lists, numbers, texts and None, fields in order."""
    plain: dict[str, Any] = _SCHEMAS[type(value)].plain(value)
    return plain


def result_from_dict(value: Any) -> Result:
    """Return the result of the output of `result_to_dict`; every number is the same to the last bit.

    A result object of `p2o run --json` is accepted, too; the name of its camera and its errors against the ground
    truth, which are not part of a Result, are ignored, and so are `figures`. Tuples within the recipe come back as
    lists. Raises InputError for a missing or unknown field, a value of another type or a pose that is not rigid; the
    text names the field.
    """
    if not isinstance(value, Mapping):
        raise InputError("the result is not an object", got=repr(value)[:60])
    value = {key: part for key, part in value.items() if key not in _NOT_RESULT}
    # A default stands for what a method did not estimate, not for a key that was removed from a file.
    missing = [field.name for field in fields(Result) if field.name not in value]
    if missing:
        raise InputError("the result lacks fields", expected=", ".join(missing))
    result: Result = _SCHEMAS[Result].read(value, "the result")
    return result


def result_to_json(result: Result) -> str:
    """Return a result as JSON text with indentation, ending in a newline."""
    return json_text(result_to_dict(result))


def result_from_json(text: str) -> Result:
    """Return the result of JSON text; raises InputError as `result_from_dict`, and for text that is not JSON."""
    return result_from_dict(parse_json(text, "result"))
