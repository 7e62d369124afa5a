"""The tables of a report, written as Markdown and as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from p2o.errors import printable

from p2o_study.coverage import WRONG_TEXT
from p2o_study.report.bootstrap import MIN_FRAMES, RESAMPLES, Interval
from p2o_study.report.summary import Group, Measured, Summary, best
from p2o_study.study import Published
from p2o_study.tally import brief_seconds, trust_text

DIGITS = 3
"""Decimals of degrees and metres; centimetres have two less."""
NONE = "-"

_NAME = {"rotation_deg": "rotation", "translation_m": "translation"}

NOTES = (
    "Errors are those of single runs (docs/conventions.md); errors by axis are absolute. A refused run counts with the "
    "error of its initial guess, which is its result; a run that raised has no error, and its row no bold figure. "
    "Published rows are as printed in their source, not measured here, and never bold.",
    f"In brackets: 95 % intervals from {RESAMPLES} bootstrap samples of the frames, all seeds of a frame together; "
    f"none for fewer than {MIN_FRAMES} frames. Frames of one drive resemble each other, so that intervals over frames "
    "of few drives are rather too narrow.",
    "The verdict is estimated without ground truth. Ambiguous: another pose fits about as well. Doubtful: image and "
    "sweep do not agree at the pose, or no independent check was possible. Refused: there is no new pose.",
    "Predicted 67 %: the median of the predicted errors (67 %), estimated without ground truth.",
    f"False accepts: trusted runs {WRONG_TEXT}. Coverage 67 % and 95 %: rotation errors and then translation errors "
    "within the predicted error, out of the solved runs with a prediction.",
    "Time is the median over the runs of a row, including extraction, on the machine and under the load of the study.",
    "Pairs are runs on the same frames and seed; negative differences are in favour of the first row.",
)


@dataclass(frozen=True)
class Cell:
    """One entry; `style` is "bold" for the best figure, "italic" for published figures."""

    text: str
    style: Literal["", "bold", "italic"] = ""


@dataclass(frozen=True)
class Table:
    """A table with a caption; the first column is text, the others are figures."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def tables_of(group: Group, summary: Summary) -> list[Table]:
    """Return the tables of a group: errors, errors by axis, and paired comparisons of rows if there are several."""
    named = f": {group.heading}" if group.heading else ""
    limits = f" (within: error at most {summary.within}; worse: larger error than the initial guess)"
    tables = [
        Table(f"Errors{named}{limits if summary.within else ''}", *_errors(group, summary)),
        Table(f"Absolute errors by axis{named}{_reached(group, summary.axes)}", *_axes(group, summary.axes)),
    ]
    if group.comparisons:
        tables.append(Table(f"Rows compared in pairs{named}", *_pairs(group, summary.norms)))
    return tables


def markdown(summaries: Sequence[Summary], figures: Callable[[Summary], Sequence[tuple[str, str]]]) -> str:
    """Return the report as Markdown; `figures` gives (title, file name) of the figures of a study."""
    return _rendered("report.md", summaries, figures=figures)


def latex(summaries: Sequence[Summary]) -> str:
    r"""Return the tables as LaTeX, to be \input in a document that loads booktabs and graphicx."""
    return _rendered("report.tex", summaries)


