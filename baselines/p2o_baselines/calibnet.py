"""Losses of geometry instead of numbers: `calibnet`, after Iyer et al. 2018."""

from __future__ import annotations

from typing import TYPE_CHECKING

import p2o

from p2o_baselines.regressors.decalibration import CALIBNET
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.method import OTHER_RIG, built, trainer
from p2o_baselines.regressors.options import RegressorOptions

if TYPE_CHECKING:
    from torch import Tensor

    from p2o_baselines.regressors.batch import Batch
    from p2o_baselines.regressors.parts import PairNetwork


def network(size: str) -> PairNetwork:
    """Return the network: branches of ResNet-18, that of the sweep half as wide, convolutions over both, two heads."""
    from torch import nn

    from p2o_baselines.regressors import parts

    if size == "paper":
        return parts.PairNetwork(
            picture=parts.resnet18(3, first_stride=2),
            sweep=parts.resnet18(1, 32, first_stride=2),
            join=parts.Beside(),
            trunk=nn.Sequential(
                parts.convolution(768, 384, 3, 2), parts.convolution(384, 384, 3, 2), parts.convolution(384, 384, 1)
            ),
            features=384 * 2 * 5,
            hidden=(),
            outputs=(3, 3),
            tell_reach=False,
        )
    return parts.PairNetwork(
        picture=parts.small_branch(3),
        sweep=parts.small_branch(1),
        join=parts.Beside(),
        trunk=nn.Sequential(
            parts.convolution(96, 64),
            parts.convolution(64, 64, 3, 2),
            parts.convolution(64, 64),
            parts.convolution(64, 24),
        ),
        features=24 * 3 * 10,
        hidden=(128,),
        outputs=(3, 3),
    )


def loss(raw: Tensor, said: Tensor, batch: Batch) -> Tensor:
    """Return the photometric loss of depth, Chamfer distance, and the distance of points."""
    from p2o_baselines.regressors import losses

    return losses.photometric(said, batch) + losses.chamfer(said, batch) + losses.points(said, batch)


DESIGN = Design(
    name="calibnet",
    network=network,
    loss=loss,
    form="rotation-vector",
    stages=CALIBNET,
    needs_true_map=True,
    pictures={"small": (48, 160), "paper": (375, 1242)},
)


def build(options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return built(DESIGN, options)


METHOD = p2o.Method(
    name="calibnet",
    build=build,
    options=RegressorOptions,
    summary="A network learns corrections by how its points and depth maps meet the true ones.",
    cite="Iyer, Ram, Murthy and Krishna, CalibNet: geometrically supervised extrinsic calibration using 3D spatial "
    "transformer networks, IROS 2018",
    expected_failures=OTHER_RIG,
    trainer=trainer(DESIGN),
)
