"""Random training crops of examples: scaled, mirrored, with changed colours and blur, and consistent labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from kornia.enhance import (
    adjust_contrast_with_mean_subtraction,
    adjust_gamma,
    adjust_saturation_with_gray_subtraction,
)
from numpy.typing import NDArray
from p2o import Float, Int, Int8, UInt8

from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.options import Augmentation
from p2o_plugins.p2ornet.spans import EAST, SOUTH, Spans

LONGEST = 14
"""Longer spans do not localise an edge and are dropped."""


@dataclass(frozen=True, eq=False)
class Crop:
    """`rgb` (h, w, 3) uint8; `classes` (2, h, w) int8, UNKNOWN if unknown; spans with one occlusion (n, K).

    `bags` are flat indices into (2, h, w), -1 beyond the end of a span; `bag_class` (n,) 0 or 2, `bag_weight` (n,).
    """

    rgb: UInt8
    classes: Int8
    bags: Int
    bag_class: Int
    bag_weight: Float


def crop(example: Example, size: tuple[int, int], options: Augmentation, rng: np.random.Generator) -> Crop:
    """Return a random crop of `size` (h, w) px; parts of it beyond the image repeat its border and are unknown."""
    height, width = size
    scale = float(np.exp(rng.uniform(-1, 1) * np.log(options.scale)))
    shift = [
        float(rng.uniform(min(0.0, scale * full - out), max(0.0, scale * full - out)))
        for full, out in zip(example.rgb.shape[1::-1], (width, height), strict=True)
    ]
    mirror = options.mirror and bool(rng.random() < 0.5)
    return cut(example, size, scale, (shift[0], shift[1]), mirror, lambda rgb: relit(rgb, options, rng))


def cut(
    example: Example,
    size: tuple[int, int],
    scale: float,
    shift: tuple[float, float],
    mirror: bool,
    lit: Callable[[UInt8], UInt8],
) -> Crop:
    """Return the crop with its upper left corner at `shift` (u, v) of the scaled image; `lit` changes colours."""
    height, width = size
    offset = [0.5 * scale - 0.5 - s for s in shift]
    source = example.rgb if scale > 0.85 else cv2.GaussianBlur(example.rgb, (0, 0), 0.45 / scale)
    matrix = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
    rgb = cv2.warpAffine(source, matrix, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    classes = np.full((2, height, width), UNKNOWN, np.int8)
    if example.classes is not None:
        for axis in (EAST, SOUTH):
            plane = example.classes[axis] if axis == EAST else example.classes[axis].T
            order = (0, 1) if axis == EAST else (1, 0)
            out = classes[axis] if axis == EAST else classes[axis].T
            _resampled(plane, out, scale, (shift[order[0]], shift[order[1]]))
    if mirror:
        rgb = np.ascontiguousarray(rgb[:, ::-1])
        classes = mirrored(classes)
    spans = example.spans.moved(scale, shift, width if mirror else None)
    bags, bag_class, bag_weight = draw(spans, classes)
    return Crop(lit(rgb), classes, bags, bag_class, bag_weight)


def mirrored(classes: Int8) -> Int8:
    """Return classes (2, H, W) of the image flipped left to right: a pair is stored at its left pixel."""
    out = np.full_like(classes, UNKNOWN)
    east = classes[EAST, :, -2::-1]
    out[EAST, :, :-1] = np.where(east == UNKNOWN, UNKNOWN, 2 - east)
    out[SOUTH] = classes[SOUTH, :, ::-1]
    return out


def _resampled(plane: Int8, out: Int8, scale: float, shift: tuple[float, float]) -> None:
    """Fill `out` with the pair classes of `plane`, both (lines, places), `shift` in (place, line) of the scaled plane.

    Occlusions are carried over one by one, so that they stay one pair thick at any scale.
    """
    lines = np.rint((np.arange(out.shape[0]) + shift[1] + 0.5) / scale - 0.5).astype(np.int64)
    places = np.rint((np.arange(out.shape[1]) + shift[0] + 0.5) / scale - 0.5).astype(np.int64)
    good_lines = np.flatnonzero((lines >= 0) & (lines < plane.shape[0]))
    good_places = np.flatnonzero((places >= 0) & (places < plane.shape[1] - 1))
    rows = plane[lines[good_lines]]
    base = rows[:, places[good_places]]
    out[np.ix_(good_lines, good_places)] = np.where(base == UNKNOWN, UNKNOWN, 1)
    line, place = np.nonzero((rows == 0) | (rows == 2))
    moved = np.floor(scale * (place + 1) - 0.5 - shift[0]).astype(np.int64)
    keep = (moved >= 0) & (moved < out.shape[1] - 1)
    out[good_lines[line[keep]], moved[keep]] = rows[line[keep], place[keep]]
    out[:, -1] = UNKNOWN  # these pairs leave the crop


def draw(spans: Spans, classes: Int8) -> tuple[Int, Int, Float]:
    """Draw spans without occlusions into `classes` (2, h, w), in place; return those with one as bags of pairs."""
    _, height, width = classes.shape
    rows = spans.rows
    axis: Int = rows["axis"].astype(np.int64)
    order: Int = rows["order"].astype(np.int64)
    line = np.rint(rows["line"]).astype(np.int64)
    first = np.ceil(rows["start"] - 0.5 - 1e-4).astype(np.int64)
    last = np.floor(rows["end"] - 0.5 + 1e-4).astype(np.int64)
    lines, places = np.array([height, width])[axis], np.array([width - 1, height - 1])[axis]
    keep = (line >= 0) & (line < lines) & (last >= first)
    smooth = keep & (order == 0)
    for a in (EAST, SOUTH):
        chosen = np.flatnonzero(smooth & (axis == a))
        begin, end = np.maximum(first[chosen], 0), np.minimum(last[chosen], places[chosen] - 1)
        count = np.maximum(end - begin + 1, 0)
        where = np.repeat(begin, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        on = np.repeat(line[chosen], count)
        (classes[a] if a == EAST else classes[a].T)[on, where] = 1
    chosen = np.flatnonzero(keep & (order != 0) & (first >= 0) & (last < places) & (last - first < LONGEST))
    along = first[chosen, None] + np.arange(LONGEST)
    inside = along <= last[chosen, None]
    along = np.minimum(along, last[chosen, None])
    on = line[chosen, None]
    v = np.where(axis[chosen, None] == EAST, on, along)
    u = np.where(axis[chosen, None] == EAST, along, on)
    flat = (axis[chosen, None] * height + v) * width + u
    # The pair is one of these: none of them is known to be smooth.
    classes.reshape(-1)[flat] = UNKNOWN
    return np.where(inside, flat, -1), order[chosen] + 1, rows["weight"][chosen].astype(np.float64)


@dataclass(frozen=True)
class Light:
    """Exposure and development of an image: gains of R, G and B, then the strength of colours, contrast and gamma.

    All ones leave an image unchanged.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    contrast: float = 1.0
    gamma: float = 1.0

    @classmethod
    def drawn(cls, strength: float, rng: np.random.Generator) -> Light:
        """Return a random light; the larger `strength`, the further from ones."""
        red, green, blue = np.exp(rng.normal(0, 0.3 * strength) + rng.normal(0, 0.08 * strength, 3)).tolist()
        return cls(
            gain=(red, green, blue),
            saturation=float(rng.uniform(1 - 0.6 * min(strength, 1.6), 1 + 0.4 * strength)),
            contrast=float(np.exp(rng.normal(0, 0.2 * strength))),
            gamma=float(np.exp(rng.normal(0, 0.15 * strength))),
        )

    def on(self, rgb: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the image (h, w, 3), 0..255, in this light; what is too bright for the sensor is white for good."""
        x = torch.from_numpy(rgb).permute(2, 0, 1) / 255
        x = (x * torch.tensor(self.gain)[:, None, None]).clamp(max=1)
        x = adjust_saturation_with_gray_subtraction(x, self.saturation)
        x = adjust_contrast_with_mean_subtraction(x, self.contrast)
        x = adjust_gamma(x, self.gamma)
        return np.ascontiguousarray(255 * x.permute(1, 2, 0).numpy())


def relit(rgb: UInt8, options: Augmentation, rng: np.random.Generator) -> UInt8:
    """Return the image with changed colours, blur and noise."""
    x: NDArray[np.float32] = rgb.astype(np.float32)
    if options.marks and rng.random() < 0.6:
        for _ in range(int(rng.integers(1, options.marks + 1))):
            x = _marked(x, rng)
    if options.light > 0:
        if rng.random() < 0.25:
            x = _shadowed(x, rng)
        x = Light.drawn(options.light, rng).on(x)
    if options.blur_px > 0 and rng.random() < 0.5:
        # kornia.filters.gaussian_blur2d gives the same to 0.002 grey levels, at up to 9 times the time.
        x = cv2.GaussianBlur(x, (0, 0), float(rng.uniform(0.1, max(options.blur_px, 0.11))))
    if options.noise > 0 and rng.random() < 0.5:
        x = x + np.float32(rng.uniform(0, options.noise)) * rng.standard_normal(x.shape, np.float32)
    return np.asarray(np.clip(x + 0.5, 0, 255), dtype=np.uint8)


def _marked(x: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Paint a line, a polygon, an ellipse, a word or a faint mirror image onto a part of the image."""
    height, width = x.shape[:2]
    size = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))) * height)
    u, v = (int(value) for value in rng.uniform((0, 0), (width, height)))
    mask = np.zeros((height, width), np.uint8)
    kind = int(rng.integers(5))
    if kind == 0:
        end = (int(u + 2 * size * rng.normal()), int(v + 2 * size * rng.normal()))
        cv2.line(mask, (u, v), end, 255, int(rng.integers(1, 9)), cv2.LINE_AA)
    elif kind == 1:
        corners = np.array([u, v]) + size * rng.normal(size=(int(rng.integers(3, 6)), 2))
        cv2.fillPoly(mask, [corners.astype(np.int32)], 255, cv2.LINE_AA)
    elif kind == 2:
        axes = (max(1, int(size)), max(1, int(size * rng.uniform(0.15, 1))))
        cv2.ellipse(mask, (u, v), axes, float(rng.uniform(0, 180)), 0, 360, 255, -1, cv2.LINE_AA)
    elif kind == 3:
        letters = "".join(chr(c) for c in rng.integers(33, 91, int(rng.integers(1, 7))))
        cv2.putText(mask, letters, (u, v), 0, size / 40, 255, max(1, int(size / 25)), cv2.LINE_AA)
    else:
        mask[v : v + int(size), u : u + int(2 * size)] = 255
    cover = mask.astype(np.float32) / 255
    if rng.random() < 0.4:
        cover = cv2.GaussianBlur(cover, (0, 0), float(rng.uniform(0.4, 0.1 * size + 0.5)))
    strength = cover[..., None] * np.float32(rng.uniform(0.15, 1.0))
    paint = x[::-1] if kind == 4 else rng.uniform(0, 255, 3).astype(np.float32)
    return np.asarray(x + strength * (paint - x), dtype=np.float32)


def _shadowed(x: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Darken a random polygon: its outline is an edge of light, not of depth."""
    height, width = x.shape[:2]
    corners = rng.uniform(-0.2, 1.2, (int(rng.integers(3, 7)), 2)) * (width, height)
    mask = np.zeros((height, width), np.float32)
    cv2.fillPoly(mask, [corners.astype(np.int32)], 1.0)
    if rng.random() < 0.5:
        mask = cv2.GaussianBlur(mask, (0, 0), float(rng.uniform(0.5, 4)))
    return np.asarray(x * (1 - mask[..., None] * np.float32(rng.uniform(0.25, 0.7))), dtype=np.float32)
