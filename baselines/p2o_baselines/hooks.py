"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

from p2o import Method, hookimpl


def _offered(names: str) -> Iterator[Method]:
    """Yield the methods of files (FILE, or FILE:NAME), imported only here so that nothing is read for `p2o --help`."""
    for file, _, name in (each.partition(":") for each in names.split()):
        yield getattr(import_module(f"p2o_baselines.{file}"), name or "METHOD")


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    return _offered("canny canny_long grey hed idt:IMAGE lane_pole_image lcs line_idt:IMAGE lsd masks smoothness")


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    return _offered(
        "attributes lane_pole_cloud line_points plane_lines reflectance returns ring_discontinuity voxel_planes"
    )


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    return _offered("crlf gmm gom idt knn_line line_idt lines mask_consistency mi nearest nid nmi tv_fusion")


@hookimpl
def p2o_calibrators() -> Iterator[Method]:
    """Offer the calibrators."""
    return _offered(
        "atop csc cues geiger hand_eye koo line_time matches mirzaei picked zhou calibnet calibrcnn lccnet regnet "
        "rggnet gong kuemmerle pusztai acsc domhof velas velo2cam"
    )


@hookimpl
def p2o_initializers() -> Iterator[Method]:
    """Offer the initializers."""
    return _offered("hand_eye:START matches:START")
