"""Folders of results with constructed rows, for the page of the benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o.cli import main
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import FrameData, Row

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


def frame(dataset: str, number: int) -> FrameData:
    """Return a frame with the identity as ground truth."""
    plain = {"dataset": dataset, "name": f"drive/{number:03d}", "truth": np.eye(4).tolist()}
    return FrameData.model_validate(plain | dict.fromkeys(("image", "sweep", "calibration"), f"{number:064x}"))


def rows_of(
    label: str, errors: Sequence[float], *, dataset: str = "first", joint: int = 1, start: float = 2.0, **values: Any
) -> list[Row]:
    """Return rows of `FRAMES` calibrations with five seeds, with these rotation errors in degrees by calibration."""
    out = []
    for group, error in enumerate(errors):
        frames = [frame(dataset, group * joint + number) for number in range(joint)]
        for seed in range(5):
            plain = {
                "suite": "tiny",
                "row": label,
                "dataset": dataset,
                "frames": [{"name": known.name, "digest": known.digest} for known in frames],
                "joint": joint > 1,
                "protocol": f"{start:g}deg 0.05m",
                "seed": seed,
                "start": turned(start),
                "method": {"words": {"calibrator": "quick"}},
                "digest": "1" * 64,
                "commit": "abc",
                "estimate": turned(error),
                "status": "converged",
                "verdict": "trusted",
                "predicted": {
                    "rotation_deg": 0.4,
                    "translation_m": "inf",
                    "rotation_deg_95": 0.8,
                    "translation_m_95": 1,
                },
                "seconds": 0.5,
                "machine": {},
                "measured_by": "tests",
                "finished": "2026-01-01T00:00:00+00:00",
            }
            out.append(Row.model_validate(plain | values))
    return out


def turned(angle_deg: float) -> list[list[float]]:
    """Return a pose with this rotation error against the identity, and a translation error of 1 cm per degree."""
    pose = p2o.se3.exp(np.array([0, 0, np.radians(angle_deg), 0, 0, 0]))
    return p2o.se3.make(pose[:3, :3], [0.01 * angle_deg, 0, 0]).tolist()  # type: ignore[no-any-return]


def spread(middle: float, half: float) -> list[float]:
    """Return errors of `FRAMES` groups around a mean."""
    return list(np.linspace(middle - half, middle + half, FRAMES))


def written(folder: Path, rows: Sequence[Row], suite: str = SUITE) -> Path:
    """Write suite, rows and their frames to a folder, and return the page that the command writes."""
    (folder / "suites").mkdir(parents=True, exist_ok=True)
    (folder / "suites/tiny.toml").write_text(suite)
    (folder / "study.toml").write_text(STUDY)
    frames = {
        (row.dataset, known.name): frame(row.dataset, int(known.name[-3:])) for row in rows for known in row.frames
    }
    Results(folder / "results").add("tiny", rows, frames.values())
    assert main(command(folder)) == 0
    return folder / "page/index.html"


def command(folder: Path) -> list[str]:
    """Return the command that writes the page of a folder."""
    places: Mapping[str, str] = {"--results": "results", "--suites": "suites", "--out": "page"}
    options = [word for option, name in places.items() for word in (option, str(folder / name))]
    return ["benchmark", "page", *options, "--plugin", str(PLUGIN), "--quiet"]
