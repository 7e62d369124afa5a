from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from p2o import Camera, Cloud, Dataset, Frame, Image, InputError, UnknownNameError
from p2o.frames.frame import LazyFrames


def frame(name: str) -> Frame:
    camera = Camera.pinhole(5, 5, 2, 2, 4, 4)
    return Frame(name, Image(np.zeros((4, 4, 3), np.uint8), camera), Cloud(np.ones((1, 3))))


def recording() -> tuple[LazyFrames, list[str]]:
    read: list[str] = []

    def reader(entry: str) -> Frame:
        read.append(entry)
        return frame(entry)

    return LazyFrames({n: n for n in "abcde"}, reader, {"f": "f.bin is missing"}), read


def test_nothing_is_read_before_it_is_asked_for_indices_are_those_of_a_list_and_left_out_frames_say_why() -> None:
    dataset, read = recording()
    assert isinstance(dataset, Dataset)
    part = dataset[1:4]
    assert (dataset.names, len(dataset), part.names, len(part), read) == (tuple("abcde"), 5, tuple("bcd"), 3, [])
    assert part[1].name == "c"
    assert read == ["c"]
    dataset, _ = recording()
    assert dataset[-1].name == "e"
    assert dataset[::-2].names == tuple("eca")
    assert dataset[1:][:2].names == tuple("bc")
    assert [f.name for f in dataset] == list("abcde")
    with pytest.raises(IndexError):
        dataset[5]
    assert dataset.frame("d").name == "d"
    with pytest.raises(InputError, match=r"frame 'f' is left out; got f\.bin is missing"):
        dataset.frame("f")
    with pytest.raises(UnknownNameError, match="unknown frame 'g'"):
        dataset.frame("g")


class Entries(dict[str, str]):
    """Entries that count how often all names are listed."""

    listed = 0

    def __iter__(self) -> Iterator[str]:
        self.listed += 1
        return super().__iter__()


def test_a_pass_through_all_frames_lists_the_names_once() -> None:
    entries = Entries({f"{number:03}": f"{number:03}" for number in range(50)})
    dataset = LazyFrames(entries, frame)
    assert [one.name for one in dataset] == list(entries.values())
    assert entries.listed == 1
