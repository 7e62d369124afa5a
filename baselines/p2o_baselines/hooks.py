"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_baselines import canny, canny_long, idt, line_idt, lsd

    yield from (canny.METHOD, canny_long.METHOD, idt.IMAGE, line_idt.IMAGE, lsd.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_baselines import line_points, plane_lines, ring_discontinuity, voxel_planes

    yield from (line_points.METHOD, plane_lines.METHOD, ring_discontinuity.METHOD, voxel_planes.METHOD)


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_baselines import gmm, idt, knn_line, line_idt, lines, nearest

    yield from (gmm.METHOD, idt.METHOD, knn_line.METHOD, line_idt.METHOD, lines.METHOD, nearest.METHOD)
