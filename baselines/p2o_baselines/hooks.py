"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_baselines import canny, canny_long, grey, hed, idt, lane_pole_image, lcs, line_idt, lsd, masks, smoothness

    yield from (canny.METHOD, canny_long.METHOD, grey.METHOD, hed.METHOD, idt.IMAGE, lane_pole_image.METHOD)
    yield from (lcs.METHOD, line_idt.IMAGE, lsd.METHOD, masks.METHOD, smoothness.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_baselines import (
        attributes,
        lane_pole_cloud,
        line_points,
        plane_lines,
        reflectance,
        returns,
        ring_discontinuity,
        voxel_planes,
    )

    yield from (attributes.METHOD, lane_pole_cloud.METHOD, line_points.METHOD, plane_lines.METHOD)
    yield from (reflectance.METHOD, returns.METHOD, ring_discontinuity.METHOD, voxel_planes.METHOD)


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_baselines import (
        crlf,
        gmm,
        gom,
        idt,
        knn_line,
        line_idt,
        lines,
        mask_consistency,
        mi,
        nearest,
        nid,
        nmi,
        tv_fusion,
    )

    yield from (crlf.METHOD, gmm.METHOD, gom.METHOD, idt.METHOD, knn_line.METHOD, line_idt.METHOD, lines.METHOD)
    yield from (mask_consistency.METHOD, mi.METHOD, nearest.METHOD, nid.METHOD, nmi.METHOD, tv_fusion.METHOD)


@hookimpl
def p2o_calibrators() -> Iterator[Method]:
    """Offer the whole methods."""
    from p2o_baselines import (
        acsc,
        atop,
        calibnet,
        calibrcnn,
        csc,
        cues,
        domhof,
        geiger,
        gong,
        hand_eye,
        koo,
        kuemmerle,
        lccnet,
        line_time,
        mirzaei,
        picked,
        pusztai,
        regnet,
        rggnet,
        velas,
        velo2cam,
        zhou,
    )

    yield from (atop.METHOD, csc.METHOD, cues.METHOD, geiger.METHOD, hand_eye.METHOD, koo.METHOD, line_time.METHOD)
    yield from (mirzaei.METHOD, picked.METHOD, zhou.METHOD)
    yield from (calibnet.METHOD, calibrcnn.METHOD, lccnet.METHOD, regnet.METHOD, rggnet.METHOD)
    yield from (gong.METHOD, kuemmerle.METHOD, pusztai.METHOD)
    yield from (acsc.METHOD, domhof.METHOD, velas.METHOD, velo2cam.METHOD)


@hookimpl
def p2o_initializers() -> Iterator[Method]:
    """Offer the initializers."""
    from p2o_baselines import hand_eye

    yield hand_eye.START
