"""Edges and information together: the sum of both is what is least, and each alone is its limit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import p2o
import pytest
from p2o.solving import Objective
from p2o_baselines.information import cues
from scipy.optimize import approx_fprime

DATA = "synthetic:?width_px=621&height_px=188&place=street&right=false"


@cache
def prepared() -> tuple[cues.Cues, cues.Seen, p2o.Frame]:
    method = cues.build(cues.CuesOptions(extractor="depth/rings"))
    assert isinstance(method, cues.Cues)
    plan = p2o.Recipe.of(data=DATA).resolve(p2o.Registry.load())
    frame = plan.dataset()[0]
    return method, method.prepare(frame), frame


def start() -> np.ndarray:
    frame = prepared()[2]
    return p2o.se3.exp(np.array([0.01, 0.0, -0.01, 0.03, 0.0, 0.02])) @ frame.camera_from_lidar


def solved() -> p2o.Result:
    method, seen, _ = prepared()
    return method.solve([seen], start())


def test_points_that_tell_nothing_leave_the_pose_of_the_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cues, "_POINTS_PER_OBSERVATION", 1e12)
    method, seen, _ = prepared()
    edges = method.pipeline.solve([seen.edges], start())
    assert edges.status.solved
    np.testing.assert_allclose(solved().camera_from_lidar, edges.camera_from_lidar, atol=1e-6)


def test_the_less_the_points_are_alike_the_further_they_move_the_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    method, seen, _ = prepared()
    edges = method.pipeline.solve([seen.edges], start()).camera_from_lidar
    steps = []
    for alike in (2e4, 200.0):
        monkeypatch.setattr(cues, "_POINTS_PER_OBSERVATION", alike)
        steps.append(p2o.se3.distance_m(solved().camera_from_lidar @ p2o.se3.inverse(edges)))
    assert 0 < steps[0] < steps[1] < 0.2


def test_the_slope_is_that_of_the_cost() -> None:
    """With the height of the LiDAR's origin in the place of the information, whose slope is known."""

    def height_slope(pose: np.ndarray) -> np.ndarray:
        return np.array([pose[1, 3], -pose[0, 3], 0, 0, 0, 1])

    height = Objective(lambda poses: poses[:, 2, 3], height_slope)
    both = cues._Sum(start(), np.diag([1e4, 2e4, 3e4, 40.0, 50.0, 60.0]), height, 20.0)
    for place in np.random.default_rng(0).normal(size=(3, 6)):
        np.testing.assert_allclose(both.slope(place), approx_fprime(place, both.cost, 1e-6), atol=1e-5)


def test_what_the_edges_refuse_stays_refused() -> None:
    method, seen, _ = prepared()
    bare = replace(seen, edges=replace(seen.edges, image=p2o.ImageFeatures(p2o.ImageEdges.empty())))
    result = method.solve([bare], start())
    assert result.status is p2o.Status.NO_EDGES
    np.testing.assert_allclose(result.camera_from_lidar, start(), atol=1e-12)


def test_an_extractor_that_is_not_there_is_told_with_the_nearest() -> None:
    with pytest.raises(p2o.UnknownNameError, match="rings"):
        cues.build(cues.CuesOptions(extractor="depth/ring"))
