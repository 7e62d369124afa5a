"""The search finds far starts where edges tell of them, and stays near the start where they tell nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import ImageEdges, ImageFeatures, View, se3
from p2o.perturb import wrong_start
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
