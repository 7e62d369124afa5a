"""Use a recurrent network over the frames of a drive: `--calibrator calibrcnn`, after Shi et al. 2020.

Branches and convolutions as in CalibNet, then two LSTMs over three consecutive frames of a drive, with a rotation
vector and a translation for each. Losses: the error of the correction, and the consistency of consecutive frames: they
share one extrinsic X, and A X = X B for known motions A of the camera and B of the LiDAR.

Departures: layer sizes are ours, because the publication was not at hand and its code is not public; pose consistency
replaces its synthetic views and epipolar lines. Three ranges of initial errors, the published one and two smaller ones.
A single frame is a window of one. `small`: one network for all ranges, with the range as an input, 48 x 160 px.
"""

from __future__ import annotations

from p2o_baselines.regressors.design import CALIBNET, Design
from p2o_baselines.regressors.method import built, regressor

DESIGN = Design(
    name="calibrcnn",
    form="rotation-vector",
    stages=CALIBNET,
    inputs={"small": (48, 160), "paper": (375, 1242)},
    window=3,
)
METHOD = regressor(
    DESIGN,
    lambda options: built(DESIGN, options),
    summary="Regresses the initial error with a recurrent network from the frames of a drive.",
    cite="Shi, Zhu, Zhang, Cheng and Chen, CalibRCNN: calibrating camera and LiDAR by recurrent convolutional neural "
    "network and geometric constraints, IROS 2020",
)
