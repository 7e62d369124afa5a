"""Folders of results with constructed rows, for the page of the benchmark."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.cli import main
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o_study.row import PREDICTED, Case, Frame, Method, Row
from p2o_study.rows import Rows

PLUGIN = Path(__file__).parents[1] / "study_plugin.py"
HOSTILE = "</script><script>window.stolen = 1</script> <b>$x$</b>"
FRAMES = 6
SUITE = 'name = "tiny"\nquestion = "Which is better? </script><b>"\nstudy = "../study.toml"\nseeds = 5\n'
STUDY = """name = "tiny"
title = "Tiny"
perturb = "1deg 0.05m"
[[dataset]]
name = "first"
data = "tiny:"
optional = true
[[dataset]]
name = "second"
data = "tiny:"
optional = true
[[row]]
label = "quick"
calibrator = "quick"
witness = "none"
"""


def rows_of(
    label: str, errors: Sequence[float], *, dataset: str = "first", joint: int = 1, start: float = 2.0, **method: Any
) -> list[Row]:
    """Return rows of `FRAMES` calibrations with five seeds, with these rotation errors in degrees by calibration.

    `method` are fields of the method.
    """
    its = Method("1" * 64, **{"words": {"calibrator": "quick"}, **method})
    figures = dict(zip(PREDICTED, (0.4, 0.8, math.inf, 1.0), strict=True))
    out = []
    for group, error in enumerate(errors):
        names = [f"drive/{group * joint + number:03d}" for number in range(joint)]
        frames = tuple(Frame(dataset, name, f"content of {name}", np.eye(4)) for name in names)
        for seed in range(5):
            case = Case(dataset, frames, seed, turned(start), f"{start:g}deg 0.05m", joint if joint > 1 else 0)
            out.append(
                Row(
                    f"{label} {dataset} {start} {joint} {group} {seed}",
                    label,
                    case,
                    its,
                    status=Status.CONVERGED,
                    estimate=turned(error),
                    trust=Trust.TRUSTED,
                    figures=figures,
                    seconds={"total": 0.5},
                    finished="2026-01-01T00:00:00+00:00",
                )
            )
    return out


def turned(angle_deg: float) -> Float:
    """Return a pose with this rotation error against the identity, and a translation error of 1 cm per degree."""
    pose = p2o.se3.exp(np.array([0, 0, np.radians(angle_deg), 0, 0, 0]))
    return p2o.se3.make(pose[:3, :3], [0.01 * angle_deg, 0, 0])


def spread(middle: float, half: float) -> list[float]:
    """Return errors of `FRAMES` groups around a mean."""
    return list(np.linspace(middle - half, middle + half, FRAMES))


def written(folder: Path, rows: Sequence[Row], suite: str = SUITE) -> Path:
    """Write suite, rows and their frames to a folder, and return the page that the command writes."""
    (folder / "suites").mkdir(parents=True, exist_ok=True)
    (folder / "suites/tiny.toml").write_text(suite)
    (folder / "study.toml").write_text(STUDY)
    results = Rows(folder / "results")
    results.make_folder()
    for row in rows:
        results.put("tiny", row)
    assert main(command(folder)) == 0
    return folder / "page/index.html"


def command(folder: Path) -> list[str]:
    """Return the command that writes the page of a folder."""
    places: Mapping[str, str] = {"--results": "results", "--suites": "suites", "--out": "page"}
    options = [word for option, name in places.items() for word in (option, str(folder / name))]
    return ["benchmark", "page", *options, "--plugin", str(PLUGIN), "--quiet"]
