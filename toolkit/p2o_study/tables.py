"""Tables of measured and published rows: one list of columns for the terminal, Markdown, LaTeX and documentation."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from p2o.errors import printable
from p2o.results.verdict import Trust
from p2o.run.protocol import figures_text, protocol_of

from p2o_study.row import GIVEN, NORMS
from p2o_study.statistics import MIN_FRAMES, RESAMPLES, WRONG_TEXT, Interval, Statistics, brief_seconds
from p2o_study.study import Published
from p2o_study.summary import Group, Summary

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
    f"False accepts: trusted runs {WRONG_TEXT}. Outside 95 %: trusted runs whose error exceeds their own 95 % bound. "
    "Coverage 67 % and 95 %: rotation errors and then translation errors within the predicted error, out of the solved "
    "runs with a prediction. Not moved: results that are the initial guess, which the solver did not move.",
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


@dataclass(frozen=True)
class Column:
    """A column of measured rows: `text` of a row, shown in a table where `shown` is true of any of its rows."""

    name: str
    text: Callable[[Statistics], str]
    shown: Callable[[Statistics], bool] = lambda row: True


def _verdict(trust: Trust) -> Column:
    return Column(
        trust.value,
        lambda row: str(row.trust.get(trust, 0)) if row.judged else NONE,
        lambda row: row.judged and bool(row.trust.get(trust)),
    )


def _judged(row: Statistics) -> bool:
    return row.judged


COLUMNS: tuple[Column, ...] = (
    Column("start", lambda row: ", ".join(row.protocols) or NONE, lambda row: set(row.protocols) != {GIVEN}),
    Column("runs", lambda row: str(row.count)),
    Column("frames", lambda row: str(row.frames)),
    Column("groups", lambda row: str(row.groups)),
    Column("not solved", lambda row: _not_solved(row), lambda row: bool(row.failures)),
    *map(_verdict, (Trust.TRUSTED, Trust.AMBIGUOUS, Trust.DOUBTFUL)),
    Column("false accepts", lambda row: str(row.false_accepts) if row.judged else NONE, _judged),
    Column("outside 95 %", lambda row: str(row.outside_95) if row.judged else NONE, _judged),
    Column("not moved", lambda row: str(row.unmoved), lambda row: bool(row.unmoved)),
    Column("predicted 67 %", lambda row: predicted_text(row), lambda row: bool(row.predicted)),
    Column("coverage 67 %", lambda row: row.coverage.text_67, lambda row: bool(row.coverage.count)),
    Column("coverage 95 %", lambda row: row.coverage.text_95, lambda row: bool(row.coverage.count)),
    Column("within", lambda row: str(row.reached), lambda row: row.within is not None),
    Column("worse", lambda row: str(row.worse), lambda row: row.within is not None),
    Column("time [s]", lambda row: brief_seconds(row.seconds)),
)
_TERMINAL = {"groups", "predicted 67 %", "start"}
"""Columns that the terminal leaves out."""


def _not_solved(row: Statistics) -> str:
    waiting = f", {row.waiting} not run" if row.waiting else ""
    crashed = f" ({row.crashed} crashed)" if row.crashed else ""
    return f"{row.count - row.solved}{crashed}{waiting}"


def columns_of(rows: Sequence[Statistics], without: Iterable[str] = ()) -> list[Column]:
    """Return the columns that any of the rows has, without the named ones."""
    left_out = set(without)
    return [c for c in COLUMNS if c.name not in left_out and any(map(c.shown, rows))]


def error_table(
    caption: str,
    rows: Sequence[Statistics | Published],
    norms: Sequence[str] = NORMS,
    *,
    columns: Sequence[Column] | None = None,
    solved_only: bool = False,
    comparable: bool = True,
) -> Table:
    """Return the table of the errors of rows: `columns` (default: `columns_of`), then mean and median of each norm.

    With `solved_only` there is also the mean without refused calibrations, where any was refused. The best figures of
    `comparable` rows are bold.
    """
    measured = [row for row in rows if isinstance(row, Statistics)]
    columns = columns_of(measured) if columns is None else columns
    leaders = measured if comparable else ()
    apart = solved_only and any(row.count > row.solved for row in measured)
    header = [column.name for column in columns]
    for norm in norms:
        unit = unit_of(norm)[0]
        header += [f"{name_of(norm)} mean [{unit}]", f"{name_of(norm)} median [{unit}]"]
        header += ["solved only"] if apart else []
    lines = []
    for row in rows:
        if isinstance(row, Published):
            if any(norm in row.values for norm in norms):
                cells = [Cell(NONE)] * len(columns)
                for norm in norms:
                    cells += [_published(row, norm), *[Cell(NONE)] * (1 + apart)]
                lines.append((label_cell(row), *cells))
            continue
        cells = [Cell(column.text(row)) for column in columns]
        for norm in norms:
            cells += [_mean(row, leaders, norm), _median(row, leaders, norm)]
            cells += [Cell(shown(row.solved_only.mean(norm), norm))] if apart else []
        lines.append((label_cell(row), *cells))
    return Table(caption, ("row", *header), tuple(lines))


def axis_table(caption: str, group: Group, axes: Sequence[str]) -> Table:
    """Return the absolute errors by axis: a line of means for each row, and one of medians for measured rows."""
    header = ("row", "", *(f"{name_of(axis)} [{unit_of(axis)[0]}]" for axis in axes))
    lines: list[tuple[Cell, ...]] = []
    for row in group.rows:
        if isinstance(row, Published):
            if any(axis in row.values for axis in axes):
                lines.append((label_cell(row), Cell("mean"), *(_published(row, axis) for axis in axes)))
            continue
        measured = group.measured
        lines.append((label_cell(row), Cell("mean"), *(_mean(row, measured, axis) for axis in axes)))
        lines.append((Cell(""), Cell("median"), *(_median(row, measured, axis) for axis in axes)))
    return Table(f"{caption}{_reached(group, axes)}", header, tuple(lines))


def pair_table(caption: str, group: Group, norms: Sequence[str]) -> Table:
    """Return the paired comparisons of rows."""
    header = ["row", "against", "pairs"]
    for norm in norms:
        header += [f"{name_of(norm)} median difference [{unit_of(norm)[0]}]", "better"]
    lines = []
    for pair in group.comparisons:
        against = f"{pair.against} (other start)" if pair.other_start else pair.against
        cells = [pair.row, against, str(pair.pairs)]
        for norm in norms:
            difference = pair.differences.get(norm)
            if difference is None:
                cells += [NONE, NONE]
                continue
            tied = f" ({100 * difference.tied:.0f} % tied)" if difference.tied else ""
            cells += [shown(difference.median, norm, sign=True), f"{100 * difference.better:.0f} %{tied}"]
        lines.append(tuple(Cell(text) for text in cells))
    return Table(caption, tuple(header), tuple(lines))


def tables_of(group: Group, summary: Summary) -> list[Table]:
    """Return the tables of a group: errors, errors by axis, and paired comparisons of rows if there are several."""
    named = f": {group.heading}" if group.heading else ""
    limits = f" (within: error at most {summary.within}; worse: larger error than the initial guess)"
    caption = f"Errors{named}{limits if summary.within else ''}"
    tables = [
        error_table(caption, group.rows, summary.norms),
        axis_table(f"Absolute errors by axis{named}", group, summary.axes),
    ]
    return [
        *tables,
        *([pair_table(f"Rows compared in pairs{named}", group, summary.norms)] if group.comparisons else ()),
    ]


def terminal_text(summary: Summary) -> str:
    """Return the tables of a study as text, with the lines on all rows below."""
    statistics = [row for group in summary.groups for row in group.measured]
    columns = columns_of(statistics, _TERMINAL)  # of the whole study
    lines: list[list[str]] = []
    by_axis: list[list[str]] = []
    for group in summary.groups:
        errors = error_table(group.heading, group.rows, summary.norms, columns=columns)
        for table, out in ((errors, lines), (axis_table(group.heading, group, summary.axes), by_axis)):
            out += [] if out else [["", *table.header[1:]]]
            out += [[f"[{group.heading}]"]] if group.heading else []
            out += [[cell.text for cell in row] for row in table.rows]
    below = (*summary.pooled, *_unmoved(statistics), *_by_protocol(summary))
    return "\n".join([*_aligned(lines), *(_aligned(by_axis) if summary.has_axes else ()), *below])


def _aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of cells as text with aligned columns; a line of one cell is a heading."""
    widths = [max((len(line[i]) for line in lines if len(line) > 1), default=0) for i in range(len(lines[0]))]
    return [_line(cells, widths) for cells in lines]


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    numbers = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=False)]
    return "  ".join([cells[0].ljust(widths[0]), *numbers]).rstrip()


