"""What extractors find, and views that hold it: kinds of features, each of which knows how it moves."""

from __future__ import annotations

import importlib
from typing import Any

# This room bears the name of a module that was one file: what was in it is still found here.
_WAS_HERE = {
    "CloudEdges": "p2o.features.edges",
    "ImageEdges": "p2o.features.edges",
    "CloudFeatures": "p2o.features.sets",
    "ImageFeatures": "p2o.features.sets",
}


def __getattr__(name: str) -> Any:
    if name not in _WAS_HERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WAS_HERE[name]), name)
