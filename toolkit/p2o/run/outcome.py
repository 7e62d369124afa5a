"""The results of a run, with their errors where the truth is known."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry.pose_error import PoseError, pose_error, summarise
from p2o.results.result import Result, RigResult
from p2o.results.result_json import result_to_dict, to_dict
from p2o.results.verdict import Trust
from p2o.run.protocol import Protocol


@dataclass(frozen=True, eq=False)
class Row:
    """One result with what is known about its truth: errors are None if the truth is unknown.

    `camera` is the name of the camera of its frames, empty where they name none.
    """

    result: Result
    truth: Float | None
    start_error: PoseError | None
    error: PoseError | None
    camera: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the result object of `p2o run --json`, ready for JSON; NaN becomes null."""
        errors = {"error": _error_dict(self.error), "start_error": _error_dict(self.start_error)}
        return {"camera": self.camera, **result_to_dict(self.result), **errors}


@dataclass(frozen=True)
class FailedFrame:
    """A frame without a result, because it cannot be read or lacks what the methods need, and why in one line.

    Of a rig it is a camera, whose frames are solved together.
    """

    frame: str
    reason: str


@dataclass(frozen=True, eq=False)
class Run:
    """All results of a recipe: `rows`, one a frame, or one for all frames with `joint`; `failed` are frames without.

    A rig has a row for each camera, and in `rig` the common result if its file has the transforms between the cameras.
    """

    rows: tuple[Row, ...]
    joint: bool = False
    interrupted: bool = False
    failed: tuple[FailedFrame, ...] = ()
    protocol: Protocol | None = None
    rig: RigResult | None = None

    @property
    def result(self) -> Result:
        """Return the result of a run with one result; raises InputError for none or several."""
        if len(self.rows) != 1:
            raise InputError(f"this run has {len(self.rows)} results", expected="one", hint="look at .rows")
        return self.rows[0].result

    @property
    def solved(self) -> bool:
        """Return whether at least one calibration ran, all were solved, and no frame failed."""
        common = self.rig is None or self.rig.body_from_lidar is not None
        return bool(self.rows) and not self.failed and common and all(row.result.status.solved for row in self.rows)

    @property
    def rig_errors(self) -> dict[str, PoseError]:
        """The errors of the common result of a rig by camera, for those whose truth is known."""
        if self.rig is None:
            return {}
        truths = {row.camera: row.truth for row in self.rows if row.truth is not None}
        poses = {camera.name: camera.camera_from_lidar for camera in self.rig.cameras}
        return {n: pose_error(pose, truths[n]) for n, pose in poses.items() if pose is not None and n in truths}

    @property
    def summary(self) -> dict[str, Any]:
        """Counts by status and by trust, and means, medians and per-axis means of the errors of solved results.

        `start` summarises the errors of the starts of the same rows.
        """
        counts = Counter(row.result.status.value for row in self.rows)
        trusts = Counter(row.result.verdict.trust for row in self.rows)
        solved = [row for row in self.rows if row.result.status.solved]
        return {
            "count": len(self.rows),
            "failed": len(self.failed),
            "status": dict(sorted(counts.items())),
            "solved": len(solved),
            "trust": {trust.value: trusts[trust] for trust in Trust if trusts[trust]},
            "error": summarise([row.error for row in solved if row.error is not None]),
            "start": summarise([row.start_error for row in solved if row.start_error is not None]),
            "interrupted": self.interrupted,
            **({} if self.protocol is None else {"protocol": self._by_protocol(self.protocol)}),
        }

    def _by_protocol(self, protocol: Protocol) -> dict[str, Any]:
        """Compute the figures of a protocol; a refused calibration counts with its initial guess."""
        known = [(row.result.camera_from_lidar, row.truth) for row in self.rows if row.truth is not None]
        estimates, truths = (np.array(poses) for poses in (zip(*known, strict=True) if known else ((), ())))
        return {"name": protocol.name, "count": len(known), **protocol.figures(estimates, truths)}

    def as_dict(self) -> dict[str, Any]:
        """Return the one object of `p2o run --json`, of one schema for all runs: `results`, `failed`, `summary`.

        A rig whose cameras are fixed to each other has a fourth part, `rig`: the common result.
        """
        return {
            "results": [row.as_dict() for row in self.rows],
            "failed": [{"frame": one.frame, "reason": one.reason} for one in self.failed],
            **({} if self.rig is None else {"rig": self._rig_dict(self.rig)}),
            "summary": self.summary,
        }

    def _rig_dict(self, rig: RigResult) -> dict[str, Any]:
        """Return the common result with its errors, by camera and summarised."""
        errors, plain = self.rig_errors, to_dict(rig)
        plain["cameras"] = [{**camera, "error": _error_dict(errors.get(camera["name"]))} for camera in plain["cameras"]]
        return {**plain, "error": summarise(list(errors.values()))}


def _error_dict(error: PoseError | None) -> dict[str, Any] | None:
    if error is None:
        return None
    return {"rotation_deg": error.rotation_deg, "translation_m": error.translation_m, "per_axis": dict(error.per_axis)}