def _rendered(template: str, summaries: Sequence[Summary], **values: Any) -> str:
    """Return the text of a template, which escapes texts by its filters `md`, `tex` and `one_line`."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__, "."),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        # The default delimiters are LaTeX.
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    environment.filters |= {"md": md_text, "tex": _tex, "one_line": _one_line}
    content = {"summaries": summaries, "tables_of": tables_of, "notes": NOTES, **values}
    return environment.get_template(template).render(content)


def unit_of(metric: str) -> tuple[str, float, int]:
    """Return the printed unit of a metric, the factor to it and the number of decimals."""
    return ("deg", 1.0, DIGITS) if metric.endswith("_deg") else ("cm", 100.0, DIGITS - 2)


def name_of(metric: str) -> str:
    """Return the name of a metric in tables and figures, without its unit."""
    return _NAME.get(metric, metric.rpartition("_")[0])


def starts_of(row: Measured | Published) -> str:
    """Return the sizes of the start errors of a row as text."""
    if isinstance(row, Published):
        return row.start or NONE
    return ", ".join(text or "as given" for text in row.perturb) or NONE


def failures_of(row: Measured) -> str:
    """Return the number of runs without an estimate by status as text."""
    return ", ".join(f"{count} {status}" for status, count in row.failures.items()) or "0"


def predicted_text(row: Measured, norms: Sequence[str]) -> str:
    """Return the predicted errors (67 %) of a row, such as "0.250 deg 5.0 cm"."""
    parts = []
    for norm in norms:
        unit, factor, digits = unit_of(norm)
        if norm in row.predicted:
            parts.append(f"{factor * row.predicted[norm]:.{digits}f} {unit}")
    return " ".join(parts) or NONE


def shown(value: Interval | None, metric: str, *, sign: bool = False) -> str:
    """Return a figure with its interval in the unit of its metric."""
    if value is None:
        return NONE
    _, factor, digits = unit_of(metric)
    numbers = [x for x in (value.value, value.low, value.high) if x is not None]
    first, *ends = [f"{factor * x:{'+' * sign}.{digits}f}" for x in numbers]
    return f"{first} [{', '.join(ends)}]" if ends else first


def _errors(group: Group, summary: Summary) -> tuple[tuple[str, ...], tuple[tuple[Cell, ...], ...]]:
    norms = summary.norms
    columns = [(metric, statistic) for metric in norms for statistic in ("mean", "median")]
    judged = any(row.trust for row in group.measured)
    promising = any(row.coverage.count for row in group.measured)
    header = ("row", "start", "runs", "frames", "not solved", *(["verdict", "false accepts"] if judged else []))
    header += ("predicted 67 %",) if any(row.predicted for row in group.measured) else ()
    header += ("coverage 67 %", "coverage 95 %") if promising else ()
    header += (*(["within", "worse"] if summary.within else []), "time [s]")
    titles = tuple(f"{name_of(metric)} {statistic} [{unit_of(metric)[0]}]" for metric, statistic in columns)
    rows = []
    for row in _with_figures(group, norms):
        if isinstance(row, Published):
            texts = [starts_of(row), *[NONE] * (len(header) - 2)]
        else:
            texts = [starts_of(row), str(row.runs), str(len(row.places)), failures_of(row)]
            texts += [trust_text(row.trust), str(row.false_accepts) if row.trust else NONE] if judged else []
            texts += [predicted_text(row, norms)] if "predicted 67 %" in header else []
            texts += [row.coverage.text_67, row.coverage.text_95] if promising else []
            texts += [str(row.within), str(row.worse)] if summary.within else []
            texts.append(brief_seconds(row.seconds))
        rows.append((_label(row), *map(Cell, texts), *(_figure(row, group, *column) for column in columns)))
    return (*header, *titles), tuple(rows)


def _axes(group: Group, axes: Sequence[str]) -> tuple[tuple[str, ...], tuple[tuple[Cell, ...], ...]]:
    """Return header and rows: a line of means for each row, and one of medians for measured rows."""
    header = ("row", "", *(f"{name_of(axis)} [{unit_of(axis)[0]}]" for axis in axes))
    rows = []
    for row in _with_figures(group, axes):
        rows.append((_label(row), Cell("mean"), *(_figure(row, group, axis, "mean") for axis in axes)))
        if isinstance(row, Measured):
            rows.append((Cell(""), Cell("median"), *(_figure(row, group, axis, "median") for axis in axes)))
    return header, tuple(rows)


def _with_figures(group: Group, metrics: Sequence[str]) -> list[Measured | Published]:
    """Return the rows without published ones that lack all of these metrics."""
    return [row for row in group.rows if isinstance(row, Measured) or any(m in row.values for m in metrics)]


def _reached(group: Group, metrics: Sequence[str]) -> str:
    """Return the number of means that are not above the compared published ones as text, or an empty text."""
    pairs = [
        (row.mean[metric].value, published.values[metric])
        for published in group.rows
        if isinstance(published, Published)
        for row in group.measured
        if published.compares_with(row.label)
        for metric in metrics
        if metric in published.values and metric in row.mean
    ]
    reached = sum(ours <= theirs for ours, theirs in pairs)
    return f" ({reached} of {len(pairs)} means at or under the published ones)" if pairs else ""


def _pairs(group: Group, norms: Sequence[str]) -> tuple[tuple[str, ...], tuple[tuple[Cell, ...], ...]]:
    header = ["row", "against", "pairs"]
    for metric in norms:
        header += [f"{name_of(metric)} median difference [{unit_of(metric)[0]}]", "better"]
    rows = []
    for pair in group.comparisons:
        against = f"{pair.against} (other start)" if pair.other_start else pair.against
        cells = [pair.row, against, str(pair.pairs)]
        for metric in norms:
            difference = pair.differences.get(metric)
            if difference is None:
                cells += [NONE, NONE]
                continue
            tied = f" ({100 * difference.tied:.0f} % tied)" if difference.tied else ""
            cells += [shown(difference.median, metric, sign=True), f"{100 * difference.better:.0f} %{tied}"]
        rows.append(tuple(Cell(text) for text in cells))
    return tuple(header), tuple(rows)


def _label(row: Measured | Published) -> Cell:
    if isinstance(row, Published):
        return Cell(f"{row.label} (published: {row.source})", "italic")
    return Cell(row.label)


def _figure(row: Measured | Published, group: Group, metric: str, statistic: str) -> Cell:
    if isinstance(row, Published):
        if statistic == "mean" and metric in row.values:
            return Cell(shown(Interval(row.values[metric]), metric), "italic")
        return Cell(NONE)
    value: Interval | None = getattr(row, statistic).get(metric)
    first = best(group.measured, metric, statistic, DIGITS)
    leads = value is not None and row.complete and first is not None and round(value.value, DIGITS) == first
    return Cell(shown(value, metric), "bold" if leads else "")


def md_text(text: str) -> str:
    """Escape a text for Markdown: one line without marks, links and formulas."""
    plain = _one_line(text)
    for mark in "\\`*_|<>#&$~":
        plain = plain.replace(mark, f"\\{mark}")
    # Only brackets that would form a link are escaped: nearly every cell contains an interval.
    return re.sub(r"\](?=[(\[:])", r"]\\", plain)


def _one_line(text: str) -> str:
    return printable(" ".join(text.split()))


_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}


def _tex(text: str) -> str:
    """Escape a text for LaTeX, also after a line break, where a bracket would begin a length."""
    if text == NONE:
        return "--"
    plain = "".join(_TEX.get(letter, letter) for letter in _one_line(text))
    return f"{{}}{plain}" if plain.startswith(("[", "*")) else plain
