"""The report as one HTML file: tables, plots and overlays work offline and load nothing."""

from __future__ import annotations

import importlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from p2o.arrays import Float
from p2o.draw.one_file import part, rendered
from p2o.errors import printable
from p2o.geometry.pose_error import AXES
from p2o.results.figures import figure_lines
from p2o.results.verdict import Trust

from p2o_study.columns import METRICS
from p2o_study.report.bootstrap import Interval
from p2o_study.report.figures import COLOURS
from p2o_study.report.overlays import OverlayImages
from p2o_study.report.series import RULE, Convergence, convergence, differ_much, rounds_differ_much
from p2o_study.report.summary import NORMS, Comparison, Group, Measured, Summary, best
from p2o_study.report.tables import DIGITS, NOTES, failures_of, predicted_text, starts_of
from p2o_study.report.worst import outcome_text, worst_run
from p2o_study.store import StoredRow
from p2o_study.study import Published
from p2o_study.tally import brief_seconds, trust_text

_SIGNIFICANT = 6
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

    The content security policy allows the page's own scripts only and no requests.
    """
    data = {
        "studies": [_study(summary, images) for summary in summaries],
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
    scripts = (library, part("p2o_study.report/page.js"))
    template, style = "p2o_study.report/page.html", "p2o_study.report/page.css"
    return rendered(template, style=style, scripts=scripts, title="p2o report", data=_json(data))


def _json(value: Any) -> Markup:
    """Return JSON for a script element: `<` is escaped, so that no text can end the element."""
    text = json.dumps(_shown(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def _shown(value: Any) -> Any:
    """Return a value with control characters in texts escaped, except for newlines."""
    if isinstance(value, str):
        return "\n".join(map(printable, value.split("\n")))
    if isinstance(value, Mapping):
        return {_shown(key): _shown(part) for key, part in value.items()}
    return [_shown(part) for part in value] if isinstance(value, list | tuple) else value


def _study(summary: Summary, images: OverlayImages) -> dict[str, Any]:
    recipes = _Numbered()
    return {
        **{name: getattr(summary, name) for name in ("name", "title", "norms", "within", "axes")},
        "note": " ".join([summary.note, *(f"{line}." for line in summary.pooled)]).strip(),
        "groups": [_group(group, summary.norms, recipes, images) for group in summary.groups],
        "recipes": recipes.values,
    }


class _Numbered:
    """A list of values without duplicates."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._numbers: dict[str, int] = {}

    def number(self, value: Any) -> int:
        """Return the index of a value, which is added if it is new."""
        key = json.dumps(value, sort_keys=True)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
        return self._numbers[key]


def _group(group: Group, norms: Sequence[str], recipes: _Numbered, images: OverlayImages) -> dict[str, Any]:
    labels = list(group.runs)
    every = [run for label in labels for run in group.runs[label]]
    worst = [worst_run(runs) for runs in group.runs.values() if runs]
    histories = [convergence(group.runs[label]) for label in labels]
    return {
        "heading": group.heading,
        "rows": [_row(row, group, norms) for row in group.rows],
        "worst": [{"run": every.index(run), "text": outcome_text(run)} for run in worst],
        "labels": labels,
        "rounds": [None if history is None else _rounds(history) for history in histories],
        "log": [metric for metric in METRICS if differ_much(_values(group, metric))],
        "logRounds": list(itertools.compress(("matches", "residual"), rounds_differ_much(histories))),
        "pairs": [_pair(pair) for pair in group.comparisons],
        "runs": [
            _run(run, number, recipes, images) for number, label in enumerate(labels) for run in group.runs[label]
        ],
    }


def _values(group: Group, metric: str) -> list[Float]:
    """Return the errors of each row in a metric."""
    values = ([getattr(run, metric) for run in runs] for runs in group.runs.values())
    return [np.array([value for value in row if value is not None], np.float64) for row in values]


