"""Training of P2ORNet: balanced cross entropy over labelled crops, resumable after a kill, seeded."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from p2o import InputError, TrainingGroup, TrainingProgress, UnknownNameError
from p2o.arrays import Bool, Float
from p2o.files.whole_file import write_whole
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from p2o_plugins.p2ornet import calibration
from p2o_plugins.p2ornet.augment import Crop, crop
from p2o_plugins.p2ornet.design import Shape
from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.loss import order_loss
from p2o_plugins.p2ornet.network import P2ORNet, order_probabilities, placed
from p2o_plugins.p2ornet.options import Augmentation, TrainingOptions
from p2o_plugins.p2ornet.shipped import path_of
from p2o_plugins.p2ornet.thinning import peaks, side_probabilities
from p2o_plugins.p2ornet.weights import load_weights, save_weights, write_tensors

Group = TrainingGroup
Progress = TrainingProgress
CHECKPOINT_S = 120.0
"""A state to go on from is written at least this often, so that a kill costs minutes and not hours."""


def train(
    options: TrainingOptions,
    groups: Sequence[Group],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Path:
    """Train into the folder `out` and return the weights file; a training that was stopped goes on.

    Writes `weights.safetensors` (half precision), `state.safetensors` (to go on from), `log.csv`, and TensorBoard
    events where tensorboard is installed. Crops depend on seed and step only, so a resumed training sees what an
    unbroken one would. Raises InputError where there is nothing to train on or `out` holds another training,
    UnknownNameError where `settle_on` names no group or `from_weights` nothing.
    """
    groups = [g for g in groups if len(g.paths) and g.share > 0]
    if not groups:
        raise InputError("nothing to train on", expected="at least one labelled frame", got="none")
    settled_on = [g for g in groups if options.settle_on in ("", g.name)]
    if not settled_on:
        raise UnknownNameError("data", options.settle_on, [g.name for g in groups], where="settle_on")
    torch.manual_seed(options.seed)
    shape = Shape.of(options.encoder)
    network = _first(options, shape)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    placed(network, device)
    optimizer = _optimizer(options, network)
    average = {name: value.detach().clone() for name, value in network.state_dict().items()}
    state, weights = out / "state.safetensors", out / "weights.safetensors"
    start = _resume(state, options, network, optimizer, average) if state.exists() else 0
    about = {"seed": str(options.seed)}
    steps = max(start, options.iterations)
    finished = {**about, "steps": str(steps), "settled": f"{options.settle} {options.settle_on}".strip()}
    if start >= options.iterations and weights.exists() and finished.items() <= load_weights(weights)[1].about.items():
        return weights
    bank = [[Example.load(path) for path in group.paths] for group in groups]
    checks = [Example.load(path) for path in validation]
    share = _shares(groups)
    kept = average if options.average else network.state_dict()
    if start < options.iterations:
        log = _Log(out, start)
        losses: list[float] = []
        began = saved = time.monotonic()
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(_batch, bank, share, options, start)
            for step in range(start, options.iterations):
                crops = coming.result()
                if step + 1 < options.iterations:
                    coming = ahead.submit(_batch, bank, share, options, step + 1)
                _set_rate(optimizer, options, step)
                losses.append(_step(network, optimizer, crops, options, device))
                if options.average:
                    _move_average(average, network, min(options.average, (step + 1) / (step + 10)))
                done = step + 1
                due = done % options.validate_every == 0 or done == options.iterations
                if due:
                    judged = _with_state(shape, kept, device)
                    found = validate(judged, checks, options, device) if checks else None
                    now = time.monotonic() - began
                    progress = Progress(done, options.iterations, float(np.mean(losses)), found, now)
                    log.add(progress, optimizer.param_groups[-1]["lr"])
                    losses = []
                    save_weights(judged.tensors(), replace(shape, about={**about, "steps": str(done)}), weights)
                if due or time.monotonic() - saved > CHECKPOINT_S:
                    _save_state(state, options, network, optimizer, average, done)
                    saved = time.monotonic()
                if due:
                    # Last, so that a report that raises loses nothing.
                    report(progress)
    del bank
    judged = _with_state(shape, kept, device)
    if options.settle:
        settle(judged, settled_on, options, options.settle)
    if checks and options.calibrate:
        finished["calibration"] = calibration_of(judged, checks)
    save_weights(judged.tensors(), replace(shape, about=finished), weights)
    return weights


def _shares(groups: Sequence[Group]) -> Float:
    """Return the part (N,) of every batch that each group makes up."""
    return np.array([group.share for group in groups]) / sum(group.share for group in groups)


def _first(options: TrainingOptions, shape: Shape) -> P2ORNet:
    """Return the network that a training begins with."""
    if not options.from_weights:
        network = P2ORNet.of(shape)
        imagenet = options.imagenet_file()
        if imagenet is not None:
            load_imagenet(network, imagenet)
        return network
    path = path_of(options.from_weights)
    tensors, found = load_weights(path)
    if replace(found, about={}) != replace(shape, about={}):
        raise InputError(
            "the weights to begin from are of another network",
            where=path,
            expected=f"{shape.encoder}, widths {shape.widths}, connectivity {shape.connectivity}",
            got=f"{found.encoder}, widths {found.widths}, connectivity {found.connectivity}",
            hint=f"--encoder {found.encoder}",
        )
    return P2ORNet.of(shape, tensors)


def load_imagenet(network: P2ORNet, path: Path) -> None:
    """Give the encoder its ImageNet weights; the file is read without running anything in it."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.encoder.load_imagenet(state)
    except Exception as problem:  # torch raises its own, OSError, RuntimeError, UnpicklingError, AttributeError
        raise InputError(
            "ImageNet weights cannot be read",
            where=path,
            expected=f"a state_dict of {network.encoder.name}",
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
    warm = max(1.0, 0.03 * options.iterations)
    part = min(1.0, max(0.0, (step - warm) / max(1.0, options.iterations - warm)))
    return options.learning_rate * min(1.0, (step + 1) / warm) * 0.5 * (1 + float(np.cos(np.pi * part)))


def _set_rate(optimizer: torch.optim.Optimizer, options: TrainingOptions, step: int) -> None:
    for group in optimizer.param_groups:
        group["lr"] = rate(options, step) * group["share"]


def _batch(bank: Sequence[Sequence[Example]], share: Float, options: TrainingOptions, step: int) -> list[Crop]:
    rng = np.random.default_rng([options.seed, step])
    crops = []
    for place in range(options.batch):
        # The places of a batch share the groups evenly; chance decides only what is left over.
        which = int(np.searchsorted(np.cumsum(share), (place + rng.random()) / options.batch, side="right"))
        examples = bank[min(which, len(bank) - 1)]
        crops.append(crop(examples[int(rng.integers(len(examples)))], options.crop_px, options.augmentation, rng))
    return crops


def collated(crops: Sequence[Crop], device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return pictures (B, 3, h, w) in 0..1, classes (B, 2, h, w), and all bags with indices into the batch."""
    rgb = torch.from_numpy(np.stack([c.rgb for c in crops])).permute(0, 3, 1, 2).to(device).float() / 255
    classes = torch.from_numpy(np.stack([c.classes for c in crops])).to(device)
    size = crops[0].classes.size
    bags = np.concatenate([np.where(c.bags >= 0, c.bags + i * size, UNKNOWN) for i, c in enumerate(crops)])
    bag_class = np.concatenate([c.bag_class for c in crops])
    weight = np.concatenate([c.bag_weight for c in crops]).astype(np.float32)
    return (
        rgb.contiguous(memory_format=torch.channels_last),
        classes,
        torch.from_numpy(bags).to(device),
        torch.from_numpy(bag_class).to(device),
        torch.from_numpy(weight).to(device),
    )


def _step(
    network: P2ORNet,
    optimizer: torch.optim.Optimizer,
    crops: Sequence[Crop],
    options: TrainingOptions,
    device: torch.device,
) -> float:
    network.train()
    if _frozen(options):
        for module in network.encoder.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
    rgb, classes, bags, bag_class, bag_weight = collated(crops, device)
    with torch.autocast(device.type, torch.bfloat16, enabled=_bfloat16(options, device)):
        logits = network(rgb)
    loss = order_loss(logits[:, :2], classes, bags, bag_class, bag_weight, *weights_of(options)) / len(crops)
    optimizer.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(network.parameters(), 5.0)
    optimizer.step()
    return float(loss.detach())


def _frozen(options: TrainingOptions) -> bool:
    """Return whether the encoder keeps its batch-norm statistics: it has none of use before ImageNet or training."""
    return options.freeze_norm and (bool(options.from_weights) or options.imagenet_file() is not None)


def weights_of(options: TrainingOptions) -> tuple[float, float, float]:
    """Return the weights of the parts of the loss."""
    return options.occlusion_weight, options.unknown_weight, options.direction_weight


def _bfloat16(options: TrainingOptions, device: torch.device) -> bool:
    if options.precision == "auto":
        return device.type == "cuda" or bool(torch.cpu._is_amx_tile_supported())
    return options.precision == "bfloat16"


def _move_average(average: dict[str, Tensor], network: P2ORNet, decay: float) -> None:
    for name, value in network.state_dict().items():
        if value.is_floating_point():
            average[name].lerp_(value, 1 - decay)
        else:
            average[name].copy_(value)


def _with_state(shape: Shape, state: dict[str, Tensor], device: torch.device) -> P2ORNet:
    network = P2ORNet.of(shape)
    network.load_state_dict(state)
    return placed(network, device).eval()


def validate(network: P2ORNet, examples: Sequence[Example], options: TrainingOptions, device: torch.device) -> float:
    """Return the mean loss over whole pictures."""
    still = Augmentation(scale=1, mirror=False, light=0, blur_px=0, noise=0)
    total = 0.0
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=_bfloat16(options, device)):
        for example in examples:
            whole = crop(example, (example.rgb.shape[0], example.rgb.shape[1]), still, np.random.default_rng(0))
            rgb, classes, bags, bag_class, bag_weight = collated([whole], device)
            logits = network(rgb)[:, :2]
            total += float(order_loss(logits, classes, bags, bag_class, bag_weight, *weights_of(options)))
    return total / len(examples)


def settle(network: P2ORNet, groups: Sequence[Group], options: TrainingOptions, batches: int = 40) -> None:
    """Measure the decoder's batch-norm statistics anew on crops of these groups, in place.

    During training they are those of the last few batches of another mixture of pictures.
    """
    device = next(network.parameters()).device
    bank = [[Example.load(path) for path in group.paths] for group in groups]
    share = _shares(groups)
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
    """Return slope and offset of the confidence that follows from the scores of held-out examples, as text.

    That of the score itself where these examples tell of too few edges.
    """
    score, right = reached(network, examples)
    if right.sum() < 100 or (~right).sum() < 100:
        return "1 0"
    slope, offset = calibration.fit(score, right)
    return f"{slope:.4f} {offset:.4f}"


def reached(network: P2ORNet, examples: Sequence[Example]) -> tuple[Float, Bool]:
    """Return the scores (M,) of the edges found in examples and whether they are right (M,), where that is known."""
    parts = []
    for example in examples:
        found = peaks(side_probabilities(order_probabilities(network, example.rgb)), min_score=0.02)
        parts.append(calibration.verdicts(found, example))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _fingerprint(options: TrainingOptions) -> dict[str, str]:
    same = {"encoder", "batch", "crop_px", "seed", "from_weights"}
    return {"options": json.dumps({k: v for k, v in options.model_dump(mode="json").items() if k in same})}


def _save_state(
    path: Path,
    options: TrainingOptions,
    network: P2ORNet,
    optimizer: torch.optim.Optimizer,
    average: dict[str, Tensor],
    step: int,
) -> None:
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    tensors |= {f"average.{name}": value for name, value in average.items()}
    for number, memory in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in memory.items()}
    plain = {name: value.detach().cpu().numpy() for name, value in tensors.items()}
    write_tensors(path, plain, {"step": str(step), **_fingerprint(options)})


def _resume(
    path: Path,
    options: TrainingOptions,
    network: P2ORNet,
    optimizer: torch.optim.Optimizer,
    average: dict[str, Tensor],
) -> int:
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as problem:
        raise InputError(
            "a training cannot go on",
            where=path,
            expected="the state that it wrote",
            got=problem,
            hint="delete the file to start over, or choose another --out",
        ) from problem
    if header.get("options") != _fingerprint(options)["options"]:
        raise InputError(
            "the folder holds another training",
            where=path,
            expected=header.get("options", "a state of p2ornet"),
            got=_fingerprint(options)["options"],
            hint="choose another --out, or the same options to go on",
        )
    network.load_state_dict({n[8:]: v for n, v in tensors.items() if n.startswith("network.")})
    for name, value in tensors.items():
        if name.startswith("average."):
            average[name[8:]].copy_(value)
    memory: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, number, what = name.split(".", 2)
            memory.setdefault(int(number), {})[what] = value
    state = optimizer.state_dict()
    state["state"] = memory
    optimizer.load_state_dict(state)
    return int(header["step"])


class _Log:
    """`log.csv`, a line a report, and TensorBoard events where tensorboard is installed."""

    def __init__(self, out: Path, start: int) -> None:
        out.mkdir(parents=True, exist_ok=True)
        self.path = out / "log.csv"
        self._forget_after(start)
        self.board: Any = None
        try:
            from torch.utils.tensorboard import SummaryWriter

            self.board = SummaryWriter(str(out), purge_step=start)
        except ImportError:
            pass

    def _forget_after(self, start: int) -> None:
        """Drop lines of steps that were lost with a kill: they come again."""
        if not self.path.exists():
            return
        head, *lines = self.path.read_text().splitlines() or [""]
        kept = [line for line in lines if line.partition(",")[0].isdigit() and int(line.partition(",")[0]) <= start]
        write_whole(self.path, "".join(f"{line}\n" for line in (head, *kept)).encode())

    def add(self, progress: Progress, learning_rate: float) -> None:
        fresh = not self.path.exists()
        with self.path.open("a", newline="") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", "loss", "validation", "learning_rate", "seconds"])
            validation = "" if progress.validation is None else f"{progress.validation:.5f}"
            writer.writerow(
                [progress.step, f"{progress.loss:.5f}", validation, f"{learning_rate:.3g}", f"{progress.seconds:.1f}"]
            )
        if self.board is not None:
            self.board.add_scalar("loss/train", progress.loss, progress.step)
            if progress.validation is not None:
                self.board.add_scalar("loss/validation", progress.validation, progress.step)
            self.board.flush()
