"""Methods by one name: the words of a recipe that make up a published method, a calibrator or a matcher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from p2o.errors import UnknownNameError
from p2o.files.parsed_text import parse_toml
from p2o.host.method import Kind
from p2o.host.registry import Registry
from p2o.host.shipped import shipped_files
from p2o.options import validated
from p2o.run.words import parse_settings

FILE = "methods.toml"
"""The file of a plugin package with the published methods that it offers: a table of words and options for each."""

_BESIDE = ("extractor", "solver", "init")
"""Words that the example of a matcher states."""


@dataclass(frozen=True)
class Preset:
    """A method under one name: words of a recipe, options by stage, and the `label` that tables name it by."""

    name: str
    words: Mapping[str, str]
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    label: str = ""

    def merged(self, words: Mapping[str, Any]) -> dict[str, Any]:
        """Return the words of a recipe with those of this method where `words` has no others.

        Options of a stage whose method `words` replaces are left out: another method does not have them.
        """
        ours, given = _stages(self.words), _stages({**self.words, **words})
        options = {stage: dict(v) for stage, v in self.options.items() if ours.get(stage) == given.get(stage)}
        for stage, values in words.get("options", {}).items():
            options[stage] = {**options.get(stage, {}), **values}
        return {**self.words, **words, **({"options": options} if options else {})}

    def __str__(self) -> str:
        """Return the options of `p2o run` that stand for this method."""
        words = [f"--{word} {name}" for word, name in self.words.items()]
        for stage, values in self.options.items():
            words += [f"--set {stage}.{name}={str(value).lower()}" for name, value in values.items()]
        return " ".join(words)


def _stages(words: Mapping[str, Any]) -> dict[str, Any]:
    """Return the method of each stage that words name; an extractor names two."""
    image, _, cloud = str(words.get("extractor", "")).partition("/")
    return {**words, "extractor": image, "cloud": cloud}


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    label: str = ""
    extractor: str | None = None
    matcher: str | None = None
    solver: str | None = None
    init: str | None = None
    calibrator: str | None = None
    accumulate: str | None = None
    options: dict[str, dict[str, Any]] = Field(default_factory=dict)


def presets(registry: Registry) -> dict[str, Preset]:
    """Return the published methods of the loaded plugins by name, in the order of their files.

    Raises InputError for a file that is no TOML or has other keys.
    """
    methods: dict[str, Preset] = {}
    for dist, file in shipped_files(registry):
        if file.name != FILE:
            continue
        where = f"{dist}, {FILE}"
        for name, content in parse_toml(file.read_text(encoding="utf-8"), "file of methods", where).items():
            table = validated(_Table, content, name, where=where)
            words = table.model_dump(exclude={"options", "label"}, exclude_none=True)
            methods.setdefault(name, Preset(name, words, table.options, table.label))
    return methods


def preset_of(name: str, registry: Registry, where: str = "--method") -> Preset:
    """Return the published method of this name, else the calibrator, else the matcher.

    A matcher without an entry is combined with the extractor, solver and init of its example, else with those of the
    default recipe. Raises UnknownNameError.
    """
    published = presets(registry)
    if name in published:
        return published[name]
    for kind, word in ((Kind.CALIBRATOR, "calibrator"), (Kind.MATCHER, "matcher")):
        offer = next((offer for offer in registry.of_kind(kind) if name in (offer.name, offer.full_name)), None)
        if offer is None:
            continue
        example = offer.method.example
        if example is None:
            return Preset(name, {word: name})
        beside = _BESIDE if kind is Kind.MATCHER else ()
        companions = {stage: value for stage in beside if (value := getattr(example, stage))}
        return Preset(name, {word: name, **companions}, parse_settings(example.settings))
    methods = {offer.name for kind in (Kind.CALIBRATOR, Kind.MATCHER) for offer in registry.of_kind(kind)}
    raise UnknownNameError("method", name, {*published, *methods}, where=where)
