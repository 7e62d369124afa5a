"""Train P2ORNet with balanced cross entropy on labelled crops: seeded, with checkpoints, and resumable."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import p2o
import torch
from p2o import Bool, Float, InputError, TrainingGroup, TrainingState, UnknownNameError, cosine_rate, run_steps
from torch import Tensor, nn

from p2o_plugins.p2ornet import calibration
from p2o_plugins.p2ornet.augment import Crop, crop
from p2o_plugins.p2ornet.design import PLANS, Shape
from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.loss import order_loss
from p2o_plugins.p2ornet.network import P2ORNet, order_probabilities, placed
from p2o_plugins.p2ornet.options import Augmentation, TrainingOptions
from p2o_plugins.p2ornet.shipped import weights_named
from p2o_plugins.p2ornet.thinning import peaks, side_probabilities
from p2o_plugins.p2ornet.weights import load_weights, save_weights

_FIXED_OPTIONS = ("encoder", "batch", "crop_px", "seed", "from_weights")
"""Options that must not change when a training is resumed."""


def train(
    options: TrainingOptions,
    groups: Sequence[TrainingGroup],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[p2o.TrainingProgress], None] = lambda progress: None,
) -> Path:
    """Train into the folder `out`, or resume the training in it, and return the weights file.

    Writes `weights.safetensors` (half precision), the checkpoint `state.safetensors`, `log.csv`, and TensorBoard events
    if tensorboard is installed. Crops depend on seed and step only, so that a resumed training gets the same crops as
    an uninterrupted one. Raises InputError if there is no example or `out` holds another training, UnknownNameError if
    `settle_on` names no group or `from_weights` no file.
    """
    groups = [g for g in groups if len(g.paths) and g.share > 0]
    if not groups:
        raise InputError("nothing to train on", expected="at least one labelled frame", got="none")
    settled_on = [g for g in groups if options.settle_on in ("", g.name)]
    if not settled_on:
        raise UnknownNameError("data", options.settle_on, [g.name for g in groups], where="settle_on")
    torch.manual_seed(options.seed)
    shape = Shape.of(options.encoder)
    network = _initial_network(options, shape)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    placed(network, device)
    fixed = options.model_dump(mode="json")
    identity = json.dumps({"method": "p2ornet", **{name: fixed[name] for name in _FIXED_OPTIONS}})
    optimizer = _optimizer(options, network)
    state = TrainingState(out / "state.safetensors", identity, network, optimizer, options.average)
    weights = out / "weights.safetensors"
    start = state.resume()
    about = {"seed": str(options.seed)}
    steps = max(start, options.iterations)
    finished = {**about, "steps": str(steps), "settled": f"{options.settle} {options.settle_on}".strip()}
    if start >= options.iterations and weights.exists() and finished.items() <= load_weights(weights)[1].about.items():
        return weights
    held_out = [Example.load(path) for path in validation]

    def published() -> P2ORNet:
        network = P2ORNet.of(shape)
        network.load_state_dict(state.weights)
        return placed(network, device).eval()

    def publish(step: int) -> float | None:
        network = published()
        loss = validate(network, held_out, options, device) if held_out else None
        save_weights(network.tensors(), replace(shape, about={**about, "steps": str(step)}), weights)
        return loss

    if start < options.iterations:
        bank, share = [group.paths for group in groups], _shares(groups)
        run_steps(
            state,
            start,
            options.iterations,
            batch=partial(_batch, bank, share, options),
            loss=lambda crops: _loss(network, crops, options, device),
            rate=lambda step: rate(options, step),
            validate_every=options.validate_every,
            validate=publish,
            report=report,
            workers=options.workers,
        )
    final = published()
    if options.settle:
        settle(final, settled_on, options, options.settle)
    if held_out and options.calibrate:
        finished["calibration"] = calibration_of(final, held_out)
    save_weights(final.tensors(), replace(shape, about=finished), weights)
    return weights


def _shares(groups: Sequence[TrainingGroup]) -> Float:
    """Return the part (N,) of every batch that each group makes up."""
    return np.array([group.share for group in groups]) / sum(group.share for group in groups)


def _initial_network(options: TrainingOptions, shape: Shape) -> P2ORNet:
    """Return the network that a training begins with."""
    if not options.from_weights:
        network = P2ORNet.of(shape)
        imagenet = options.imagenet_file()
        if imagenet is not None:
            load_imagenet(network, imagenet)
        return network
    path = weights_named(options.from_weights).path
    tensors, stored_shape = load_weights(path)
    if replace(stored_shape, about={}) != replace(shape, about={}):
        raise InputError(
            "the weights to begin from are of another network",
            where=path,
            expected=f"{shape.encoder}, widths {shape.widths}, connectivity {shape.connectivity}",
            got=f"{stored_shape.encoder}, widths {stored_shape.widths}, connectivity {stored_shape.connectivity}",
            hint=f"--encoder {stored_shape.encoder}",
        )
    return P2ORNet.of(shape, tensors)


def load_imagenet(network: P2ORNet, path: Path) -> None:
    """Give the encoder its ImageNet weights; the file is read without running anything in it."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        kept = {k: v for k, v in state.items() if not k.startswith(PLANS[network.shape.encoder].unused)}
        network.encoder.load_state_dict(kept, strict=True)
    except Exception as problem:  # torch raises its own, OSError, RuntimeError, UnpicklingError, AttributeError
        raise InputError(
            "ImageNet weights cannot be read",
            where=path,
            expected=f"a state_dict of {network.shape.encoder}",
            got=str(problem).splitlines()[0] if str(problem) else type(problem).__name__,
        ) from problem


