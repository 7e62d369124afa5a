"""Confirm by a random sample of rows that a change of a method's code altered no outcome."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from math import isclose, radians

import numpy as np
from p2o.cache import FeatureCache, content_hash
from p2o.geometry.pose_error import pose_error

from p2o_study.ablate import OnProgress, Progress, ReadOptions, calibrated, read_cells
from p2o_study.benchmark.equivalences import Equivalence, Equivalences
from p2o_study.benchmark.measure import method_of, row_of, source_version
from p2o_study.benchmark.outcomes import Outcomes
from p2o_study.benchmark.plan import State, Task, state_of
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import Machine, Method, Row
from p2o_study.benchmark.status import method_digests
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.machine import machine_info
from p2o_study.parallel import Run
from p2o_study.worker import Plugins, now

SAMPLE = 30
SAME_RAD, SAME_M, SAME_PREDICTED = 1e-6, 1e-6, 1e-6
"""Largest difference of a pose from that of the row, and largest relative difference of a predicted error."""


@dataclass(frozen=True, eq=False)
class _Stale:
    """A row that is stale only because the code of its method changed, and its calibration."""

    task: Task
    row: Row

    @property
    def position(self) -> tuple[str, ...]:
        """Sorts rows by suite, dataset, section, label, initial error, frames and seed."""
        suite, dataset, label, protocol, seed, *names = self.row.identity
        return (suite, dataset, self.row.section, label, protocol, *names, seed)


@dataclass(frozen=True)
class Confirmation:
    """The outcome for one version of a method, which has the digest `digest`, or one digest for each seed.

    Of `of` rows, `computed` were computed again; `difference` is empty if all agree.
    """

    label: str
    digest: str
    computed: int
    of: int
    seed: int
    difference: str = ""

    def __str__(self) -> str:
        """Return the outcome with the 95 % upper bound of the share of rows that could differ (rule of three)."""
        head = f"{self.label} ({self.digest[:8]}): {self.computed} of {self.of} rows computed again (seed {self.seed})"
        if self.difference:
            return f"{head}, no equivalence; this row differs:\n  {self.difference}"
        if self.computed == self.of:
            return f"{head}, none differs"
        return f"{head}, none differs: at most {upper_bound(self.computed):.3g} % of the rows differ (95 % bound, 3/n)"


def upper_bound(computed: int) -> float:
    """Return the 95 % upper bound, in %, of the share of rows that differ if none of a random sample does."""
    return min(300 / computed, 100.0)


def confirmations(
    suites: Sequence[SuiteFile],
    results: Results,
    options: ReadOptions,
    *,
    sample: int = SAMPLE,
    seed: int,
    measured_by: str,
) -> Iterator[Confirmation]:
    """Compute a random sample of the rows again whose method changed, and yield the outcome for each method.

    If all rows of a sample have the outcome that they had, the equivalence is added to the results before the outcome
    is yielded; a sample ends at the first row that differs. No outcome is taken from a store.
    """
    equivalences = results.equivalences
    stale: list[_Stale] = []
    for suite in suites:
        outcomes = Outcomes.read(results, suite.name)
        if _has_changed_methods(suite, outcomes, equivalences, options.plugins):
            tasks = (Task.of(suite.name, cell) for cell in read_cells(suite.study, options))
            known = (_stale(task, outcomes, equivalences) for task in tasks if task is not None)
            stale += [row for row in known if row is not None]
    with options.workers.start() as run:
        for rows in by_version(stale):
            # The sample of a method does not depend on the other methods.
            digest = min(row.row.digest for row in rows)
            chosen = drawn(rows, sample, np.random.default_rng([seed, int(digest[:8], 16)]))
            confirmation = _compared(chosen, rows, run, seed, measured_by, options.on_progress)
            if not confirmation.difference:
                results.add_equivalence(_equivalence(confirmation, rows, measured_by))
            yield confirmation


def _has_changed_methods(suite: SuiteFile, outcomes: Outcomes, equivalences: Equivalences, plugins: Plugins) -> bool:
    """Return whether a row on data of this machine has another digest than its method; no frame is read."""
    with_data = {table.name for table in suite.study.study.dataset if not table.left_out}
    digests = method_digests(suite, plugins) if with_data else {}
    for run in outcomes.runs[outcomes.latest]:
        dataset, label = outcomes.datasets[run["dataset"]], outcomes.rows[run["row"]]
        method, digest = outcomes.methods[run["method"]]
        present = digests.get(label, {}).get(int(run["seed"]))
        if dataset not in with_data or method.external or present is None:
            continue
        if equivalences.sample(digest, present, suite.name, dataset) is None:
            return True
    return False


def _stale(task: Task, outcomes: Outcomes, equivalences: Equivalences) -> _Stale | None:
    """Return the last row of a task if its method is all that changed, and only the code of it."""
    rows = outcomes.measured(task.identity)
    if state_of(task, rows, equivalences) is not State.METHOD or task.cell.group.failure is not None:
        return None
    same = task.has_start_of(rows[0]) and method_of(task) == rows[0].method
    return _Stale(task, rows[0]) if same else None


def by_version(rows: Iterable[_Stale]) -> list[list[_Stale]]:
    """Return the rows of each earlier version of each method.

    Rows of a method have the same words and options, apart from seeds. They are of one version if they have the same
    digest; different digests, such as one for each seed, are of one version if they were measured with one commit.
    """
    versions: list[tuple[set[tuple[str, str]], list[_Stale]]] = []
    for stale in rows:
        method, commit = _method_key(stale.row.method), stale.row.commit
        marks = {(method, stale.row.digest)}
        # Sources with changes are not one version.
        if "+changes" not in commit and commit != "unknown":
            marks.add((method, commit))
        same = [version for version in versions if version[0] & marks]
        versions = [version for version in versions if not version[0] & marks]
        versions.append((marks.union(*(known for known, _ in same)), [*(s for _, its in same for s in its), stale]))
    return [its for _, its in versions]


def _method_key(method: Method) -> str:
    """Return the hash of words and options without the seeds."""
    options = {
        stage: {name: value for name, value in values.items() if name != "seed"}
        for stage, values in method.options.items()
    }
    return content_hash([method.words, json.dumps(options, sort_keys=True)])


def drawn(rows: Sequence[_Stale], count: int, random: np.random.Generator) -> list[_Stale]:
    """Return a random sample of rows: one of each of `count` parts of equal size; all rows if there are not more.

    The parts are successive rows sorted by suite, dataset and section, so that the sample is spread over them. Every
    row has the same probability, and the bound 3/n of a simple random sample holds.
    """
    ordered = sorted(rows, key=lambda stale: stale.position)
    if len(ordered) <= count:
        return ordered
    return [ordered[random.choice(part)] for part in np.array_split(np.arange(len(ordered)), count)]


def _compared(
    chosen: Sequence[_Stale], rows: Sequence[_Stale], run: Run, seed: int, measured_by: str, say: OnProgress
) -> Confirmation:
    """Compute the rows of a sample again up to the first that differs, and return the outcome."""
    label = min((stale.row.row.partition(" @ ")[0] for stale in rows), key=len)
    # Equal frames of two datasets have one key.
    waiting = {(s.row.suite, s.row.dataset, s.row.row, s.task.cell.planned.key): s for s in chosen}
    cells = [stale.task.cell for stale in waiting.values()]
    difference, computed = "", 0
    with closing(calibrated(cells, run, FeatureCache.of_user())) as finished:
        for stored in finished:
            computed += 1
            stale = waiting[stored.study, stored.dataset, stored.row, stored.key]
            row = row_of(stale.task, stored, source_version(), measured_by)
            say(Progress("calibrate", computed, len(cells), name=f"{label}, {row.place}, seed {row.seed}"))
            if difference := difference_of(stale.row, row):
                difference = f"{row.suite}, {row.row}, {row.place}, {row.protocol}, seed {row.seed}: {difference}"
                break
    return Confirmation(label, min(stale.row.digest for stale in rows), computed, len(rows), seed, difference)


def difference_of(before: Row, after: Row) -> str:
    """Return how the outcome of a calibration differs from that of its row; empty if it is the same."""
    parts = []
    if after.status is not before.status:
        parts.append(f"status {after.status.value} instead of {before.status.value}")
    if after.verdict is not before.verdict:
        parts.append(f"verdict {_word(after.verdict)} instead of {_word(before.verdict)}")
    if before.estimate is not None and after.estimate is not None:
        step = pose_error(after.estimate, before.estimate)
        if radians(step.rotation_deg) > SAME_RAD or step.translation_m > SAME_M:
            parts.append(f"pose changed by {radians(step.rotation_deg):.2g} rad and {step.translation_m:.2g} m")
    old = {} if before.predicted is None else before.predicted.model_dump()
    new = {} if after.predicted is None else after.predicted.model_dump()
    for name in sorted({*old, *new}):
        known = name in old and name in new
        if not known or not isclose(old[name], new[name], rel_tol=SAME_PREDICTED):
            parts.append(f"predicted {name} {new.get(name)} instead of {old.get(name)}")
    if parts and before.machine.processor != after.machine.processor:
        parts.append(f"the row is of another processor ({before.machine.processor})")
    return ", ".join(parts)


def _word(verdict: object) -> str:
    return "none" if verdict is None else str(verdict)


def _equivalence(confirmation: Confirmation, rows: Sequence[_Stale], measured_by: str) -> Equivalence:
    return Equivalence(
        label=confirmation.label,
        digests={stale.row.digest: stale.task.cell.method.digest for stale in rows},
        places=tuple(sorted({(stale.row.suite, stale.row.dataset) for stale in rows})),
        confirmed=confirmation.computed,
        of=confirmation.of,
        seed=confirmation.seed,
        commit=source_version(),
        versions={name: text for stale in rows for name, text in stale.task.cell.method.versions.items()},
        machine=Machine.model_validate(machine_info()),
        measured_by=measured_by,
        finished=now(),
    )
