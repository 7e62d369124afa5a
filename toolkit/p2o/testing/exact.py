"""Exact problems of the stage, and poses at a known distance from its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from p2o.arrays import Float, Int
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import LeastSquares
from p2o.testing import stage
from p2o.testing.subject import require


@dataclass(frozen=True, eq=False)
class PlanesInMetres(LeastSquares):
    """Points `xyz` (K, 3) m of the LiDAR on planes of the camera: residual normal . (camera_from_lidar xyz) - offset.

    `normal` (K, 3) unit, `offset` (K,) m. There is no pixel in it, and derivatives are left to the base class.
    """

    unit: ClassVar[str] = "m"
    huber: ClassVar[float] = 0.05

    xyz: Float
    normal: Float
    offset: Float
    weight: Float
    frame: Int

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return signed distances in metres, (K,) or (B, K)."""
        return np.asarray((se3.apply(camera_from_lidar, self.xyz) * self.normal).sum(axis=-1) - self.offset)


def planes() -> PlanesInMetres:
    """Return four hundred points of the stage with the planes that they lie on."""
    points, truth = stage.view().get("cloud-points"), stage.camera_from_lidar()
    some = points.select(np.linspace(0, len(points) - 1, 400).astype(np.int64))
    normal = some.normal @ truth[:3, :3].T
    offset = (se3.apply(truth, some.xyz) * normal).sum(axis=1)
    return PlanesInMetres(some.xyz, normal, offset, np.ones(400), np.zeros(400, np.int64))


@lru_cache(maxsize=1)
def pairs() -> PointToLine:
    """Return exact pairs: every outline point of the stage with the line through its own projection."""
    edges, truth = stage.view().cloud_edges, stage.camera_from_lidar()
    xyz = se3.apply(truth, edges.xyz)
    uv = stage.camera().project(xyz)
    # The outline runs along y for upper and bottom edges, along z for the others.
    along = np.where(np.isin(edges.side, [Side.UPPER, Side.BOTTOM])[:, None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ahead = stage.camera().project(se3.apply(truth, edges.xyz + 0.01 * along)) - uv
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
    count = len(edges)
    return PointToLine(
        edges.xyz, uv, normal, np.ones(count), edges.side, np.zeros(count, np.int64), (stage.camera(),), huber_px=1.0
    )


def around(truth: Float, angle_deg: float, distance_m: float) -> Float:
    """Return eight poses (8, 4, 4) at an angle and a distance from the truth, in fixed directions."""
    axes = np.array(
        [[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1], [1, 1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, -1]]
    )
    unit = axes / np.sqrt(3.0)
    return np.asarray(truth @ se3.exp(np.column_stack([np.radians(angle_deg) * unit, distance_m * unit[::-1]])))


def require_near(pose: Float, truth: Float, angle_deg: float, distance_m: float) -> None:
    """Raise CheckFailed unless a pose is that near to the truth."""
    error = pose_error(pose, truth)
    require(
        error.rotation_deg <= angle_deg and error.translation_m <= distance_m,
        f"{error.rotation_deg:.4f} deg and {error.translation_m:.4f} m from the truth, "
        f"at most {angle_deg:g} deg and {distance_m:g} m are promised",
    )
