"""A plugin of the tests: kinds of features of its own, extractors that find them, and a matcher that needs them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import p2o
from p2o.geometry.motion import moved
from p2o.solving import LeastSquares, Objective


@dataclass(frozen=True, eq=False)
class Marks(p2o.CloudFeature):
    """Points (N, 3) m with a heading (N, 3) and a time (N,) each: a kind that keeps every promise."""

    word: ClassVar[str] = "cloud-marks"

    xyz: Any
    heading: Any
    time_s: Any

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, keep: Any) -> Any:
        return replace(self, xyz=self.xyz[keep], heading=self.heading[keep], time_s=self.time_s[keep])

    def moved(self, b_from_lidar: Any) -> Any:
        xyz, heading = p2o.se3.apply(b_from_lidar, self.xyz), self.heading @ b_from_lidar[:3, :3].T
        return replace(self, xyz=xyz, heading=heading)

    def untwisted(self, twist: Any) -> Any:
        heading = moved(twist, self.time_s, self.heading, directions=True)
        return replace(self, xyz=moved(twist, self.time_s, self.xyz), heading=heading)

    @property
    def times_s(self) -> Any:
        return self.time_s

    @property
    def places(self) -> Any:
        return self.xyz


def variant(name: str, **changed: Any) -> type[Marks]:
    """Return a class of marks of this module with other methods."""
    return dataclass(frozen=True, eq=False)(type(name, (Marks,), {"__module__": __name__, **changed}))


def shifted(self: Marks, b_from_lidar: Any) -> Any:
    """Move marks, and shift their headings instead of turning them."""
    return replace(Marks.moved(self, b_from_lidar), heading=p2o.se3.apply(b_from_lidar, self.heading) + 1e-3)


def twice(self: Marks, keep: Any) -> Any:
    """Select each mark twice."""
    return Marks.select(self, np.tile(np.arange(len(self))[keep], 2))


# They stay where they are, move the wrong way round, turn by a shift, or pay no heed to their times.
StandingMarks = variant("StandingMarks", moved=lambda self, b_from_lidar: self)
BackwardMarks = variant("BackwardMarks", moved=lambda self, pose: Marks.moved(self, p2o.se3.inverse(pose)))
StiffMarks = variant("StiffMarks", moved=shifted)
TimelessMarks = variant("TimelessMarks", untwisted=lambda self, twist: self)
TwiceMarks = variant("TwiceMarks", select=twice)
ShyMarks = variant("ShyMarks", without_sides=lambda self: self.select(np.arange(len(self) - 1)))


@dataclass(frozen=True, eq=False)
class SecretMarks(Marks):
    """They hold what the cache cannot keep."""

    secret: Any = field(default_factory=lambda: {1, 2})


@dataclass(frozen=True, eq=False)
class Spots(p2o.ImageFeature):
    """Pixels (N, 2)."""

    word: ClassVar[str] = "image-spots"

    uv: Any

    def __len__(self) -> int:
        return len(self.uv)

    def select(self, keep: Any) -> Any:
        return Spots(self.uv[keep])


def marks_of(cloud: p2o.Cloud, kind: type[Marks] = Marks) -> Marks:
    """Return every tenth point that is near: the inside of the featureless ball is too far away."""
    near = np.flatnonzero(np.linalg.norm(cloud.xyz, axis=1) < 12.5)[::10]
    xyz = cloud.xyz[near]
    return kind(xyz, xyz / np.linalg.norm(xyz, axis=1, keepdims=True), cloud.time_s[near])


def spots_of(image: p2o.Image) -> Spots:
    """Return the pixels where the grey steps."""
    v, u = np.nonzero(np.abs(np.diff(image.grey.astype(float), axis=1)) > 60)
    return Spots(np.column_stack([u, v]).astype(float))


@dataclass(frozen=True, eq=False)
class PointsToSpots(LeastSquares):
    """Points (K / 2, 3) and the pixels where they belong: across and down, one residual each."""

    huber: ClassVar[float] = 2.0

    xyz: Any
    uv: Any
    weight: Any
    frame: Any
    camera: Any

    def residuals(self, camera_from_lidar: Any) -> Any:
        off = self.camera.project(p2o.se3.apply(camera_from_lidar, self.xyz)) - self.uv
        return off.reshape(*off.shape[:-2], -1)


def spots_matched(views: Sequence[p2o.View], pose: Any, reach_px: float) -> Any:
    """Return each cloud edge with the nearest image edge."""
    found = []
    for view in views:
        edges, uv = view.cloud_edges, view.image_edges.uv
        at = view.camera.project(p2o.se3.apply(pose, edges.xyz))
        near = [np.linalg.norm(uv - here, axis=1).argmin() for here in at[::3]] if len(uv) else []
        close = np.linalg.norm(uv[near] - at[::3], axis=1) <= reach_px if near else np.zeros(0, bool)
        found.append((edges.xyz[::3][close], uv[near][close] if near else np.zeros((0, 2))))
    count = [2 * len(xyz) for xyz, _ in found]
    frame = np.repeat(np.arange(len(views)), count)
    xyz, uv = (np.concatenate(part) for part in zip(*found, strict=True))
    return PointsToSpots(xyz, uv, np.ones(sum(count)), frame, views[0].camera)


def marked(views: Sequence[p2o.View], pose: Any, reach_px: float) -> Any:
    """Return a cost that asks for marks and spots, and is lowest at the truth of the stage."""
    from p2o_testing import stage

    for view in views:
        assert view.image.words == {"image-spots"}
        assert view.cloud.words == {"cloud-marks"}
    truth = stage.camera_from_lidar()
    return Objective(lambda poses: np.square(poses - truth).sum(axis=(1, 2)))


@p2o.hookimpl
def p2o_image_extractors():
    """Offer the spots."""
    yield p2o.Method(
        name="spots",
        build=lambda options: lambda image: p2o.ImageFeatures(features=[spots_of(image)]),
        summary="Steps of the grey.",
        gives={"image-spots"},
    )


@p2o.hookimpl
def p2o_cloud_extractors():
    """Offer the marks."""
    yield p2o.Method(
        name="marks",
        build=lambda options: lambda cloud: p2o.CloudFeatures(features=[marks_of(cloud)]),
        summary="Points near by.",
        gives={"cloud-marks"},
        needs={"time"},
    )


@p2o.hookimpl
def p2o_matchers():
    """Offer one matcher for them, and one of residuals."""
    yield p2o.Method(
        name="marked",
        build=lambda options: marked,
        summary="A cost of marks and spots.",
        needs={"image-spots", "cloud-marks"},
        gives={"objective"},
    )
    yield p2o.Method(
        name="to-spots",
        build=lambda options: spots_matched,
        summary="Points to pixels.",
        needs={"image-edges", "cloud-edges"},
        gives={"residuals"},
    )
