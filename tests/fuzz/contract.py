"""What p2o promises of every input, right or wrong (docs/reliability.md), checked on how a command ended."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.sandbox import PEAK_BYTES, Outcome
from tests.fuzz.surfaces import OUT, Case

INTERRUPTED = 130
STATUSES = {0, 1, 2, INTERRUPTED}
_LONGEST_LINE = 2000
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
_OURS = re.compile(r"p2o|\d+ ")
"""How a line on stderr begins: our name, or how many of something were written or are left."""
_RIGID = 1e-6


def broken(case: Case, outcome: Outcome, home: Path) -> list[str]:
    """Return a line for each promise that was not kept."""
    found = []
    if outcome.hung:
        return ["hung"]
    if outcome.status is None:
        return [f"ended by signal {outcome.signal}"]
    if outcome.status not in STATUSES:
        found.append(f"status {outcome.status}: {_last_line(outcome.stderr)}")
    if outcome.interrupted and outcome.status != INTERRUPTED:
        found.append(f"interrupted, and status {outcome.status}")
    if outcome.peak_bytes > PEAK_BYTES:
        found.append(f"took {outcome.peak_bytes / 1e9:.1f} GB")
    found += [f"touched what it must not: {line}" for line in outcome.trespass]
    said, told = (_text(name, data, found) for name, data in (("stdout", outcome.stdout), ("stderr", outcome.stderr)))
    lines = told.splitlines()
    found += [f"stderr is not of p2o: {line[:200]}" for line in lines if not _OURS.match(line)][:1]
    found += [f"a line of {len(line)} letters: {line[:100]}" for line in lines if len(line) > _LONGEST_LINE][:1]
    if outcome.status == 2 and not any(line.startswith("p2o: error: ") for line in lines) and ": BAD: " not in said:
        found.append("status 2 without a word")
    if sum(line.startswith("p2o: error: ") for line in lines) > 1:
        found.append("more than one error")
    if outcome.status in (0, 1):
        found += _results(case, said, home)
    return found


def _text(name: str, data: bytes, found: list[str]) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        found.append(f"{name} is not UTF-8")
        text = data.decode("utf-8", "replace")
    control = _CONTROL.search(text)
    if control is not None:
        around = text[max(0, control.start() - 40) : control.end() + 20]
        found.append(f"a control character on {name}: {around!r}")
    return text


def _last_line(stderr: bytes) -> str:
    return (stderr.decode(errors="replace").strip().splitlines() or ["nothing said"])[-1][:300]


def _results(case: Case, said: str, home: Path) -> list[str]:
    """Return what is wrong with the results on stdout and in files."""
    found: list[str] = []
    texts = {str(path.relative_to(home)): path for path in (home / OUT).rglob("*.json")}
    values: dict[str, Any] = {}
    for name, path in texts.items():
        values[name] = _json(path.read_text(encoding="utf-8", errors="replace"), name, found)
    if "--json" in case.argv:
        values["stdout"] = _json(said, "stdout", found)
    for name, value in values.items():
        found += [f"{name}: {why}" for pose in _poses(value) for why in [_not_rigid(pose)] if why]
    return found


def _json(text: str, name: str, found: list[str]) -> Any:
    def refuse(constant: str) -> Any:
        raise ValueError(f"holds {constant}")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as problem:
        found.append(f"{name} is not JSON: {problem}")
        return None


def _poses(value: Any) -> list[Any]:
    if isinstance(value, dict):
        own = [value["camera_from_lidar"]] if "camera_from_lidar" in value else []
        if own == [None] and "left_out" in value:  # a camera of a rig that has nothing in common
            own = []
        return own + [pose for inner in value.values() for pose in _poses(inner)]
    return [pose for inner in value for pose in _poses(inner)] if isinstance(value, list) else []


def _not_rigid(pose: Any) -> str:
    try:
        matrix = np.array(pose, dtype=float)
    except (TypeError, ValueError):
        return f"a pose that is none: {str(pose)[:100]}"
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return f"a pose that is not finite: {str(pose)[:100]}"
    turn = matrix[:3, :3]
    right = np.allclose(turn @ turn.T, np.eye(3), atol=_RIGID) and np.linalg.det(turn) > 0
    return "" if right and np.array_equal(matrix[3], [0, 0, 0, 1]) else f"a pose that is not rigid: {str(pose)[:200]}"
