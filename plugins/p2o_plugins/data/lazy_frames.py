"""The sequence that every dataset of this folder returns: names now, frames when asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

from p2o import Frame, InputError, UnknownNameError


@dataclass(frozen=True, eq=False)
class LazyFrames(Sequence[Frame]):
    """Frames read one by one with `read(entry)`; `entries` maps names, in order, to what `read` needs.

    `skipped` maps names of frames that are left out to the reason, which names the missing file. Slices are lazy too.
    """

    entries: Mapping[str, Any]
    read: Callable[[Any], Frame]
    skipped: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, in order."""
        return tuple(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> LazyFrames: ...
    def __getitem__(self, index: int | slice) -> Frame | LazyFrames:
        names = self.names[index]
        if isinstance(names, str):
            return self.read(self.entries[names])
        return replace(self, entries={name: self.entries[name] for name in names})

    def frame(self, name: str) -> Frame:
        """Return the frame of a name.

        Raises InputError with the missing file for a frame that was left out, UnknownNameError for any other name.
        """
        if name in self.entries:
            return self.read(self.entries[name])
        if name in self.skipped:
            raise InputError(f"frame '{name}' is left out", got=self.skipped[name])
        raise UnknownNameError("frame", name, self.names)
