"""What cloud extractors promise that give occlusion edges."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.features.edges import CloudEdges
from p2o.frames.cloud import Cloud
from p2o.host.method import Kind
from p2o.testing import stage
from p2o.testing.check import Checks, both, but, gives, needs
from p2o.testing.checks import extractors
from p2o.testing.checks.sides import require_sides
from p2o.testing.subject import Subject, require

CHECKS = Checks(Kind.CLOUD_EXTRACTOR)
_edges = gives("cloud-edges")


def _found(subject: Subject) -> CloudEdges:
    edges: CloudEdges = subject.once(extractors.look).features.edges
    return edges


@CHECKS.of(_edges)
def cloud_edges_lie_on_surfaces(subject: Subject) -> None:
    """Edges are found on the test stage, and each lies within half a metre of a measured point."""
    from scipy.spatial import cKDTree

    cloud, edges = subject.frames[0].cloud, _found(subject)
    require(len(edges), "no edges on a sweep of five plates in front of a wall")
    distance = np.asarray(cKDTree(cloud.xyz).query(edges.xyz)[0])
    require(distance.max() <= 0.5, f"an edge lies {distance.max():.2f} m from the nearest point")


@CHECKS.of(_edges)
def cloud_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the edges lie within 15 cm of an outline (of their side, where sides are given)."""
    from scipy.spatial import cKDTree

    edges, truth = subject.once(_on_the_stage), stage.view().cloud_edges
    if "side" not in subject.gives:
        truth = truth.without_sides()
    near = np.zeros(len(edges), bool)
    for side in np.unique(edges.side):
        rows, known = edges.side == side, truth.side == side
        if known.any():
            near[rows] = cKDTree(truth.xyz[known]).query(edges.xyz[rows])[0] <= 0.15
    require(near.any(), "no edge is within 15 cm of an outline")
    require(near.mean() >= 0.5, f"only {100 * near.mean():.0f} % of the edges are within 15 cm of an outline")


@CHECKS.of(_edges)
def cloud_sides_are_as_declared(subject: Subject) -> None:
    """A method that gives `side` gives one to every edge; one that does not gives none."""
    require_sides(subject, _found(subject))


@CHECKS.of(_edges)
def a_featureless_cloud_has_no_edges(subject: Subject) -> None:
    """A sweep of the inside of a ball gives no edges, and no error."""
    edges = subject.once(extractors.nothing).edges
    require(len(edges) == 0, f"{len(edges)} edges on a sweep without any jump")


@CHECKS.of(both(_edges, but(needs("rings"))))
def point_order_does_not_matter(subject: Subject) -> None:
    """Shuffled points give the same edges in some order, unless the method needs `rings`."""
    cloud: Cloud = extractors.seen(subject)
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    here, there = _found(subject), subject.built()(shuffled).edges
    require(len(here) == len(there), f"{len(here)} edges in order, {len(there)} shuffled")
    here_rows, there_rows = (_sorted(np.column_stack([e.xyz, e.side])) for e in (here, there))
    require(np.allclose(here_rows, there_rows, atol=1e-9), "shuffled points give other edges")


@CHECKS.of(_edges)
def cloud_edges_repeat(subject: Subject) -> None:
    """The same sweep gives the same edges, bit for bit, also from a freshly built stage."""
    extractors.require_repeated(subject)


@CHECKS.of(_edges)
def cloud_input_is_unchanged(subject: Subject) -> None:
    """The sweep is not written to."""
    extractors.require_input_unchanged(subject)


def _on_the_stage(subject: Subject) -> CloudEdges:
    """Return the edges on the stage, whatever frames the method has for an example: there outlines are known."""
    if subject.example is None:
        return _found(subject)
    edges: CloudEdges = subject.built()(stage.frame().cloud).edges
    return edges


def _sorted(rows: Float) -> Float:
    return rows[np.lexsort(np.round(rows, 6).T)]
