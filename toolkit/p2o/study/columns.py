"""What the columns of a store hold: values to SQLite and back, and no value from outside that is not what it must be.

A store may come from anywhere, so nothing in it is believed: a text where a number belongs is an error, not a crash
somewhere else.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from p2o.errors import InputError
from p2o.files.parsed_text import parse_json
from p2o.geometry.pose_error import AXES
from p2o.results.result import Status
from p2o.results.verdict import Trust

METRICS = ("rotation_deg", "translation_m", *AXES)
"""The columns that say how far an estimate is from the truth; those of the axes are signed."""

RIVAL = ("rival_lead", "rival_rotation_deg", "rival_translation_m")
LIKELY = ("likely_rotation_deg", "likely_translation_m", "likely_rotation_deg_95", "likely_translation_m_95")

TIME = ("time_offset_s", "time_sigma_s")

# Odds and likely errors may be infinite; errors are not.
_FINITE = (*METRICS, "start_rotation_deg", "start_translation_m")
_REAL = (*_FINITE, "agreement", *RIVAL, *LIKELY, *TIME)
_INTEGER = ("joint", "seed")
_POSE = ("estimate", "start", "truth")
_OPTIONAL_TEXT = ("perturb", "why", "rival_unit", "time_use", "exception")

_LARGEST = 2**53
"""No count and no seed is larger, and integers up to here are floats without loss."""


def type_of(column: str) -> str:
    """Return the type of a column in SQL."""
    return "REAL" if column in _REAL else "INTEGER" if column in _INTEGER else "TEXT"


def json_text(value: Any) -> str:
    """Return a value as JSON; halves of surrogates, of which names of files may be made, are written out."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=False)
    return text if _is_text(text) else json.dumps(value, allow_nan=False)


def to_column(column: str, value: Any) -> Any:
    """Return a value as SQLite keeps it."""
    if value is None:
        return None
    if column in _POSE:
        return json_text(np.asarray(value).tolist())
    if column in _FORMS:
        return json_text(list(value) if column in ("frames", "rounds") else dict(value))
    # What a method raised may name a file whose name is no text.
    return (
        value if not isinstance(value, str) or _is_text(value) else value.encode("utf-8", "backslashreplace").decode()
    )


def from_column(column: str, value: Any) -> Any:
    """Return what SQLite has kept; raises InputError where it is nothing that `to_column` returns."""
    if column in _FORMS or column in _POSE:
        return _parsed(column, value)
    if value is None:
        if column in _REAL or column in _OPTIONAL_TEXT or column == "trust":
            return None
    elif column in _REAL:
        if isinstance(value, float | int) and (math.isfinite(value) or column not in _FINITE):
            return float(value)
    elif column in _INTEGER:
        if isinstance(value, int) and 0 <= value <= _LARGEST:
            return value
    elif isinstance(value, str):
        if column == "status" and value not in _STATUSES:
            raise _wrong(column, "the status of a result", value)
        if column == "trust":
            if value in _TRUSTS:
                return Trust(value)
            raise _wrong(column, "the word of a verdict", value)
        return value
    raise _wrong(column, {"REAL": "a number", "INTEGER": "a number >= 0", "TEXT": "text"}[type_of(column)], value)


def parsed_object(what: str, value: Any) -> dict[str, Any]:
    """Return the mapping that JSON of a store says; raises InputError for anything else."""
    found = _json(what, value)
    if not _is_mapping(found):
        raise _wrong(what, "a mapping", value)
    return dict(found)


def parsed_published(value: Any) -> tuple[Mapping[str, Any], ...]:
    """Return the published rows that JSON of a store says; raises InputError for anything else."""
    found = _json("published", value)
    if not _is_list_of(_is_published)(found):
        raise _wrong("published", "a list of rows with texts and values", value)
    return tuple(found)


def _parsed(column: str, value: Any) -> Any:
    if value is None and (column in _POSE or column == "judged"):
        return None
    read = _json(column, value)
    if column in _POSE:
        if not _is_pose(read):
            raise _wrong(column, "4 rows of 4 finite numbers", value)
        return np.array(read, dtype=np.float64)
    form, expected = _FORMS[column]
    if not form(read):
        raise _wrong(column, expected, value)
    return tuple(read) if isinstance(read, list) else read


def _json(what: str, value: Any) -> Any:
    if not isinstance(value, str):
        raise _wrong(what, "JSON", value)
    # Names of frames may be those of files that are no UTF-8.
    read = parse_json(value, f"column '{what}'", halves=True)
    if not _all_finite(read):
        raise _wrong(what, "JSON with finite numbers", value)
    return read


def _all_finite(value: Any) -> bool:
    """Return whether no number in a JSON value is NaN, infinite, or an integer too long for a float."""
    if isinstance(value, dict):
        return all(map(_all_finite, value.values()))
    if isinstance(value, list):
        return all(map(_all_finite, value))
    return not isinstance(value, float | int) or abs(value) <= sys.float_info.max


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _wrong(column: str, expected: str, value: Any) -> InputError:
    return InputError(f"column '{column}' of a store", expected=expected, got=repr(value)[:80])


# ---- the forms of JSON

_Form = Callable[[Any], bool]


def _is_mapping(value: Any) -> bool:
    return isinstance(value, dict)


def _is_string(value: Any) -> bool:
    return isinstance(value, str)


def _is_plain_number(value: Any) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    """Numbers that are not finite are texts in JSON."""
    return _is_plain_number(value) or value in ("inf", "-inf", "nan")


def _or_none(form: _Form) -> _Form:
    return lambda value: value is None or form(value)


def _is_list_of(form: _Form) -> _Form:
    return lambda value: isinstance(value, list) and all(map(form, value))


def _is_mapping_to(form: _Form) -> _Form:
    return lambda value: isinstance(value, dict) and all(map(form, value.values()))


def _is_round(value: Any) -> bool:
    numbers = ("reach_px", "mean_residual", "cost", "step_deg", "step_m")
    return (
        _is_mapping(value)
        and _is_string(value.get("stage", ""))
        and _or_none(_is_mapping_to(_is_plain_number))(value.get("matches"))
        and all(_or_none(_is_number)(value.get(name)) for name in numbers)
    )


def _is_judged(value: Any) -> bool:
    return (
        _is_mapping(value)
        and all(_is_string(value.get(name)) for name in ("judge", "unit"))
        and all(name in value and _or_none(_is_number)(value[name]) for name in ("start", "estimate"))
    )


def _is_published(value: Any) -> bool:
    return (
        _is_mapping(value)
        and _is_mapping_to(_is_plain_number)(value.get("values", {}))
        and all(_is_string(part) for word, part in value.items() if word != "values")
    )


def _is_pose(value: Any) -> bool:
    rows = _is_list_of(lambda row: isinstance(row, list) and len(row) == 4 and all(map(_is_plain_number, row)))
    return rows(value) and len(value) == 4


_STATUSES = {status.value for status in Status}
_TRUSTS = {trust.value for trust in Trust}
_FORMS: dict[str, tuple[_Form, str]] = {
    "frames": (_is_list_of(_is_string), "a list of names"),
    "rounds": (_is_list_of(_is_round), "a list of rounds"),
    "judged": (_is_judged, "judge, unit, start and estimate"),
    "matches": (_is_mapping_to(_is_plain_number), "counts by name"),
    "seconds": (_is_mapping_to(_or_none(_is_number)), "numbers by name"),
    "recipe": (_is_mapping, "a mapping"),
    "versions": (_is_mapping_to(_is_string), "texts by name"),
    "inputs": (_is_mapping, "a mapping"),
}
"""What JSON of a column has to be, and how to say it."""
