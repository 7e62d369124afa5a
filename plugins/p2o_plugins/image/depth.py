"""Extract directed occlusion edges from the depth map that comes with the image (`--extractor depth`)."""

from __future__ import annotations

import numpy as np
from p2o import Image, ImageEdges, ImageExtractor, ImageFeatures, InputError, Method, Options, Side, field, occlusion

_MIN_LENGTH_PX = 5  # connected edges of fewer pixels than this are dropped, side by side


class DepthOptions(Options):
    """Criteria for an occlusion edge of a depth map."""

    min_jump_m: float = field(0.4, gt=0, help="Smallest step in distance from foreground to background, in metres.")


def build(options: DepthOptions) -> ImageExtractor:
    """Return the extractor; raises InputError for an image without depth.

    The labels are those of the paper's training data (Sec. III-B, IV-A). Pairs whose occluding pixel is masked give no
    edge. The depth map must be dense: the rule compares four consecutive pixels, and unknown pixels never form an edge,
    so that sparse ground truth (KITTI's disparity maps, one pixel in four) yields almost no edges.
    """
    background = np.array([Side(s).background for s in range(4)], dtype=np.float64)

    def extract(image: Image) -> ImageFeatures:
        if image.depth_m is None:
            raise InputError(
                "the image has no depth",
                where="depth",
                expected="depth_m beside the image",
                got="an image alone",
                hint="use rendered data such as --data synthetic, or another extractor such as --extractor canny/rings",
            )
        orders = occlusion.occlusion_orders(
            image.depth_m,
            image.camera,
            min_jump_m=options.min_jump_m,
            masked=image.masked,
        )
        maps = occlusion.without_short(occlusion.side_maps(orders), _MIN_LENGTH_PX)
        uv, side = occlusion.edges_from_maps(maps)
        # The true outline is between the centres of the two pixels. Their midpoint is unbiased on average, whereas the
        # centre of the foreground pixel would make every object one pixel too narrow.
        return ImageFeatures(ImageEdges(uv + 0.5 * background[side], side))

    return extract


METHOD = Method(
    name="depth",
    build=build,
    options=DepthOptions,
    summary="Directed occlusion edges at the steps of a known depth map: the oracle among image extractors.",
    needs={"depth"},
    gives={"image-edges", "side"},
    cite="Qiu, Xiao, Wang, Marlet, Pixel-Pair Occlusion Relationship Map (P2ORM), ECCV 2020",
)
