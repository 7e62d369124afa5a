"""Masks by colour alone, `--extractor masks/attributes`: OpenCV's graph segments and superpixels, without a network.

They stand in for the masks of a segmentation network (SAM in CalibAnything): the graph segments of Felzenszwalb and
Huttenlocher at several scales, which overlap as SAM's parts and wholes do, and if wanted the superpixels SLIC or SEEDS.
Masks that a network made are read by the matcher `mask-consistency` from a folder.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import p2o
from p2o.arrays import Int, UInt8

from p2o_baselines.image_masks import masks_of, parts_of


class MasksOptions(p2o.Options):
    """Options of `masks`."""

    graph_scales: tuple[float, ...] = p2o.field(
        (100.0, 400.0, 1500.0), max_length=3, help="Scales k of the graph segments: larger ones give larger segments."
    )
    graph_sigma_px: float = p2o.field(0.5, gt=0, le=10, help="Width of the blur before the graph segments.")
    superpixels: Literal["none", "slic", "seeds"] = p2o.field("none", help="Superpixels that are taken as masks too.")
    superpixel_px: int = p2o.field(60, ge=8, le=500, help="Size of a superpixel.")
    least_share: float = p2o.field(
        1 / 1200, gt=0, lt=1, help="Masks of a smaller share of the image, or 2000 px if that is less, are left out."
    )
    most: int = p2o.field(255, ge=1, le=2000, help="Only so many masks count, the largest ones.")


def graph_segments(rgb: UInt8, scale: float, sigma_px: float, least_px: float) -> Int:
    """Return the label image (H, W) of the graph segments of a picture (H, W, 3)."""
    import cv2

    segmenter = cv2.ximgproc.segmentation.createGraphSegmentation(sigma_px, scale, max(1, int(least_px)))
    return np.asarray(segmenter.processImage(np.ascontiguousarray(rgb[..., ::-1])), np.int64)


def superpixels(rgb: UInt8, kind: str, size_px: int) -> Int:
    """Return the label image (H, W) of the superpixels `slic` or `seeds` of a picture (H, W, 3)."""
    import cv2

    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2Lab)
    height, width = lab.shape[:2]
    if kind == "slic":
        found = cv2.ximgproc.createSuperpixelSLIC(lab, cv2.ximgproc.SLICO, size_px, 10.0)
        found.iterate(10)
        found.enforceLabelConnectivity(25)
    else:
        count = max(2, round(height * width / size_px**2))
        found = cv2.ximgproc.createSuperpixelSEEDS(width, height, 3, count, 4)
        found.iterate(lab, 10)
    return np.asarray(found.getLabels(), np.int64)


def build(options: MasksOptions) -> p2o.ImageExtractor:
    """Return the extractor; raises InputError if nothing is to be looked for."""
    if not options.graph_scales and options.superpixels == "none":
        raise p2o.InputError("no kind of mask is chosen", where="masks", expected="graph_scales, superpixels or both")

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        least_px = min(options.least_share * image.grey.size, 2000)
        layers = [graph_segments(image.rgb, k, options.graph_sigma_px, least_px) for k in options.graph_scales]
        if options.superpixels != "none":
            layers.append(superpixels(image.rgb, options.superpixels, options.superpixel_px))
        found = [shape for layer in layers for shape in parts_of(layer)]
        # One mask that is the whole picture tells nothing.
        shapes = [shape for shape in found if not shape.all()]
        return p2o.ImageFeatures(features=[masks_of(shapes, image.grey.shape, options.most, least_px)])

    return extract


METHOD = p2o.Method(
    name="masks",
    build=build,
    options=MasksOptions,
    summary="Graph segments at several scales, and superpixels, as masks of the image.",
    gives={"image-masks"},
    cite="Felzenszwalb and Huttenlocher, Efficient graph-based image segmentation, IJCV 2004",
)
