"""Runs a study: plans every row, computes those that are not there yet, and keeps each as soon as it is finished.

Started again after anything, it computes only what is missing. `p2o ablate` and Python both come through `ablate`.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from p2o.arrays import Float
from p2o.errors import InputError, P2OError
from p2o.frames.selection import select
from p2o.geometry.pose_error import pose_error
from p2o.host.guard import GuardedDataset
from p2o.host.registry import Registry
from p2o.run.recipe import Plan, open_dataset
from p2o.run.run import common_pose, listed_errors, start_of
from p2o.run.words import split_data
from p2o.study import worker
from p2o.study.groups import group_size, groups_of
from p2o.study.store import Planned, Store, StoredRow, StoredStudy
from p2o.study.study import LARGEST_SEED, MOST_SEEDS, StudyFile, StudyRow, check_study, retold
from p2o.study.worker import Calibration, Extraction, Facts, Plugins, Reading, Source
from p2o.work.cache import FeatureCache, content_hash, named_files
from p2o.work.parallel import Run, Workers
from p2o.work.sources import code_hash

Phase = Literal["read", "extract", "calibrate"]
_MOST_CALIBRATIONS = 100_000
"""Planning so many takes minutes and some 100 MB; a row in the store is some 5 kB."""
_CORE = ("p2o.calibration.pipeline", "p2o.run.run", "p2o.geometry.pose_error", "p2o.geometry.perturb")
"""Modules that every row goes through, besides those of its methods."""


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
    """What a study came to: `rows` finished, `missing` planned but not computed; `computed` were computed just now."""

    study: StudyFile
    rows: tuple[StoredRow, ...]
    missing: tuple[Planned, ...]
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
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Ablation:
    """Run a study and return what it came to; the rows are in the store of `folder`, this time's and earlier ones.

    `plugins` are those of this process by default, `workers` one job in this process, `cache` the user's cache of
    features. `overrides` are noted in the store as the words that differ from the study's file. Ctrl-C ends it with
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
    rows = check_study(study.study, plugins.registry())
    if absent := [table.name for table in study.study.dataset if table.left_out]:
        (on_warning or _warn)(
            f"left out, as nothing says where they are: {', '.join(absent)} (--root DIR or --data NAME=DATASET:PATH)"
        )
    opened = _opened(rows, plugins)
    with Store.open(folder) as store, _turn(store.path.parent) as forward, workers.hired() as run:
        pace = _Pace(say)
        interrupted = False
        try:
            # Where rows are there already, what is missing may need no features.
            facts = _read(run, opened, cache, say, warn, extract=not store.rows(study.study.name))
            cells = list(_cells(opened, facts))
            store.begin(_noted(study, overrides), [cell.planned for cell in cells])
            _compute(run, store, cells if forward else cells[::-1], cache, pace, warn)
        except KeyboardInterrupt:
            interrupted = True
        name = study.study.name
        return Ablation(study, tuple(store.rows(name)), tuple(store.missing(name)), pace.computed, interrupted)


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


def _noted(study: StudyFile, overrides: Mapping[str, Any] | None) -> StoredStudy:
    # What stands beside rows that are left out has no place in a table.
    shown = {label for row in study.study.rows() for label in (row.label, row.label.rpartition(" @ ")[0])}
    tables = [table for table in study.study.published if table.beside is None or table.beside in shown]
    published = [table.model_dump(mode="json", exclude_none=True) for table in tables]
    return StoredStudy(study.study.name, study.text, dict(overrides or {}), tuple(published))


@dataclass(frozen=True, eq=False)
class _Method:
    """The methods of one row and seed: `recipe` (JSON) for workers, `key` the hash of all that acts on a result."""

    recipe: str
    plan: Plan
    described: Mapping[str, Any]
    versions: Mapping[str, str]
    key: str

    @classmethod
    def of(
        cls, row: StudyRow, seed: int, data_options: str, versions: Mapping[str, str], registry: Registry
    ) -> _Method:
        recipe = row.recipe(seed)
        options = {**recipe.options, "data": json.loads(data_options)}
        if not options["data"]:
            del options["data"]
        recipe = recipe.model_copy(update={"options": options})
        plan = recipe.resolve(registry)
        described = plan.described()
        builds = [part.offer.method.build for stage, part in plan.parts.items() if stage != "data"]
        # Where the frames come from does not act on the result: their content does.
        acting = {
            "methods": {stage: p.offer.full_name for stage, p in sorted(plan.parts.items()) if stage != "data"},
            "options": {stage: values for stage, values in described["options"].items() if stage != "data"},
            "seed": seed,
            "perturb": recipe.perturb,
            "versions": versions,
            "code": code_hash(*builds, *_CORE),
            "files": named_files({k: v for k, v in described["options"].items() if k != "data"}),
        }
        words = recipe.model_dump(mode="json", exclude_unset=True)
        return cls(json.dumps(words, sort_keys=True), plan, described, versions, content_hash(acting))

    @property
    def extractors(self) -> dict[str, tuple[str, str]]:
        """By a name of method and options: recipe and stage that say how to prepare what may be kept."""
        parts = {stage: self.plan.parts[stage] for stage in worker.prepared_stages(self.plan)}
        return {worker.part_name(part): (self.recipe, stage) for stage, part in parts.items()}


