"""Logs at URLs: copies on the machine of the worker for the duration of a check."""

from __future__ import annotations

import contextlib
import tempfile
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

from p2o.errors import InputError

_WEB = ("http", "https")
_TIMEOUT_S = 60.0
_READERS = {".bag": "ros", ".mcap": "ros", ".db3": "ros"}
"""Data sets of files by suffix; everything else is a folder of frames."""


_MAX_BYTES = 64 << 30
"""Maximum size of a log that is copied."""


@contextlib.contextmanager
def local_data(data: str) -> Iterator[str]:
    """Yield DATASET:PATH of a log on this machine: `data` itself, or a temporary copy if it contains a URL.

    `data` is DATASET:PATH, DATASET:URL or a URL. Web addresses are downloaded, s3://, gs://, hdfs:// and file:// are
    read by Arrow; folders are copied with their content. Raises InputError if the log cannot be fetched, is larger than
    64 GiB, or contains anything but files and folders, such as devices and pipes.
    """
    before, separator, after = data.partition("://")
    if not separator:
        yield data
        return
    reader, _, scheme = before.rpartition(":")
    address, query, options = after.partition("?") if scheme not in _WEB else (after, "", "")
    url = f"{scheme}://{address}"
    name = Path(unquote(urlsplit(url).path)).name or "log"
    with tempfile.TemporaryDirectory(prefix="p2o-fleet-") as folder:
        target = Path(folder) / name
        try:
            (_download if scheme in _WEB else _copy)(url, target)
        except (OSError, ValueError, RuntimeError) as problem:
            raise InputError("the log cannot be fetched", where=url, got=problem) from problem
        yield f"{reader or _READERS.get(target.suffix.lower(), 'folder')}:{target}{query}{options}"


def _download(url: str, target: Path) -> None:
    size = 0
    with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as response, target.open("wb") as file:
        while block := response.read(1 << 20):
            size += len(block)
            _check_size(size)
            file.write(block)


def _copy(url: str, target: Path) -> None:
    """Copy a file or a folder from a file system that Arrow supports."""
    from pyarrow import fs

    system, path = fs.FileSystem.from_uri(url)
    about = system.get_file_info(path)
    if about.type == fs.FileType.NotFound:
        raise FileNotFoundError("there is no such file or folder")
    contents = [about]
    if about.type == fs.FileType.Directory:
        contents += system.get_file_info(fs.FileSelector(path, recursive=True))
        target.mkdir()
    for one in contents:
        if one.type not in (fs.FileType.File, fs.FileType.Directory):
            raise ValueError(f"{one.path} is neither a file nor a folder")
    _check_size(sum(one.size or 0 for one in contents))
    fs.copy_files(path, str(target), source_filesystem=system, destination_filesystem=fs.LocalFileSystem())


def _check_size(size: int) -> None:
    if size > _MAX_BYTES:
        raise ValueError(f"it is larger than {_MAX_BYTES >> 30} GiB")
