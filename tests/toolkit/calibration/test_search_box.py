"""A pose outside the box that an initializer searches loses against one inside, and is not trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.calibration.search_box import SearchBox
from p2o.geometry.perturb import parse_perturbation
from p2o.results.verdict import Doubt
from p2o.solving import Pipeline

from tests import edge_scene

BOX = SearchBox(10.0, 0.5)


@pytest.mark.parametrize("axis", range(6))
def test_the_box_ends_ten_percent_beyond_its_half_sizes_on_each_axis(axis: int) -> None:
    unit = np.radians(10.0) if axis < 3 else 0.5
    for share, inside in ((1.09, True), (1.11, False), (-1.09, True), (-1.11, False)):
        step = np.zeros(6)
        step[axis] = share * unit
        assert BOX.has(np.eye(4), se3.exp(step)) is inside


@pytest.mark.parametrize("size", ["euler camera 10deg 0.5m", "10deg 0.5m"])
def test_initial_errors_of_the_size_of_the_box_are_inside(size: str) -> None:
    truth = edge_scene.TRUTH
    for seed in range(100):
        start = parse_perturbation(size).start(truth, np.random.default_rng(seed))
        assert BOX.has(start, truth), seed


@dataclass(frozen=True)
class Proposing(p2o.InitializerBase):
    """Propose given poses, and search a box of a given size."""

    poses: Sequence[np.ndarray]
    size: tuple[float, float] | None

    @property
    def reach(self) -> tuple[float, float] | None:
        return self.size

    def __call__(self, views: Sequence[p2o.View], camera_from_lidar: np.ndarray, /) -> list[np.ndarray]:
        return list(self.poses)


def result(start: np.ndarray, poses: Sequence[np.ndarray], size: tuple[float, float] | None) -> p2o.Result:
    plan = p2o.Recipe.of(data="synthetic:").resolve(p2o.Registry.load(environ={}))
    pipeline = plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    chosen = Pipeline(**{**vars(pipeline), "initializer": Proposing(poses, size)})
    return chosen.solve([edge_scene.view()], start)


def test_a_pose_outside_the_box_is_doubtful_and_says_so() -> None:
    start = se3.exp(np.array([0, np.radians(4.0), 0, 0, 0, 0])) @ edge_scene.TRUTH
    near = se3.exp(np.array([0, np.radians(0.3), 0, 0, 0, 0])) @ edge_scene.TRUTH
    wide, narrow = (result(start, [near], size) for size in ((5.0, 0.5), (2.0, 0.5)))
    assert np.array_equal(wide.camera_from_lidar, narrow.camera_from_lidar)
    assert Doubt.OUTSIDE_BOX not in [reason.doubt for reason in wide.verdict.reasons]
    [reason] = [reason for reason in narrow.verdict.reasons if reason.doubt is Doubt.OUTSIDE_BOX]
    assert "outside the searched box, 2 deg about and 0.5 m along each axis" in reason.text
    assert not narrow.verdict.trusted


def test_a_pose_inside_the_box_wins_against_a_better_one_outside() -> None:
    start = se3.exp(np.array([0, np.radians(6.0), 0, 0, 0, 0])) @ edge_scene.TRUTH
    truth = se3.exp(np.array([0, np.radians(0.2), 0, 0, 0, 0])) @ edge_scene.TRUTH
    wrong = se3.exp(np.array([0, np.radians(5.0), 0, 0, 0, 0])) @ edge_scene.TRUTH
    free, boxed = (result(start, [truth, wrong], size) for size in (None, (3.0, 0.5)))
    assert se3.angle_deg(free.camera_from_lidar @ se3.inverse(edge_scene.TRUTH)) < 0.5
    assert se3.angle_deg(boxed.camera_from_lidar @ se3.inverse(edge_scene.TRUTH)) > 1.0
