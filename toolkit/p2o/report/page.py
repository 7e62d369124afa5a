"""One HTML file with everything in it: tables, plots and pictures work offline, and nothing is ever asked for."""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import printable
from p2o.geometry.pose_error import AXES
from p2o.report.bootstrap import Interval
from p2o.report.figures import COLOURS
from p2o.report.log_axis import RULE, differ_much
from p2o.report.one_file import filled, part
from p2o.report.overlays import Pictures
from p2o.report.rounds import Convergence, convergence
from p2o.report.summary import NORMS, Difference, Group, Measured, Published, Summary, best
from p2o.report.tables import DIGITS, NOTES, failures_of, likely_of, starts_of
from p2o.report.worst import what_went_wrong, worst_run
from p2o.results.verdict import Trust
from p2o.study.columns import METRICS
from p2o.study.store import StoredRow
from p2o.study.tally import brief_seconds, told

_SIGNIFICANT = 6


NO_PLOTS = 'the page has no plots, for plotly is not installed; run: pip install "plotly>=6", and p2o report again'


def plot_library() -> str:
    """Return the JavaScript of plotly as its Python package ships it, "" where it is not installed."""
    try:
        offline = importlib.import_module("plotly.offline")
    except ModuleNotFoundError:
        return ""
    return str(offline.get_plotlyjs())


def page(summaries: Sequence[Summary], pictures: Pictures, library: str) -> str:
    """Return the page of these studies; `library` is `plot_library()`, and without one there are no plots.

    Its content security policy lets it run its own three scripts and load nothing.
    """
    data = {
        "studies": [_study(summary, pictures) for summary in summaries],
        "pictures": pictures.uris,
        "metrics": METRICS,
        "norms": NORMS,
        "axes": AXES,
        "trusts": [*Trust],
        "colours": COLOURS,
        "notes": NOTES,
        "rule": RULE,
        "noPlots": "" if library else f"{NO_PLOTS}. The figures beside this page, PNG and SVG, show the same.",
    }
    script = part("page.js")
    parts = {
        "title": "p2o report",
        "style": part("page.css"),
        "library": library,
        "script": script,
        "data": _json(data),
    }
    return filled("page.html", parts, scripts=(library, script))


