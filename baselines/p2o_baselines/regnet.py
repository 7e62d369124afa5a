"""Branches of Network in Network and a dual quaternion: `--calibrator regnet`, after Schneider et al. 2017.

    p2o run --data kitti-raw:PATH --calibrator regnet
    p2o train regnet --data kitti-raw:PATH --out trained

Network in Network for the picture and, with half of the channels, for the sweep drawn at the start; two more blocks
over both, fully connected layers of 512 and 256, eight numbers: the dual quaternion that undoes the error of the start,
by its squared distance. Five networks for five ranges of starts follow each other, as published; the filter over time
that came after them is the median of frames together.

Departures: sizes of kernels and a pooling of ours where the publication was not at hand; nearness instead of depth;
both parts of the dual quaternion count in the reach of the stage. `small`: one network for all stages, which is told
the reach, 48 x 160 px.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import p2o

from p2o_baselines.regressors.decalibration import LCCNET
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.method import OTHER_RIG, built, trainer
from p2o_baselines.regressors.options import RegressorOptions

if TYPE_CHECKING:
    from torch import Tensor

    from p2o_baselines.regressors.batch import Batch
    from p2o_baselines.regressors.parts import PairNetwork


def network(size: str) -> PairNetwork:
    """Return the network: Network in Network for each sensor, two more blocks over both, fully connected layers."""
    from torch import nn

    from p2o_baselines.regressors import parts

    nin = parts.network_in_network
    if size == "paper":

        def branch(inputs: int, widths: tuple[int, int, int]) -> nn.Sequential:
            a, b, c = widths
            pools = [nn.MaxPool2d(3, 2, 1) for _ in widths]
            return nn.Sequential(nin(inputs, a, 11, 4), pools[0], nin(a, b, 5, 1), pools[1], nin(b, c, 3, 1), pools[2])

        return parts.PairNetwork(
            picture=branch(3, (96, 256, 384)),
            sweep=branch(1, (48, 128, 192)),
            join=parts.Beside(),
            trunk=nn.Sequential(nin(576, 512, 5, 1), nin(512, 512, 3, 1), nn.MaxPool2d(3, 2, 1)),
            features=512 * 6 * 19,
            hidden=(512, 256),
            outputs=(4, 4),
            tell_reach=False,
        )

    def small(inputs: int) -> nn.Sequential:
        return nn.Sequential(nin(inputs, 16, 5, 2), nin(16, 32, 3, 2), nin(32, 48, 3, 2))

    return parts.PairNetwork(
        picture=small(3),
        sweep=small(1),
        join=parts.Beside(),
        trunk=nn.Sequential(nin(96, 64, 5, 1), nin(64, 64, 3, 2), parts.convolution(64, 24, 1)),
        features=24 * 3 * 10,
        hidden=(128, 64),
        outputs=(4, 4),
    )


def loss(raw: Tensor, said: Tensor, batch: Batch) -> Tensor:
    """Return the squared distance of dual quaternions."""
    from p2o_baselines.regressors import losses

    return losses.dual_quaternion(raw, batch, said)


DESIGN = Design(
    name="regnet",
    network=network,
    loss=loss,
    form="dual-quaternion",
    stages=LCCNET,
    pictures={"small": (48, 160), "paper": (352, 1216)},
)


def build(options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return built(DESIGN, options)


METHOD = p2o.Method(
    name="regnet",
    build=build,
    options=RegressorOptions,
    summary="Two branches of a network say how wrong the start is as a dual quaternion, in five stages.",
    cite="Schneider, Piewak, Stiller and Franke, RegNet: multimodal sensor registration using deep neural networks, "
    "IV 2017",
    expected_failures=OTHER_RIG,
    trainer=trainer(DESIGN),
)
