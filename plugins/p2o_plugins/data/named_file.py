"""Files that other files name: they have to lie in the folder of the dataset, links followed."""

from __future__ import annotations

from pathlib import Path

from p2o import InputError


def file_inside(root: Path, name: str) -> Path:
    """Return the path of a file that a table of a dataset names, from its `root`, which has to be resolved.

    Raises InputError if it, links followed, leaves the root.
    """
    path = root / name
    try:
        inside = path.resolve().is_relative_to(root)
    except (OSError, RuntimeError, ValueError) as problem:
        raise InputError("a table names a file badly", where=root, got=ascii(name)[:80]) from problem
    if not inside:
        raise InputError("a file of the tables lies outside of the folder", where=root, got=name[:200])
    return path
