"""Tables of measured and published rows: one list of columns for the terminal, Markdown, LaTeX and documentation."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import methodcaller
from typing import Any, Literal

import numpy as np
from p2o.errors import UnknownNameError, one_line
from p2o.page.page import TRUST_LOOKS, Column, brief, cell, interval
from p2o.results.result import SolverStatus
from p2o.results.verdict import Trust
from p2o.run.protocol import figures_text, protocol_of

from p2o_study.row import GIVEN, METRICS, NORMS, PER_AXIS, Row
from p2o_study.statistics import (
    FRAMES_TEXT,
    MIN_FRAMES,
    RESAMPLES,
    WRONG_TEXT,
    Comparison,
    Interval,
    Share,
    Statistic,
    Statistics,
    brief_seconds,
)
from p2o_study.study import Published
from p2o_study.summary import Group, Summary

DIGITS = 3
"""Decimals of degrees and metres; centimetres have two less."""
NONE = "-"
STATISTICS: tuple[Statistic, ...] = ("mean", "median")
_NAME = {
    "rotation_deg": "rotation",
    "translation_m": "translation",
    "axis_deg": "rotation per axis",
    "axis_m": "translation per axis",
}
_PRINTED = dict(zip(PER_AXIS, NORMS, strict=True))
"""Published figures that are shown as means over axes, too: publications do not always state which they are."""

NOTES = (
    "Runs are calibrations, frames distinct frames, groups independent ones (frames or drives). Errors are those of "
    "single runs (docs/conventions.md), absolute by axis. A refused run counts with the error of its initial "
    "guess, which is its result (solved only: the mean without them); a run that raised has no error, and its row no "
    "bold figure. Published rows are as printed in their source, not measured here, and never bold.",
    f"In brackets: 95 % intervals from {RESAMPLES} bootstrap samples of the groups, all seeds of a frame together; "
    f"none for fewer than {MIN_FRAMES}. Frames of one drive resemble each other, so that intervals over frames of few "
    "drives are rather too narrow. Methods whose intervals overlap have no order.",
    "The verdict is estimated without ground truth. Ambiguous: another pose fits about as well. Doubtful: image and "
    "sweep do not agree at the pose, or no independent check was possible. Refused: there is no new pose.",
    "Predicted 67 %: the median of the predicted errors (67 %), estimated without ground truth.",
    f"False accepts: trusted runs {WRONG_TEXT}. Outside 95 %: trusted runs whose error exceeds their own 95 % bound. "
    f"Of both, {FRAMES_TEXT}. Coverage 67 % and 95 %: rotation errors and then translation errors within the predicted "
    "error, out of the solved runs with a prediction. Not moved: results that are the initial guess.",
    "Per axis: the mean over the three axes of the absolute errors by axis.",
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


def table_of(caption: str, columns: Sequence[Column], rows: Iterable[Any]) -> Table:
    """Return a table with columns of a page: the first line of each cell."""
    header = tuple(map(header_of, columns))
    return Table(caption, header, tuple(tuple(Cell(text_of(column, row)) for column in columns) for row in rows))


def header_of(column: Column) -> str:
    """Return the heading of a column in tables: its name and unit."""
    return f"{column.name} [{column.unit}]" if column.unit else column.name


def text_of(column: Column, row: Any) -> str:
    """Return the first line of the cell of a row, "-" for an empty one; intervals are left out."""
    assert column.of is not None
    value: Any = column.of(row)
    text = None
    if isinstance(value, Mapping):
        value, text = value.get("v"), value.get("t")
    if text is None and isinstance(value, float) and column.digits is not None:
        return f"{value:.{column.digits}f}"
    return text or (NONE if value is None else str(value))


@dataclass(frozen=True)
class Figure:
    """A column of rows in tables and on pages, shown in a table where `shown` is true of any of its measured rows.

    One of errors has a `metric` and a `statistic`: its best value is bold, and published rows have means.
    """

    column: Column
    shown: Callable[[Statistics], bool] = lambda row: True
    metric: str | None = None
    statistic: Statistic = "mean"

    @property
    def name(self) -> str:
        """The name of the column."""
        return self.column.name

    def published(self, row: Published) -> float | None:
        """Return the value of a published row, in degrees or metres."""
        if self.metric is None or self.statistic == "median":
            return None
        return row.values.get(self.metric, row.values.get(_PRINTED.get(self.metric, "")))

    def page_cell(self, row: Statistics | Published, rivals: Sequence[Statistics] = ()) -> Any:
        """Return the cell of a row on a page; the best of the rivals is bold."""
        if isinstance(row, Published):
            return None if self.metric is None else in_unit(self.published(row), self.metric)
        if self.metric is not None:
            best = leads(row, rivals, self.metric, self.statistic)
            return error_cell(row, self.metric, self.statistic, "strong" if best else None)
        return None if self.column.of is None else self.column.of(row)

    def table_cell(self, row: Statistics | Published, rivals: Sequence[Statistics]) -> Cell:
        """Return the cell of a row in a table; the best of the rivals is bold."""
        if self.metric is None:
            return Cell(NONE if isinstance(row, Published) else text_of(self.column, row))
        if isinstance(row, Published):
            value = self.published(row)
            return Cell(NONE) if value is None else Cell(shown(Interval(value), self.metric), "italic")
        known: Interval | None = getattr(row, self.statistic)(self.metric)
        plain = Interval(known.value) if known is not None and self.statistic == "median" else known
        return Cell(shown(plain, self.metric), "bold" if leads(row, rivals, self.metric, self.statistic) else "")


def _judged(row: Statistics) -> bool:
    return row.judged


def _figure_column(
    name: str, of: Callable[[Statistics], Any], shown: Callable[[Statistics], bool] = lambda row: True, hide: int = 3
) -> Figure:
    return Figure(Column(name, hide=hide, of=of), shown)


def _verdict(trust: Trust) -> Figure:
    return _figure_column(
        trust.value,
        lambda row: row.trust.get(trust, 0) if row.judged else None,
        lambda row: row.judged and bool(row.trust.get(trust)),
    )


def _not_solved(row: Statistics) -> Any:
    waiting = f", {row.waiting} not run" if row.waiting else ""
    crashed = f" ({row.crashed} crashed)" if row.crashed else ""
    statuses = ", ".join(f"{count} {status}" for status, count in row.failures.items())
    count = row.count - row.solved
    return cell(count + row.waiting, f"{count}{crashed}{waiting}", statuses or None)


def _accepted(name: str, of: Callable[[Statistics], Share]) -> Figure:
    def share(row: Statistics) -> Any:
        known = of(row)
        return cell(known.runs, str(known)) if row.judged and (known.out_of or not row.trusted) else None

    return _figure_column(name, share, _judged)


def _coverage(suffix: str) -> Figure:
    def covered(row: Statistics) -> Any:
        within, count = row.coverage.within, row.coverage.count
        counts = [within[f"{norm}{suffix}"] for norm in NORMS]
        return cell(brief(counts[0] / count), " ".join(f"{one}/{count}" for one in counts)) if count else None

    name = "coverage 95 %" if suffix else "coverage 67 %"
    return _figure_column(name, covered, lambda row: bool(row.coverage.count), 4)


def _predicted(row: Statistics) -> Any:
    texts = [with_unit(value, norm) for norm, value in row.predicted.items()]
    return cell(brief(next(iter(row.predicted.values()))), " ".join(texts)) if texts else None


FIGURES: tuple[Figure, ...] = (
    _figure_column("start", lambda row: ", ".join(row.protocols) or NONE, lambda row: set(row.protocols) != {GIVEN}, 6),
    _figure_column("runs", lambda row: row.count),
    _figure_column("frames", lambda row: row.frames, hide=5),
    _figure_column("groups", lambda row: row.groups, hide=5),
    _figure_column("not solved", _not_solved, lambda row: bool(row.failures)),
    *map(_verdict, (Trust.TRUSTED, Trust.AMBIGUOUS, Trust.DOUBTFUL)),
    _accepted("false accepts", lambda row: row.false_accepts),
    _accepted("outside 95 %", lambda row: row.outside_95),
    _figure_column("not moved", lambda row: row.unmoved, lambda row: bool(row.unmoved), 5),
    _figure_column("predicted 67 %", _predicted, lambda row: bool(row.predicted), 4),
    _coverage(""),
    _coverage("_95"),
    _figure_column("within", lambda row: row.reached, lambda row: row.within is not None),
    _figure_column("worse", lambda row: row.worse, lambda row: row.within is not None, 4),
    _figure_column("time [s]", lambda row: cell(brief(row.seconds), brief_seconds(row.seconds)), hide=5),
)
_TERMINAL = {"groups", "predicted 67 %", "start"}
"""Columns that the terminal leaves out."""


def figures_of(rows: Iterable[Statistics], without: Collection[str] = ()) -> list[Figure]:
    """Return the columns that any of the rows has, without the named ones."""
    rows = list(rows)
    return [figure for figure in FIGURES if figure.name not in without and any(map(figure.shown, rows))]


def error_figure(metric: str, statistic: Statistic, hide: int = 1, option: str | None = None) -> Figure:
    """Return the column of the mean or median errors in a metric; `hide` and `option` are those of pages."""
    of = partial(error_cell, metric=metric, statistic=statistic)
    column = Column(f"{name_of(metric)} {statistic}", *unit_of(metric)[::2], hide=hide, option=option, of=of)
    return Figure(column, metric=metric, statistic=statistic)


def _of_solved(norm: str) -> Figure:
    return Figure(Column("solved only", of=lambda row: shown(row.solved_only.mean(norm), norm)))


def entries_of(names: Iterable[str], where: str) -> list[Figure]:
    """Return columns by their names, with or without the unit in brackets; raises UnknownNameError, with `where`."""
    entries = []
    for name in names:
        word = name.strip()
        plain = word if word in ENTRIES else word.partition(" [")[0]
        if plain not in ENTRIES:
            raise UnknownNameError("column", word, ENTRIES, where=where)
        entries.append(ENTRIES[plain])
    return entries


def entries_by_default(
    rows: Iterable[Statistics],
    norms: Sequence[str] = NORMS,
    *,
    figures: Sequence[Figure] | None = None,
    solved_only: bool = False,
) -> list[Figure]:
    """Return the columns of rows: `figures` (default: `figures_of`), then mean and median of each norm.

    With `solved_only` there is also the mean without refused calibrations, where any was refused.
    """
    rows = list(rows)
    apart = solved_only and any(row.count > row.solved for row in rows)
    entries = list(figures_of(rows) if figures is None else figures)
    for norm in norms:
        entries += [*(error_figure(norm, one) for one in STATISTICS), *([_of_solved(norm)] if apart else [])]
    return entries


def error_table(
    caption: str, rows: Sequence[Statistics | Published], entries: Sequence[Figure], *, comparable: bool = True
) -> Table:
    """Return the table of rows with these columns; the best figures of `comparable` rows are bold.

    Published rows without a value in any of the columns are left out.
    """
    leaders = [row for row in rows if isinstance(row, Statistics)] if comparable else ()
    lines = []
    for row in rows:
        cells = [entry.table_cell(row, leaders) for entry in entries]
        if not isinstance(row, Published) or any(one.text != NONE for one in cells):
            lines.append((label_cell(row), *cells))
    return Table(caption, ("row", *(header_of(entry.column) for entry in entries)), tuple(lines))


def entries_by_axis(rows: Iterable[Statistics], axes: Sequence[str]) -> list[Figure]:
    """Return the columns of mean absolute errors by axis, and of their means over the axes of one unit."""
    means = [metric for metric, of in PER_AXIS.items() if set(of) <= set(axes)]
    stuck = [figure for figure in figures_of(rows) if figure.name == "not moved"]
    return [*stuck, *(error_figure(metric, "mean") for metric in (*axes, *means))]


def in_unit(value: float | None, metric: str) -> Any:
    """Return the cell of a value in the unit of its metric."""
    if value is None:
        return None
    return cell(None, "unobservable") if value == np.inf else brief(unit_of(metric)[1] * value)


def error_cell(row: Statistics, metric: str, statistic: Statistic, look: str | None = None) -> Any:
    """Return the cell of the mean or median error of a row with its interval."""
    known: Interval | None = getattr(row, statistic)(metric)
    if known is None:
        return None
    factor = unit_of(metric)[1]
    return interval([None if end is None else factor * end for end in (known.value, known.low, known.high)], look)


def pair_columns(norms: Sequence[str]) -> list[Column]:
    """Return the columns of comparisons of two rows."""
    other = " (other start)"
    columns = [
        Column("row", text=True, hide=0, of=lambda pair: pair.row),
        Column("against", text=True, hide=0, of=lambda pair: pair.against + other * pair.other_start),
        Column("pairs", hide=3, of=lambda pair: pair.pairs),
    ]
    for norm in norms:
        unit = unit_of(norm)[0]
        columns.append(Column(f"{name_of(norm)} median difference", unit, of=partial(_difference, norm=norm)))
        columns.append(Column(f"{name_of(norm)} better", hide=2, of=partial(_better, norm=norm)))
    return columns


def _difference(pair: Comparison, norm: str) -> Any:
    known = pair.differences.get(norm)
    return None if known is None else cell(brief(known.median.value), shown(known.median, norm, sign=True))


def _better(pair: Comparison, norm: str) -> Any:
    known = pair.differences.get(norm)
    if known is None:
        return None
    tied = f" ({100 * known.tied:.0f} % tied)" if known.tied else ""
    return cell(brief(known.better), f"{100 * known.better:.0f} %{tied}")


def tables_of(group: Group, summary: Summary, columns: Sequence[str] = ()) -> list[Table]:
    """Return the tables of a group: errors, errors by axis, and paired comparisons of rows if there are several.

    With names of `columns` only the table of errors, with these columns.
    """
    named = f": {group.heading}" if group.heading else ""
    limits = f" (within: error at most {summary.within}; worse: larger error than the initial guess)"
    caption = f"Errors{named}{limits if summary.within else ''}"
    if columns:
        return [error_table(caption, group.rows, entries_of(columns, "--columns"))]
    tables = [
        error_table(caption, group.rows, entries_by_default(group.measured, summary.norms)),
        error_table(
            f"Absolute errors by axis{named}",
            group.rows,
            entries_by_axis(group.measured, summary.axes),
        ),
    ]
    pairs = group.comparisons
    caption = f"Rows compared in pairs{named}"
    return [*tables, *([table_of(caption, pair_columns(summary.norms), pairs)] if pairs else ())]


def terminal_text(summary: Summary, columns: Sequence[str] = ()) -> str:
    """Return the tables of a study as text, with the lines on all rows below; `columns` names those of the errors."""
    statistics = [row for group in summary.groups for row in group.measured]
    figures = figures_of(statistics, _TERMINAL)  # of the whole study
    entries = entries_of(columns, "--columns") or entries_by_default(statistics, summary.norms, figures=figures)
    by_axis = [entries_by_axis(statistics, summary.axes)] if summary.has_axes and not columns else []
    text: list[str] = []
    for chosen in (entries, *by_axis):
        lines = [["", *(header_of(entry.column) for entry in chosen)]]
        for group in summary.groups:
            lines += [[f"[{group.heading}]"]] if group.heading else []
            named = [row.model_copy(update={"source": ""}) if isinstance(row, Published) else row for row in group.rows]
            lines += [[cell.text for cell in row] for row in error_table("", named, chosen).rows]
        text += aligned(lines)
    published = [row for group in summary.groups for row in group.rows if isinstance(row, Published)]
    sources = [f"{row.label}: {', '.join(filter(None, (row.source, row.start, row.note)))}" for row in published]
    return "\n".join([*text, *sources, *summary.pooled, *_by_protocol(summary)])


def aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return lines of cells as text with aligned columns; a line of one cell is a heading."""
    widths = [max((len(line[i]) for line in lines if len(line) > 1), default=0) for i in range(len(lines[0]))]
    return ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip() for line in lines]


