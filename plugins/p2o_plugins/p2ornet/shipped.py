"""Shipped weights by name; importable without torch."""

from __future__ import annotations

import os
from pathlib import Path

from p2o import UnknownNameError

FOLDER = Path(__file__).parents[1] / "weights"
SHIPPED = {"kitti": "p2ornet-kitti.safetensors", "synthetic": "p2ornet-synthetic.safetensors"}
"""Shipped weights by name: see MODEL_CARD.md beside them."""

LICENCES = {
    "kitti": "kitti: research only (CC BY-NC-SA 3.0); P2O_WEIGHTS=free selects weights without this restriction",
    "synthetic": "synthetic: Apache-2.0; encoder initialised with weights under Apache-2.0, trained on ImageNet",
}
"""Licences of the shipped weights, each in one line."""


def default_weights() -> str:
    """Return the name of the default weights, which the environment variable P2O_WEIGHTS selects.

    Raises UnknownNameError if its value is neither empty nor `free`.
    """
    chosen = os.environ.get("P2O_WEIGHTS", "")
    if chosen not in ("", "free"):
        raise UnknownNameError("value of P2O_WEIGHTS", chosen, ["free"], hint="or unset it for the default weights")
    return "synthetic" if chosen else "kitti"


def licence_of(weights: str) -> str:
    """Return the licence of weights given by name or path in one line."""
    return LICENCES.get(weights, f"{Path(weights).name}: the terms of its training data apply")


def path_of(weights: str) -> Path:
    """Return the file of weights given by name or path; raises UnknownNameError if there is none."""
    if weights in SHIPPED:
        return FOLDER / SHIPPED[weights]
    if not Path(weights).exists():
        raise UnknownNameError("weights", weights, SHIPPED, hint="or the path of a .safetensors file")
    return Path(weights)