def _unmoved(rows: Sequence[Statistics]) -> list[str]:
    """Return a line for each row of the table with results that are the initial guess, without being refused."""
    return [
        f"{row.label}: {row.unmoved} of {row.count} results are the initial guess, which the solver did not move"
        for row in rows
        if row.unmoved
    ]


def _by_protocol(summary: Summary) -> list[str]:
    """Return the figures of the protocol, one line per row; a refused calibration counts with its initial guess."""
    if summary.protocol is None:
        return []
    protocol, lines = protocol_of(summary.protocol), []
    for row in (row for group in summary.groups for row in group.measured):
        known = [(one.pose, one.truth) for one in row.rows if one.truth is not None and one.pose is not None]
        if known:
            estimates, truths = (np.array(poses) for poses in zip(*known, strict=True))
            lines.append(f"{row.label}: {figures_text(protocol, protocol.figures(estimates, truths))}")
    return lines


def unit_of(metric: str) -> tuple[str, float, int]:
    """Return the printed unit of a metric, the factor to it and the number of decimals."""
    return ("deg", 1.0, DIGITS) if metric.endswith("_deg") else ("cm", 100.0, DIGITS - 2)


def name_of(metric: str) -> str:
    """Return the name of a metric in tables and figures, without its unit."""
    return _NAME.get(metric, metric.rpartition("_")[0])