def _json(value: Any) -> str:
    """Return JSON that may stand inside a script element: nothing in it can end the element."""
    text = json.dumps(_shown(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def _shown(value: Any) -> Any:
    """Return a value without control characters in its texts, whose lines stay lines."""
    if isinstance(value, str):
        return "\n".join(map(printable, value.split("\n")))
    if isinstance(value, Mapping):
        return {_shown(key): _shown(part) for key, part in value.items()}
    return [_shown(part) for part in value] if isinstance(value, list | tuple) else value


def _study(summary: Summary, pictures: Pictures) -> dict[str, Any]:
    recipes = _Numbered()
    return {
        "name": summary.name,
        "title": summary.title,
        "note": " ".join([summary.note, *(f"{line}." for line in summary.pooled)]).strip(),
        "norms": summary.norms,
        "within": summary.within,
        "axes": summary.axes,
        "groups": [_group(group, summary.norms, recipes, pictures) for group in summary.groups],
        "recipes": recipes.values,
    }


class _Numbered:
    """Values that many runs share, each once."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._numbers: dict[str, int] = {}

    def number(self, value: Any) -> int:
        """Return the number of a value."""
        key = json.dumps(value, sort_keys=True)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
        return self._numbers[key]


def _group(group: Group, norms: Sequence[str], recipes: _Numbered, pictures: Pictures) -> dict[str, Any]:
    labels = list(group.runs)
    every = [run for label in labels for run in group.runs[label]]
    worst = [worst_run(runs) for runs in group.runs.values() if runs]
    histories = [convergence(group.runs[label]) for label in labels]
    return {
        "heading": group.heading,
        "rows": [_row(row, group, norms) for row in group.rows],
        "worst": [{"run": every.index(run), "said": what_went_wrong(run)} for run in worst],
        "labels": labels,
        "rounds": [None if history is None else _rounds(history) for history in histories],
        "log": [metric for metric in METRICS if differ_much(_values(group, metric))],
        "logRounds": _log_rounds([history for history in histories if history is not None]),
        "pairs": [
            {
                "row": pair.row,
                "against": pair.against,
                "pairs": pair.pairs,
                "otherStart": pair.other_start,
                "differences": {metric: _difference(value) for metric, value in pair.differences.items()},
            }
            for pair in group.comparisons
        ],
        "runs": [
            _run(run, number, recipes, pictures) for number, label in enumerate(labels) for run in group.runs[label]
        ],
    }


def _values(group: Group, metric: str) -> list[Float]:
    """Return the errors of each row in a metric."""
    values = ([getattr(run, metric) for run in runs] for runs in group.runs.values())
    return [np.array([value for value in row if value is not None], np.float64) for row in values]


def _log_rounds(histories: Sequence[Convergence]) -> list[str]:
    """Return what of the rounds has a logarithmic axis: rows end far from each other."""
    ends = zip(*(history.ends for history in histories), strict=True)
    return [
        what
        for what, last in zip(("matches", "residual"), ends, strict=False)
        if differ_much([np.array([value]) for value in last])
    ]


def _row(row: Measured | Published, group: Group, norms: Sequence[str]) -> dict[str, Any]:
    if isinstance(row, Published):
        means = {metric: [_brief(value), None, None] for metric, value in row.values.items()}
        return {
            "label": row.label,
            "published": row.source,
            "note": row.note,
            "start": starts_of(row),
            "mean": means,
            "median": {},
        }
    out: dict[str, Any] = {
        "label": row.label,
        "start": starts_of(row),
        "runs": row.runs,
        "frames": len(row.places),
        "failures": failures_of(row),
        "failed": sum(row.failures.values()),
        "trust": told(row.trust) if row.trust else None,
        "trusted": row.trust.get(Trust.TRUSTED, 0) if row.trust else None,
        "trustedWrong": row.trusted_wrong if row.trust else None,
        "likely": likely_of(row, norms) if row.likely else None,
        "likelySize": None if not row.likely else _brief(next(iter(row.likely.values()))),
        "held": [row.held.two_thirds, row.held.nineteen_twentieths] if row.held.count else None,
        "heldRotations": [row.held.rotation, row.held.rotation_95] if row.held.count else None,
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


def _run(run: StoredRow, row: int, recipes: _Numbered, pictures: Pictures) -> dict[str, Any]:
    shown = [
        {"frame": frame, "before": pictures.of[run.key, frame][0], "after": pictures.of[run.key, frame][1]}
        for frame in run.frames
        if (run.key, frame) in pictures.of
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
        "evidence": _evidence(run),
        "costUnit": "" if run.judged is None else run.judged["unit"],
        "errors": [_brief(getattr(run, metric)) for metric in METRICS],
        "start": [_brief(run.start_rotation_deg), _brief(run.start_translation_m)],
        "matches": dict(run.matches),
        "seconds": {stage: _brief(value) for stage, value in run.seconds.items()},
        "rounds": [
            [
                r.get("stage", ""),
                _brief(r.get("reach_px")),
                sum((r.get("matches") or {}).values()),
                _brief(r.get("mean_residual")),
                _brief(r.get("cost")),
                _brief(r.get("step_deg")),
                _brief(r.get("step_m")),
                bool(r.get("accepted")),
            ]
            for r in run.rounds
        ],
        "estimate": None if run.estimate is None else np.round(run.estimate, 9).tolist(),
        "recipe": recipes.number({"recipe": unseeded, "versions": dict(run.versions)}),
        "exception": run.exception or "",
        "finished": run.finished,
        "pictures": shown,
    }


def _evidence(run: StoredRow) -> list[tuple[str, str]]:
    """Return what was found beside the pose, in the words of `p2o run`; what is not known is left out."""
    lines = []
    if run.judged is not None:
        start, end = (_said(run.judged[word], run.judged["unit"]) for word in ("start", "estimate"))
        lines.append(("cost", f"{start} at the start, {end} at the end, by {run.judged['judge']}"))
    if run.agreement is not None:
        lines.append(("agreement", f"odds ratio {_said(run.agreement)}"))
    if run.rival_lead is not None:
        away = f"{_said(run.rival_rotation_deg, 'deg')} and {_said(run.rival_translation_m, 'm')} away"
        lines.append(("next best", f"{away}, {_said(run.rival_lead, run.rival_unit or '')} worse"))
    if run.likely_rotation_deg is not None:
        usual = f"{_said(run.likely_rotation_deg, 'deg')} and {_said(run.likely_translation_m, 'm')}"
        rare = f"{_said(run.likely_rotation_deg_95, 'deg')} and {_said(run.likely_translation_m_95, 'm')}"
        lines.append(("accuracy", f"two of three within {usual}, 19 of 20 within {rare}"))
    if run.time_offset_s is not None and run.time_sigma_s is not None:
        offset = f"{1000 * run.time_offset_s:+.1f} ms (+-{1000 * run.time_sigma_s:.1f})"
        lines.append(("time", f"images later than told by {offset}, {run.time_use or 'told'}"))
    return lines


def _said(value: float | str | None, unit: str = "") -> str:
    """Return a number with its unit; infinities are texts in stores."""
    number = "-" if value is None else f"{float(value):.3g}"
    return f"{number} {unit}".rstrip()


def _rounds(history: Convergence) -> dict[str, Any]:
    quartiles = {"matches": history.matches, "residual": history.residual_px}
    return {"runs": history.runs, **{k: [[_brief(x) for x in line] for line in v] for k, v in quartiles.items()}}


def _difference(value: Difference) -> dict[str, Any]:
    return {"median": _interval(value.median), "better": _brief(value.better), "tied": _brief(value.tied)}


def _interval(value: Interval) -> list[float | None]:
    return [_brief(value.value), _brief(value.low), _brief(value.high)]


def _brief(value: float | str | None) -> float | None:
    """Return a number with as many digits as anyone reads; None for what is not finite, which is text in stores."""
    return None if value is None or not np.isfinite(float(value)) else float(f"{value:.{_SIGNIFICANT}g}")
