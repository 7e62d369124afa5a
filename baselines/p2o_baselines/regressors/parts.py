"""Parts of the networks: branches, cost volume, trunks, heads, and their composition."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_MEAN, _DEVIATION = 0.45, 0.225


def convolution(
    inputs: int, outputs: int, kernel: int = 3, stride: int = 1, *, norm: bool = True, slope: float = 0.1
) -> nn.Sequential:
    """Return a convolution, optional batch norm, and a leaky ReLU (slope 0: ReLU)."""
    layers: list[nn.Module] = [nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=not norm)]
    layers += [nn.BatchNorm2d(outputs)] if norm else []
    return nn.Sequential(*layers, nn.LeakyReLU(slope) if slope else nn.ReLU())


def network_in_network(inputs: int, outputs: int, kernel: int, stride: int) -> nn.Sequential:
    """Return a block of Network in Network (Lin et al., 2013): a convolution and two of 1 x 1."""
    return nn.Sequential(
        convolution(inputs, outputs, kernel, stride, slope=0.0),
        convolution(outputs, outputs, 1, slope=0.0),
        convolution(outputs, outputs, 1, slope=0.0),
    )


class Block(nn.Module):
    """A block of ResNet-18, or with `inner` of ResNet-50 (1x1, 3x3, 1x1)."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, inner: int = 0, slope: float = 0.1) -> None:
        super().__init__()
        if inner:
            first = [convolution(inputs, inner, 1, slope=slope), convolution(inner, inner, 3, stride, slope=slope)]
            last = nn.Conv2d(inner, outputs, 1, bias=False)
        else:
            first = [convolution(inputs, outputs, 3, stride, slope=slope)]
            last = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.body = nn.Sequential(*first, last, nn.BatchNorm2d(outputs))
        self.skip: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.skip = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))
        self.slope = slope

    def forward(self, x: Tensor) -> Tensor:
        return F.leaky_relu(self.body(x) + self.skip(x), self.slope)


def resnet18(inputs: int, width: int = 64, first_stride: int = 1) -> nn.Sequential:
    """Return the branch of ResNet-18 (11 million weights at width 64): 8 * width channels at a 32nd of the size."""
    layers: list[nn.Module] = [convolution(inputs, width, 7, 2), nn.MaxPool2d(3, 2, 1)]
    widths = [width, width, 2 * width, 4 * width, 8 * width]
    for (a, b), stride in zip(pairwise(widths), (first_stride, 2, 2, 2), strict=True):
        layers += [Block(a, b, stride), Block(b, b)]
    return nn.Sequential(*layers)


def resnet50(inputs: int) -> nn.Sequential:
    """Return the branch of ResNet-50 (23.5 million weights): 2048 channels at a 32nd of the size."""
    layers: list[nn.Module] = [convolution(inputs, 64, 7, 2), nn.MaxPool2d(3, 2, 1)]
    before = 64
    for number, count in enumerate((3, 4, 6, 3)):
        inner, stride = 64 << number, 1 if number == 0 else 2
        for place in range(count):
            layers.append(Block(before, 4 * inner, stride if place == 0 else 1, inner))
            before = 4 * inner
    return nn.Sequential(*layers)


def small_branch(inputs: int) -> nn.Sequential:
    """Return a branch for a CPU: 48 channels at an eighth of the size, 55 thousand weights."""
    first = [convolution(inputs, 16, 5, 2), convolution(16, 24, 3, 2), Block(24, 24)]
    return nn.Sequential(*first, convolution(24, 40, 3, 2), convolution(40, 48))


class CostVolume(nn.Module):
    """Correlation of each cell of one map with the cells of another within `reach` cells: PWC-Net's cost volume."""

    def __init__(self, reach: int = 4) -> None:
        super().__init__()
        self.reach = reach

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Return ((2 reach + 1)^2) maps of two (B, C, h, w): the mean product over channels, row by row of shifts."""
        side, (height, width) = 2 * self.reach + 1, a.shape[2:]
        wide = F.pad(b, [self.reach] * 4)
        rows = [(a * wide[:, :, v : v + height, u : u + width]).mean(1) for v in range(side) for u in range(side)]
        return F.leaky_relu(torch.stack(rows, dim=1), 0.1)


class Beside(nn.Module):
    """Concatenation of both maps as channels."""

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        return torch.cat([a, b], dim=1)


class CostVolumeBeside(nn.Module):
    """A cost volume concatenated with the sweep's map."""

    def __init__(self, reach: int = 4) -> None:
        super().__init__()
        self.volume = CostVolume(reach)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        return torch.cat([self.volume(F.normalize(a, dim=1), F.normalize(b, dim=1)) * a.shape[1], b], dim=1)


