"""Train with the geodesic distance on SE(3): `--calibrator rggnet`, after Yuan et al. 2020.

ResNet-50 branches after a pooling, their concatenated means, layers of 2048, 1024 and 512, a rotation vector and a
translation. The sweep is projected as five maps: x, y, z in the LiDAR frame, reflectance and nearness. The loss is the
geodesic distance on SE(3), with a left-invariant metric.

Departures: the tolerance term, by a variational autoencoder and with a weight of 1e-9 in the authors' settings, is left
out; the metric is normalised by the range of the stage; no tanh limits the rotation. Three ranges of initial errors,
the published one and two smaller ones. `small`: one network for all of them, with the range as an input, 48 x 160 px.
"""

from __future__ import annotations

from p2o_baselines.regressors.design import CALIBNET, Design
from p2o_baselines.regressors.method import built, regressor

DESIGN = Design(
    name="rggnet",
    form="rotation-vector",
    stages=CALIBNET,
    inputs={"small": (48, 160), "paper": (160, 640)},
    channels=("x", "y", "z", "reflectance", "nearness"),
)
METHOD = regressor(
    DESIGN,
    lambda options: built(DESIGN, options),
    summary="Regresses the initial error with coordinates and reflectance as inputs; trained by distances on SE(3).",
    needs=frozenset({"intensity"}),
    cite="Yuan, Guo and Wang, RGGNet: tolerance aware LiDAR-camera online calibration with geometric deep learning and "
    "generative model, RA-L 2020",
)
