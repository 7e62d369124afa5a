"""One run: the words, the recipe, what fits together, frames in and results out."""

from __future__ import annotations

import importlib
from typing import Any

# This room bears the name of a module that was one file: what was in it is still found here.
_WAS_HERE = {
    "Progress": "p2o.run.run",
    "Row": "p2o.run.run",
    "Run": "p2o.run.run",
    "calibrate": "p2o.run.run",
}


def __getattr__(name: str) -> Any:
    if name not in _WAS_HERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WAS_HERE[name]), name)
