"""Parse the texts of the command line and of study files: DATASET:PATH, [NAME=]DATASET:PATH, STAGE.FIELD=VALUE."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded, nearest
from p2o.files.parsed_text import parse_yaml
from p2o.host.registry import Registry, watch
from p2o.host.slots import STAGES, Kind


@dataclass(frozen=True)
class NamedData:
    """A text [NAME=]DATASET:PATH: `name` is "" if absent, `data` is DATASET:PATH."""

    name: str
    data: str

    @classmethod
    def of(cls, text: str) -> NamedData:
        """Split a text into its two parts; a "=" after the first ":", "/" or "?" belongs to the path or its options."""
        match = re.fullmatch(r"\s*([^=:/?\\]+?)\s*=\s*(.+)", text, re.DOTALL)
        return cls("", text) if match is None else cls(match[1], match[2])


def data_by_name(texts: Iterable[str], names: Collection[str], owner: str) -> dict[str, str]:
    """Return DATASET:PATH by name of the datasets `names` of `owner` (such as "study smoke") that the texts are for.

    A text without NAME is for the only dataset; the last of two for one dataset wins. Raises UnknownNameError for
    other names, InputError where it is not said which of several datasets is meant.
    """
    data: dict[str, str] = {}
    for text in texts:
        named = NamedData.of(text)
        if not named.name and len(names) > 1:
            message = f"it is not said which dataset of {owner} is meant"
            expected = "NAME=DATASET:PATH with a NAME of " + ", ".join(names)
            raise InputError(message, where="--data", expected=expected, got=text)
        name = named.name or next(iter(names), "")
        if name not in names:
            raise UnknownNameError(f"dataset of {owner}", name, names, where="--data")
        data[name] = named_data(named.data)
    return data


def named_data(text: str, registry: Registry | None = None) -> str:
    """Return DATASET:PATH of a text that may be a PATH alone, whose dataset is inferred from its files.

    A text is a path if it contains a separator before any colon, begins with ~, or exists and has no colon. Raises
    InputError as `data_kind`.
    """
    name, colon, _ = text.partition(":")
    if not (set("/\\") & set(name) or name[:1] in ("~", ".") or (not colon and os.path.exists(name))):
        return text
    path, query, _ = text.partition("?")
    return f"{data_kind(expanded(path if query else text), registry)}:{text}"


def data_kind(path: Path, registry: Registry | None = None) -> str:
    """Return the only dataset of a registry (by default that of the process) that recognises a file or folder.

    Raises InputError if none or several do, PluginError if one of them fails.
    """
    if not path.exists():
        expected = "DATASET:PATH, or an existing path"
        raise InputError("no such file or folder", where=path, expected=expected, hint=nearest(path))
    kinds = []
    for offer in (Registry.of_process() if registry is None else registry).of_kind(Kind.DATASET):
        if offer.method.recognises is not None:
            with watch(offer, f"recognising {path}"):
                kinds += [offer.name] if offer.method.recognises(path) else []
    if len(kinds) != 1:
        text = f"the path could be of several datasets: {', '.join(kinds)}" if kinds else "no dataset recognises it"
        hint = f"name it: DATASET:PATH, such as {kinds[0] if kinds else 'folder'}:{path}"
        raise InputError(text, where=path, hint=hint)
    return kinds[0]


def split_data(text: str, registry: Registry | None = None) -> tuple[str, dict[str, Any]]:
    """Return the dataset name and the options of DATASET:PATH, or of a PATH as in `named_data`.

    `kitti-raw:build/data` gives root; `synthetic:?scenes=4&seed=1` gives options; both may be there.
    """
    return split_name(named_data(text, registry))


def split_name(text: str) -> tuple[str, dict[str, Any]]:
    """Return the name and the options of NAME:PATH?OPTION=VALUE&...; the path is the option `root`."""
    name, _, rest = text.partition(":")
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
    """Parse a value of the command line: YAML lists, mappings and null, else the text itself.

    Numbers and switches stay text: the option's own type decides what they mean.
    """
    if text in ("null", "~"):
        return None
    if text[:1] in ("[", "{"):
        return parse_yaml(text, "value", text if len(text) <= 80 else f"{text[:77]}...")
    return text


def parse_settings(settings: Iterable[str] | Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return options by stage from texts STAGE.FIELD=VALUE or a mapping; the last of two for one field wins.

    Raises InputError for other texts and for a value beside options of its name, UnknownNameError for unknown stages.
    """
    if isinstance(settings, Mapping):
        return {stage: dict(values) for stage, values in settings.items()}
    parsed = [(text, *_setting(text, "STAGE.FIELD=VALUE: matcher.huber_px=2", least=2)) for text in settings]
    return _combined({}, parsed, stages=STAGES)


def parse_fields(
    settings: Iterable[str], values: Mapping[str, Any] | None = None, *, example: str = "seed=1"
) -> dict[str, Any]:
    """Return options from texts FIELD=VALUE that override those of `values`, which is not modified.

    OUTER.FIELD=VALUE sets an option of options. Raises InputError, with the example, for other texts, and for a value
    beside options of its name.
    """
    return _combined(values or {}, [(text, *_setting(text, f"FIELD=VALUE: {example}")) for text in settings])


def _combined(
    values: Mapping[str, Any], settings: Iterable[tuple[str, list[str], Any]], stages: Collection[str] | None = None
) -> dict[str, Any]:
    """Return `values` with settings (text, path of names, value) in them; UnknownNameError for a wrong first name.

    Raises InputError if a setting would silently replace another one of a different field.
    """
    options = dict(values)
    known: dict[tuple[str, ...], Any] = {}
    for text, path, value in settings:
        if stages is not None and path[0] not in stages:
            raise UnknownNameError("stage", path[0], stages, where="--set")
        for other, earlier in known.items():
            inside = other[: len(path)] == tuple(path) and len(other) > len(path)
            outside = tuple(path[: len(other)]) == other and len(other) < len(path) and not isinstance(earlier, Mapping)
            if inside or outside:
                expected = "a value, or options in it"
                raise InputError(f"{'.'.join(other)} is set already", where="--set", expected=expected, got=text)
        known[tuple(path)] = value
        options = _with(options, path, value)
    return options


def _setting(text: str, expected: str, least: int = 1) -> tuple[list[str], Any]:
    """Return the names before the "=", at least `least`, and the value after it."""
    names, equals, value = text.strip().partition("=")
    path = names.split(".")
    if not equals or len(path) < least or not all(re.fullmatch(r"[A-Za-z0-9_-]+", name) for name in path):
        raise InputError("cannot read the setting", where="--set", expected=expected, got=text)
    return path, value_of(value)


def _with(options: Mapping[str, Any], path: list[str], value: Any) -> dict[str, Any]:
    """Return the options with one more value; a scalar on the path is replaced by a mapping."""
    name, *rest = path
    if not rest:
        return {**options, name: value}
    inner = options.get(name)
    return {**options, name: _with(inner if isinstance(inner, Mapping) else {}, rest, value)}