def _by_protocol(summary: Summary) -> list[str]:
    """Return the figures of the protocol, one line per row; a refused calibration counts with its initial guess."""
    if summary.protocol is None:
        return []
    protocol, lines = protocol_of(summary.protocol), []
    for row in (row for group in summary.groups for row in group.measured):
        known = [(one.pose, one.case.truth) for one in row.rows if one.case.truth is not None and one.pose is not None]
        if known:
            estimates, truths = (np.array(poses) for poses in zip(*known, strict=True))
            lines.append(f"{row.label}: {figures_text(protocol, protocol.figures(estimates, truths))}")
    return lines


def unit_of(metric: str) -> tuple[str, float, int]:
    """Return the printed unit of a metric, the factor to it and the number of decimals."""
    return ("deg", 1.0, DIGITS) if metric.endswith("_deg") else ("cm", 100.0, DIGITS - 2)


def with_unit(value: float, metric: str) -> str:
    """Return a value in the unit of its metric as text, such as "0.250 deg"."""
    unit, factor, digits = unit_of(metric)
    return f"{factor * value:.{digits}f} {unit}"


def name_of(metric: str) -> str:
    """Return the name of a metric in tables and figures, without its unit."""
    return _NAME.get(metric, metric.rpartition("_")[0])


def shown(value: Interval | None, metric: str, *, sign: bool = False) -> str:
    """Return a figure with its interval in the unit of its metric."""
    if value is None:
        return NONE
    _, factor, digits = unit_of(metric)
    numbers = [x for x in (value.value, value.low, value.high) if x is not None]
    first, *ends = [f"{factor * x:{'+' * sign}.{digits}f}" for x in numbers]
    return f"{first} [{', '.join(ends)}]" if ends else first