def predicted_text(row: Statistics) -> str:
    """Return the predicted errors (67 %) of a row, such as "0.250 deg 5.0 cm"."""
    parts = []
    for norm, value in row.predicted.items():
        unit, factor, digits = unit_of(norm)
        parts.append(f"{factor * value:.{digits}f} {unit}")
    return " ".join(parts) or NONE


def shown(value: Interval | None, metric: str, *, sign: bool = False) -> str:
    """Return a figure with its interval in the unit of its metric."""
    if value is None:
        return NONE
    _, factor, digits = unit_of(metric)
    numbers = [x for x in (value.value, value.low, value.high) if x is not None]
    first, *ends = [f"{factor * x:{'+' * sign}.{digits}f}" for x in numbers]
    return f"{first} [{', '.join(ends)}]" if ends else first


def best(rows: Iterable[Statistics], metric: str, statistic: Literal["mean", "median"]) -> float | None:
    """Return the smallest value among complete rows, rounded as printed; None for fewer than two rows."""
    known = [getattr(row, statistic)(metric) for row in rows if row.complete]
    values = [value.value for value in known if value is not None]
    return round(min(values), DIGITS) if len(values) > 1 else None


def label_cell(row: Statistics | Published) -> Cell:
    """Return the cell with the label of a row, and the source of a published one."""
    return Cell(f"{row.label} (published: {row.source})", "italic") if isinstance(row, Published) else Cell(row.label)


def _published(row: Published, metric: str) -> Cell:
    return Cell(shown(Interval(row.values[metric]), metric), "italic") if metric in row.values else Cell(NONE)


def _mean(row: Statistics, rows: Sequence[Statistics], metric: str) -> Cell:
    return _figure(row, row.mean(metric), best(rows, metric, "mean"), metric)


def _median(row: Statistics, rows: Sequence[Statistics], metric: str) -> Cell:
    value = row.median(metric)
    plain = None if value is None else Interval(value.value)
    return _figure(row, plain, best(rows, metric, "median"), metric)


