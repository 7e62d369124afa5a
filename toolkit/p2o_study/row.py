"""The record of one calibration: what was calibrated, with what, and what came out.

Studies, suites, comparisons and external methods have the same record. It holds poses; errors are computed from them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.pose_error import AXES, PoseError, pose_error
from p2o.results.figures import Value
from p2o.results.json_types import Count, Number, Tree, json_tree
from p2o.results.result import Round, SolverStatus, Status
from p2o.results.verdict import Trust
from pydantic import Field, PlainSerializer, PlainValidator, Strict
from pydantic_core import PydanticCustomError

NORMS = ("rotation_deg", "translation_m")
METRICS = (*NORMS, *AXES)
"""The parts of the error of an estimate against the ground truth; those of the axes are signed."""
PER_AXIS = {f"axis{unit}": tuple(axis for axis in AXES if axis.endswith(unit)) for unit in ("_deg", "_m")}
"""Means over three axes of the absolute error, and their axes: what a mean absolute error by axis states."""
GIVEN = "as given"
"""Protocol of a row whose initial guess is that of the data."""
UNREADABLE = "unreadable"
"""Content of a frame that cannot be read."""
_DECIMALS, _SIGNIFICANT, _BRIEF_SIGNIFICANT = 9, 7, 5
PREDICTED = tuple(f"predicted_{norm}{suffix}" for norm in NORMS for suffix in ("", "_95"))
"""The figures of a result with its predicted errors, 67 % and 95 %."""


def _read_pose(numbers: Any) -> Float:
    """Return the pose (4, 4) of the twelve numbers of its first three rows."""
    try:
        upper = np.asarray(numbers, np.float64)
    except (ValueError, TypeError, OverflowError) as problem:
        raise PydanticCustomError("pose", "twelve numbers") from problem
    if upper.shape == (4, 4):
        return upper
    if upper.shape != (12,):
        raise PydanticCustomError("pose", "twelve numbers")
    try:
        return se3.check_rigid("the pose", np.vstack([upper.reshape(3, 4), [0, 0, 0, 1]]), tolerance=1e-6)
    except InputError as problem:
        raise PydanticCustomError("rigid", "a rigid transform: {what}", {"what": problem.what}) from problem


def rounded_pose(pose: Float) -> list[float]:
    """Return the first three rows of a pose (4, 4) with 9 decimals: machines differ in the last bits of functions."""
    return (np.round(pose[:3], _DECIMALS) + 0.0).ravel().tolist()


StoredPose = Annotated[Float, PlainValidator(_read_pose), PlainSerializer(rounded_pose, when_used="json")]
"""A rigid transform (4, 4), the twelve numbers of its first three rows in JSON."""
Text = Annotated[str, Strict()]
"""A text, which may contain lone surrogates: names of files that are not valid UTF-8."""
Seed = Annotated[int, Strict(), Field(ge=0, le=2**32 - 1)]


def _read_figure(value: Any) -> Value:
    """Return a figure of JSON: a number, a text, or an infinity written as text."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float | str)):
        raise PydanticCustomError("figure", "a number or a text")
    return float(value) if value in ("inf", "-inf") else value


Figure = Annotated[
    float | int | str | None,
    PlainValidator(_read_figure),
    PlainSerializer(lambda value: json_tree("a figure", value), when_used="json"),
]


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a data set: `truth` (4, 4) is camera_from_lidar, None if unknown.

    `content` is the `frame_digest`: of files that of their arrays, rounded so that machines agree, of computed frames
    that of their recipe.
    """

    dataset: Text
    name: Text
    content: Text
    truth: StoredPose | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """What is calibrated: frames of one data set from one initial guess; the same for all methods of a suite.

    `data` is the name of the data set in the registry, `options` are its options. `joint` is the number of frames of a
    joint calibration, 0 for a single frame; a `rig` has frames of several cameras, and its poses are those of the
    camera of the first frame. `protocol` draws the initial guess `start` camera_from_lidar (4, 4) with `seed`; it is
    None where a frame cannot be read.
    """

    dataset: Text
    frames: Annotated[tuple[Frame, ...], Field(min_length=1, max_length=10_000)]
    seed: Seed
    start: StoredPose | None
    protocol: Text = GIVEN
    joint: Annotated[int, Strict(), Field(ge=0, le=10_000)] = 0
    rig: Annotated[bool, Strict()] = False
    data: Text = ""
    options: Tree = field(default_factory=dict)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the frames."""
        return tuple(frame.name for frame in self.frames)

    @cached_property
    def truth(self) -> Float | None:
        """The ground truth (4, 4), the first that is known of the frames; None if none is."""
        return next((frame.truth for frame in self.frames if frame.truth is not None), None)

    @property
    def place(self) -> str:
        """The names of the frames as one text: the first, and the number of others."""
        first, *others = self.names
        return first + (f" +{len(others)}" if others else "")

    @cached_property
    def start_error(self) -> PoseError | None:
        """The error of the initial guess; None where it is unknown."""
        return None if self.truth is None or self.start is None else pose_error(self.start, self.truth)


@dataclass(frozen=True, eq=False)
class Method:
    """A method: the words of its recipe and every option that took effect, or the name of an external method.

    `revision` is the hash of its code, weights and options, for an external method that of its file of poses.
    """

    revision: Text
    words: Mapping[str, Text] = field(default_factory=dict)
    options: Tree = field(default_factory=dict)
    external: Annotated[bool, Strict()] = False
    source: Text = ""


@dataclass(frozen=True, eq=False)
class Environment:
    """Where a row was computed: machine, packages, commit of the sources, and who measured."""

    machine: Tree = field(default_factory=dict)
    versions: Mapping[str, Text] = field(default_factory=dict)
    commit: Text = ""
    measured_by: Text = ""