def _row(row: Measured | Published, group: Group, norms: Sequence[str]) -> dict[str, Any]:
    if isinstance(row, Published):
        means = {metric: [_brief(value), None, None] for metric, value in row.values.items()}
        texts = {"label": row.label, "published": row.source, "note": row.note, "start": starts_of(row)}
        return {**texts, "mean": means, "median": {}}
    out: dict[str, Any] = {
        "label": row.label,
        "start": starts_of(row),
        "runs": row.runs,
        "frames": len(row.places),
        "failures": failures_of(row),
        "failed": sum(row.failures.values()),
        "trust": trust_text(row.trust) if row.trust else None,
        "trusted": row.trust.get(Trust.TRUSTED, 0) if row.trust else None,
        "falseAccepts": row.false_accepts if row.trust else None,
        "predicted": predicted_text(row, norms) if row.predicted else None,
        "predictedSize": None if not row.predicted else _brief(next(iter(row.predicted.values()))),
        "coverage": [row.coverage.text_67, row.coverage.text_95] if row.coverage.count else None,
        "coverageRotations": [row.coverage.rotation, row.coverage.rotation_95] if row.coverage.count else None,
        "seconds": None if math.isnan(row.seconds) else row.seconds,
        "time": brief_seconds(row.seconds),
        "within": row.within,
        "worse": row.worse,
        "best": [],
    }
    for statistic in ("mean", "median"):
        values: Mapping[str, Interval] = getattr(row, statistic)
        out[statistic] = {metric: _interval(value) for metric, value in values.items()}
        for metric, value in values.items():
            first = best(group.measured, metric, statistic, DIGITS)
            if row.complete and first is not None and round(value.value, DIGITS) == first:
                out["best"].append(f"{metric} {statistic}")
    return out


def _run(run: StoredRow, row: int, recipes: _Numbered, images: OverlayImages) -> dict[str, Any]:
    shown = [
        {"frame": frame, "before": images.of[run.key, frame][0], "after": images.of[run.key, frame][1]}
        for frame in run.frames
        if (run.key, frame) in images.of
    ]
    unseeded = {key: value for key, value in run.recipe.items() if key != "seed"}
    return {
        "row": row,
        "place": run.place,
        "frames": run.frames if len(run.frames) > 1 else [],
        "seed": run.seed,
        "perturb": run.perturb or "",
        "status": run.status,
        "solved": run.solved,
        "reason": run.reason,
        "trust": run.trust,
        "why": run.why or "",
        "evidence": figure_lines(run.figures),
        "costUnit": run.figures.get("cost_unit") or "",
        "errors": [_brief(getattr(run, metric)) for metric in METRICS],
        "start": [_brief(run.start_rotation_deg), _brief(run.start_translation_m)],
        "matches": dict(run.matches),
        "seconds": {stage: _brief(value) for stage, value in run.seconds.items()},
        "rounds": [
            [r.stage, _brief(r.reach_px), sum(r.matches.values()), *numbers, r.accepted]
            for r in run.rounds
            for numbers in [map(_brief, (r.mean_residual, r.cost, r.step_deg, r.step_m))]
        ],
        "estimate": None if run.estimate is None else np.round(run.estimate, 9).tolist(),
        "recipe": recipes.number({"recipe": unseeded, "versions": dict(run.versions)}),
        "exception": run.exception or "",
        "finished": run.finished,
        "overlays": shown,
    }


def _rounds(history: Convergence) -> dict[str, Any]:
    quartiles = {"matches": history.matches, "residual": history.residual_px}
    return {"runs": history.runs, **{k: [[_brief(x) for x in line] for line in v] for k, v in quartiles.items()}}


def _pair(pair: Comparison) -> dict[str, Any]:
    differences = {
        metric: {"median": _interval(value.median), "better": _brief(value.better), "tied": _brief(value.tied)}
        for metric, value in pair.differences.items()
    }
    names = {"row": pair.row, "against": pair.against, "pairs": pair.pairs, "otherStart": pair.other_start}
    return {**names, "differences": differences}


def _interval(value: Interval) -> list[float | None]:
    return [_brief(value.value), _brief(value.low), _brief(value.high)]


def _brief(value: float | str | None) -> float | None:
    """Return a number with 6 significant digits; None for None and non-finite values, which stores keep as text."""
    return None if value is None or not np.isfinite(float(value)) else float(f"{value:.{_SIGNIFICANT}g}")