def _figure(row: Statistics, value: Interval | None, first: float | None, metric: str) -> Cell:
    leads = value is not None and row.complete and first is not None and round(value.value, DIGITS) == first
    return Cell(shown(value, metric), "bold" if leads else "")


def _reached(group: Group, metrics: Sequence[str]) -> str:
    """Return the number of means that are not above the compared published ones as text, or an empty text."""
    pairs = [
        (row.average(metric), published.values[metric])
        for published in group.rows
        if isinstance(published, Published)
        for row in group.measured
        if published.compares_with(row.label)
        for metric in metrics
        if metric in published.values and row.mean(metric) is not None
    ]
    reached = sum(ours <= theirs for ours, theirs in pairs)
    return f" ({reached} of {len(pairs)} means at or under the published ones)" if pairs else ""


_MARKS = {"": "", "bold": "**", "italic": "*"}


def markdown_table(table: Table) -> str:
    """Return a table in Markdown, without its caption."""
    lines = [[md_text(text) for text in table.header]]
    lines += [[f"{_MARKS[cell.style]}{md_text(cell.text)}{_MARKS[cell.style]}" for cell in row] for row in table.rows]
    head, *rows = [f"| {' | '.join(cells)} |\n" for cells in lines]
    return f"{head}|:--{'|--:' * (len(table.header) - 1)}|\n{''.join(rows)}"


_STYLES = {"": "{}", "bold": r"\textbf{{{}}}", "italic": r"\textit{{{}}}"}


def latex_table(table: Table, title: str) -> str:
    r"""Return a table as LaTeX, to be \input in a document that loads booktabs and graphicx."""
    head = " & ".join(map(tex_text, table.header))
    rows = (" & ".join(_STYLES[cell.style].format(tex_text(cell.text)) for cell in row) for row in table.rows)
    body = "".join(f"{row} \\\\\n" for row in rows)
    return (
        f"\\begin{{table}}[htbp]\n\\centering\n\\caption{{{tex_text(title)}. {tex_text(table.caption)}.}}\n"
        f"\\resizebox{{\\linewidth}}{{!}}{{%\n\\begin{{tabular}}{{l{'r' * (len(table.header) - 1)}}}\n\\toprule\n"
        f"{head} \\\\\n\\midrule\n{body}\\bottomrule\n\\end{{tabular}}}}\n\\end{{table}}\n"
    )


def report_markdown(summaries: Sequence[Summary], figures: Callable[[Summary], Sequence[tuple[str, str]]]) -> str:
    """Return the report as Markdown; `figures` gives (title, file name) of the figures of a study."""
    parts = ["# Report\n"]
    for summary in summaries:
        parts += [f"## {md_text(summary.title)}\n", *([f"{md_text(summary.note)}\n"] if summary.note else [])]
        for table in (table for group in summary.groups for table in tables_of(group, summary)):
            parts += [f"**{md_text(table.caption)}**\n", markdown_table(table)]
        parts += [f"{md_text(line)}\n" for line in summary.pooled]
        parts += [f"![{md_text(title)}]({file})\n" for title, file in figures(summary)]
    return "\n".join([*parts, "## How to read it\n", *(f"{note}\n" for note in NOTES)])


def report_latex(summaries: Sequence[Summary]) -> str:
    """Return the tables of the report as LaTeX."""
    parts = ["% \\usepackage{booktabs,graphicx}\n"]
    for summary in summaries:
        parts.append(f"\n% {_one_line(summary.name)}\n")
        for group in summary.groups:
            parts += [latex_table(table, summary.title) for table in tables_of(group, summary)]
    return "".join(parts)


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


def tex_text(text: str) -> str:
    """Escape a text for LaTeX, also after a line break, where a bracket would begin a length."""
    if text == NONE:
        return "--"
    plain = "".join(_TEX.get(letter, letter) for letter in _one_line(text))
    return f"{{}}{plain}" if plain.startswith(("[", "*")) else plain
