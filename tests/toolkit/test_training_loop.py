"""The loop of a training: learning rate, running average, checkpoint, log, and events for TensorBoard."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
import torch
from p2o import InputError, TrainingProgress
from p2o.training_loop import TrainingLog, TrainingState, cosine_rate, run_steps


class Events:
    """Stands for TensorBoard's SummaryWriter and counts how many of them are open."""

    opened: int = 0

    def __init__(self, folder: str, purge_step: int) -> None:
        Events.opened += 1
        self.closed = False

    def add_scalar(self, name: str, value: float, step: int) -> None:
        assert not self.closed

    def flush(self) -> None:
        assert not self.closed

    def close(self) -> None:
        Events.opened -= 1
        self.closed = True


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> type[Events]:
    module = ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Events  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    Events.opened = 0
    return Events


def sum_batch(step: int) -> torch.Tensor:
    return torch.rand(8, 2, generator=torch.Generator().manual_seed(step))


def failing_batch(step: int) -> torch.Tensor:
    if step == 3:
        raise InputError("a label file cannot be read", where="3.npz")
    return sum_batch(step)


def state_in(folder: Path, identity: str = "line", decay: float = 0.0) -> TrainingState:
    torch.manual_seed(3)
    network = torch.nn.Linear(2, 1)
    return TrainingState(
        folder / "state.safetensors", identity, network, torch.optim.AdamW(network.parameters()), decay
    )


def run(
    state: TrainingState,
    iterations: int,
    stop_at: int = 0,
    workers: int = 0,
    batch: Callable[[int], torch.Tensor] = sum_batch,
) -> list[TrainingProgress]:
    """Fit the sum of two numbers; raises KeyboardInterrupt in the report of step `stop_at`."""
    reports: list[TrainingProgress] = []

    def loss(xy: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor((state.network(xy)[:, 0] - xy.sum(dim=1)).square().mean())

    def report(progress: TrainingProgress) -> None:
        reports.append(progress)
        if progress.step == stop_at:
            raise KeyboardInterrupt

    rest = {"rate": lambda step: 0.1, "validate_every": 2, "validate": lambda step: None, "workers": workers}
    run_steps(state, state.resume(), iterations, batch=batch, loss=loss, report=report, **rest)  # type: ignore[arg-type]
    return reports


def test_the_loop_learns_a_sum_and_the_rate_rises_to_the_highest_and_falls_to_zero(tmp_path: Path) -> None:
    state = state_in(tmp_path)
    reports = run(state, 200)
    assert reports[-1].loss < 1e-2
    assert [each.step for each in reports] == list(range(2, 201, 2))
    rates = [cosine_rate(2.0, step, 1000) for step in range(1000)]
    assert rates[0] == pytest.approx(2.0 / 30)
    assert max(rates) == pytest.approx(2.0)
    assert rates.index(max(rates)) == pytest.approx(30, abs=1)
    assert rates[515] == pytest.approx(1.0, abs=1e-2)
    assert rates[-1] < 1e-4


@pytest.mark.parametrize(("decay", "workers"), [(0.0, 0), (0.9, 0), (0.9, 2)])
def test_an_interrupted_training_resumes_with_the_same_bits(tmp_path: Path, decay: float, workers: int) -> None:
    whole = state_in(tmp_path / "whole", decay=decay)
    run(whole, 10)
    with pytest.raises(KeyboardInterrupt):
        run(state_in(tmp_path / "broken", decay=decay), 10, stop_at=4, workers=workers)
    resumed = state_in(tmp_path / "broken", decay=decay)
    run(resumed, 10, workers=workers)
    for name, value in whole.weights.items():
        assert torch.equal(value, resumed.weights[name])


@pytest.mark.parametrize("workers", [0, 1])
def test_an_error_of_a_batch_ends_the_training_with_that_error(tmp_path: Path, workers: int) -> None:
    with pytest.raises(InputError, match="a label file cannot be read"):
        run(state_in(tmp_path), 7, workers=workers, batch=failing_batch)


def test_the_average_of_constant_weights_is_those_weights_and_lags_behind_moving_ones(tmp_path: Path) -> None:
    state = state_in(tmp_path, decay=0.5)
    before = state.average["weight"].clone()
    state.update_average(1000)
    assert torch.equal(state.average["weight"], before)
    with torch.no_grad():
        state.network.weight += 1.0  # type: ignore[operator]
    state.update_average(1000)
    assert torch.allclose(state.average["weight"], before + 0.5)


def test_a_checkpoint_of_another_training_or_a_damaged_one_is_refused(tmp_path: Path) -> None:
    run(state_in(tmp_path), 2)
    with pytest.raises(InputError, match="holds another training"):
        state_in(tmp_path, "circle").resume()
    path = tmp_path / "state.safetensors"
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match=r"training checkpoint.*delete the file"):
        state_in(tmp_path).resume()


def test_lines_of_lost_steps_are_removed_from_the_log(tmp_path: Path) -> None:
    with TrainingLog(tmp_path, 0) as log:
        for step in (2, 4, 6):
            log.add(TrainingProgress(step, 6, 1.0, None, 0.0), 0.1)
    with TrainingLog(tmp_path, 4) as log:
        log.add(TrainingProgress(6, 6, 2.0, None, 0.0), 0.1)
    steps = [line.split(",")[0] for line in (tmp_path / "log.csv").read_text().splitlines()]
    assert steps == ["step", "2", "4", "6"]


@pytest.mark.parametrize("stop_at", [0, 2])
def test_the_writer_of_events_is_closed_at_the_end(tmp_path: Path, events: type[Events], stop_at: int) -> None:
    if stop_at:
        with pytest.raises(KeyboardInterrupt):
            run(state_in(tmp_path), 4, stop_at)
    else:
        run(state_in(tmp_path), 4)
    assert events.opened == 0
