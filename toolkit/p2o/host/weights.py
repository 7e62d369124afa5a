"""Trained weights by name: those of a method's own package, and those of installed packages of weights."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from p2o.errors import UnknownNameError
from p2o.files.input_file import expanded

GROUP = "p2o.weights"
"""Entry points of packages with files METHOD-NAME.safetensors. The package is looked for, not imported."""
_SUFFIX = ".safetensors"


@dataclass(frozen=True)
class Weights:
    """A file of weights and its licence in one line."""

    path: Path
    licence: str


def weights_of(
    method: str, name: str, shipped: Path | None = None, licence: str = "Apache-2.0", *, hint: str = ""
) -> Weights:
    """Return weights of a method by name, or the file of this path.

    `shipped` is the folder of the method's own package, whose files have the licence `licence`; those of installed
    packages have that of their metadata. Raises UnknownNameError, with the names of the weights there are, if there is
    neither.
    """
    names = set()
    for folder, terms in _folders([] if shipped is None else [(shipped, licence)]):
        for path in sorted(folder.glob(f"{method}-*{_SUFFIX}")):
            if path.stem == f"{method}-{name}":
                return Weights(path, f"{name}: {terms}")
            names.add(path.stem.removeprefix(f"{method}-"))
    path = expanded(name)
    if not path.exists():
        more = f"; {hint}" if hint else ""
        raise UnknownNameError("weights", name, names, where=method, hint=f"or the path of a {_SUFFIX} file{more}")
    return Weights(path, f"{path.name}: the terms of its training data apply")


def _folders(folders: list[tuple[Path, str]]) -> list[tuple[Path, str]]:
    """Return folders, and those of installed packages of weights, each with the licence that its metadata state."""
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        spec = importlib.util.find_spec(entry.value) if entry.value.isidentifier() else None
        places = [] if spec is None else spec.submodule_search_locations or []
        about = {} if entry.dist is None else entry.dist.metadata.json
        licence = str(about.get("license_expression") or about.get("license") or "no licence stated")
        folders = [*folders, *((Path(place), licence) for place in places)]
    return folders
