"""Train the default weights of P2ORNet on simulated places only: render, train and evaluate, in one resumable command.

    python benchmarks/train_free.py --size cpu --out build/free

Frames are rendered by `--renderers` processes while the training runs on those that are there: it begins with a part of
the places and takes more at fixed steps, for which it waits. The same command continues after an interruption. The real
rigs of build/data, if they are there, are then calibrated with the weights before and after (`left_out.py compare`).
On a machine with a GPU that is lent for nine minutes: --size gpu --minutes 8.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

from left_out import Row, collect, compared
from limits_and_tables import read_rows
from p2o import TrainingGroup, TrainingProgress
from p2o.host.registry import Registry
from p2o_train.guarded_trainer import trainer_of
from p2o_train.train import Source, sources_of, trainable, write_labels
from rigs import RIGS

_COMMON = "megapixels=0.5&mask_foliage=true&right=false&weather=any"
DATA = {
    "vehicle": (f"rig=random-vehicle&place=varied&{_COMMON}", 0.4, 0.4),
    "roads": (f"rig=random-vehicle&place=mixed&{_COMMON}", 0.25, 0.25),
    "anywhere": (f"rig=random-rings&place=anywhere&{_COMMON}", 0.35, 0.35),
}
"""By name: options of the simulator, the share of all places, and the share of every batch."""
SEEDS = {"vehicle": 7001, "roads": 7002, "anywhere": 7003}


@dataclass(frozen=True)
class Size:
    """Number of places, steps, crops in a step, highest learning rate, and processes that draw crops."""

    places: int
    steps: int
    batch: int
    rate: float
    workers: int


SIZES = {"cpu": Size(3000, 12_000, 4, 5e-4, 0), "gpu": Size(3600, 9000, 24, 1e-3, 6)}
STAGES = ((0.05, 0.0), *((part / 10, part / 10 - 0.05) for part in range(1, 10)), (1.0, 0.95))
"""The part of the places that is drawn from, and the part of all steps after which it is."""
HELD_OUT = 10
"""The last places of every kind, which are only used for validation."""


class _NextStageError(Exception):
    """More places are to be drawn from."""


class _TimeIsUpError(Exception):
    """The training has to end: the weights are those of the last validation."""


def sources(places: int) -> list[Source]:
    """Return the data sets of `places` places in all."""
    registry = Registry.load()
    texts = [
        f"{name}=synthetic:?scenes={round(share * places) + HELD_OUT}&seed={SEEDS[name]}&{options}"
        for name, (options, share, _) in DATA.items()
    ]
    return sources_of(trainable("p2ornet", registry), texts, ["all"], registry)


def render(places: int, out: Path, number: int, of: int) -> None:
    """Write every `of`-th label from `number` on, kinds of places in turn; what is there is kept."""
    os.nice(5)
    trainer = trainer_of(trainable("p2ornet", Registry.load()))
    data = sources(places)
    for first in range(0, max(len(source.chosen) for source in data), 10 * of):
        for source in data:
            # The places of the validation first: the training needs them at its beginning.
            order = (*source.chosen[-HELD_OUT:], *source.chosen[:-HELD_OUT])
            write_labels(trainer, [replace(source, chosen=order[first + number : first + 10 * of : of])], out)


def files(source: Source, out: Path) -> list[Path]:
    """Return the label files of a data set in order."""
    trainer = trainer_of(trainable("p2ornet", Registry.load()))
    return [out / source.folder / name for name in source.files(trainer)]


def train(size: Size, out: Path, data: list[list[Path]], start_from: str, minutes: float) -> Path:
    """Train on the label files of each data set, which may still be written, and return the weights.

    After `minutes`, the weights are those of the last validation.
    """
    from p2o_plugins.p2ornet import training
    from p2o_plugins.p2ornet.options import Augmentation, TrainingOptions

    options = TrainingOptions(
        iterations=size.steps, batch=size.batch, learning_rate=size.rate, workers=size.workers, from_weights=start_from,
        precision="bfloat16", validate_every=max(100, size.steps // 60), average=0.999,
        augmentation=Augmentation(scale=1.6, marks=12),
    )  # fmt: skip
    until = time.monotonic() + 60 * minutes
    validation = [path for paths in data for path in paths[-HELD_OUT:]]
    _wait_for(validation)
    for (part, _), (_, stop) in zip(STAGES, (*STAGES[1:], (1.0, 1.01)), strict=True):
        groups = [
            TrainingGroup(name, tuple(paths[: max(1, round(part * (len(paths) - HELD_OUT)))]), share)
            for (name, (_, _, share)), paths in zip(DATA.items(), data, strict=True)
        ]
        _wait_for([path for group in groups for path in group.paths])

        def report(progress: TrainingProgress, stop: float = stop) -> None:
            print(f"step {progress.step}: loss {progress.loss:.4f}, validation {progress.validation:.4f}", flush=True)
            if time.monotonic() > until:
                raise _TimeIsUpError
            if stop * size.steps <= progress.step < size.steps:
                raise _NextStageError

        try:
            training.train(options, groups, validation, out, report)
        except _NextStageError:
            continue
        except _TimeIsUpError:
            break
    return out / "weights.safetensors"


def evaluated(choices: dict[str, str], out: Path) -> str:
    """Return the errors of weights by name on the real rigs, with the choice by all other rigs (`left_out.py`)."""
    rows_of = {}
    for name, weights in choices.items():
        for rig in RIGS:
            if rig.is_real:
                collect(replace(rig, weights=weights), out / name, 12)
        rows_of[name] = [Row.of(values) for values in read_rows(out / name / "rows.jsonl")]
    return compared(rows_of)


def _wait_for(paths: list[Path]) -> None:
    while missing := sum(not path.exists() for path in paths):
        print(f"{missing} of {len(paths)} labels are not rendered yet", flush=True)
        time.sleep(10)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", choices=SIZES, default="cpu")
    parser.add_argument("--out", type=Path, default=Path("build/free"))
    parser.add_argument("--renderers", type=int, default=max(1, (os.cpu_count() or 2) - 1))
    parser.add_argument("--places", type=int, help="instead of the number of the size")
    parser.add_argument("--steps", type=int, help="instead of the number of the size")
    parser.add_argument("--from-weights", default="free", help="weights to begin from; '' for those of ImageNet")
    parser.add_argument("--minutes", type=float, default=1e6, help="longest time of the training")
    given = parser.parse_args()
    size = SIZES[given.size]
    size = replace(size, places=given.places or size.places, steps=given.steps or size.steps)
    labels = given.out / "labels"
    spawn = multiprocessing.get_context("spawn")
    renderers = [
        spawn.Process(target=render, args=(size.places, labels, number, given.renderers), daemon=True)
        for number in range(given.renderers)
    ]
    for process in renderers:
        process.start()
    data = [files(source, labels) for source in sources(size.places)]
    weights = train(size, given.out, data, given.from_weights, given.minutes)
    print(weights)
    for process in renderers:
        process.terminate()
    if Path("build/data").is_dir():
        print(evaluated({"before": given.from_weights or "free", "after": str(weights)}, given.out / "choice"))


if __name__ == "__main__":
    main()
