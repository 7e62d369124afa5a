"""Files are written as a whole or not at all: a full disk or an interrupt leaves no half-written file behind."""

from __future__ import annotations

import os
from pathlib import Path

from p2o.errors import InputError


def write_whole(path: Path | str, data: bytes) -> None:
    """Write `data` to a file in an existing folder; another file of that name is replaced in one step.

    Raises InputError if the folder is missing, is no folder, cannot be written, or the disk is full.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        try:
            part.write_bytes(data)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as problem:
        raise InputError(
            "cannot write the file",
            where=path,
            got=problem.strerror or str(problem),
            hint=_hint(path),
        ) from problem


def _hint(path: Path) -> str:
    if path.is_dir():
        return "name a file, not a folder"
    if not path.parent.exists():
        return f"make the folder first: mkdir -p {path.parent}"
    return "check the rights and the free space of the folder, or write elsewhere"
