"""Frames whose sweeps are joined: which neighbours belong to them, and how often each is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from p2o import Camera, Cloud, Frame, Image, InputError
from p2o.run.joined import JoinedFrames

IMAGE = Image(np.zeros((5, 7, 3), np.uint8), Camera.pinhole(5, 5, 3, 2, 7, 5))


@dataclass
class Drives(Sequence[Frame]):
    """Frames of drives of four frames each; point i of the world is what frame i sees."""

    count: int = 8
    read: list[int] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{number // 4}/{number}" for number in range(self.count))

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: Any) -> Any:
        self.read.append(index)
        truth = np.eye(4)
        return Frame(self.names[index], IMAGE, Cloud([[1.0, index, 0.0]]), truth, sequence=f"drive-{index // 4}")


@dataclass
class Numbers:
    """Joins sweeps as they are, and notes what it was given."""

    past: int = 1
    future: int = 2
    seen: list[Sequence[Frame]] = field(default_factory=list)

    def __call__(self, frames: Sequence[Frame], number: int, /) -> Cloud:
        self.seen.append(frames)
        return Cloud(np.vstack([frames[number].cloud.xyz, *(frame.cloud.xyz for frame in frames)]))


@pytest.mark.parametrize(
    ("index", "sees"), [(0, [0, 1, 2]), (1, [0, 1, 2, 3]), (3, [2, 3]), (4, [4, 5, 6]), (-1, [6, 7])]
)
def test_a_frame_is_joined_with_its_neighbours_of_the_same_drive(index: int, sees: list[int]) -> None:
    accumulate = Numbers()
    frame = JoinedFrames(Drives(), accumulate)[index]
    own = range(8)[index]
    assert frame.cloud.xyz[:, 1].tolist() == [own, *sees]
    assert frame.sweep.xyz[:, 1].tolist() == [own]
    assert frame.camera_from_lidar is not None
    assert all(seen.camera_from_lidar is None for frames in accumulate.seen for seen in frames), "never the truth"


def test_going_through_a_drive_reads_each_frame_once_and_none_for_names() -> None:
    drives = Drives()
    frames = JoinedFrames(drives, Numbers())
    assert (frames.names, drives.read) == (drives.names, [])
    assert [frame.name for frame in frames] == list(frames.names)
    # The frame that ends a drive is followed by one that is read to see that it is of another.
    assert sorted(drives.read) == list(range(8))


@dataclass
class TwoCameras(Drives):
    """The same drives, each moment seen by two cameras."""

    def __getitem__(self, index: Any) -> Any:
        return replace(super().__getitem__(index), sequence="drive", camera_name="LR"[index % 2])


def test_neighbours_are_frames_of_the_same_camera() -> None:
    dataset = TwoCameras()
    joined = JoinedFrames(dataset, Numbers())
    assert joined[4].cloud.xyz[:, 1].tolist() == [4, 2, 4, 6]
    # Those of the other camera are looked at once, to tell that they are of another one.
    assert joined[2].cloud.xyz[:, 1].tolist() == [2, 0, 2, 4, 6]
    assert dataset.read.count(3) == 1


@dataclass
class Nameless(Sequence[Frame]):
    """The same drives, whose names are in the frames only."""

    drives: Drives = field(default_factory=Drives)

    def __len__(self) -> int:
        return len(self.drives)

    def __getitem__(self, index: Any) -> Any:
        return self.drives[index]


def test_a_dataset_without_names_is_read_once_for_names_and_cameras_and_a_frame_alone_refused() -> None:
    nameless = Nameless()
    joined = JoinedFrames(nameless, Numbers())
    assert [joined.names[i] for i in range(8)] == list(nameless.drives.names)
    assert [joined.camera_name(i) for i in range(8)] == [""] * 8
    assert sorted(nameless.drives.read) == list(range(8))
    alone = Frame("alone", IMAGE, Cloud([[1.0, 2.0, 3.0]]))
    with pytest.raises(InputError, match="alone: the frame is of no sequence"):
        JoinedFrames([alone], Numbers())[0]
