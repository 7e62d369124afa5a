"""Measure a suite, state which of its rows are missing or stale, and compute a random sample of its rows again."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import p2o
from p2o.errors import UnknownNameError
from p2o.geometry.pose_error import pose_error

from p2o_study.ablate import Progress, open_session
from p2o_study.benchmark.suite import Suite
from p2o_study.cells import Cell, Method
from p2o_study.row import Row
from p2o_study.rows import Rows, latest
from p2o_study.worker import Plugins

SAME_DEG, SAME_M, SAME_PREDICTED = 1e-6, 1e-6, 1e-3
"""Largest difference of a pose that is computed again, and largest relative difference of a predicted error."""
OTHER_DEG, OTHER_M, OTHER_PREDICTED = 0.02, 0.005, 0.1
"""The same for rows of another processor."""


class State(StrEnum):
    """Whether there is a row of a calibration, and whether it is a measurement of the current version."""

    FRESH = "fresh"
    MISSING = "missing"
    CRASHED = "crashed"
    METHOD = "method changed"
    DATA = "data changed"
    START = "initial guess changed"


class Entry(NamedTuple):
    """One calibration of a suite, planned or finished, and the state of its row."""

    row: Row
    state: State


@dataclass(frozen=True)
class SuiteStatus:
    """The state of every calibration of a suite.

    `unchecked` are datasets without a path: their existing rows are compared by method only, and missing ones are
    unknown. `unreadable` counts calibrations with a frame that cannot be read. `kept` and `removable` are the rows: one
    can be removed if a later one replaces it, or if the suite does not ask for it. Of datasets without a path or with a
    frame that cannot be read, only replaced rows can be removed.
    """

    suite: str
    entries: tuple[Entry, ...]
    unchecked: tuple[str, ...]
    unreadable: int
    kept: Sequence[Row]
    removable: Sequence[Row]

    def count(self, state: State) -> int:
        """Return the number of calibrations in a state."""
        return sum(entry.state is state for entry in self.entries)

    @property
    def outdated(self) -> tuple[Entry, ...]:
        """The calibrations without a fresh row."""
        return tuple(entry for entry in self.entries if entry.state is not State.FRESH)

    def as_dict(self) -> dict[str, object]:
        """Return the status for JSON."""
        return {
            "suite": self.suite,
            "counts": {state.value: self.count(state) for state in State},
            "outdated": [{**row.named(), "state": state.value} for row, state in self.outdated],
            "unchecked_datasets": list(self.unchecked),
            "surplus_rows": len(self.removable),
            "unreadable": self.unreadable,
        }


class _Known:
    """The rows of a suite by key, with and without their labels, and by identity."""

    def __init__(self, rows: Iterable[Row]) -> None:
        rows = list(rows)
        self.by_key: dict[str, Row] = {}
        self.by_label: dict[Any, Row] = {}
        for row in (row for row in rows if not row.crashed):
            self.by_key.setdefault(row.key, row)
            self.by_label.setdefault((row.key, row.identity), row)
        self.by_identity = {row.identity: row for row in latest(rows)}

    def state(self, cell: Cell) -> tuple[State, Row | None]:
        """Return the state of a calibration and its row, the latest one unless there is a fresh one."""
        planned = cell.row
        if (fresh := self.by_label.get((planned.key, planned.identity))) is not None:
            return State.FRESH, fresh
        row = self.by_identity.get(planned.identity)
        if row is None:
            return State.MISSING, None
        return _why_stale(cell, row), row


def _why_stale(cell: Cell, row: Row) -> State:
    if row.crashed:
        return State.CRASHED
    if [f.content for f in row.case.frames] != [f.content for f in cell.row.case.frames]:
        return State.DATA
    if row.method.revision != cell.row.method.revision and not row.method.external:
        return State.METHOD
    starts = cell.row.case.start, row.case.start
    known = all(start is not None for start in starts)
    same_start = known and np.allclose(*starts, rtol=0, atol=1e-6)  # type: ignore[arg-type]
    return State.FRESH if row.method.external and same_start else State.START


@dataclass(frozen=True)
class Measured:
    """The outcome: `fresh` rows were there before, `added` are new, `crashed` raised, `missing` are not computed.

    `shared` of the new rows are measurements of other suites, `unreadable` are calibrations with a frame that cannot be
    read.
    """

    fresh: int
    added: int
    shared: int
    crashed: int
    missing: int
    unreadable: int
    interrupted: bool


def measure(suite: Suite, results: Rows, *, measured_by: str, sections: Collection[str] = (), **words: Any) -> Measured:
    """Compute the missing and stale rows of a suite, or of some of its `sections`, and append them to the results.

    Each row is appended when it is finished, so that an interrupted measurement continues. A calibration that another
    suite has measured with this version of the method is not computed again, unless the suite has `share = false`.
    The other words are those of `open_session`. Raises UnknownNameError for an unknown section, and as `ablate`.
    """
    names = list(dict.fromkeys(row.section for row in suite.all_rows()))
    for section in sections:
        if section not in names:
            raise UnknownNameError("section", section, names, where=suite.file)
    results.make_folder()
    known, commit = _Known(results.each(suite.name)), source_version()
    from_others = [] if not suite.share else [name for name in results.studies if name != suite.name]
    same = {**_Known(row for name in from_others for row in results.each(name)).by_key, **known.by_key}
    pending: list[int] = []
    fresh = shared = unreadable = crashed = 0
    interrupted = False

    def as_stored(row: Row) -> Row:
        nonlocal crashed
        crashed += row.crashed
        environment = replace(row.environment, commit=commit, measured_by=measured_by)
        return replace(row.brief(), environment=environment)

    with open_session(suite, **words) as session:
        try:
            cells = session.cells()
            for position, cell in enumerate(cells):
                if sections and cell.row.section not in sections:
                    continue
                if not cell.group.readable:
                    unreadable += 1
                elif known.state(cell)[0] is State.FRESH:
                    fresh += 1
                elif cell.row.key in same:
                    results.put(suite.name, _labelled(same[cell.row.key], cell))
                    shared += 1
                else:
                    pending.append(position)
            session.compute(cells, pending, results, suite.name, kept=fresh + shared, as_stored=as_stored)
        except KeyboardInterrupt:
            interrupted = True
        known, missing = _Known(results.each(suite.name)), 0
        for cell in (cells[position] for position in pending):
            # Two rows of the suite may be the same calibration, which is computed once.
            if cell.row.key in known.by_key and (cell.row.key, cell.row.identity) not in known.by_label:
                results.put(suite.name, _labelled(known.by_key[cell.row.key], cell))
            missing += cell.row.identity not in known.by_identity and cell.row.key not in known.by_key
    return Measured(fresh, shared + len(pending) - missing, shared, crashed, missing, unreadable, interrupted)


def _labelled(row: Row, cell: Cell) -> Row:
    """Return a row under the labels of another calibration with the same key."""
    return replace(row, **{name: getattr(cell.row, name) for name in ("row", "section", "case", "method")})


def status_of(suite: Suite, results: Rows, plugins: Plugins, **words: Any) -> SuiteStatus:
    """Return the status of a suite; frames of datasets with a path are read, nothing is computed.

    The other words are those of `open_session`.
    """
    rows = list(results.each(suite.name))
    known, unchecked = _Known(rows), {table.name for table in suite.dataset if table.left_out}
    entries: list[Entry] = []
    asked: dict[Any, Cell] = {}
    unreadable: list[str] = []
    if len(unchecked) < len(suite.dataset):
        with open_session(suite, plugins, **{**words, "on_warning": lambda text: None}) as session:
            for cell in session.cells():
                if not cell.group.readable:
                    unreadable.append(cell.row.dataset)
                    continue
                asked[cell.row.identity] = cell
                asked.setdefault(_any_method(cell.row.identity), cell)
                entries.append(Entry(cell.row, known.state(cell)[0]))
    revisions = _revisions(suite, plugins) if unchecked else {}
    for row in known.by_identity.values():
        same, current = asked.get(_asked_by(row)), revisions.get((row.section, row.row))
        if row.method.external and same is not None:
            entries.append(Entry(row, _why_stale(same, row)))
        elif same is None and row.dataset in unchecked and (row.method.external or current is not None):
            is_fresh = current is None or row.method.revision in current
            entries.append(Entry(row, State.CRASHED if row.crashed else State.FRESH if is_fresh else State.METHOD))
    counting = latest(rows, {cell.row.key for cell in asked.values()})
    kept = [row for row in counting if _asked_by(row) in asked or row.dataset in {*unchecked, *unreadable}]
    chosen = set(map(id, kept))
    removable = [row for row in rows if id(row) not in chosen]
    without_data = tuple(sorted(unchecked))
    return SuiteStatus(suite.name, tuple(entries), without_data, len(unreadable), kept, removable)


def _any_method(identity: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return an identity for external methods, whose labels the suite does not have."""
    section, dataset, _, *draw = identity
    return (section, dataset, None, *draw)


