"""The figures of a report, PNG and SVG: errors by axis, convergence, errors by frame."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from p2o.arrays import Float
from p2o.errors import printable
from p2o.files.file_names import distinct_names

from p2o_study.report.series import convergence_of, differ_much, lifted, rounds_differ_much
from p2o_study.row import Row
from p2o_study.summary import Group, Summary
from p2o_study.tables import name_of, unit_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f")
"""Colours for colour-blind readers (Okabe and Ito); rows also differ in their markers."""
KINDS = 3
"""Maximum number of figures of a group: errors by axis, convergence, errors by frame."""
_MARKERS = "os^DvPX*"
_DASHES = ("-", "--", ":", "-.")

_MOST_NAMES = 80
_MOST_ROWS = 200
"""Maximum number of rows in a figure: more are not legible, and an image has at most 65535 px."""
_LONGEST_TITLE = 150
_LONGEST_NAME = 40
_LETTERS_PER_INCH = 15  # of a legend


def figure_names(summaries: Sequence[Summary]) -> list[tuple[str, ...]]:
    """Return the file names of the figures of each group of each study: the study, and a number for several groups.

    Names are distinct and valid on every file system, for any names of studies in a foreign store.
    """
    stems = distinct_names([summary.name for summary in summaries])
    taken: set[str] = set()
    names_of_groups = []
    for summary in summaries:
        names = []
        for number in range(1, len(summary.groups) + 1):
            stem = stems[summary.name]
            name = wanted = stem if len(summary.groups) == 1 else f"{stem}-{number}"
            # The first group of a study "a" may clash with a study "a-1".
            for again in itertools.count(2):
                if name.lower() not in taken:
                    break
                name = f"{wanted}_{again}"
            taken.add(name.lower())
            names.append(name)
        names_of_groups.append(tuple(names))
    return names_of_groups


def figures_of(summary: Summary, names: Sequence[str] = ()) -> Iterator[tuple[str, str, Figure]]:
    """Yield (file name without suffix, title, figure) of all figures of a study that have data.

    `names` are those of `figure_names`, one per group (default: those of this study alone).
    """
    for name, whole in zip(names or figure_names([summary])[0], summary.groups, strict=True):
        group = replace(whole, rows=whole.measured[:_MOST_ROWS])
        title = f"{summary.title}: {group.heading}" if group.heading else summary.title
        for kind, what, draw in (
            ("boxplot", "errors by axis", _boxes),
            ("convergence", "convergence", _convergence),
            ("frames", "errors by frame", _by_frame),
        ):
            figure = draw(group, summary)
            if figure is not None:
                some = f" (the first {_MOST_ROWS} rows of {len(whole.measured)})"
                text = f"{_cut(title, _LONGEST_TITLE)}: {what}{some if len(whole.measured) > _MOST_ROWS else ''}"
                figure.suptitle(_plain(text), fontsize=11)
                yield f"{name}-{kind}", text, figure


def rendered(figure: Figure) -> dict[str, bytes]:
    """Return a figure as "png" and "svg", in one layout; the same figure gives the same bytes."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    png, svg = io.BytesIO(), io.BytesIO()
    figure.dpi = 130
    # Not `savefig`, which draws everything twice, with a layout each time.
    FigureCanvasAgg(figure).print_png(png, metadata={"Software": None})
    figure.set_layout_engine("none")
    with matplotlib.rc_context({"svg.hashsalt": "p2o"}):
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None, "Creator": None})
    return {"png": png.getvalue(), "svg": svg.getvalue()}


