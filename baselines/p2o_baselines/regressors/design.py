"""What one regressor is: its network in each size, what it sees, how its numbers are a pose, and its loss."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from p2o_baselines.regressors.decalibration import Reach
from p2o_baselines.regressors.glance import Size
from p2o_baselines.regressors.sweep_map import Channel

if TYPE_CHECKING:
    from torch import Tensor

    from p2o_baselines.regressors.batch import Batch
    from p2o_baselines.regressors.parts import PairNetwork

Form = Literal["rotation-vector", "quaternion", "dual-quaternion"]
"""How the numbers that a network gives are a pose."""
NUMBERS: Mapping[str, int] = {"rotation-vector": 6, "quaternion": 7, "dual-quaternion": 8}


@dataclass(frozen=True, kw_only=True)
class Design:
    """A regressor before it is trained.

    `network(size)` returns the network with weights of chance; `loss(said, batch)` the loss (), `said` being its raw
    numbers (B, n) and the corrections (B, 4, 4) that they are. `stages` are the published ranges of starts, `pictures`
    what each size sees. `window` frames of a drive are looked at together, where there are so many. `needs_true_map`
    says that the loss asks for `Batch.true_nearness`.
    """

    name: str
    network: Callable[[str], PairNetwork]
    loss: Callable[[Tensor, Tensor, Batch], Tensor]
    form: Form
    stages: Sequence[Reach]
    pictures: Mapping[str, Size]
    channels: Sequence[Channel] = ("nearness",)
    window: int = 1
    needs_true_map: bool = False
