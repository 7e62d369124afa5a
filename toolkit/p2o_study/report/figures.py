"""The plots of studies, for pages and as files: errors by axis, convergence, errors by frame and over what varies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from p2o.arrays import Float
from p2o.errors import printable
from p2o.files.file_names import distinct_names
from p2o.page.plot import Axis, Figure, Panel, Series

from p2o_study.curves import Over, curves, frames_of, start_error_of
from p2o_study.row import NORMS, Row
from p2o_study.statistics import Statistics, error_rank
from p2o_study.summary import Group, Summary
from p2o_study.tables import name_of, unit_of

_MOST_NAMES = 80
_MOST_ROWS = 200
"""Maximum number of rows in a figure: more are not legible, and an image has at most 65535 px."""
_LONGEST_TITLE = 150
_MOST_POINTS = 2000
"""Maximum number of points of the plot of errors by frame: rows times frames."""


# ---- values

QUARTILES = (0.25, 0.5, 0.75)
MUCH = 20.0
"""Ratio of medians: on a linear axis of 300 px the smaller box would have 15 px and not be legible."""
RULE = f"An axis is logarithmic where the median size of one row is over {MUCH:g} times that of another."


def convergence_of(runs: Iterable[Row]) -> tuple[int, Float] | None:
    """Return how many runs have rounds, and quartiles (2, 3, rounds) of matches and of mean residuals in px.

    A run that has ended is continued with the values of its last round; otherwise the last rounds would represent the
    slowest runs only. None if no run has rounds of matching and solving.
    """
    # The round of an initializer has no matches.
    solved = [[r for r in run.rounds if math.isfinite(r.mean_residual) and r.matches] for run in runs]
    values = [np.array([[sum(r.matches.values()), r.mean_residual] for r in rounds]) for rounds in solved if rounds]
    if not values:
        return None
    last = range(max(map(len, values)))
    quartiles = np.array([np.quantile([v[min(i, len(v) - 1)] for v in values], QUARTILES, axis=0) for i in last])
    return len(values), np.moveaxis(quartiles, (2, 1), (0, 1))


def differ_much(rows: Iterable[Float]) -> bool:
    """Return whether the largest median absolute value of a row exceeds `MUCH` times the smallest.

    Rows without finite values and medians of zero are left out.
    """
    medians = [float(np.median(sizes)) for row in rows if len(sizes := _sizes(row))]
    shown = [median for median in medians if median > 0]
    return bool(shown) and max(shown) > MUCH * min(shown)


def lifted(rows: Iterable[Float]) -> list[Float]:
    """Return absolute values for a logarithmic axis: zeros are replaced by the smallest positive value."""
    sizes = [_sizes(row) for row in rows]
    above = [float(size[size > 0].min()) for size in sizes if (size > 0).any()]
    least = min(above, default=1.0)
    return [np.maximum(size, least) for size in sizes]


def _sizes(row: Float) -> Float:
    values = np.abs(np.asarray(row, dtype=np.float64))
    return np.asarray(values[np.isfinite(values)])


# ---- panels, for the page and for files


def errors_of(row: Statistics, metric: str) -> Float:
    """Return the signed errors (N,) of the runs of a row with a known error, in the unit of tables."""
    return unit_of(metric)[1] * row.signed(metric)


def boxes(group: Group, metric: str, *, log: bool, reach: float | None = None) -> Panel:
    """Return the errors of a metric as box plots, one per row.

    On a logarithmic axis they are absolute. With `reach` the axis is limited to this error, and its title counts the
    runs beyond.
    """
    values = [errors_of(row, metric) for row in group.measured]
    labels = [f"{row.label} (n = {len(own)})" for row, own in zip(group.measured, values, strict=True)]
    shown = lifted(values) if log else values
    title = f"|{name_of(metric)}|" if log else name_of(metric)
    title = f"{title} [{unit_of(metric)[0]}]"
    series = []
    for number, (row, errors) in enumerate(zip(group.measured, shown, strict=True)):
        if len(errors):
            series.append(Series(row.label, [box_of(errors)], [number], "box"))
    beyond = 0 if reach is None else sum(int((np.abs(errors) > reach).sum()) for errors in shown)
    if beyond:
        title += f"; {beyond} of {sum(map(len, shown))} runs beyond"
    ends = () if reach is None else (-reach, reach)
    axis = Axis(title, log=log, low=min(ends, default=None), high=max(ends, default=None))
    return Panel(axis, Axis(names=labels), series, marks=() if log else (0.0,))


def box_of(values: Float) -> list[float]:
    """Return lower whisker, quartiles and upper whisker of values (N,), whiskers of 1.5 interquartile ranges."""
    low, middle, high = np.quantile(values, QUARTILES)
    length = 1.5 * (high - low)
    inner = values[(values >= low - length) & (values <= high + length)]
    return [float(value) for value in (inner.min(), low, middle, high, inner.max())]


def by_frame(group: Group, metric: str, places: Sequence[str]) -> Panel:
    """Return median and range of the errors over the seeds of each of these frames."""
    numbers = {place: number for number, place in enumerate(places)}
    series = []
    for row, measured in enumerate(group.measured):
        by_place: dict[str, list[float]] = {place: [] for place in places}
        for run in measured.rows:
            value = run.error_of(metric)
            if value is not None and run.place in by_place:
                by_place[run.place].append(unit_of(metric)[1] * abs(value))
        known = {place: own for place, own in by_place.items() if own}
        offset = 0.7 * ((row + 0.5) / len(group.measured) - 0.5)
        if known:
            low, middle, high = np.array([np.quantile(own, (0, 0.5, 1)) for own in known.values()]).T.tolist()
            at = [numbers[place] + offset for place in known]
            series.append(Series(measured.label, middle, at, low=low, high=high, along="x"))
    axis = Axis(f"{name_of(metric)} error [{unit_of(metric)[0]}]", log=True)
    return Panel(axis, Axis(names=places), series)


def rounds(group: Group) -> list[Panel]:
    """Return matches and residual by round over all runs of a row: medians, with quartiles as bands."""
    known = [(row.label, *history) for row in group.measured if (history := convergence_of(row.rows)) is not None]
    panels = []
    for number, title in enumerate(("matches", "mean residual [px]")):
        log = differ_much(quartiles[number, 1, -1:] for _, _, quartiles in known)
        series = []
        for label, runs, quartiles in known:
            low, middle, high = quartiles[number].tolist()
            named, count = f"{label} ({runs} runs)", range(1, len(middle) + 1)
            series.append(Series(named, count, middle, "line", low=low, high=high, band=True))
        panels.append(Panel(Axis("round", whole=True), Axis(title, log=log, zero=not log), series))
    return panels if known else []


def places_of(group: Group, most: int) -> list[str]:
    """Return the frames with the largest errors, at most this number, in the order of the runs."""
    largest: dict[str, float] = {}
    for run in (run for row in group.measured for run in row.rows):
        largest[run.place] = max(largest.get(run.place, -1.0), error_rank(run)[0])
    kept = set(sorted(largest, key=lambda place: -largest[place])[:most])
    return [place for place in largest if place in kept]


# ---- figures in files


def figure_names(summaries: Sequence[Summary]) -> list[tuple[str, ...]]:
    """Return the file names of the figures of each group of each study: the study, and a number for several groups.

    Names are distinct and valid on every file system, for any names of studies in a foreign store.
    """
    taken: set[str] = set()
    names_of_groups = []
    for summary in summaries:
        numbers = range(1, len(summary.groups) + 1)
        wanted = [summary.name] if len(numbers) == 1 else [f"{summary.name}-{number}" for number in numbers]
        names = tuple(distinct_names(wanted, taken).values())
        taken.update(names)
        names_of_groups.append(names)
    return names_of_groups


def group_figures(group: Group, summary: Summary) -> Iterator[tuple[str, str, str, Figure]]:
    """Yield kind, title, explanation and figure of each figure of a group that has data, of many rows the first."""
    some = f" (the first {_MOST_ROWS} rows of {len(group.measured)})" if len(group.measured) > _MOST_ROWS else ""
    shown = Group(group.heading, group.measured[:_MOST_ROWS])
    for kind, title, note, draw in _KINDS:
        figure = draw(shown, summary)
        if any(panel.series for panel in figure.panels):
            yield kind, f"{title}{some}", note, figure


def figures_of(summary: Summary, names: Sequence[str] = ()) -> Iterator[tuple[str, str, Figure]]:
    """Yield (file name without suffix, title, figure) of all figures of a study that have data.

    `names` are those of `figure_names`, one per group (default: those of this study alone).
    """
    for name, group in zip(names or figure_names([summary])[0], summary.groups, strict=True):
        heading = f"{summary.title}: {group.heading}" if group.heading else summary.title
        for kind, title, _, figure in group_figures(group, summary):
            text = f"{_cut(heading, _LONGEST_TITLE)}: {title}"
            yield f"{name}-{kind}", text, replace(figure, title=text)
    lines = [row for group in summary.groups for row in group.measured]
    yield from figures_over((names or figure_names([summary])[0])[0], summary.title, lines, summary.norms)


def figures_over(
    name: str, title: str, lines: Sequence[Statistics], norms: Sequence[str] = NORMS
) -> Iterator[tuple[str, str, Figure]]:
    """Yield (file name, title, figure) of the mean errors over the number of frames and over the initial error.

    A figure has the methods with two or more points; without any there is none.
    """
    kinds: tuple[Over, ...] = ("frames", "initial error")
    for over in kinds:
        known = dict(list(curves(lines, over, least=2).items())[:_MOST_ROWS])
        if known:
            what = "number of frames" if over == "frames" else over
            text = f"{_cut(title, _LONGEST_TITLE)}: mean error over the {what}, 95 % intervals"
            size = (4.8 * len(norms), 3.6 + 0.07 * len(known))
            figure = Figure(text, [_over(known, over, norm) for norm in norms], len(norms), size)
            yield f"{name}-over-{over.replace(' ', '-')}", text, figure


def _over(known: Mapping[str, Sequence[Statistics]], over: Over, norm: str) -> Panel:
    unit, factor, _ = unit_of(norm)
    series = []
    for method, lines in known.items():
        means = [mean for line in lines if (mean := line.mean(norm)) is not None]
        places = [frames_of(line) if over == "frames" else factor * start_error_of(line, norm) for line in lines]
        low = [factor * (mean.low or mean.value) for mean in means]
        high = [factor * (mean.high or mean.value) for mean in means]
        values = [factor * mean.value for mean in means]
        if len(values) == len(places):
            series.append(Series(method, places, values, "line", low=low, high=high))
    what = "frames of a joint calibration" if over == "frames" else f"initial {name_of(norm)} error [{unit}]"
    return Panel(Axis(what, log=True), Axis(f"mean {name_of(norm)} error [{unit}]", log=True), series)


def _axes_figure(group: Group, summary: Summary) -> Figure:
    """Return the errors by axis; the axes of one unit have one scale, a linear one includes all whiskers."""
    units = [[axis for axis in summary.axes if axis.endswith(unit)] for unit in ("_deg", "_m")]
    panels, lines = [], [axes for axes in units if axes]
    across = max(map(len, lines))
    for axes in lines:
        values = {axis: [errors_of(row, axis) for row in group.measured] for axis in axes}
        log = differ_much(np.concatenate(row) for row in zip(*values.values(), strict=True))
        whiskers = [abs(end) for some in values.values() for errors in some if len(errors) for end in box_of(errors)]
        reach = None if log else 1.12 * max(whiskers, default=0.0) or 1.0
        panels += [boxes(group, axis, log=log, reach=reach) for axis in axes]
        panels += [Panel(Axis(), Axis(), ())] * ((across - len(axes)) if axes is not lines[-1] else 0)
    size = (2.0 + 2.6 * across, len(lines) * (0.9 + 0.32 * len(group.measured)) + 0.4)
    return Figure("", panels, across, size)


def _rounds_figure(group: Group, _: Summary) -> Figure:
    return Figure("", rounds(group), 1, (7.6, 4.8 + 0.16 * len(group.measured)))


def _frames_figure(group: Group, summary: Summary) -> Figure:
    """Return the errors by frame, of many frames those with the largest ones."""
    most = max(1, min(_MOST_NAMES, _MOST_POINTS // max(1, len(group.measured))))
    places, norms = places_of(group, most), summary.norms
    height = 1.3 + (0.17 + 0.045 * len(group.measured)) * len(places) + 0.16 * len(group.measured)
    return Figure("", [by_frame(group, norm, places) for norm in norms], len(norms), (9.6, height))


_KINDS: tuple[tuple[str, str, str, Callable[[Group, Summary], Figure]], ...] = (
    (
        "boxplot",
        "errors by axis",
        f"Quartiles of the signed errors of all runs, whiskers of 1.5 interquartile ranges. {RULE}",
        _axes_figure,
    ),
    (
        "convergence",
        "convergence",
        "Median and quartiles over the runs of a row; a run that has ended keeps its last value.",
        _rounds_figure,
    ),
    (
        "frames",
        "errors by frame",
        "Median and range over the seeds by frame. Of many frames, those with the largest errors.",
        _frames_figure,
    ),
)
"""The figures of groups: name of the file, title, explanation."""


def _cut(text: str, most: int) -> str:
    return printable(text if len(text) <= most else text[: most - 3] + "...")
