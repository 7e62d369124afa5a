"""Write files atomically: a full disk or an interrupt leaves no partial file."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from p2o.errors import InputError


def write_whole(path: Path | str, data: bytes) -> None:
    """Write `data` to a file in an existing folder; an existing file is replaced atomically.

    Raises InputError if the folder is missing or cannot be written, the disk is full, or the path is a folder, a
    device or a pipe.
    """
    _write(path, data, sync=False)


def write_synced(path: Path | str, data: bytes) -> None:
    """Write as `write_whole`, with the content on the disk before the file has its name, as `sync_folder` for names."""
    _write(path, data, sync=True)


def _write(path: Path | str, data: bytes, *, sync: bool) -> None:
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        if path.exists() and not path.is_file():
            # The superuser would replace /dev/null by a file.
            raise OSError(0, "it is a device, a pipe or a socket")
        try:
            part.write_bytes(data)
            if sync:
                with part.open("r+b") as file:
                    os.fsync(file.fileno())
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as problem:
        got = problem.strerror or str(problem)
        raise InputError("cannot write the file", where=path, got=got, hint=_hint(path)) from problem


def sync_folder(folder: Path) -> None:
    """Write the names of the files in a folder to the disk; raises OSError if that fails.

    Windows, and file systems that cannot do it, write names with the files.
    """
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


def json_text(value: Any) -> str:
    """Return a value as JSON text with indentation, ending in a newline."""
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(path: Path, value: Any) -> None:
    """Write a value as `json_text`; raises InputError as `write_whole`, and OSError if the folder cannot be created."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json_text(value).encode())


@contextlib.contextmanager
def write_errors(what: str, where: Path, hint: str | None = None) -> Iterator[None]:
    """Convert errors of the operating system to InputError "cannot write WHAT"; `where` is the file or folder."""
    try:
        yield
    except OSError as problem:
        got = problem.strerror or str(problem)
        raise InputError(f"cannot write {what}", where=where, got=got, hint=hint) from problem


def _hint(path: Path) -> str:
    if os.path.exists(path) and not os.path.isfile(path):
        return "name a file, not a folder"
    if not path.parent.exists():
        return f"create the folder first: mkdir -p {path.parent}"
    return "check permissions and free space of the folder, or write to another one"


def make_writable(folder: Path) -> None:
    """Create a folder if needed and write a temporary file to it; raises OSError if that fails."""
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".p2o-{os.getpid()}"
    probe.write_bytes(b"")
    probe.unlink()
