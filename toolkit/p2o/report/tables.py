"""The tables of a report, made once and written as Markdown and as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from p2o.errors import printable
from p2o.report.bootstrap import MIN_FRAMES, RESAMPLES, Interval
from p2o.report.summary import Group, Measured, Published, Summary, best
from p2o.study.held import WRONG_TOLD
from p2o.study.tally import brief_seconds, told

DIGITS = 3
"""Decimals of degrees and metres; centimetres have two less."""
NONE = "-"

_NAME = {"rotation_deg": "rotation", "translation_m": "translation"}

NOTES = (
    "Errors are of single runs (docs/conventions.md), those about and along the axes absolute. A refused run counts "
    "with the error of its start, which is what its user is left with; a run that raised has no error, and its row no "
    "bold figure. Published rows are as printed in their source, not measured here, and never bold.",
    f"In brackets: 95 % intervals from {RESAMPLES} bootstrap samples of the frames, all seeds of a frame together; "
    f"none for fewer than {MIN_FRAMES} frames. Frames of one drive resemble each other, so that intervals over frames "
    "of few drives are rather too narrow.",
    "A verdict says, without the truth, whether a result may be trusted. Ambiguous: another pose fits about as well. "
    "Doubtful: image and sweep do not seem to belong together, or nothing could check that they do. Refused: there is "
    "no new pose.",
    "Likely 2/3: the median of the errors that two of three results should keep to, as the runs themselves say; no "
    "truth is in it.",
    f"Trusted, wrong: runs that were called trusted and are {WRONG_TOLD}. Held 2/3 and 19/20: rotations and then "
    "translations that are off by no more than the run itself said is likely, for two of three and for 19 of 20 runs, "
    "of the runs that said so; runs without an estimate have said nothing.",
    "Time is the median of the runs of a row, extraction and all, on the machine and beside the work of then.",
    "Pairs are runs on the same frames and seed; negative differences are in favour of the first row.",
)


@dataclass(frozen=True)
class Cell:
    """One entry; `style` is "bold" for the best figure, "italic" for what is published and not measured."""

    text: str
    style: Literal["", "bold", "italic"] = ""


@dataclass(frozen=True)
class Table:
    """A table with a caption; the first column is text, the others are figures."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def tables_of(group: Group, summary: Summary) -> list[Table]:
    """Return the tables of a group: errors, errors by axis, and rows compared in pairs where there are several."""
    named = f": {group.heading}" if group.heading else ""
    found = [
        Table(f"Errors{named}{_counted(summary)}", *_errors(group, summary)),
        Table(f"Absolute errors by axis{named}{_reached(group, summary.axes)}", *_axes(group, summary.axes)),
    ]
    if group.comparisons:
        found.append(Table(f"Rows compared in pairs{named}", *_pairs(group, summary.norms)))
    return found


def markdown(summaries: Sequence[Summary], figures: Callable[[Summary], Sequence[tuple[str, str]]]) -> str:
    """Return the report as Markdown; `figures` gives (title, file name) of the figures of a study."""
    parts = ["# Report\n"]
    for summary in summaries:
        parts.append(f"## {_md(summary.title)}\n")
        if summary.note:
            parts.append(f"{_md(summary.note)}\n")
        for group in summary.groups:
            parts += [_markdown_table(table) for table in tables_of(group, summary)]
        parts += [f"{_md(line)}\n" for line in summary.pooled]
        parts += [f"![{_md(title)}]({file})\n" for title, file in figures(summary)]
    parts += ["## How to read it\n", *(f"{note}\n" for note in NOTES)]
    return "\n".join(parts)


def latex(summaries: Sequence[Summary]) -> str:
    r"""Return the tables as LaTeX, to be \input in a document that loads booktabs and graphicx."""
    parts = [r"% \usepackage{booktabs,graphicx}"]
    for summary in summaries:
        parts.append(f"\n% {_one_line(summary.name)}")
        for group in summary.groups:
            parts += [_latex_table(table, summary) for table in tables_of(group, summary)]
        parts += [f"% {_one_line(line)}" for line in summary.pooled]
    parts += ["", *(f"% {note}" for note in NOTES)]
    return "\n".join(parts) + "\n"


def unit_of(metric: str) -> tuple[str, float, int]:
    """Return the unit a metric is printed in, the factor to it, and the number of decimals."""
    return ("deg", 1.0, DIGITS) if metric.endswith("_deg") else ("cm", 100.0, DIGITS - 2)


def name_of(metric: str) -> str:
    """Return what a metric is called in tables and figures, without its unit."""
    return _NAME.get(metric, metric.rpartition("_")[0])


def starts_of(row: Measured | Published) -> str:
    """Return how wrong the starts of a row are."""
    if isinstance(row, Published):
        return row.start or NONE
    return ", ".join(text or "as given" for text in row.perturb) or NONE


def failures_of(row: Measured) -> str:
    """Return how many runs did not end with an estimate, by status."""
    return ", ".join(f"{count} {status}" for status, count in row.failures.items()) or "0"


def likely_of(row: Measured, norms: Sequence[str]) -> str:
    """Return the likely errors of a row, such as "0.250 deg 5.0 cm"."""
    parts = []
    for norm in norms:
        unit, factor, digits = unit_of(norm)
        if norm in row.likely:
            parts.append(f"{factor * row.likely[norm]:.{digits}f} {unit}")
    return " ".join(parts) or NONE


