"""Write files that a loss of power does not remove: content and names are on the disk before a function returns."""

from __future__ import annotations

import errno
import os
from pathlib import Path

_ATTEMPTS = 10


def write_durable(path: Path, data: bytes, root: Path) -> None:
    """Write a file and the folders from `root` to it to the disk; an existing file is replaced atomically.

    Folders that are missing are created, also if another process removes an empty one at the same time. Raises OSError
    if that fails: no partial file remains.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    for attempt in range(1, _ATTEMPTS + 1):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = part.open("wb")
            break
        except FileNotFoundError:
            if attempt == _ATTEMPTS:
                raise
    try:
        with file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    folder = path.parent
    sync_folder(folder)
    while folder != root:
        folder = folder.parent
        sync_folder(folder)


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
