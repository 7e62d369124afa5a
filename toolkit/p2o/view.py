"""One frame as matchers and initializers see it: the camera and the features of both sensors, no truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from p2o.arrays import Float
from p2o.camera import Camera
from p2o.features import CloudEdges, CloudFeatures, ImageEdges, ImageFeatures


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

    def moved(self, b_from_lidar: Float) -> View:
        """Return the view with the LiDAR frame replaced by b; the image side is untouched."""
        return replace(self, cloud=self.cloud.moved(b_from_lidar))
