"""Bundles: rows, frames, equivalences, stated errors and environment in one zip file, and their verification."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from p2o.errors import InputError
from p2o.files.input_file import read_start
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.geometry.pose_error import pose_error
from p2o.options import validated
from pydantic import BaseModel, ConfigDict, Field

from p2o_study.ablate import OnProgress, OnWarning, ablate
from p2o_study.benchmark.equivalences import EQUIVALENCES_FILE, Equivalence, Equivalences
from p2o_study.benchmark.measure import source_version
from p2o_study.benchmark.plan import State, Task
from p2o_study.benchmark.results import FRAMES_FILE, Frames, Results
from p2o_study.benchmark.row import Digest, FrameData, JsonLine, Row, latest, merged, parsed_lines
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.cells import Cell
from p2o_study.machine import machine_info
from p2o_study.parallel import Workers
from p2o_study.store import StoredRow
from p2o_study.study import Line, Slug
from p2o_study.worker import Plugins

MANIFEST, ROWS, ERRORS = "manifest.json", "rows.jsonl", "errors.csv"
_FILES = (MANIFEST, ROWS, FRAMES_FILE, ERRORS)
MAX_BYTES = 1 << 30
"""Maximum size of a file of a bundle, unpacked."""
_STATED = ("dataset", "row", "group", "protocol", "seed", "status", "rotation_deg", "translation_m")
_ROUNDING = 2e-6
"""Largest difference of a stated error, which is printed with 6 decimals."""
SAME_DEG, SAME_M = 0.02, 0.005
"""Largest difference of a pose that is computed again, possibly on another machine."""


class Manifest(BaseModel):
    """The description of a bundle: SHA-256 of every line of rows and equivalences, sources, and the packing machine."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: Literal[1]
    suite: Slug
    commit: Line
    environment: dict[Line, Line | int | float] = Field(max_length=100)
    rows: tuple[Digest, ...] = Field(min_length=1)
    equivalences: tuple[Digest, ...] = ()


@dataclass(frozen=True)
class Certificate:
    """The outcome of a verification; a bundle with `failures` is refused.

    `compared` rows had their frames and initial guesses compared with data on this machine, `rerun` were computed
    again. `not_rerun` counts rows of the sample that were not, by reason. `samples` has one number for each compared
    row of an earlier version of its method, which an equivalence of the bundle declares equal to the version here: how
    many rows of the method were confirmed.
    """

    suite: str
    rows: int
    failures: tuple[str, ...]
    compared: int = 0
    rerun: int = 0
    not_rerun: Mapping[str, int] = field(default_factory=dict)
    samples: tuple[int, ...] = ()

    def __str__(self) -> str:
        """Return the certificate as lines of text."""
        head = "refused" if self.failures else "accepted"
        lines = [f"{self.suite}: {head}, {self.rows} rows; every error computed again from its pose"]
        lines.append(f"  {self.compared} rows compared with the data here, {self.rerun} computed again")
        if self.samples:
            claim = f"declared equal by samples of at least {min(self.samples)} rows"
            lines.append(f"  {len(self.samples)} of an earlier version of their method, {claim}")
        lines += [f"  not computed again: {count} ({reason})" for reason, count in self.not_rerun.items()]
        return "\n".join([*lines, *(f"  FAIL  {failure}" for failure in self.failures)])


def pack(results: Results, suite: str, path: Path) -> int:
    """Write the last measured rows of a suite as a bundle, and return their number; InputError without rows.

    The bundle contains the equivalences that begin at the digests of its rows.
    """
    rows = latest(results.rows(suite))
    if not rows:
        raise InputError("the suite has no rows", where=results.path(suite), hint=f"p2o benchmark run {suite}")
    frames = results.frames
    used = merged(frame for row in rows for frame in frames.of(row))
    equivalences = merged(results.equivalences.reachable({row.digest for row in rows}, suite))
    manifest: dict[str, object] = {
        "version": 1,
        "suite": suite,
        "commit": source_version(),
        "environment": machine_info(),
        "rows": [_sha256(row) for row in rows],
    }
    contents = {
        ROWS: "".join(f"{row.line}\n" for row in rows),
        FRAMES_FILE: "".join(f"{frame.line}\n" for frame in used),
        ERRORS: errors_csv(rows, frames),
    }
    if equivalences:
        manifest["equivalences"] = [_sha256(equivalence) for equivalence in equivalences]
        contents[EQUIVALENCES_FILE] = "".join(f"{equivalence.line}\n" for equivalence in equivalences)
    contents[MANIFEST] = json.dumps(manifest, indent=1)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in contents.items():
            # A fixed time: equal rows give equal bundles.
            archive.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)
    write_whole(path, packed.getvalue())
    return len(rows)


