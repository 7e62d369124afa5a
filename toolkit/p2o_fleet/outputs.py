"""Files of a report on a fleet: JSON, metrics for Prometheus, the payload of a webhook, and proposed extrinsics."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import json_text, make_writable, write_errors, write_whole

from p2o_fleet.fleet_state import ExtrinsicState, FleetState, FleetStatus, TypeState, amount
from p2o_fleet.segments import Extrinsic

STATE, METRICS, WEBHOOK, PROPOSALS = "fleet.json", "fleet.prom", "webhook.json", "proposals"
_STRENGTH = 300.0
"""Upper limit of the natural logarithm of an e-value in files: larger ones do not fit a number of JSON readers."""


def write_outputs(state: FleetState, folder: Path) -> dict[str, Any]:
    """Write `fleet.json`, `fleet.prom`, `webhook.json` and `proposals/*.txt` to a folder; return the content of JSON.

    The payload of the webhook contains the alarms that an earlier `fleet.json` in the folder does not contain. Raises
    InputError if the folder cannot be written.
    """
    with write_errors("the report on the fleet", folder):
        make_writable(folder)
        (folder / PROPOSALS).mkdir(exist_ok=True)
    before = _known_alarms(folder / STATE)
    plain = state_dict(state)
    for one in state.alarms:
        assert one.alarm is not None
        write_whole(folder / PROPOSALS / proposal_name(one), matrix_text(one.alarm.proposal).encode())
    write_whole(folder / METRICS, prometheus_text(state).encode())
    write_whole(folder / WEBHOOK, json_text(webhook_payload(state, before)).encode())
    # Last: if a step before fails, the next report announces its alarms again.
    write_whole(folder / STATE, json_text(plain).encode())
    return plain


def iso(time: float) -> str:
    """Return a time in s since 1970 as ISO 8601 in UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def proposal_name(state: ExtrinsicState) -> str:
    """Return the file name of a proposed extrinsic."""
    name = "_".join(re.sub(r"[^\w.-]", "-", part) for part in (state.vehicle, state.camera, state.lidar))
    return f"{name}_{state.digest[:8]}.txt"


def matrix_text(camera_from_lidar: Float) -> str:
    """Return a pose (4, 4) as text that `--extrinsic` and `p2o convert` read."""
    return "\n".join(" ".join(f"{value:.12g}" for value in row) for row in camera_from_lidar) + "\n"


def state_dict(state: FleetState) -> dict[str, Any]:
    """Return the state of a fleet as dicts, lists, numbers, texts and None; histories are left out."""
    return {
        "until": iso(state.until),
        "checks": state.checks,
        "rules": asdict(state.rules),
        "statuses": status_counts(state),
        "alarms": [_alarm_dict(one) for one in state.alarms],
        "types": [_type_dict(one) for one in state.types],
        "services": [{**asdict(one), "time": iso(one.time)} for one in state.services],
        "extrinsics": [extrinsic_dict(one) for one in state.extrinsics],
        "remarks": list(state.remarks),
    }


def status_counts(state: FleetState) -> dict[str, int]:
    """Return the number of extrinsics in use by status."""
    counts = Counter(one.status for one in state.current)
    return {status.value: counts[status] for status in FleetStatus}


def _identity(state: ExtrinsicState) -> dict[str, Any]:
    return {one.name: getattr(state, one.name) for one in fields(Extrinsic) if one.name != "current"}


def extrinsic_dict(state: ExtrinsicState) -> dict[str, Any]:
    """Return an extrinsic without its history."""
    names = ("current", "status", "reason", "checks", "usable", "unreadable", "frames")
    error, sigma = (None, None) if state.mean is None else (state.mean.error, state.mean.sigma)
    return {
        **_identity(state),
        **{name: getattr(state, name) for name in names},
        "first": iso(state.first),
        "last": iso(state.last),
        "log_e": round(min(state.total_log_e, _STRENGTH), 3),
        "error": None if error is None else error.round(6).tolist(),
        "sigma": None if sigma is None else sigma.round(6).tolist(),
    }


def _alarm_dict(state: ExtrinsicState) -> dict[str, Any]:
    assert state.alarm is not None
    plain = asdict(state.alarm)
    del plain["present"]
    plain["since_interval"] = [iso(plain.pop("since_first")), iso(plain.pop("since_last"))]
    plain |= {"since": iso(state.alarm.since), "log_e": round(min(state.alarm.log_e, _STRENGTH), 3)}
    plain["proposal"] = state.alarm.proposal.tolist()
    return {**_identity(state), "status": state.status, "text": state.reason, **plain}


def _type_dict(state: TypeState) -> dict[str, Any]:
    plain = asdict(state)
    plain["log_e"] = [round(min(value, _STRENGTH), 3) for value in state.log_e]
    plain["text"] = type_text(state)
    return plain