def leads(row: Statistics, rows: Sequence[Statistics], metric: str, statistic: Statistic) -> bool:
    """Return whether a row has the smallest value, as printed, among two or more complete rows."""
    known = [getattr(one, statistic)(metric) for one in rows if one.complete]
    values = [round(value.value, DIGITS) for value in known if value is not None]
    own = getattr(row, statistic)(metric)
    return row.complete and own is not None and len(values) > 1 and round(own.value, DIGITS) == min(values)


def label_cell(row: Statistics | Published) -> Cell:
    """Return the cell with the label of a row, and the source of a published one."""
    if not isinstance(row, Published):
        return Cell(row.label)
    return Cell(f"{row.label} (published{f': {row.source}' if row.source else ''})", "italic")


ENTRIES: Mapping[str, Figure] = {
    **{figure.name: figure for figure in FIGURES},
    **{f"{name_of(m)} {one}": error_figure(m, one) for m in (*METRICS, *PER_AXIS) for one in STATISTICS},
    **{f"{name_of(norm)} solved only": _of_solved(norm) for norm in NORMS},
}
"""Every column of tables of errors by its name, without the unit."""


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


def report_markdown(
    summaries: Sequence[Summary],
    figures: Callable[[Summary], Sequence[tuple[str, str]]],
    columns: Sequence[str] = (),
) -> str:
    """Return the report as Markdown; `figures` gives (title, file name) of the figures of a study.

    With names of `columns` its tables are those of errors, with these columns.
    """
    parts = ["# Report\n"]
    for summary in summaries:
        parts += [f"## {md_text(summary.title)}\n", *([f"{md_text(summary.note)}\n"] if summary.note else [])]
        for table in (table for group in summary.groups for table in tables_of(group, summary, columns)):
            parts += [f"**{md_text(table.caption)}**\n", markdown_table(table)]
        parts += [f"{md_text(line)}\n" for line in summary.pooled]
        parts += [f"![{md_text(title)}]({file})\n" for title, file in figures(summary)]
    return "\n".join([*parts, "## How to read it\n", *(f"{note}\n" for note in NOTES)])


