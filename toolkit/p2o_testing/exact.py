"""Exact problems and views of the stage, and poses at a known distance from its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from p2o.arrays import Float, Int
from p2o.errors import MethodUnavailable
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.side import Side
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.host.guard import build
from p2o.host.method import Kind
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import LeastSquares
from p2o.run.initial_guess import common_pose

from p2o_testing import stage
from p2o_testing.subject import CheckFailed, NotApplicable, Subject, lacking, require


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
    """Return 400 points of the stage with the planes that contain them."""
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


def require_near(pose: Float, truth: Float, angle_deg: float, distance_m: float, where: str = "") -> None:
    """Raise CheckFailed, with `where` first, unless the error of a pose is within the tolerance."""
    error = pose_error(pose, truth)
    near = error.rotation_deg <= angle_deg and error.translation_m <= distance_m
    promised = f"at most {angle_deg:g} deg and {distance_m:g} m are promised"
    require(near, f"{where}{size_of(error)} from the truth, {promised}")


def truth_of(frames: tuple[Frame, ...]) -> Float:
    """Return the true pose (4, 4) of frames of one rig; raise CheckFailed if it is not known."""
    truth = common_pose(frames, "camera_from_lidar")
    if truth is None:
        raise CheckFailed(f"{frames[0].name} has no truth: the frames of an example must")
    return truth


def size_of(error: PoseError) -> str:
    """Return an error as text."""
    return f"{error.rotation_deg:.4f} deg and {error.translation_m:.4f} m"


def nearest_m(xyz: Float, others: Float) -> Float:
    """Return the distance (N,) in m of each point (N, 3) to the nearest of the others."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(others).query(xyz)[0])


_PREFIXES = ("image-", "cloud-")


def view(subject: Subject) -> View:
    """Return the stage with the kinds of features that the method needs, all that it has where none is named.

    They are exact, but for kinds that only plugins know: those are extracted by a method that gives them.
    """
    return _as_pipeline(subject, subject.once(_full))


def bare_view(subject: Subject) -> View:
    """Return the counterpart of `view` without any features."""
    return _as_pipeline(subject, subject.once(_bare))


def _as_pipeline(subject: Subject, features: View) -> View:
    """Return the view as the pipeline passes it: without sides if the method does not need them."""
    sided = "side" in subject.needs or subject.offer.kind == Kind.INITIALIZER
    return features if sided else features.without_sides()


def _full(subject: Subject) -> View:
    frame = stage.frame()
    return _view(subject, stage.view(), {"image-": frame.image, "cloud-": frame.cloud})


def _bare(subject: Subject) -> View:
    nothing = {"image-": stage.featureless_image(), "cloud-": stage.featureless_cloud()}
    return _view(subject, stage.bare_view(), nothing)


def _view(subject: Subject, known: View, seen: dict[str, Any]) -> View:
    words = sorted(word for word in subject.needs if word.startswith(_PREFIXES))
    if not words:
        return known
    features: dict[str, list[Any]] = {prefix: [] for prefix in _PREFIXES}
    for word in words:
        feature = known.get(word)
        features[word[:6]].append(_by_a_plugin(subject, word, seen[word[:6]]) if feature is None else feature)
    image, cloud = ImageFeatures(features=features["image-"]), CloudFeatures(features=features["cloud-"])
    return View(known.name, known.camera, image, cloud)


def _by_a_plugin(subject: Subject, word: str, seen: Any) -> Any:
    """Return the features of a kind from an installed extractor, preferably of the same plugin; else NotApplicable."""
    kind = Kind.IMAGE_EXTRACTOR if word.startswith("image-") else Kind.CLOUD_EXTRACTOR
    givers = [offer for offer in subject.registry.of_kind(kind) if word in offer.method.gives]
    own = (subject.offer.dist, subject.offer.entry)
    for offer in sorted(givers, key=lambda offer: (offer.dist, offer.entry) != own):
        if lacking(offer.method.needs, (stage.frame(),)):
            continue
        try:
            return build(offer, offer.method.options())(seen).get(word)
        except MethodUnavailable:
            continue
    raise NotApplicable(f"no installed extractor gives {word}")
