"""The rows of all suites as one page that works offline: families, tables with top groups, plots, runs on demand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Int
from p2o.errors import P2OError
from p2o.files.whole_file import write_whole
from p2o.host.registry import Registry
from p2o.host.slots import KIND_OF
from p2o.page import page as html
from p2o.page.page import Block, Column, brief, cell
from p2o.page.plot import plot_of_table, table_panel
from p2o.run.fit import FRAME_CONTENT
from p2o.run.recipe import Recipe

from p2o_study.benchmark.outcomes import STATUSES, TRUSTS, Outcomes, Runs, split_by
from p2o_study.benchmark.overlays import Overlays
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import Method, place_of
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.benchmark.summary import RowSummary, clusters_of, dataset_clusters, summarised, top_groups
from p2o_study.benchmark.tables import NOTE
from p2o_study.compare import family_of
from p2o_study.coverage import WRONG, WRONG_TEXT
from p2o_study.report.summary import NORMS
from p2o_study.report.tables import name_of, unit_of
from p2o_study.study import DatasetTable
from p2o_study.tally import brief_seconds

INDEX = "index.html"
MAX_BYTES = 4_000_000
"""Maximum size of the rows on the page, as JSON: the page stays below 5 MB."""
MAX_ROWS = 4000
EXTERNAL, UNKNOWN = "external", "not installed"
"""Families of methods outside p2o, and of methods that are not installed here."""
NO_NEEDS = "nothing beyond image and sweep"
GROUPS_NOTE = (
    "Groups are top groups: methods whose 95 % intervals overlap, also through a third one, are in one group, which "
    "has no order. Only methods on the same frames, from the same initial error and with the same number of frames "
    f"are compared. A false accept is a trusted result {WRONG_TEXT}. Coverage is the share of rotation errors, below "
    "it that of translation errors, within the predicted ones; 67 % and 95 % are expected."
)
Card = Mapping[str, str]
"""A data card: texts by their heading, such as "sensor" and "licence"."""


# ---- what the page shows of a row, and of a run when the row is opened

_STARTS = {norm: f"initial {name_of(norm)}" for norm in NORMS}


def line_columns() -> list[Column]:
    """Return the columns of rows; some are for filters, search and plots only."""
    columns = [Column("method", text=True, hide=0, of=lambda one: cell(one.label, below=one.family))]
    for norm in NORMS:
        name, (unit, _, digits) = name_of(norm), unit_of(norm)
        columns += [
            Column(f"{name} group", hide=2, looks={"1": "good"}, of=partial(_top_group, norm=norm)),
            Column(f"{name} mean", unit, digits, hide=0, of=partial(_mean, norm=norm)),
            Column(f"{name} median", unit, digits, hide=3, of=partial(_median, norm=norm)),
        ]
    return [
        *columns,
        Column("n", hide=4, of=lambda one: one.summary.count),
        Column("independent groups", hide=6, of=lambda one: one.summary.groups),
        Column("refused", hide=2, of=lambda one: one.summary.refused),
        Column("trusted", hide=3, of=lambda one: one.summary.trusted),
        Column("false accepts", hide=2, of=lambda one: one.summary.false_accepts),
        Column("coverage 67 %", hide=5, of=partial(_covered, names=("rotation", "translation"))),
        Column("coverage 95 %", hide=4, of=partial(_covered, names=("rotation_95", "translation_95"))),
        Column(
            "time", "s", hide=3, of=lambda one: cell(brief(one.summary.seconds), brief_seconds(one.summary.seconds))
        ),
        Column("suite", off=True, of=lambda one: one.suite.name),
        Column("data set", off=True, of=lambda one: one.data_title),
        Column("initial error", off=True, of=lambda one: one.protocol),
        Column("frames", off=True, of=lambda one: one.frames[1]),
        Column("family", off=True, of=lambda one: one.family),
        Column("needs", off=True, of=lambda one: one.needs or [NO_NEEDS]),
        Column("method words", off=True, of=lambda one: ", ".join(f"{k} {v}" for k, v in one.method.words.items())),
        Column("source", off=True, of=lambda one: one.method.source or None),
        *(Column(f"{name_of(n)} of solved [{unit_of(n)[0]}]", off=True, of=partial(_solved, norm=n)) for n in NORMS),
        Column("name", off=True, of=lambda one: one.name),
        Column("compared", off=True, of=lambda one: cell(one.heading, one.heading, one.suite.suite.question)),
        *(Column(_STARTS[n], n.rpartition("_")[2], off=True, of=partial(_start, norm=n)) for n in NORMS),
    ]


def _top_group(line: _Line, norm: str) -> int | None:
    return line.top_group.get(norm)


def _mean(line: _Line, norm: str) -> Any:
    mean = line.summary.mean.get(norm)
    ends = [] if mean is None else [mean.value, mean.low, mean.high]
    return html.interval([None if end is None else unit_of(norm)[1] * end for end in ends]) if ends else None


def _median(line: _Line, norm: str) -> float | None:
    median = line.summary.median.get(norm)
    return None if median is None else brief(unit_of(norm)[1] * median)


def _solved(line: _Line, norm: str) -> Any:
    value, (_, factor, digits) = line.summary.solved_only.get(norm), unit_of(norm)
    return None if value is None else cell(brief(factor * value), html.number_text(factor * value, digits))


def _covered(line: _Line, names: tuple[str, str]) -> Any:
    coverage = line.summary.coverage
    shares = [getattr(coverage, name) / coverage.count for name in names] if coverage.count else []
    return cell(brief(shares[0]), *(f"{100 * share:.0f} %" for share in shares)) if shares else None


def _start(line: _Line, norm: str) -> float | None:
    values = line.runs[f"start_{norm}"]
    return None if np.isnan(values).all() else brief(float(np.nanmean(values)))


RUN_COLUMNS = html.columns_of(
    [
        Column("frames", text=True, hide=0),
        Column("seed", hide=4),
        *(Column(name_of(norm), *unit_of(norm)[::2], hide=0) for norm in NORMS),
        Column("status", text=True, hide=3),
        Column("verdict", text=True, order=TRUSTS, looks=html.TRUST_LOOKS),
        *(
            Column(f"{name_of(norm)} {what}", *unit_of(norm)[::2], hide=hide)
            for what, hide in (("initial", 4), ("67 %", 3), ("95 %", 5))
            for norm in NORMS
        ),
        Column("time", "s", 2, hide=4),
        Column("names of frames", off=True),
    ]
)
"""The columns of runs, in the order of `run_rows`."""


def run_rows(runs: Runs, outcomes: Outcomes) -> list[list[Any]]:
    """Return the rows of runs."""
    names = [
        f"{prefix}{norm}{end}"
        for prefix, end in (("start_", ""), ("predicted_", ""), ("predicted_", "_95"))
        for norm in NORMS
    ]
    factors = {name: unit_of(name.removesuffix("_95"))[1] for name in (*NORMS, *names)}
    columns = {name: (factor * runs[name]).tolist() for name, factor in factors.items()}
    rows = []
    for number, run in enumerate(runs):
        place = list(outcomes.places[int(run["place"])])
        verdict = int(run["verdict"])
        errors, others = ([_size(columns[name][number]) for name in some] for some in (NORMS, names))
        words = [STATUSES[int(run["status"])], None if verdict < 0 else TRUSTS[verdict]]
        frames = ", ".join(place) if len(place) > 1 else None
        rows.append([place_of(place), int(run["seed"]), *errors, *words, *others, brief(float(run["seconds"])), frames])
    return rows


def _size(value: float) -> Any:
    return cell(None, "unobservable") if value == np.inf else brief(value)


# ---- the page


@dataclass(frozen=True)
class Written:
    """What was written: the page, the number of its rows, of those left out, and of the single runs."""

    path: Path
    rows: int
    left_out: int
    runs: int


@dataclass(eq=False)
class _Line:
    """One row of the page: the runs of a label on one dataset from one initial error.

    `name` is the common name of the rows of its method, `top_group` its top group by norm, `data_title` the
    dataset with its sensors.
    """

    suite: SuiteFile
    outcomes: Outcomes
    runs: Runs
    clusters: Int
    name: str = ""
    family: str = ""
    needs: Sequence[str] = ()
    data_title: str = ""
    top_group: Mapping[str, int | None] = field(default_factory=dict)

    @cached_property
    def summary(self) -> RowSummary:
        return summarised(self.runs, dataset_clusters(self.runs, self.clusters))

    @property
    def method(self) -> Method:
        return self.outcomes.methods[int(self.runs["method"][-1])][0]

    @property
    def label(self) -> str:
        return self.outcomes.rows[int(self.runs["row"][0])]

    @property
    def dataset(self) -> str:
        return self.outcomes.datasets[int(self.runs["dataset"][0])]

    @property
    def protocol(self) -> str:
        return self.outcomes.protocols[int(self.runs["protocol"][0])]

    @cached_property
    def frames(self) -> tuple[int, int]:
        """Minimum and maximum number of frames of a calibration."""
        counts = [len(self.outcomes.places[number]) for number in np.unique(self.runs["place"])]
        return min(counts), max(counts)

    @property
    def frames_text(self) -> str:
        """The number of frames of a calibration as text."""
        least, most = self.frames
        return f"{most if least == most else f'{least} to {most}'} frame{'s' * (most != 1)}"

    @property
    def heading(self) -> str:
        """What rows have in common that are compared, as text."""
        return f"{self.data_title}, {self.frames_text}, from {self.protocol}"

    @property
    def comparable(self) -> tuple[str, str, str, int]:
        """What rows have in common that are compared."""
        return self.suite.name, self.dataset, self.protocol, self.frames[1]

    @cached_property
    def same_method(self) -> str:
        """Equal for two rows of one method, whatever their initial error and number of frames."""
        if self.method.external:
            return f"external {self.label}"
        options = {
            stage: {name: value for name, value in values.items() if name != "seed"}
            if isinstance(values, Mapping)
            else values
            for stage, values in self.method.options.items()
        }
        return json.dumps([self.method.words, options], sort_keys=True)


def write_page(
    suites: Sequence[SuiteFile],
    results: Results,
    folder: Path,
    registry: Registry,
    *,
    cards: Callable[[DatasetTable], Mapping[str, Card]] = lambda table: {},
    overlays: Overlays | None = None,
    on_suite: Callable[[str], None] = lambda name: None,
) -> Written:
    """Write the page of suites, and a file for the runs of each row, to a folder, and return what was written.

    The page needs no server and loads nothing but these files. It opens with the suite that compares most families.
    It stays below 5 MB: rows beyond `MAX_BYTES` or `MAX_ROWS` are left out, which it states. `cards` returns the data
    cards of a dataset of a suite by title, `overlays` draws images. Raises InputError as `Outcomes.read`, and if the
    folder cannot be written.
    """
    html.prepare_data(folder)
    names, shared, columns = _Names(registry), html.Shared(), line_columns()
    shown: list[_Line] = []
    rows: list[list[Any]] = []
    opens = []
    described: dict[str, Card] = {}
    size = left_out = 0
    for suite in suites:
        on_suite(suite.name)
        own = {table.name: cards(table) for table in suite.study.study.dataset}
        for lines in _compared(suite, Outcomes.read(results, suite.name, results.frames)):
            chosen = lines[: MAX_ROWS - len(rows)] if size < MAX_BYTES else []
            groups = {norm: top_groups([line.summary.mean.get(norm) for line in chosen]) for norm in NORMS}
            for number, line in enumerate(chosen):
                known = own.get(line.dataset, {})
                sensors = ", ".join(sorted({card["sensor"] for card in known.values() if card.get("sensor")}))
                line.data_title = f"{line.dataset} ({sensors})" if sensors else line.dataset
                line.family, line.needs = names.of(line.method)
                line.top_group = {norm: groups[norm][number] for norm in NORMS}
                cells = html.cells(columns, line)
                size += len(json.dumps(cells))
                if size > MAX_BYTES:
                    break
                file = f"{suite.name}-{len(rows)}"
                facts = [_card(shared, title, card) for title, card in known.items()]
                html.write_data(folder, file, [[*facts, *_runs(line, overlays, shared)]])
                opens.append(html.detail_of_file(f"{line.label}: {line.heading}", file))
                described |= known
                shown.append(line)
                rows.append(cells)
                left_out -= 1
            left_out += len(lines)
    families = {suite.name: {line.family for line in shown if line.suite is suite} for suite in suites}
    first = max(families, key=lambda name: len(families[name]), default="")
    blocks = [
        html.text("Errors of camera-LiDAR calibration, computed from poses. Select a row to see its runs.", "quiet")
    ]
    if left_out:
        text = f"The page has the first {len(rows)} rows; {left_out} further ones are left out."
        blocks.append(html.text(f"{text} p2o benchmark table has all.", "quiet"))
    blocks += [_families([line for line in shown if line.suite.name == first])] if shown else []
    filters = ["data set", "initial error", "frames", "family", "needs"]
    table = html.table(
        [replace(column, of=None) for column in columns],
        rows,
        name="rows",
        search=True,
        filters=[("suite", first), *filters] if shown else (),
        group="compared",
        opens=opens,
        counted=" rows",
    )
    note = (
        "Of the rows above. Select a point to open its row, a name to hide it; drag to enlarge. Axes are logarithmic."
    )
    plots = html.choice("of", {name_of(norm): [_plots(norm)] for norm in NORMS})
    blocks += [html.section("Rows", table), html.section("Errors", plots, html.text(note, "quiet"))]
    if described:
        blocks.append(html.section("Data", *(_card(shared, title, card) for title, card in described.items())))
    blocks.append(html.section("How to read it", *(html.text(note, "quiet") for note in (GROUPS_NOTE, NOTE))))
    page = html.page("p2o benchmark", blocks, shared=shared, script_files=True)
    write_whole(folder / INDEX, page.encode())
    return Written(folder / INDEX, len(rows), left_out, sum(len(line.runs) for line in shown))


def _card(shared: html.Shared, title: str, card: Card) -> Block:
    """Return a data card."""
    return shared.use(
        html.fold(f"data card: {title}", html.facts([(name, text) for name, text in card.items() if text]))
    )


def _runs(line: _Line, overlays: Overlays | None, shared: html.Shared) -> list[Block]:
    """Return the overlays and the runs of a row, those with the largest errors first."""
    runs = line.runs
    size = np.nan_to_num(runs["rotation_deg"] / WRONG.angle_deg + runs["translation_m"] / WRONG.distance_m, nan=np.inf)
    runs = runs[np.argsort(-size, kind="stable")]
    drawn = [] if overlays is None else overlays.of(line.suite, line.outcomes, runs)
    slides = [html.slides(f"run with the {one['name']}: {one['frame']}", one["before"], one["after"]) for one in drawn]
    table = html.table(
        shared.use(RUN_COLUMNS),
        run_rows(runs, line.outcomes),
        name="runs",
        search=True,
        counted=" runs, those with the largest errors first",
    )
    return [*([html.grid(*slides, least=400)] if slides else []), html.section("Runs", table)]


def _families(lines: Sequence[_Line]) -> Block:
    """Return the methods of a suite by family: their mean errors in each comparison."""
    by_method: dict[tuple[str, str], dict[str, _Line]] = {}
    for line in lines:
        by_method.setdefault((line.family, line.name), {})[line.heading] = line
    keys = sorted(by_method, key=lambda key: key[0])
    columns = [Column("method", text=True, hide=0, of=lambda key: key[1])]
    columns.append(Column("family", off=True, of=lambda key: key[0]))
    for heading, line in {line.heading: line for line in lines}.items():
        title = f"{line.dataset}, {line.frames_text}, from {line.protocol}"
        columns.append(Column(title, of=partial(_both_means, by_method, heading)))
    opens = [html.rows_of("rows", suite=lines[0].suite.name, family=family, find=name) for family, name in keys]
    guide = "Mean rotation error, below it that of the translation. Select a method to see its rows."
    table = html.table(columns, keys, name="families", group="family", opens=opens)
    question = html.text(lines[0].suite.suite.question)
    return html.section("Methods by family", question, table, html.text(guide, "quiet"))


def _both_means(by_method: Mapping[Any, Mapping[str, _Line]], heading: str, key: tuple[str, str]) -> Any:
    line = by_method[key].get(heading)
    means = {} if line is None else line.summary.mean
    texts = [
        f"{factor * means[norm].value:.{digits}f} {unit}" for norm in means for unit, factor, digits in [unit_of(norm)]
    ]
    return cell(brief(means[NORMS[0]].value), *texts) if texts else None


def _plots(norm: str) -> Block:
    """Return the plots of the mean error of a norm over what it depends on."""
    y, title = f"{name_of(norm)} mean", f"{name_of(norm)} error [{unit_of(norm)[0]}]"
    start = (f"mean initial {name_of(norm)} error [{norm.rpartition('_')[2]}]", title)
    same, below = ("suite", "data set", "name"), "Below the dashed line the error became smaller."
    note = "Lines connect rows of one method on one data set from one initial error."
    return plot_of_table(
        "rows",
        [
            table_panel("over time", "time", y, "name", ("median time of a calibration [s]", title)),
            table_panel(
                "over number of frames",
                "frames",
                y,
                "name",
                ("frames", title),
                join=(*same, "initial error"),
                note=note,
            ),
            table_panel(
                "over initial error", _STARTS[norm], y, "name", start, join=(*same, "frames"), diagonal=True, note=below
            ),
            table_panel("over data set", "data set", y, "name", ("", title), categories=True),
        ],
    )


def _compared(suite: SuiteFile, outcomes: Outcomes) -> list[list[_Line]]:
    """Return the rows of a suite, one list for all that are compared with each other."""
    clusters = clusters_of(outcomes, suite.suite.groups)
    order = {row.label: number for number, row in enumerate(suite.rows)}
    latest = outcomes.runs[outcomes.latest]
    lines = [_Line(suite, outcomes, runs, clusters) for runs in split_by(latest, "row", "dataset", "protocol")]
    labels: dict[str, list[str]] = {}
    for line in lines:
        labels.setdefault(line.same_method, []).append(line.label)
    for line in lines:
        line.name = common_name(labels[line.same_method])
    lines.sort(key=lambda line: (line.comparable, order.get(line.label, len(order)), line.label))
    return [list(some) for _, some in groupby(lines, key=lambda line: line.comparable)]


class _Names:
    """What the registry states of methods, by the words of a row."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._known: dict[str, tuple[str, list[str]]] = {}

    def of(self, method: Method) -> tuple[str, list[str]]:
        """Return the family of a method, and the optional content of frames that it needs."""
        if method.external:
            return EXTERNAL, []
        key = json.dumps(method.words, sort_keys=True)
        if key not in self._known:
            self._known[key] = self._resolved(method.words)
        return self._known[key]

    def _resolved(self, words: Mapping[str, str]) -> tuple[str, list[str]]:
        try:
            plan = Recipe.of(**words).resolve(self._registry)
        except P2OError:
            return UNKNOWN, []
        needs = {word for stage, its in plan.parts.items() if stage in KIND_OF for word in its.offer.method.needs}
        return family_of(plan), sorted(needs & FRAME_CONTENT.keys())


def common_name(labels: Sequence[str]) -> str:
    """Return the common beginning of labels in whole words: "ours" of "ours from 1deg" and "ours from 2deg"."""
    if len(set(labels)) == 1:
        return labels[0]
    words = [[word.rstrip(",") for word in label.split(" ")] for label in labels]
    # All labels contain what the first and the last one in alphabetical order have in common.
    pairs = zip(min(words), max(words), strict=False)
    common = [first for first, _ in takewhile(lambda pair: pair[0] == pair[1], pairs)]
    while common and common[-1] in ("", "from", "on", "@"):
        common = common[:-1]
    return " ".join(labels[0].split(" ")[: len(common)]).rstrip(",") or labels[0]
