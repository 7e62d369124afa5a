"""Read files named by users, with errors of one line that name the file."""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice, pairwise
from pathlib import Path

from p2o.errors import InputError

MAX_BYTES = 4 << 30
"""Maximum size of a file, above that of sweeps and images: a sparse file could exhaust memory."""
MAX_TEXT_BYTES = 64 << 20
_MOST_NAMES, _LONGEST_NAME = 5000, 200
"""Limits of the search for similar names, whose time grows with both."""

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_bytes(path: Path | str, what: str, most: int = MAX_BYTES) -> bytes:
    """Return the bytes of a file; `what` names it in errors ("image", "sweep").

    Raises InputError if the file is missing, empty, larger than `most` bytes, cannot be read, or is not a regular file
    (a folder, a pipe, a device, or a link to one), which is never opened.
    """
    path = Path(path)
    with _explained(path, what):
        size = _size(path, what)
        if size > most:
            text = f"the {what} is too large"
            raise InputError(text, where=path, expected=f"at most {most} bytes", got=f"{size} bytes")
        return _not_empty(path.read_bytes(), path, what)


def read_start(path: Path | str, what: str, count: int) -> bytes:
    """Return the first `count` bytes of a file of any size, or all if it has less; raises as `read_bytes`.

    Use it to check that a file that a library reads in parts is a regular file and not empty.
    """
    path = Path(path)
    with _explained(path, what):
        _size(path, what)
        with path.open("rb") as file:
            return _not_empty(file.read(count), path, what)


def _not_empty(data: bytes, path: Path, what: str) -> bytes:
    if not data:
        raise InputError(f"the {what} is empty", where=path, expected="more than 0 bytes")
    return data


def _size(path: Path, what: str) -> int:
    """Return the size of a regular file in bytes; raises InputError for other kinds of files."""
    about = os.stat(path)
    kind = next((name for is_kind, name in _KINDS if is_kind(about.st_mode)), None)
    if kind is not None:
        raise InputError(f"the {what} is {kind}", where=path, expected="a file")
    return about.st_size


@contextmanager
def _explained(path: Path, what: str) -> Iterator[None]:
    """Convert errors of the operating system about a file to InputError."""
    try:
        yield
    except FileNotFoundError as problem:
        raise InputError(f"the {what} is missing", where=path, expected="a file", hint=nearest(path)) from problem
    except OSError as problem:
        raise InputError(f"the {what} cannot be read", where=path, got=problem.strerror or problem) from problem
    except ValueError as problem:  # a null byte in the name, or characters that file names cannot contain
        raise InputError(f"the name of the {what} is not valid", where=ascii(str(path)), got=problem) from problem


def read_text(path: Path | str, what: str) -> str:
    """Return the text of a UTF-8 file; raises InputError as `read_bytes`, and if the file is not text."""
    try:
        return read_bytes(path, what, MAX_TEXT_BYTES).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputError(f"the {what} is not text", where=path, expected="UTF-8 text") from problem


def expanded(path: Path | str) -> Path:
    """Return a path with ~ and ~NAME expanded; raises InputError for an unknown user."""
    try:
        return Path(path).expanduser()
    except RuntimeError as problem:
        text = "the home folder of an unknown user"
        raise InputError(text, where=path, expected="a user of this machine after ~", hint="write ./~NAME") from problem


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the path to an InputError raised inside that has no place."""
    try:
        yield
    except InputError as problem:
        if problem.where is not None:
            raise
        expected = problem.expected
        raise InputError(problem.what, where=path, expected=expected, got=problem.got, hint=problem.hint) from problem


def listing(folder: Path, what: str) -> list[Path]:
    """Return the content of a folder, sorted; raises InputError if it cannot be read."""
    try:
        return sorted(folder.iterdir())
    except OSError as problem:
        text = f"the folder of {what} cannot be read"
        raise InputError(text, where=folder, got=problem.strerror or problem) from problem


def layout(*patterns: str) -> Callable[[Path], bool]:
    """Return a function that tests whether a folder has a file or folder of one of these patterns (`Path.glob`).

    The first part of a pattern that begins with ../ is matched with the name of the folder itself.
    """

    def recognises(folder: Path) -> bool:
        return folder.is_dir() and any(_has(folder, pattern) for pattern in patterns)

    return recognises


def _has(folder: Path, pattern: str) -> bool:
    if pattern.startswith("../"):
        own_name, _, rest = pattern[3:].partition("/")
        return folder.resolve().match(own_name) and (folder / rest).exists()
    return next(folder.glob(pattern), None) is not None


def nearest(path: Path) -> str | None:
    """Return "nearest: PATH" for a missing path: similar names in its deepest folder that exists; None without any."""
    parts = [path, *path.parents]
    for missing, folder in pairwise(parts):
        if folder.is_dir():
            with suppress(OSError):
                names = [entry.name for entry in islice(os.scandir(folder), _MOST_NAMES)]
                similar = difflib.get_close_matches(missing.name[:_LONGEST_NAME], names, n=2, cutoff=0.6)
                return f"nearest: {', '.join(str(folder / name) for name in similar)}" if similar else None
    return None


def no_such_folder(path: Path, expected: str) -> InputError:
    """Return the error about a missing folder, with the nearest that exists."""
    return InputError("no such folder", where=path, expected=expected, hint=nearest(path))


def existing_folder(root: Path, what: str) -> Path:
    """Return the folder with ~ expanded; raises InputError if it is missing or a file."""
    root = expanded(root)
    with _explained(root, f"folder of {what}"):
        try:
            about = os.stat(root)
        except FileNotFoundError as problem:
            raise no_such_folder(root, f"the folder of {what}") from problem
    if not stat.S_ISDIR(about.st_mode):
        raise InputError(f"the folder of {what} is a file", where=root, expected="a folder")
    return root
