"""Define a regressor: its inputs, its initial errors for training, the parametrisation of the pose, and its method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from p2o_baselines.regressors.network_input import Channel, Size
from p2o_baselines.regressors.sample import Reach

if TYPE_CHECKING:
    from torch import Tensor

    from p2o_baselines.regressors.batch import Batch
    from p2o_baselines.regressors.parts import PairNetwork

Form = Literal["rotation-vector", "quaternion", "dual-quaternion"]
"""How the numbers that a network gives are a pose."""

LCCNET: tuple[Reach, ...] = ((20.0, 1.5), (10.0, 1.0), (5.0, 0.5), (2.0, 0.2), (1.0, 0.1))
"""The five stages of LCCNet, and of RegNet before it, from the widest."""
CALIBNET: tuple[Reach, ...] = ((10.0, 0.25), (5.0, 0.2), (2.0, 0.1))
"""Range of CalibNet and its successors, and two smaller ranges for its iterations."""


@dataclass(frozen=True, kw_only=True)
class Design:
    """A regressor before training; its network and loss are the functions of its name in `networks` and `losses`.

    `stages` are the published ranges of initial errors, `inputs` the input size of each network size. `window` frames
    of a drive, if that many exist, are processed together. `needs_true_map` states that the loss uses
    `Batch.true_nearness`.
    """

    name: str
    form: Form
    stages: Sequence[Reach]
    inputs: Mapping[str, Size]
    channels: Sequence[Channel] = ("nearness",)
    window: int = 1
    needs_true_map: bool = False

    @property
    def network(self) -> Callable[[str], PairNetwork]:
        """The function of a size that returns the network with random weights."""
        from p2o_baselines.regressors import networks

        return getattr(networks, self.name)  # type: ignore[no-any-return]

    @property
    def loss(self) -> Callable[[Tensor, Tensor, Batch], Tensor]:
        """The loss () of raw outputs (B, n), the corrections (B, 4, 4) they represent, and the batch."""
        from p2o_baselines.regressors import losses

        return getattr(losses, self.name)  # type: ignore[no-any-return]
