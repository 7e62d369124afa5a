"""What exporters promise of the files that they write."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from p2o.errors import P2OError
from p2o.geometry.camera import Camera
from p2o.host.method import Kind
from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Agreement, Judged, Rival, StartWeight
from p2o.results.result import DIRECTED, Result, Round, Status
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.testing import stage
from p2o.testing.check import Checks
from p2o.testing.exact import around
from p2o.testing.subject import CheckFailed, Subject, require

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
    return Result(
        ("stage",),
        around(truth, 1.0, 0.05)[0],
        truth,
        Status.CONVERGED,
        "the last round moved the pose by less than the tolerance",
        (turn,),
        covariance=1e-6 * np.eye(6),
        matches={"L": 40, "R": 38},
        residual_px={"L": 0.5, "R": 0.75},
        judged=Judged(DIRECTED, "px", 3.0, 1.0),
        agreement=Agreement(0.5, 0.1, 78),
        rival=Rival(1.0, "edges", 1.5, 0.2),
        start_weight=StartWeight(2.0, 0.1, np.eye(4), Accuracy(0.2, 0.05, 0.5, 0.12), 0.01, 0.002),
        intrinsics=Camera.pinhole(700, 700, 320, 120, 640, 240),
        verdict=Verdict((Reason(Doubt.RIVAL_POSE, "another pose fits as well"),)),
        seconds={"extract": 0.5},
        recipe={"matcher": "ogm"},
        seed=0,
        versions={"p2o-calib": "0"},
    )
