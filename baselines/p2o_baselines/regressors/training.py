"""Training of a regressor: wrong starts drawn anew in each step, resumable after a kill, seeded."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
from p2o import InputError, TrainingGroup, TrainingProgress
from p2o.files.input_file import expanded
from p2o.files.whole_file import write_whole
from torch import Tensor, nn

from p2o_baselines.regressors import losses
from p2o_baselines.regressors.batch import Batch, correction
from p2o_baselines.regressors.decalibration import Reach
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.lesson import Lesson
from p2o_baselines.regressors.options import Augmentation, TrainingOptions
from p2o_baselines.regressors.parts import PairNetwork
from p2o_baselines.regressors.sample import Sample, sample, shrunk, view
from p2o_baselines.regressors.weights_file import Trained, branch_tensors, read_tensors, read_weights, write_tensors
from p2o_baselines.regressors.weights_file import write_weights as _write_weights

CHECKPOINT_S = 120.0
"""A state to go on from is written at least this often."""
_STILL = Augmentation(zoom=1, mirror=False, light=0, thin=1)
_CHECKED = 4
"""Starts by which every held-out lesson is looked at."""
_SAME = ("size", "stages", "batch", "seed", "from_weights", "branches", "points")


@dataclass(frozen=True, eq=False)
class School:
    """Lessons to learn from: by group of data, by drive; `share` (G,) of a batch that each group makes up."""

    drives: Sequence[Sequence[Sequence[Lesson]]]
    share: np.ndarray
    design: Design
    options: TrainingOptions

    @property
    def reaches(self) -> Sequence[Reach]:
        """Ranges of starts."""
        return self.options.stages or self.design.stages

    def window(self, rng: np.random.Generator, augmentation: Augmentation) -> list[Sample]:
        """Return the samples of a window drawn by chance: neighbours of one drive, seen alike."""
        group = self.drives[min(int(np.searchsorted(np.cumsum(self.share), rng.random())), len(self.share) - 1)]
        sizes = np.array([len(drive) for drive in group], np.float64)
        drive = group[int(rng.choice(len(group), p=sizes / sizes.sum()))]
        count = self.design.window
        # A drive of fewer frames fills its window by showing frames again.
        first = int(rng.integers(max(1, len(drive) - count + 1)))
        chosen = [drive[(first + i) % len(drive)] for i in range(count)]
        return self.seen(chosen, rng, augmentation)

    def seen(self, lessons: Sequence[Lesson], rng: np.random.Generator, augmentation: Augmentation) -> list[Sample]:
        """Return the samples of lessons in one view drawn by chance."""
        seen = view(self.reaches, augmentation, rng)
        size, channels = self.design.pictures[self.options.size], self.design.channels
        points, with_truth = self.options.points, self.design.needs_true_map
        before = [None, *lessons[:-1]]
        return [
            sample(each, seen, size, channels, points, augmentation, rng, earlier, with_truth=with_truth)
            for each, earlier in zip(lessons, before, strict=True)
        ]

    def batch(self, step: int) -> list[Sample]:
        """Return the samples of a step: the same for the same seed and step."""
        rng = np.random.default_rng([self.options.seed, step])
        count = max(1, self.options.batch // self.design.window)
        return [each for _ in range(count) for each in self.window(rng, self.options.augmentation)]


def train(
    design: Design,
    options: TrainingOptions,
    groups: Sequence[TrainingGroup],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[TrainingProgress], None] = lambda progress: None,
) -> Path:
    """Train into the folder `out` and return the weights file; a training that was stopped goes on.

    Writes `weights.safetensors` (half precision), `state.safetensors` (to go on from) and `log.csv`. Raises InputError
    where there is nothing to train on or `out` holds another training.
    """
    groups = [group for group in groups if len(group.paths) and group.share > 0]
    if not groups:
        raise InputError("nothing to train on", expected="at least one labelled frame", got="none")
    torch.manual_seed(options.seed)
    network = _first(design, options)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network.to(device)
    optimizer = torch.optim.AdamW(network.parameters(), options.learning_rate, weight_decay=options.weight_decay)
    average = {name: value.detach().clone() for name, value in network.state_dict().items()}
    state, weights = out / "state.safetensors", out / "weights.safetensors"
    start = _resume(state, design, options, network, optimizer, average) if state.exists() else 0
    if start >= options.iterations and weights.exists():
        return weights
    share = np.array([group.share for group in groups])
    school = School([_drives(g.paths, design, options) for g in groups], share / share.sum(), design, options)
    checks = [shrunk(Lesson.load(path), design.pictures[options.size], 1.0) for path in validation]
    kept = average if options.average else network.state_dict()
    log = _Log(out, start)
    spent: list[float] = []
    began = saved = time.monotonic()
    with ThreadPoolExecutor(1) as ahead:
        coming = ahead.submit(school.batch, start)
        for step in range(start, options.iterations):
            samples = coming.result()
            if step + 1 < options.iterations:
                coming = ahead.submit(school.batch, step + 1)
            for group in optimizer.param_groups:
                group["lr"] = rate(options, step)
            spent.append(_step(network, optimizer, Batch.of(samples, design.window, device), design, options.match))
            if options.average:
                _move_average(average, network, min(options.average, (step + 1) / (step + 10)))
            done = step + 1
            due = done % options.validate_every == 0 or done == options.iterations
            if due:
                judged = _with_state(design, options, kept, device)
                found = validate(judged, checks, school, device) if checks else None
                progress = TrainingProgress(
                    done, options.iterations, float(np.mean(spent)), found, time.monotonic() - began
                )
                log.add(progress, rate(options, step))
                spent = []
                trained = Trained(
                    design.name, options.size, tuple(school.reaches), {"steps": str(done), "seed": str(options.seed)}
                )
                _write_weights(judged, trained, weights)
            if due or time.monotonic() - saved > CHECKPOINT_S:
                _save_state(state, design, options, network, optimizer, average, done)
                saved = time.monotonic()
            if due:
                # Last, so that a report that raises loses nothing.
                report(progress)
    return weights


def rate(options: TrainingOptions, step: int) -> float:
    """Return the learning rate of a step: 3 % warm-up, then a cosine to zero."""
    warm = max(1.0, 0.03 * options.iterations)
    part = min(1.0, max(0.0, (step - warm) / max(1.0, options.iterations - warm)))
    return options.learning_rate * min(1.0, (step + 1) / warm) * 0.5 * (1 + float(np.cos(np.pi * part)))


def validate(network: PairNetwork, lessons: Sequence[Lesson], school: School, device: torch.device) -> float:
    """Return the mean loss over held-out lessons, each from a few wrong starts that are always the same."""
    found = []
    with torch.inference_mode():
        for number, lesson in enumerate(lessons):
            rng = np.random.default_rng([7, number])
            samples = [
                each for _ in range(_CHECKED) for each in school.seen([lesson] * school.design.window, rng, _STILL)
            ]
            found.append(float(_loss(network, Batch.of(samples, school.design.window, device), school.design)))
    return float(np.mean(found))


def _loss(network: PairNetwork, batch: Batch, design: Design, match: float = 0.0) -> Tensor:
    picture, sweep = network.features(batch.picture, batch.sweep)
    raw = network.said(picture, sweep, batch.reach, batch.window)
    loss = design.loss(raw, correction(raw, batch.reach, design.form), batch)
    if match:
        height, width = batch.picture.shape[2:]
        loss = loss + match * losses.matching(picture, sweep, (height, width), batch)
    return loss


def _step(
    network: PairNetwork, optimizer: torch.optim.Optimizer, batch: Batch, design: Design, match: float = 0.0
) -> float:
    network.train()
    loss = _loss(network, batch, design, match)
    optimizer.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(network.parameters(), 5.0)
    optimizer.step()
    return float(loss.detach())


def _drives(paths: Sequence[Path], design: Design, options: TrainingOptions) -> list[list[Lesson]]:
    """Return the lessons of label files by drive, in the order of the files."""
    size, zoom = design.pictures[options.size], options.augmentation.zoom
    lessons = [shrunk(Lesson.load(path), size, zoom) for path in paths]
    return [list(drive) for _, drive in groupby(lessons, key=lambda each: each.group)]


def _first(design: Design, options: TrainingOptions) -> PairNetwork:
    """Return the network that a training begins with."""
    network = design.network(options.size)
    if options.branches:
        network.load_state_dict(branch_tensors(expanded(options.branches), network), strict=False)
    if options.from_weights:
        path = expanded(options.from_weights)
        network, trained = read_weights(path, design)
        if trained.size != options.size:
            raise InputError(
                "the weights to begin from are of another size", where=path, expected=options.size, got=trained.size
            )
    return network.train()


def _move_average(average: dict[str, Tensor], network: PairNetwork, decay: float) -> None:
    for name, value in network.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


def _with_state(
    design: Design, options: TrainingOptions, state: dict[str, Tensor], device: torch.device
) -> PairNetwork:
    network = design.network(options.size)
    network.load_state_dict(state)
    return network.to(device).eval()


def _fingerprint(design: Design, options: TrainingOptions) -> str:
    said = options.model_dump(mode="json")
    return json.dumps({"method": design.name, **{name: said[name] for name in _SAME}})


def _save_state(
    path: Path,
    design: Design,
    options: TrainingOptions,
    network: PairNetwork,
    optimizer: torch.optim.Optimizer,
    average: dict[str, Tensor],
    step: int,
) -> None:
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    tensors |= {f"average.{name}": value for name, value in average.items()}
    for number, memory in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in memory.items()}
    write_tensors(path, tensors, {"step": str(step), "training": _fingerprint(design, options)})


def _resume(
    path: Path,
    design: Design,
    options: TrainingOptions,
    network: PairNetwork,
    optimizer: torch.optim.Optimizer,
    average: dict[str, Tensor],
) -> int:
    tensors, header = read_tensors(path, "state of a training")
    if header.get("training") != _fingerprint(design, options):
        raise InputError(
            "the folder holds another training",
            where=path,
            expected=header.get("training", f"a state of {design.name}"),
            got=_fingerprint(design, options),
            hint="choose another --out, or the same options to go on",
        )
    network.load_state_dict({n[8:]: v for n, v in tensors.items() if n.startswith("network.")})
    memory: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("average."):
            average[name[8:]].copy_(value)
        elif name.startswith("optimizer."):
            _, number, what = name.split(".", 2)
            memory.setdefault(int(number), {})[what] = value
    state = optimizer.state_dict()
    state["state"] = memory
    optimizer.load_state_dict(state)
    return int(header["step"])


class _Log:
    """`log.csv`, a line a report."""

    def __init__(self, out: Path, start: int) -> None:
        self.path = out / "log.csv"
        out.mkdir(parents=True, exist_ok=True)
        if self.path.exists():
            head, *lines = self.path.read_text().splitlines() or [""]
            # Steps that were lost with a kill come again.
            kept = [line for line in lines if line.partition(",")[0].isdigit() and int(line.partition(",")[0]) <= start]
            write_whole(self.path, "".join(f"{line}\n" for line in (head, *kept)).encode())

    def add(self, progress: TrainingProgress, learning_rate: float) -> None:
        fresh = not self.path.exists()
        with self.path.open("a", newline="") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", "loss", "validation", "learning_rate", "seconds"])
            validation = "" if progress.validation is None else f"{progress.validation:.5f}"
            writer.writerow(
                [progress.step, f"{progress.loss:.5f}", validation, f"{learning_rate:.3g}", f"{progress.seconds:.1f}"]
            )
