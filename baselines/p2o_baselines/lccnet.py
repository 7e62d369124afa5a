"""A cost volume between the features of both sensors, in five stages: `lccnet`, after Lv et al. 2021."""

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
    """Return the network: two branches of ResNet-18, cost volume, PWC-Net's dense estimator, two heads."""
    from torch import nn

    from p2o_baselines.regressors import parts

    if size == "paper":
        estimator = parts.DenseTrunk(81)
        return parts.PairNetwork(
            picture=parts.resnet18(3),
            sweep=parts.resnet18(1),
            join=parts.CostVolume(4),
            trunk=estimator,
            features=estimator.outputs * 8 * 16,
            hidden=(512,),
            outputs=(4, 3),
            apart=256,
            tell_reach=False,
        )
    trunk = nn.Sequential(
        parts.convolution(81 + 48, 64),
        parts.convolution(64, 64, 3, 2),
        parts.convolution(64, 64),
        parts.convolution(64, 24, 3),
    )
    return parts.PairNetwork(
        picture=parts.small_branch(3),
        sweep=parts.small_branch(1),
        join=parts.CostVolumeBeside(4),
        trunk=trunk,
        features=24 * 3 * 10,
        hidden=(128,),
        outputs=(4, 3),
        apart=64,
    )


def loss(raw: Tensor, said: Tensor, batch: Batch) -> Tensor:
    """Return smooth L1 of the shift, the angle of the quaternions, and half of the distance of points."""
    from p2o_baselines.regressors import losses

    pose = losses.shift(said, batch.correction, batch.reach) + losses.angle(said, batch.correction, batch.reach)
    return pose + 0.5 * losses.points(said, batch)


DESIGN = Design(
    name="lccnet",
    network=network,
    loss=loss,
    form="quaternion",
    stages=LCCNET,
    pictures={"small": (48, 160), "paper": (256, 512)},
)


def build(options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return built(DESIGN, options)


METHOD = p2o.Method(
    name="lccnet",
    build=build,
    options=RegressorOptions,
    summary="A network with a cost volume says how wrong the start is, in five stages.",
    cite="Lv, Wang, Dou, Ye and Wang, LCCNet: LiDAR and camera self-calibration using cost volume network, CVPRW 2021",
    expected_failures=OTHER_RIG,
    trainer=trainer(DESIGN),
)
