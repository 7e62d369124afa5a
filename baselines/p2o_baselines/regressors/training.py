"""Train a regressor on decalibrated samples: seeded, with checkpoints, and resumable."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
from p2o import InputError, TrainingGroup, TrainingProgress, TrainingState, cosine_rate, run_steps
from p2o.reading import expanded
from torch import Tensor

from p2o_baselines.regressors import losses
from p2o_baselines.regressors.batch import Batch, correction
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.options import Augmentation, TrainingOptions
from p2o_baselines.regressors.parts import PairNetwork
from p2o_baselines.regressors.sample import AugmentedSample, Reach, Sample, augment, draw_view, shrunk
from p2o_baselines.regressors.weights_file import Trained, branch_tensors, read_weights, write_weights

_NO_AUGMENTATION = Augmentation(zoom=1, mirror=False, light=0, thin=1)
_VALIDATION_STARTS = 4  # initial extrinsics from which each held-out sample is evaluated
_FIXED_OPTIONS = ("size", "stages", "batch", "seed", "from_weights", "branches", "points")
"""Options that must not change when a training is resumed."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Samples by group of data and by drive; `share` (G,) is the part of a batch that each group makes up."""

    drives: Sequence[Sequence[Sequence[Sample]]]
    share: np.ndarray
    design: Design
    options: TrainingOptions

    @property
    def reaches(self) -> Sequence[Reach]:
        """Return the ranges of initial errors, one per stage."""
        return self.options.stages or self.design.stages

    def draw_window(self, rng: np.random.Generator, augmentation: Augmentation) -> list[AugmentedSample]:
        """Draw a window of successive samples of one drive, augmented with the same view."""
        group = self.drives[min(int(np.searchsorted(np.cumsum(self.share), rng.random())), len(self.share) - 1)]
        sizes = np.array([len(drive) for drive in group], np.float64)
        drive = group[int(rng.choice(len(group), p=sizes / sizes.sum()))]
        count = self.design.window
        # A drive with fewer frames than the window repeats its frames.
        first = int(rng.integers(max(1, len(drive) - count + 1)))
        return self.augmented([drive[(first + i) % len(drive)] for i in range(count)], rng, augmentation)

    def augmented(
        self, samples: Sequence[Sample], rng: np.random.Generator, augmentation: Augmentation
    ) -> list[AugmentedSample]:
        """Return samples augmented with the same random view."""
        view = draw_view(self.reaches, augmentation, rng)
        size, channels = self.design.inputs[self.options.size], self.design.channels
        points, with_truth = self.options.points, self.design.needs_true_map
        previous = [None, *samples[:-1]]
        return [
            augment(sample, view, size, channels, points, augmentation, rng, before, with_truth=with_truth)
            for sample, before in zip(samples, previous, strict=True)
        ]

    def batch(self, step: int) -> list[AugmentedSample]:
        """Return the samples of a step, which depend on the seed and the step only."""
        rng = np.random.default_rng([self.options.seed, step])
        count = max(1, self.options.batch // self.design.window)
        return [sample for _ in range(count) for sample in self.draw_window(rng, self.options.augmentation)]


def train(
    design: Design,
    options: TrainingOptions,
    groups: Sequence[TrainingGroup],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[TrainingProgress], None] = lambda progress: None,
) -> Path:
    """Train into the folder `out`, or resume the training in it, and return the weights file.

    Writes `weights.safetensors` (half precision), the checkpoint `state.safetensors`, `log.csv`, and TensorBoard events
    if tensorboard is installed. Raises InputError if there is no sample or `out` holds another training.
    """
    groups = [group for group in groups if len(group.paths) and group.share > 0]
    if not groups:
        raise InputError("nothing to train on", expected="at least one labelled frame", got="none")
    torch.manual_seed(options.seed)
    network = _initial_network(design, options)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network.to(device)
    optimizer = torch.optim.AdamW(network.parameters(), options.learning_rate, weight_decay=options.weight_decay)
    fixed = options.model_dump(mode="json")
    identity = json.dumps({"method": design.name, **{name: fixed[name] for name in _FIXED_OPTIONS}})
    state = TrainingState(out / "state.safetensors", identity, network, optimizer, options.average)
    weights = out / "weights.safetensors"
    start = state.resume()
    if start >= options.iterations and weights.exists():
        return weights
    share = np.array([group.share for group in groups])
    drives = [_drives(group.paths, design, options) for group in groups]
    training_set = TrainingSet(drives, share / share.sum(), design, options)
    held_out = [shrunk(Sample.load(path), design.inputs[options.size], 1.0) for path in validation]

    def loss(samples: Sequence[AugmentedSample]) -> Tensor:
        network.train()
        return _loss(network, Batch.of(samples, design.window, device), design, options.match)

    def publish(step: int) -> float | None:
        published = design.network(options.size)
        published.load_state_dict(state.weights)
        published.to(device).eval()
        validation_loss = validate(published, held_out, training_set, device) if held_out else None
        about = {"steps": str(step), "seed": str(options.seed)}
        write_weights(published, Trained(design.name, options.size, tuple(training_set.reaches), about), weights)
        return validation_loss

    run_steps(
        state,
        start,
        options.iterations,
        batch=training_set.batch,
        loss=loss,
        rate=lambda step: cosine_rate(options.learning_rate, step, options.iterations),
        validate_every=options.validate_every,
        validate=publish,
        report=report,
        workers=options.workers,
    )
    return weights


def validate(network: PairNetwork, samples: Sequence[Sample], training_set: TrainingSet, device: torch.device) -> float:
    """Return the mean loss over held-out samples, each from a few initial extrinsics that are always the same."""
    values = []
    window = training_set.design.window
    with torch.inference_mode():
        for number, sample in enumerate(samples):
            rng = np.random.default_rng([7, number])
            drawn = []
            for _ in range(_VALIDATION_STARTS):
                drawn += training_set.augmented([sample] * window, rng, _NO_AUGMENTATION)
            values.append(float(_loss(network, Batch.of(drawn, window, device), training_set.design)))
    return float(np.mean(values))


def _loss(network: PairNetwork, batch: Batch, design: Design, match: float = 0.0) -> Tensor:
    image, sweep = network.features(batch.image, batch.sweep)
    raw = network.regress(image, sweep, batch.reach, batch.window)
    loss = design.loss(raw, correction(raw, batch.reach, design.form), batch)
    if match:
        height, width = batch.image.shape[2:]
        loss = loss + match * losses.matching(image, sweep, (height, width), batch)
    return loss


def _drives(paths: Sequence[Path], design: Design, options: TrainingOptions) -> list[list[Sample]]:
    """Return the samples of label files by drive, in the order of the files."""
    size, zoom = design.inputs[options.size], options.augmentation.zoom
    samples = [shrunk(Sample.load(path), size, zoom) for path in paths]
    return [list(drive) for _, drive in groupby(samples, key=lambda sample: sample.group)]


def _initial_network(design: Design, options: TrainingOptions) -> PairNetwork:
    """Return the network with random weights or those that the options name."""
    network = design.network(options.size)
    if options.branches:
        network.load_state_dict(branch_tensors(expanded(options.branches), network), strict=False)
    if options.from_weights:
        path = expanded(options.from_weights)
        network, trained = read_weights(path, design)
        if trained.size != options.size:
            what = "the initial weights are of another size"
            raise InputError(what, where=path, expected=options.size, got=trained.size)
    return network.train()
