"""Many frames of one calibration: read when they are asked for, each time anew, instead of held in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from p2o.arrays import Float
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.scale import image_at_scale
from p2o.geometry.camera import Camera

MOST_HELD = 64
"""So many frames are held, which is quicker. A frame of KITTI takes 10 MB, and 500 of them most laptops' memory."""


class _Stand:
    """Stands for one picture or sweep, however often it is read."""


_stands: WeakKeyDictionary[Any, _Stand] = WeakKeyDictionary()


def lasting(data: Any) -> Any:
    """Return what to remember a picture or sweep by: itself, or what stands for it if it is read again and again."""
    return _stands.get(data, data)


@dataclass(frozen=True, eq=False)
class ReadAgain(Sequence[Frame]):
    """Frames of these `indices`, read by `read`, with the truth or without.

    `stands` are there for as long as these frames are, so that what was found of a frame is found once (`lasting`).
    """

    read: Callable[[int], Frame]
    indices: Sequence[int]
    truth: bool = True
    stands: dict[tuple[int, str], _Stand] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return ReadAgain(self.read, self.indices[number], self.truth, self.stands)
        index = self.indices[number]
        frame = self.read(index)
        seen = {"image": image_at_scale(frame.image), "sweep": frame.sweep, "cloud": frame.cloud}
        for part, data in seen.items():
            if data is not None:
                _stands[data] = self.stands.setdefault((index, part), _Stand())
        return frame if self.truth else frame.without_truth()


def without_truth(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Return frames as stages may see them; those that are read again stay so."""
    if isinstance(frames, ReadAgain):
        return ReadAgain(frames.read, frames.indices, truth=False, stands=frames.stands)
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
