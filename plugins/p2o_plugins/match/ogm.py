"""Occlusion-guided matching: match cloud edges with image edges of the same direction (paper Sec. III-D.1)."""

from __future__ import annotations

from collections.abc import Sequence

import p2o
from p2o import Float
from p2o.solving import PairingOptions, PointToLine, assemble, pair


class OgmOptions(PairingOptions):
    """Options of `ogm`."""

    sides: str = p2o.field("LRUB", pattern="^[LRUB]+$", help="Directions that take part; LR is the paper's row w/o UB.")
    balance_sides: bool = p2o.field(False, help="Give every direction the same total weight.")


def build(options: OgmOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> PointToLine`."""
    sides = [side for side in p2o.SIDES if side.letter in options.sides]

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> PointToLine:
        pairs = [
            pair(view.camera, view.image_edges, view.cloud_edges, sides, camera_from_lidar, reach_px, options)
            for view in views
        ]
        return assemble(views, pairs, options.huber_px, options.balance_sides)

    return match


METHOD = p2o.Method(
    name="ogm",
    build=build,
    options=OgmOptions,
    summary="Nearest image edges of the same occlusion direction, as a line per cloud edge.",
    needs={"image-edges", "cloud-edges", "side"},
    gives={"pairs"},
    cite="Wang et al., P2O-Calib, IROS 2023, Sec. III-D",
)
