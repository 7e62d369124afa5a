"""Measure what the results of a suite lack, by a study of the missing and stale rows, and add the rows."""

from __future__ import annotations

import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import p2o
from p2o.errors import UnknownNameError
from p2o.results.result import Status

from p2o_study.ablate import OnProgress, OnWarning, ablate
from p2o_study.benchmark.outcomes import Outcomes
from p2o_study.benchmark.plan import GIVEN, State, Task, state_of
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import FrameOfRow, Machine, Method, Predicted, Row
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.cells import Cell
from p2o_study.parallel import Workers
from p2o_study.store import StoredRow
from p2o_study.worker import Plugins

WORDS = ("extractor", "matcher", "solver", "init", "calibrator", "accumulate", "witness")
_BOUNDS = ("rotation_deg", "translation_m", "rotation_deg_95", "translation_m_95")


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


def measure(
    suite: SuiteFile,
    results: Results,
    store: Path,
    *,
    measured_by: str,
    sections: Collection[str] = (),
    plugins: Plugins | None = None,
    workers: Workers | None = None,
    at_most: int | None = None,
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Measured:
    """Compute the missing and stale rows of a suite, or of some of its `sections`, and add them to the results.

    A calibration that another suite has measured with this version of the method is not computed again, unless the
    suite has `share = false`. `store`
    is the folder of the study's store, from which an interrupted measurement continues. Raises UnknownNameError for an
    unknown section, and as `ablate`.
    """
    names = list(dict.fromkeys(row.section for row in suite.rows))
    for section in sections:
        if section not in names:
            raise UnknownNameError("section", section, names, where=suite.source)
    outcomes, equivalences = Outcomes.read(results, suite.name), results.equivalences
    others = [Outcomes.read(results, name) for name in results.suites if suite.suite.share and name != suite.name]
    # Equal frames of two data sets have one key.
    tasks: dict[tuple[str, str], Task] = {}
    shared: list[tuple[Row, Task]] = []
    fresh = unreadable = 0

    def wanted(cell: Cell) -> bool:
        nonlocal fresh, unreadable
        if sections and cell.planned.section not in sections:
            return False
        task = Task.of(suite.name, cell)
        if task is None:
            unreadable += 1
            return False
        if state_of(task, outcomes.measured(task.identity), equivalences) is State.FRESH:
            fresh += 1
            return False
        known = measured_elsewhere(task, others)
        if known is not None:
            shared.append((known, task))
            return False
        tasks[cell.planned.key, cell.planned.row] = task
        return True

    done = ablate(
        suite.study,
        store,
        plugins=plugins,
        workers=workers,
        at_most=at_most,
        wanted=wanted,
        on_progress=on_progress,
        on_warning=on_warning,
    )
    commit = source_version()
    new = list(shared)
    crashed = 0
    for stored in done.rows:
        task = tasks[stored.key, stored.row]
        row = row_of(task, stored, commit, measured_by)
        crashed += row.crashed
        # A calibration that raises again is the same outcome, not a further one.
        if not (row.crashed and any(known.crashed for known in outcomes.measured(task.identity))):
            new.append((row, task))
    frames = {frame.line: frame for _, task in new for frame in task.frames}
    added = results.add(suite.name, [row for row, _ in new], frames.values())
    return Measured(fresh, added, len(shared), crashed, len(done.missing), unreadable, done.interrupted)


def measured_elsewhere(task: Task, others: Sequence[Outcomes]) -> Row | None:
    """Return the row of another suite that is a measurement of the same calibration, under the names of the task.

    Method, content and truth of the frames, initial guess and seed are equal; labels and the name of the dataset may
    differ. None if no suite has one.
    """
    for outcomes in others:
        number = outcomes.runs["method"]
        same = np.array([digest == task.cell.method.digest for _, digest in outcomes.methods], bool)
        if not same.any():
            continue
        named = np.array([place == task.names for place in outcomes.places], bool)
        runs = outcomes.runs
        for place in np.flatnonzero(same[number] & named[runs["place"]] & (runs["seed"] == task.cell.seed)):
            row = outcomes.row(int(place))
            same_draw = row.protocol == task.protocol and row.joint == task.joint
            if same_draw and task.state_of(row) is State.FRESH:
                own = task.cell.planned
                names = {"suite": task.suite, "row": own.row, "section": own.section, "dataset": own.dataset}
                return Row.model_validate({**row.model_dump(mode="json"), **names})
    return None


def row_of(task: Task, stored: StoredRow, commit: str, measured_by: str) -> Row:
    """Return the row of a finished calibration."""
    bounds: Mapping[str, object] = {name: stored.figures.get(f"predicted_{name}") for name in _BOUNDS}
    seconds = [value for value in stored.seconds.values() if value is not None]
    return Row(
        suite=task.suite,
        row=stored.row,
        section=stored.section,
        dataset=stored.dataset,
        frames=tuple(FrameOfRow(name=frame.name, digest=frame.digest) for frame in task.frames),
        joint="rig" if task.cell.group.rig else bool(stored.joint),
        protocol=stored.perturb or GIVEN,
        seed=stored.seed,
        start=task.start.tolist(),
        method=method_of(task),
        digest=task.cell.method.digest,
        commit=commit,
        estimate=stored.estimate.tolist() if stored.solved and stored.estimate is not None else None,
        status=Status(stored.status),
        reason=stored.reason[:2000],
        verdict=stored.trust,
        predicted=None if None in bounds.values() else Predicted.model_validate(bounds),
        seconds=float(sum(seconds)) if seconds else None,
        machine=Machine.model_validate(dict(stored.machine)),
        versions=dict(stored.versions),
        measured_by=measured_by,
        finished=stored.finished,
    )


def method_of(task: Task) -> Method:
    """Return the words and options of the method of a task."""
    described = task.cell.method.described
    return Method(
        words={word: described[word] for word in WORDS if described.get(word)},
        options={stage: options for stage, options in described["options"].items() if stage != "data"},
    )


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
