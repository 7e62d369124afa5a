"""Masks of an image as a feature: which of them cover each pixel, and where they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import p2o
from p2o.arrays import Bool, Int, UInt8, checked
from p2o.files.file_names import folder_name
from p2o.files.input_file import existing_folder, naming, read_bytes

LAYERS = 4
"""Masks that may cover one pixel, as in the released code of CalibAnything."""


@dataclass(frozen=True, eq=False)
class ImageMasks(p2o.ImageFeature):
    """Masks of one image: `labels` (H, W, L) numbers of up to L masks that cover a pixel, -1 for none.

    `area_px` (M,) is how many pixels each mask covers.
    """

    word: ClassVar[str] = "image-masks"

    labels: Int
    area_px: Int

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked("labels of the masks", self.labels, (None, None, None), np.int64))
        object.__setattr__(self, "area_px", checked("areas of the masks", self.area_px, (None,), np.int64))

    def __len__(self) -> int:
        return len(self.area_px)


def masks_of(shapes: Sequence[Bool], size: tuple[int, int], most: int, least_px: float) -> ImageMasks:
    """Return the `most` largest of masks of a `size` (H, W) of at least `least_px` pixels, which may be none.

    Of a mask that covers more than 2 % of the image only a band of 30 px + 1 / share inside of its border counts, as
    in the released code of CalibAnything. A pixel is told of `LAYERS` masks at most, the smallest ones first.
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
    """Return the masks (H, W) of the frame `name` in a folder: one file a frame, or a folder of one PNG a mask.

    `FOLDER/NAME.png` is a label image, 8 or 16 bit grey with 0 for no mask, or of three colours with black for none;
    `FOLDER/NAME/*.png` are masks, of which pixels above half of the largest value count. NAME is that of the frame, or
    the same with every sign that a file name cannot have replaced by `_` (2011_09_26_0005_0000000010).

    Raises InputError where there is neither, and where a picture has another size than the image.
    """
    root = existing_folder(Path(folder), "masks")
    for stem in dict.fromkeys((name, folder_name(name))):
        one, many = root / f"{stem}.png", root / stem
        if one.exists():
            return parts_of(_numbered(_picture(one, shape)))
        if many.is_dir():
            files = sorted(many.glob("*.png"))
            pictures = [_picture(file, shape) for file in files]
            return [_numbered(picture) >= 0 if picture.ndim == 3 else _upper_half(picture) for picture in pictures]
    raise p2o.InputError(
        "there are no masks of this frame",
        where=root,
        expected=f"{folder_name(name)}.png, or a folder {folder_name(name)} of one PNG a mask",
        got="neither",
    )


def _upper_half(picture: UInt8) -> Bool:
    return np.asarray(picture > picture.max(initial=1) / 2)


def _numbered(picture: UInt8) -> Int:
    """Return the numbers (H, W) of a label image, -1 where it is 0 or black."""
    if picture.ndim == 3:
        picture = picture.astype(np.int64) @ np.array([1, 1 << 16, 1 << 32])
    return picture.astype(np.int64) - 1


def _picture(path: Path, shape: tuple[int, int]) -> UInt8:
    """Return the picture (H, W) or (H, W, 3) of a file as it is written; one whose channels are equal is grey."""
    import cv2

    with naming(path):
        picture = cv2.imdecode(np.frombuffer(read_bytes(path, "mask"), np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise p2o.InputError("the mask is no picture", expected="a PNG file")
        picture = picture[..., :3] if picture.ndim == 3 else picture
        if picture.ndim == 3 and (picture == picture[..., :1]).all():
            picture = picture[..., 0]
        if picture.shape[:2] != shape:
            size = f"{shape[1]}x{shape[0]} px"
            got = f"{picture.shape[1]}x{picture.shape[0]} px"
            raise p2o.InputError("the mask has another size than the image", expected=size, got=got)
    return np.asarray(picture)
