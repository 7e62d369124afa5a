"""Whether edges have the directions that a method says it gives."""

from __future__ import annotations

from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.side import Side
from p2o.testing.subject import Subject, require


def require_sides(subject: Subject, edges: ImageEdges | CloudEdges) -> None:
    """Raise CheckFailed unless every edge has a side where `gives` says so, and none where it does not."""
    without = int((edges.side == Side.NONE).sum())
    if "side" in subject.gives:
        require(without == 0, f"{without} of {len(edges)} edges have no side, though `gives` says side")
    else:
        require(without == len(edges), "edges have sides, though `gives` does not say side")
