"""Points of the sweep as a feature: surfaces that hide what is behind them, and what reflectance methods match."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from p2o.arrays import Float, checked
from p2o.features.feature import CloudFeature
from p2o.geometry import se3
from p2o.geometry.motion import moved


@dataclass(frozen=True, eq=False)
class CloudPoints(CloudFeature):
    """Points of one sweep: `xyz` (K, 3) m in the LiDAR frame.

    Optional, per point: `intensity` (K,) as the sensor gives it, `normal` (K, 3) unit surface normals, `time_s` (K,)
    as in `CloudEdges`: when a point of a raw sweep was measured, in seconds from the image.
    """

    word: ClassVar[str] = "cloud-points"

    xyz: Float
    intensity: Float | None = None
    normal: Float | None = None
    time_s: Float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("points of the cloud features", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        for name, shape in (("intensity", (count,)), ("normal", (count, 3)), ("time_s", (count,))):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked(f"{name} of the cloud points", value, shape, np.float64))

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: Any) -> CloudPoints:
        """Return the points of a mask or index."""
        rows = (self.xyz, self.intensity, self.normal, self.time_s)
        return CloudPoints(*(None if values is None else values[keep] for values in rows))  # type: ignore[arg-type]

    def moved(self, b_from_lidar: Float) -> CloudPoints:
        """Return the points in another frame b, by a (4, 4) rigid transform."""
        normal = None if self.normal is None else self.normal @ b_from_lidar[:3, :3].T
        return replace(self, xyz=se3.apply(b_from_lidar, self.xyz), normal=normal)

    def untwisted(self, twist: Float) -> CloudPoints:
        """Return the points as if measured at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        if self.time_s is None:
            return self
        normal = None if self.normal is None else moved(twist, self.time_s, self.normal, directions=True)
        return replace(self, xyz=moved(twist, self.time_s, self.xyz), normal=normal)

    @property
    def times_s(self) -> Float | None:
        """When each point of a raw sweep was measured."""
        return self.time_s

    @property
    def places(self) -> Float:
        """The points themselves."""
        return self.xyz
