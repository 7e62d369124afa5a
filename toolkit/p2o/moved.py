"""Modules that have moved into rooms: their old names still work, with a DeprecationWarning that tells the new one.

Plugins need none of them: what they use is in `p2o` itself, or in the open modules that docs/plugins.md lists.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_ROOMS = {
    "files": "whole_file file_names",
    "geometry": "se3 camera radial_error motion ego_motion visibility perturb",
    "frames": "image cloud frame selection",
    "features": "side view occlusion missing",
    "problems": "directed_cost",
    "results": "result accuracy result_json",
    "host": "method stages hookspecs registry guard trainer",
    "calibration": "pipeline adjustment agreement camera_check",
    "run": "recipe",
    "work": "cache sources parallel",
    "study": "store worker ablate gate tally",
    "learn": "train label_files",
    "draw": "overlay plots",
}
MOVED = {f"p2o.{name}": f"p2o.{room}.{name}" for room, names in _ROOMS.items() for name in names.split()}
MOVED |= {"p2o.metrics": "p2o.geometry.pose_error", "p2o.problem": "p2o.problems.point_to_line"}
"""New names of modules by their old ones."""


class _Forwarder(MetaPathFinder, Loader):
    """Finds a moved module by its old name and hands out the new one."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        new = MOVED[spec.name]
        warnings.warn(f"{spec.name} has moved to {new}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # Importing has just given the module the spec of its old name: the new one is its own.
        spec = module.__spec__
        if spec is not None and isinstance(spec.loader_state, ModuleSpec):
            module.__spec__ = spec.loader_state


def forward_moved_modules() -> None:
    """Make the old names work; once is enough."""
    if not any(isinstance(finder, _Forwarder) for finder in sys.meta_path):
        sys.meta_path.append(_Forwarder())
