"""A cost volume between the features of both sensors: `--calibrator lccnet`, after Lv et al. 2021.

    p2o run --data kitti-raw:PATH --calibrator lccnet
    p2o train lccnet --data kitti-raw:PATH --out trained          # --preset paper on a GPU, a stage at a time

Branches of ResNet-18 see the picture and the sweep drawn at the start; PWC-Net's cost volume tells how alike each cell
of one is to the 81 cells around it in the other, its dense estimator and two layers for each head make a quaternion and
a shift of it. Five networks for five ranges of starts (20 deg and 1.5 m to 1 deg and 0.1 m) follow each other; frames
together give the median. Losses: smooth L1 of the shift, the angle of the quaternions, and the distance of points.

Departures: nearness on a logarithmic scale instead of depth; points next to the car are not left out; losses count in
the reach of the stage. `small` has one network for all stages, which is told the reach, branches of 48 channels at an
eighth of 48 x 160 px, four convolutions after the volume, and sees the sweep's features beside it. Its shipped weights
were trained with `match`, which no paper has.
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
