"""Lanes and poles of a sweep, `--extractor lane-pole/lane-pole`, after CRLF (Ma et al. 2021).

The ground is a plane by RANSAC (0.2 m). Lanes are its points within 10 m to either side that reflect strongly; poles
are columns of a 0.7 m grid that are high, filled all the way up, and stand alone.

Departures from the released code (PJLab lidar2camera/auto_calib): it asks lanes for a reflectance of 80 of 255, ours
for one of the strongest `lane_share` of the ground, since scales differ between sensors. It asks poles to reach 4 m; on
KITTI the highest beam is there only 65 m away, so ours asks for `pole_top_m`, and that the columns around hold nothing
at the height of the chest, else every wall would be poles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int, checked
from p2o.geometry.motion import moved
from scipy.ndimage import maximum_filter

from p2o_baselines.ground import ground_of

LANE, POLE = 0, 1
_STEP_M = 0.5  # a pole has points in every step of its height


@dataclass(frozen=True, eq=False)
class LanePolePoints(p2o.CloudFeature):
    """Points `xyz` (N, 3) m of lanes (`kind` 0) and poles (1); `time_s` (N,) where the sweep is raw."""

    word: ClassVar[str] = "cloud-lane-pole"

    xyz: Float
    kind: Int
    time_s: Float | None = None

    def __post_init__(self) -> None:
        count = len(self.xyz)
        object.__setattr__(self, "xyz", checked("points of lanes and poles", self.xyz, (count, 3), np.float64))
        object.__setattr__(self, "kind", checked("kinds of lanes and poles", self.kind, (count,), np.int64))
        if self.time_s is not None:
            object.__setattr__(self, "time_s", checked("times of lanes and poles", self.time_s, (count,), np.float64))

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: Any) -> LanePolePoints:
        """Return the points of a mask or index."""
        return LanePolePoints(self.xyz[keep], self.kind[keep], None if self.time_s is None else self.time_s[keep])

    def moved(self, b_from_lidar: Float) -> LanePolePoints:
        """Return the points in another frame b, by a (4, 4) rigid transform."""
        return replace(self, xyz=p2o.se3.apply(b_from_lidar, self.xyz))

    def untwisted(self, twist: Float) -> LanePolePoints:
        """Return the points as if measured at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        return self if self.time_s is None else replace(self, xyz=moved(twist, self.time_s, self.xyz))

    @property
    def times_s(self) -> Float | None:
        """When each point of a raw sweep was measured."""
        return self.time_s

    @property
    def places(self) -> Float:
        """The points themselves."""
        return self.xyz


class LanePoleCloudOptions(p2o.Options):
    """Options of the cloud side of `lane-pole`."""

    band_m: float = p2o.field(0.2, gt=0, le=2, help="Half thickness of the ground (CRLF: 0.2).")
    aside_m: float = p2o.field(10.0, gt=0, le=100, help="Lanes lie within this to either side (CRLF: 10).")
    lane_share: float = p2o.field(
        0.03, gt=0, lt=1, help="This share of the ground reflects strongly enough for a lane."
    )
    cell_m: float = p2o.field(0.7, gt=0, le=5, help="Size of a column of poles (CRLF: 0.7).")
    pole_top_m: float = p2o.field(
        2.0, gt=0.5, le=50, help="A pole reaches at least so high above the ground (CRLF: 4)."
    )
    max_range_m: float = p2o.field(50.0, gt=1, le=1000, help="Points farther off are left out.")
    seed: int = p2o.field(0, ge=0, help="Seed of the ground planes that are tried.")


def lanes_of(xyz: Float, height: Float, strength: Float, options: LanePoleCloudOptions) -> Bool:
    """Return which points (N,) are of lanes, given their heights above the ground and reflectance."""
    ground = (np.abs(height) < options.band_m) & (np.abs(xyz[:, 1]) < options.aside_m)
    if not ground.any():
        return ground
    level = np.quantile(strength[ground], 1 - options.lane_share)
    # Ground that is all alike has no lanes.
    return np.asarray(ground & (strength >= level) & (strength > 1.5 * np.median(strength[ground])))


def poles_of(xyz: Float, height: Float, options: LanePoleCloudOptions) -> Bool:
    """Return which points (N,) are of poles, given their heights above the ground."""
    cell = np.floor(xyz[:, :2] / options.cell_m).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    shape = tuple((cell.max(axis=0) + 2).tolist())
    steps = int(np.ceil(options.pole_top_m / _STEP_M))
    filled = np.zeros((*shape, steps), np.bool_)
    level = np.floor(height / _STEP_M).astype(np.int64)
    inside = (level >= 0) & (level < steps) & (height > options.band_m)
    filled[cell[inside, 0], cell[inside, 1], level[inside]] = True
    top = np.full(shape, -np.inf)
    np.maximum.at(top, (cell[:, 0], cell[:, 1]), height)
    high = filled[..., 1:].all(axis=2) & (top >= options.pole_top_m)
    # Alone: none of the columns two steps away holds anything at the height of the chest.
    chest = filled[..., min(2, steps - 1)]
    ring = np.ones((5, 5), np.bool_)
    ring[1:4, 1:4] = False
    alone = ~maximum_filter(chest, footprint=ring, mode="constant", cval=False)
    return np.asarray((high & alone)[cell[:, 0], cell[:, 1]] & (height > options.band_m))


def build(options: LanePoleCloudOptions) -> p2o.CloudExtractor:
    """Return the extractor of the points of lanes and poles."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        near = np.flatnonzero(np.linalg.norm(cloud.xyz, axis=1) <= options.max_range_m)
        # Sorted by place: points in another order are the same sweep.
        near = near[np.lexsort(cloud.xyz[near].T)]
        xyz = cloud.xyz[near]
        plane = ground_of(xyz, np.random.default_rng(options.seed), band_m=options.band_m)
        if plane is None:
            empty = np.zeros((0, 3))
            return p2o.CloudFeatures(features=[LanePolePoints(empty, np.zeros(0, np.int64))])
        height = xyz @ plane[:3] + plane[3]
        strength = np.zeros(len(near)) if cloud.intensity is None else cloud.intensity[near]
        lane, pole = lanes_of(xyz, height, strength, options), poles_of(xyz, height, options)
        keep = lane | pole
        time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[near][keep]
        return p2o.CloudFeatures(features=[LanePolePoints(xyz[keep], np.where(pole, POLE, LANE)[keep], time_s)])

    return extract


METHOD = p2o.Method(
    name="lane-pole",
    build=build,
    options=LanePoleCloudOptions,
    summary="Points of lanes on the ground and of poles that stand on it.",
    needs={"intensity"},
    gives={"cloud-lane-pole"},
    cite="Ma et al., CRLF: automatic calibration and refinement based on line feature, arXiv 2103.04558, 2021",
)
