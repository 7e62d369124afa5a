"""Edges where the grey level steps, without direction."""

import numpy as np
import p2o
from scipy.ndimage import gaussian_filter, maximum_filter1d


class GreyStepsOptions(p2o.Options):
    """Options of `grey-steps`."""

    threshold: float = p2o.field(20.0, gt=0, le=255, help="Smallest step of the grey level across an edge.")
    sigma_px: float = p2o.field(1.0, gt=0, le=20, help="Width of the Gaussian that smooths the image first.")


def build(options: GreyStepsOptions) -> p2o.ImageExtractor:
    """Return the extractor."""

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        grey = gaussian_filter(image.grey.astype(float), options.sigma_px)
        edge = np.zeros(grey.shape, bool)
        for axis in (0, 1):
            step = np.abs(np.gradient(grey, axis=axis)) * 2
            edge |= (step >= options.threshold) & (step == maximum_filter1d(step, 5, axis=axis))
        v, u = np.nonzero(edge)
        uv = np.column_stack([u, v]).astype(float)
        return p2o.ImageFeatures(edges=p2o.ImageEdges(uv, np.full(len(uv), p2o.Side.NONE, np.int8)))

    return extract


METHOD = p2o.Method(
    name="grey-steps",
    build=build,
    options=GreyStepsOptions,
    summary="Steps of the grey level, without direction.",
    gives={"image-edges"},
)
