"""Run the steps of a seeded training that can be interrupted: schedule, running average, checkpoint and log."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from p2o.errors import InputError
from p2o.files.input_file import read_bytes
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.host.method import TrainingProgress
from p2o.options import Options
from p2o.options import field as option

if TYPE_CHECKING:
    import torch
    from torch import Tensor

CHECKPOINT_S = 120.0
"""A checkpoint is written at least this often, so that a kill loses minutes and not hours."""
_GRADIENT_NORM = 5.0
_Batch = TypeVar("_Batch")


class StepOptions(Options):
    """Options of `run_steps`, which the options of a training inherit."""

    workers: int = option(
        0,
        ge=0,
        le=256,
        help="Processes that draw the batches; 0: one thread of the training process. The weights are the same.",
    )


def cosine_rate(highest: float, step: int, iterations: int) -> float:
    """Return the learning rate of a step: linear warm-up over 3 % of the iterations, then a cosine to zero."""
    warm_up = max(1.0, 0.03 * iterations)
    part = min(1.0, max(0.0, (step - warm_up) / max(1.0, iterations - warm_up)))
    return highest * min(1.0, (step + 1) / warm_up) * 0.5 * (1 + float(np.cos(np.pi * part)))


@dataclass(eq=False)
class TrainingState:
    """Network, optimizer and exponential moving average of the weights, with their checkpoint file `path`.

    `identity` names the method and the options that must not change when the training is resumed. `decay` is that of
    the average; 0 keeps no average. A parameter group of the optimizer may hold a factor `share` of the learning rate.
    """

    path: Path
    identity: str
    network: torch.nn.Module
    optimizer: torch.optim.Optimizer
    decay: float
    average: dict[str, torch.Tensor] = field(init=False)

    def __post_init__(self) -> None:
        self.average = {name: value.detach().clone() for name, value in self.network.state_dict().items()}

    @property
    def weights(self) -> dict[str, torch.Tensor]:
        """Return the weights to validate and to publish: the average, or those of the network without one."""
        return self.average if self.decay else self.network.state_dict()

    def set_rate(self, rate: float) -> None:
        """Set the learning rate of all parameter groups."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group.get("share", 1.0)

    def descend(self, loss: torch.Tensor) -> float:
        """Take one step of the optimizer with clipped gradients and return the value of the loss."""
        import torch

        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _GRADIENT_NORM)
        self.optimizer.step()
        return float(loss.detach())

    def update_average(self, step: int) -> None:
        """Move the average towards the network; in the first steps its decay is smaller."""
        if not self.decay:
            return
        decay = min(self.decay, (step + 1) / (step + 10))
        for name, value in self.network.state_dict().items():
            if value.is_floating_point():
                self.average[name].lerp_(value, 1 - decay)
            else:
                self.average[name].copy_(value)

    def save(self, step: int) -> None:
        """Write the checkpoint after `step` steps."""
        import torch

        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"average.{name}": value for name, value in self.average.items()}
        for number, memory in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in memory.items()}
        arrays = {name: value.detach().cpu().numpy() for name, value in tensors.items()}
        write_tensors(self.path, arrays, {"step": str(step), "training": self.identity})

    def resume(self) -> int:
        """Load the checkpoint if there is one and return the number of steps done.

        Raises InputError if the file is damaged or belongs to a training with another `identity`.
        """
        if not self.path.exists():
            return 0
        hint = "delete the file to start over, or choose another --out"
        tensors, header = read_tensors(self.path, "training checkpoint", hint)
        if header.get("training") != self.identity:
            text, expected = "the folder holds another training", header.get("training", "a training checkpoint")
            advice = "choose another --out, or the same options to resume"
            raise InputError(text, where=self.path, expected=expected, got=self.identity, hint=advice)
        network: dict[str, torch.Tensor] = {}
        memory: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in tensors.items():
            part, _, rest = name.partition(".")
            if part == "network":
                network[rest] = value
            elif part == "average":
                self.average[rest].copy_(value)
            elif part == "optimizer":
                number, _, quantity = rest.partition(".")
                memory.setdefault(int(number), {})[quantity] = value
        self.network.load_state_dict(network)
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": memory})
        return int(header["step"])


class TrainingLog:
    """Write `log.csv`, one line per report, and TensorBoard events if tensorboard is installed.

    Opened at step `start`: lines of later steps, which a killed training left behind, are removed. Use it as a context
    manager, which closes the writer of events.
    """

    def __init__(self, out: Path, start: int) -> None:
        out.mkdir(parents=True, exist_ok=True)
        self.path = out / "log.csv"
        self._remove_after(start)
        self._events: Any = None
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            return
        self._events = SummaryWriter(str(out), purge_step=start)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._events is not None:
            self._events.close()

    def _remove_after(self, start: int) -> None:
        if not self.path.exists():
            return
        head, *lines = self.path.read_text().splitlines() or [""]
        kept = [line for line in lines if line.partition(",")[0].isdigit() and int(line.partition(",")[0]) <= start]
        write_whole(self.path, "".join(f"{line}\n" for line in (head, *kept)).encode())

    def add(self, progress: TrainingProgress, learning_rate: float) -> None:
        """Append one report."""
        fresh = not self.path.exists()
        with self.path.open("a", newline="") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", "loss", "validation", "learning_rate", "seconds"])
            validation = "" if progress.validation is None else f"{progress.validation:.5f}"
            writer.writerow(
                [progress.step, f"{progress.loss:.5f}", validation, f"{learning_rate:.3g}", f"{progress.seconds:.1f}"]
            )
        if self._events is not None:
            self._events.add_scalar("loss/train", progress.loss, progress.step)
            if progress.validation is not None:
                self._events.add_scalar("loss/validation", progress.validation, progress.step)
            self._events.flush()


