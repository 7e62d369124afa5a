"""What exporters promise of the files that they write, and readers of calibration files of those that they read."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from p2o.calibration_files.calibration import Calibration, Source
from p2o.errors import InputError, P2OError
from p2o.geometry.camera import Camera
from p2o.host.method import Kind
from p2o.results.evidence import Accuracy, Agreement, Judged, Rival, StartWeight
from p2o.results.result import DIRECTED, Result, Round, Status
from p2o.results.verdict import Doubt, Reason, Verdict

from p2o_testing import stage
from p2o_testing.exact import around
from p2o_testing.same import require_equal
from p2o_testing.subject import CheckFailed, Checks, Subject, require

CHECKS = Checks(Kind.EXPORTER)


@CHECKS.of()
def exports_repeat(subject: Subject) -> None:
    """A result is written to the path that is asked for, and twice the same gives the same bytes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.out" for name in "ab"]
        for path in paths:
            subject.built()(_result(), path)
            require(path.is_file() and path.stat().st_size, "nothing was written")
        require(paths[0].read_bytes() == paths[1].read_bytes(), "the same result gives other bytes")


@CHECKS.of()
def unwritable_paths_are_errors(subject: Subject) -> None:
    """A path that cannot be written raises a P2OError instead of losing the result."""
    with tempfile.NamedTemporaryFile() as file:
        try:
            subject.built()(_result(), Path(file.name) / "below" / "a-file.out")
        except P2OError as problem:
            require("raised" not in str(problem), str(problem))
            return
    raise CheckFailed("a path below a file was written without an error")


def _result() -> Result:
    truth = stage.camera_from_lidar()
    turn = Round("refine", 50.0, {"L": 40, "R": 38}, 1.25, 2.5, 0.1, 0.01, True)
    reason = "the last round moved the pose by less than the tolerance"
    fit: dict[str, Any] = {"covariance": 1e-6 * np.eye(6), "matches": {"L": 40, "R": 38}}
    fit |= {"residual_px": {"L": 0.5, "R": 0.75}, "intrinsics": Camera.pinhole(700, 700, 320, 120, 640, 240)}
    evidence: dict[str, Any] = {"judged": Judged(DIRECTED, "px", 3.0, 1.0), "agreement": Agreement(0.5, 0.1, 78)}
    evidence |= {"rival": Rival(1.0, "edges", 1.5, 0.2), "seed": 0, "versions": {"p2o-calib": "0"}}
    evidence["start_weight"] = StartWeight(2.0, 0.1, np.eye(4), Accuracy(0.2, 0.05, 0.5, 0.12), 0.01, 0.002)
    evidence["verdict"] = Verdict((Reason(Doubt.RIVAL_POSE, "another pose fits as well"),))
    record: dict[str, Any] = {"seconds": {"extract": 0.5}, "recipe": {"matcher": "ogm"}}
    start = around(truth, 1.0, 0.05)[0]
    return Result(("stage",), start, truth, Status.CONVERGED, reason, (turn,), **fit, **evidence, **record)


READERS = Checks(Kind.CALIBRATION_READER)

_OTHER_CONTENT = (
    b"",
    b"\x00\xff\xfe" * 40,
    b"The quick brown fox jumps over the lazy dog.\n",
    b"{}",
    b"[1, 2, [3]]",
    b"a: {b: [c, 1.0]}\n",
    b"<html><body/></html>",
    b"1 2 3\n",
)
"""Files of no calibration format: nothing, bytes, prose, JSON, YAML, XML, numbers."""
_CUTS = 16


def _source(content: bytes) -> Source:
    return Source(Path("example"), content)


def _read(subject: Subject) -> Calibration:
    reader = subject.built()
    calibration: Calibration = reader.read(_source(reader.example()))
    return calibration


@READERS.of()
def the_example_is_recognised(subject: Subject) -> None:
    """The reader recognises its own example."""
    reader = subject.built()
    require(reader.recognises(_source(reader.example())), "the example is not recognised")


@READERS.of()
def other_files_are_not_recognised(subject: Subject) -> None:
    """Content of no calibration format is not recognised, and raises nothing."""
    reader = subject.built()
    for content in _OTHER_CONTENT:
        require(not reader.recognises(_source(content)), f"{content[:60]!r} is recognised")


@READERS.of()
def the_example_holds_a_calibration(subject: Subject) -> None:
    """The example reads as a camera, a rigid extrinsic, or both."""
    require(_read(subject).parts, "the example holds neither a camera nor an extrinsic")


@READERS.of()
def reading_repeats(subject: Subject) -> None:
    """Reading a file twice gives the same calibration, bit for bit."""
    require_equal(_read(subject), _read(subject), "the second calibration differs")


@READERS.of()
def incomplete_files_are_errors_of_the_file(subject: Subject) -> None:
    """A file that breaks off is not recognised, raises InputError that names the file, or holds what is left of it."""
    reader = subject.built()
    example = reader.example()
    for share in range(1, _CUTS):
        source = _source(example[: len(example) * share // _CUTS])
        if reader.recognises(source):
            try:
                reader.read(source)
            except InputError:
                continue
