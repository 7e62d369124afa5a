"""Convert the columns of a store to SQLite and back; every value that is read is validated against its type.

A store may be foreign: a value of another type is an error that names the column.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from operator import itemgetter
from typing import Annotated, Any

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.parsed_text import parse_json
from p2o.geometry.pose_error import AXES
from p2o.results import figures
from p2o.results.json_types import Count, JsonArray, Number, Schema, Tree
from p2o.results.result import Round, Status
from p2o.results.verdict import Trust
from pydantic import AllowInfNan, Field, Strict

METRICS = ("rotation_deg", "translation_m", *AXES)
"""The columns of the error of an estimate against the ground truth; those of the axes are signed."""

_LARGEST_INDEX = 2**53
_Index = Annotated[int, Strict(), Field(ge=0, le=_LARGEST_INDEX)]
"""A count or a seed; integers up to 2**53 are floats without loss."""
_Figure = Annotated[float, Strict(), AllowInfNan(True)]
"""A figure of a result: predicted errors and odds may be infinite, errors may not."""
_Error = Annotated[float, Strict(), AllowInfNan(False)]
_MAYBE_ERROR, _MAYBE_FIGURE = _Error | None, _Figure | None
_SQL = {_MAYBE_ERROR: "REAL", _MAYBE_FIGURE: "REAL", _Index: "INTEGER", _Index | None: "INTEGER"}
"""SQL types of the types of columns; all others are TEXT."""
_Pose = Annotated[Float, JsonArray((4, 4), finite=True)]
_Text = Annotated[str, Strict()]

_TYPES: dict[str, Any] = {
    **dict.fromkeys((*METRICS, "start_rotation_deg", "start_translation_m"), _MAYBE_ERROR),
    **dict.fromkeys(("joint", "seed"), _Index),
    **dict.fromkeys(("perturb", "why", "exception"), _Text | None),
    **dict.fromkeys(("estimate", "start", "truth"), _Pose | None),
    "trust": Trust | None,
    "frames": tuple[_Text, ...],
    "rounds": tuple[Round, ...],
    "matches": Mapping[str, Count],
    "seconds": Mapping[str, Number],
    "recipe": Tree,
    "versions": Mapping[str, _Text],
    "inputs": Tree,
    "machine": Tree,
}
"""Types of the columns that are not figures; all others are texts."""
_FIGURES: dict[type, Any] = {float: _MAYBE_FIGURE, int: _Index | None, str: _Text | None}
"""Types of the columns of figures by the type of the figure."""
_JSON = {"estimate", "start", "truth", "frames", "rounds", "matches", "seconds", "recipe", "versions", "inputs"}
_JSON |= {"machine"}

_ROUND_FIELDS = itemgetter(*(field.name for field in fields(Round)))
_NUMBER_KINDS = (float, type(None))
_ROUND_KINDS = frozenset(itertools.product((str,), _NUMBER_KINDS, (dict,), *(4 * [_NUMBER_KINDS]), (bool,)))
"""Types of the fields of a round in JSON, as Python parses it."""


def figure_columns() -> tuple[str, ...]:
    """Return the columns that the figures of a result have."""
    return tuple(figure.name for figure in figures.FIGURES)


def type_of(column: str) -> str:
    """Return the type of a column in SQL."""
    return _SQL.get(_kind(column), "TEXT")


def json_text(value: Any) -> str:
    """Return a value as JSON; lone surrogates, which names of files may contain, are escaped."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=False)
    return text if _is_text(text) else json.dumps(value, allow_nan=False)


def to_column(column: str, value: Any) -> Any:
    """Return a value as SQLite stores it; raises InputError where JSON has no form for it."""
    if value is None:
        return None
    if column in _JSON:
        return json_text(_schema(_kind(column)).plain(value))
    # The message of an exception may name a file whose name is not valid UTF-8.
    return (
        value if not isinstance(value, str) or _is_text(value) else value.encode("utf-8", "backslashreplace").decode()
    )