def _asked_by(row: Row) -> tuple[Any, ...]:
    return _any_method(row.identity) if row.method.external else row.identity


def _revisions(suite: Suite, plugins: Plugins) -> Mapping[tuple[str, str], set[str]]:
    """Return the revisions of the methods of each row, by section and label; no data are needed."""
    registry = plugins.registry()
    return {
        (row.section, row.label): {Method.of(row, "{}", {}, registry, seed).digest for seed in row.seeds}
        for row in suite.all_rows()
    }


@dataclass(frozen=True)
class Recheck:
    """The outcome of computing a random sample of the rows of a suite again.

    `sampled` rows were compared, drawn with `seed` from `fresh` ones; `different` states each difference in one line,
    `doubled` names calibrations with two fresh rows whose outcomes differ. `missing` and `stale` count calibrations
    without a fresh row, `external` rows of methods that are not installed here.
    """

    suite: str
    sampled: int
    fresh: int
    seed: int
    different: tuple[str, ...]
    doubled: tuple[str, ...]
    missing: tuple[str, ...]
    stale: int
    external: int

    @property
    def clean(self) -> bool:
        """True if all sampled rows agree, and none is doubled."""
        return not self.different and not self.doubled

    def __str__(self) -> str:
        """Return the outcome as lines, with the 95 % upper bound of the share of rows that could differ."""
        bound = f": at most {min(300 / self.sampled, 100):.3g} % of the rows differ (95 %, 3/n)" if self.sampled else ""
        counts = f"{self.sampled} of {self.fresh} fresh rows computed again (seed {self.seed})"
        head = f"{counts}, none differs{bound}" if not self.different else f"{counts}, {len(self.different)} differ"
        lines = [f"{self.suite}: {head}", *(f"  {line}" for line in (*self.different, *self.doubled))]
        left = [(len(self.missing), "missing"), (self.stale, "stale"), (self.external, "of external methods")]
        if unchecked := [f"{count} {what}" for count, what in left if count]:
            lines.append(
                f"  not checked: {', '.join(unchecked)}" + (f", such as {self.missing[0]}" if self.missing else "")
            )
        return "\n".join(lines)


