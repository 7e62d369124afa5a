"""Regress the extrinsic from a cost volume between both sensors: `--calibrator lccnet`, after Lv et al. 2021.

ResNet-18 branches process the image and the sweep projected at the initial extrinsic; PWC-Net's cost volume correlates
each cell of one with the 81 cells around it in the other; its dense estimator and two layers per head give a quaternion
and a translation. Five networks for five ranges of initial errors (20 deg and 1.5 m to 1 deg and 0.1 m) are applied in
sequence; several frames give the median. Losses: smooth L1 of the translation, the angle of the quaternions, and the
distance of points.

Departures: nearness on a logarithmic scale instead of depth; points next to the car are kept; losses are normalised by
the range of the stage. `small` has one network for all stages, with the range as an input, branches of 48 channels at
an eighth of 48 x 160 px, four convolutions after the volume, and the features of the sweep as further inputs. Its
shipped weights were trained with `match`, which no paper has.
"""

from __future__ import annotations

from p2o_baselines.regressors.design import LCCNET, Design
from p2o_baselines.regressors.method import built, regressor

DESIGN = Design(name="lccnet", form="quaternion", stages=LCCNET, inputs={"small": (48, 160), "paper": (256, 512)})
METHOD = regressor(
    DESIGN,
    lambda options: built(DESIGN, options),
    summary="Regresses the initial error with a cost-volume network in five stages.",
    cite="Lv, Wang, Dou, Ye and Wang, LCCNet: LiDAR and camera self-calibration using cost volume network, CVPRW 2021",
)