@dataclass(frozen=True, eq=False)
class _Opened:
    """One row with its frames and, by seed, its methods; `listed` are errors of starts from a list, by frame."""

    row: StudyRow
    sources: tuple[Source, ...]
    methods: Mapping[int, _Method]
    listed: Mapping[int, Float]

    @property
    def first(self) -> _Method:
        """The methods of the first seed."""
        return next(iter(self.methods.values()))


def _opened(rows: Sequence[StudyRow], plugins: Plugins) -> list[_Opened]:
    """Return each row with its frames, none of which is read yet."""
    registry = plugins.registry()
    datasets: dict[tuple[str, str], GuardedDataset] = {}
    out = []
    count = 0
    for row in rows:
        data, options = row.dataset.data, _data_options(row, registry)
        where = f"{row.where}, dataset '{row.dataset.name}'"
        if (data, options) not in datasets:
            try:
                datasets[data, options] = open_dataset(data, registry, json.loads(options))
            except P2OError as problem:
                raise retold(problem, where, f"say where they are: --data {data.partition(':')[0]}:PATH") from problem
        dataset = datasets[data, options]
        indices = select(dataset.names, row.dataset.frames, where=where, skipped=dataset.skipped)
        joins = _joins(row.resolve(registry, row.seeds[0]))
        sources = tuple(Source(plugins, data, options, index, dataset.names[index], joins) for index in indices)
        # Looked up in the metadata of packages, which takes its time; no seed changes them.
        versions = row.resolve(registry, row.seeds[0]).versions()
        size = group_size(row.joint, len(sources))
        count += len(row.seeds) * math.ceil(len(sources) / size)
        if count > _MOST_CALIBRATIONS:
            raise InputError(
                "the study asks for too many calibrations",
                where=where,
                expected=f"at most {_MOST_CALIBRATIONS}",
                got=f"{count} up to this row",
                hint="choose fewer frames or seeds: --frames, --seeds",
            )
        methods = {seed: _Method.of(row, seed, options, versions, registry) for seed in row.seeds}
        listed = listed_errors(row.recipe(row.seeds[0]), dataset.names, indices[::size])
        out.append(_Opened(row, sources, methods, listed))
    return out


def _joins(plan: Plan) -> str:
    """Return name and options of the method that joins sweeps as JSON, or an empty text."""
    part = plan.parts.get("accumulate")
    if part is None:
        return ""
    return json.dumps([part.offer.full_name, part.options.model_dump(mode="json")], sort_keys=True)


def _data_options(row: StudyRow, registry: Registry) -> str:
    """Return the dataset's options as JSON; its seed is its own, so that all seeds of a row see the same frames."""
    options = {**row.dataset.options, **row.words["options"].get("data", {})}
    fields = row.resolve(registry, row.seeds[0]).parts["data"].options.model_fields
    if "seed" in fields and "seed" not in split_data(row.dataset.data)[1]:
        options.setdefault("seed", 0)
    return json.dumps(options, sort_keys=True)


def _read(
    run: Run, opened: Sequence[_Opened], cache: FeatureCache, say: OnProgress, warn: _Once, *, extract: bool
) -> dict[Source, Facts]:
    """Return what planning has to know about every frame, each read once; `extract` its features at once, too.

    Raises InputError where the first frame of a row lacks what the row needs.
    """
    checks: dict[Source, set[str]] = {}
    firsts: dict[Source, list[_Opened]] = {}
    extractors: dict[Source, dict[str, tuple[str, str]]] = {}
    for entry in opened:
        firsts.setdefault(entry.sources[0], []).append(entry)
        for source in entry.sources:
            checks.setdefault(source, set()).add(entry.first.recipe)
            wanted = extractors.setdefault(source, {})
            if extract:
                wanted.update({name: w for m in entry.methods.values() for name, w in m.extractors.items()})
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


@dataclass(frozen=True, eq=False)
class _Cell:
    """One calibration to be had: a row of the table, a seed, and the frames; `check` is what frames are checked by."""

    planned: Planned
    row: StudyRow
    seed: int
    joint: int
    method: _Method
    check: str
    facts: tuple[Facts, ...]
    truth: Float | None
    start: Float | None

    @property
    def failure(self) -> tuple[str, str] | None:
        """Reason and traceback of the first frame that cannot be read, or lacks what the row needs."""
        for fact in self.facts:
            if fact.failure is not None:
                return fact.reason, fact.failure
            if self.check in fact.misfits:
                return fact.misfits[self.check], fact.misfits[self.check]
        return None

    @property
    def stored(self) -> StoredRow:
        """The row with all that is known before it is computed."""
        names = tuple(fact.name for fact in self.facts)
        before: dict[str, Any] = {}
        if self.truth is not None and self.start is not None:
            error = pose_error(self.start, self.truth)
            before = {"start_rotation_deg": error.rotation_deg, "start_translation_m": error.translation_m}
        return StoredRow(
            **{name: getattr(self.planned, name) for name in Planned.__dataclass_fields__},
            frames=names,
            joint=self.joint,
            seed=self.seed,
            perturb=self.method.described["perturb"],
            start=self.start,
            truth=self.truth,
            recipe={**self.method.described, "frames": ",".join(names), "joint": bool(self.joint)},
            versions=self.method.versions,
            inputs={fact.name: dict(fact.inputs) for fact in self.facts},
            **before,
        )


