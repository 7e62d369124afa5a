"""Segment an image by colour, `--extractor masks/attributes`: OpenCV's graph segments and superpixels, no network.

These masks replace those of a segmentation network (SAM in CalibAnything): the graph segments of Felzenszwalb and
Huttenlocher at several scales, which overlap like the parts and wholes of SAM, and optionally the superpixels SLIC or
SEEDS. Masks of a network are read from a folder by the matcher `mask-consistency`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import p2o
from p2o import Bool, Int, UInt8, field
from p2o.reading import MAX_BYTES, existing_folder, folder_name, naming, read_bytes
from p2o.solving import checked

LAYERS = 4
"""Masks that may cover one pixel, as in the released code of CalibAnything."""


@dataclass(frozen=True, eq=False)
class ImageMasks(p2o.ImageFeature):
    """Masks of one image: up to L numbers that cover a pixel (H, W, L), -1 for none, and areas (M,) in px."""

    word: ClassVar[str] = "image-masks"

    labels: Int
    area_px: Int

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked("labels of the masks", self.labels, (None, None, None), np.int64))
        object.__setattr__(self, "area_px", checked("areas of the masks", self.area_px, (None,), np.int64))

    def __len__(self) -> int:
        return len(self.area_px)


def masks_of(shapes: Sequence[Bool], size: tuple[int, int], most: int, least_px: float) -> ImageMasks:
    """Return the `most` largest masks of a `size` (H, W) with at least `least_px` pixels; there may be none.

    Of a mask that covers more than 2 % of the image only a band of 30 px + 1 / share inside its border is kept, as in
    the released code of CalibAnything. A pixel has at most `LAYERS` masks, the smallest ones first.
    """
    sizes = [int(np.count_nonzero(shape)) for shape in shapes]
    chosen = [k for k in np.argsort(sizes, kind="stable")[::-1].tolist() if sizes[k] >= max(least_px, 1)][:most]
    chosen.reverse()
    labels = np.full((*size, LAYERS), -1, np.int64)
    areas: list[int] = []
    for shape in (bordered(np.asarray(shapes[k], np.bool_)) for k in chosen):
        rows, columns = np.nonzero(shape)
        free = labels[rows, columns] < 0
        rows, columns, layer = (values[free.any(axis=1)] for values in (rows, columns, np.argmax(free, axis=1)))
        labels[rows, columns, layer] = len(areas)
        areas.append(len(rows))
    return ImageMasks(labels, np.array(areas, np.int64))


def bordered(shape: Bool) -> Bool:
    """Return a mask (H, W), of a large one only the band along its border, that of the image not counted."""
    import cv2

    share = float(shape.mean())
    if share < 0.02:
        return shape
    width = 2 * int(30 + 1 / share) + 3
    inner = cv2.erode(shape.astype(np.uint8), np.ones((width, width), np.uint8), borderValue=1)
    return np.asarray(shape & (inner == 0))


def parts_of(labels: Int) -> list[Bool]:
    """Return a mask (H, W) for each number of a label image (H, W) that is not negative."""
    return [labels == number for number in np.unique(labels[labels >= 0])]


def read_masks(folder: str, name: str, shape: tuple[int, int]) -> list[Bool]:
    """Return the masks (H, W) of the frame `name` in a folder: one file per frame, or a folder with one PNG per mask.

    `FOLDER/NAME.png` is a label image, 8 or 16 bit grey with 0 for no mask, or RGB with black for none;
    `FOLDER/NAME/*.png` are masks, whose pixels above half of the largest value are set. NAME is that of the frame, or
    the same with every character that a file name cannot have replaced by `_` (2011_09_26_0005_0000000010).

    Masks of the original image are downsampled to the size of a smaller one. Raises InputError if there is neither, and
    if a mask has the size of another image.
    """
    root = existing_folder(Path(folder), "masks")
    for stem in dict.fromkeys((name, folder_name(name))):
        one, many = root / f"{stem}.png", root / stem
        if one.exists():
            return parts_of(_numbered(_mask_image(one, shape)))
        if many.is_dir():
            images = [_mask_image(file, shape) for file in sorted(many.glob("*.png"))]
            return [_numbered(each) >= 0 if each.ndim == 3 else each > each.max(initial=1) / 2 for each in images]
    raise p2o.InputError(
        "there are no masks of this frame",
        where=root,
        expected=f"{folder_name(name)}.png, or a folder {folder_name(name)} of one PNG a mask",
        got="neither",
    )


def _numbered(image: UInt8) -> Int:
    """Return the numbers (H, W) of a label image, -1 where it is 0 or black."""
    if image.ndim == 3:
        image = image.astype(np.int64) @ np.array([1, 1 << 16, 1 << 32])
    return image.astype(np.int64) - 1


def _mask_image(path: Path, shape: tuple[int, int]) -> UInt8:
    """Return the image (H, W) or (H, W, 3) of a file as it is written; one whose channels are equal is grey."""
    import cv2

    with naming(path):
        image = cv2.imdecode(np.frombuffer(read_bytes(path, "mask", MAX_BYTES), np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise p2o.InputError("the mask is no image", expected="a PNG file")
        image = image[..., :3] if image.ndim == 3 else image
        if image.ndim == 3 and (image == image[..., :1]).all():
            image = image[..., 0]
        if image.shape[:2] != shape and _is_larger(image.shape[:2], shape):
            # Images of long focal lengths are downsampled before a calibration, masks are of the original image.
            image = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_NEAREST)
        if image.shape[:2] != shape:
            size, got = (f"{width}x{height} px" for height, width in (shape, image.shape[:2]))
            raise p2o.InputError("the mask has another size than the image", expected=size, got=got)
    return np.asarray(image)


def _is_larger(size: tuple[int, int], shape: tuple[int, int]) -> bool:
    """Return whether an image (H, W) becomes one of another shape (H, W) by downsampling, up to half a pixel."""
    return size[0] > shape[0] and abs(size[1] * shape[0] / size[0] - shape[1]) <= 0.5 * (1 + shape[1] / shape[0])


_GRAPH_SIGMA_PX = 0.5  # width of the blur before the graph segments
_SUPERPIXEL_PX = 60  # size of a superpixel
_LEAST_SHARE = 1 / 1200  # least share of a mask, or 2000 px if that is less
_MOST = 255  # largest number of masks; the largest masks are kept
_GRAPH_SCALES = (100.0, 400.0, 1500.0)  # scales k of graph segments


class MasksOptions(p2o.Options):
    """Options of `masks`."""

    superpixels: Literal["none", "slic", "seeds"] = field("none", help="Superpixels that are used as further masks.")


def graph_segments(rgb: UInt8, scale: float, sigma_px: float, least_px: float) -> Int:
    """Return the label image (H, W) of the graph segments of an image (H, W, 3)."""
    import cv2

    segmenter = cv2.ximgproc.segmentation.createGraphSegmentation(sigma_px, scale, max(1, int(least_px)))
    return np.asarray(segmenter.processImage(np.ascontiguousarray(rgb[..., ::-1])), np.int64)


def superpixels(rgb: UInt8, kind: str, size_px: int) -> Int:
    """Return the label image (H, W) of the superpixels `slic` or `seeds` of an image (H, W, 3)."""
    import cv2

    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2Lab)
    height, width = lab.shape[:2]
    if kind == "slic":
        slic = cv2.ximgproc.createSuperpixelSLIC(lab, cv2.ximgproc.SLICO, size_px, 10.0)
        slic.iterate(10)
        slic.enforceLabelConnectivity(25)
        return np.asarray(slic.getLabels(), np.int64)
    seeds = cv2.ximgproc.createSuperpixelSEEDS(width, height, 3, max(2, round(height * width / size_px**2)), 4)
    seeds.iterate(lab, 10)
    return np.asarray(seeds.getLabels(), np.int64)


def build(options: MasksOptions) -> p2o.ImageExtractor:
    """Return the extractor."""

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        least_px = min(_LEAST_SHARE * image.grey.size, 2000)
        layers = [graph_segments(image.rgb, k, _GRAPH_SIGMA_PX, least_px) for k in _GRAPH_SCALES]
        if options.superpixels != "none":
            layers.append(superpixels(image.rgb, options.superpixels, _SUPERPIXEL_PX))
        regions = (shape for layer in layers for shape in parts_of(layer))
        # A single mask of the whole image contains no information.
        shapes = [shape for shape in regions if not shape.all()]
        return p2o.ImageFeatures(features=[masks_of(shapes, image.grey.shape, _MOST, least_px)])

    return extract


METHOD = p2o.Method(
    name="masks",
    build=build,
    options=MasksOptions,
    summary="Graph segments at several scales, and superpixels, as masks of the image.",
    gives={"image-masks"},
    cite="Felzenszwalb and Huttenlocher, Efficient graph-based image segmentation, IJCV 2004",
)
