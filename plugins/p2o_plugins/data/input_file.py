"""Reading a file whole, with one-line errors that name it; every reader of this folder goes through here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from p2o import InputError


def read_bytes(path: Path, what: str) -> bytes:
    """Return the bytes of a file; `what` names it in errors ("image", "sweep").

    Raises InputError if the file is missing, a folder, empty, or cannot be read.
    """
    if path.is_dir():
        raise InputError(f"the {what} is a folder", where=path, expected="a file")
    try:
        data = path.read_bytes()
    except FileNotFoundError as problem:
        raise InputError(f"the {what} is missing", where=path, expected="a file") from problem
    except OSError as problem:
        raise InputError(f"the {what} cannot be read", where=path, got=problem.strerror or problem) from problem
    if not data:
        raise InputError(f"the {what} is empty", where=path, expected="more than 0 bytes")
    return data


def read_text(path: Path, what: str) -> str:
    """Return the text of a UTF-8 file; raises InputError as `read_bytes`, and if the file is not text."""
    try:
        return read_bytes(path, what).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputError(f"the {what} is not text", where=path, expected="UTF-8 text") from problem


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name on an InputError raised inside that does not name a place yet."""
    try:
        yield
    except InputError as problem:
        if problem.where is not None:
            raise
        raise InputError(
            problem.what, where=path, expected=problem.expected, got=problem.got, hint=problem.hint
        ) from problem


def existing_folder(root: Path, what: str) -> Path:
    """Return the folder with ~ expanded; raises InputError if it is missing or a file."""
    root = root.expanduser()
    if not root.exists():
        raise InputError(f"the folder of {what} is missing", where=root, expected="a folder")
    if not root.is_dir():
        raise InputError(f"the folder of {what} is a file", where=root, expected="a folder")
    return root
