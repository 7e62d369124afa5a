"""The page of a fleet: overview, vehicles with filter and search, history of each with alarms; works offline."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from p2o.arrays import Float
from p2o.confidence.audit import AXES
from p2o.draw.one_file import part, rendered
from p2o.files.whole_file import write_errors, write_whole
from p2o_study.report.page import script_json, shown_texts

from p2o_fleet.fleet_state import ExtrinsicState, FleetState, FleetStatus, ServiceChange, TypeState, amount
from p2o_fleet.outputs import extrinsic_dict, iso, matrix_text, proposal_name, status_counts, type_text
from p2o_fleet.overlays import Overlays

INDEX, DATA = "index.html", "data"
_PER_FILE = 50
"""Number of extrinsics whose histories are in one file."""


def write_page(state: FleetState, folder: Path, overlays: Overlays | None = None) -> Path:
    """Write the page to a folder: index.html, and files of histories that it loads on demand; return its path.

    It needs no server and loads nothing from elsewhere. Raises InputError if the folder cannot be written.
    """
    with write_errors("the page of the fleet", folder):
        (folder / DATA).mkdir(parents=True, exist_ok=True)
        for path in (folder / DATA).glob("*.js"):
            path.unlink()
    # Alarms first: the overlays are for the strongest ones.
    order = [*state.alarms, *(one for one in state.current if one.alarm is None)]
    retired = [one for one in state.extrinsics if not one.current]
    rows = []
    for number, one in enumerate([*order, *retired]):
        rows.append({**_row(one), "file": number // _PER_FILE, "place": number % _PER_FILE})
    for first in range(0, len(rows), _PER_FILE):
        histories = [_history(one, overlays) for one in [*order, *retired][first : first + _PER_FILE]]
        text = json.dumps([first // _PER_FILE, shown_texts(histories)], separators=(",", ":"), allow_nan=False)
        write_whole(folder / DATA / f"history-{first // _PER_FILE}.js", f"receiveHistories(...{text});\n".encode())
    data = {
        "rows": rows,
        "axes": [list(axis) for axis in AXES],
        "statuses": status_counts(state),
        "checks": state.checks,
        "until": iso(state.until),
        "types": [_type(one) for one in state.types],
        "services": [{"vehicle": one.vehicle, "text": _service_text(one)} for one in state.services],
        "rate": state.rules.rate,
        "tolerance": state.rules.tolerance,
        "notice": state.rules.notice,
    }
    page = rendered(
        "p2o_fleet/page.html",
        style="p2o_study.report/page.css",
        scripts=(part("p2o_study.report/nodes.js") + part("p2o_fleet/page.js"),),
        script_files=True,
        title="Fleet",
        own_style=Markup(part("p2o_fleet/page.css")),
        data=script_json(data),
    )
    write_whole(folder / INDEX, page.encode())
    return folder / INDEX


def _row(state: ExtrinsicState) -> dict[str, Any]:
    """Return an extrinsic as a row of the overview."""
    plain = extrinsic_dict(state)
    names = ("vehicle", "vehicle_type", "camera", "lidar", "extrinsic", "service", "current", "status", "reason")
    row = {name: plain[name] for name in (*names, "last", "checks", "usable", "unreadable", "frames", "log_e")}
    row["error"], row["sigma"] = plain["error"], plain["sigma"]
    alarm = state.alarm
    if alarm is not None:
        row |= {
            "since": iso(alarm.since),
            "sinceRange": [iso(alarm.since_first), iso(alarm.since_last)],
            "systematic": alarm.systematic,
            "axis": alarm.axes[0].axis,
            "alarmChecks": alarm.checks,
            "alarmFrames": alarm.frames,
            "proposal": matrix_text(alarm.proposal),
            "proposalFile": proposal_name(state),
            "proof": list(alarm.proof),
        }
    return row


def _history(state: ExtrinsicState, overlays: Overlays | None) -> dict[str, Any]:
    """Return the history of an extrinsic by column, and its overlays."""
    past = state.history
    return {
        "time": [round(time) for time in past.time.tolist()],
        "verdict": list(past.verdict),
        "error": [_rounded(row) for row in past.error],
        "sigma": [_rounded(row) for row in past.sigma],
        "logE": [round(value, 2) if math.isfinite(value) else None for value in past.log_e.tolist()],
        "since": None if state.alarm is None else round(state.alarm.since),
        "overlays": overlays.of(state) if overlays is not None and state.status is not FleetStatus.HOLDS else [],
    }


def _rounded(values: Float) -> list[float] | None:
    return [float(f"{value:.4g}") for value in values] if np.isfinite(values).all() else None


def _type(state: TypeState) -> dict[str, Any]:
    errors = [[error.axis, error.unit, error.size, error.low, error.high] for error in state.errors]
    names = [error.axis for error in state.alarms]
    return {
        "name": state.vehicle_type or "unnamed",
        "pair": f"{state.camera} and {state.lidar}",
        "vehicles": state.vehicles,
        "errors": errors,
        "alarms": names,
        "text": type_text(state),
        "trends": list(state.trends),
        "noise": [round(value, 2) for value in state.noise_scale],
    }


def _service_text(change: ServiceChange) -> str:
    return "; ".join(_texts(change))


def _texts(change: ServiceChange) -> Iterator[str]:
    yield f"{change.camera} and {change.lidar}, service {change.service} at {iso(change.time)}"
    yield from map(amount, change.axes)