def _optimizer(options: TrainingOptions, network: P2ORNet) -> torch.optim.AdamW:
    inside = [p for n, p in network.named_parameters() if n.startswith("encoder.")]
    outside = [p for n, p in network.named_parameters() if not n.startswith("encoder.")]
    groups = [{"params": inside, "share": options.encoder_share}, {"params": outside, "share": 1.0}]
    return torch.optim.AdamW(groups, options.learning_rate, (options.beta1, 0.999), weight_decay=options.weight_decay)


def rate(options: TrainingOptions, step: int) -> float:
    """Return the learning rate of a step (Sec. IV-A of the paper for "halved": a tenth from half of the steps on)."""
    if options.schedule == "halved":
        return options.learning_rate * (1.0 if step < options.iterations / 2 else 0.1)
    return cosine_rate(options.learning_rate, step, options.iterations)


def _batch(bank: Sequence[Sequence[Path]], share: Float, options: TrainingOptions, step: int) -> list[Crop]:
    """Draw the crops of a step; examples are read when they are drawn, so that memory does not limit their number."""
    rng = np.random.default_rng([options.seed, step])
    crops = []
    for place in range(options.batch):
        # The samples of a batch are distributed evenly over the groups; only the remainder is random.
        which = int(np.searchsorted(np.cumsum(share), (place + rng.random()) / options.batch, side="right"))
        examples = bank[min(which, len(bank) - 1)]
        example = Example.load(examples[int(rng.integers(len(examples)))])
        crops.append(crop(example, options.crop_px, options.augmentation, rng))
    return crops


def collated(crops: Sequence[Crop], device: torch.device) -> tuple[Tensor, ...]:
    """Return images (B, 3, h, w) in 0..1, classes (B, 2, h, w), and all bags, their classes and weights."""
    rgb = torch.from_numpy(np.stack([c.rgb for c in crops])).permute(0, 3, 1, 2).to(device).float() / 255
    classes = torch.from_numpy(np.stack([c.classes for c in crops])).to(device)
    size = crops[0].classes.size
    bags = np.concatenate([np.where(c.bags >= 0, c.bags + i * size, UNKNOWN) for i, c in enumerate(crops)])
    bag_class = np.concatenate([c.bag_class for c in crops])
    weight = np.concatenate([c.bag_weight for c in crops]).astype(np.float32)
    labels = (torch.from_numpy(values).to(device) for values in (bags, bag_class, weight))
    return (rgb.contiguous(memory_format=torch.channels_last), classes, *labels)


