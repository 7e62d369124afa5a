"""One training example: an image with the known occlusion orders of its pixels, and its drawing."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from p2o import Frame, InputError, Int, Int8, Side, UInt8, occlusion
from p2o.reading import MAX_BYTES, read_bytes, read_npz, write_whole
from p2o.solving import image_at_scale

from p2o_plugins.p2ornet.spans import AXIS, EAST, ORDER, Spans, classes_of, depth_spans, lidar_spans

UNKNOWN = -1
"""The class of unlabelled pairs, which are ignored."""
DENSE = 0.9
"""From this share of known pixels on a depth map is dense, and the occlusion rule decides every pair."""
RAW_SPEED_M_S = 10.0
"""Assumed speed of a car whose sweeps have times per point and were not corrected for ego-motion."""

COLOURS = {
    Side.LEFT: (40, 220, 60),
    Side.RIGHT: (255, 60, 50),
    Side.UPPER: (255, 225, 40),
    Side.BOTTOM: (70, 130, 255),
}
"""RGB by direction, as in all images of p2o: L green, R red, U yellow, B blue."""
_NONE = np.array((0, 200, 200))
_FAINT = 0.3


@dataclass(frozen=True, eq=False)
class Example:
    """`rgb` (H, W, 3) uint8; `classes` (2, H, W) int8 of the east and south pairs, UNKNOWN if unlabelled.

    `spans` are labels of spans of pairs. `name` is the frame.
    """

    name: str
    rgb: UInt8
    classes: Int8 | None
    spans: Spans

    def save(self, path: Path) -> None:
        """Write the example as .npz without pickled objects."""
        write_whole(path, self.packed())

    def packed(self) -> bytes:
        """Return the content of the file that `save` writes."""
        classes = np.zeros((0, 0, 0), np.int8) if self.classes is None else self.classes
        file = io.BytesIO()
        np.savez(file, name=self.name, rgb=self.rgb, classes=classes, spans=self.spans.rows)
        return file.getvalue()

    @classmethod
    def load(cls, path: Path) -> Example:
        """Return an example that `save` wrote; raises InputError if the file is something else."""
        try:
            file = read_npz(read_bytes(path, "file of labels", MAX_BYTES), path)
            name, rgb, classes, rows = str(file["name"]), file["rgb"], file["classes"], file["spans"]
            if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
                raise ValueError(f"rgb {rgb.dtype} {rgb.shape}")
            if classes.dtype != np.int8 or (classes.size and classes.shape != (2, *rgb.shape[:2])):
                raise ValueError(f"classes {classes.dtype} {classes.shape}")
            if rows.dtype != Spans.joined().rows.dtype or rows.ndim != 1:
                raise ValueError(f"spans {rows.dtype} {rows.shape}")
            return cls(name, rgb, classes if classes.size else None, Spans(rows))
        except (ValueError, KeyError, InputError) as problem:
            got = problem.what if isinstance(problem, InputError) else problem
            raise InputError(
                "a label file cannot be read", where=path, expected="a file written by p2o labels", got=got
            ) from problem


def example_of(frame: Frame) -> Example:
    """Return the labels of a frame.

    With dense depth (simulation, Virtual KITTI 2) the occlusion rule labels every pair; pairs whose occluding pixel is
    masked are unknown. Otherwise the labels follow from the sweep at the true extrinsic, and from sparse depth if
    available. Images with long focal lengths are downsampled as in a calibration. Raises InputError if the frame has
    neither.
    """
    image = image_at_scale(frame.image)
    depth = image.depth_m
    if depth is not None and np.mean(~np.isnan(depth)) > DENSE:
        orders = occlusion.occlusion_orders(depth, image.camera)
        classes = classes_of(np.stack([orders.east, orders.south]))
        if image.masked is not None:
            kept = occlusion.occlusion_orders(depth, image.camera, masked=image.masked)
            classes[classes != classes_of(np.stack([kept.east, kept.south]))] = UNKNOWN
        classes[0, :, -1] = UNKNOWN
        classes[1, -1] = UNKNOWN
        return Example(frame.name, image.rgb, classes, Spans.joined())
    parts = []
    if frame.camera_from_lidar is not None:
        # As in a calibration: points without times come from a sweep that was corrected, or was taken at rest.
        speed = RAW_SPEED_M_S if frame.cloud.time_s is not None and frame.twist is None else 0.0
        parts.append(lidar_spans(frame.cloud, image.camera, frame.camera_from_lidar, speed_m_s=speed))
    if depth is not None:
        parts.append(depth_spans(depth))
    if not parts:
        expected = "a dense depth map, or a true extrinsic"
        raise InputError("the frame cannot be used for training", where=frame.name, expected=expected, got="neither")
    return Example(frame.name, image.rgb, None, Spans.joined(*parts))


def drawn(example: Example) -> UInt8:
    """Return the dimmed image (H, W, 3) with its labels: foreground pixels of labelled pairs, spans as lines.

    Spans without an occlusion are a faint cyan; those with one have the colour of its direction.
    """
    rgb = example.rgb.astype(np.float64)
    canvas = 0.5 * (0.75 * rgb.mean(axis=2, keepdims=True) + 0.25 * rgb)
    rows = example.spans.rows
    v, u = _pixels(Spans(rows[rows["order"] == 0]), canvas.shape[:2])
    canvas[v, u] = (1 - _FAINT) * canvas[v, u] + _FAINT * _NONE
    for side, colour in COLOURS.items():
        axis, order = AXIS[side], ORDER[side]
        v, u = _pixels(Spans(rows[(rows["axis"] == axis) & (rows["order"] == order)]), canvas.shape[:2])
        canvas[v, u] = colour
        if example.classes is not None:
            v, u = np.nonzero(example.classes[axis] == order + 1)
            # A pair is stored at its first pixel; of a left or upper outline the second one is in front.
            ahead = int(order < 0)
            v, u = (v, u + ahead) if axis == EAST else (v + ahead, u)
            canvas[v, u] = colour
    return np.asarray(np.rint(canvas), dtype=np.uint8)


def _pixels(spans: Spans, size: tuple[int, int]) -> tuple[Int, Int]:
    """Return rows v and columns u of the pixels on spans that lie in an image of `size` (h, w)."""
    rows = spans.rows
    first = np.ceil(rows["start"] - 0.5).astype(np.int64)
    count = np.maximum(np.floor(rows["end"] + 0.5).astype(np.int64) - first + 1, 0)
    along = np.repeat(first, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    line = np.repeat(np.rint(rows["line"]).astype(np.int64), count)
    east = np.repeat(rows["axis"] == EAST, count)
    v, u = np.where(east, line, along), np.where(east, along, line)
    inside = (v >= 0) & (u >= 0) & (v < size[0]) & (u < size[1])
    return v[inside], u[inside]
