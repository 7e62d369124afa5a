"""Offers every method of this package; each lives in the file of its name, which is imported when it is used."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl, methods_at


def _offered(places: str) -> Iterator[Method]:
    return methods_at("p2o_baselines", places.split())


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    return _offered(
        "edges.canny edges.canny_long information.grey edges.hed edges.idt:IMAGE segments.lane_pole_image edges.lcs "
        "edges.line_idt:IMAGE edges.lsd segments.masks edges.smoothness"
    )


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    return _offered(
        "segments.attributes segments.lane_pole_cloud edges.line_points edges.plane_lines information.reflectance "
        "information.returns edges.ring_discontinuity edges.voxel_planes"
    )


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    return _offered(
        "segments.crlf edges.gmm information.gom edges.idt edges.knn_line edges.line_idt edges.lines "
        "segments.mask_consistency information.mi edges.nearest information.nid information.nmi edges.tv_fusion"
    )


@hookimpl
def p2o_calibrators() -> Iterator[Method]:
    """Offer the calibrators."""
    return _offered(
        "segments.atop motion.csc information.cues targets.geiger motion.hand_eye targets.koo motion.line_time "
        "learned.matches targets.mirzaei picked targets.zhou learned.calibnet learned.calibrcnn learned.lccnet "
        "learned.regnet learned.rggnet targets.gong targets.kuemmerle targets.pusztai targets.acsc targets.domhof "
        "targets.velas targets.velo2cam"
    )


@hookimpl
def p2o_initializers() -> Iterator[Method]:
    """Offer the initializers."""
    return _offered("motion.hand_eye:START learned.matches:START")
