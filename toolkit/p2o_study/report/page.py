"""The report as one HTML file: tables, plots and overlays work offline and load nothing."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from p2o.page import page as html
from p2o.page.page import Block, Column, brief, cell
from p2o.page.plot import Panel, plot
from p2o.page.run_page import ROUND_COLUMNS
from p2o.results.figures import figure_lines
from p2o.results.verdict import Trust

from p2o_study.report import figures
from p2o_study.report.overlays import OverlayImages
from p2o_study.row import NORMS, Row
from p2o_study.statistics import Statistics, error_rank, trust_text
from p2o_study.study import Published
from p2o_study.summary import Group, Summary
from p2o_study.tables import (
    NONE,
    NOTES,
    RUN_COLUMNS,
    STATISTICS,
    VERDICT,
    Figure,
    error_figure,
    figures_of,
    name_of,
    pair_columns,
)

_RUN_BYTES = 1_500_000
"""Maximum size of the single runs on the page, as JSON; about 1,000 runs."""
_MOST_ROWS = 400
# ---- what the page shows of a row, of a pair of rows and of a run


def row_columns(group: Group, summary: Summary) -> list[Column]:
    """Return the columns of the rows of a group; most are empty for published rows."""
    metrics = [(metric, None) for metric in summary.norms] + [(metric, "by axis") for metric in summary.axes]
    verdict = Column("verdict", text=True, hide=3, of=lambda row: cell(row.trusted, trust_text(row.trust)))
    figures = [
        *(error_figure(m, s, 1 + (s == "median"), option) for m, option in metrics for s in STATISTICS),
        *([Figure(verdict)] if _have_verdicts(run for row in group.measured for run in row.rows) else []),
        *figures_of(group.measured, _NOT_ON_PAGE),
    ]
    return [
        Column("row", text=True, hide=0, of=_label),
        *(replace(one.column, of=partial(one.page_cell, rivals=group.measured)) for one in figures),
        Column("start", text=True, hide=6, of=_starts),
    ]


_NOT_ON_PAGE = {"start", "groups", *Trust}


def _label(row: Statistics | Published) -> Any:
    return cell(row.label, below=f"published: {row.source}") if isinstance(row, Published) else row.label


def _starts(row: Statistics | Published) -> str:
    return row.start or NONE if isinstance(row, Published) else ", ".join(row.protocols) or NONE


def _have_verdicts(runs: Iterable[Row]) -> bool:
    return any(run.trust is not None for run in runs)


def run_columns(runs: Sequence[Row], images: OverlayImages) -> list[Column]:
    """Return the columns of runs, without verdicts if they have none; ▣ marks runs with overlays."""
    drawn = {key for key, _ in images.of}
    frame, *others = (column for column in RUN_COLUMNS if column is not VERDICT or _have_verdicts(runs))
    return [
        _ROW,
        replace(frame, of=lambda run: f"{run.place}{' ▣' * (run.key in drawn)}"),
        *others,
        Column("start", text=True, hide=6, of=lambda run: run.case.protocol),
        Column("matches", hide=4, of=lambda run: sum(run.matches.values()) or None),
        Column("overlays", text=True, off=True, of=lambda run: "yes" if run.key in drawn else "no"),
    ]


def run_blocks(run: Row, images: OverlayImages, shared: html.Shared) -> Iterator[Block]:
    """Yield what a run shows when it is opened."""
    why = run.why or ""
    yield html.text(f"{run.status}{f': {run.reason}' if run.reason else ''}", "" if run.solved else "bad")
    if run.trust:
        yield html.text(
            f"{'remark: ' * bool(run.trust is Trust.TRUSTED and why)}{why if why != run.reason else ''}", mark=run.trust
        )
    yield from overlays_of(run, images)
    evidence = figure_lines(run.figures)
    if evidence:
        yield html.part("Evidence", html.facts(evidence))
    seconds = [(stage, f"{value:.3g} s") for stage, value in run.seconds.items() if brief(value) is not None]
    counts = [(side, str(count)) for side, count in run.matches.items()]
    parts = [html.part("Matches", html.facts(counts))] if counts else []
    parts += [html.part("Time", html.facts(seconds))] if seconds else []
    yield html.grid(*parts, least=220)
    poses = []
    if run.pose is not None:
        lines = [" ".join(f"{value:11.6f}" for value in line) for line in np.asarray(run.pose)]
        poses.append(html.code("\n".join(lines), "camera_from_lidar"))
    if run.rounds:
        cost = str(run.figures.get("cost_unit") or "")
        columns = [replace(one, unit=cost) if one.name == "cost" and cost else one for one in ROUND_COLUMNS]
        poses.append(
            html.part(
                "Rounds",
                html.table(shared.use(html.columns_of(columns)), [html.cells(columns, one) for one in run.rounds]),
            )
        )
    yield html.grid(*poses, least=420)
    if run.exception:
        yield html.code(run.exception, "Traceback")
    if len(run.frames) > 1:
        yield html.fold(f"{len(run.frames)} frames", html.code("\n".join(run.frames)))
    method = {**run.method.words, "options": run.method.options}
    recipe = json.dumps({"method": method, "versions": dict(run.environment.versions)}, indent=1, default=str)
    yield shared.use(html.fold("recipe and versions", html.code(recipe)))
    if run.finished:
        yield html.text(f"finished {run.finished}", "quiet")


def overlays_of(run: Row, images: OverlayImages) -> list[Block]:
    """Return the overlays of the frames of a run that were drawn."""
    numbers = [(frame, images.of[run.key, frame]) for frame in run.frames if (run.key, frame) in images.of]
    return [html.slides(frame, {"use": before}, {"use": after}) for frame, (before, after) in numbers]


# ---- the page


def page(summaries: Sequence[Summary], images: OverlayImages) -> str:
    """Return the page of these studies.

    Without overlays the page stays below 5 MB for any number of runs and rows: it has the first `_MOST_ROWS` rows, and
    the worst runs of each row as far as `_RUN_BYTES` allows; plots are of all runs.
    """
    summaries = _with_first_rows(summaries)
    shared = html.Shared()
    for uri in images.uris:
        shared.use(uri)
    chosen = _chosen_runs(summaries, images, shared)
    titles = Counter(summary.title for summary in summaries)
    studies = {
        summary.title if titles[summary.title] == 1 else f"{summary.title} ({summary.name})": _study(
            summary, chosen, images, summary.title if len(summaries) > 1 else ""
        )
        for summary in summaries
    }
    notes = [html.text(note, "quiet") for note in NOTES]
    title = summaries[0].title if len(summaries) == 1 else "p2o report"
    return html.page(title, [html.choice("study", studies), html.section("How to read it", *notes)], shared=shared)


Opened = dict[int, dict[str, Any]]
"""What the runs on the page open, by the id of the run."""


def _with_first_rows(summaries: Sequence[Summary]) -> list[Summary]:
    """Return the summaries with the first `_MOST_ROWS` rows of all groups together; a note counts those left out."""
    left, out = _MOST_ROWS, []
    for summary in summaries:
        groups = []
        for group in summary.groups:
            kept = group.measured[:left]
            left -= len(kept)
            if kept:
                rows = (row for row in group.rows if isinstance(row, Published) or row in kept)
                groups.append(Group(group.heading, tuple(rows)))
        shown, every = (sum(len(group.measured) for group in some) for some in (groups, summary.groups))
        note = f"{summary.note} This page has the first {shown} of {every} rows; report.md has all."
        out.append(replace(summary, groups=tuple(groups), note=summary.note if shown == every else note.strip()))
    return [summary for summary in out if summary.groups]


def _chosen_runs(summaries: Sequence[Summary], images: OverlayImages, shared: html.Shared) -> Opened:
    """Return the runs on the page: the worst run of each row, then the next worst of each, up to `_RUN_BYTES`."""
    chosen, left = Opened(), _RUN_BYTES
    drawn = {key for key, _ in images.of}
    queues = []
    for row in (row for summary in summaries for group in summary.groups for row in group.measured):
        order = sorted(row.rows, key=error_rank, reverse=True)
        # The worst run of a row is always its first, those with overlays are next.
        queues.append([*order[:1], *sorted(order[1:], key=lambda run: run.key not in drawn)])
    for run in (run for turn in itertools.zip_longest(*queues) for run in turn if run is not None):
        before = shared.size
        detail = html.detail(f"{run.row}, {run.place}, seed {run.seed}", *run_blocks(run, images, shared))
        left -= len(html.plain_json(detail)) + shared.size - before
        if left < 0:
            break
        chosen[id(run)] = detail
    return chosen


def _study(summary: Summary, opened: Opened, images: OverlayImages, title: str) -> list[Block]:
    note = " ".join([summary.note, *(f"{line}." for line in summary.pooled)]).strip()
    groups = {
        group.heading or f"rows {number}": _group(group, summary, opened, images)
        for number, group in enumerate(summary.groups, 1)
    }
    lines = [row for group in summary.groups for row in group.measured]
    over = figures.figures_over(summary.name, summary.title, lines, summary.norms)
    plots = [_figure(name, figure.panels) for _, name, figure in over]
    return [html.section(title, html.text(note, "quiet"), html.choice("rows", groups), *plots)]


def _figure(title: str, panels: Sequence[Panel], note: str = "") -> Block:
    """Return a figure with its explanation."""
    shown = plot([panel for panel in panels if panel.series])
    return html.section(title[:1].upper() + title[1:], shown, *([html.text(note, "quiet")] if note else []))


def _group(group: Group, summary: Summary, opened: Opened, images: OverlayImages) -> list[Block]:
    taken = [run for row in group.measured for run in row.rows if id(run) in opened]
    numbers = {id(run): number for number, run in enumerate(taken)}
    opens = [None if isinstance(row, Published) else html.rows_of("runs", row=row.label) for row in group.rows]
    looks = ["published" if isinstance(row, Published) else None for row in group.rows]
    some = len(group.rows) > 30
    blocks = [
        html.section(
            "Rows",
            html.table(row_columns(group, summary), group.rows, name="rows", search=some, opens=opens, looks=looks),
            html.text(
                "Bold: best of its column. In brackets: 95 % intervals over frames. Select a row to see its runs.",
                "quiet",
            ),
        ),
        _worst(group, numbers, images),
        *(_figure(title, figure.panels, note) for _, title, note, figure in figures.group_figures(group, summary)),
    ]
    if group.comparisons:
        rule = "On the same frames and seeds; negative differences are in favour of the first row."
        blocks.append(
            html.section(
                "Paired comparisons of rows",
                html.table(pair_columns(summary.norms), group.comparisons, name="pairs"),
                html.text(rule, "quiet"),
            )
        )
    total = sum(row.count for row in group.measured)
    counted = " runs"
    if total > len(taken):
        counted += f", the worst of each row; all {total} runs are in {summary.name}.jsonl"
    columns = run_columns(taken, images)
    runs = html.table(
        columns,
        taken,
        name="runs",
        search=True,
        filters=[name for name in ("row", "status", "verdict", "overlays") if name in {each.name for each in columns}],
        opens=[opened[id(run)] for run in taken],
        counted=counted,
    )
    return [*blocks, html.section("Runs", runs)]


def _worst(group: Group, numbers: Mapping[int, int], images: OverlayImages) -> Block:
    """Return the worst run of each row with its reasons, and its overlays."""
    runs = [max(row.rows, key=error_rank) for row in group.measured if row.rows]
    runs = [run for run in runs if id(run) in numbers]
    opens = [html.row_of("runs", numbers[id(run)]) for run in runs]
    drawn = [html.part(run.row, one) for run in runs for one in overlays_of(run, images)[:1]]
    hint = [] if images.uris else [html.text("Overlays need the data: p2o report DIR --data DATASET:PATH", "quiet")]
    table = html.table(_WORST_COLUMNS, runs, name="worst", opens=opens)
    return html.section("The worst run of each row", table, *([html.grid(*drawn)] if drawn else hint))


_ROW = Column("row", text=True, hide=0, of=lambda run: run.row)
_IN_WORST = ("status", "verdict", *map(name_of, NORMS))
_WORST_COLUMNS = (
    _ROW,
    *(column for column in RUN_COLUMNS if column.name in _IN_WORST),
    Column("reasons", text=True, hide=2, of=lambda run: (run.why if run.solved else run.reason) or None),
    Column("frame", text=True, hide=3, of=lambda run: f"{run.place}, seed {run.seed}"),
)