class DenseTrunk(nn.Module):
    """PWC-Net's estimator: each convolution sees all that came before it."""

    def __init__(self, inputs: int, widths: Sequence[int] = (128, 128, 96, 64, 32), *, norm: bool = False) -> None:
        super().__init__()
        self.layers = nn.ModuleList()
        for width in widths:
            self.layers.append(convolution(inputs, width, norm=norm))
            inputs += width
        self.outputs = inputs

    def forward(self, x: Tensor) -> Tensor:
        for layer in self.layers:
            x = torch.cat([layer(x), x], dim=1)
        return x


def dense(sizes: Sequence[int], dropout: float = 0.0) -> nn.Sequential:
    """Return fully connected layers, each with a leaky ReLU."""
    layers: list[nn.Module] = []
    for a, b in pairwise(sizes):
        layers += [nn.Linear(a, b), nn.LeakyReLU(0.1)] + ([nn.Dropout(dropout)] if dropout else [])
    return nn.Sequential(*layers)


class PairNetwork(nn.Module):
    """Branches for image and sweep, their join, a trunk, heads, and optionally a recurrent memory over frames.

    `features` is the number of outputs of the trunk, `hidden` the sizes of the layers after it; rotation and
    translation have separate last layers, each after a layer of size `apart` if that is above zero. With `tell_reach`
    the range of the stage is an input of the head, so that one network serves several stages.
    """

    def __init__(
        self,
        branches: Sequence[nn.Module],
        join: nn.Module,
        trunk: nn.Module,
        *,
        features: int,
        hidden: Sequence[int],
        outputs: tuple[int, int],
        apart: int = 0,
        memory: int = 0,
        dropout: float = 0.0,
        tell_reach: bool = True,
    ) -> None:
        super().__init__()
        (self.picture, self.sweep), self.join, self.trunk = branches, join, trunk
        self.tell_reach = tell_reach
        self.hidden = dense([features + 2 * tell_reach, *hidden], dropout)
        last = hidden[-1] if hidden else features + 2 * tell_reach
        self.memory = nn.LSTM(last, memory, num_layers=2, batch_first=True) if memory else None
        last = memory or last
        self.heads = nn.ModuleList()
        for count in outputs:
            own = [*dense([last, apart])] if apart else []
            end = nn.Linear(apart or last, count)
            # An untrained network predicts no correction.
            nn.init.normal_(end.weight, std=1e-3)
            nn.init.zeros_(end.bias)
            self.heads.append(nn.Sequential(*own, end))

    def features(self, image: Tensor, sweep: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the branches make of images (B, 3, h, w) in 0..1 and sweeps (B, C, h, w)."""
        return self.picture((image - _MEAN) / _DEVIATION), self.sweep(sweep)

    def regress(self, image: Tensor, sweep: Tensor, reach: Tensor, window: int = 1) -> Tensor:
        """Return raw numbers (B, n) of features; reach (B, 2) in rad and m, windows of neighbours."""
        x = self.trunk(self.join(image, sweep)).flatten(1)
        if self.tell_reach:
            x = torch.cat([x, reach.log()], dim=1)
        x = self.hidden(x)
        if self.memory is not None:
            x = self.memory(x.reshape(-1, window, x.shape[1]))[0].flatten(0, 1)
        return torch.cat([head(x) for head in self.heads], dim=1)

    def forward(self, image: Tensor, sweep: Tensor, reach: Tensor, window: int = 1) -> Tensor:
        """Return raw numbers (B, n) of images (B, 3, h, w) in 0..1 and sweeps (B, C, h, w)."""
        return self.regress(*self.features(image, sweep), reach, window)