def shown(value: Interval | None, metric: str, *, sign: bool = False) -> str:
    """Return a figure with its interval in the unit of its metric."""
    if value is None:
        return NONE
    _, factor, digits = unit_of(metric)
    numbers = [x for x in (value.value, value.low, value.high) if x is not None]
    first, *ends = [f"{factor * x:{'+' * sign}.{digits}f}" for x in numbers]
    return f"{first} [{', '.join(ends)}]" if ends else first


def _counted(summary: Summary) -> str:
    return f" (within: solved to {summary.within}; worse: farther off than the start)" if summary.within else ""


def _errors(group: Group, summary: Summary) -> tuple[tuple[str, ...], tuple[tuple[Cell, ...], ...]]:
    norms = summary.norms
    columns = [(metric, statistic) for metric in norms for statistic in ("mean", "median")]
    judged = any(row.trust for row in group.measured)
    promising = any(row.held.count for row in group.measured)
    header = ("row", "start", "runs", "frames", "not solved", *(["verdict", "trusted, wrong"] if judged else []))
    header += ("likely 2/3",) if any(row.likely for row in group.measured) else ()
    header += ("held 2/3", "held 19/20") if promising else ()
    header += (*(["within", "worse"] if summary.within else []), "time [s]")
    titles = tuple(f"{name_of(metric)} {statistic} [{unit_of(metric)[0]}]" for metric, statistic in columns)
    rows = []
    for row in _with_figures(group, norms):
        if isinstance(row, Published):
            texts = [starts_of(row), *[NONE] * (len(header) - 2)]
        else:
            texts = [starts_of(row), str(row.runs), str(len(row.places)), failures_of(row)]
            texts += [told(row.trust), str(row.trusted_wrong) if row.trust else NONE] if judged else []
            texts += [likely_of(row, norms)] if "likely 2/3" in header else []
            texts += [row.held.two_thirds, row.held.nineteen_twentieths] if promising else []
            texts += [str(row.within), str(row.worse)] if summary.within else []
            texts.append(brief_seconds(row.seconds))
        rows.append((_label(row), *map(Cell, texts), *(_figure(row, group, *column) for column in columns)))
    return (*header, *titles), tuple(rows)


def _axes(group: Group, axes: Sequence[str]) -> tuple[tuple[str, ...], tuple[tuple[Cell, ...], ...]]:
    """Return header and rows: a line of means for each row, and one of medians where it was measured."""
    header = ("row", "", *(f"{name_of(axis)} [{unit_of(axis)[0]}]" for axis in axes))
    rows = []
    for row in _with_figures(group, axes):
        rows.append((_label(row), Cell("mean"), *(_figure(row, group, axis, "mean") for axis in axes)))
        if isinstance(row, Measured):
            rows.append((Cell(""), Cell("median"), *(_figure(row, group, axis, "median") for axis in axes)))
    return header, tuple(rows)


def _with_figures(group: Group, metrics: Sequence[str]) -> list[Measured | Published]:
    """Return the rows without those published ones that say nothing about these metrics."""
    return [row for row in group.rows if isinstance(row, Measured) or any(m in row.values for m in metrics)]


def _reached(group: Group, metrics: Sequence[str]) -> str:
    """Return how many means are not above the published ones beside them, or nothing where there are none."""
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


def _markdown_table(table: Table) -> str:
    marks = {"": "", "bold": "**", "italic": "*"}
    lines = [
        f"**{_md(table.caption)}**",
        "",
        _md_row(map(_md, table.header)),
        _md_row([":--", *["--:"] * (len(table.header) - 1)]),
        *(_md_row(marks[c.style] + _md(c.text) + marks[c.style] for c in row) for row in table.rows),
        "",
    ]
    return "\n".join(lines)


def _md_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _md(text: str) -> str:
    """Return a text that Markdown shows as it is: one line, no marks, no links, no formulas."""
    plain = _one_line(text)
    for mark in "\\`*_|<>#&$~":
        plain = plain.replace(mark, f"\\{mark}")
    # Brackets stay where they are an interval, as in nearly every cell.
    return re.sub(r"\](?=[(\[:])", r"]\\", plain)


def _one_line(text: str) -> str:
    return printable(" ".join(text.split()))


def _latex_table(table: Table, summary: Summary) -> str:
    styles = {"": "{}", "bold": r"\textbf{{{}}}", "italic": r"\textit{{{}}}"}
    body = [" & ".join(styles[c.style].format(_tex(c.text)) for c in row) + r" \\" for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}[htbp]",
            r"\centering",
            rf"\caption{{{_tex(summary.title)}. {_tex(table.caption)}.}}",
            r"\resizebox{\linewidth}{!}{%",
            rf"\begin{{tabular}}{{l{'r' * (len(table.header) - 1)}}}",
            r"\toprule",
            " & ".join(map(_tex, table.header)) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}}",
            r"\end{table}",
        ]
    )


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
    """Return a text that LaTeX shows as it is, also behind a line break, where a bracket would be a length."""
    if text == NONE:
        return "--"
    plain = "".join(_TEX.get(letter, letter) for letter in _one_line(text))
    return f"{{}}{plain}" if plain.startswith(("[", "*")) else plain
