"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_baselines import canny, grey, hed

    yield from (canny.METHOD, grey.METHOD, hed.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_baselines import reflectance

    yield reflectance.METHOD


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_baselines import gom, mi, nearest, nid, nmi

    yield from (gom.METHOD, mi.METHOD, nearest.METHOD, nid.METHOD, nmi.METHOD)


@hookimpl
def p2o_calibrators() -> Iterator[Method]:
    """Offer the whole methods."""
    from p2o_baselines import picked

    yield picked.METHOD
