"""Which rows of a suite are missing or stale: its method, data or initial guesses changed since they were measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from p2o_study.ablate import ReadOptions, read_cells
from p2o_study.benchmark.outcomes import CRASHED, Outcomes
from p2o_study.benchmark.plan import State, Task, state_of
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import place_of
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.cells import Method
from p2o_study.worker import Plugins


@dataclass(frozen=True, slots=True)
class Entry:
    """One calibration of a suite and the state of its row."""

    dataset: str
    row: str
    place: str
    protocol: str
    seed: int
    state: State


@dataclass(frozen=True)
class SuiteStatus:
    """The state of every calibration of a suite.

    `unchecked` are datasets without a path: their existing rows are compared by method only, and missing ones are
    unknown. `surplus` is the number of rows that the suite no longer asks for, `unreadable` that of calibrations with a
    frame that cannot be read. `samples` has one number for each fresh row that was measured with an equivalent version
    of its method: how many rows of the method were confirmed (`Equivalence`).
    """

    suite: str
    entries: tuple[Entry, ...]
    unchecked: tuple[str, ...]
    surplus: int
    unreadable: int
    samples: tuple[int, ...] = ()

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
            "confirmed_by_sample": len(self.samples),
            "smallest_sample": min(self.samples, default=None),
            "outdated": [asdict(entry) for entry in self.outdated],
            "unchecked_datasets": list(self.unchecked),
            "surplus_rows": self.surplus,
            "unreadable": self.unreadable,
        }


def status_of(suite: SuiteFile, results: Results, options: ReadOptions) -> SuiteStatus:
    """Return the status of a suite; frames of datasets with a path are read, nothing is computed."""
    outcomes, equivalences = Outcomes.read(results, suite.name), results.equivalences
    unchecked = {table.name for table in suite.study.study.dataset if table.left_out}
    entries: list[Entry] = []
    samples: list[int] = []
    sample: int | None
    left = outcomes.latest.copy()
    unreadable = 0
    tasks: dict[tuple[str, ...], Task] = {}
    if len(unchecked) < len(suite.study.study.dataset):
        for cell in read_cells(suite.study, options):
            task = Task.of(suite.name, cell)
            if task is None:
                unreadable += 1
                continue
            known = outcomes.find(task.identity)
            left[known.start : known.stop] = False
            tasks.setdefault(task.identity_for(""), task)
            rows = outcomes.measured(task.identity)
            state = state_of(task, rows, equivalences)
            entries.append(_entry(task, task.cell.planned.row, state))
            if state is State.FRESH:
                fresh = [row for row in rows if task.state_of(row, equivalences) is state]
                sample = min(task.sample_of(row, equivalences) or 0 for row in fresh)
                samples += [sample] if sample else []
    digests = method_digests(suite, options.plugins) if unchecked else {}
    places = [place_of(list(names)) for names in outcomes.places]
    surplus = 0
    for number in np.flatnonzero(left).tolist():
        run = outcomes.runs[number]
        dataset, label, protocol = outcomes.datasets[run["dataset"]], outcomes.rows[run["row"]], run["protocol"]
        seed, (method, digest) = int(run["seed"]), outcomes.methods[run["method"]]
        names = outcomes.places[run["place"]]
        same = tasks.get((suite.name, dataset, "", outcomes.protocols[protocol], f"{seed:010d}", *names))
        if method.external and same is not None:
            entries.append(_entry(same, label, same.state_of(outcomes.row(number))))
        elif dataset in unchecked and (method.external or label in digests):
            sample = 0
            if not method.external:
                sample = equivalences.sample(digest, digests[label].get(seed, ""), suite.name, dataset)
            state = State.CRASHED if run["status"] == CRASHED else State.METHOD if sample is None else State.FRESH
            samples += [sample] if sample and state is State.FRESH else []
            place = places[run["place"]]
            entries.append(Entry(dataset, label, place, outcomes.protocols[protocol], seed, state))
        else:
            surplus += 1
    return SuiteStatus(suite.name, tuple(entries), tuple(sorted(unchecked)), surplus, unreadable, tuple(samples))


def _entry(task: Task, label: str, state: State) -> Entry:
    planned = task.cell.planned
    return Entry(planned.dataset, label, place_of(list(task.names)), task.protocol, task.cell.seed, state)


def method_digests(suite: SuiteFile, plugins: Plugins) -> Mapping[str, Mapping[int, str]]:
    """Return the digest of the methods of each row and seed; no data are needed."""
    registry = plugins.registry()
    return {
        row.label: {seed: Method.of(row, seed, "{}", {}, registry).digest for seed in row.seeds} for row in suite.rows
    }
