"""The rows of all suites as one page that works offline: tables with top groups, plots, and single runs on demand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from p2o.draw.one_file import part, rendered
from p2o.errors import InputError, P2OError
from p2o.files.whole_file import write_whole
from p2o.host.registry import Registry
from p2o.host.slots import KIND_OF
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o.run.fit import FRAME_CONTENT
from p2o.run.recipe import Recipe

from p2o_study.benchmark.overlays import Overlays
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.benchmark.tables import NOTE
from p2o_study.compare import family_of
from p2o_study.report.figures import COLOURS
from p2o_study.report.page import brief, script_json, shown_texts
from p2o_study.row import NORMS, PREDICTED, Method, Row, place_of
from p2o_study.rows import Rows
from p2o_study.statistics import BOUNDS, WRONG, WRONG_TEXT, Interval, Statistics, brief_seconds, top_groups
from p2o_study.study import DatasetTable

STATUSES, TRUSTS = tuple(Status), tuple(Trust)
INDEX, DATA = "index.html", "data"
MAX_BYTES = 4_000_000
"""Maximum size of the rows on the page, as JSON: the page stays below 5 MB."""
MAX_ROWS = 4000
_AT_ONCE = 2000
"""Number of runs of a file that the page loads."""
EXTERNAL, UNKNOWN = "external", "not installed"
"""Families of methods outside p2o, and of methods that are not installed here."""
GROUPS_NOTE = (
    "Groups are top groups: methods whose 95 % intervals overlap, also through a third one, are in one group, which "
    "has no order. Only methods on the same frames, from the same initial error and with the same number of frames "
    f"are compared. A false accept is a trusted result {WRONG_TEXT}. Coverage is the share of rotation errors, below "
    "it that of translation errors, within the predicted ones; 67 % and 95 % are expected."
)
Card = Mapping[str, str]
"""A data card: texts by their heading, such as "sensor" and "licence"."""


@dataclass(frozen=True)
class Written:
    """What was written: the page, the number of its rows, of those left out, and of the single runs."""

    path: Path
    rows: int
    left_out: int
    runs: int


@dataclass(eq=False)
class _Line:
    """One row of the page: the runs of a label on one dataset from one initial error."""

    suite: SuiteFile
    summary: Statistics

    @property
    def rows(self) -> Sequence[Row]:
        return self.summary.rows

    @property
    def method(self) -> Method:
        return self.rows[-1].method

    @property
    def label(self) -> str:
        return self.summary.label

    @property
    def dataset(self) -> str:
        return self.rows[0].dataset

    @property
    def protocol(self) -> str:
        return self.rows[0].protocol

    @cached_property
    def frames(self) -> tuple[int, int]:
        """Minimum and maximum number of frames of a calibration."""
        counts = {len(row.frames) for row in self.rows}
        return min(counts), max(counts)

    @property
    def comparable(self) -> tuple[str, str, str, int]:
        """What rows have in common that are compared."""
        return self.suite.name, self.dataset, self.protocol, self.frames[1]

    @property
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
    results: Rows,
    folder: Path,
    registry: Registry,
    *,
    cards: Callable[[DatasetTable], Mapping[str, Card]] = lambda table: {},
    overlays: Overlays | None = None,
    on_suite: Callable[[str], None] = lambda name: None,
) -> Written:
    """Write the page of suites, and a file for each 2000 runs, to a folder, and return what was written.

    The page needs no server and loads nothing but these files. It stays below 5 MB: rows beyond `MAX_BYTES` or
    `MAX_ROWS` are left out, which it states. `cards` returns the data cards of a dataset of a suite by title,
    `overlays` draws images. Raises InputError if the folder cannot be written.
    """
    _prepare(folder)
    lines: list[dict[str, Any]] = []
    size = left_out = runs = 0
    names = _Names(registry)
    described: dict[str, Card] = {}
    for suite in suites:
        on_suite(suite.name)
        own = {table.name: cards(table) for table in suite.study.study.dataset}
        for compared in _compared(suite, results):
            chosen = compared[: MAX_ROWS - len(lines)] if size < MAX_BYTES else []
            groups = {norm: top_groups([line.summary.mean(norm) for line in chosen]) for norm in NORMS}
            for number, line in enumerate(chosen):
                shown = _shown_line(line, names) | {"group": {norm: groups[norm][number] for norm in NORMS}}
                shown["cards"] = list(own.get(line.dataset, ()))
                size += len(json.dumps(shown))
                if size > MAX_BYTES:
                    break
                shown["file"] = f"{suite.name}-{len(lines)}"
                shown["parts"] = _write_runs(folder / DATA, shown["file"], line, overlays)
                described |= own.get(line.dataset, {})
                lines.append(shown)
                runs += len(line.rows)
                left_out -= 1
            left_out += len(compared)
    _name_methods(lines)
    data = {
        "rows": lines,
        "suites": {suite.name: suite.suite.question for suite in suites},
        "cards": {title: dict(card) for title, card in described.items()},
        "norms": NORMS,
        "statuses": STATUSES,
        "trusts": TRUSTS,
        "colours": COLOURS,
        "leftOut": left_out,
        "notes": [GROUPS_NOTE, NOTE],
    }
    files = ("p2o_study.report/nodes.js", "p2o_study.report/elements.js", "p2o_study.benchmark/page.js")
    page = rendered(
        "p2o_study.benchmark/page.html",
        style="p2o_study.report/page.css",
        scripts=("".join(map(part, files)),),
        script_files=True,
        title="p2o benchmark",
        own_style=Markup(part("p2o_study.benchmark/page.css")),
        data=script_json(data),
    )
    write_whole(folder / INDEX, page.encode())
    return Written(folder / INDEX, len(lines), left_out, runs)


def _prepare(folder: Path) -> None:
    """Create the folder of the page, and remove the runs of an earlier page."""
    try:
        (folder / DATA).mkdir(parents=True, exist_ok=True)
        for path in (folder / DATA).glob("*.js"):
            path.unlink()
    except OSError as problem:
        got = problem.strerror or str(problem)
        raise InputError("cannot write the folder of the page", where=folder, got=got, hint="--out FOLDER") from problem


def _compared(suite: SuiteFile, results: Rows) -> list[list[_Line]]:
    """Return the rows of a suite, one list for all that are compared with each other."""
    order = {row.label: number for number, row in enumerate(suite.rows)}
    rows: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in results.latest(suite.name):
        rows.setdefault((row.section, row.row, row.dataset, row.protocol), []).append(row)
    group_of = suite.suite.group_of
    lines = [_Line(suite, Statistics(own, label, group_of)) for (_, label, _, _), own in rows.items()]
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


def _shown_line(line: _Line, names: _Names) -> dict[str, Any]:
    """Return a row as JSON."""
    summary, (least, most) = line.summary, line.frames
    family, needs = names.of(line.method)
    coverage = summary.coverage
    starts = [[row.start_error_of(norm) or 0.0 for row in line.rows if row.case.start_error] for norm in NORMS]
    return {
        "label": line.label,
        "method": line.same_method,
        "suite": line.suite.name,
        "dataset": line.dataset,
        "protocol": line.protocol,
        "frames": most,
        "framesText": str(most) if least == most else f"{least} to {most}",
        "family": family,
        "needs": needs,
        "words": dict(line.method.words),
        "source": line.method.source,
        "count": summary.count,
        "groups": summary.groups,
        "refused": summary.refused,
        "mean": {norm: _interval(value) for norm in NORMS if (value := summary.mean(norm))},
        "median": {norm: brief(value.value) for norm in NORMS if (value := summary.median(norm))},
        "solvedOnly": {norm: brief(summary.solved_only.average(norm)) for norm in NORMS if summary.solved},
        "trusted": summary.trusted if summary.judged else None,
        "falseAccepts": summary.false_accepts if summary.judged else None,
        "outside": summary.outside_95 if summary.judged else None,
        "coverage": [brief(coverage.within[name] / coverage.count) for name in BOUNDS] if coverage.count else None,
        "covered": coverage.count,
        "seconds": brief(summary.seconds),
        "time": brief_seconds(summary.seconds),
        "start": [brief(float(np.mean(values))) if values else None for values in starts],
    }


def _interval(value: Interval) -> list[float | None]:
    return [brief(value.value), brief(value.low), brief(value.high)]


def _name_methods(lines: Sequence[dict[str, Any]]) -> None:
    """Replace the key of the method of each row by a number, and add the common name of its rows."""
    labels: dict[str, list[str]] = {}
    for line in lines:
        labels.setdefault(line["method"], []).append(line["label"])
    numbers = {method: number for number, method in enumerate(labels)}
    for line in lines:
        line["name"] = common_name(labels[line["method"]])
        line["method"] = numbers[line["method"]]


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


def _write_runs(folder: Path, name: str, line: _Line, overlays: Overlays | None) -> int:
    """Write the runs of a row, those with the largest errors first, and return the number of files."""
    rows = sorted(line.rows, key=_size, reverse=True)
    starts = range(0, len(rows), _AT_ONCE)
    for number, first in enumerate(starts):
        shown = _shown_runs(rows[first : first + _AT_ONCE])
        shown["overlays"] = [] if overlays is None or number else overlays.of(line.suite, rows)
        text = json.dumps([name, number, shown], separators=(",", ":"))
        # NaN and Infinity are values of a script.
        write_whole(folder / f"{name}-{number}.js", f"receiveRuns(...{text});\n".encode())
    return len(starts)


def _size(row: Row) -> float:
    """Return a size of the error by which runs are sorted; those without an error come first."""
    error = row.error
    return np.inf if error is None else error.rotation_deg / WRONG.angle_deg + error.translation_m / WRONG.distance_m


def _shown_runs(rows: Sequence[Row]) -> dict[str, Any]:
    """Return runs by column; "places" are the distinct frames, "frames" those of groups of several."""
    names = sorted({row.frames for row in rows})
    numbers = {place: number for number, place in enumerate(names)}
    columns: dict[str, Callable[[Row], float | None]] = {
        **{norm: (lambda row, norm=norm: row.error_of(norm)) for norm in NORMS},  # type: ignore[misc]
        **{f"start_{norm}": (lambda row, norm=norm: row.start_error_of(norm)) for norm in NORMS},  # type: ignore[misc]
        **{name: (lambda row, name=name: row.predicted(name.removeprefix("predicted_"))) for name in PREDICTED},  # type: ignore[misc]
        "seconds": lambda row: row.total_s,
    }
    return {
        "places": shown_texts([place_of(place) for place in names]),
        "frames": shown_texts([list(place) if len(place) > 1 else [] for place in names]),
        "place": [numbers[row.frames] for row in rows],
        "seed": [row.seed for row in rows],
        "status": [STATUSES.index(row.status) for row in rows],
        "verdict": [-1 if row.trust is None else TRUSTS.index(row.trust) for row in rows],
        **{name: [_rounded(value(row)) for row in rows] for name, value in columns.items()},
    }


def _rounded(value: float | None) -> float:
    return float("nan") if value is None else round(value, 5)
