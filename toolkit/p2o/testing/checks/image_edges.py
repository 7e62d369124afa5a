"""What image extractors promise that give occlusion edges."""

from __future__ import annotations

import numpy as np

from p2o.features.edges import ImageEdges
from p2o.host.method import Kind
from p2o.testing import stage
from p2o.testing.check import Checks, gives
from p2o.testing.checks import extractors
from p2o.testing.checks.sides import require_sides
from p2o.testing.subject import Subject, require

CHECKS = Checks(Kind.IMAGE_EXTRACTOR)
_edges = gives("image-edges")


def _found(subject: Subject) -> ImageEdges:
    edges: ImageEdges = subject.once(extractors.look).features.edges
    return edges


@CHECKS.of(_edges)
def image_edges_are_in_the_image(subject: Subject) -> None:
    """Edges are found on the test stage, and all of them lie inside the image."""
    edges, camera = _found(subject), subject.frames[0].camera
    require(len(edges), "no edges on an image with five plates in front of a wall")
    inside = camera.in_image(edges.uv)
    require(inside.all(), f"{int((~inside).sum())} of {len(edges)} edges lie outside the image")


@CHECKS.of(_edges)
def image_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the outlines of the test stage have an edge (of their side, where sides are given) near by."""
    edges, truth = subject.once(_on_the_stage), stage.view().image_edges
    if "side" not in subject.gives:
        truth = truth.without_sides()
    found = np.concatenate(
        [
            edges.trees[side].query(truth.uv[rows])[0] <= 3.0 if side in edges.index else np.zeros(len(rows), bool)
            for side, rows in truth.index.items()
        ]
    )
    require(found.mean() >= 0.5, f"only {100 * found.mean():.0f} % of the outlines have an edge within 3 px")


@CHECKS.of(_edges)
def image_sides_are_as_declared(subject: Subject) -> None:
    """A method that gives `side` gives one to every edge; one that does not gives none."""
    require_sides(subject, _found(subject))


@CHECKS.of(_edges)
def a_featureless_image_has_no_edges(subject: Subject) -> None:
    """An image of one grey and one depth gives no edges, and no error."""
    edges = subject.once(extractors.nothing).edges
    require(len(edges) == 0, f"{len(edges)} edges on an image of one grey")


@CHECKS.of(_edges)
def image_edges_repeat(subject: Subject) -> None:
    """The same image gives the same edges, bit for bit, also from a freshly built stage."""
    extractors.require_repeated(subject)


@CHECKS.of(_edges)
def image_input_is_unchanged(subject: Subject) -> None:
    """The image is not written to."""
    extractors.require_input_unchanged(subject)


def _on_the_stage(subject: Subject) -> ImageEdges:
    """Return the edges on the stage, whatever frames the method has for an example: there outlines are known."""
    if subject.example is None:
        return _found(subject)
    edges: ImageEdges = subject.built()(stage.frame().image).edges
    return edges