def from_column(column: str, value: Any) -> Any:
    """Return the value that SQLite has stored; raises InputError where it is not one that `to_column` returns."""
    kind = _kind(column)
    # The most frequent values, as the schema reads them and many times faster.
    if type(value) is float and math.isfinite(value) and (kind is _MAYBE_ERROR or kind is _MAYBE_FIGURE):
        return value
    if type(value) is str and kind is _Text and column != "status":
        return value
    if type(value) is int and kind is _Index and 0 <= value <= _LARGEST_INDEX:
        return value
    if column == "rounds" and (rounds := _usual_rounds(value)) is not None:
        return rounds
    plain = _json(column, value) if column in _JSON and value is not None else value
    try:
        read = _schema(kind).read(plain, column)
    except InputError as problem:
        raise _wrong(column, problem.expected or problem.what, value) from problem
    if column == "status" and read not in list(Status):
        raise _wrong(column, f"one of {', '.join(Status)}", value)
    return read


def parsed_object(what: str, value: Any) -> dict[str, Any]:
    """Return the mapping in a JSON text of a store; raises InputError for anything else."""
    parsed = _json(what, value)
    if not isinstance(parsed, dict):
        raise _wrong(what, "a mapping", value)
    return parsed


def parsed_published(value: Any) -> tuple[Mapping[str, Any], ...]:
    """Return the published rows in a JSON text of a store; raises InputError for anything else."""
    parsed = _json("published", value)
    if not isinstance(parsed, list) or not all(map(_is_published, parsed)):
        raise _wrong("published", "a list of rows with texts and values", value)
    return tuple(parsed)


def _is_published(value: Any) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("values", {}), dict):
        return False
    numbers = value.get("values", {}).values()
    texts = (part for word, part in value.items() if word != "values")
    return all(type(number) in (int, float) for number in numbers) and all(isinstance(text, str) for text in texts)


@cache
def _kind(column: str) -> Any:
    """Return the type of a column."""
    if column in _TYPES:
        return _TYPES[column]
    return next((_FIGURES[figure.kind] for figure in figures.FIGURES if figure.name == column), _Text)


@cache
def _schema(kind: Any) -> Schema:
    return Schema(kind)


def _json(what: str, value: Any) -> Any:
    if not isinstance(value, str):
        raise _wrong(what, "JSON", value)
    # Names of frames may contain lone surrogates: file names that are not valid UTF-8.
    parsed = parse_json(value, f"column '{what}'", halves=True)
    if not _all_finite(parsed):
        raise _wrong(what, "JSON with finite numbers", value)
    return parsed


def _usual_rounds(text: Any) -> tuple[Round, ...] | None:
    """Return rounds whose JSON has the types of their fields; None for all others, which the schema reads or refuses.

    This reads the same values as the schema and is several times faster: a report reads a million rounds.
    """
    if type(text) is not str or not text.startswith("["):
        return None
    rounds = []
    try:
        for entry in json.loads(text):
            stage, reach_px, matches, residual, cost, step_deg, step_m, accepted = values = _ROUND_FIELDS(entry)
            numbers = [
                math.nan if number is None else number for number in (reach_px, residual, cost, step_deg, step_m)
            ]
            # A sum that overflows is left to the schema, too.
            is_usual = (
                len(entry) == len(values)
                and tuple(map(type, values)) in _ROUND_KINDS
                and set(map(type, matches.values())) <= {int}
                and math.isfinite(sum(number for number in values if type(number) is float))
            )
            if not is_usual or any(count.bit_length() > 64 for count in matches.values()):
                return None
            reach_px, residual, cost, step_deg, step_m = numbers
            rounds.append(Round(stage, reach_px, matches, residual, cost, step_deg, step_m, accepted))
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return tuple(rounds)


def _all_finite(value: Any) -> bool:
    """Return whether no number in a JSON value is NaN, infinite, or an integer too long for a float."""
    kind = type(value)
    if kind is dict or kind is list:
        return all(map(_all_finite, value.values() if kind is dict else value))
    return kind is str or not isinstance(value, float | int) or abs(value) <= sys.float_info.max


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _wrong(column: str, expected: object, value: Any) -> InputError:
    return InputError(f"column '{column}' of a store", expected=expected, got=repr(value)[:80])
