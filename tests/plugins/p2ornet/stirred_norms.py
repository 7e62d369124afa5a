"""Batch norms that do something, so that a network of random weights has maps that differ from place to place."""

from __future__ import annotations

import torch
from torch import nn


def stir(network: nn.Module) -> None:
    """Draw scales, shifts and statistics of all batch norms, the same each time."""
    generator = torch.Generator().manual_seed(1)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.weight.data.uniform_(0.8, 1.4, generator=generator)
            module.bias.data.uniform_(-0.3, 0.3, generator=generator)
            module.running_mean.uniform_(-0.2, 0.2, generator=generator)  # type: ignore[union-attr, operator]
            module.running_var.uniform_(0.2, 0.6, generator=generator)  # type: ignore[union-attr, operator]
