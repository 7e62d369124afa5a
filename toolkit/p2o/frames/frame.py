"""One image with its sweep, and what is known about them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, overload, runtime_checkable

import numpy as np

from p2o.arrays import Float, checked
from p2o.errors import InputError, printable
from p2o.frames.cloud import Cloud
from p2o.frames.image import Image
from p2o.frames.target import Target
from p2o.geometry import se3
from p2o.geometry.camera import Camera

_LONGEST_CAMERA = 100
_GAP = re.compile(r"[\s,]")


@dataclass(frozen=True, eq=False)
class Frame:
    """Image and sweep taken together.

    `camera_from_lidar` (4, 4) is the true extrinsic where it is known; `start` (4, 4) a first guess that the dataset
    itself offers (a mechanical drawing). `twist` (6,) is the velocity of the LiDAR in its own frame (rad/s, then m/s)
    where ego-motion is known. `warnings` are remarks of the reader that the result repeats.

    `sequence` names the drive that the frame is of, empty where it stands alone; `time_s` is when its image was taken,
    on one clock for the whole sequence. `lidar_world_from_lidar` and `camera_world_from_camera` (4, 4) are the poses of
    the sensors at that time, each in a world of its own, where they are known: the two worlds differ by what nobody
    knows, so that both together tell the extrinsic only by how the sensors move (hand-eye), never by a single pose.
    `targets` are the calibration targets in view: what they are, not where. `sweep` is the frame's own sweep where
    `cloud` joins several. `camera_name` is the word for the camera on its rig ("CAM_FRONT"), empty where there is one
    camera only.

    Raises InputError for poses that are not rigid, a twist or time that is not finite, things that are no targets, and
    a name of a camera that is no word.
    """

    name: str
    image: Image
    cloud: Cloud
    camera_from_lidar: Float | None = None
    start: Float | None = None
    twist: Float | None = None
    warnings: tuple[str, ...] = ()
    sequence: str = ""
    time_s: float | None = None
    lidar_world_from_lidar: Float | None = None
    camera_world_from_camera: Float | None = None
    targets: tuple[Target, ...] = ()
    sweep: Cloud | None = None
    camera_name: str = ""

    def __post_init__(self) -> None:
        for name in ("camera_from_lidar", "start", "lidar_world_from_lidar", "camera_world_from_camera"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, se3.check_rigid(name, getattr(self, name), where=self.name))
        if self.twist is not None:
            object.__setattr__(self, "twist", checked("twist", self.twist, (6,), np.float64))
        if self.time_s is not None:
            object.__setattr__(self, "time_s", float(checked("time_s", [self.time_s], (1,), np.float64)[0]))
        if self.camera_name:
            check_camera_name(self.camera_name, where=self.name)
        object.__setattr__(self, "targets", tuple(self.targets))
        strange = [target for target in self.targets if not isinstance(target, Target)]
        if strange:
            raise InputError(
                "a target is none",
                where=self.name,
                expected="Checkerboard, HoleBoard, Sphere or Box",
                got=type(strange[0]).__name__,
            )

    @property
    def camera(self) -> Camera:
        """The camera of the image."""
        return self.image.camera

    def without_truth(self) -> Frame:
        """Return the frame as a stage may see it: the true extrinsic removed."""
        return replace(self, camera_from_lidar=None)


def check_camera_name(name: object, *, where: object = None) -> str:
    """Return a name of a camera; raises InputError unless it is a word that a terminal only shows."""
    if isinstance(name, str) and 0 < len(name) <= _LONGEST_CAMERA and printable(name) == name and not _GAP.search(name):
        return name
    raise InputError(
        "the name of a camera is no word",
        where=where,
        expected=f"1 to {_LONGEST_CAMERA} characters without blanks and commas, such as CAM_FRONT",
        got=repr(name)[:80],
    )


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
