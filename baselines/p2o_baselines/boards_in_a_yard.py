"""Frames on which methods of mutual information promise to succeed: boards whose squares both sensors see alike."""

from __future__ import annotations

import p2o

_YARD = "synthetic:?place=yard&targets=checkerboard&boards=2&lidar=os1-64&width_px=621&height_px=188&right=false"


def boards_in_a_yard(scenes: int, solver: str, *settings: str, perturb: str, within: str) -> p2o.Example:
    """Return an example of so many scenes, all calibrated together: black squares send a tenth back to both sensors."""
    return p2o.Example(
        f"{_YARD}&exposure_ev=0&scenes={scenes}",
        perturb=perturb,
        within=within,
        joint=True,
        extractor="grey/reflectance",
        solver=solver,
        init="given",
        settings=settings,
    )
