"""Logs at URLs: copies on the machine of the worker for the duration of a check."""

from __future__ import annotations

import contextlib
import shutil
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


@contextlib.contextmanager
def local_data(data: str) -> Iterator[str]:
    """Yield DATASET:PATH of a log on this machine: `data` itself, or a temporary copy if it contains a URL.

    `data` is DATASET:PATH, DATASET:URL or a URL. Web addresses are downloaded, s3://, gs://, hdfs:// and file:// are
    read by Arrow; folders are copied with their content. Raises InputError if the log cannot be fetched.
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
            if scheme in _WEB:
                with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as response, target.open("wb") as file:
                    shutil.copyfileobj(response, file)
            else:
                _copy(url, target)
        except (OSError, ValueError, RuntimeError) as problem:
            raise InputError("the log cannot be fetched", where=url, got=problem) from problem
        yield f"{reader or _READERS.get(target.suffix.lower(), 'folder')}:{target}{query}{options}"


def _copy(url: str, target: Path) -> None:
    """Copy a file or a folder from a file system that Arrow supports."""
    from pyarrow import fs

    system, path = fs.FileSystem.from_uri(url)
    kind = system.get_file_info(path).type
    if kind == fs.FileType.NotFound:
        raise FileNotFoundError("there is no such file or folder")
    if kind == fs.FileType.Directory:
        target.mkdir()
    fs.copy_files(path, str(target), source_filesystem=system, destination_filesystem=fs.LocalFileSystem())
