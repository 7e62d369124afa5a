"""Datasets whose sweeps are joined with those of neighbouring frames as they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from p2o.errors import InputError
from p2o.frames.frame import Dataset, Frame
from p2o.host.stages import Accumulator


class JoinedFrames(Sequence[Frame]):
    """The frames of a dataset, each with a cloud that an accumulator makes of its sweep and its neighbours'.

    Neighbours are the frames before and after it in the dataset that are of the same sequence and the same camera, as
    those of another one hold the same sweeps. The frame's own sweep stays in `Frame.sweep`. A frame that stands alone
    raises InputError. So many frames as belong together are kept in memory, so that whoever goes through a drive reads
    each of them once.
    """

    def __init__(self, dataset: Sequence[Frame] | Dataset, accumulate: Accumulator) -> None:
        self._dataset, self._accumulate = dataset, accumulate
        self._read = lru_cache(accumulate.past + 1 + accumulate.future)(dataset.__getitem__)
        self._drives: dict[int, tuple[str, str]] = {}
        self.skipped: Mapping[str, str] = getattr(dataset, "skipped", {})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, in order."""
        names = getattr(self._dataset, "names", None)
        return tuple(names) if names is not None else tuple(frame.name for frame in self._dataset)  # type: ignore[union-attr]

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        frame = self._read(index)
        if not frame.sequence:
            raise InputError(
                "the frame is of no sequence, so no other sweep belongs to it",
                where=frame.name,
                expected="frames with `sequence`",
                hint="leave out --accumulate, or say the sequence in frame.yaml",
            )
        before = self._neighbours(frame, range(index - 1, -1, -1), self._accumulate.past)[::-1]
        after = self._neighbours(frame, range(index + 1, len(self)), self._accumulate.future)
        frames = [*before, frame, *after]
        cloud = self._accumulate([f.without_truth() for f in frames], len(before))
        return replace(frame, cloud=cloud, sweep=frame.cloud)

    def camera_name(self, index: int) -> str:
        """Return the camera that a frame names, without joining anything."""
        return self._drive(index)[1]

    def _neighbours(self, frame: Frame, indices: range, count: int) -> list[Frame]:
        """Return the first frames of these indices that are of the frame's camera, up to the end of the sequence."""
        found: list[Frame] = []
        for i in indices:
            if len(found) == count:
                break
            # Which drive a frame is of is kept: frames of other cameras are not read again to be left out.
            sequence, camera = self._drives.get(i) or self._drive(i)
            if sequence != frame.sequence:
                break
            if camera == frame.camera_name:
                found.append(self._read(i))
        return found

    def _drive(self, index: int) -> tuple[str, str]:
        frame = self._read(index)
        return self._drives.setdefault(index, (frame.sequence, frame.camera_name))
