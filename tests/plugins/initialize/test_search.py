"""The search finds far starts where edges tell of them, and stays near the start where they tell nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import ImageEdges, ImageFeatures, Side, View, se3
from p2o.geometry.perturb import wrong_start
from p2o.solving import DirectedCost
from p2o_plugins.initialize import search

from tests import edge_scene


def searched(view: View, start: np.ndarray, **options: float) -> np.ndarray:
    return search.build(search.SearchOptions(**options))([view], start)[0]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("prior", [0.0, 10.0])
def test_with_edges_the_prior_does_not_hold_the_pose_back(seed: int, prior: float) -> None:
    view = edge_scene.view(seed=seed)
    start = wrong_start(edge_scene.TRUTH, 3.0, 0.15, np.random.default_rng(seed))
    found = searched(view, start, prior=prior)
    assert se3.angle_deg(found @ se3.inverse(edge_scene.TRUTH)) < 0.3


def scattered(seed: int) -> View:
    """Return a view whose image edges have nothing to do with its LiDAR edges."""
    view, rng = edge_scene.view(seed=seed), np.random.default_rng(seed)
    uv = rng.uniform([0, 0], [view.camera.width - 1, view.camera.height - 1], (3000, 2))
    side = rng.integers(0, 4, 3000).astype(np.int8)
    return replace(view, image=ImageFeatures(ImageEdges(uv, side)))


def test_without_evidence_the_prior_keeps_the_pose_near_the_start() -> None:
    start = edge_scene.TRUTH
    moved = {
        prior: np.mean(
            [se3.angle_deg(searched(scattered(s), start, prior=prior) @ se3.inverse(start)) for s in range(4)]
        )
        for prior in (0.0, 1000.0)
    }
    assert moved[1000.0] < 0.5 < moved[0.0]


def haunted(seed: int) -> View:
    """Return a view that lacks most image edges, but has those of a copy 3 deg aside whose outlines are 10 px too wide.

    At a wide truncation the copy fits better, for something is near to all of it; at a narrow one nothing of it fits.
    """
    view, rng = edge_scene.view(seed=seed), np.random.default_rng(seed)
    edges, camera = view.image_edges, view.camera
    turned = se3.exp(np.array([0, np.radians(-3.0), 0, 0, 0, 0]))
    outwards = np.array([edge_scene.STEP[Side(side)] for side in range(4)])
    copy = camera.project(camera.rays(edges.uv) @ turned[:3, :3].T) + 10.0 * outwards[edges.side]
    inside = camera.in_image(copy)
    patch = (edges.uv[:, 0] // 70).astype(int) * 3 + (edges.uv[:, 1] // 130).astype(int)
    there = (rng.random(60) > 0.6)[patch]
    uv, side = np.concatenate([edges.uv[there], copy[inside]]), np.concatenate([edges.side[there], edges.side[inside]])
    return replace(view, image=ImageFeatures(ImageEdges(uv, side)))


def test_a_basin_that_only_narrow_truncation_tells_is_among_the_proposals() -> None:
    start = se3.exp(np.array([0, np.radians(-1.5), 0, 0, 0, 0])) @ edge_scene.TRUTH
    right = 0
    for seed in range(8):
        proposals = search.build(search.SearchOptions())([haunted(seed)], start)[:-1]
        right += min(se3.angle_deg(pose @ se3.inverse(edge_scene.TRUTH)) for pose in proposals) < 0.5
    assert right >= 5  # where the start alone began the searches: 2


def test_proposals_lie_apart_the_best_first_and_the_given_start_last() -> None:
    start = wrong_start(edge_scene.TRUTH, 2.0, 0.1, np.random.default_rng(0))
    *proposals, last = search.build(search.SearchOptions())([haunted(0)], start)
    assert last is start
    assert 1 < len(proposals) <= 3
    cost = DirectedCost.of([haunted(0)], start, 4.0, max_points=search.MAX_POINTS)
    values = cost(np.stack(proposals))
    assert (np.diff(values) > -0.05).all()
    for number, pose in enumerate(proposals):
        assert all(se3.angle_deg(pose @ se3.inverse(other)) > 0.1 for other in proposals[:number])


def test_where_no_lidar_edge_is_in_sight_the_given_start_is_all_there_is() -> None:
    view = edge_scene.view()
    behind = se3.exp(np.array([0, np.pi, 0, 0, 0, 0])) @ edge_scene.TRUTH
    assert search.build(search.SearchOptions())([view], behind) == [behind]