def run_steps(
    state: TrainingState,
    start: int,
    iterations: int,
    *,
    batch: Callable[[int], _Batch],
    loss: Callable[[_Batch], torch.Tensor],
    rate: Callable[[int], float],
    validate_every: int,
    validate: Callable[[int], float | None],
    report: Callable[[TrainingProgress], None],
    workers: int = 0,
) -> None:
    """Train from step `start` to `iterations`, with a log and checkpoints in the folder of the checkpoint.

    `batch(step)` is drawn while earlier steps are computed: in a second thread, or in `workers` processes, to which it
    must be picklable. `validate(step)` publishes the weights and returns their loss on held-out data. An exception of
    `report` ends the training without losing a step.
    """
    losses: list[float] = []
    began = saved = time.monotonic()
    with TrainingLog(state.path.parent, start) as log:
        for step, current in enumerate(_batches(batch, range(start, iterations), workers), start):
            state.set_rate(rate(step))
            losses.append(state.descend(loss(current)))
            state.update_average(step)
            done = step + 1
            due = done % validate_every == 0 or done == iterations
            if due:
                validation = validate(done)
                seconds = time.monotonic() - began
                progress = TrainingProgress(done, iterations, float(np.mean(losses)), validation, seconds)
                log.add(progress, rate(step))
                losses = []
            if due or time.monotonic() - saved > CHECKPOINT_S:
                state.save(done)
                saved = time.monotonic()
            if due:
                report(progress)


@dataclass(frozen=True)
class _StepsAsData(Generic[_Batch]):
    """The batches of steps, in the form of a data set of PyTorch."""

    batch: Callable[[int], _Batch]
    steps: range

    def __len__(self) -> int:
        return len(self.steps)

    def __getitem__(self, number: int) -> _Batch:
        return self.batch(self.steps[number])


def _unchanged(batch: _Batch) -> _Batch:
    return batch


def _batches(batch: Callable[[int], _Batch], steps: range, workers: int) -> Iterator[_Batch]:
    """Yield the batches of steps in order, drawn ahead in one thread or in `workers` processes."""
    if workers:
        from torch.utils.data import DataLoader

        # Spawned, because this process has threads and possibly a GPU, which a fork does not carry over.
        yield from DataLoader(
            _StepsAsData(batch, steps),  # type: ignore[arg-type]
            batch_size=None,
            collate_fn=_unchanged,
            num_workers=workers,
            multiprocessing_context="spawn",
        )
        return
    with ThreadPoolExecutor(1) as drawing:
        following = drawing.submit(batch, steps[0]) if steps else None
        for step in steps:
            assert following is not None
            current = following.result()
            if step + 1 in steps:
                following = drawing.submit(batch, step + 1)
            yield current


_MAX_BYTES = 2 << 30
_MAX_HEADER_BYTES = 100 << 20


def write_tensors(path: Path, tensors: Mapping[str, NDArray[Any]], header: Mapping[str, str]) -> None:
    """Write a safetensors file atomically; the same content gives the same bytes.

    The entries of the header are sorted, because safetensors itself writes them in random order.
    """
    from safetensors.numpy import save

    raw = save({name: np.array(value, order="C") for name, value in tensors.items()}, metadata=dict(header))
    size = int.from_bytes(raw[:8], "little")
    entries = json.loads(raw[8 : 8 + size])
    entries["__metadata__"] = dict(sorted(entries["__metadata__"].items()))
    text = json.dumps(entries, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    write_whole(path, len(text).to_bytes(8, "little") + text + raw[8 + size :])


def read_tensors(path: Path, what: str, hint: str = "") -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors on the CPU and the header of a safetensors file.

    Raises InputError, which names the file as `what`, if the file is missing, damaged or larger than 2 GiB.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    raw = read_bytes(path, what, _MAX_BYTES)
    try:
        size = int.from_bytes(raw[:8], "little")
        if not 0 < size <= min(len(raw) - 8, _MAX_HEADER_BYTES):
            raise ValueError("its header is cut off")
        header = parse_json(raw[8 : 8 + size].rstrip(b" "), what, path).get("__metadata__", {})
        return load(raw), {str(name): str(value) for name, value in header.items()}
    except (SafetensorError, ValueError, AttributeError, KeyError, RuntimeError) as problem:
        text = f"a {what} cannot be read"
        raise InputError(text, where=path, expected="safetensors", got=problem, hint=hint) from problem
