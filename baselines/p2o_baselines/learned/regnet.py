"""Regress a dual quaternion with Network in Network: `--calibrator regnet`, after Schneider et al. 2017.

Network in Network for the image and, with half of the channels, for the sweep projected at the initial extrinsic; two
more blocks over both, fully connected layers of 512 and 256, eight outputs: the dual quaternion of the correction, with
its squared distance as the loss. Five networks for five ranges of initial errors are applied in sequence, as published;
the median over frames replaces the temporal filter.

Departures: kernel sizes and a pooling are ours, because the publication was not at hand; nearness instead of depth;
both parts of the dual quaternion are normalised by the range of the stage. `small`: one network for all stages, with
the range as an input, 48 x 160 px.
"""

from __future__ import annotations

from p2o_baselines.regressors.design import LCCNET, Design
from p2o_baselines.regressors.method import built, regressor

DESIGN = Design(name="regnet", form="dual-quaternion", stages=LCCNET, inputs={"small": (48, 160), "paper": (352, 1216)})
METHOD = regressor(
    DESIGN,
    lambda options: built(DESIGN, options),
    summary="Regresses the initial error as a dual quaternion in five stages.",
    cite="Schneider, Piewak, Stiller and Franke, RegNet: multimodal sensor registration using deep neural networks, "
    "IV 2017",
)