def type_text(state: TypeState) -> str:
    """Return the systematic errors of a type as text, empty if there are none."""
    if not state.alarms:
        return ""
    sizes = ", ".join(map(amount, state.alarms))
    return f"{state.vehicles} vehicles of type {state.vehicle_type or 'unnamed'} have in common: {sizes}"


def _known_alarms(path: Path) -> set[tuple[str, ...]]:
    """Return the alarms of an earlier report; none if there is no valid one."""
    if not path.exists():
        return set()
    try:
        plain = parse_json(read_text(path, "earlier report"), "earlier report", path)
        alarms = {_alarm_key(alarm) for alarm in plain["alarms"]}
        return alarms | {("type", *(one[name] for name in _TYPE)) for one in plain["types"] if one["alarms"]}
    except (InputError, KeyError, TypeError):
        return set()


_TYPE = ("vehicle_type", "camera", "lidar")


def _alarm_key(alarm: dict[str, Any]) -> tuple[str, ...]:
    return tuple(alarm[name] for name in ("vehicle", "camera", "lidar", "digest", "service"))


def webhook_payload(state: FleetState, known: set[tuple[str, ...]]) -> dict[str, Any]:
    """Return the payload: `text`, one line per new alarm, as chats take it, and `alarms` and `types` in full."""
    alarms = [plain for plain in map(_alarm_dict, state.alarms) if _alarm_key(plain) not in known]
    types = [one for one in state.types if one.alarms and ("type", *(getattr(one, n) for n in _TYPE)) not in known]
    lines = [type_text(one) for one in types]
    lines += ["{vehicle}: {camera} and {lidar}: {text}, since {since}".format(**one) for one in alarms]
    return {"text": "\n".join(lines), "alarms": alarms, "types": [_type_dict(one) for one in types]}


def prometheus_text(state: FleetState) -> str:
    """Return metrics in the text format of Prometheus, for the textfile collector of its node exporter."""
    return "\n".join(_metrics(state)) + "\n"


def _metrics(state: FleetState) -> Iterator[str]:
    def head(name: str, text: str, kind: str = "gauge") -> list[str]:
        return [f"# HELP p2o_fleet_{name} {text}", f"# TYPE p2o_fleet_{name} {kind}"]

    yield from head("extrinsics", "Extrinsics in use by status.")
    for status, count in status_counts(state).items():
        yield f"p2o_fleet_extrinsics{_labels(status=status)} {count}"
    yield from head("checks_total", "Stored checks.", "counter")
    yield f"p2o_fleet_checks_total {state.checks}"
    yield from head("last_check_timestamp_seconds", "Time of the last check.")
    yield f"p2o_fleet_last_check_timestamp_seconds {state.until:.0f}"
    yield from head("error", "Error of an axis with an alarm, in degrees or metres.")
    for one in state.alarms:
        assert one.alarm is not None
        for axis in one.alarm.axes:
            labels = _labels(vehicle=one.vehicle, camera=one.camera, lidar=one.lidar, axis=axis.axis, unit=axis.unit)
            yield f"p2o_fleet_error{labels} {axis.size:.6g}"
    yield from head("type_error", "Systematic error of an axis of a vehicle type with an alarm, in degrees or metres.")
    for own in state.types:
        for axis in own.alarms:
            labels = _labels(type=own.vehicle_type, camera=own.camera, lidar=own.lidar, axis=axis.axis, unit=axis.unit)
            yield f"p2o_fleet_type_error{labels} {axis.size:.6g}"


def _labels(**labels: str) -> str:
    def escaped(text: str) -> str:
        return text.replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')

    return "{" + ",".join(f'{name}="{escaped(value)}"' for name, value in labels.items()) + "}"


def summary_lines(state: FleetState, most: int = 20) -> Sequence[str]:
    """Return the state of a fleet as lines for a terminal."""
    counts = status_counts(state)
    total = sum(counts.values())
    texts = ", ".join(f"{count} {status.replace('-', ' ')}" for status, count in counts.items())
    lines = [f"{total} extrinsics in use, {state.checks} checks until {iso(state.until)}: {texts}"]
    lines += [f"  {type_text(one)}" for one in state.types if one.alarms]
    for one in state.alarms[:most]:
        assert one.alarm is not None
        systematic = ", as its type" if one.alarm.systematic else ""
        lines.append(
            f"  {one.vehicle}, {one.camera} and {one.lidar}: {one.reason}, since {iso(one.alarm.since)}{systematic}"
        )
    if len(state.alarms) > most:
        lines.append(f"  and {len(state.alarms) - most} further alarms")
    lines += [f"  remark: {text}" for text in state.remarks[:most]]
    if len(state.remarks) > most:
        lines.append(f"  and {len(state.remarks) - most} further remarks")
    return lines
