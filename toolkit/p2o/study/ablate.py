"""Runs a study: plans every row, computes those that are not there yet, and keeps each as soon as it is finished.

Started again after anything, it computes only what is missing. `p2o ablate` and Python both come through `ablate`.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from p2o.errors import InputError
from p2o.study import worker
from p2o.study.cells import Cell, Cells, FeatureKeys, Opened, opened
from p2o.study.store import Planned, Store, StoredRow, StoredStudy
from p2o.study.study import LARGEST_SEED, MOST_ROWS, MOST_SEEDS, StudyFile, StudyRow, check_study
from p2o.study.worker import Calibration, Extraction, Facts, Plugins, Reading, Source
from p2o.work.cache import FeatureCache
from p2o.work.parallel import Run, Workers

Phase = Literal["read", "extract", "calibrate"]
MOST_CALIBRATIONS = 100_000
"""So many are computed without being asked twice: a nought too many in a file of a few lines is weeks of work."""


@dataclass(frozen=True)
class Progress:
    """How far a study is: `done` of `total` in a phase, `failed` rows that raised so far, `name` of the last one.

    `kept` of the done rows were there before. `seconds_left` is None until it can be told.
    """

    phase: Phase
    done: int
    total: int
    kept: int = 0
    failed: int = 0
    name: str = ""
    seconds_left: float | None = None


OnProgress = Callable[[Progress], None]
OnWarning = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Ablation:
    """What a study came to: `rows` finished, `missing` planned but not computed; `computed` were computed just now.

    Of more than MOST_CALIBRATIONS, rows are not held: they are read from the store whenever they are looked at.
    """

    study: StudyFile
    rows: Sequence[StoredRow]
    missing: Sequence[Planned]
    computed: int
    interrupted: bool = False


def ablate(
    study: StudyFile,
    folder: str | Path,
    *,
    plugins: Plugins | None = None,
    workers: Workers | None = None,
    cache: FeatureCache | None = None,
    overrides: Mapping[str, Any] | None = None,
    at_most: int | None = None,
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Ablation:
    """Run a study and return what it came to; the rows are in the store of `folder`, this time's and earlier ones.

    `plugins` are those of this process by default, `workers` one job in this process, `cache` the user's cache of
    features. `overrides` are noted in the store as the words that differ from the study's file. `at_most` says how many
    calibrations are meant, where they are more than MOST_CALIBRATIONS. Ctrl-C ends it with
    `interrupted`; every finished row is kept. `on_warning` (default: `warnings.warn`) is told which datasets are left
    out, as nothing says where they are, and once that a cache cannot be written, which costs time alone.

    Raises a P2OError before any work for whatever is wrong with the study, its data or the plugins, and later where
    the store cannot be written any more. A row that raises is a row with status stage-failed; it is tried again the
    next time.
    """
    plugins = Plugins.of() if plugins is None else plugins
    workers = Workers() if workers is None else workers
    cache = FeatureCache.of_user() if cache is None else cache
    say = on_progress or (lambda progress: None)
    warn = _Once(on_warning or _warn)
    rows = check_study(study.study, plugins.registry(), MOST_ROWS if at_most is None else max(at_most, MOST_ROWS))
    if absent := [table.name for table in study.study.dataset if table.left_out]:
        (on_warning or _warn)(
            f"left out, as nothing says where they are: {', '.join(absent)} (--root DIR or --data NAME=DATASET:PATH)"
        )
    its = opened(rows, plugins, MOST_CALIBRATIONS if at_most is None else at_most)
    name = study.study.name
    with Store.open(folder) as store, _turn(store.path.parent) as forward, workers.hired() as run:
        pace = _Pace(say)
        interrupted = False
        try:
            # Where rows are there already, what is missing may need no features.
            facts = _read(run, its, cache, say, warn, extract=not store.count(name))
            cells = Cells(its, facts)
            begun = store.begin(_noted(study, rows, overrides), (cell.planned for cell in cells))
            pending = begun.pending if forward else begun.pending[::-1]
            _compute(run, store, cells, pending, begun.kept, cache, pace, warn)
        except KeyboardInterrupt:
            interrupted = True
        finished, missing = store.all_rows(name), store.all_missing(name)
        if len(finished) + len(missing) <= MOST_CALIBRATIONS:
            finished, missing = tuple(finished), tuple(missing)
        return Ablation(study, finished, missing, pace.computed, interrupted)


class _Once:
    """Says why features could not be kept, the first time."""

    def __init__(self, warn: OnWarning) -> None:
        self._warn: OnWarning | None = warn

    def __call__(self, unkept: str) -> None:
        if unkept and self._warn is not None:
            self._warn(f"{unkept}; until then features are extracted wherever they are needed")
            self._warn = None


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=2)


def _noted(study: StudyFile, rows: Sequence[StudyRow], overrides: Mapping[str, Any] | None) -> StoredStudy:
    # What stands beside rows that are left out has no place in a table.
    shown = {label for row in rows for label in (row.label, row.label.rpartition(" @ ")[0])}
    tables = [table for table in study.study.published if table.beside is None or table.beside in shown]
    published = [table.model_dump(mode="json", exclude_none=True) for table in tables]
    return StoredStudy(study.study.name, study.text, dict(overrides or {}), tuple(published))


def _read(
    run: Run, rows: Sequence[Opened], cache: FeatureCache, say: OnProgress, warn: _Once, *, extract: bool
) -> dict[Source, Facts]:
    """Return what planning has to know about every frame, each read once; `extract` its features at once, too.

    Raises InputError where the first frame of a row lacks what the row needs.
    """
    checks: dict[Source, set[str]] = {}
    firsts: dict[Source, list[Opened]] = {}
    extractors: dict[Source, dict[str, tuple[str, str]]] = {}
    for entry in rows:
        firsts.setdefault(entry.sources[0], []).append(entry)
        own: dict[str, tuple[str, str]] = {}
        for seed in entry.row.seeds if extract else ():
            own.update(entry.method(seed).extractors)
        for source in entry.sources:
            checks.setdefault(source, set()).add(entry.first.recipe)
            extractors.setdefault(source, {}).update(own)
    jobs = [
        Reading(source, cache.root, tuple(sorted(checks[source])), tuple(wanted.values()))
        # Those that may refuse the study come first.
        for source, wanted in sorted(extractors.items(), key=lambda item: item[0] not in firsts)
    ]
    facts: dict[Source, Facts] = {}
    with contextlib.closing(run(worker.read, jobs, worker.unread)) as finished:
        for fact in finished:
            for entry in firsts.get(fact.source, ()):
                if entry.first.recipe in fact.misfits:
                    where = f"{entry.row.where}, row '{entry.row.label}'"
                    raise InputError(fact.misfits[entry.first.recipe], where=where)
            facts[fact.source] = fact
            warn(fact.unkept)
            say(Progress("read", len(facts), len(jobs), name=fact.name))
    return facts


def _compute(
    run: Run,
    store: Store,
    cells: Cells,
    pending: Sequence[int],
    kept: int,
    cache: FeatureCache,
    pace: _Pace,
    warn: _Once,
) -> None:
    """Compute the cells at these positions, and keep each row as soon as it is there; so many are `kept`."""
    pace.begin(kept=kept, total=kept + len(pending))
    if not pending:
        return
    tried: set[int] = set()
    for entry, _, seed in map(cells.place, pending):
        if id(entry) not in tried:
            tried.add(id(entry))
            for stage, part in entry.method(seed).plan.parts.items():
                if stage != "data":
                    worker.built(part)  # a package that is missing is told before any work
    keys = FeatureKeys()
    failures = _extracted(run, cells, pending, keys, cache, pace.say, warn)
    refused: list[StoredRow] = []

    def jobs() -> Iterator[Calibration]:
        for position in pending:
            cell: Cell = cells[position]
            failure = cell.group.failure
            own: tuple[Mapping[str, str], ...] = ()
            if failure is None:
                own = tuple(keys.of(cell.method, fact) for fact in cell.group.facts)
                failure = _failed_features(own, failures)
            if failure is not None:
                refused.append(replace(cell.stored, reason=failure[0], exception=failure[1], finished=worker.now()))
            # Another process that works on the same study may have been faster.
            elif not store.finished([cell.planned.key]):
                yield Calibration(cell.stored, cell.method.recipe, cell.group.facts, cache.root, own)

    pace.begin(kept=kept, total=kept + len(pending))
    with contextlib.closing(run(worker.calibrate, jobs(), worker.uncalibrated)) as rows:
        for row in _with_refused(rows, refused):
            store.put(row)
            pace.one(row)
    pace.finish()


def _with_refused(rows: Iterable[StoredRow], refused: list[StoredRow]) -> Iterator[StoredRow]:
    """Yield the rows of workers, and between them those that were refused without work."""
    for row in rows:
        yield row
        while refused:
            yield refused.pop(0)
    yield from refused


def _extracted(
    run: Run,
    cells: Cells,
    pending: Sequence[int],
    keys: FeatureKeys,
    cache: FeatureCache,
    say: OnProgress,
    warn: _Once,
) -> dict[str, tuple[str, str]]:
    """Extract the features that are not kept yet, once each; return reason and traceback of those that failed."""
    wanted: dict[Source, dict[str, tuple[str, str, str]]] = {}
    looked: set[str] = set()
    for entry, group, seed in map(cells.place, pending):
        if group.failure is not None:
            continue
        method = entry.method(seed)
        for fact in group.facts:
            for stage, key in keys.of(method, fact).items():
                if key in looked:
                    continue
                looked.add(key)
                if not cache.has(key):
                    wanted.setdefault(fact.source, {})[key] = (key, method.recipe, stage)
    jobs = [Extraction(source, cache.root, tuple(tasks.values())) for source, tasks in wanted.items()]
    failures: dict[str, tuple[str, str]] = {}
    with contextlib.closing(run(worker.extract, jobs, worker.unextracted)) as finished:
        for done, found in enumerate(finished, start=1):
            failures |= found.failed
            warn(found.unkept)
            say(Progress("extract", done, len(jobs)))
    return failures


def _failed_features(
    keys: Sequence[Mapping[str, str]], failures: Mapping[str, tuple[str, str]]
) -> tuple[str, str] | None:
    return next((failures[key] for stages in keys for key in stages.values() if key in failures), None)


@dataclass
class _Pace:
    """Counts rows and tells how long the rest will take."""

    say: OnProgress
    total: int = 0
    kept: int = 0
    computed: int = 0
    failed: int = 0
    name: str = ""
    began: float = 0.0

    def begin(self, kept: int, total: int) -> None:
        self.kept, self.total, self.began = kept, total, time.monotonic()
        self.tell()

    def one(self, row: StoredRow) -> None:
        self.computed += 1
        self.failed += row.crashed
        self.name = f"{row.row}, {row.place}, seed {row.seed}"
        self.tell()

    def tell(self) -> None:
        left = self.total - self.kept - self.computed
        rate = (time.monotonic() - self.began) / self.computed if self.computed else None
        seconds = None if rate is None else rate * left
        self.say(Progress("calibrate", self.total - left, self.total, self.kept, self.failed, self.name, seconds))

    def finish(self) -> None:
        """Count what another process computed meanwhile."""
        if self.kept + self.computed < self.total:
            self.kept = self.total - self.computed
            self.tell()


@contextlib.contextmanager
def _turn(folder: Path) -> Iterator[bool]:
    """Yield True for the first process on a folder, False for others: they begin at the other end and meet it."""
    try:
        import fcntl
    except ImportError:  # Windows: both begin at the front, and the slower one's rows are replaced by equal ones
        yield True
        return
    # The lock goes with the process, however it ends.
    try:
        handle = os.open(folder / ".running", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError:  # something else of that name: nobody is told from the other
        yield True
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            first = True
        except BlockingIOError:
            first = False
        except OSError:  # a file system without locks
            first = True
        yield first
    finally:
        os.close(handle)


def chosen_seeds(text: str) -> int | tuple[int, ...]:
    """Return the seeds that a text states: a number of them, or a list such as 3,5,8.

    Raises InputError for anything else.
    """
    words = [word.strip() for word in text.split(",")]
    # Ten digits hold every seed, and Python takes thousands of them ill.
    if not all(re.fullmatch("[0-9]{1,10}", word) for word in words):
        raise InputError("cannot read the seeds", where="--seeds", expected="a number such as 10, or 3,5,8", got=text)
    numbers = tuple(map(int, words))
    if len(numbers) == 1 and not 1 <= numbers[0] <= MOST_SEEDS:
        raise InputError("wrong number of seeds", where="--seeds", expected=f"1 to {MOST_SEEDS}", got=text)
    if len(numbers) > MOST_SEEDS or max(numbers) > LARGEST_SEED:
        expected = f"at most {MOST_SEEDS} of 0 to {LARGEST_SEED}"
        raise InputError("too many seeds, or too large ones", where="--seeds", expected=expected)
    return numbers[0] if len(numbers) == 1 else numbers