def errors_csv(rows: Sequence[Row], frames: Frames) -> str:
    """Return the errors of rows as CSV, one line each, for readers; they are checked, never used."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_STATED)
    for row in rows:
        error = frames.error_of(row)
        numbers = ("", "") if error is None else (f"{error.rotation_deg:.6f}", f"{error.translation_m:.6f}")
        writer.writerow((row.dataset, row.row, row.place, row.protocol, row.seed, row.status.value, *numbers))
    return text.getvalue()


def verify(
    path: Path,
    suite: SuiteFile | None,
    *,
    sample: int,
    plugins: Plugins,
    workers: Workers | None = None,
    on_progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> Certificate:
    """Verify a bundle and return its certificate.

    Every error is computed again from pose and ground truth, and compared with the stated one. With `suite`, frames
    and initial guesses are compared with the data on this machine, and a random sample of rows is computed again. Rows
    of earlier versions of a method belong to it if the bundle declares them equal: the sample tests this, too.

    Raises InputError for a file that is not a bundle or has an invalid line.
    """
    bundle = read_bundle(path)
    manifest, rows, frames, stated = bundle.manifest, bundle.rows, bundle.frames, bundle.stated
    failures = [*_changed_lines(bundle), *_wrong_frames(rows, frames)]
    if not failures:
        failures += _wrong_errors(rows, frames, stated)
    if suite is None or failures:
        return Certificate(manifest.suite, len(rows), tuple(failures))
    rerun = _Rerun(suite.name, bundle, sample)
    if all(table.left_out for table in suite.study.study.dataset):
        return Certificate(manifest.suite, len(rows), (), not_rerun={"no data": len(rerun.sample)})
    with tempfile.TemporaryDirectory() as folder:
        done = ablate(
            suite.study,
            folder,
            plugins=plugins,
            workers=workers,
            wanted=rerun.wanted,
            on_progress=on_progress,
            on_warning=on_warning,
        )
        for stored in done.rows:
            rerun.compare(stored)
    failures, samples = rerun.failures, tuple(rerun.samples)
    return Certificate(
        manifest.suite, len(rows), tuple(failures), rerun.compared, len(done.rows), rerun.reasons(), samples
    )


class _Rerun:
    """Compare rows with the tasks of a suite, and compute a random sample of them again."""

    def __init__(self, suite: str, bundle: Bundle, sample: int) -> None:
        self.suite, rows = suite, bundle.rows
        self.equivalences = Equivalences(bundle.equivalences)
        self.rows = {row.identity: row for row in rows}
        chosen = np.random.default_rng().permutation(len(rows))[:sample]
        self.sample = {rows[number].identity for number in chosen}
        self.failures: list[str] = []
        self.compared = 0
        self.samples: list[int] = []
        self._again: dict[str, Row] = {}
        self._methods: set[tuple[str, ...]] = set()

    def wanted(self, cell: Cell) -> bool:
        """Compare the rows on the frames of a calibration with its data; return whether to compute it again."""
        task = Task.of(self.suite, cell)
        if task is None:
            return False
        row = self.rows.get(task.identity)
        if row is None:
            return False
        self.compared += 1
        state = task.state_of(row, self.equivalences)
        if sample := task.sample_of(row, self.equivalences):
            self.samples.append(sample)
        if state in (State.DATA, State.START):
            self.failures.append(f"{_name(row)}: {_DIFFERENT[state]}")
        if row.identity not in self.sample or state is not State.FRESH:
            return False
        self._methods.add(row.identity)
        self._again[cell.planned.key] = row
        return True

    def compare(self, stored: StoredRow) -> None:
        """Compare the outcome of a calibration that was computed again with its row."""
        row = self._again[stored.key]
        if stored.solved != row.status.solved or stored.estimate is None or row.estimate is None:
            if stored.status != row.status.value:
                self.failures.append(f"{_name(row)}: computed again it is {stored.status}, not {row.status.value}")
            return
        step = pose_error(row.estimate, stored.estimate)
        if step.rotation_deg > SAME_DEG or step.translation_m > SAME_M:
            text = f"{step.rotation_deg:.3f} deg and {step.translation_m:.3f} m from the pose of the row"
            self.failures.append(f"{_name(row)}: computed again the pose is {text}")

    def reasons(self) -> dict[str, int]:
        """Return the number of rows of the sample that were not computed again, by reason."""
        left = [self.rows[identity] for identity in self.sample - self._methods]
        external = sum(row.method.external for row in left)
        counts = {"external method": external, "other version of the method, or no data": len(left) - external}
        return {reason: count for reason, count in counts.items() if count}


_DIFFERENT = {
    State.DATA: "the frames differ from the data here",
    State.START: "the initial guess is not that of protocol and seed",
}


@dataclass(frozen=True, eq=False)
class Bundle:
    """The content of a bundle; `stated` are the lines of errors."""

    manifest: Manifest
    rows: Sequence[Row]
    frames: Frames
    equivalences: Sequence[Equivalence]
    stated: Sequence[Mapping[str, str]]


def read_bundle(path: Path) -> Bundle:
    """Return the content of a bundle.

    Raises InputError for a file that is not a zip file, with other files, too large content or invalid lines.
    """
    contents = _unpacked(path)
    place = f"{path}:{MANIFEST}"
    manifest = validated(Manifest, parse_json(contents[MANIFEST], "manifest", place), where=place)
    rows = list(parsed_lines(Row, contents[ROWS].splitlines(), f"{path}:{ROWS}"))
    frames = Frames(parsed_lines(FrameData, contents[FRAMES_FILE].splitlines(), f"{path}:{FRAMES_FILE}"))
    lines = contents.get(EQUIVALENCES_FILE, b"").splitlines()
    equivalences = list(parsed_lines(Equivalence, lines, f"{path}:{EQUIVALENCES_FILE}"))
    for number, row in enumerate(rows, start=1):
        if row.suite != manifest.suite:
            raise InputError("a row of another suite", where=f"{path}:{ROWS}:{number}", expected=manifest.suite)
    try:
        reader = csv.DictReader(io.StringIO(contents[ERRORS].decode("utf-8"), newline=""), strict=True)
        stated = [{str(key): str(value) for key, value in line.items()} for line in reader]
    except (csv.Error, UnicodeDecodeError) as problem:
        raise InputError("the stated errors are not CSV", where=f"{path}:{ERRORS}", got=problem) from problem
    return Bundle(manifest, rows, frames, equivalences, stated)


def _unpacked(path: Path) -> dict[str, bytes]:
    """Return the files of a bundle; names and sizes are checked before anything is unpacked."""
    read_start(path, "bundle", 4)
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            names = sorted(entry.filename for entry in entries)
            if names not in (sorted(_FILES), sorted((*_FILES, EQUIVALENCES_FILE))):
                raise InputError(
                    "the bundle has other files", where=path, expected=", ".join(_FILES), got=", ".join(names[:10])
                )
            contents = {}
            for entry in entries:
                if entry.file_size > MAX_BYTES:
                    text = f"the file {entry.filename} of the bundle is too large"
                    raise InputError(text, where=path, expected=f"at most {MAX_BYTES} bytes", got=entry.file_size)
                with archive.open(entry) as file:
                    # Reading stops at the size of the header, even if the data unpack to more.
                    contents[entry.filename] = file.read(entry.file_size)
            return contents
    except InputError:
        raise
    except Exception as problem:  # zipfile raises many types for damaged archives
        raise InputError("the bundle is not a zip file, or is damaged", where=path, got=problem) from problem


def _changed_lines(bundle: Bundle) -> Iterable[str]:
    """Yield a failure for each row that differs from its digest in the manifest, and for other equivalences."""
    stated, rows = bundle.manifest.rows, bundle.rows
    if [_sha256(equivalence) for equivalence in bundle.equivalences] != list(bundle.manifest.equivalences):
        yield f"{EQUIVALENCES_FILE}: the equivalences were changed after they were packed"
    if len(stated) != len(rows):
        yield f"{ROWS}: {len(rows)} rows, the manifest has {len(stated)}"
        return
    for number, (digest, row) in enumerate(zip(stated, rows, strict=True), start=1):
        if digest != _sha256(row):
            yield f"{ROWS}:{number}: the row was changed after it was packed ({_name(row)})"


def _wrong_frames(rows: Sequence[Row], frames: Frames) -> Iterable[str]:
    """Yield a failure for each row that names a frame whose content or ground truth is not that of its digest."""
    for row in rows:
        try:
            frames.of(row)
        except InputError as problem:
            yield str(problem)


def _wrong_errors(rows: Sequence[Row], frames: Frames, stated: Sequence[Mapping[str, str]]) -> Iterable[str]:
    """Yield a failure for each stated error that is not that of the pose."""
    if len(stated) != len(rows):
        yield f"{ERRORS}: {len(stated)} lines for {len(rows)} rows"
        return
    for number, (line, row) in enumerate(zip(stated, rows, strict=True), start=2):
        error = frames.error_of(row)
        for name in ("rotation_deg", "translation_m"):
            value, text = None if error is None else float(getattr(error, name)), line.get(name, "")
            if not _agrees(text, value):
                shown = "none" if value is None else f"{value:.6f}"
                values = f"the stated {name} is {text or 'empty'}, that of the pose {shown}"
                yield f"{ERRORS}:{number}: {values} ({_name(row)})"


def _agrees(text: str, value: float | None) -> bool:
    if value is None or not text:
        return value is None and not text
    try:
        return math.isfinite(float(text)) and abs(float(text) - value) <= _ROUNDING
    except ValueError:
        return False


def _name(row: Row) -> str:
    return f"{row.row}, {row.place}, {row.protocol}, seed {row.seed}"


def _sha256(line: JsonLine) -> str:
    return hashlib.sha256(line.line.encode()).hexdigest()
