"""Kinds of features: they move, thin and lose their sides by themselves, and sets find them by their words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from p2o import (
    CloudEdges,
    CloudFeature,
    CloudFeatures,
    CloudPoints,
    GreyMap,
    ImageEdges,
    ImageFeature,
    ImageFeatures,
    InputError,
    Side,
    View,
    se3,
)

from tests.edge_scene import PINHOLE

MOVE = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
XYZ = np.random.default_rng(0).normal(size=(50, 3)) * 10


@dataclass(frozen=True, eq=False)
class Poles(CloudFeature):
    """A kind that a plugin brings: points with an axis each."""

    word: ClassVar[str] = "cloud-poles"
    foot: np.ndarray
    axis: np.ndarray

    def __len__(self) -> int:
        return len(self.foot)

    def select(self, keep: object) -> Poles:
        return Poles(self.foot[keep], self.axis[keep])

    def moved(self, b_from_lidar: np.ndarray) -> Poles:
        return Poles(se3.apply(b_from_lidar, self.foot), self.axis @ b_from_lidar[:3, :3].T)


POLES = Poles(XYZ, np.tile([0.0, 0, 1], (50, 1)))
EDGES = CloudEdges(XYZ, np.zeros(50, np.int8))


def view(cloud: CloudFeatures) -> View:
    return View("v", PINHOLE, ImageFeatures(features=[GreyMap(np.ones((4, 4)))]), cloud)


def test_features_are_found_by_word_and_count_nothing_where_there_are_none_and_those_of_plugins_move_along() -> None:
    seen = view(CloudFeatures(features=[POLES]))
    assert seen.get("cloud-poles") is POLES
    assert (seen.count("cloud-poles"), seen.count("image-grey"), seen.count("cloud-edges")) == (50, 16, 0)
    assert seen.get("cloud-edges") is None
    assert seen.cloud.words == {"cloud-poles"}
    moved = view(CloudFeatures(EDGES, features=[POLES])).moved(MOVE)
    np.testing.assert_allclose(moved.get("cloud-poles").foot, moved.cloud_edges.xyz)
    np.testing.assert_allclose(moved.get("cloud-poles").axis[0], MOVE[:3, 2])


def test_thinning_having_and_forgetting_sides_work_by_kind() -> None:
    cloud = CloudFeatures(EDGES, XYZ, features=[POLES]).thinned(10)
    assert [len(feature) for feature in cloud] == [10, 10, 10]
    np.testing.assert_array_equal(cloud.get("cloud-poles").foot[[0, -1]], XYZ[[0, -1]])
    assert CloudFeatures(features=[POLES]).thinned(50).get("cloud-poles") is POLES
    assert len(POLES.thinned(0)) == 0
    cloud = CloudFeatures(EDGES, features=[POLES]).having(EDGES.select(np.arange(3)))
    assert (len(cloud.edges), len(cloud.get("cloud-poles"))) == (3, 50)
    forgotten = CloudFeatures(EDGES, features=[POLES]).without_sides()
    assert set(forgotten.edges.side) == {Side.NONE}
    assert forgotten.get("cloud-poles") is POLES
    # The older way of writing the same as `having`.
    assert len(replace(CloudFeatures(EDGES, features=[POLES]), edges=EDGES.select([0])).edges) == 1


def test_points_move_with_their_normals_and_untwist_by_their_own_times() -> None:
    normal = np.tile([1.0, 0, 0], (50, 1))
    points = CloudPoints(XYZ, intensity=np.arange(50.0), normal=normal, time_s=np.full(50, 0.1))
    moved = points.moved(MOVE)
    np.testing.assert_allclose(moved.xyz, se3.apply(MOVE, XYZ))
    np.testing.assert_allclose(moved.normal[0], MOVE[:3, 0])
    twist = np.array([0, 0, 0.2, 5.0, 0, 0])
    np.testing.assert_allclose(points.untwisted(twist).xyz, se3.apply(se3.exp(twist * 0.1), XYZ), atol=1e-12)
    np.testing.assert_array_equal(CloudPoints(XYZ).untwisted(twist).xyz, XYZ)
    assert points.select([3, 4]).intensity.tolist() == [3.0, 4.0]


def test_a_map_is_looked_up_between_pixels_and_is_nan_outside() -> None:
    rows, columns = np.mgrid[0:5, 0:7]
    plane = GreyMap(2.0 * columns + 10.0 * rows)
    np.testing.assert_allclose(plane.at(np.array([[0.0, 0.0], [2.5, 1.25], [6.0, 4.0]])), [0.0, 17.5, 52.0])
    assert np.isnan(plane.at(np.array([[-0.1, 0], [6.1, 0], [0, 4.5], [np.nan, 1]]))).all()
    stacked = GreyMap(np.stack([plane.values, -plane.values], axis=2))
    np.testing.assert_allclose(stacked.at(np.array([[[2.5, 1.25]]])), [[[17.5, -17.5]]])


class Mute(CloudFeature):
    """A kind that does not define moved."""

    word: ClassVar[str] = "cloud-mute"

    def __len__(self) -> int:
        return 1


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: CloudFeatures(features=[POLES, POLES]), "two features of the sweep are of the kind cloud-poles"),
        (lambda: CloudFeatures(features=[GreyMap(np.ones((2, 2)))]), "expected p2o.CloudFeature.*got GreyMap"),
        (lambda: ImageFeatures(features=[np.ones(3)]), "expected p2o.ImageFeature.*got ndarray"),
        (lambda: ImageFeatures(features=[ImageFeature()]), "expected p2o.ImageFeature with a `word`"),
        (lambda: CloudPoints(XYZ, intensity=np.ones(3)), "intensity of the cloud points has the wrong shape"),
        (lambda: GreyMap(np.full((2, 2), np.nan)), "image-grey contains values that are not finite"),
    ],
)
def test_what_is_no_feature_is_refused(make, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make()


def test_a_kind_that_does_not_say_how_it_moves_cannot_be_moved_unnoticed() -> None:
    with pytest.raises(TypeError, match="Mute does not define moved"):
        CloudFeatures(features=[Mute()]).moved(MOVE)
    # Edges given twice are the ones given by name.
    uv = np.zeros((2, 2))
    old, new = ImageEdges(uv, np.zeros(2, np.int8)), ImageEdges(uv[:1], np.zeros(1, np.int8))
    assert ImageFeatures(new, features=[old]).edges is new
