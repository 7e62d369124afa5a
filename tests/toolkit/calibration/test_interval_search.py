"""The search finds the pose of the highest interval likelihood from anywhere in its box, and nothing without edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import CloudEdges, CloudFeatures, pose_error
from p2o.calibration.interval_search import most_likely_pose
from p2o.geometry.perturb import wrong_start

from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view

VIEWS = [sparse_view(seed) for seed in range(4)]


@pytest.mark.parametrize("seed", range(2))
def test_the_pose_is_found_from_anywhere_in_the_box_although_rings_are_far_apart(seed: int) -> None:
    start = wrong_start(TRUTH, 2.0, 0.15, np.random.default_rng(seed))
    error = pose_error(most_likely_pose(VIEWS, start, []), TRUTH)
    assert error.rotation_deg < 0.25
    assert error.translation_m < 0.08


def test_a_proposal_beyond_the_box_is_used_and_without_edges_the_initial_pose_returned() -> None:
    start = wrong_start(TRUTH, 5.0, 0.3, np.random.default_rng(1))
    proposal = wrong_start(TRUTH, 0.2, 0.02, np.random.default_rng(2))
    assert pose_error(most_likely_pose(VIEWS, start, [start, proposal]), TRUTH).rotation_deg < 0.5
    empty = replace(VIEWS[0], cloud=CloudFeatures(CloudEdges.empty()))
    np.testing.assert_array_equal(most_likely_pose([empty], TRUTH, []), TRUTH)


def test_the_search_is_the_same_for_the_same_seed() -> None:
    start = wrong_start(TRUTH, 2.0, 0.15, np.random.default_rng(0))
    one, again, other = (most_likely_pose(VIEWS[:1], start, [], seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
