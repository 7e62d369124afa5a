"""Run a study: plan every calibration, compute the missing ones and store each as soon as it is finished.

A study that is started again computes only what is missing. `p2o ablate` and Python callers both use `ablate`.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from p2o.cache import FeatureCache
from p2o.errors import InputError, P2OError
from p2o.host.registry import DISTRIBUTION

from p2o_study import worker
from p2o_study.cells import Cell, Cells, FeatureKeys, InitialGuess, OpenRow, open_rows
from p2o_study.parallel import Run, Workers
from p2o_study.row import Row
from p2o_study.rows import PlanRow, Rows, StoredStudy, plan_of
from p2o_study.study import LARGEST_SEED, MAX_ROWS, MAX_SEEDS, Study, StudyRow, check_study, with_place
from p2o_study.worker import CalibrateJob, FrameRecord, Plugins, Source

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


@dataclass(frozen=True, eq=False)
class Ablation:
    """The outcome of a study: `rows` finished, `missing` planned but not computed, `computed` in this call.

    More than MAX_CALIBRATIONS rows have no rounds, to save memory.
    """

    rows: Sequence[Row]
    missing: Sequence[PlanRow]
    computed: int
    interrupted: bool = False


def ablate(
    study: Study,
    folder: str | Path,
    *,
    initial_guess: InitialGuess | None = None,
    seeds_first: bool = False,
    **words: Any,
) -> Ablation:
    """Run a study and return its outcome; the rows are written to the store in `folder`.

    `initial_guess` replaces the initial guesses of the rows. With `seeds_first` all rows are computed with one seed
    before the next, so that an interrupted study has all rows. The other words are those of `open_session`. Ctrl-C ends
    the study with `interrupted`; finished rows are kept.

    Raises a P2OError before any work if the study, its data or the plugins are invalid, and later if the store cannot
    be written. A calibration that raises is a row with status stage-failed; it is repeated the next time.
    """
    stored, name = Rows(folder), study.name
    stored.make_folder()
    with open_session(study, **words) as session, _first_process_lock(stored.folder) as forward:
        interrupted = False
        try:
            cells = session.cells(initial_guess)
            plan = plan_of(cell.row for cell in cells)
            stored.begin(StoredStudy(name, study.model_dump(mode="json", exclude_defaults=True), plan))
            stored.refresh()
            keys = enumerate(key for row in plan for key in row.keys)
            # Two rows of the table may be the same calibration.
            first = {key: position for position, key in reversed(list(keys))}
            pending = sorted(position for key, position in first.items() if not stored.finished(key))
            kept = len(first) - len(pending)
            if seeds_first:
                pending.sort(key=lambda position: cells.place(position)[2])
            session.compute(cells, pending if forward else pending[::-1], stored, name, kept=kept)
        except KeyboardInterrupt:
            interrupted = True
        if name not in stored.studies:  # interrupted before its plan was written
            return Ablation((), (), 0, interrupted)
        count = len(stored.study(name).keys)
        rows = stored.planned(name, rounds=count <= MAX_CALIBRATIONS)
        return Ablation(rows, stored.missing(name), session.computed, interrupted)


@contextlib.contextmanager
def open_session(
    study: Study,
    plugins: Plugins | None = None,
    workers: Workers | None = None,
    cache: FeatureCache | None = None,
    at_most: int | None = None,
    on_progress: OnProgress = lambda progress: None,
    on_warning: OnWarning = partial(warnings.warn, stacklevel=2),
) -> Iterator[Session]:
    """Yield a session that reads the frames of a study and computes its calibrations.

    `plugins` are those of this process by default, `workers` one job in this process (with `isolate` None in a worker
    if the study uses plugins of other distributions), `cache` the user's cache of features. `at_most` confirms a number
    of calibrations above MAX_CALIBRATIONS. `on_warning` receives the datasets that are left out because they have no
    path, and one message if the cache cannot be written, which costs time only.

    Raises a P2OError if the study, its data or the plugins are invalid.
    """
    plugins, workers = Plugins.of() if plugins is None else plugins, Workers() if workers is None else workers
    rows = check_study(study, plugins.registry(), MAX_ROWS if at_most is None else max(at_most, MAX_ROWS))
    if absent := [table.name for table in study.dataset if table.left_out]:
        text = f"datasets without a path are left out: {', '.join(absent)} (--root DIR or --data NAME=DATASET:PATH)"
        on_warning(text)
    opened = open_rows(rows, plugins, MAX_CALIBRATIONS if at_most is None else at_most)
    if workers.isolate is None:  # methods of other distributions may crash a process
        parts = [part for entry in opened for part in entry.first.plan.parts.values()]
        workers = replace(workers, isolate=any(part.offer.dist != DISTRIBUTION for part in parts))
    with workers.start() as run:
        yield Session(rows, opened, run, FeatureCache.of_user() if cache is None else cache, on_progress, on_warning)


@dataclass(eq=False)
class Session:
    """The open rows of a study and the workers that compute them; `computed` counts finished calibrations."""

    rows: Sequence[StudyRow]
    opened: Sequence[OpenRow]
    run: Run
    cache: FeatureCache
    say: OnProgress
    on_warning: OnWarning
    computed: int = 0
    _has_warned: bool = False

    def cells(self, initial_guess: InitialGuess | None = None) -> Cells:
        """Read every frame once and return all calibrations.

        Raises InputError if the first frame of a row lacks an input of the row's methods.
        """
        firsts: dict[Source, list[OpenRow]] = {}
        for entry in self.opened:
            firsts.setdefault(entry.sources[0], []).append(entry)
        # The first frames of rows come first, because they may refuse the study.
        sources = dict.fromkeys([*firsts, *(source for entry in self.opened for source in entry.sources)])
        read = partial(worker.read, cache_folder=self.cache.root)
        records: dict[Source, FrameRecord] = {}
        with contextlib.closing(self.run(read, sources, worker.read_failed)) as finished:
            for record in finished:
                for entry in firsts.get(record.source, ()) if record.failure is None else ():
                    try:
                        entry.first.plan.check_contents(record.name, frozenset(record.contents))
                    except InputError as problem:
                        raise with_place(problem, f"{entry.row.where}, row '{entry.row.label}'") from problem
                records[record.source] = record
                self._warn_once(record.cache_error)
                self.say(Progress("read", len(records), len(sources), name=record.name))
        return Cells(self.opened, records, initial_guess)

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
        total, computed, failed, began = kept + len(pending), 0, 0, time.monotonic()

        def is_pending(key: str) -> bool:
            stored.refresh()  # another process may have finished this cell in the meantime
            return not stored.finished(key)

        self.say(Progress("calibrate", kept, total, kept))
        with contextlib.closing(self.calibrated(cells, pending, is_pending)) as rows:
            for row in rows:
                stored.put(study, as_stored(row))
                computed, failed, self.computed = computed + 1, failed + row.crashed, self.computed + 1
                done = kept + computed
                seconds = (time.monotonic() - began) / computed * (total - done)
                name = f"{row.row}, {row.place}, seed {row.seed}"
                self.say(Progress("calibrate", done, total, kept, failed, name, seconds))
        if kept + computed < total:  # another process computed the others
            self.say(Progress("calibrate", total, total, total - computed, failed))

    def calibrated(
        self, cells: Cells, pending: Sequence[int], is_pending: Callable[[str], bool] = lambda key: True
    ) -> Generator[Row, None, None]:
        """Yield the row of each cell at these positions, as far as `is_pending` of its key, when it is finished."""
        tried: set[int] = set()
        for entry, _, seed in map(cells.place, pending):
            if id(entry) not in tried:
                tried.add(id(entry))
                for stage, part in entry.method(seed).plan.parts.items():
                    try:
                        if stage != "data":
                            worker.built(part)  # reports a missing package before any work
                    except P2OError as problem:
                        raise with_place(problem, f"{entry.row.where}, row '{entry.row.label}'") from problem
        keys = FeatureKeys()
        self._extract(cells, pending, keys)
        for position in pending:
            if (failure := cells.place(position)[1].failure) is not None:
                yield replace(cells[position].row, reason=failure[0], exception=failure[1], finished=worker.now())

        def jobs() -> Iterator[CalibrateJob]:
            for position in pending:
                cell: Cell = cells[position]
                group = cell.group
                if group.failure is None and is_pending(cell.row.key):
                    own = () if group.rig else tuple(keys.of(cell.method, record) for record in group.records)
                    words = (cell.row, cell.method.recipe, group.records, self.cache.root, own, cell.method.damage)
                    yield CalibrateJob(*words, group.cameras if group.rig else {})

        with contextlib.closing(self.run(worker.calibrate, jobs(), worker.calibration_failed)) as rows:
            yield from rows

    def _extract(self, cells: Cells, pending: Sequence[int], keys: FeatureKeys) -> None:
        """Extract the features that are not cached, once each."""
        wanted: dict[Source, dict[str, tuple[str, str, str]]] = {}
        examined: set[str] = set()
        for entry, group, seed in map(cells.place, pending):
            if group.failure is not None or group.rig:
                continue
            method = entry.method(seed)
            for record in group.records:
                for stage, key in keys.of(method, record).items():
                    if key not in examined and not self.cache.has(key):
                        wanted.setdefault(record.source, {})[key] = (key, method.recipe, stage)
                    examined.add(key)
        jobs = [(source, tuple(tasks.values())) for source, tasks in wanted.items()]
        extract = partial(worker.extract, cache_folder=self.cache.root)
        with contextlib.closing(self.run(extract, jobs, lambda job, problem: "")) as finished:
            for done, cache_error in enumerate(finished, start=1):
                self._warn_once(cache_error)
                self.say(Progress("extract", done, len(jobs)))

    def _warn_once(self, cache_error: str) -> None:
        if cache_error and not self._has_warned:
            self._has_warned = True
            self.on_warning(f"{cache_error}; features are extracted for each calibration until this is resolved")


@contextlib.contextmanager
def _first_process_lock(folder: Path) -> Iterator[bool]:
    """Yield True for the first process on a folder, False for others, which compute the cells in reverse order."""
    try:
        import fcntl

        handle = os.open(folder / ".running", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except (ImportError, OSError):  # Windows, or the name is taken: both compute in the same order
        yield True
        return
    first = True
    with os.fdopen(handle):  # the operating system releases the lock when the process ends
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            first = False
        except OSError:  # a file system without locks
            pass
        yield first


def parse_seeds(text: str) -> int | tuple[int, ...]:
    """Parse --seeds: a number of seeds, or a list such as 3,5,8; raises InputError for any other text."""
    words = [word.strip() for word in text.split(",")]
    # Ten digits represent every seed; Python raises ValueError for thousands of digits.
    if not all(re.fullmatch("[0-9]{1,10}", word) for word in words):
        raise InputError("cannot read the seeds", where="--seeds", expected="a number such as 10, or 3,5,8", got=text)
    numbers = tuple(map(int, words))
    count = numbers[0] if len(numbers) == 1 else len(numbers)
    if not 1 <= count <= MAX_SEEDS or max(numbers) > LARGEST_SEED:
        expected = f"1 to {MAX_SEEDS} seeds of 0 to {LARGEST_SEED}"
        raise InputError("wrong number of seeds, or a seed is too large", where="--seeds", expected=expected)
    return count if len(numbers) == 1 else numbers
