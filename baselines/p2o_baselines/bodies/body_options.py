"""Options of every method of bodies, and results that are refused in words."""

from __future__ import annotations

import numpy as np
import p2o
from p2o import Result, Status
from p2o.arrays import Float

from p2o_baselines.boards.board_method import by_axis


class BodyOptions(p2o.Options):
    """Options of every method of bodies: what is looked at, and how exact the sensors are."""

    farthest_m: float = p2o.field(12.0, gt=0, le=200, help="Bodies are looked for so far from the LiDAR.")
    scatter_m: float = p2o.field(0.04, gt=0, le=1, help="Ranges scatter about a body by no more than this.")
    range_bias_m: float = p2o.field(
        0.01, ge=0, le=1, help="Deviation of an error that all ranges share, for the likely error."
    )
    camera_px: float = p2o.field(
        0.5, ge=0, le=100, help="Deviation of the camera's calibration in pixels, for the likely error."
    )
    worst_deg: float = p2o.field(5.0, gt=0, le=180, help="Results less sure than this about some axis are refused.")
    worst_m: float = p2o.field(0.5, gt=0, le=100, help="Results less sure than this along some axis are refused.")


def refused(result: Result, status: Status, reason: str) -> Result:
    """Return the start as a result that says why there is no other."""
    frames, start = result.frames, result.start
    return Result(frames, start, start, status, reason, matches=result.matches, warnings=result.warnings)


def too_unsure(covariance: Float | None, pose: Float, noun: str, options: BodyOptions) -> str:
    """Return in words that a pose (4, 4) is too unsure, and in what; "" where it is not."""
    if covariance is None or not np.isfinite(covariance).all():
        return f"the {noun} leave a direction of the pose open: more of them, elsewhere in the picture, are needed"
    axes = by_axis(covariance, pose)
    deg, metres = float(np.degrees(axes[:3].max())), float(axes[3:].max())
    if deg > options.worst_deg or metres > options.worst_m:
        return (
            f"the {noun} tell the pose to {deg:.1f} deg and {metres:.2f} m about and along its worst axes only: "
            "more of them, elsewhere in the picture, are needed"
        )
    return ""