def _loss(network: P2ORNet, crops: Sequence[Crop], options: TrainingOptions, device: torch.device) -> Tensor:
    network.train()
    if _frozen(options):
        for module in network.encoder.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
    rgb, classes, bags, bag_class, bag_weight = collated(crops, device)
    with torch.autocast(device.type, torch.bfloat16, enabled=_bfloat16(options, device)):
        logits = network(rgb)
    loss = order_loss(logits[:, :2], classes, bags, bag_class, bag_weight, *weights_of(options))
    return loss / len(crops)


def _frozen(options: TrainingOptions) -> bool:
    """Return whether the encoder keeps its batch-norm statistics, which exist only after pretraining."""
    return options.freeze_norm and (bool(options.from_weights) or options.imagenet_file() is not None)


def weights_of(options: TrainingOptions) -> tuple[float, float, float]:
    """Return the weights of the parts of the loss."""
    return options.occlusion_weight, options.unknown_weight, options.direction_weight


def _bfloat16(options: TrainingOptions, device: torch.device) -> bool:
    if options.precision == "auto":
        return device.type == "cuda" or bool(torch.cpu._is_amx_tile_supported())
    return options.precision == "bfloat16"


def validate(network: P2ORNet, examples: Sequence[Example], options: TrainingOptions, device: torch.device) -> float:
    """Return the mean loss over whole images."""
    still = Augmentation(scale=1, mirror=False, light=0, blur_px=0, noise=0)
    total = 0.0
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=_bfloat16(options, device)):
        for example in examples:
            whole = crop(example, (example.rgb.shape[0], example.rgb.shape[1]), still, np.random.default_rng(0))
            rgb, classes, bags, bag_class, bag_weight = collated([whole], device)
            logits = network(rgb)[:, :2]
            total += float(order_loss(logits, classes, bags, bag_class, bag_weight, *weights_of(options)))
    return total / len(examples)


def settle(network: P2ORNet, groups: Sequence[TrainingGroup], options: TrainingOptions, batches: int = 40) -> None:
    """Measure the decoder's batch-norm statistics again on crops of these groups, in place.

    During training they are those of the last few batches of another mixture of images.
    """
    device = next(network.parameters()).device
    bank, share = [group.paths for group in groups], _shares(groups)
    network.eval()
    fixed = _frozen(options)
    for name, module in network.named_modules():
        if isinstance(module, nn.BatchNorm2d) and not (fixed and name.startswith("encoder.")):
            module.reset_running_stats()
            module.momentum = None
            module.train()
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=_bfloat16(options, device)):
        for number in range(batches):
            rgb, *_ = collated(_batch(bank, share, options, 10**9 + number), device)
            network(rgb)
    network.eval()


def calibration_of(network: P2ORNet, examples: Sequence[Example]) -> str:
    """Return slope and offset of the calibrated confidence from the scores of held-out examples, as text.

    The identity for examples with too few edges.
    """
    score, right = reached(network, examples)
    if right.sum() < 100 or (~right).sum() < 100:
        return "1 0"
    slope, offset = calibration.fit(score, right)
    return f"{slope:.4f} {offset:.4f}"


def reached(network: P2ORNet, examples: Sequence[Example]) -> tuple[Float, Bool]:
    """Return the scores (M,) of detected edges with a known verdict and whether they are right (M,)."""
    parts = []
    for example in examples:
        edges = peaks(side_probabilities(order_probabilities(network, example.rgb)), min_score=0.02)
        parts.append(calibration.verdicts(edges, example))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
