"""What extractors give: every kind of feature that they found in one image or one sweep."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from p2o.arrays import Float
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.feature import CloudFeature, FeatureSet, ImageFeature, checked_kinds
from p2o.features.points import CloudPoints


@dataclass(frozen=True, eq=False, init=False)
class ImageFeatures(FeatureSet[ImageFeature]):
    """What an image extractor gives: `edges`, and `features` of any kinds, found by their words.

    Raises InputError for what is no `p2o.ImageFeature`, and for two features of one kind.
    """

    features: tuple[ImageFeature, ...]

    def __init__(self, edges: ImageEdges | None = None, *, features: Iterable[ImageFeature] = ()) -> None:
        found = tuple(features)
        if edges is not None:
            found = (*(f for f in found if not isinstance(f, ImageEdges)), edges)
        object.__setattr__(self, "features", checked_kinds(found, ImageFeature, "image"))

    @property
    def edges(self) -> ImageEdges | None:
        """The occlusion edges; None where the method gives none."""
        found: ImageEdges | None = self.get(ImageEdges.word)
        return found


@dataclass(frozen=True, eq=False, init=False)
class CloudFeatures(FeatureSet[CloudFeature]):
    """What a cloud extractor gives: `edges`, `points` (K, 3) m that can hide something, and `features` of any kinds.

    Raises InputError for what is no `p2o.CloudFeature`, and for two features of one kind.
    """

    features: tuple[CloudFeature, ...]

    def __init__(
        self,
        edges: CloudEdges | None = None,
        points: Float | CloudPoints | None = None,
        *,
        features: Iterable[CloudFeature] = (),
    ) -> None:
        found = tuple(features)
        if edges is not None:
            found = (*(f for f in found if not isinstance(f, CloudEdges)), edges)
        if points is not None:
            points = points if isinstance(points, CloudPoints) else CloudPoints(points)
            found = (*(f for f in found if not isinstance(f, CloudPoints)), points)
        object.__setattr__(self, "features", checked_kinds(found, CloudFeature, "sweep"))

    @property
    def edges(self) -> CloudEdges | None:
        """The occlusion edges; None where the method gives none."""
        found: CloudEdges | None = self.get(CloudEdges.word)
        return found

    @property
    def points(self) -> Float | None:
        """The points (K, 3) m; None where the method gives none."""
        found: CloudPoints | None = self.get(CloudPoints.word)
        return None if found is None else found.xyz

    def moved(self, b_from_lidar: Float) -> CloudFeatures:
        """Return the features in another frame b, by a (4, 4) rigid transform."""
        return self.mapped(lambda feature: feature.moved(b_from_lidar))

    def untwisted(self, twist: Float) -> CloudFeatures:
        """Return the features as if seen at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        return self.mapped(lambda feature: feature.untwisted(twist))
