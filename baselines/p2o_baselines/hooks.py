"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_baselines import canny, lane_pole_image, masks, smoothness

    yield from (canny.METHOD, lane_pole_image.METHOD, masks.METHOD, smoothness.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_baselines import attributes, lane_pole_cloud, returns

    yield from (attributes.METHOD, lane_pole_cloud.METHOD, returns.METHOD)


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_baselines import crlf, mask_consistency, nearest, tv_fusion

    yield from (crlf.METHOD, mask_consistency.METHOD, nearest.METHOD, tv_fusion.METHOD)


@hookimpl
def p2o_calibrators() -> Iterator[Method]:
    """Offer the whole methods."""
    from p2o_baselines import atop

    yield atop.METHOD
