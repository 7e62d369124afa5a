"""The page of a fleet: overview, vehicles with filter and search, history of each with alarms; works offline."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from p2o.confidence.audit import AXES
from p2o.files.whole_file import write_whole
from p2o.page import page as html
from p2o.page.page import Block, Column, brief, cell
from p2o.page.plot import Axis, Panel, Series, plot

from p2o_fleet.fleet_state import Alarm, ExtrinsicState, FleetState, FleetStatus, TypeState
from p2o_fleet.outputs import extrinsic_dict, iso, type_text

INDEX = "index.html"
_PER_FILE = 50
"""Number of extrinsics whose histories are in one file."""
_WORDS = {
    FleetStatus.WRONG: "wrong since the first check",
    FleetStatus.SLIPPED: "slipped",
    FleetStatus.CANNOT_TELL: "cannot tell",
    FleetStatus.HOLDS: "holds",
}
_LOOKS = dict(zip(_WORDS.values(), ("bad", "bad", "warn", "good"), strict=True))
_IN_USE = "in use"
_MOST_EVIDENCE = 60.0


def columns() -> list[Column]:
    """Return the columns of extrinsics."""
    order = list(_WORDS.values())
    return [
        Column("vehicle", text=True, hide=0, of=lambda one: one.vehicle),
        Column("state", text=True, hide=0, order=order, looks=_LOOKS, of=lambda one: _WORDS[one.status]),
        Column("reason", text=True, of=_reason),
        Column("largest error", hide=2, of=_largest),
        Column("since", hide=2, of=lambda one: None if one.alarm is None else _time_cell(one.alarm.since)),
        Column("evidence", digits=1, hide=3, of=lambda one: extrinsic_dict(one)["log_e"]),
        Column("type", text=True, hide=4, of=lambda one: one.vehicle_type or "unnamed"),
        Column("sensors", text=True, hide=5, of=_sensors),
        Column("checks", hide=5, of=lambda one: one.checks),
        Column("no estimate", hide=6, of=lambda one: one.checks - one.usable),
        Column("last check", hide=7, of=lambda one: _time_cell(one.last)),
        Column("extrinsics", off=True, of=lambda one: _IN_USE if one.current else "replaced"),
        Column("service", off=True, of=lambda one: one.service),
        Column("extrinsic", off=True, of=lambda one: one.extrinsic),
        Column("unreadable", off=True, of=lambda one: one.unreadable),
        _alarm("since, 95 %", lambda alarm: f"{_short_time(alarm.since_first)} to {_short_time(alarm.since_last)}"),
        _alarm("shown by", lambda alarm: f"{alarm.checks} checks with {alarm.frames} frames"),
        _alarm("logs", lambda alarm: ", ".join(alarm.proof)),
    ]


def type_columns() -> list[Column]:
    """Return the columns of types of vehicles."""
    return [
        Column("type", text=True, hide=0, of=lambda one: one.vehicle_type or "unnamed"),
        Column("sensors", text=True, hide=4, of=lambda one: f"{one.camera} and {one.lidar}"),
        Column("vehicles", hide=2, of=lambda one: one.vehicles),
        *(Column(axis, _printed(unit), of=partial(_type_error, axis=axis, unit=unit)) for axis, unit in AXES),
        Column("noise", hide=3, of=lambda one: f"{min(one.noise_scale):.2f} to {max(one.noise_scale):.2f}"),
        Column("trends", text=True, hide=3, of=lambda one: "; ".join(one.trends) or None),
    ]


def _reason(state: ExtrinsicState) -> str:
    systematic = state.alarm is not None and state.alarm.systematic
    return state.reason + (" (as all vehicles of its type)" if systematic else "")


def write_page(state: FleetState, folder: Path) -> Path:
    """Write the page to a folder: index.html, and files of histories that it loads on demand; return its path.

    It needs no server and loads nothing from elsewhere. Raises InputError if the folder cannot be written.
    """
    html.prepare_data(folder)
    order = [*state.alarms, *(one for one in state.current if one.alarm is None)]
    order += [one for one in state.extrinsics if not one.current]
    opens = []
    for first in range(0, len(order), _PER_FILE):
        name, some = f"history-{first // _PER_FILE}", order[first : first + _PER_FILE]
        html.write_data(folder, name, [[*_proposal(one), *_history(one)] for one in some])
        opens += [html.detail_of_file(f"{one.vehicle}: {_sensors(one)}", name, n) for n, one in enumerate(some)]
    filters: list[str | tuple[str, str]] = ["state", "type", "sensors", ("extrinsics", _IN_USE)]
    table = html.table(
        columns(), order, name="rows", search=True, filters=filters, tiles="state", opens=opens, counted=" extrinsics"
    )
    count = f"{len(list(state.current))} extrinsics in use, {state.checks:,} checks"
    blocks = [html.text(f"{count}, last one at {_short_time(state.until)} UTC", "quiet")]
    blocks += [html.text(words, "notice") for words in map(type_text, state.types) if words]
    if state.remarks:
        blocks.append(html.section("Not read", html.items(state.remarks)))
    types = html.table(type_columns(), state.types, name="types")
    blocks += [table, html.section("Types", types, html.text(_TYPES, "quiet"))]
    notes = (
        f"Alarms have a false discovery rate of {100 * state.rules.rate:g} % over the whole fleet. Constant errors up "
        f"to {state.rules.tolerance} count as correct.",
        f"The state is unknown if an error of {state.rules.notice} may stay undetected, or if the last checks give no "
        "estimate.",
        "Evidence is the natural logarithm of an e-value: 11.5 means that a correct extrinsic reaches it with a "
        "probability of at most 1 in 100,000, however often it is checked.",
        "Points are single checks with their 95 % intervals; the dashed line is the most likely onset of the error.",
    )
    blocks.append(html.section("How to read it", *(html.text(note, "quiet") for note in notes)))
    write_whole(folder / INDEX, html.page("Fleet", blocks, script_files=True).encode())
    return folder / INDEX


def _largest(state: ExtrinsicState) -> dict[str, Any] | None:
    """Return the largest error of an axis relative to 0.1 deg or 1 cm."""
    if state.mean is None:
        return None
    sizes = np.abs(state.mean.error) / np.repeat([0.1, 0.01], 3)
    largest = int(np.argmax(sizes))
    axis, unit = AXES[largest]
    return cell(brief(float(sizes[largest])), f"{axis} {_signed(state.mean.error[largest], unit)} {_printed(unit)}")


def _type_error(state: TypeState, axis: str, unit: str) -> dict[str, Any] | None:
    """Return the mean error of a type on an axis with its interval."""
    for error in state.errors:
        if error.axis == axis:
            size, low, high = (_signed(value, unit) for value in (error.size, error.low, error.high))
            is_alarm = any(alarm.axis == axis for alarm in state.alarms)
            return cell(brief(error.size), size, f"[{low}, {high}]", "bad" if is_alarm else None)
    return None


_TYPES = (
    "Mean error over the vehicles of a type, with its 95 % interval. Systematic errors that exceed the tolerance are "
    "marked. Noise is the factor by which errors of checks vary more than predicted."
)


def _alarm(name: str, of: Callable[[Alarm], Any]) -> Column:
    """Return a column that a row opens with, of extrinsics with an alarm."""
    return Column(name, off=True, of=lambda one: None if one.alarm is None else of(one.alarm))


def _proposal(state: ExtrinsicState) -> list[Block]:
    if state.alarm is None:
        return []
    rows = "\n".join(" ".join(f"{value:.12g}" for value in row) for row in state.alarm.proposal)
    return [html.code(f"{rows}\n", "proposed extrinsic, as --extrinsic and p2o convert read it", paste=True)]


def _history(state: ExtrinsicState) -> Iterator[Block]:
    """Yield the plots of the errors by axis and of the evidence over time."""
    past = state.history
    since = () if state.alarm is None else (float(round(state.alarm.since)),)
    known = np.isfinite(past.error).all(axis=1)
    times = past.time[known].round().tolist()
    first, last = (float(past.time.min()), float(past.time.max()) + 1.0) if len(past.time) else (None, None)
    x = Axis("", time=True, low=first, high=last)
    panels = []
    for number, (axis, unit) in enumerate(AXES):
        factor, least = (1.0, 0.3) if unit == "deg" else (100.0, 3.0)
        error, half = (factor * values[known, number] for values in (past.error, 1.96 * past.sigma))
        # All points and nine of ten intervals are inside: a single weak check has a long one.
        reach = max(least, *np.abs(error).tolist(), float(np.quantile(np.abs(error) + half, 0.9))) if times else 1.0
        low, high = (np.clip(ends, -reach, reach).tolist() for ends in (error - half, error + half))
        series = [Series("check", times, error.tolist(), size=0.5, low=low, high=high)] if times else []
        scale = Axis("", low=-1.05 * reach, high=1.05 * reach)
        panels.append(Panel(x, scale, series, title=f"{axis} [{_printed(unit)}]", marks=since, height=180))
    evidence = [min(value, _MOST_EVIDENCE) if math.isfinite(value) else 0.0 for value in past.log_e.tolist()]
    line = [Series("evidence", past.time.round().tolist(), evidence, "line", size=0.3)]
    title = f"evidence of an error (log e-value, at most {_MOST_EVIDENCE:g})"
    panels.append(Panel(x, Axis("", zero=True), line, title=title, marks=since, height=180))
    yield plot(panels, least=360)
    missing = int((~known).sum())
    if missing:
        yield html.text(f"{missing} checks without an estimate are not shown.", "quiet")


def _sensors(state: ExtrinsicState) -> str:
    return f"{state.camera} and {state.lidar}"


def _time_cell(time: float) -> dict[str, Any]:
    return cell(time, _short_time(time))


def _short_time(time: float) -> str:
    return iso(time).replace("T", " ")[:16]


def _printed(unit: str) -> str:
    return "deg" if unit == "deg" else "cm"


def _signed(value: float, unit: str) -> str:
    return f"{value:+.2f}" if unit == "deg" else f"{100 * value:+.1f}"
