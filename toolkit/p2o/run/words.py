"""The words of the command line and of study files: DATASET:PATH, [NAME=]DATASET:PATH, STAGE.FIELD=VALUE."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded
from p2o.files.parsed_text import parse_yaml
from p2o.host.slots import STAGES


@dataclass(frozen=True)
class NamedData:
    """A text [NAME=]DATASET:PATH: `name` is "" where it says none, `data` is DATASET:PATH."""

    name: str
    data: str

    @classmethod
    def of(cls, text: str) -> NamedData:
        """Return the two parts of a text; a "=" after the first ":", "/" or "?" belongs to the path or its options."""
        match = re.fullmatch(r"\s*([^=:/?\\]+?)\s*=\s*(.+)", text, re.DOTALL)
        return cls("", text) if match is None else cls(match[1], match[2])


def data_by_name(texts: Iterable[str], names: Collection[str], owner: str) -> dict[str, str]:
    """Return DATASET:PATH by name of the datasets `names` of `owner` (such as "study smoke") that the texts are for.

    A text without NAME is for the only dataset; the last of two for one dataset wins. Raises UnknownNameError for
    other names, InputError where it is not said which of several datasets is meant.
    """
    found: dict[str, str] = {}
    for text in texts:
        said = NamedData.of(text)
        if not said.name and len(names) > 1:
            raise InputError(
                f"it is not said which dataset of {owner} is meant",
                where="--data",
                expected="NAME=DATASET:PATH with a NAME of " + ", ".join(names),
                got=text,
            )
        name = said.name or next(iter(names), "")
        if name not in names:
            raise UnknownNameError(f"dataset of {owner}", name, names, where="--data")
        found[name] = said.data
    return found


def split_data(text: str) -> tuple[str, dict[str, Any]]:
    """Return the dataset name and the options that DATASET:PATH states.

    `kitti-raw:build/data` gives root; `synthetic:?scenes=4&seed=1` gives options; both may be there.
    """
    name, colon, rest = text.partition(":")
    if not colon and ("/" in name or os.path.exists(name)):
        raise InputError("data need a dataset name", expected="DATASET:PATH, such as kitti-raw:PATH", got=text)
    options: dict[str, Any] = {}
    query = re.fullmatch(r"(.*?)\?((?:[a-z0-9_]+=[^&]*)(?:&[a-z0-9_]+=[^&]*)*)?", rest, re.DOTALL)
    if query is not None:
        rest = query[1]
        for key, value in parse_qsl(query[2] or "", keep_blank_values=True):
            if key in options:
                raise InputError(f"the option {key} is said twice", expected="each once", got=text)
            options[key] = value_of(value)
    if rest:
        options["root"] = str(expanded(rest))
    return name, options


def value_of(text: str) -> Any:
    """Return the value that a text on the command line states: YAML lists, mappings and null, else the text itself.

    Numbers and switches stay text: the option's own type decides what they mean.
    """
    if text in ("null", "~"):
        return None
    if text[:1] in ("[", "{"):
        return parse_yaml(text, "value", text if len(text) <= 80 else f"{text[:77]}...")
    return text


def parse_settings(settings: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return options by stage from texts STAGE.FIELD=VALUE; the last of two for one field wins.

    Raises InputError for other texts and for a value beside options of its name, UnknownNameError for unknown stages.
    """
    options: dict[str, dict[str, Any]] = {}
    said: dict[tuple[str, ...], Any] = {}
    for text in settings:
        path, value = _setting(text, "STAGE.FIELD=VALUE: matcher.huber_px=2", least=2)
        if path[0] not in STAGES:
            raise UnknownNameError("stage", path[0], STAGES, where="--set")
        _check_beside(said, path, text)
        said[tuple(path)] = value
        options = _with(options, path, value)
    return options


def parse_fields(
    settings: Iterable[str], values: Mapping[str, Any] | None = None, *, example: str = "seed=1"
) -> dict[str, Any]:
    """Return options from texts FIELD=VALUE over those of `values`, which stays as it is.

    OUTER.FIELD=VALUE sets an option of options. Raises InputError, with the example, for other texts, and for a value
    beside options of its name.
    """
    options = dict(values or {})
    said: dict[tuple[str, ...], Any] = {}
    for text in settings:
        path, value = _setting(text, f"FIELD=VALUE: {example}")
        _check_beside(said, path, text)
        said[tuple(path)] = value
        options = _with(options, path, value)
    return options


def _check_beside(said: Mapping[tuple[str, ...], Any], path: list[str], text: str) -> None:
    """Raise InputError where a setting would silently replace another one that is not for the same field.

    A mapping may be followed by single options in it.
    """
    for other, value in said.items():
        inside = other[: len(path)] == tuple(path) and len(other) > len(path)
        outside = tuple(path[: len(other)]) == other and len(other) < len(path) and not isinstance(value, Mapping)
        if inside or outside:
            raise InputError(
                f"{'.'.join(other)} is set already", where="--set", expected="a value, or options in it", got=text
            )


def _setting(text: str, expected: str, least: int = 1) -> tuple[list[str], Any]:
    """Return the names before the "=", at least so many, and the value behind it."""
    names, equals, value = text.strip().partition("=")
    path = names.split(".")
    if not equals or len(path) < least or not all(re.fullmatch(r"[A-Za-z0-9_-]+", name) for name in path):
        raise InputError("cannot read the setting", where="--set", expected=expected, got=text)
    return path, value_of(value)


def _with(options: Mapping[str, Any], path: list[str], value: Any) -> dict[str, Any]:
    """Return the options with one more set; a single value on the way gives room to options of its name."""
    name, *rest = path
    if not rest:
        return {**options, name: value}
    inner = options.get(name)
    return {**options, name: _with(inner if isinstance(inner, Mapping) else {}, rest, value)}