def recheck(suite: Suite, results: Rows, *, sample: int, seed: int, **words: Any) -> Recheck:
    """Compute a random sample of the fresh rows of a suite again; compare status, verdict, pose and predicted errors.

    Rows of this processor have to agree to 1e-6 deg and m, those of others to 0.02 deg and 5 mm. No outcome is taken
    from a store. The other words are those of `open_session`.
    """
    rows = list(results.each(suite.name))
    known = _Known(rows)
    states: Counter[State] = Counter()
    fresh: dict[int, Row] = {}
    missing = []
    with open_session(suite, **words) as session:
        cells = session.cells()
        for position, cell in enumerate(cells):
            state, row = known.state(cell)
            states[state] += 1
            if state is State.MISSING and cell.group.readable:
                missing.append(_name(cell.row))
            if row is not None and state is State.FRESH:
                fresh[position] = row
        places = list(fresh)
        chosen = [places[i] for i in sorted(np.random.default_rng(seed).permutation(len(fresh))[:sample])]
        before = {cells[position].row.key: fresh[position] for position in chosen}
        different: list[str] = []
        for done, row in enumerate(session.calibrated(cells, chosen), start=1):
            if difference := _difference(before[row.key], row):
                different.append(f"{_name(row)}: {difference}")
            session.say(Progress("calibrate", done, len(chosen), failed=len(different), name=_name(row)))
    stale = sum(count for state, count in states.items() if state not in (State.FRESH, State.MISSING))
    external = sum(row.method.external for row in rows)
    doubled = tuple(_doubled(rows, known))
    return Recheck(
        suite.name, len(chosen), len(fresh), seed, tuple(different), doubled, tuple(missing), stale, external
    )


