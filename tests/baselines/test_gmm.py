"""`gmm`: image edges as a Gaussian mixture."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.edges.gmm import Gmm, mixtures, scattered
from p2o_testing import stage


def test_the_pictures_are_the_sums_over_all_pairs() -> None:
    """For edges between pixels, but for what sharing them out among four pixels costs at a width of 3 px."""
    rng = np.random.default_rng(0)
    uv, weight, s = rng.uniform(20, 60, (40, 2)), rng.uniform(0.1, 1, 40), 3.0
    first, second = mixtures((80, 80), uv, weight, s)
    for u, v in ((40, 40), (25, 50), (18, 30)):
        off = uv - [u, v]
        bare = np.exp(-(off**2).sum(axis=1) / (2 * s**2)) * (np.abs(off) <= 9.5).all(axis=1)
        count = max(scattered((80, 80), uv, np.ones(40))[max(v - 9, 0) : v + 10, max(u - 9, 0) : u + 10].sum(), 1)
        assert first[v, u] == pytest.approx(bare.sum() / count, rel=0.05)
        assert second[v, u] == pytest.approx(bare @ weight / count, rel=0.05)


def test_the_width_shrinks_with_the_reach_down_to_its_limit() -> None:
    match, view, truth = Gmm(), stage.view(), stage.camera_from_lidar()
    aside = p2o.se3.exp(np.array([0.0, 0.02, 0, 0, 0, 0])) @ truth  # 6 px
    wide, narrow, least = (match([view], truth, reach).cost(aside[None])[0] for reach in (50.0, 10.0, 1.0))
    assert wide < narrow
    own = match([view], truth, 5.0).cost(aside[None])[0]
    assert least == pytest.approx(own)
