"""Weights of P2ORNet by name; importable without torch."""

from __future__ import annotations

import os
from pathlib import Path

from p2o.reading import Weights, weights_of

FOLDER = Path(__file__).parents[1] / "weights"
FREE = "free"
"""Name of the shipped weights: see MODEL_CARD.md beside them."""
_LICENCE = "Apache-2.0; encoder initialised with weights under Apache-2.0, trained on ImageNet"


def default_weights() -> str:
    """Return the name of the default weights, or what the environment variable P2O_WEIGHTS selects."""
    return os.environ.get("P2O_WEIGHTS") or FREE


def weights_named(name: str) -> Weights:
    """Return weights by name or path with their licence; raises UnknownNameError if there are none."""
    hint = "kitti needs pip install p2o-kitti-weights"
    if name == os.environ.get("P2O_WEIGHTS"):
        hint += "; P2O_WEIGHTS has this name"
    return weights_of("p2ornet", name, FOLDER, _LICENCE, hint=hint)
