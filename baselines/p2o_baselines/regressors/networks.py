"""The networks of the regressors, by the name of the method: `small` for a CPU, 48 x 160 px, or that of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import nn

from p2o_baselines.regressors import parts
from p2o_baselines.regressors.parts import PairNetwork, convolution


def calibnet(size: str) -> PairNetwork:
    """Return the network: branches of ResNet-18, that of the sweep half as wide, convolutions over both, two heads."""
    return _resnet18() if size == "paper" else _small()


def calibrcnn(size: str) -> PairNetwork:
    """Return the network: branches and convolutions as in `calibnet`, two LSTMs, two heads."""
    return _resnet18(hidden=(1024,), memory=1000) if size == "paper" else _small(memory=96)


def lccnet(size: str) -> PairNetwork:
    """Return the network: two branches of ResNet-18, cost volume, PWC-Net's dense estimator, two heads."""
    if size == "paper":
        dense, branches = parts.DenseTrunk(81), [parts.resnet18(3), parts.resnet18(1)]
        about: dict[str, Any] = {"features": dense.outputs * 8 * 16, "apart": 256, "tell_reach": False}
        return PairNetwork(branches, parts.CostVolume(4), dense, hidden=(512,), outputs=(4, 3), **about)
    trunk = nn.Sequential(
        convolution(81 + 48, 64), convolution(64, 64, 3, 2), convolution(64, 64), convolution(64, 24, 3)
    )
    branches = [parts.small_branch(3), parts.small_branch(1)]
    sizes: dict[str, Any] = {"features": 24 * 3 * 10, "apart": 64}
    return PairNetwork(branches, parts.CostVolumeBeside(4), trunk, hidden=(128,), outputs=(4, 3), **sizes)


def regnet(size: str) -> PairNetwork:
    """Return the network: Network in Network for each sensor, two more blocks over both, fully connected layers."""
    nin = parts.network_in_network
    if size == "paper":

        def branch(inputs: int, a: int, b: int, c: int) -> nn.Sequential:
            pools = [nn.MaxPool2d(3, 2, 1) for _ in range(3)]
            return nn.Sequential(nin(inputs, a, 11, 4), pools[0], nin(a, b, 5, 1), pools[1], nin(b, c, 3, 1), pools[2])

        branches, features = [branch(3, 96, 256, 384), branch(1, 48, 128, 192)], 512 * 6 * 19
        trunk = nn.Sequential(nin(576, 512, 5, 1), nin(512, 512, 3, 1), nn.MaxPool2d(3, 2, 1))
        hidden, tell_reach = (512, 256), False
    else:
        branches = [nn.Sequential(nin(n, 16, 5, 2), nin(16, 32, 3, 2), nin(32, 48, 3, 2)) for n in (3, 1)]
        trunk, features = nn.Sequential(nin(96, 64, 5, 1), nin(64, 64, 3, 2), convolution(64, 24, 1)), 24 * 3 * 10
        hidden, tell_reach = (128, 64), True
    about: dict[str, Any] = {"features": features, "hidden": hidden, "tell_reach": tell_reach}
    return PairNetwork(branches, parts.Beside(), trunk, outputs=(4, 4), **about)


def rggnet(size: str) -> PairNetwork:
    """Return the network: two branches of ResNet-50 after a pooling, their means, three layers, two heads."""
    if size != "paper":
        return _small(channels=5, hidden=(128, 64))
    branches = [nn.Sequential(nn.AvgPool2d(2), parts.resnet50(inputs), nn.AdaptiveAvgPool2d(1)) for inputs in (3, 5)]
    about: dict[str, Any] = {"features": 4096, "hidden": (2048, 1024, 512), "outputs": (3, 3)}
    return PairNetwork(branches, parts.Beside(), nn.Identity(), dropout=0.5, tell_reach=False, **about)


def _small(channels: int = 1, hidden: Sequence[int] = (128,), memory: int = 0) -> PairNetwork:
    """Return the network for a CPU that regresses a rotation vector and a translation."""
    branches = [parts.small_branch(3), parts.small_branch(channels)]
    trunk = nn.Sequential(convolution(96, 64), convolution(64, 64, 3, 2), convolution(64, 64), convolution(64, 24))
    about: dict[str, Any] = {"features": 24 * 3 * 10, "hidden": hidden, "memory": memory, "outputs": (3, 3)}
    return PairNetwork(branches, parts.Beside(), trunk, **about)


def _resnet18(hidden: Sequence[int] = (), memory: int = 0) -> PairNetwork:
    """Return branches of ResNet-18, half as wide for the sweep, and convolutions over both, for 375 x 1242 px."""
    branches = [parts.resnet18(3, first_stride=2), parts.resnet18(1, 32, first_stride=2)]
    trunk = nn.Sequential(convolution(768, 384, 3, 2), convolution(384, 384, 3, 2), convolution(384, 384, 1))
    about: dict[str, Any] = {
        "features": 384 * 2 * 5,
        "hidden": hidden,
        "memory": memory,
        "outputs": (3, 3),
        "tell_reach": False,
    }
    return PairNetwork(branches, parts.Beside(), trunk, **about)
