"""Distance on SE(3), and maps with places and reflectance: `--calibrator rggnet`, after Yuan et al. 2020.

    p2o run --data kitti-raw:PATH --calibrator rggnet
    p2o train rggnet --data kitti-raw:PATH --out trained

Branches of ResNet-50 after a pooling, their means beside each other, layers of 2048, 1024 and 512, a rotation vector
and a shift. The sweep is drawn as five maps: places x, y, z in the LiDAR's frame, reflectance and nearness. The loss is
the geodesic distance on SE(3), by a metric that moving both poses leaves alone.

Departures: the tolerance term, by a variational autoencoder and with a weight of 1e-9 in the authors' settings, is left
out; the metric counts in the reach of the stage; no tanh bounds the rotation. Three ranges from the published one
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
    """Return the network: two branches of ResNet-50 after a pooling, their means, three layers, two heads."""
    from torch import nn

    from p2o_baselines.regressors import parts

    if size == "paper":

        def branch(inputs: int) -> nn.Sequential:
            return nn.Sequential(nn.AvgPool2d(2), parts.resnet50(inputs), nn.AdaptiveAvgPool2d(1))

        return parts.PairNetwork(
            picture=branch(3),
            sweep=branch(5),
            join=parts.Beside(),
            trunk=nn.Identity(),
            features=4096,
            hidden=(2048, 1024, 512),
            outputs=(3, 3),
            dropout=0.5,
            tell_reach=False,
        )
    return parts.PairNetwork(
        picture=parts.small_branch(3),
        sweep=parts.small_branch(5),
        join=parts.Beside(),
        trunk=nn.Sequential(
            parts.convolution(96, 64),
            parts.convolution(64, 64, 3, 2),
            parts.convolution(64, 64),
            parts.convolution(64, 24),
        ),
        features=24 * 3 * 10,
        hidden=(128, 64),
        outputs=(3, 3),
    )


def loss(raw: Tensor, said: Tensor, batch: Batch) -> Tensor:
    """Return the distance on SE(3)."""
    from p2o_baselines.regressors import losses

    return losses.geodesic(said, batch.correction, batch.reach)


DESIGN = Design(
    name="rggnet",
    network=network,
    loss=loss,
    form="rotation-vector",
    stages=CALIBNET,
    pictures={"small": (48, 160), "paper": (160, 640)},
    channels=("x", "y", "z", "reflectance", "nearness"),
)


def build(options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return built(DESIGN, options)


METHOD = p2o.Method(
    name="rggnet",
    build=build,
    options=RegressorOptions,
    summary="A network that also sees places and reflectance learns by distances on SE(3).",
    needs=frozenset({"intensity"}),
    cite="Yuan, Guo and Wang, RGGNet: tolerance aware LiDAR-camera online calibration with geometric deep learning and "
    "generative model, RA-L 2020",
    expected_failures=OTHER_RIG,
    trainer=trainer(DESIGN),
)
