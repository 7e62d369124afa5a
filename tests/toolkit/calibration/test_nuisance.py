"""Views with the nuisance parameters applied: features are moved to the time of the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o.calibration.adjustment import Nuisance
from p2o.calibration.nuisance import known_twists
from p2o.calibration.options import PipelineOptions
from p2o.results.result import TimeOffset

from tests import edge_scene


@pytest.mark.parametrize("offset_s", [0.02, -0.05])
def test_a_late_image_sees_points_nearer_by_the_distance_driven_and_turned_back(offset_s: float) -> None:
    view = edge_scene.view()
    forward, standing = np.array([0, 0, 0, 10.0, 0, 0]), np.zeros(6)
    nuisance = Nuisance(twists=np.array([forward, standing]), time=TimeOffset(offset_s, 0.05, used=True))
    moved, same = nuisance.views([view, view])
    driven = np.array([10.0 * offset_s, 0, 0])
    np.testing.assert_allclose(moved.cloud_edges.xyz, view.cloud_edges.xyz - driven, atol=1e-12)
    np.testing.assert_allclose(same.cloud_edges.xyz, view.cloud_edges.xyz, atol=1e-12)
    assert np.array_equal(moved.image_edges.uv, view.image_edges.uv)
    left = np.array([0, 0, np.radians(20.0), 0, 0, 0])
    (moved,) = Nuisance(twists=left[None], time=TimeOffset(0.1, 0.05, used=True)).views([view])
    turned = [np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0])) for xyz in (moved.cloud_edges.xyz, view.cloud_edges.xyz)]
    np.testing.assert_allclose(turned[0] - turned[1], -2.0, atol=1e-9)


def test_an_offset_in_time_needs_four_frames_of_known_and_different_velocities() -> None:
    twists = [np.array([0, 0, 0, speed, 0, 0]) for speed in (2.0, 4.0, 6.0, 8.0)]
    views = [replace(edge_scene.view(), twist=twist) for twist in twists]
    options = PipelineOptions()
    found = known_twists(views, options)
    assert found is not None
    assert np.array_equal(found, twists)
    assert known_twists(views[:3], options) is None
    assert known_twists([*views, replace(views[0], twist=None)], options) is None
    assert known_twists([replace(view, twist=twists[0]) for view in views], options) is None
    assert known_twists(views, PipelineOptions(time="trust")) is None
