"""One frame as matchers and initializers see it: the camera and the features of both sensors, no truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.visibility import hidden


@dataclass(frozen=True, eq=False)
class View:
    """The features of one frame with the camera that saw it.

    `twist` (6,) is the velocity of the LiDAR in its own frame (rad/s, m/s) where it is known. `full_size` is the camera
    that the frame came with, where its picture was looked at smaller (`p2o.frames.scale`), else None. `prepared` is
    what the initializer prepared of the frame, where it does.
    """

    name: str
    camera: Camera
    image: ImageFeatures
    cloud: CloudFeatures
    twist: Float | None = None
    full_size: Camera | None = None
    prepared: Any = None

    @property
    def image_edges(self) -> ImageEdges:
        """The image edges; empty where the extractor gave none."""
        return self.image.edges if self.image.edges is not None else ImageEdges.empty()

    @property
    def cloud_edges(self) -> CloudEdges:
        """The cloud edges; empty where the extractor gave none."""
        return self.cloud.edges if self.cloud.edges is not None else CloudEdges.empty()

    def get(self, word: str) -> Any:
        """Return the features of a kind, of either sensor, or None where the extractors gave none."""
        found = self.image.get(word)
        return self.cloud.get(word) if found is None else found

    def count(self, word: str) -> int:
        """Return how many features of a kind there are."""
        found = self.get(word)
        return 0 if found is None else len(found)

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
        return replace(self, cloud=self.cloud.having(replace(edges, side=side)))

    def without_hidden(self, camera_from_lidar: Float) -> View:
        """Return the view without LiDAR edges that the sweep's own points hide from the camera at a pose (4, 4)."""
        edges, surface = self.cloud.edges, self.cloud.points
        if edges is None or surface is None or not len(edges):
            return self
        keep = ~hidden(edges.xyz, surface, self.camera, camera_from_lidar)
        return replace(self, cloud=self.cloud.having(edges.select(keep)))

    def moved(self, b_from_lidar: Float) -> View:
        """Return the view with the LiDAR frame replaced by b; the image side is untouched."""
        return replace(self, cloud=self.cloud.moved(b_from_lidar))

    def untwisted(self, twist: Float) -> View:
        """Return the view with its LiDAR features as if seen at time 0 from a LiDAR that moves with `twist` (6,)."""
        return replace(self, cloud=self.cloud.untwisted(twist))
