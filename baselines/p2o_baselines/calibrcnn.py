"""A memory over the frames of a drive, which share one rig: `--calibrator calibrcnn`, after Shi et al. 2020.

    p2o run --data kitti-raw:PATH --calibrator calibrcnn --joint
    p2o train calibrcnn --data kitti-raw:PATH --out trained

Branches and convolutions as CalibNet's, then two LSTMs over three frames of a drive that follow each other, a rotation
vector and a shift for each. Losses: that of the correction, and the geometry of neighbours: they have one extrinsic X,
and where the motions A of the camera and B of the LiDAR between them are known, A X = X B.

Departures: sizes of layers of ours, as the publication was not at hand and its code is not public; the consistency of
poses stands for its synthetic views and epipolar lines. Three ranges from the published one inwards. A single frame is
a window of one. `small`: one network for all ranges, which is told the reach, 48 x 160 px.
"""

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
    """Return the network: branches of ResNet-18, that of the sweep half as wide, convolutions, two LSTMs, two heads."""
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
            hidden=(1024,),
            memory=1000,
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
        memory=96,
        outputs=(3, 3),
    )


def loss(raw: Tensor, said: Tensor, batch: Batch) -> Tensor:
    """Return the loss of the correction, and half of that of neighbours that share a rig and move together."""
    from p2o_baselines.regressors import losses

    pose = losses.shift(said, batch.correction, batch.reach) + losses.angle(said, batch.correction, batch.reach)
    return pose + 0.5 * losses.same_rig(said, batch)


DESIGN = Design(
    name="calibrcnn",
    network=network,
    loss=loss,
    form="rotation-vector",
    stages=CALIBNET,
    pictures={"small": (48, 160), "paper": (375, 1242)},
    window=3,
)


def build(options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return built(DESIGN, options)


METHOD = p2o.Method(
    name="calibrcnn",
    build=build,
    options=RegressorOptions,
    summary="A recurrent network says how wrong the start is from the frames of a drive together.",
    cite="Shi, Zhu, Zhang, Cheng and Chen, CalibRCNN: calibrating camera and LiDAR by recurrent convolutional neural "
    "network and geometric constraints, IROS 2020",
    expected_failures=OTHER_RIG,
    trainer=trainer(DESIGN),
)
