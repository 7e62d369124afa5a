"""The report on a fleet as JSON and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from p2o.files.whole_file import json_text, make_writable, write_errors, write_whole

from p2o_fleet.fleet_state import ExtrinsicState, FleetState, FleetStatus, TypeState, amount
from p2o_fleet.segments import Extrinsic

STATE = "fleet.json"
_STRENGTH = 300.0
"""Upper limit of the natural logarithm of an e-value in files: larger ones do not fit a number of JSON readers."""


def write_state(state: FleetState, folder: Path) -> dict[str, Any]:
    """Write `fleet.json` to a folder, and return its content: dicts, lists, numbers, texts and None, no histories.

    Raises InputError if the folder cannot be written.
    """
    with write_errors("the report on the fleet", folder):
        make_writable(folder)
    plain = {
        "until": iso(state.until),
        "checks": state.checks,
        "rules": asdict(state.rules),
        "statuses": status_counts(state),
        "alarms": [_alarm_dict(one) for one in state.alarms],
        "types": [_type_dict(one) for one in state.types],
        "extrinsics": [extrinsic_dict(one) for one in state.extrinsics],
        "remarks": list(state.remarks),
    }
    write_whole(folder / STATE, json_text(plain).encode())
    return plain


def iso(time: float) -> str:
    """Return a time in s since 1970 as ISO 8601 in UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def status_counts(state: FleetState) -> dict[str, int]:
    """Return the number of extrinsics in use by status."""
    counts = Counter(one.status for one in state.current)
    return {status.value: counts[status] for status in FleetStatus}


def _identity(state: ExtrinsicState) -> dict[str, Any]:
    return {one.name: getattr(state, one.name) for one in fields(Extrinsic)}


def _strength(log_e: float) -> float:
    return round(min(log_e, _STRENGTH), 3)


def extrinsic_dict(state: ExtrinsicState) -> dict[str, Any]:
    """Return an extrinsic without its history."""
    names = ("current", "status", "reason", "checks", "usable", "unreadable", "frames")
    return {
        **_identity(state),
        **{name: getattr(state, name) for name in names},
        "first": iso(state.first),
        "last": iso(state.last),
        "log_e": _strength(state.total_log_e),
        "error": None if state.mean is None else state.mean.error.round(6).tolist(),
        "sigma": None if state.mean is None else state.mean.sigma.round(6).tolist(),
    }


def _alarm_dict(state: ExtrinsicState) -> dict[str, Any]:
    assert state.alarm is not None
    plain = asdict(state.alarm)
    del plain["present"]
    plain["since_interval"] = [iso(plain.pop("since_first")), iso(plain.pop("since_last"))]
    plain |= {"since": iso(state.alarm.since), "log_e": _strength(state.total_log_e)}
    plain["proposal"] = state.alarm.proposal.tolist()
    return {**_identity(state), "status": state.status, "text": state.reason, **plain}


def _type_dict(state: TypeState) -> dict[str, Any]:
    return {**asdict(state), "log_e": list(map(_strength, state.log_e)), "text": type_text(state)}


def type_text(state: TypeState) -> str:
    """Return the systematic errors of a type as text, empty if there are none."""
    if not state.alarms:
        return ""
    sizes = ", ".join(map(amount, state.alarms))
    return f"{state.vehicles} vehicles of type {state.vehicle_type or 'unnamed'} have in common: {sizes}"


def summary_lines(state: FleetState, most: int = 20) -> Sequence[str]:
    """Return the state of a fleet as lines for a terminal."""
    counts = status_counts(state)
    total = sum(counts.values())
    by_status = ", ".join(f"{count} {status.replace('-', ' ')}" for status, count in counts.items())
    lines = [f"{total} extrinsics in use, {state.checks} checks until {iso(state.until)}: {by_status}"]
    lines += [f"  {type_text(one)}" for one in state.types if one.alarms]
    alarms = [
        f"{one.vehicle}, {one.camera} and {one.lidar}: {one.reason}, since {iso(one.alarm.since)}"
        + (", as its type" if one.alarm.systematic else "")
        for one in state.alarms
        if one.alarm is not None
    ]
    for texts, further in ((alarms, "alarms"), ([f"remark: {text}" for text in state.remarks], "remarks")):
        lines += [f"  {text}" for text in texts[:most]]
        if len(texts) > most:
            lines.append(f"  and {len(texts) - most} further {further}")
    return lines
