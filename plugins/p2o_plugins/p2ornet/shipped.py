"""The weights that come with the package, by name; importable without torch."""

from __future__ import annotations

from pathlib import Path

from p2o import UnknownNameError

FOLDER = Path(__file__).parents[1] / "weights"
SHIPPED = {"kitti": "p2ornet-kitti.safetensors", "synthetic": "p2ornet-synthetic.safetensors"}
"""By name, the weights that come with the package: see MODEL_CARD.md beside them."""


def path_of(weights: str) -> Path:
    """Return the file of weights given by name or path; raises UnknownNameError if there is none."""
    if weights in SHIPPED:
        return FOLDER / SHIPPED[weights]
    if not Path(weights).exists():
        raise UnknownNameError("weights", weights, SHIPPED, hint="or the path of a .safetensors file")
    return Path(weights)
