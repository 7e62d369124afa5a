"""Frames of large joint calibrations: read again at every access instead of kept in memory."""

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

MAX_FRAMES_IN_MEMORY = 32
"""Joint calibrations of more frames read them again. A frame of KITTI takes 10 MB: 500 of them fill most laptops."""


class _CacheKey:
    """Identifies one image or sweep, however often it is read."""


_keys: WeakKeyDictionary[Any, _CacheKey] = WeakKeyDictionary()


def cache_key(data: Any) -> Any:
    """Return the weak key under which features of an image or sweep are remembered: itself, unless it is read again."""
    return _keys.get(data, data)


@dataclass(frozen=True, eq=False)
class ReadAgain(Sequence[Frame]):
    """Frames of these `indices`, read by `read` at every access, with the truth or without.

    `keys` are the cache keys of images and sweeps by index; features are remembered as long as these frames live.
    """

    read: Callable[[int], Frame]
    indices: Sequence[int]
    truth: bool = True
    keys: dict[tuple[int, str], _CacheKey] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return ReadAgain(self.read, self.indices[number], self.truth, self.keys)
        index = self.indices[number]
        frame = self.read(index)
        parts = {"image": image_at_scale(frame.image), "sweep": frame.sweep, "cloud": frame.cloud}
        for part, data in parts.items():
            if data is not None:
                _keys[data] = self.keys.setdefault((index, part), _CacheKey())
        return frame if self.truth else frame.without_truth()


def without_truth(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Return frames as stages may see them; those that are read again stay so."""
    if isinstance(frames, ReadAgain):
        return ReadAgain(frames.read, frames.indices, truth=False, keys=frames.keys)
    return [frame.without_truth() for frame in frames]


@dataclass(frozen=True, eq=False)
class FrameInfo:
    """What is kept of a frame without its image and sweep.

    `cloud` is there for the first of several frames only (`frame_infos`). Stages get no `camera_from_lidar`.
    """

    name: str
    camera: Camera
    camera_name: str = ""
    camera_from_lidar: Float | None = None
    start: Float | None = None
    twist: Float | None = None
    cloud: Cloud | None = None
    warnings: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()

    @classmethod
    def of(cls, frame: Frame, *names: str) -> FrameInfo:
        """Return the info of a frame: name, camera, remarks, and the fields of these names."""
        kept = {name: getattr(frame, name) for name in ("warnings", "advice", *names)}
        return cls(frame.name, frame.camera, **kept)


def frame_infos(frames: Sequence[Frame]) -> list[FrameInfo]:
    """Return the infos of frames, each of them read once; the first one keeps its sweep."""
    names = ("camera_name", "camera_from_lidar", "start")
    return [FrameInfo.of(frame, *names, *(() if number else ("cloud",))) for number, frame in enumerate(frames)]
