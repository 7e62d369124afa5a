"""The input of matchers and initializers for one frame: camera and features of both sensors, no ground truth."""

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
    """The features of one frame with its camera.

    `twist` (6,) is the velocity of the LiDAR in its own frame (rad/s, m/s), if known. `full_size` is the camera of the
    original image if it was downsampled (`p2o.frames.scale`), else None. `prepared` is the output of `prepare` of the
    initializer, if it has one. `weight` is the share of the frame that other frames of the calibration do not show, and
    `scene` the number of the frames that show the same place (`p2o.problems.distinct_views`); 1 and None where unknown.
    """

    name: str
    camera: Camera
    image: ImageFeatures
    cloud: CloudFeatures
    twist: Float | None = None
    full_size: Camera | None = None
    prepared: Any = None
    weight: float = 1.0
    scene: int | None = None

    @property
    def image_edges(self) -> ImageEdges:
        """The image edges; empty if the extractor gave none."""
        return self.image.edges if self.image.edges is not None else ImageEdges.empty()

    @property
    def cloud_edges(self) -> CloudEdges:
        """The cloud edges; empty if the extractor gave none."""
        return self.cloud.edges if self.cloud.edges is not None else CloudEdges.empty()

    def get(self, word: str) -> Any:
        """Return the features of a kind of either sensor, None if there are none."""
        features = self.image.get(word)
        return self.cloud.get(word) if features is None else features

    def count(self, word: str) -> int:
        """Return the number of features of a kind."""
        features = self.get(word)
        return 0 if features is None else len(features)

    def without_sides(self) -> View:
        """Return the view without directions (for methods that do not use them)."""
        return replace(self, image=self.image.without_sides(), cloud=self.cloud.without_sides())

    def as_seen_from(self, camera_from_lidar: Float) -> View:
        """Return the view with the sides of the LiDAR edges expressed in image axes at a pose (4, 4).

        The side is the larger image component of the projected background direction (docs/conventions.md). It changes
        for rigs that are not upright, such as a camera on its side or a LiDAR upside down. Edges without a background
        direction keep their side.
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
        """Return the view without LiDAR edges that points of the sweep occlude at a pose (4, 4)."""
        edges, surface = self.cloud.edges, self.cloud.points
        if edges is None or surface is None or not len(edges):
            return self
        keep = ~hidden(edges.xyz, surface, self.camera, camera_from_lidar)
        return replace(self, cloud=self.cloud.having(edges.select(keep)))

    def moved(self, b_from_lidar: Float) -> View:
        """Return the view with the LiDAR frame replaced by b; image features are unchanged."""
        return replace(self, cloud=self.cloud.moved(b_from_lidar))

    def untwisted(self, twist: Float) -> View:
        """Return the view with its LiDAR features as observed at time 0 from a LiDAR that moves with `twist` (6,)."""
        return replace(self, cloud=self.cloud.untwisted(twist))
