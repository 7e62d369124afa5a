"""A plugin of the tests: a method that learns without any network, on frames that cost nothing."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import p2o


class TrainingOptions(p2o.Options):
    """How it learns."""

    steps: int = p2o.field(2, ge=1, help="Reports.")
    seed: int = p2o.field(0, ge=0, help="Seed.")
    package: str = p2o.field("json", help="A package that training imports.")


class FrameOptions(p2o.Options):
    """Which frames there are."""

    names: str = p2o.field("d1/0 d1/1 d2/0", help="Names.")
    blank: str = p2o.field("", help="The frame of this name teaches nothing.")


class Frames(Sequence[p2o.Frame]):
    """Empty frames under given names."""

    def __init__(self, options: FrameOptions) -> None:
        self.names = tuple(options.names.split())
        self.blank = options.blank

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        camera = p2o.Camera("SIMPLE_PINHOLE", 8, 6, (5.0, 4.0, 3.0))
        image = p2o.Image(np.zeros((6, 8, 3), np.uint8), camera)
        name = self.names[index]
        return p2o.Frame(name, image, p2o.Cloud(np.full((1, 3), 1.0 - 2 * (name == self.blank))))


def label(frame: p2o.Frame) -> bytes:
    """Return the name: what can be learnt of it."""
    if frame.cloud.xyz[0, 0] < 0:
        raise p2o.InputError("the frame teaches nothing", where=frame.name)
    return frame.name.encode()


def draw(path: Path) -> Any:
    """Return a picture that is as wide as the name."""
    return np.zeros((2, len(path.read_bytes()), 3), np.uint8)


def train(options: Any, groups: Any, validation: Any, out: Path, report: Any) -> Path:
    """Write what it was given as the weights."""
    __import__(options.package)
    told = {
        "groups": [[g.name, g.share, [p.read_text() for p in g.paths]] for g in groups],
        "validation": [p.read_text() for p in validation],
        "seed": options.seed,
    }
    with (out / "log.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["step", "loss", "validation", "learning_rate"])
        for step in range(1, options.steps + 1):
            writer.writerow([step, 1 / step, "", 0.1])
            report(p2o.TrainingProgress(step, options.steps, 1 / step, None, float(step)))
    weights = out / "weights.json"
    weights.write_text(json.dumps(told))
    return weights


def build(options: Any) -> Any:
    """Return nothing of use."""
    return lambda frames, start: None


@p2o.hookimpl
def p2o_datasets():
    """Offer the frames."""
    yield p2o.Method(name="named", build=Frames, options=FrameOptions, summary="Frames of given names.")


@p2o.hookimpl
def p2o_solvers():
    """Offer the method that learns, and one that does not."""
    trainer = p2o.Trainer(
        options=TrainingOptions, presets={"long": {"steps": 5}}, label=label, draw=draw, train=train, suffix=".txt"
    )
    yield p2o.Method(name="pupil", build=build, summary="Learns names.", trainer=trainer)
    yield p2o.Method(name="stone", build=build, summary="Learns nothing.")
