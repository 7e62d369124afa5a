"""What a calibration file holds: a camera, where it stands on the LiDAR, and what its frames are called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.camera import Camera

CAMERA, EXTRINSIC = "camera", "extrinsic"
PARTS = (CAMERA, EXTRINSIC)
"""The two things that a calibration file may hold."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera, camera_from_lidar (4, 4), or both; None for what the file does not say.

    The camera's axes are x right, y down, z forward. `lidar_frame` and `camera_frame` are the names that a file gives
    them, empty without. `remarks` are sentences about what was read.

    Raises InputError for a transform that is not rigid.
    """

    camera: Camera | None = None
    camera_from_lidar: Float | None = None
    lidar_frame: str = ""
    camera_frame: str = ""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.camera_from_lidar is not None:
            pose = se3.check_rigid("camera_from_lidar", self.camera_from_lidar)
            # The numbers themselves, not the nearest rotation: what is written is to the last bit what was given.
            given = np.array(self.camera_from_lidar, dtype=np.float64)
            exact = np.abs(given - pose).max() < 1e-12
            given.flags.writeable = False
            object.__setattr__(self, "camera_from_lidar", given if exact else pose)

    @property
    def held(self) -> frozenset[str]:
        """Which of `PARTS` it holds."""
        said = {CAMERA: self.camera, EXTRINSIC: self.camera_from_lidar}
        return frozenset(part for part, value in said.items() if value is not None)

    def extrinsic(self, where: object = None) -> Float:
        """Return camera_from_lidar (4, 4); raises InputError where there is none."""
        if self.camera_from_lidar is None:
            raise InputError("there is no extrinsic in it", where=where, expected="a transform of camera and LiDAR")
        return self.camera_from_lidar

    def intrinsics(self, where: object = None) -> Camera:
        """Return the camera; raises InputError where there is none."""
        if self.camera is None:
            raise InputError("there is no camera in it", where=where, expected="intrinsics of a camera")
        return self.camera
