"""The files of `--export`: which there will be is known before any work, and written as results come."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from p2o.errors import InputError

if TYPE_CHECKING:
    from p2o.host.registry import Registry
    from p2o.host.stages import Exporter
    from p2o.results.result import Result

PLACE = "{frame}"
"""What stands for the name of the frame in a path; "{camera}" for that of a camera of a rig."""


@dataclass(frozen=True)
class Export:
    """One text NAME:PATH; `files` are the paths by frame, once the frames are known."""

    text: str
    exporter: Exporter
    path: Path
    files: Mapping[str, Path] = field(default_factory=dict)
    place: str = PLACE

    @classmethod
    def of(cls, text: str, registry: Registry) -> Export:
        """Return what the text means; raises as `open_exporter`."""
        from p2o.run.recipe import open_exporter

        return cls(text, *open_exporter(text, registry))

    def for_frames(self, names: Mapping[str, str], place: str = PLACE) -> Export:
        """Return it with the files of frames, whose names as files are given and stand at `place` in the path.

        Raises InputError where several frames would be one file, or a file could not be written.
        """
        if len(names) > 1 and place not in str(self.path):
            raise InputError(
                "several results do not fit in one file",
                where="--export",
                expected=f"a path with {place} in it" + (", or --joint" if place == PLACE else ""),
                got=self.text,
            )
        files = {frame: Path(str(self.path).replace(place, name)) for frame, name in names.items()}
        for file in files.values():
            _check_place(file, made=place in str(self.path.parent))
        return Export(self.text, self.exporter, self.path, files, place)

    def write(self, result: Result, frame: str) -> None:
        """Write the result that is called after a frame, or after a camera of a rig."""
        file = self.files[frame]
        if self.place in str(self.path.parent):
            file.parent.mkdir(parents=True, exist_ok=True)
        self.exporter(result, file)


def check_apart(exports: Sequence[Export], taken: Sequence[Path] = ()) -> None:
    """Raise InputError where two exports would write one file, or one of those that are `taken` by --out."""
    known = {_key(path): "--out" for path in taken}
    for export in exports:
        for file in export.files.values():
            other = known.setdefault(_key(file), export.text)
            if other is not export.text:
                raise InputError("two outputs would be one file", where=file, got=f"{other} and --export {export.text}")


def _key(path: Path) -> str:
    """Return what tells files apart on every system."""
    return str(path.absolute()).lower()


def _check_place(file: Path, *, made: bool) -> None:
    """Raise InputError where a file cannot be written; with `made` its folder is made for it."""
    try:
        if file.is_dir():
            raise InputError("the export is a folder", where=file, expected=f"--export NAME:{file}/{PLACE}.txt")
        if not (made or file.parent.is_dir()):
            raise InputError(
                "the folder of the export is missing", where=file, hint=f"make it first: mkdir -p {file.parent}"
            )
    except OSError as problem:
        raise InputError("cannot write the export", where=file, got=problem.strerror or problem) from problem
