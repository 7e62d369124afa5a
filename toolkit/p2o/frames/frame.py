"""One image with its sweep, and what is known about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, overload, runtime_checkable

import numpy as np

from p2o.arrays import Float, checked
from p2o.frames.cloud import Cloud
from p2o.frames.image import Image
from p2o.geometry import se3
from p2o.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """Image and sweep taken together.

    `camera_from_lidar` (4, 4) is the true extrinsic where it is known; `start` (4, 4) a first guess that the dataset
    itself offers (a mechanical drawing). `twist` (6,) is the velocity of the LiDAR in its own frame (rad/s, then m/s)
    where ego-motion is known. `warnings` are remarks of the reader that the result repeats.
    """

    name: str
    image: Image
    cloud: Cloud
    camera_from_lidar: Float | None = None
    start: Float | None = None
    twist: Float | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("camera_from_lidar", "start"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, se3.check_rigid(name, getattr(self, name), where=self.name))
        if self.twist is not None:
            object.__setattr__(self, "twist", checked("twist", self.twist, (6,), np.float64))

    @property
    def camera(self) -> Camera:
        """The camera of the image."""
        return self.image.camera

    def without_truth(self) -> Frame:
        """Return the frame as a stage may see it: the true extrinsic removed."""
        return replace(self, camera_from_lidar=None)


@runtime_checkable
class Dataset(Protocol):
    """A sequence of frames that are read when they are asked for; `names` are known without reading them."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all frames, in order (KITTI raw: date/drive/frame)."""
        ...

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