@dataclass(frozen=True, eq=False)
class Row:
    """One calibration of a study: `row` is the label of its row in the table, `section` the heading above it.

    `key` identifies the computation: content of the frames, initial guess, seed and revision of the method.

    The other values are those of a finished calibration: `status` is that of the `Result`, `exception` the traceback
    where the run raised. `estimate` is camera_from_lidar (4, 4), None if the calibration was refused. `trust` is the
    verdict and `why` its reasons, None without a result. `figures` holds the figures of the result
    (`p2o.results.figures`) by name; unknown ones are absent. `matches` holds counts by direction, `seconds` the time by
    stage, `load` the load average of the machine at the end, `finished` the time in UTC, ISO 8601.
    """

    key: Text
    row: Text
    case: Case
    method: Method
    section: Text = ""
    status: Status = Status.STAGE_FAILED
    reason: Text = ""
    exception: Text | None = None
    estimate: StoredPose | None = None
    trust: Trust | None = None
    why: Text | None = None
    figures: Mapping[str, Figure] = field(default_factory=dict)
    matches: Mapping[str, Count] = field(default_factory=dict)
    rounds: tuple[Round, ...] = ()
    seconds: Mapping[str, Number] = field(default_factory=dict)
    environment: Environment = field(default_factory=Environment)
    load: Number | None = None
    finished: Text = ""

    @property
    def dataset(self) -> str:
        """The name of the data set in the study."""
        return self.case.dataset

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of the frames."""
        return self.case.names

    @property
    def place(self) -> str:
        """The names of the frames as one text."""
        return self.case.place

    @property
    def seed(self) -> int:
        """The seed of the initial guess."""
        return self.case.seed

    @property
    def identity(self) -> tuple[str, str, str, str, int, tuple[str, ...]]:
        """What is measured, whatever the revision of the method: section, data set, label, protocol, seed, frames."""
        return (self.section, self.dataset, self.row, self.case.protocol, self.seed, self.frames)

    def named(self) -> dict[str, str | int]:
        """Return what identifies the calibration for a reader, for JSON."""
        names = {"dataset": self.dataset, "section": self.section, "row": self.row, "place": self.place}
        return {**names, "protocol": self.case.protocol, "seed": self.seed}

    @property
    def solved(self) -> bool:
        """True if `estimate` is a new pose and not the initial guess."""
        return self.status.solved

    @property
    def crashed(self) -> bool:
        """True if the calibration raised: it is repeated when the study is started again."""
        return self.status is Status.STAGE_FAILED

    @property
    def total_s(self) -> float | None:
        """Time of the calibration in s including feature extraction; None if unknown."""
        return sum(self.seconds.values()) if self.seconds else None

    @property
    def pose(self) -> Float | None:
        """The result (4, 4): the estimate, or the initial guess of a refused calibration."""
        return self.case.start if self.estimate is None else self.estimate

    @cached_property
    def error(self) -> PoseError | None:
        """The error of the result; None where it is unknown or the calibration raised."""
        if self.crashed or self.case.truth is None or self.pose is None:
            return None
        return self.case.start_error if self.estimate is None else pose_error(self.estimate, self.case.truth)

    def error_of(self, metric: str) -> float | None:
        """Return one of `METRICS` of the error, signed by axis; None where it is unknown."""
        return _part(self.error, metric)

    def start_error_of(self, metric: str) -> float | None:
        """Return one of `METRICS` of the error of the initial guess; None where it is unknown."""
        return _part(self.case.start_error, metric)

    def predicted(self, name: str) -> float | None:
        """Return a predicted error, such as "rotation_deg_95"; None where it is unknown."""
        value = self.figures.get(f"predicted_{name}")
        return None if value is None else float(value)

    def brief(self) -> Row:
        """Return the row without rounds, matches, reasons of a solved calibration, and figures but predicted errors."""
        known = {name: self.figures[name] for name in PREDICTED if name in self.figures}
        predicted = {name: _brief(value, _BRIEF_SIGNIFICANT) for name, value in known.items()}
        total = {} if self.total_s is None else {"total": round(self.total_s, 3)}
        reason = "" if self.solved else self.reason
        return replace(self, figures=predicted, matches={}, rounds=(), reason=reason, why=None, seconds=total)

    @property
    def unmoved(self) -> bool:
        """True if the estimate is the initial guess: the solver did not move."""
        if self.estimate is None or self.case.start is None:
            return False
        return SolverStatus.of(self.case.start, self.estimate, converged=True) is SolverStatus.NOT_MOVED


def _part(error: PoseError | None, metric: str) -> float | None:
    if error is None:
        return None
    value: float = getattr(error, metric) if metric in NORMS else error.per_axis[metric]
    return value


def frame_digest(digests: Mapping[str, str], truth: Float | None) -> str:
    """Return the SHA-256 of the content (hashes of image, sweep and calibration) and ground truth of a frame."""
    # Machines differ in the last bits of matrix products; adding 0 removes negative zeros.
    pose = None if truth is None else (np.round(truth, _DECIMALS) + 0.0).tolist()
    content = [*(digests[name] for name in ("image", "sweep", "calibration")), pose]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def brief_figures(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return the known figures of a result, numbers with 7 significant digits."""
    known = {name: value for name, value in values.items() if value is not None}
    return {name: _brief(value) for name, value in known.items()}


def _brief(value: Value, digits: int = _SIGNIFICANT) -> Value:
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def canonical(plain: object) -> str:
    """Return JSON with sorted keys and without white space, one text for equal values."""
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_id(plain: object) -> str:
    """Return the first 12 hexadecimal digits of the SHA-256 of a JSON value."""
    return hashlib.sha256(canonical(plain).encode()).hexdigest()[:12]
