"""Files are written as a whole or not at all: a full disk or an interrupt leaves no half-written file behind."""

from __future__ import annotations

import os
from pathlib import Path

from p2o.errors import InputError


def write_whole(path: Path | str, data: bytes) -> None:
    """Write `data` to a file in an existing folder; another file of that name is replaced in one step.

    Raises InputError if the folder is missing, is no folder, cannot be written, or the disk is full, and for a name
    that is a folder, a device or a pipe.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        if path.exists() and not path.is_file():
            # Whoever may do everything would put a file in the place of /dev/null.
            raise OSError(0, "it is a device, a pipe or a socket")
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
    if os.path.exists(path) and not os.path.isfile(path):
        return "name a file, not a folder"
    if not path.parent.exists():
        return f"make the folder first: mkdir -p {path.parent}"
    return "check the rights and the free space of the folder, or write elsewhere"