def _cells(opened: Sequence[_Opened], facts: Mapping[Source, Facts]) -> Iterator[_Cell]:
    """Return every calibration of the study: by row, then frames, then seed."""
    for entry in opened:
        row = entry.row
        for group in groups_of(row.joint, [facts[source] for source in entry.sources]):
            for seed in entry.methods:
                yield _cell(entry, seed, len(group) if row.joint else 0, group)


def _cell(entry: _Opened, seed: int, joint: int, group: tuple[Facts, ...]) -> _Cell:
    row, method = entry.row, entry.methods[seed]
    truth = start = None
    if all(fact.failure is None for fact in group):
        # Facts know the poses of a frame by the same names as the frame.
        poses: Any = group
        truth = common_pose(poses, "camera_from_lidar")
        start, _ = start_of(poses, truth, method.plan.recipe, None, group[0].source.index, entry.listed)
    key = content_hash(
        {
            "method": method.key,
            "joint": bool(joint),
            "frames": [{"name": fact.name, **fact.inputs} for fact in group],
            "start": start,
            "truth": truth,
        }
    )
    planned = Planned(
        key=key,
        study=row.where.removeprefix("study "),
        row=row.label,
        section=row.section,
        dataset=row.dataset.name,
        **row.said,
    )
    return _Cell(planned, row, seed, joint, method, entry.first.recipe, group, truth, start)


def _compute(run: Run, store: Store, cells: Sequence[_Cell], cache: FeatureCache, pace: _Pace, warn: _Once) -> None:
    """Compute what is missing, and keep each row as soon as it is there."""
    finished = store.finished(cell.planned.key for cell in cells)
    # Two rows of the table may be one and the same calibration.
    pending = list({c.planned.key: c for c in cells if c.planned.key not in finished}.values())
    pace.begin(kept=len(finished), total=len(finished) + len(pending))
    if not pending:
        return
    for part in {f"{s} {p}": p for c in pending for s, p in c.method.plan.parts.items() if s != "data"}.values():
        worker.built(part)  # a package that is missing is told before any work
    keys = _feature_keys(pending)
    failures = _extracted(run, pending, keys, cache, pace.say, warn)
    refused: list[StoredRow] = []

    def jobs() -> Iterator[Calibration]:
        for cell in pending:
            key = cell.planned.key
            failure = cell.failure or _failed_features(keys.get(key), failures)
            if failure is not None:
                refused.append(replace(cell.stored, reason=failure[0], exception=failure[1], finished=worker.now()))
            # Another process that works on the same study may have been faster.
            elif not store.finished([key]):
                yield Calibration(cell.stored, cell.method.recipe, cell.facts, cache.root, keys[key])

    pace.begin(kept=len(finished), total=len(finished) + len(pending))
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


FeatureKeys = Mapping[str, tuple[Mapping[str, str], ...]]


def _feature_keys(cells: Sequence[_Cell]) -> FeatureKeys:
    """Return the keys of what is prepared of each frame, by the key of the cell."""
    known: dict[tuple[str, Source], dict[str, str]] = {}
    out = {}
    for cell in cells:
        if cell.failure is not None:
            continue
        for fact in cell.facts:
            if (cell.method.key, fact.source) not in known:
                known[cell.method.key, fact.source] = worker.piece_keys(cell.method.plan, fact)
        out[cell.planned.key] = tuple(known[cell.method.key, fact.source] for fact in cell.facts)
    return out


def _extracted(
    run: Run, cells: Sequence[_Cell], keys: FeatureKeys, cache: FeatureCache, say: OnProgress, warn: _Once
) -> dict[str, tuple[str, str]]:
    """Extract the features that are not kept yet, once each; return reason and traceback of those that failed."""
    wanted: dict[Source, dict[str, tuple[str, str, str]]] = {}
    for cell in cells:
        for fact, stages in zip(cell.facts, keys.get(cell.planned.key, ()), strict=False):
            for stage, key in stages.items():
                if not cache.has(key):
                    wanted.setdefault(fact.source, {}).setdefault(key, (key, cell.method.recipe, stage))
    jobs = [Extraction(source, cache.root, tuple(tasks.values())) for source, tasks in wanted.items()]
    failures: dict[str, tuple[str, str]] = {}
    with contextlib.closing(run(worker.extract, jobs, worker.unextracted)) as finished:
        for done, found in enumerate(finished, start=1):
            failures |= found.failed
            warn(found.unkept)
            say(Progress("extract", done, len(jobs)))
    return failures


def _failed_features(
    keys: Sequence[Mapping[str, str]] | None, failures: Mapping[str, tuple[str, str]]
) -> tuple[str, str] | None:
    return next((failures[key] for stages in keys or () for key in stages.values() if key in failures), None)


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
