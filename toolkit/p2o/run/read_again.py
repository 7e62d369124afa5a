"""Many frames of one calibration: read when they are asked for, each time anew, instead of held in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from p2o.arrays import Float
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.geometry.camera import Camera

MOST_HELD = 64
"""So many frames are held, which is quicker. A frame of KITTI takes 10 MB, and 500 of them most laptops' memory."""


@dataclass(frozen=True, eq=False)
class ReadAgain(Sequence[Frame]):
    """Frames of these `indices`, read by `read`, with the truth or without."""

    read: Callable[[int], Frame]
    indices: Sequence[int]
    truth: bool = True

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return ReadAgain(self.read, self.indices[number], self.truth)
        frame = self.read(self.indices[number])
        return frame if self.truth else frame.without_truth()


def without_truth(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Return frames as stages may see them; those that are read again stay so."""
    if isinstance(frames, ReadAgain):
        return ReadAgain(frames.read, frames.indices, truth=False)
    return [frame.without_truth() for frame in frames]


@dataclass(frozen=True, eq=False)
class Told:
    """What a frame says beside its picture and its sweep; `cloud` is there where it is needed (`told`)."""

    name: str
    camera: Camera
    camera_name: str
    camera_from_lidar: Float | None
    start: Float | None
    cloud: Cloud | None = None


def told(frames: Sequence[Frame]) -> list[Told]:
    """Return what frames say, each of them read once; the first one keeps its sweep."""
    return [
        Told(
            frame.name,
            frame.camera,
            frame.camera_name,
            frame.camera_from_lidar,
            frame.start,
            None if number else frame.cloud,
        )
        for number, frame in enumerate(frames)
    ]
