"""A folder of results: SUITE.jsonl with the rows of each suite, frames.jsonl with digests and truth of their frames.

equivalences.jsonl has the versions of methods whose outcomes agree (`p2o benchmark confirm`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.files.whole_file import write_whole
from p2o.geometry.pose_error import PoseError, pose_error

from p2o_study.benchmark.equivalences import EQUIVALENCES_FILE, Equivalence, Equivalences
from p2o_study.benchmark.row import FrameData, Row, add_records, read_records

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
        others = (FRAMES_FILE, EQUIVALENCES_FILE)
        return sorted(path.stem for path in self.folder.glob("*.jsonl") if path.name not in others)

    def path(self, suite: str) -> Path:
        """Return the file of the rows of a suite."""
        return self.folder / f"{suite}.jsonl"

    def rows(self, suite: str) -> list[Row]:
        """Return the rows of a suite, sorted; none without a file. Raises InputError for a row of another suite."""
        rows = read_records(Row, self.path(suite))
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
    def equivalences(self) -> Equivalences:
        """The equivalences of versions of methods; raises InputError, with file and line, for an invalid one."""
        return Equivalences(read_records(Equivalence, self.folder / EQUIVALENCES_FILE))

    def add_equivalence(self, equivalence: Equivalence) -> None:
        """Add an equivalence; existing lines are kept."""
        add_records(self.folder / EQUIVALENCES_FILE, [equivalence], Equivalence)

    def add(self, suite: str, rows: Iterable[Row], frames: Iterable[FrameData]) -> int:
        """Add rows and their frames, and return the number of new rows; existing lines are kept."""
        add_records(self.folder / FRAMES_FILE, frames, FrameData)
        return add_records(self.path(suite), rows, Row)

    def remove(self, suite: str, rows: Iterable[Row]) -> None:
        """Remove rows from the file of a suite; frames and all other rows are kept."""
        lines = {row.line for row in rows}
        kept = [row for row in self.rows(suite) if row.line not in lines]
        write_whole(self.path(suite), "".join(f"{row.line}\n" for row in kept).encode())
