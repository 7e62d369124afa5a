"""The report as one HTML file: tables, plots and overlays work offline and load nothing."""

from __future__ import annotations

import base64
import gzip
import importlib
import itertools
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from p2o.arrays import Float
from p2o.draw.one_file import part, rendered
from p2o.errors import printable
from p2o.geometry.pose_error import AXES
from p2o.results.figures import figure_lines
from p2o.results.verdict import Trust

from p2o_study.report.figures import COLOURS
from p2o_study.report.overlays import OverlayImages
from p2o_study.report.series import (
    QUARTILES,
    RULE,
    Convergence,
    convergence_of,
    differ_much,
    lifted,
    rounds_differ_much,
)
from p2o_study.report.worst import error_rank, outcome_text, worst_run
from p2o_study.row import METRICS, NORMS, Row
from p2o_study.statistics import Comparison, Interval, Statistics, brief_seconds, trust_text
from p2o_study.study import Published
from p2o_study.summary import Group, Summary
from p2o_study.tables import DIGITS, NONE, NOTES, best, predicted_text

_SIGNIFICANT = 6
_RUN_BYTES = 1_500_000
"""Maximum size of the single runs on the page, as JSON; about 1,000 runs."""
_MOST_ROWS = 400
_MOST_POINTS = 2000
"""Maximum number of points of the plot of errors by frame: rows times frames."""
NO_PLOTS = 'the page has no plots, because plotly is missing; run: pip install "plotly>=6", and p2o report again'


def plot_library() -> str:
    """Return the JavaScript of plotly from its Python package, "" if it is not installed."""
    try:
        offline = importlib.import_module("plotly.offline")
    except ModuleNotFoundError:
        return ""
    return str(offline.get_plotlyjs())


def page(summaries: Sequence[Summary], images: OverlayImages, library: str) -> str:
    """Return the page of these studies; `library` is `plot_library()`, "" for a page without plots.

    Without overlays the page stays below 5 MB for any number of runs and rows: it has the first `_MOST_ROWS` rows, and
    the worst runs of each row as far as `_RUN_BYTES` allows; plots are of all runs. The content security policy allows
    the page's own scripts only and no requests.
    """
    summaries = _with_first_rows(summaries)
    data = {
        "studies": [
            _study(summary, runs) for summary, runs in zip(summaries, _chosen_runs(summaries, images), strict=True)
        ],
        "images": images.uris,
        "metrics": METRICS,
        "norms": NORMS,
        "axes": AXES,
        "trusts": [*Trust],
        "colours": COLOURS,
        "notes": NOTES,
        "rule": RULE,
        "noPlots": "" if library else f"{NO_PLOTS}. The figures beside this page, PNG and SVG, show the same.",
    }
    scripts = (library, "".join(part(f"p2o_study.report/{name}.js") for name in ("nodes", "elements", "page")))
    template, style = "p2o_study.report/page.html", "p2o_study.report/page.css"
    # Compressed, because the library has 5 MB; the policy contains the hash of its text.
    packed = base64.b64encode(gzip.compress(library.encode(), mtime=0)).decode() if library else ""
    values: dict[str, Any] = {"title": "p2o report", "data": script_json(data), "library": Markup(packed)}
    return rendered(template, style=style, scripts=scripts, **values)


