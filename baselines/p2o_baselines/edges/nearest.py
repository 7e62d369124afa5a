"""Nearest-line matching without directions: the paper's ablation row without OGM, and the matcher for Canny."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import p2o
from p2o import Bool, Float
from p2o.solving import PairingOptions, PointToLine, assemble, pair

from p2o_baselines.information.information import remembered

Edges = TypeVar("Edges", p2o.ImageEdges, p2o.CloudEdges)


def undirected(edges: Edges) -> Edges:
    """Return edges without directions, each place once: one that carries two directions is listed twice before."""
    place = edges.uv if isinstance(edges, p2o.ImageEdges) else edges.xyz
    return edges.select(_heaviest(place, edges.weight)).without_sides()


def _heaviest(place: Float, weight: Float) -> Bool:
    """Return a mask (N,) of the edge of largest `weight` (N,) at each distinct `place` (N, 2 or 3)."""
    order = np.lexsort((-weight, *place.T))
    ordered = place[order]
    keep = np.ones(len(order), np.bool_)
    keep[order[1:]] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return keep


def build(options: PairingOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> PointToLine`."""
    image_edges: Callable[[p2o.ImageEdges], p2o.ImageEdges] = remembered(undirected)
    cloud_edges: Callable[[p2o.CloudEdges], p2o.CloudEdges] = remembered(undirected)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> PointToLine:
        pairs = []
        for view in views:
            image, cloud = image_edges(view.image_edges), cloud_edges(view.cloud_edges)
            pairs.append(pair(view.camera, image, cloud, [p2o.Side.NONE], camera_from_lidar, reach_px, options))
        return assemble(views, pairs, options.huber_px, balance=False)

    return match


METHOD = p2o.Method(
    name="nearest",
    build=build,
    options=PairingOptions,
    summary="Nearest image edges whatever their direction, as a line per cloud edge.",
    needs={"image-edges", "cloud-edges"},
    gives={"pairs"},
    cite="Wang et al., P2O-Calib, IROS 2023, Table II, row without OGM",
)