def _doubled(rows: Iterable[Row], known: _Known) -> Iterator[str]:
    """Yield a line for each further row of a key whose outcome differs from the first."""
    for row in rows:
        first = known.by_key.get(row.key)
        if row.crashed or first is None or first is row or first.identity != row.identity:
            continue
        if difference := _difference(first, row):
            yield f"{_name(row)}: measured twice: {difference}"


def _difference(before: Row, after: Row) -> str:
    """Return how the outcome of a calibration differs from that of its row, empty if they agree."""
    processors = [row.environment.machine.get("processor") for row in (before, after)]
    same = processors[0] == processors[1]
    most_deg, most_m, most = (SAME_DEG, SAME_M, SAME_PREDICTED) if same else (OTHER_DEG, OTHER_M, OTHER_PREDICTED)
    parts = []
    if before.status.solved != after.status.solved:
        parts.append(f"status {after.status.value} instead of {before.status.value}")
    if before.trust is not after.trust:
        parts.append(f"verdict {after.trust or 'none'} instead of {before.trust or 'none'}")
    if before.estimate is not None and after.estimate is not None:
        step = pose_error(before.estimate, after.estimate)
        if step.rotation_deg > most_deg or step.translation_m > most_m:
            parts.append(f"pose {step.rotation_deg:.3g} deg and {step.translation_m:.3g} m apart")
    for name in sorted({*before.brief().figures, *after.brief().figures}):
        old, new = before.figures.get(name), after.figures.get(name)
        numbers = isinstance(old, float | int) and isinstance(new, float | int)
        if not numbers or not isclose(float(old), float(new), rel_tol=most):  # type: ignore[arg-type]
            parts.append(f"{name} {new} instead of {old}")
    if parts and not same:
        parts.append(f"the row is of another processor ({processors[0]})")
    return ", ".join(parts)


def _name(planned: Any) -> str:
    return f"{planned.section}, {planned.row}, {planned.dataset} {planned.place}, seed {planned.seed}"


@cache
def source_version() -> str:
    """Return the Git commit of the sources, with "+changes" if code differs from it, or the installed version."""
    folder = str(Path(p2o.__file__).parent)

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", folder, *words], capture_output=True, text=True, check=True, timeout=60)
        return done.stdout.strip()

    try:
        commit = git("rev-parse", "HEAD")
        return commit + ("+changes" if git("status", "--porcelain", "--untracked-files=no", "--", ":(top)*.py") else "")
    except (OSError, subprocess.SubprocessError):
        pass
    try:
        return f"version {version('p2o-calib')}"
    except PackageNotFoundError:
        return "unknown"
