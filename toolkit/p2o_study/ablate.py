"""Run a study: plan every calibration, compute the missing ones and store each as soon as it is finished.

A study that is started again computes only what is missing. `p2o ablate` and Python callers both use `ablate`.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
import warnings
from array import array
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from p2o.cache import FeatureCache
from p2o.errors import InputError
from p2o.host.registry import DISTRIBUTION

from p2o_study import frame_records, worker
from p2o_study.cells import Cell, Cells, FeatureKeys, InitialGuess, OpenRow, open_rows
from p2o_study.parallel import Run, Workers
from p2o_study.row import Row
from p2o_study.rows import PlanRow, Rows, StoredStudy, plan_of
from p2o_study.study import BY_RIG, LARGEST_SEED, MAX_ROWS, MAX_SEEDS, Study, StudyFile, StudyRow, check_study
from p2o_study.worker import CalibrateJob, ExtractJob, FrameRecord, Plugins, ReadJob, Source

Phase = Literal["read", "extract", "calibrate"]
MAX_CALIBRATIONS = 100_000
"""Maximum number of calibrations without confirmation (--at-most): one zero too many is weeks of computing time."""


@dataclass(frozen=True)
class Progress:
    """The progress of a study: `done` of `total` jobs of a phase, `failed` rows that raised, `name` of the last job.

    `kept` of the done rows were in the store before. `seconds_left` is None until it can be estimated.
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


def _silent(progress: Progress) -> None:
    """Show no progress."""


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=2)


@dataclass(frozen=True, eq=False)
class Ablation:
    """The outcome of a study: `rows` finished, `missing` planned but not computed, `computed` in this call.

    More than MAX_CALIBRATIONS rows have no rounds, to save memory.
    """

    study: StudyFile
    rows: Sequence[Row]
    missing: Sequence[PlanRow]
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
    initial_guess: InitialGuess | None = None,
    seeds_first: bool = False,
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Ablation:
    """Run a study and return its outcome; the rows are written to the store in `folder`.

    `plugins` are those of this process by default, `workers` one job in this process (with `isolate` None in a worker
    if the study uses plugins of other distributions), `cache` the user's cache of
    features. `overrides` are recorded in the store as the differences from the study file. `at_most` confirms a number
    of calibrations above MAX_CALIBRATIONS. `initial_guess` replaces the initial guesses of the rows. With `seeds_first`
    all rows are computed with one seed before the next, so that an interrupted study has all rows. Ctrl-C ends the
    study with `interrupted`; finished rows are kept.
    `on_warning` (default: `warnings.warn`) receives the datasets that are left out because they have no path, and one
    message if the cache cannot be written, which costs time only.

    Raises a P2OError before any work if the study, its data or the plugins are invalid, and later if the store cannot
    be written. A calibration that raises is a row with status stage-failed; it is repeated the next time.
    """
    begun = study.study.name in (stored := Rows(folder)).studies
    stored.make_folder()
    with (
        open_session(study.study, plugins, workers, cache, at_most, on_progress, on_warning) as session,
        _first_process_lock(stored.folder) as forward,
    ):
        interrupted = False
        try:
            # If rows exist already, the missing ones may need no features: extract only on demand.
            cells = session.cells(extract=not begun, initial_guess=initial_guess)
            plan = plan_of(cell.planned for cell in cells)
            stored.begin(_stored_study(study, session.rows, overrides, plan))
            pending = _pending([key for row in plan for key in row.keys], stored)
            kept = len({key for row in plan for key in row.keys}) - len(pending)
            if seeds_first:
                pending = array("q", sorted(pending, key=lambda position: cells.place(position)[2]))
            session.compute(cells, pending if forward else pending[::-1], stored, study.study.name, kept=kept)
        except KeyboardInterrupt:
            interrupted = True
        return _outcome(study, stored, session.computed, interrupted)


def _pending(keys: Sequence[str], stored: Rows) -> array[int]:
    """Return the positions of the keys that are not finished; two rows of the table may be the same calibration."""
    stored.refresh()
    first = {key: position for position, key in reversed(list(enumerate(keys)))}
    return array("q", sorted(position for key, position in first.items() if not stored.finished(key)))


