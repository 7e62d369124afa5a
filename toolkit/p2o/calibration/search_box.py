"""The box of poses around the initial extrinsic in which an initializer searches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.geometry import se3

_MARGIN = 1.1
"""Relative enlargement of the box: rotations and translations depend on the order of composition."""


@dataclass(frozen=True)
class SearchBox:
    """Half sizes of the box about (deg) and along (m) each axis of the camera, around the initial extrinsic."""

    deg: float
    metres: float

    def has(self, start: Float, pose: Float) -> bool:
        """Return whether a pose (4, 4) is within the box around the initial extrinsic (4, 4), with a margin of 10 %.

        The step between them counts by the smaller of two measures, because the accuracy of an initial guess is stated
        in either: rotation vector or Euler angles; translation of the LiDAR, or of the camera frame.
        """
        from scipy.spatial.transform import Rotation

        step = pose @ se3.inverse(start)
        turn = Rotation.from_matrix(step[:3, :3])
        angles = (np.degrees(turn.as_rotvec()), turn.as_euler("xyz", degrees=True))
        shifts = (step[:3, 3], pose[:3, 3] - start[:3, 3])
        turned = min(float(np.abs(angle).max()) for angle in angles)
        moved = min(float(np.abs(shift).max()) for shift in shifts)
        return turned <= _MARGIN * self.deg and moved <= _MARGIN * self.metres

    @property
    def text(self) -> str:
        """The box in words."""
        return f"{self.deg:g} deg about and {self.metres:g} m along each axis"
