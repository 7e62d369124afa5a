"""Further kinds of features (points, maps, remarks), and the outputs of extractors: sets of features of any kinds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from p2o.arrays import Float, checked
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.feature import CloudFeature, FeatureSet, ImageFeature, checked_kinds
from p2o.geometry import se3
from p2o.geometry.motion import moved


@dataclass(frozen=True, eq=False)
class CloudPoints(CloudFeature):
    """Points of one sweep: `xyz` (K, 3) m in the LiDAR frame.

    Optional, per point: `intensity` (K,) in units of the sensor, `normal` (K, 3) unit surface normals, `time_s` (K,)
    in seconds relative to the image for a raw sweep, as in `CloudEdges`.
    """

    word: ClassVar[str] = "cloud-points"

    xyz: Float
    intensity: Float | None = None
    normal: Float | None = None
    time_s: Float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("points of the cloud features", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        for name, shape in (("intensity", (count,)), ("normal", (count, 3)), ("time_s", (count,))):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked(f"{name} of the cloud points", value, shape, np.float64))

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: Any) -> CloudPoints:
        """Return the points of a mask or index."""
        rows = (self.xyz, self.intensity, self.normal, self.time_s)
        return CloudPoints(*(None if values is None else values[keep] for values in rows))  # type: ignore[arg-type]

    def moved(self, b_from_lidar: Float) -> CloudPoints:
        """Return the points in another frame b, by a (4, 4) rigid transform."""
        normal = None if self.normal is None else self.normal @ b_from_lidar[:3, :3].T
        return replace(self, xyz=se3.apply(b_from_lidar, self.xyz), normal=normal)

    def untwisted(self, twist: Float) -> CloudPoints:
        """Return the points as measured at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        if self.time_s is None:
            return self
        normal = None if self.normal is None else moved(twist, self.time_s, self.normal, directions=True)
        return replace(self, xyz=moved(twist, self.time_s, self.xyz), normal=normal)

    @property
    def times_s(self) -> Float | None:
        """Time of each point of a raw sweep in s relative to the image."""
        return self.time_s

    @property
    def places(self) -> Float:
        """The positions of the points."""
        return self.xyz


@dataclass(frozen=True, eq=False)
class ImageMap(ImageFeature):
    """A map (H, W) or (H, W, C) float over the pixels of one image; derive a class with a `word` for each meaning."""

    values: Float

    def __post_init__(self) -> None:
        shape = (None,) * np.ndim(self.values) if np.ndim(self.values) in (2, 3) else (None, None)
        object.__setattr__(self, "values", checked(f"the map {self.word}", self.values, shape, np.float64))

    def __len__(self) -> int:
        return int(self.values.shape[0] * self.values.shape[1])

    def at(self, uv: Float) -> Float:
        """Return the values (..., C or nothing) at pixels uv (..., 2), bilinear; NaN outside of the image."""
        height, width = self.values.shape[:2]
        u, v = uv[..., 0], uv[..., 1]
        with np.errstate(invalid="ignore"):
            inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        column = np.clip(u.astype(np.int64), 0, max(width - 2, 0))
        row = np.clip(v.astype(np.int64), 0, max(height - 2, 0))
        right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
        fu, fv = u - column, v - row
        if self.values.ndim == 3:
            fu, fv, inside = fu[..., None], fv[..., None], inside[..., None]
        top = self.values[row, column] * (1 - fu) + self.values[row, right] * fu
        bottom = self.values[below, column] * (1 - fu) + self.values[below, right] * fu
        return np.where(inside, top * (1 - fv) + bottom * fv, np.nan)


@dataclass(frozen=True, eq=False)
class GreyMap(ImageMap):
    """Grey values (H, W), 0 to 255, compared with reflectance by mutual information."""

    word: ClassVar[str] = "image-grey"


@dataclass(frozen=True, eq=False)
class CloudRemarks(CloudFeature):
    """Remarks of one line each, which become warnings of the result with the name of the frame."""

    word: ClassVar[str] = "cloud-remarks"

    texts: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.texts)

    def moved(self, b_from_lidar: Float) -> CloudRemarks:
        """Return the remarks, which do not depend on the frame."""
        return self


@dataclass(frozen=True, eq=False, init=False)
class ImageFeatures(FeatureSet[ImageFeature]):
    """The output of an image extractor: `edges`, and `features` of any kinds.

    Raises InputError for features that are no `p2o.ImageFeature` and for two features of one kind.
    """

    features: tuple[ImageFeature, ...]

    def __init__(self, edges: ImageEdges | None = None, *, features: Iterable[ImageFeature] = ()) -> None:
        kinds = tuple(features)
        if edges is not None:
            kinds = (*(f for f in kinds if not isinstance(f, ImageEdges)), edges)
        object.__setattr__(self, "features", checked_kinds(kinds, ImageFeature, "image"))

    @property
    def edges(self) -> ImageEdges | None:
        """The occlusion edges; None if the method gives none."""
        kinds: ImageEdges | None = self.get(ImageEdges.word)
        return kinds


@dataclass(frozen=True, eq=False, init=False)
class CloudFeatures(FeatureSet[CloudFeature]):
    """The output of a cloud extractor: `edges`, `points` (K, 3) m for occlusion tests, and `features` of any kinds.

    Raises InputError for features that are no `p2o.CloudFeature` and for two features of one kind.
    """

    features: tuple[CloudFeature, ...]

    def __init__(
        self,
        edges: CloudEdges | None = None,
        points: Float | CloudPoints | None = None,
        *,
        features: Iterable[CloudFeature] = (),
    ) -> None:
        kinds = tuple(features)
        if edges is not None:
            kinds = (*(f for f in kinds if not isinstance(f, CloudEdges)), edges)
        if points is not None:
            points = points if isinstance(points, CloudPoints) else CloudPoints(points)
            kinds = (*(f for f in kinds if not isinstance(f, CloudPoints)), points)
        object.__setattr__(self, "features", checked_kinds(kinds, CloudFeature, "sweep"))

    @property
    def edges(self) -> CloudEdges | None:
        """The occlusion edges; None if the method gives none."""
        kinds: CloudEdges | None = self.get(CloudEdges.word)
        return kinds

    @property
    def points(self) -> Float | None:
        """The points (K, 3) m; None if the method gives none."""
        kinds: CloudPoints | None = self.get(CloudPoints.word)
        return None if kinds is None else kinds.xyz

    def moved(self, b_from_lidar: Float) -> CloudFeatures:
        """Return the features in another frame b, by a (4, 4) rigid transform."""
        return self.mapped(lambda feature: feature.moved(b_from_lidar))

    def untwisted(self, twist: Float) -> CloudFeatures:
        """Return the features as observed at time 0 from a LiDAR that moves with constant `twist` (6,)."""
        return self.mapped(lambda feature: feature.untwisted(twist))
