"""Extract lanes and poles of a sweep, `--extractor lane-pole/lane-pole`, after CRLF (Ma et al. 2021).

The ground is a plane by RANSAC (0.2 m). Lanes are its points within 10 m to either side with a high reflectance; poles
are isolated columns of a 0.7 m grid that are high and filled at every height.

Departures from the released code (PJLab lidar2camera/auto_calib): it requires a reflectance of 80 of 255 for lanes,
here they are the strongest 3 % of the ground, since scales differ between sensors. It requires poles to reach
4 m; on KITTI the highest beam is that high only at 65 m, so `pole_top_m` is used instead, and the surrounding columns
must be empty at chest height, because otherwise every wall would be poles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import p2o
from p2o import Bool, Float, Int, field
from scipy.ndimage import maximum_filter

from p2o_baselines.point_feature import PointFeature, raw_times, rows_in_range
from p2o_baselines.segments.cloud_segments import ground_of

LANE, POLE = 0, 1
_STEP_M = 0.5  # a pole has points in every step of its height


@dataclass(frozen=True, eq=False)
class LanePolePoints(PointFeature):
    """Points `xyz` (N, 3) m of lanes (`kind` 0) and poles (1); `time_s` (N,) for a raw sweep."""

    word: ClassVar[str] = "cloud-lane-pole"

    xyz: Float
    kind: Int
    time_s: Float | None = None


_LANE_SHARE = 0.03  # share of the ground that reflects as strongly as a lane
_MAX_RANGE_M = 50.0  # drop points farther than this
_ASIDE_M = 10.0  # largest lateral distance of lanes (CRLF: 10)
_CELL_M = 0.7  # size of a column of poles (CRLF: 0.7)
_BAND_M = 0.2  # half thickness of the ground (CRLF: 0.2)


class LanePoleCloudOptions(p2o.Options):
    """Options of the cloud side of `lane-pole`."""

    pole_top_m: float = field(2.0, gt=0.5, le=50, help="Least height of a pole above the ground (CRLF: 4).")


def lanes_of(xyz: Float, height: Float, strength: Float, options: LanePoleCloudOptions) -> Bool:
    """Return which points (N,) are of lanes, given their heights above the ground and reflectance."""
    ground = (np.abs(height) < _BAND_M) & (np.abs(xyz[:, 1]) < _ASIDE_M)
    if not ground.any():
        return ground
    level = np.quantile(strength[ground], 1 - _LANE_SHARE)
    # Ground of uniform reflectance has no lanes.
    return np.asarray(ground & (strength >= level) & (strength > 1.5 * np.median(strength[ground])))


def poles_of(xyz: Float, height: Float, options: LanePoleCloudOptions) -> Bool:
    """Return which points (N,) are of poles, given their heights above the ground."""
    cell = np.floor(xyz[:, :2] / _CELL_M).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    shape = tuple((cell.max(axis=0) + 2).tolist())
    steps = int(np.ceil(options.pole_top_m / _STEP_M))
    filled = np.zeros((*shape, steps), np.bool_)
    level = np.floor(height / _STEP_M).astype(np.int64)
    inside = (level >= 0) & (level < steps) & (height > _BAND_M)
    filled[cell[inside, 0], cell[inside, 1], level[inside]] = True
    top = np.full(shape, -np.inf)
    np.maximum.at(top, (cell[:, 0], cell[:, 1]), height)
    high = filled[..., 1:].all(axis=2) & (top >= options.pole_top_m)
    # Isolated: the columns two steps away have no returns at chest height.
    chest = filled[..., min(2, steps - 1)]
    ring = np.ones((5, 5), np.bool_)
    ring[1:4, 1:4] = False
    alone = ~maximum_filter(chest, footprint=ring, mode="constant", cval=False)
    return np.asarray((high & alone)[cell[:, 0], cell[:, 1]] & (height > _BAND_M))


def extract(cloud: p2o.Cloud, options: LanePoleCloudOptions) -> p2o.CloudFeatures:
    """Return the points of lanes and poles of a sweep."""
    near = rows_in_range(cloud, _MAX_RANGE_M)
    xyz = cloud.xyz[near]
    plane = ground_of(xyz, np.random.default_rng(0), band_m=_BAND_M)
    if plane is None:
        return p2o.CloudFeatures(features=[LanePolePoints(np.zeros((0, 3)), np.zeros(0, np.int64))])
    height = xyz @ plane[:3] + plane[3]
    strength = np.zeros(len(near)) if cloud.intensity is None else cloud.intensity[near]
    lane, pole = lanes_of(xyz, height, strength, options), poles_of(xyz, height, options)
    keep = lane | pole
    kind = np.where(pole, POLE, LANE)[keep]
    return p2o.CloudFeatures(features=[LanePolePoints(xyz[keep], kind, raw_times(cloud, near[keep]))])


METHOD = p2o.Method(
    name="lane-pole",
    build=lambda options: lambda cloud: extract(cloud, options),
    options=LanePoleCloudOptions,
    summary="Points of lanes on the ground and of poles that stand on it.",
    needs={"intensity"},
    gives={"cloud-lane-pole"},
    cite="Ma et al., CRLF: automatic calibration and refinement based on line feature, arXiv 2103.04558, 2021",
)
