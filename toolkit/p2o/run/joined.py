"""Datasets with accumulated sweeps: each sweep is joined with those of neighbouring frames when it is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from p2o.errors import InputError
from p2o.frames.frame import Dataset, Frame
from p2o.host.stages import Accumulator


class _Source(NamedTuple):
    """Where a frame belongs: its name, its sequence and the name of its camera."""

    name: str
    sequence: str
    camera: str


class JoinedFrames(Sequence[Frame]):
    """The frames of a dataset, each with a cloud that an accumulator makes of its sweep and its neighbours'.

    Neighbours are the previous and next frames of the same sequence and the same camera; frames of another camera hold
    the same sweeps. The frame's own sweep stays in `Frame.sweep`. A frame without a sequence raises InputError. The
    frames that the accumulator joins are kept in memory, so that a pass through a drive reads each frame once.
    """

    def __init__(self, dataset: Sequence[Frame] | Dataset, accumulate: Accumulator) -> None:
        self._dataset, self._accumulate = dataset, accumulate
        self._read = lru_cache(accumulate.past + 1 + accumulate.future)(dataset.__getitem__)
        self._sources: dict[int, _Source] = {}
        self.skipped: Mapping[str, str] = getattr(dataset, "skipped", {})

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, in order; a dataset that has no names is read once for them."""
        names = getattr(self._dataset, "names", None)
        return tuple(self._source(i).name for i in range(len(self))) if names is None else tuple(names)

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        frame = self._read(index)
        if not frame.sequence:
            text = "the frame is of no sequence, so no other sweep belongs to it"
            hint = "leave out --accumulate, or give the sequence in frame.yaml"
            raise InputError(text, where=frame.name, expected="frames with `sequence`", hint=hint)
        before = self._neighbours(frame, range(index - 1, -1, -1), self._accumulate.past)[::-1]
        after = self._neighbours(frame, range(index + 1, len(self)), self._accumulate.future)
        frames = [*before, frame, *after]
        cloud = self._accumulate([f.without_truth() for f in frames], len(before))
        return replace(frame, cloud=cloud, sweep=frame.cloud)

    def camera_name(self, index: int) -> str:
        """Return the name of a frame's camera, without joining sweeps."""
        return self._source(index).camera

    def _neighbours(self, frame: Frame, indices: range, count: int) -> list[Frame]:
        """Return the first `count` frames of these indices of the frame's camera, up to the end of its sequence."""
        neighbours: list[Frame] = []
        for i in indices:
            if len(neighbours) == count:
                break
            # Remembered, so that frames of other cameras are not read again only to be skipped.
            source = self._source(i)
            if source.sequence != frame.sequence:
                break
            if source.camera == frame.camera_name:
                neighbours.append(self._read(i))
        return neighbours

    def _source(self, index: int) -> _Source:
        if index not in self._sources:
            frame = self._read(index)
            self._sources[index] = _Source(frame.name, frame.sequence, frame.camera_name)
        return self._sources[index]
