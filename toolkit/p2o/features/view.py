"""One frame as matchers and initializers see it: the camera and the features of both sensors, no truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from p2o.arrays import Float
from p2o.features.edges import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class View:
    """The features of one frame with the camera that saw it."""

    name: str
    camera: Camera
    image: ImageFeatures
    cloud: CloudFeatures

    @property
    def image_edges(self) -> ImageEdges:
        """The image edges; empty where the extractor gave none."""
        return self.image.edges if self.image.edges is not None else ImageEdges.empty()

    @property
    def cloud_edges(self) -> CloudEdges:
        """The cloud edges; empty where the extractor gave none."""
        return self.cloud.edges if self.cloud.edges is not None else CloudEdges.empty()

    def without_sides(self) -> View:
        """Return the view with every direction forgotten (for methods that do not use them)."""
        return replace(self, image=self.image.without_sides(), cloud=self.cloud.without_sides())

    def as_seen_from(self, camera_from_lidar: Float) -> View:
        """Return the view with the sides of the LiDAR edges told in image axes at a pose (4, 4).

        The background direction of each edge is projected; its larger image component decides (docs/conventions.md).
        For an upright rig nothing changes; for a camera on its side or a LiDAR upside down this is what makes the
        letters of both sensors mean the same. Edges without a background direction keep their letter.
        """
        edges = self.cloud.edges
        if edges is None or not len(edges):
            return self
        xyz = se3.apply(camera_from_lidar, edges.xyz)
        known = edges.background.any(axis=1) & np.isfinite(self.camera.project(xyz)).all(axis=1)
        _, jacobian = self.camera.project_with_jacobian(xyz[known])
        du, dv = np.einsum("kij,kj->ik", jacobian, edges.background[known] @ camera_from_lidar[:3, :3].T)
        side = np.array(edges.side)
        horizontal = np.where(du < 0, Side.LEFT, Side.RIGHT)
        vertical = np.where(dv < 0, Side.UPPER, Side.BOTTOM)
        side[known] = np.where(np.abs(du) > np.abs(dv), horizontal, vertical)
        return replace(self, cloud=replace(self.cloud, edges=replace(edges, side=side)))

    def moved(self, b_from_lidar: Float) -> View:
        """Return the view with the LiDAR frame replaced by b; the image side is untouched."""
        return replace(self, cloud=self.cloud.moved(b_from_lidar))

    def untwisted(self, twist: Float) -> View:
        """Return the view with its LiDAR edges as if seen at time 0 from a LiDAR that moves with `twist` (6,)."""
        edges = self.cloud.edges
        return self if edges is None else replace(self, cloud=replace(self.cloud, edges=edges.untwisted(twist)))
