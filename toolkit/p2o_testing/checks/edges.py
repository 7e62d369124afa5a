"""What extractors promise that give occlusion edges, of images and of sweeps."""

from __future__ import annotations

from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.features.edges import CloudEdges
from p2o.features.side import Side

from p2o_testing import stage
from p2o_testing.checks.extractors import CLOUDS, IMAGES, look, seen
from p2o_testing.exact import nearest_m
from p2o_testing.subject import Subject, both, but, gives, needs, require

_image_edges, _cloud_edges = gives("image-edges"), gives("cloud-edges")


def _edges(subject: Subject) -> Any:
    return subject.once(look).answer.edges


def _on_the_stage(subject: Subject) -> tuple[Any, Any]:
    """Return the edges on the stage, also if the method has other frames for an example, and the true outlines."""
    name = "image" if "image-edges" in subject.gives else "cloud"
    own = subject.example is None
    edges = _edges(subject) if own else subject.built()(getattr(stage.frame(), name)).edges
    truth = stage.view().image_edges if name == "image" else stage.view().cloud_edges
    return edges, truth if "side" in subject.gives else truth.without_sides()


@IMAGES.of(_image_edges)
def image_edges_are_in_the_image(subject: Subject) -> None:
    """Edges are found on the test stage, and all of them lie inside the image."""
    edges, camera = _edges(subject), subject.frames[0].camera
    require(len(edges), "no edges on an image with five plates in front of a wall")
    inside = camera.in_image(edges.uv)
    require(inside.all(), f"{int((~inside).sum())} of {len(edges)} edges lie outside the image")


@IMAGES.of(_image_edges)
def image_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the outlines of the test stage have an edge (of their side, where sides are given) near by."""
    edges, truth = _on_the_stage(subject)
    near = [
        edges.trees[side].query(truth.uv[rows])[0] <= 3.0 if side in edges.index else np.zeros(len(rows), bool)
        for side, rows in truth.index.items()
    ]
    share = np.concatenate(near).mean()
    require(share >= 0.5, f"only {100 * share:.0f} % of the outlines have an edge within 3 px")


@CLOUDS.of(_cloud_edges)
def cloud_edges_lie_on_surfaces(subject: Subject) -> None:
    """Edges are found on the test stage, and each lies within half a metre of a measured point."""
    cloud, edges = subject.frames[0].cloud, _edges(subject)
    require(len(edges), "no edges on a sweep of five plates in front of a wall")
    distance = nearest_m(edges.xyz, cloud.xyz)
    require(distance.max() <= 0.5, f"an edge lies {distance.max():.2f} m from the nearest point")


@CLOUDS.of(_cloud_edges)
def cloud_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the edges lie within 15 cm of an outline (of their side, where sides are given)."""
    edges, truth = _on_the_stage(subject)
    near = np.zeros(len(edges), bool)
    for side in np.unique(edges.side):
        rows, known = edges.side == side, truth.side == side
        if known.any():
            near[rows] = nearest_m(edges.xyz[rows], truth.xyz[known]) <= 0.15
    require(near.any(), "no edge is within 15 cm of an outline")
    require(near.mean() >= 0.5, f"only {100 * near.mean():.0f} % of the edges are within 15 cm of an outline")


@CLOUDS.of(both(_cloud_edges, but(needs("rings"))))
def point_order_does_not_matter(subject: Subject) -> None:
    """Shuffled points give the same edges in some order, unless the method needs `rings`."""
    cloud = seen(subject)
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    first, second = _edges(subject), subject.built()(shuffled).edges
    require(len(first) == len(second), f"{len(first)} edges in order, {len(second)} shuffled")
    require(np.allclose(_sorted_rows(first), _sorted_rows(second), atol=1e-9), "shuffled points give other edges")


def _sorted_rows(edges: CloudEdges) -> Float:
    rows = np.column_stack([edges.xyz, edges.side])
    return rows[np.lexsort(np.round(rows, 6).T)]


@IMAGES.of(_image_edges, "image_sides_are_as_declared")
@CLOUDS.of(_cloud_edges, "cloud_sides_are_as_declared")
def sides_are_as_declared(subject: Subject) -> None:
    """A method that gives `side` gives one to every edge; one that does not gives none."""
    edges = _edges(subject)
    without = int((edges.side == Side.NONE).sum())
    if "side" in subject.gives:
        require(without == 0, f"{without} of {len(edges)} edges have no side, though `gives` says side")
    else:
        require(without == len(edges), "edges have sides, though `gives` does not say side")


CHECKS = [*IMAGES, *CLOUDS]