def _boxes(group: Group, summary: Summary) -> Figure | None:
    """Draw the errors by axis as box plots, one box per row; on a logarithmic axis if `differ_much`."""
    rows = [row for row in group.measured if len(row.errors(summary.axes[0]))]
    if not rows:
        return None
    angles = [axis for axis in summary.axes if axis.endswith("_deg")]
    shifts = [axis for axis in summary.axes if axis.endswith("_m")]
    panels = [axes for axes in (angles, shifts) if axes]
    across = max(map(len, panels))
    figure = _figure(2.0 + 2.6 * across, len(panels) * (0.9 + 0.32 * len(rows)) + 0.4)
    grid = figure.subplots(len(panels), across, squeeze=False, sharey=True)
    for line, axes in zip(grid, panels, strict=True):
        factor = unit_of(axes[0])[1]
        values = [[factor * row.signed(axis) for row in rows] for axis in axes]
        logarithmic = differ_much([np.concatenate(row) for row in zip(*values, strict=True)])
        reach = _whisker_reach([v for boxes in values for v in boxes])
        for panel, axis, boxes in zip(line, axes, values, strict=False):
            panel.set_xlabel(f"{name_of(axis)} [{unit_of(axis)[0]}]")
            if logarithmic:
                _draw_boxes(panel, lifted(boxes))
                panel.set_xlabel(f"|{name_of(axis)}| [{unit_of(axis)[0]}]")
            else:
                _draw_boxes(panel, boxes)
                _cut_at(panel, boxes, reach)
        if logarithmic:
            _share_log_axis(line[: len(axes)])
        for panel in line[len(axes) :]:
            panel.set_visible(False)
        line[0].set_yticks(range(len(rows)), [_short(row.label) for row in rows])
        line[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def _draw_boxes(panel: Any, boxes: Sequence[Float]) -> None:
    drawn = panel.boxplot(
        boxes,
        positions=range(len(boxes)),
        orientation="horizontal",
        widths=0.6,
        patch_artist=True,
        manage_ticks=False,
        medianprops={"color": "black", "lw": 1.4},
        flierprops={"marker": ".", "ms": 3, "mfc": "0.35", "mec": "none"},
    )
    for number, box in enumerate(drawn["boxes"]):
        box.set(facecolor=COLOURS[number % len(COLOURS)], alpha=0.75, lw=0.8)
    panel.tick_params(axis="y", length=0)
    _tidy(panel, "x")


def _cut_at(panel: Any, boxes: Sequence[Float], reach: float) -> None:
    """Limit a linear axis to plus and minus `reach` and write the number of outliers beyond at its ends."""
    panel.axvline(0, color="0.6", lw=0.8, zorder=0)
    panel.set_xlim(-reach, reach)
    for number, values in enumerate(boxes):
        for side, beyond in ((-1, (values < -reach).sum()), (1, (values > reach).sum())):
            if beyond:
                text, align = (f"{beyond} >", "right") if side > 0 else (f"< {beyond}", "left")
                panel.text(0.98 * side * reach, number - 0.36, text, ha=align, va="center", fontsize=6, color="0.3")


def _share_log_axis(panels: Sequence[Any]) -> None:
    """Give panels the same logarithmic axis, which includes all points."""
    for panel in panels:
        _log_axis(panel, "x")
    limits = [limit for panel in panels for limit in panel.get_xlim()]
    for panel in panels:
        panel.set_xlim(min(limits), max(limits))


def _log_axis(panel: Any, name: Literal["x", "y"]) -> None:
    """Make an axis logarithmic with plain numbers as labels."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis = panel.xaxis if name == "x" else panel.yaxis
    (panel.set_xscale if name == "x" else panel.set_yscale)("log")
    axis.set_major_locator(LogLocator(subs=(1, 3)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _whisker_reach(boxes: Sequence[Float]) -> float:
    """Return the limit of the axes that includes all whiskers."""
    ends = [0.0]
    for values in boxes:
        if len(values):
            low, high = np.quantile(values, (0.25, 0.75))
            length = 1.5 * (high - low)
            inner = values[(values >= low - length) & (values <= high + length)]
            ends.append(float(np.abs(inner).max(initial=0.0)))
    return 1.12 * max(ends) or 1.0


def _convergence(group: Group, _: Summary) -> Figure | None:
    """Draw matches and residual by round over all runs of a row: medians, with quartiles as bands.

    An axis is logarithmic if the medians in the last round `differ_much`.
    """
    histories = [(row.label, convergence_of(row.rows)) for row in group.measured]
    if not any(history for _, history in histories):
        return None
    from matplotlib.ticker import MaxNLocator

    figure = _figure(7.6, 4.8 + 0.16 * len(histories))
    top, bottom = figure.subplots(2, 1, sharex=True)
    for number, (label, history) in enumerate(histories):
        if history is None:
            continue
        rounds = np.arange(1, history.matches.shape[1] + 1)
        style = _style(number)
        for panel, (low, middle, high) in ((top, history.matches), (bottom, history.residual_px)):
            panel.fill_between(rounds, low, high, color=style["color"], alpha=0.15, lw=0)
            panel.plot(rounds, middle, ms=4, lw=1.4, label=f"{_short(label)} ({history.runs} runs)", **style)
    top.set_ylabel("matches")
    bottom.set_ylabel("mean residual [px]")
    bottom.set_xlabel("round (median and quartiles; a run that has ended keeps its last value)")
    bottom.xaxis.set_major_locator(MaxNLocator(integer=True))
    for panel, logarithmic in zip((top, bottom), rounds_differ_much(h for _, h in histories), strict=True):
        if logarithmic:
            _log_axis(panel, "y")
        else:
            panel.set_ylim(bottom=0)
        _tidy(panel, "both")
    _legend(figure, top)
    return figure


def _by_frame(group: Group, summary: Summary) -> Figure | None:
    """Draw median and range of the error over the seeds of each frame; many frames as a cumulative curve."""
    rows = [row for row in group.measured if len(row.errors(summary.norms[0]))]
    if not rows:
        return None
    places = list(dict.fromkeys(place for row in rows for place in row.places))
    ranked = len(places) > _MOST_NAMES
    height = 5.0 if ranked else 1.3 + (0.17 + 0.045 * len(rows)) * len(places)
    figure = _figure(9.6, height + 0.16 * len(rows))
    panels = figure.subplots(1, len(summary.norms), sharey=not ranked, squeeze=False)
    for panel, metric in zip(panels[0], summary.norms, strict=True):
        unit, factor, _ = unit_of(metric)
        for number, row in enumerate(rows):
            spread = factor * _spread(row.rows, places, metric)
            if ranked:
                middle = np.sort(spread[1][np.isfinite(spread[1])])
                panel.plot(middle, np.arange(1, len(middle) + 1), lw=1.4, label=_short(row.label), **_style(number, ""))
            else:
                at = np.arange(len(places)) + 0.7 * ((number + 0.5) / len(rows) - 0.5)
                look = {key: value for key, value in _style(number).items() if key != "linestyle"}
                panel.hlines(at, spread[0], spread[2], color=look["color"], lw=1.1, alpha=0.6)
                panel.plot(spread[1], at, ms=4, linestyle="none", label=_short(row.label), **look)
        _log_axis(panel, "x")
        panel.set_xlabel(f"{name_of(metric)} error [{unit}]: median of the seeds" + ("" if ranked else " and range"))
        _tidy(panel, "both")
    if ranked:
        panels[0, 0].set_ylabel("frames with at most this error")
    else:
        panels[0, 0].set_yticks(range(len(places)), [_short(place, end=True) for place in places], fontsize=7)
        panels[0, 0].set_ylim(len(places) - 0.4, -0.6)
    _legend(figure, panels[0, 0])
    return figure


def _spread(runs: Sequence[Row], places: Sequence[str], metric: str) -> Float:
    """Return minimum, median and maximum error (3, places) over the seeds; NaN for a place without errors."""
    by_place: dict[str, list[float]] = {place: [] for place in places}
    for run in runs:
        value = run.error_of(metric)
        if value is not None:
            by_place[run.place].append(abs(value))
    none = (np.nan, np.nan, np.nan)
    return np.array([np.quantile(v, (0, 0.5, 1)) if v else none for v in by_place.values()]).T


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _style(number: int, markers: str = _MARKERS) -> dict[str, str]:
    """Return colour, line style and marker of the row with this number; 28 rows are distinct."""
    look = {"color": COLOURS[number % len(COLOURS)], "linestyle": _DASHES[number // len(COLOURS) % len(_DASHES)]}
    return {**look, "marker": markers[number % len(markers)]} if markers else look


def _legend(figure: Figure, panel: Any) -> None:
    """Draw the legend below the figure, in at most 3 columns."""
    handles, labels = panel.get_legend_handles_labels()
    room = _LETTERS_PER_INCH * figure.get_figwidth() / (max(map(len, labels)) + 8)
    columns = max(1, min(3, int(room), len(labels)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)


def _tidy(panel: Any, grid: str) -> None:
    panel.grid(axis=grid, alpha=0.3, lw=0.6)
    panel.spines[["top", "right"]].set_visible(False)


def _short(text: str, *, end: bool = False) -> str:
    """Return the beginning of a text, or its `end`, where names of frames differ."""
    if end and len(text) > _LONGEST_NAME:
        return _plain("..." + text[3 - _LONGEST_NAME :])
    return _plain(_cut(text, _LONGEST_NAME))


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _plain(text: str) -> str:
    """Escape a text for matplotlib: $ begins a formula, a leading _ or an empty label hides a legend entry."""
    text = printable(text)
    return (" " + text if text.startswith("_") or not text else text).replace("$", r"\$")
