"""Train with geometric losses instead of pose errors: `--calibrator calibnet`, after Iyer et al. 2018.

A ResNet-18 branch for the image, one of half the width for the sweep projected at the initial extrinsic, convolutions
over both, and heads for a rotation vector and a translation. The loss compares geometry: points moved by the predicted
correction with the true points (Chamfer distance), and their depth with the map of the true sweep (photometric depth
loss). The network is applied repeatedly (`calibrator.rounds`).

Departures: points sample the true map instead of being rendered into one (inverse direction of the 3D spatial
transformer); the distance of each point from its true position is a third loss, because the other two have small
gradients for large errors; the earth mover's distance of the authors' code is left out; nearness replaces depth. Three
ranges of initial errors, the published one and two smaller ones. `small`: one network for all ranges, with the range as
an input, 48 x 160 px.
"""

from __future__ import annotations

from p2o_baselines.regressors.design import CALIBNET, Design
from p2o_baselines.regressors.method import built, regressor

DESIGN = Design(
    name="calibnet",
    form="rotation-vector",
    stages=CALIBNET,
    needs_true_map=True,
    inputs={"small": (48, 160), "paper": (375, 1242)},
)
METHOD = regressor(
    DESIGN,
    lambda options: built(DESIGN, options),
    summary="Regresses the initial error with a network trained by distances of points and depth maps.",
    cite="Iyer, Ram, Murthy and Krishna, CalibNet: geometrically supervised extrinsic calibration using 3D spatial "
    "transformer networks, IROS 2018",
)
