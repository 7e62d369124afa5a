"""Which rows of a suite can be removed: those it no longer asks for, and stale ones that were measured again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby

from p2o_study.ablate import ReadOptions, read_cells
from p2o_study.benchmark.equivalences import Equivalences
from p2o_study.benchmark.outcomes import Outcomes
from p2o_study.benchmark.plan import GIVEN, State, Task
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import Row
from p2o_study.benchmark.status import method_digests
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.worker import Plugins

Digests = dict[tuple[str, str, str, int], str]
"""Digest of the method by dataset, label, protocol and seed."""


class Why(StrEnum):
    """Why a row can be removed."""

    NOT_ASKED = "not in the suite"
    MEASURED_AGAIN = "stale, and measured again"


@dataclass(frozen=True)
class Prunable:
    """A row that can be removed, and why."""

    row: Row
    why: Why

    def as_dict(self) -> dict[str, object]:
        """Return the row for JSON, without its poses."""
        names = ("row", "dataset", "place", "protocol", "seed", "finished")
        return {**{name: getattr(self.row, name) for name in names}, "why": self.why.value}


def prunable(suite: SuiteFile, results: Results, options: ReadOptions) -> list[Prunable]:
    """Return the rows of a suite that can be removed, in the order of the file; nothing is computed.

    A row can be removed if the suite has no calibration of its label, protocol, seed and frames, or if it is stale or
    crashed and a later row of the same calibration did not crash. Fresh rows are never among them. Of datasets without
    a path, or with a frame that cannot be read, frames are not compared: their rows can be removed only by the other
    parts.
    """
    outcomes, equivalences = Outcomes.read(results, suite.name), results.equivalences
    if not len(outcomes.runs):
        return []
    incomplete = {table.name for table in suite.study.study.dataset if table.left_out}
    tasks: dict[tuple[str, ...], Task] = {}
    if len(incomplete) < len(suite.study.study.dataset):
        for cell in read_cells(suite.study, options):
            task = Task.of(suite.name, cell)
            if task is None:
                incomplete.add(cell.planned.dataset)
                continue
            tasks[task.identity] = task
            # External methods have labels of their own.
            tasks.setdefault(task.identity_for(""), task)
    digests = _digests(suite, options.plugins)
    removable: list[Prunable] = []
    rows = (outcomes.row(number) for number in range(len(outcomes.runs)))
    for _, of_one in groupby(rows, lambda row: row.identity):
        removable += _of_one(list(of_one), tasks, digests, incomplete, equivalences)
    return removable


def _of_one(
    rows: list[Row],
    tasks: dict[tuple[str, ...], Task],
    digests: Digests,
    incomplete: set[str],
    equivalences: Equivalences,
) -> Iterator[Prunable]:
    """Yield the rows of one calibration, in the order of time, that can be removed."""
    last_good = max((number for number, row in enumerate(rows) if not row.crashed), default=-1)
    for number, row in enumerate(rows):
        suite, dataset, label, *draw_and_names = row.identity
        task = tasks.get((suite, dataset, "" if row.method.external else label, *draw_and_names))
        digest = digests.get((dataset, label, row.protocol, row.seed))
        if task is not None:
            state = task.state_of(row, equivalences)
        elif dataset not in incomplete or (digest is None and not row.method.external):
            yield Prunable(row, Why.NOT_ASKED)
            continue
        else:
            same = digest is None or equivalences.sample(row.digest, digest, suite, dataset) is not None
            state = State.CRASHED if row.crashed else State.FRESH if same else State.METHOD
        if state is not State.FRESH and number < last_good:
            yield Prunable(row, Why.MEASURED_AGAIN)


def _digests(suite: SuiteFile, plugins: Plugins) -> Digests:
    """Return the digest of the method of each row and seed of a suite; no data are needed."""
    by_label = method_digests(suite, plugins)
    return {
        (row.dataset.name, row.label, row.recipe(seed).perturb or GIVEN, seed): by_label[row.label][seed]
        for row in suite.rows
        for seed in row.seeds
    }
