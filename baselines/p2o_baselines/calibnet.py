"""Losses of geometry instead of numbers: `--calibrator calibnet`, after Iyer et al. 2018.

    p2o run --data kitti-raw:PATH --calibrator calibnet
    p2o train calibnet --data kitti-raw:PATH --out trained

A branch of ResNet-18 for the picture, one half as wide for the sweep drawn at the start, convolutions over both, a
rotation vector and a shift. What is learnt is not the distance from the true numbers: points that are moved as the
network says should lie where the true ones do (Chamfer distance), at the depth that the map of the true sweep has where
they fall (photometric loss of depth). Used over and over (`calibrator.rounds`).

Departures: points look up the true map, instead of being drawn onto one (the 3D spatial transformer the other way
round); the distance of each point from itself is a third loss, since the two others alone hardly pull from far, and the
earth mover's distance of the authors' code is left out; nearness instead of depth. Three ranges from the published one
inwards. `small`: one network for all of them, which is told the reach, 48 x 160 px.
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
