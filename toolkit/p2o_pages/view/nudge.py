"""Manual corrections of a pose: rotation about and translation along the axes of the camera or of the LiDAR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from p2o.arrays import Float
from p2o.geometry import se3

Axes = Literal["camera", "LiDAR"]
AXES: tuple[Axes, ...] = get_args(Axes)


@dataclass(frozen=True)
class Nudge:
    """A correction of the sweep: a rotation vector, then a translation, both in the axes of `axes`.

    In camera axes (x right, y down, z forward) the centre of rotation is the camera, in LiDAR axes the LiDAR.
    """

    axes: Axes = "camera"
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def zero(self) -> bool:
        """True for no correction."""
        return not any((*self.turn_deg, *self.shift_m))

    def applied(self, camera_from_lidar: Float) -> Float:
        """Return the corrected camera_from_lidar (4, 4); bit-identical to the given one if `zero`."""
        if self.zero:
            return camera_from_lidar
        turn = se3.exp(np.array([*np.radians(self.turn_deg), 0.0, 0.0, 0.0]))
        moved_from_given = se3.make(turn[:3, :3], self.shift_m)
        chain = (
            (moved_from_given, camera_from_lidar) if self.axes == "camera" else (camera_from_lidar, moved_from_given)
        )
        return np.asarray(chain[0] @ chain[1])