def report_latex(summaries: Sequence[Summary], columns: Sequence[str] = ()) -> str:
    """Return the tables of the report as LaTeX, with names of `columns` only those of errors, with these columns."""
    parts = ["% \\usepackage{booktabs,graphicx}\n"]
    for summary in summaries:
        parts.append(f"\n% {one_line(summary.name)}\n")
        for group in summary.groups:
            parts += [latex_table(table, summary.title) for table in tables_of(group, summary, columns)]
    return "".join(parts)


def md_text(text: str) -> str:
    """Escape a text for Markdown: one line without marks, links and formulas."""
    plain = one_line(text)
    for mark in "\\`*_|<>#&$~":
        plain = plain.replace(mark, f"\\{mark}")
    # Only brackets that would form a link are escaped: nearly every cell contains an interval.
    return re.sub(r"\](?=[(\[:])", r"]\\", plain)


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
    plain = "".join(_TEX.get(letter, letter) for letter in one_line(text))
    return f"{{}}{plain}" if plain.startswith(("[", "*")) else plain


def _run_figure(name: str, metric: str, of: Callable[[Row], float | None], hide: int) -> Column:
    return Column(name, *unit_of(metric)[::2], hide=hide, of=lambda run: in_unit(of(run), metric))


def _status(run: Row) -> Any:
    if run.unmoved:
        return cell(SolverStatus.NOT_MOVED, look="bad")
    return run.status if run.solved else cell(run.status, look="bad")


VERDICT = Column("verdict", text=True, hide=1, order=list(Trust), looks=TRUST_LOOKS, of=lambda run: run.trust)
RUN_COLUMNS = (
    Column("frame", text=True, hide=0, of=lambda run: run.place),
    Column("seed", hide=4, of=lambda run: run.seed),
    Column("status", text=True, hide=3, of=_status),
    VERDICT,
    *(_run_figure(name_of(m), m, methodcaller("error_of", m), 1 if m in NORMS else 5) for m in METRICS),
    *(_run_figure(f"{name_of(norm)} initial", norm, methodcaller("start_error_of", norm), 4) for norm in NORMS),
    *(_run_figure(f"{name_of(norm)} 67 %", norm, methodcaller("predicted", norm), 3) for norm in NORMS),
    *(_run_figure(f"{name_of(norm)} 95 %", norm, methodcaller("predicted", f"{norm}_95"), 5) for norm in NORMS),
    Column("time", "s", 2, hide=4, of=lambda run: brief(run.total_s)),
    Column("names of frames", off=True, of=lambda run: ", ".join(run.frames) if len(run.frames) > 1 else None),
)
"""The columns of runs on pages."""
