"""The calibrations that a suite asks for, and whether a row of the results is a measurement of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from p2o.arrays import Float

from p2o_study.benchmark.equivalences import NONE, Equivalences
from p2o_study.benchmark.row import FrameData, Row
from p2o_study.cells import Cell
from p2o_study.worker import FrameRecord

GIVEN = "as given"
"""Protocol of a row whose initial guess is that of the data."""
_SAME_START = 1e-6
"""Largest difference of two initial guesses of one draw: machines differ in the last bits of sine and cosine."""


class State(StrEnum):
    """Whether the results have a row of a calibration, and whether it is a measurement of the current version."""

    FRESH = "fresh"
    MISSING = "missing"
    CRASHED = "crashed"
    METHOD = "method changed"
    DATA = "data changed"
    START = "initial guess changed"


@dataclass(frozen=True, eq=False)
class Task:
    """One calibration of a suite; `frames` hold content and truth of its frames, `digest` is that of the method."""

    suite: str
    cell: Cell
    frames: tuple[FrameData, ...]

    @classmethod
    def of(cls, suite: str, cell: Cell) -> Task | None:
        """Return the task of a calibration; None if a frame cannot be read."""
        if cell.start is None or not cell.group.readable:
            return None
        dataset = cell.planned.dataset
        return cls(suite, cell, tuple(frame_data(dataset, record) for record in cell.group.records))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the frames."""
        return tuple(frame.name for frame in self.frames)

    @property
    def joint(self) -> bool | Literal["rig"]:
        """Whether several frames are calibrated jointly, and whether they are those of a rig."""
        return "rig" if self.cell.group.rig else len(self.names) > 1

    @property
    def protocol(self) -> str:
        """The draw of the initial guess."""
        return self.cell.method.described["perturb"] or GIVEN

    @property
    def start(self) -> Float:
        """The initial guess (4, 4)."""
        assert self.cell.start is not None
        return self.cell.start

    @cached_property
    def identity(self) -> tuple[str, ...]:
        """What is measured, as `Row.identity`."""
        return self.identity_for(self.cell.planned.row)

    def identity_for(self, label: str) -> tuple[str, ...]:
        """Return the identity of a row with another label on the same frames from the same initial guess."""
        return (self.suite, self.cell.planned.dataset, label, self.protocol, f"{self.cell.seed:010d}", *self.names)

    def state_of(self, row: Row, equivalences: Equivalences = NONE) -> State:
        """Return whether a row with this identity is a measurement of this task, or of an equivalent method."""
        if row.crashed:
            return State.CRASHED
        if [frame.digest for frame in row.frames] != [frame.digest for frame in self.frames]:
            return State.DATA
        if self.sample_of(row, equivalences) is None:
            return State.METHOD
        return State.FRESH if self.has_start_of(row) else State.START

    def sample_of(self, row: Row, equivalences: Equivalences) -> int | None:
        """Return `Equivalences.sample` from the method of a row to that of the task; 0 for external methods."""
        if row.method.external:
            return 0
        return equivalences.sample(row.digest, self.cell.method.digest, row.suite, row.dataset)

    def has_start_of(self, row: Row) -> bool:
        """Return whether the initial guess is that of a row."""
        return np.allclose(row.start, self.start, rtol=0, atol=_SAME_START)


@lru_cache(maxsize=20_000)
def frame_data(dataset: str, record: FrameRecord) -> FrameData:
    """Return content digests and ground truth of a frame that was read; computed once per record."""
    return FrameData(
        dataset=dataset,
        name=record.name,
        image=record.digests["image"],
        sweep=record.digests["sweep"],
        calibration=record.digests["calibration"],
        truth=None if record.camera_from_lidar is None else record.camera_from_lidar.tolist(),
    )


def state_of(task: Task, rows: Sequence[Row], equivalences: Equivalences = NONE) -> State:
    """Return the state of a task from the rows of its identity: fresh if any is, otherwise that of the first."""
    states = [task.state_of(row, equivalences) for row in rows]
    return State.MISSING if not states else State.FRESH if State.FRESH in states else states[0]