def script_json(value: Any) -> Markup:
    """Return JSON for a script element: `<` is escaped, so that no text can end the element."""
    text = json.dumps(shown_texts(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def shown_texts(value: Any) -> Any:
    """Return a value with control characters in texts escaped, except for newlines."""
    if isinstance(value, str):
        return "\n".join(map(printable, value.split("\n")))
    if isinstance(value, Mapping):
        return {shown_texts(key): shown_texts(part) for key, part in value.items()}
    return [shown_texts(part) for part in value] if isinstance(value, list | tuple) else value


def _with_first_rows(summaries: Sequence[Summary]) -> list[Summary]:
    """Return the summaries with the first `_MOST_ROWS` rows of all groups together; a note counts those left out."""
    left, out = _MOST_ROWS, []
    for summary in summaries:
        groups = []
        for group in summary.groups:
            kept = group.measured[:left]
            left -= len(kept)
            if kept:
                groups.append(
                    Group(group.heading, tuple(r for r in group.rows if isinstance(r, Published) or r in kept))
                )
        shown, every = (sum(len(group.measured) for group in some) for some in (groups, summary.groups))
        note = f"{summary.note} This page has the first {shown} of {every} rows; report.md has all."
        out.append(replace(summary, groups=tuple(groups), note=summary.note if shown == every else note.strip()))
    return [summary for summary in out if summary.groups]


def _chosen_runs(summaries: Sequence[Summary], images: OverlayImages) -> list[_Runs]:
    """Return the runs on the page: the worst run of each row, then the next worst of each, up to `_RUN_BYTES`."""
    chosen = [_Runs(_Numbered(), [{} for _ in summary.groups]) for summary in summaries]
    drawn = {key for key, _ in images.of}
    queues = []
    for runs, summary in zip(chosen, summaries, strict=True):
        for taken, group in zip(runs.groups, summary.groups, strict=True):
            for row, some in enumerate(measured.rows for measured in group.measured):
                order = sorted(range(len(some)), key=lambda i: error_rank(some[i]), reverse=True)
                # The worst run of a row is always its first, those with overlays are next.
                order[1:] = sorted(order[1:], key=lambda i: some[i].key not in drawn)
                queues.append([(runs, taken, row, place, some[place]) for place in order])
    left = _RUN_BYTES
    turns = (entry for turn in itertools.zip_longest(*queues) for entry in turn if entry is not None)
    for runs, taken, row, place, run in turns:
        before = runs.recipes.size
        shown = _run(run, row, runs.recipes, images)
        left -= len(json.dumps(shown)) + runs.recipes.size - before
        if left < 0:
            break
        taken[row, place] = (run, shown)
    return chosen


class _Runs(NamedTuple):
    """The runs of a study on the page, by group: (row, place in the row) to the run and its JSON."""

    recipes: _Numbered
    groups: list[dict[tuple[int, int], tuple[Row, dict[str, Any]]]]


def _study(summary: Summary, runs: _Runs) -> dict[str, Any]:
    return {
        **{name: getattr(summary, name) for name in ("name", "title", "norms", "axes")},
        "within": "" if summary.within is None else str(summary.within),
        "note": " ".join([summary.note, *(f"{line}." for line in summary.pooled)]).strip(),
        "groups": [_group(group, summary.norms, own) for group, own in zip(summary.groups, runs.groups, strict=True)],
        "recipes": runs.recipes.values,
    }


class _Numbered:
    """A list of values without duplicates."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._numbers: dict[str, int] = {}
        self.size = 0

    def number(self, value: Any) -> int:
        """Return the index of a value, which is added if it is new."""
        key = json.dumps(value, sort_keys=True)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
            self.size += len(key)
        return self._numbers[key]


def _group(
    group: Group, norms: Sequence[str], chosen: Mapping[tuple[int, int], tuple[Row, dict[str, Any]]]
) -> dict[str, Any]:
    every = [row.rows for row in group.measured]
    labels = [row.label for row in group.measured]
    numbers = {place: number for number, place in enumerate(sorted(chosen))}
    worst = [(row, runs.index(worst_run(runs))) for row, runs in enumerate(every) if runs]
    histories = [convergence_of(runs) for runs in every]
    errors = {metric: [row.signed(metric) for row in group.measured] for metric in METRICS}
    return {
        "heading": group.heading,
        "rows": [_row(row, group, norms) for row in group.rows],
        "worst": [{"run": numbers[at], "text": outcome_text(chosen[at][0])} for at in worst if at in chosen],
        "labels": labels,
        "rounds": [None if history is None else _rounds(history) for history in histories],
        "log": [metric for metric in METRICS if differ_much(errors[metric])],
        "logRounds": list(itertools.compress(("matches", "residual"), rounds_differ_much(histories))),
        "boxes": {metric: [_box(values) for values in rows] for metric, rows in errors.items()},
        "sizeBoxes": {metric: [_box(values) for values in lifted(rows)] for metric, rows in errors.items()},
        **_by_frame(group, numbers),
        "pairs": [_pair(pair) for pair in group.comparisons],
        "runs": [chosen[place][1] for place in numbers],
        "total": sum(map(len, every)),
    }


def _box(values: Float) -> list[float | None] | None:
    """Return lower whisker, quartiles and upper whisker of errors; None without errors."""
    if not len(values):
        return None
    low, middle, high = np.quantile(values, QUARTILES)
    length = 1.5 * (high - low)
    inner = values[(values >= low - length) & (values <= high + length)]
    return [brief(float(value)) for value in (inner.min(), low, middle, high, inner.max())]


def _by_frame(group: Group, numbers: Mapping[tuple[int, int], int]) -> dict[str, Any]:
    """Return the frames with the largest errors, and by row and frame the range of each metric and its worst run."""
    largest: dict[str, float] = {}
    for run in itertools.chain(*(row.rows for row in group.measured)):
        largest[run.place] = max(largest.get(run.place, -1.0), error_rank(run)[0])
    most = max(1, _MOST_POINTS // max(1, len(group.measured)))
    kept = set(sorted(largest, key=lambda place: -largest[place])[:most])
    places = [place for place in largest if place in kept]
    rows = []
    for row, runs in enumerate(measured.rows for measured in group.measured):
        members: dict[str, list[int]] = {place: [] for place in places}
        for number, run in enumerate(runs):
            if run.place in members:
                members[run.place].append(number)
        rows.append([_ranges(row, runs, some, numbers) for some in members.values()])
    return {"places": places, "frames": rows}


def _ranges(
    row: int, runs: Sequence[Row], members: Sequence[int], numbers: Mapping[tuple[int, int], int]
) -> dict[str, list[float | int | None]]:
    """Return by metric minimum, median and maximum error, and the number of the worst run if it is on the page."""
    ranges: dict[str, list[float | int | None]] = {}
    for metric in METRICS:
        sizes = sorted((abs(size), i) for i in members if (size := runs[i].error_of(metric)) is not None)
        if sizes:
            values = [size for size, _ in sizes]
            three = (values[0], statistics.median(values), values[-1])
            ranges[metric] = [*map(brief, three), numbers.get((row, sizes[-1][1]))]
    return ranges


def _row(row: Statistics | Published, group: Group, norms: Sequence[str]) -> dict[str, Any]:
    if isinstance(row, Published):
        means = {metric: [brief(value), None, None] for metric, value in row.values.items()}
        texts = {"label": row.label, "published": row.source, "note": row.note, "start": row.start or NONE}
        return {**texts, "mean": means, "median": {}}
    coverage = row.coverage
    out: dict[str, Any] = {
        "label": row.label,
        "start": ", ".join(row.protocols) or NONE,
        "runs": row.count,
        "frames": row.frames,
        "failures": ", ".join(f"{count} {status}" for status, count in row.failures.items()) or "0",
        "failed": sum(row.failures.values()),
        "trust": trust_text(row.trust) if row.trust else None,
        "trusted": row.trusted if row.judged else None,
        "falseAccepts": row.false_accepts if row.judged else None,
        "outside": row.outside_95 if row.judged else None,
        "unmoved": row.unmoved,
        "predicted": predicted_text(row) if row.predicted else None,
        "predictedSize": None if not row.predicted else brief(next(iter(row.predicted.values()))),
        "coverage": [coverage.text_67, coverage.text_95] if coverage.count else None,
        "coverageRotations": [coverage.within[f"rotation_deg{s}"] for s in ("", "_95")] if coverage.count else None,
        "seconds": None if math.isnan(row.seconds) else row.seconds,
        "time": brief_seconds(row.seconds),
        "within": row.reached,
        "worse": row.worse,
        "best": [],
    }
    for statistic in ("mean", "median"):
        values = {metric: getattr(row, statistic)(metric) for metric in METRICS}
        known = {metric: value for metric, value in values.items() if value is not None}
        out[statistic] = {metric: _interval(value) for metric, value in known.items()}
        for metric, value in known.items():
            first = best(group.measured, metric, statistic)
            if row.complete and first is not None and round(value.value, DIGITS) == first:
                out["best"].append(f"{metric} {statistic}")
    return out


def _run(run: Row, row: int, recipes: _Numbered, images: OverlayImages) -> dict[str, Any]:
    shown = [
        {"frame": frame, "before": images.of[run.key, frame][0], "after": images.of[run.key, frame][1]}
        for frame in run.frames
        if (run.key, frame) in images.of
    ]
    return {
        "row": row,
        "place": run.place,
        "frames": run.frames if len(run.frames) > 1 else [],
        "seed": run.seed,
        "perturb": run.protocol,
        "status": run.status,
        "solved": run.solved,
        "reason": run.reason,
        "trust": run.trust,
        "why": run.why or "",
        "evidence": figure_lines(run.figures),
        "costUnit": run.figures.get("cost_unit") or "",
        "errors": [brief(run.error_of(metric)) for metric in METRICS],
        "start": [brief(run.start_error_of(norm)) for norm in NORMS],
        "matches": dict(run.matches),
        "seconds": {stage: brief(value) for stage, value in run.seconds.items()},
        "rounds": [
            [r.stage, brief(r.reach_px), sum(r.matches.values()), *numbers, r.accepted]
            for r in run.rounds
            for numbers in [map(brief, (r.mean_residual, r.cost, r.step_deg, r.step_m))]
        ],
        "estimate": None if run.pose is None else np.round(run.pose, 9).tolist(),
        "recipe": recipes.number(
            {"recipe": {**run.method.words, "options": run.method.options}, "versions": dict(run.environment.versions)}
        ),
        "exception": run.exception or "",
        "finished": run.finished,
        "overlays": shown,
    }


def _rounds(history: Convergence) -> dict[str, Any]:
    quartiles = {"matches": history.matches, "residual": history.residual_px}
    return {"runs": history.runs, **{k: [[brief(x) for x in line] for line in v] for k, v in quartiles.items()}}


def _pair(pair: Comparison) -> dict[str, Any]:
    differences = {
        metric: {"median": _interval(value.median), "better": brief(value.better), "tied": brief(value.tied)}
        for metric, value in pair.differences.items()
    }
    names = {"row": pair.row, "against": pair.against, "pairs": pair.pairs, "otherStart": pair.other_start}
    return {**names, "differences": differences}


def _interval(value: Interval) -> list[float | None]:
    return [brief(value.value), brief(value.low), brief(value.high)]


def brief(value: float | str | None) -> float | None:
    """Return a number with 6 significant digits; None for None and non-finite values, which stores keep as text."""
    return None if value is None or not np.isfinite(float(value)) else float(f"{value:.{_SIGNIFICANT}g}")