def _outcome(study: StudyFile, stored: Rows, computed: int, interrupted: bool) -> Ablation:
    name = study.study.name
    if name not in stored.studies:  # interrupted before its plan was written
        return Ablation(study, (), (), 0, interrupted)
    count = sum(len(row.keys) for row in stored.study(name).plan)
    rows = stored.planned(name, rounds=count <= MAX_CALIBRATIONS)
    return Ablation(study, rows, stored.missing(name), computed, interrupted)


@contextlib.contextmanager
def open_session(
    study: Study,
    plugins: Plugins | None = None,
    workers: Workers | None = None,
    cache: FeatureCache | None = None,
    at_most: int | None = None,
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Iterator[Session]:
    """Yield a session that reads the frames of a study and computes its calibrations; the words are those of `ablate`.

    Raises a P2OError if the study, its data or the plugins are invalid.
    """
    plugins, warn_user = Plugins.of() if plugins is None else plugins, on_warning or _warn
    rows = check_study(study, plugins.registry(), MAX_ROWS if at_most is None else max(at_most, MAX_ROWS))
    if absent := [table.name for table in study.dataset if table.left_out]:
        warn_user(f"datasets without a path are left out: {', '.join(absent)} (--root DIR or --data NAME=DATASET:PATH)")
    opened = open_rows(rows, plugins, MAX_CALIBRATIONS if at_most is None else at_most)
    cache = FeatureCache.of_user() if cache is None else cache
    with _isolated(Workers() if workers is None else workers, opened).start() as run:
        yield Session(rows, opened, run, cache, on_progress or _silent, _Once(warn_user))


@dataclass(eq=False)
class Session:
    """The open rows of a study and the workers that compute them; `computed` counts finished calibrations."""

    rows: Sequence[StudyRow]
    opened: Sequence[OpenRow]
    run: Run
    cache: FeatureCache
    say: OnProgress
    warn: _Once
    computed: int = 0

    def cells(self, *, extract: bool = False, initial_guess: InitialGuess | None = None) -> Cells:
        """Read every frame once and return all calibrations; with `extract` features of all rows are cached."""
        return Cells(self.opened, _read(self, self.opened, extract=extract), initial_guess)

    def compute(
        self,
        cells: Cells,
        pending: Sequence[int],
        stored: Rows,
        study: str,
        *,
        kept: int = 0,
        as_stored: Callable[[Row], Row] = lambda row: row,
    ) -> None:
        """Compute the cells at these positions and store each row, as `as_stored` returns it, when it is finished."""
        pace = _RunProgress(self.say)
        try:
            with contextlib.closing(_computed(self, stored, cells, pending, kept, pace)) as rows:
                for row in rows:
                    stored.put(study, as_stored(row))
                    pace.one(row)
        finally:
            self.computed += pace.computed
        pace.finish()


def calibrated(cells: Iterable[Cell], session: Session) -> Generator[Row, None, None]:
    """Yield the row of each calibration as it is finished; no store is read or written, features may be cached.

    The frames of all cells are readable.
    """
    keys = FeatureKeys()
    jobs = (_calibrate_job(cell, _keys_of(cell, keys), session.cache) for cell in cells)
    with contextlib.closing(session.run(worker.compute, jobs, worker.calibration_failed)) as rows:
        yield from rows


def _calibrate_job(cell: Cell, keys: tuple[Mapping[str, str], ...], cache: FeatureCache) -> CalibrateJob:
    job = CalibrateJob(cell.row, cell.method.recipe, cell.group.records, cache.root, keys, cell.method.damage)
    return worker.RigJob(**vars(job), cameras=cell.group.cameras) if cell.group.rig else job


def _keys_of(cell: Cell, keys: FeatureKeys) -> tuple[Mapping[str, str], ...]:
    """Return the cache keys of the features of each frame by stage; none of a rig, which extracts its own."""
    return () if cell.group.rig else tuple(keys.of(cell.method, record) for record in cell.group.records)


def _isolated(workers: Workers, rows: Sequence[OpenRow]) -> Workers:
    """Return the workers with `isolate` set: True for methods of other distributions, which may crash a process."""
    if workers.isolate is not None:
        return workers
    parts = [part for entry in rows for part in entry.first.plan.parts.values()]
    return replace(workers, isolate=any(part.offer.dist != DISTRIBUTION for part in parts))


class _Once:
    """Pass on the first error of the feature cache only."""

    def __init__(self, warn: OnWarning) -> None:
        self._warn: OnWarning | None = warn

    def __call__(self, cache_error: str) -> None:
        if cache_error and self._warn is not None:
            self._warn(f"{cache_error}; features are extracted for each calibration until this is resolved")
            self._warn = None


def _stored_study(
    study: StudyFile, rows: Sequence[StudyRow], overrides: Mapping[str, Any] | None, plan: tuple[PlanRow, ...]
) -> StoredStudy:
    # Published rows whose row is left out are not part of the table.
    shown = {label for row in rows for label in (row.label, row.label.rpartition(" @ ")[0])}
    tables = [table for table in study.study.published if table.beside is None or table.beside in shown]
    published = [table.model_dump(mode="json", exclude_none=True) for table in tables]
    return StoredStudy(study.study.name, study.text, dict(overrides or {}), tuple(published), plan)


def _read(work: Session, rows: Sequence[OpenRow], *, extract: bool) -> dict[Source, FrameRecord]:
    """Read every frame once and return its record; with `extract` also extract the features of all rows.

    Raises InputError if the first frame of a row lacks an input of the row's methods.
    """
    checks: dict[Source, set[str]] = {}
    firsts: dict[Source, list[OpenRow]] = {}
    extractors: dict[Source, dict[str, tuple[str, str]]] = {}
    for entry in rows:
        firsts.setdefault(entry.sources[0], []).append(entry)
        own: dict[str, tuple[str, str]] = {}
        for seed in entry.row.seeds if extract and entry.row.joint != BY_RIG else ():
            own.update(entry.method(seed).extractors)
        for source in entry.sources:
            checks.setdefault(source, set()).add(entry.first.recipe)
            extractors.setdefault(source, {}).update(own)
    jobs = [
        ReadJob(source, work.cache.root, tuple(sorted(checks[source])), tuple(wanted.values()))
        # The first frames of rows come first, because they may refuse the study.
        for source, wanted in sorted(extractors.items(), key=lambda item: item[0] not in firsts)
    ]
    records: dict[Source, FrameRecord] = {}
    with contextlib.closing(work.run(frame_records.read, jobs, worker.read_failed)) as finished:
        for record in finished:
            for entry in firsts.get(record.source, ()):
                if entry.first.recipe in record.missing_inputs:
                    where = f"{entry.row.where}, row '{entry.row.label}'"
                    raise InputError(record.missing_inputs[entry.first.recipe], where=where)
            records[record.source] = record
            work.warn(record.cache_error)
            work.say(Progress("read", len(records), len(jobs), name=record.name))
    return records


def _computed(
    work: Session, stored: Rows, cells: Cells, pending: Sequence[int], kept: int, pace: _RunProgress
) -> Generator[Row, None, None]:
    """Yield the row of each cell at these positions when it is finished; `kept` rows exist already."""
    pace.begin(kept=kept, total=kept + len(pending))
    if not pending:
        return
    tried: set[int] = set()
    for entry, _, seed in map(cells.place, pending):
        if id(entry) not in tried:
            tried.add(id(entry))
            for stage, part in entry.method(seed).plan.parts.items():
                if stage != "data":
                    worker.built(part)  # reports a missing package before any work
    keys = FeatureKeys()
    failures = _extracted(work, cells, pending, keys)
    refused: list[Row] = []

    def jobs() -> Iterator[CalibrateJob]:
        for position in pending:
            cell: Cell = cells[position]
            failure = cell.group.failure
            own: tuple[Mapping[str, str], ...] = ()
            if failure is None:
                own = _keys_of(cell, keys)
                failure = next((failures[key] for stages in own for key in stages.values() if key in failures), None)
            if failure is not None:
                refused.append(replace(cell.row, reason=failure[0], exception=failure[1], finished=worker.now()))
                continue
            stored.refresh()
            # Another process may have finished this cell in the meantime.
            if not stored.finished(cell.planned.key):
                yield _calibrate_job(cell, own, work.cache)

    pace.begin(kept=kept, total=kept + len(pending))
    with contextlib.closing(work.run(worker.compute, jobs(), worker.calibration_failed)) as rows:
        yield from _with_refused(rows, refused)


def _with_refused(rows: Iterable[Row], refused: list[Row]) -> Iterator[Row]:
    """Yield the rows of workers, interleaved with rows that were refused without a job."""
    for row in rows:
        yield row
        while refused:
            yield refused.pop(0)
    yield from refused


def _extracted(work: Session, cells: Cells, pending: Sequence[int], keys: FeatureKeys) -> dict[str, tuple[str, str]]:
    """Extract the features that are not cached, once each; return reason and traceback of failures by key."""
    wanted: dict[Source, dict[str, tuple[str, str, str]]] = {}
    looked: set[str] = set()
    for entry, group, seed in map(cells.place, pending):
        if group.failure is not None or group.rig:
            continue
        method = entry.method(seed)
        for record in group.records:
            for stage, key in keys.of(method, record).items():
                if key in looked:
                    continue
                looked.add(key)
                if not work.cache.has(key):
                    wanted.setdefault(record.source, {})[key] = (key, method.recipe, stage)
    jobs = [ExtractJob(source, work.cache.root, tuple(tasks.values())) for source, tasks in wanted.items()]
    failures: dict[str, tuple[str, str]] = {}
    with contextlib.closing(work.run(worker.extract, jobs, worker.extraction_failed)) as finished:
        for done, outcome in enumerate(finished, start=1):
            failures |= outcome.failed
            work.warn(outcome.cache_error)
            work.say(Progress("extract", done, len(jobs)))
    return failures


@dataclass
class _RunProgress:
    """Counts finished rows and estimates the remaining time."""

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

    def one(self, row: Row) -> None:
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
        """Count the rows that another process computed in the meantime."""
        if self.kept + self.computed < self.total:
            self.kept = self.total - self.computed
            self.tell()


@contextlib.contextmanager
def _first_process_lock(folder: Path) -> Iterator[bool]:
    """Yield True for the first process on a folder, False for others, which compute the cells in reverse order."""
    try:
        import fcntl
    except ImportError:  # Windows: both processes compute in the same order; rows of one replace equal ones
        yield True
        return
    # The operating system releases the lock when the process ends.
    try:
        handle = os.open(folder / ".running", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError:  # the name is taken by something that is no file: processes cannot be distinguished
        yield True
        return
    first = True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        first = False
    except OSError:  # a file system without locks
        pass
    try:
        yield first
    finally:
        os.close(handle)


def parse_seeds(text: str) -> int | tuple[int, ...]:
    """Parse --seeds: a number of seeds, or a list such as 3,5,8; raises InputError for any other text."""
    words = [word.strip() for word in text.split(",")]
    # Ten digits represent every seed; Python raises ValueError for thousands of digits.
    if not all(re.fullmatch("[0-9]{1,10}", word) for word in words):
        raise InputError("cannot read the seeds", where="--seeds", expected="a number such as 10, or 3,5,8", got=text)
    numbers = tuple(map(int, words))
    if len(numbers) == 1 and not 1 <= numbers[0] <= MAX_SEEDS:
        raise InputError("wrong number of seeds", where="--seeds", expected=f"1 to {MAX_SEEDS}", got=text)
    if len(numbers) > MAX_SEEDS or max(numbers) > LARGEST_SEED:
        expected = f"at most {MAX_SEEDS} of 0 to {LARGEST_SEED}"
        raise InputError("too many seeds, or a seed is too large", where="--seeds", expected=expected)
    return numbers[0] if len(numbers) == 1 else numbers
