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
from p2o.arrays import Int
from p2o.draw.one_file import part, rendered
from p2o.errors import InputError, P2OError
from p2o.files.whole_file import write_whole
from p2o.host.registry import Registry
from p2o.host.slots import KIND_OF
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
from p2o_study.report.bootstrap import Interval
from p2o_study.report.figures import COLOURS
from p2o_study.report.page import brief, script_json, shown_texts
from p2o_study.report.summary import NORMS
from p2o_study.study import DatasetTable
from p2o_study.tally import brief_seconds

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
    outcomes: Outcomes
    runs: Runs
    clusters: Int

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
    results: Results,
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
    `overlays` draws images. Raises InputError as `Outcomes.read`, and if the folder cannot be written.
    """
    _prepare(folder)
    lines: list[dict[str, Any]] = []
    size = left_out = runs = 0
    names = _Names(registry)
    frames = results.frames
    described: dict[str, Card] = {}
    for suite in suites:
        on_suite(suite.name)
        own = {table.name: cards(table) for table in suite.study.study.dataset}
        for compared in _compared(suite, Outcomes.read(results, suite.name, frames)):
            chosen = compared[: MAX_ROWS - len(lines)] if size < MAX_BYTES else []
            groups = {norm: top_groups([line.summary.mean.get(norm) for line in chosen]) for norm in NORMS}
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
                runs += len(line.runs)
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


def _compared(suite: SuiteFile, outcomes: Outcomes) -> list[list[_Line]]:
    """Return the rows of a suite, one list for all that are compared with each other."""
    clusters = clusters_of(outcomes, suite.suite.groups)
    order = {row.label: number for number, row in enumerate(suite.rows)}
    latest = outcomes.runs[outcomes.latest]
    lines = [_Line(suite, outcomes, runs, clusters) for runs in split_by(latest, "row", "dataset", "protocol")]
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
    counts = (coverage.rotation, coverage.translation, coverage.rotation_95, coverage.translation_95)
    starts = [line.runs[f"start_{norm}"] for norm in NORMS]
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
        "mean": {norm: _interval(value) for norm, value in summary.mean.items()},
        "median": {norm: brief(value) for norm, value in summary.median.items()},
        "solvedOnly": {norm: brief(value) for norm, value in summary.solved_only.items()},
        "trusted": summary.trusted,
        "falseAccepts": summary.false_accepts,
        "coverage": [brief(number / coverage.count) for number in counts] if coverage.count else None,
        "covered": coverage.count,
        "seconds": brief(summary.seconds),
        "time": brief_seconds(summary.seconds),
        "start": [None if np.isnan(values).all() else brief(float(np.nanmean(values))) for values in starts],
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
    runs = line.runs
    size = np.nan_to_num(runs["rotation_deg"] / WRONG.angle_deg + runs["translation_m"] / WRONG.distance_m, nan=np.inf)
    runs = runs[np.argsort(-size, kind="stable")]
    starts = range(0, len(runs), _AT_ONCE)
    for number, first in enumerate(starts):
        own = runs[first : first + _AT_ONCE]
        shown = _shown_runs(own, line.outcomes)
        shown["overlays"] = [] if overlays is None or number else overlays.of(line.suite, line.outcomes, runs)
        text = json.dumps([name, number, shown], separators=(",", ":"))
        # NaN and Infinity are values of a script.
        write_whole(folder / f"{name}-{number}.js", f"receiveRuns(...{text});\n".encode())
    return len(starts)


def _shown_runs(runs: Runs, outcomes: Outcomes) -> dict[str, Any]:
    """Return runs by column; "places" are the distinct frames, "frames" those of groups of several."""
    places, numbers = np.unique(runs["place"], return_inverse=True)
    names = [outcomes.places[place] for place in places]
    bounds = [f"predicted_{norm}{suffix}" for suffix in ("", "_95") for norm in NORMS]
    columns = [*NORMS, *(f"start_{norm}" for norm in NORMS), *bounds, "seconds"]
    return {
        "places": shown_texts([place_of(list(place)) for place in names]),
        "frames": shown_texts([list(place) if len(place) > 1 else [] for place in names]),
        "place": numbers.tolist(),
        "seed": runs["seed"].tolist(),
        "status": runs["status"].tolist(),
        "verdict": runs["verdict"].tolist(),
        **{name: np.round(runs[name], 5).tolist() for name in columns},
    }
