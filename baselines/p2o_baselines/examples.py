"""Synthetic frames on which a method has to succeed: the examples that several methods share."""

from __future__ import annotations

import p2o

_MOTION = "period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0"
DRIVE = f"synthetic:?place=street&frames_per_scene=5&{_MOTION}&right=false&seed=1"
"""A drive that turns about all axes, so that motion alone determines the extrinsic."""

DWELL = "synthetic:?place=hall&lidar=mid-40&sweep_s=2&speed_m_s=0&right=false&seed=43"
"""A static LiDAR that scans a hall for two seconds: a dense reflectance image."""


def targets(target: str, lidar: str, frames: int, within: str, settings: str = "") -> p2o.Example:
    """Return an example with targets in a yard; `settings` are further options of the data set, such as "&boards=3"."""
    data = f"targets={target}&place=yard&frames_per_scene={frames}&width_px=621&height_px=350&right=false&lidar={lidar}"
    return p2o.Example(f"synthetic:?{data}{settings}", "10deg 0.3m", within, joint=True)


def checkerboards(within: str, *, lidar: str = "hdl-64e", frames: int = 5) -> p2o.Example:
    """Return an example with checkerboards."""
    return targets("checkerboard", lidar, frames, within)


def hole_boards(within: str) -> p2o.Example:
    """Return an example with boards with four round holes."""
    return targets("holes", "vlp-16", 3, within, "&exposure_ev=0")


def information(scenes: int, solver: str, *settings: str, perturb: str, within: str) -> p2o.Example:
    """Return an example for mutual information: checkerboards whose black squares are dark for both sensors."""
    yard = "place=yard&targets=checkerboard&boards=2&lidar=os1-64&width_px=621&height_px=188&right=false"
    data = f"synthetic:?{yard}&exposure_ev=0&scenes={scenes}"
    return p2o.Example(data, perturb, within, True, "grey/reflectance", solver, "given", settings=settings)


def streets(scenes: int, extractor: str, solver: str, *, perturb: str, within: str) -> p2o.Example:
    """Return an example of streets, calibrated jointly from the given initial extrinsic."""
    data = f"synthetic:?scenes={scenes}&place=street"
    return p2o.Example(data, perturb, within, True, extractor, solver, "given")
