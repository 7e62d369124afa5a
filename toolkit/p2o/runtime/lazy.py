"""Lazy public modules: names are declared once, under `TYPE_CHECKING`, and imported on first use."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def attach(module: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a public module.

    The names are those that `file` imports in its block `if TYPE_CHECKING:`, which type checkers read, too.
    A name that is imported from a folder, and that the folder does not define, is a module itself.
    """
    blocks = [node for node in ast.parse(Path(file).read_bytes()).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    home_of = {alias.name: node.module or "" for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in home_of:
            raise AttributeError(f"module '{module}' has no attribute {name!r}")
        home = importlib.import_module(home_of[name])
        is_module = hasattr(home, "__path__") and name not in vars(home)
        value = importlib.import_module(f"{home.__name__}.{name}") if is_module else getattr(home, name)
        setattr(sys.modules[module], name, value)
        return value

    names = sorted(home_of)
    return load, lambda: names, names
