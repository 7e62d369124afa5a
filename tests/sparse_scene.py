"""The boxes of `edge_scene`, scanned by a LiDAR whose rings are far apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o import Camera, CloudFeatures, Side, View

from tests import edge_scene


def sparse_view(seed: int, step_deg: float = 1.7, *, camera: Camera = edge_scene.PINHOLE) -> View:
    """Return boxes whose horizontal outlines are anywhere between two rings; the vertical ones are known better."""
    rng = np.random.default_rng(seed)
    view = edge_scene.view(camera, seed=seed, noise_px=0.7)
    edges = view.cloud_edges
    level = np.isin(edges.side, (Side.UPPER, Side.BOTTOM))
    gap_m = np.radians(np.where(level, step_deg, 0.2)) * np.linalg.norm(edges.xyz, axis=1)
    # One ring passes above a whole horizontal outline; consecutive edges of a side are of one box.
    outline = np.cumsum(np.append(0, np.diff(edges.side) != 0))
    offset = np.where(level, rng.uniform(-0.5, 0.5, outline[-1] + 1)[outline], rng.uniform(-0.5, 0.5, len(edges)))
    xyz = edges.xyz + (offset * gap_m)[:, None] * edges.background
    return replace(view, cloud=CloudFeatures(replace(edges, xyz=xyz, sigma_m=gap_m / np.sqrt(12))))
