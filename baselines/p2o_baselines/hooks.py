"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_baselines import canny, idt, line_idt, lsd

    yield from (canny.METHOD, idt.IMAGE, line_idt.IMAGE, lsd.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_baselines import line_points, ring_discontinuity

    yield from (line_points.METHOD, ring_discontinuity.METHOD)


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_baselines import gmm, idt, line_idt, nearest

    yield from (gmm.METHOD, idt.METHOD, line_idt.METHOD, nearest.METHOD)
