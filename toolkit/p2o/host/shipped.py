"""Find the files that plugin packages ship beside their code: studies and presets of methods."""

from __future__ import annotations

import importlib.resources
import re
from importlib.metadata import entry_points
from importlib.resources.abc import Traversable

from p2o.host.registry import GROUP, Registry


def shipped_files(registry: Registry, folder: str = "") -> list[tuple[str, Traversable]]:
    """Return the files in `folder` of the packages of loaded plugins, each with the distribution that ships it.

    Plugins that are single files ship none.
    """
    loaded = {(plugin.dist, plugin.entry) for plugin in registry.plugins}
    packages: dict[str, str] = {}
    for entry in entry_points(group=GROUP):
        dist = "" if entry.dist is None else re.sub(r"[-_.]+", "-", entry.dist.name).lower()
        if (dist, entry.name) in loaded:
            packages.setdefault(entry.module.partition(".")[0], dist)
    files: list[tuple[str, Traversable]] = []
    for package, dist in sorted(packages.items()):
        try:
            place = importlib.resources.files(package).joinpath(folder)
            inside = sorted(place.iterdir(), key=lambda file: file.name) if place.is_dir() else []
        except (ImportError, OSError, TypeError):  # a plugin of a single module has no folder
            continue
        files += [(dist, file) for file in inside]
    return files
