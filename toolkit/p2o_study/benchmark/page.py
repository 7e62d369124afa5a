"""The rows of all suites as one page that works offline: families, tables with top groups, plots, runs on demand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from p2o.errors import P2OError
from p2o.files.whole_file import write_whole
from p2o.host.registry import Registry
from p2o.page import page as html
from p2o.page.page import Block, Column, brief, cell
from p2o.page.plot import plot_of_table, table_panel
from p2o.run.recipe import Recipe

from p2o_study.benchmark.lines import read_lines
from p2o_study.benchmark.overview import needs_of
from p2o_study.benchmark.suite import Suite
from p2o_study.compare import family_of
from p2o_study.curves import frames_of, method_names, start_error_of
from p2o_study.row import NORMS, Method
from p2o_study.rows import Rows
from p2o_study.statistics import Statistics, error_rank, top_groups
from p2o_study.study import DatasetTable
from p2o_study.tables import ENTRIES, NOTES, RUN_COLUMNS, error_figure, name_of, unit_of, with_unit

INDEX = "index.html"
MAX_ROWS = 4000
"""Maximum number of rows on the page, which then stays below 5 MB."""
EXTERNAL, UNKNOWN = "external", "not installed"
"""Families of methods outside p2o, and of methods that are not installed here."""
NO_NEEDS = "nothing beyond image and sweep"
GROUPS_NOTE = (
    "Groups are top groups: methods whose 95 % intervals overlap, also through a third one, are in one group, which "
    "has no order. Only methods on the same frames, from the same initial error and with the same number of frames "
    "are compared. Of the errors, 67 % and 95 % are expected within the predicted ones."
)
Card = Mapping[str, str]
"""A data card: texts by their heading, such as "sensor" and "licence"."""


# ---- what the page shows of a row, and of a run when the row is opened

_STARTS = {norm: f"initial {name_of(norm)}" for norm in NORMS}


def line_columns() -> list[Column]:
    """Return the columns of rows; some are for filters, search and plots only."""
    columns = [Column("method", text=True, hide=0, of=lambda line: cell(line.label, below=line.family))]
    for norm in NORMS:
        top = Column(f"{name_of(norm)} group", hide=2, looks={"1": "good"}, of=partial(_top_group, norm=norm))
        columns += [top, error_figure(norm, "mean", 0).column, error_figure(norm, "median", 3).column]
    renamed = {"runs": "n", "frames": "distinct frames", "groups": "independent groups"}
    return [
        *columns,
        *(replace(ENTRIES[name].column, name=renamed.get(name, name)) for name in _FIGURES),
        replace(ENTRIES["time [s]"].column, name="time", unit="s", hide=3),
        Column("suite", off=True, of=lambda line: line.suite),
        Column("data set", off=True, of=lambda line: line.data_title),
        Column("initial error", off=True, of=lambda line: line.protocol),
        Column("frames", off=True, of=frames_of),
        Column("family", off=True, of=lambda line: line.family),
        Column("needs", off=True, of=lambda line: line.needs or [NO_NEEDS]),
        Column("method words", off=True, of=lambda line: ", ".join(f"{k} {v}" for k, v in line.method.words.items())),
        Column("source", off=True, of=lambda line: line.method.source or None),
        Column("name", off=True, of=lambda line: line.name),
        Column("compared", off=True, of=lambda line: cell(line.heading, line.heading, line.question)),
        *(Column(_STARTS[n], n.rpartition("_")[2], off=True, of=partial(_start, norm=n)) for n in NORMS),
    ]


_FIGURES = (
    *("runs", "frames", "groups", "not solved", "trusted", "false accepts", "outside 95 %", "not moved"),
    *("coverage 67 %", "coverage 95 %"),
)


def _top_group(line: Line, norm: str) -> int | None:
    return line.top_group[norm]


def _start(line: Line, norm: str) -> float | None:
    return brief(start_error_of(line, norm))


# ---- the page


@dataclass(frozen=True, eq=False)
class Line(Statistics):
    """One row of the page: the runs of a label on one dataset from one initial error, in a suite with its question.

    `name` is the common name of the rows of its method, `data_title` the dataset with its sensors, `top_group` its top
    group by norm.
    """

    suite: str = ""
    question: str = ""
    name: str = ""
    data_title: str = ""
    family: str = ""
    needs: Sequence[str] = ()
    top_group: dict[str, int | None] = field(default_factory=dict)

    @property
    def method(self) -> Method:
        return self.rows[-1].method

    @property
    def dataset(self) -> str:
        return self.rows[0].dataset

    @property
    def protocol(self) -> str:
        return self.rows[0].case.protocol

    @property
    def frames_text(self) -> str:
        """The number of frames of a calibration as text; the last group of frames may be smaller."""
        least, most = min(len(row.frames) for row in self.rows), frames_of(self)
        return f"{most if least == most else f'{least} to {most}'} frame{'s' * (most != 1)}"

    @property
    def heading(self) -> str:
        """What rows have in common that are compared, as text."""
        return f"{self.data_title}, {self.frames_text}, from {self.protocol}"

    @property
    def comparable(self) -> tuple[str, str, int]:
        """What rows of a suite have in common that are compared."""
        return self.dataset, self.protocol, frames_of(self)


def write_page(
    suites: Sequence[Suite],
    results: Rows,
    folder: Path,
    registry: Registry,
    *,
    cards: Callable[[DatasetTable], Mapping[str, Card]] = lambda table: {},
    on_suite: Callable[[str], None] = lambda name: None,
) -> tuple[list[Line], int]:
    """Write the page of suites, and a file for the runs of each row, to a folder; return its rows and those left out.

    The page needs no server and loads nothing but these files. It opens with the suite that compares most families.
    Rows beyond `MAX_ROWS` are left out, which it states. `cards` returns the data cards of a dataset of a suite by
    title. Raises InputError if the folder cannot be written.
    """
    html.prepare_data(folder)
    shared, lines = html.Shared(), list[Line]()
    cards_of = {suite.name: {table.name: cards(table) for table in suite.dataset} for suite in suites}
    for suite in suites:
        on_suite(suite.name)
        lines += _compared(suite, results, cards_of[suite.name], registry)
    shown, left_out = lines[:MAX_ROWS], len(lines[MAX_ROWS:])
    opens, described = [], dict[str, Card]()
    for number, line in enumerate(shown):
        known = cards_of[line.suite].get(line.dataset, {})
        described |= known
        file = f"{line.suite}-{number}"
        html.write_data(folder, file, [[*(_card(shared, *one) for one in known.items()), _runs(line, shared)]])
        opens.append(html.detail_of_file(f"{line.label}: {line.heading}", file))
    families = {suite.name: {line.family for line in shown if line.suite == suite.name} for suite in suites}
    first = max(families, key=lambda name: len(families[name]), default="")
    table = html.table(
        line_columns(),
        shown,
        name="rows",
        search=True,
        filters=[("suite", first), "data set", "initial error", "frames", "family", "needs"] if shown else (),
        group="compared",
        opens=opens,
        counted=" rows",
    )
    left = f"The page has the first {len(shown)} rows; {left_out} further ones are left out." if left_out else ""
    data = [_card(shared, title, card) for title, card in described.items()]
    blocks = _blocks([line for line in shown if line.suite == first], table, data, left)
    write_whole(folder / INDEX, html.page("p2o benchmark", blocks, shared=shared, script_files=True).encode())
    return shown, left_out


def _blocks(first: Sequence[Line], table: Block, data: Sequence[Block], left: str) -> list[Block]:
    """Return the page: the families of the `first` suite, the rows of all, plots, data cards and notes."""
    head = "Errors of camera-LiDAR calibration, computed from poses. Select a row to see its runs."
    note = (
        "Of the rows above. Select a point to open its row, a name to hide it; drag to enlarge. Axes are logarithmic."
    )
    plots = html.choice("of", {name_of(norm): [_plots(norm)] for norm in NORMS})
    return [
        html.text(head, "quiet"),
        *([html.text(f"{left} p2o benchmark table has all.", "quiet")] if left else []),
        *([_families(first)] if first else []),
        html.section("Rows", table),
        html.section("Errors", plots, html.text(note, "quiet")),
        *([html.section("Data", *data)] if data else []),
        html.section("How to read it", *(html.text(text, "quiet") for text in (GROUPS_NOTE, *NOTES))),
    ]


def _card(shared: html.Shared, title: str, card: Card) -> Block:
    """Return a data card."""
    return shared.use(
        html.fold(f"data card: {title}", html.facts([(name, text) for name, text in card.items() if text]))
    )


def _runs(line: Line, shared: html.Shared) -> Block:
    """Return the runs of a row, those with the largest errors first."""
    rows = sorted(line.rows, key=error_rank, reverse=True)
    table = html.table(
        shared.use(html.columns_of(RUN_COLUMNS)),
        [html.cells(RUN_COLUMNS, row) for row in rows],
        name="runs",
        search=True,
        counted=" runs, those with the largest errors first",
    )
    return html.section("Runs", table)


def _families(lines: Sequence[Line]) -> Block:
    """Return the methods of a suite by family: their mean errors in each comparison."""
    by_method: dict[tuple[str, str], dict[str, Line]] = {}
    for line in lines:
        by_method.setdefault((line.family, line.name), {})[line.heading] = line
    keys = sorted(by_method, key=lambda key: key[0])
    columns = [Column("method", text=True, hide=0, of=lambda key: key[1])]
    columns.append(Column("family", off=True, of=lambda key: key[0]))
    for heading, line in {line.heading: line for line in lines}.items():
        title = f"{line.dataset}, {line.frames_text}, from {line.protocol}"
        columns.append(Column(title, of=partial(_both_means, by_method, heading)))
    opens = [html.rows_of("rows", suite=lines[0].suite, family=family, find=name) for family, name in keys]
    guide = "Mean rotation error, below it that of the translation. Select a method to see its rows."
    table = html.table(columns, keys, name="families", group="family", opens=opens)
    question = html.text(lines[0].question)
    return html.section("Methods by family", question, table, html.text(guide, "quiet"))


def _both_means(by_method: Mapping[Any, Mapping[str, Line]], heading: str, key: tuple[str, str]) -> Any:
    line = by_method[key].get(heading)
    means = {} if line is None else {norm: mean for norm in NORMS if (mean := line.mean(norm)) is not None}
    texts = [with_unit(mean.value, norm) for norm, mean in means.items()]
    return cell(brief(means[NORMS[0]].value), *texts) if texts else None


def _plots(norm: str) -> Block:
    """Return the plots of the mean error of a norm over what it depends on."""
    title = f"{name_of(norm)} error [{unit_of(norm)[0]}]"
    initial = f"mean initial {name_of(norm)} error [{norm.rpartition('_')[2]}]"
    same, below = ("suite", "data set", "name"), "Below the dashed line the error became smaller."
    note = "Lines connect rows of one method on one data set from one initial error."
    figures: dict[tuple[str, str], dict[str, Any]] = {
        ("time", "median time of a calibration [s]"): {},
        ("frames", "frames"): {"join": (*same, "initial error"), "note": note},
        (_STARTS[norm], initial): {"join": (*same, "frames"), "diagonal": True, "note": below},
        ("data set", ""): {"categories": True},
    }
    names = ("over time", "over number of frames", "over initial error", "over data set")
    panels = [
        table_panel(name, column, f"{name_of(norm)} mean", "name", (axis, title), **words)
        for name, ((column, axis), words) in zip(names, figures.items(), strict=True)
    ]
    return plot_of_table("rows", panels)


def _compared(suite: Suite, results: Rows, cards: Mapping[str, Mapping[str, Card]], registry: Registry) -> list[Line]:
    """Return the rows of a suite, those that are compared in succession; `cards` are those of datasets."""
    about: dict[str, tuple[str, list[str]]] = {}
    known = []
    for line in read_lines(suite, results, only_asked=False).values():
        for protocol in line.protocols:
            rows = [row for row in line.rows if row.case.protocol == protocol]
            method, dataset = rows[-1].method, rows[0].dataset
            label = line.label if method.external else rows[0].row
            sensors = sorted({card["sensor"] for card in cards.get(dataset, {}).values() if card.get("sensor")})
            title = f"{dataset} ({', '.join(sensors)})" if sensors else dataset
            key = json.dumps([method.external, method.words], sort_keys=True)
            if key not in about:
                about[key] = _family_and_needs(method, registry)
            family, needs = about[key]
            known.append(
                Line(
                    rows,
                    label,
                    suite.group_of,
                    suite=suite.name,
                    question=suite.question,
                    data_title=title,
                    family=family,
                    needs=needs,
                )
            )
    lines = [replace(line, name=name) for line, name in zip(known, method_names(known), strict=True)]
    lines.sort(key=lambda line: line.comparable)
    for _, some in groupby(lines, key=lambda line: line.comparable):
        own = list(some)
        for norm in NORMS:
            for line, group in zip(own, top_groups([line.mean(norm) for line in own]), strict=True):
                line.top_group[norm] = group
    return lines


def _family_and_needs(method: Method, registry: Registry) -> tuple[str, list[str]]:
    """Return the family of a method, and the optional content of frames that it needs."""
    if method.external:
        return EXTERNAL, []
    try:
        plan = Recipe.of(**method.words).resolve(registry)
    except P2OError:
        return UNKNOWN, []
    return family_of(plan), needs_of(plan)
