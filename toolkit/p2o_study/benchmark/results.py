"""A folder of results: SUITE.jsonl with the rows of each suite, frames.jsonl with digests and truth of their frames.

methods.jsonl has the methods of the rows, each once; rows in a file name them by digest. equivalences.jsonl has the
versions of methods whose outcomes agree (`p2o benchmark confirm`).
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.input_file import read_bytes
from p2o.files.whole_file import write_whole
from p2o.geometry.pose_error import PoseError, pose_error

from p2o_study.benchmark.equivalences import EQUIVALENCES_FILE, Equivalence, Equivalences
from p2o_study.benchmark.row import (
    METHODS_FILE,
    FrameData,
    MethodData,
    Methods,
    Row,
    add_records,
    lines_of,
    merged,
    parsed_lines,
    read_records,
)

FRAMES_FILE = "frames.jsonl"


class Frames:
    """Frames by dataset, name and digest."""

    def __init__(self, frames: Iterable[FrameData] = ()) -> None:
        self._by_key = {(frame.dataset, frame.name, frame.digest): frame for frame in frames}

    def of(self, row: Row) -> list[FrameData]:
        """Return the frames of a row; raises InputError for a frame that is not listed with the digest of the row."""
        frames = []
        for frame in row.frames:
            data = self._by_key.get((row.dataset, frame.name, frame.digest))
            if data is None:
                raise InputError(
                    "a row names a frame that is not listed with this digest",
                    where=f"row '{row.row}', frame {row.dataset} {frame.name}",
                    expected=f"a line of {FRAMES_FILE} with this frame and digest",
                    got=frame.digest,
                )
            frames.append(data)
        return frames

    def truth_of(self, row: Row) -> Float | None:
        """Return the ground truth (4, 4) of a row, the first that is known of its frames; raises as `of`."""
        return next((frame.truth for frame in self.of(row) if frame.truth is not None), None)

    def error_of(self, row: Row) -> PoseError | None:
        """Return the error of the estimate, or of the initial guess of a refused row; None where it is unknown."""
        truth = self.truth_of(row)
        if truth is None or row.crashed:
            return None
        return pose_error(row.start if row.estimate is None else row.estimate, truth)


@dataclass(frozen=True)
class Results:
    """The rows of all suites in a folder."""

    folder: Path

    @property
    def suites(self) -> list[str]:
        """The names of the suites with rows."""
        others = (FRAMES_FILE, METHODS_FILE, EQUIVALENCES_FILE)
        return sorted(path.stem for path in self.folder.glob("*.jsonl") if path.name not in others)

    def path(self, suite: str) -> Path:
        """Return the file of the rows of a suite."""
        return self.folder / f"{suite}.jsonl"

    def rows(self, suite: str) -> list[Row]:
        """Return the rows of a suite, sorted; none without a file. Raises InputError for a row of another suite."""
        rows = read_records(Row, self.path(suite), self.methods)
        for row in rows:
            if row.suite != suite:
                raise InputError("a row of another suite", where=self.path(suite), expected=suite, got=row.suite)
        return rows

    @property
    def frame_data(self) -> list[FrameData]:
        """The frames of all suites."""
        return read_records(FrameData, self.folder / FRAMES_FILE)

    @property
    def frames(self) -> Frames:
        """The frames of all suites by digest."""
        return Frames(self.frame_data)

    @property
    def methods(self) -> Methods:
        """The methods of methods.jsonl by digest; raises InputError, with file and line, for an invalid one."""
        path = self.folder / METHODS_FILE
        return _methods(path, read_bytes(path, "file of methods")) if path.exists() else {}

    @property
    def equivalences(self) -> Equivalences:
        """The equivalences of versions of methods; raises InputError, with file and line, for an invalid one."""
        return Equivalences(read_records(Equivalence, self.folder / EQUIVALENCES_FILE))

    def add_equivalence(self, equivalence: Equivalence) -> None:
        """Add an equivalence; existing lines are kept."""
        add_records(self.folder / EQUIVALENCES_FILE, [equivalence], Equivalence)

    def add(self, suite: str, rows: Iterable[Row], frames: Iterable[FrameData]) -> int:
        """Add rows, their frames and their methods, and return the number of new rows; existing rows are kept."""
        add_records(self.folder / FRAMES_FILE, frames, FrameData)
        before = self.rows(suite)
        after = merged(before, rows)
        if len(after) > len(before):
            self._write(suite, after)
        return len(after) - len(before)

    def remove(self, suite: str, rows: Iterable[Row]) -> None:
        """Remove rows from the file of a suite; frames, methods and all other rows are kept."""
        removed = {row.stored for row in rows}
        self._write(suite, [row for row in self.rows(suite) if row.stored not in removed])

    def _write(self, suite: str, rows: Collection[Row]) -> None:
        """Write all rows of a suite, their methods first: an interruption leaves no row whose method is not listed."""
        methods = {row.method.digest: MethodData(method=row.method) for row in rows}
        add_records(self.folder / METHODS_FILE, methods.values(), MethodData)
        _write_lines(self.path(suite), [row.stored for row in rows])

    def unused_methods(self, removed: Iterable[Row]) -> set[str]:
        """Return the digests in methods.jsonl that no row of any suite names, except rows of `removed`."""
        lines = {row.stored for row in removed}
        rows = (row for suite in self.suites for row in self.rows(suite))
        return set(self.methods) - {row.method.digest for row in rows if row.stored not in lines}

    def remove_methods(self, digests: Collection[str]) -> None:
        """Remove the methods with these digests from methods.jsonl."""
        path = self.folder / METHODS_FILE
        kept = [data.line for data in read_records(MethodData, path) if data.method.digest not in digests]
        _write_lines(path, kept)


@lru_cache(maxsize=1)
def _methods(path: Path, content: bytes) -> Methods:
    """Return the methods of a file by digest; the last content is kept, since each suite needs the same methods."""
    return {data.method.digest: data.method for data in parsed_lines(MethodData, lines_of(io.BytesIO(content)), path)}


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    """Write the lines of a file; without lines the file is removed, since readers refuse an empty one."""
    if lines:
        write_whole(path, "".join(f"{line}\n" for line in lines).encode())
    else:
        path.unlink(missing_ok=True)
