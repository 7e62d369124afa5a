"""What each method of the comparison needs, is for, measured on its own ground, and published: from rows and studies.

A package names its methods in overview.toml; `p2o benchmark docs` writes overview.json beside it, which
`p2o methods --matrix` prints, so that no figure is typed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path

from p2o.errors import UnknownNameError
from p2o.files.parsed_text import parse_toml
from p2o.host.registry import Registry
from p2o.host.shipped import shipped_files
from p2o.host.slots import KIND_OF
from p2o.options import Options, validated
from p2o.run.fit import FRAME_CONTENT
from p2o.run.overview import FILE as RENDERED
from p2o.run.overview import MethodFacts
from p2o.run.presets import preset_of
from p2o.run.recipe import Plan, Recipe

from p2o_study.benchmark.lines import Key
from p2o_study.benchmark.tables import SuiteTables
from p2o_study.curves import frames_of
from p2o_study.row import NORMS
from p2o_study.statistics import Statistics
from p2o_study.study import find_study
from p2o_study.tables import NONE, Cell, Table, markdown_table, with_unit

FILE = "overview.toml"


class _Place(Options):
    suite: str
    section: str
    label: str
    data: str


class _Figures(Options):
    study: str
    label: str


class _Entry(Options):
    paper: str
    use: str
    row: _Place | None = None
    published: _Figures | None = None


def needs_of(plan: Plan) -> list[str]:
    """Return the optional content of frames that the methods of a plan need."""
    parts = plan.parts.items()
    needs = {word for stage, part in parts if stage in KIND_OF for word in part.offer.method.needs}
    return sorted(needs & FRAME_CONTENT.keys())


def overviews(registry: Registry, tables: Callable[[str], SuiteTables]) -> dict[Traversable, list[MethodFacts]]:
    """Return the facts of the methods of each package that has a file of them, by the file.

    Raises InputError for a file that is not valid, and UnknownNameError for an unknown method, row or published figure.
    """
    return {
        file: [_facts(name, validated(_Entry, entry, where=file), registry, tables) for name, entry in content.items()]
        for _, file in shipped_files(registry)
        if file.name == FILE
        for content in (parse_toml(file.read_text(encoding="utf-8"), "overview of methods", str(file)),)
    }


def _facts(name: str, entry: _Entry, registry: Registry, tables: Callable[[str], SuiteTables]) -> MethodFacts:
    preset = preset_of(name, registry, FILE)
    needs = needs_of(Recipe.of(**preset.merged({"data": None})).resolve(registry))
    line = None
    if (row := entry.row) is not None:
        suite = tables(row.suite)
        if (key := Key(row.section, row.label, row.data)) not in suite.asked:
            labels = {f"{one.section}; {one.label}; {one.dataset}" for one in suite.asked}
            raise UnknownNameError("row", "; ".join(key), labels, where=f"{FILE}, {name}")
        line = suite.lines.get(key)
    measured = NONE if line is None or row is None else _measured(line, row)
    published = NONE
    if (figures := entry.published) is not None:
        known = {one.label: one for one in find_study(figures.study, registry).published}
        if figures.label not in known:
            raise UnknownNameError("published row", figures.label, known, where=f"{FILE}, {name}")
        one = known[figures.label]
        published = f"{_errors_text(one.values)} ({', '.join(filter(None, (one.source, one.start, one.note)))})"
    return MethodFacts(name, entry.paper, tuple(needs), entry.use, measured, published)


def _measured(line: Statistics, place: _Place) -> str:
    count = frames_of(line)
    frames = f"{count} frames jointly" if count > 1 else "single frames"
    frames += f", {line.unmoved} of {line.count} not moved" if line.unmoved else ""
    errors = {norm: line.average(norm) for norm in NORMS}
    return f"{_errors_text(errors)} ({frames}, {place.data}, from {line.rows[0].case.protocol}, suite {place.suite})"


def _errors_text(values: Mapping[str, float]) -> str:
    return ", ".join(with_unit(values[norm], norm) for norm in NORMS if norm in values)


def overview_files(registry: Registry, tables: Callable[[str], SuiteTables]) -> dict[Path, str]:
    """Return the content of overview.json of each package with a file of methods, by its path."""
    known = overviews(registry, tables).items()
    return {
        Path(str(file)).with_name(RENDERED): json.dumps([one.as_dict() for one in facts], indent=1) + "\n"
        for file, facts in known
    }


def overview_text(registry: Registry, tables: Callable[[str], SuiteTables]) -> str:
    """Return the facts of all methods as a Markdown table."""
    header = ("method", "paper", "needs", "for", "measured, mean", "published")
    known = [one for facts in overviews(registry, tables).values() for one in facts]
    cells = [(one.name, one.paper, one.needs_text, one.use, one.measured, one.published) for one in known]
    return markdown_table(Table("", header, tuple(tuple(map(Cell, row)) for row in cells)))
