"""A picture of what an example teaches: `p2o labels --draw`."""

from __future__ import annotations

import numpy as np
from p2o import Side
from p2o.arrays import Int, UInt8

from p2o_plugins.p2ornet.example import Example
from p2o_plugins.p2ornet.spans import AXIS, EAST, ORDER, Spans

COLOURS = {
    Side.LEFT: (40, 220, 60),
    Side.RIGHT: (255, 60, 50),
    Side.UPPER: (255, 225, 40),
    Side.BOTTOM: (70, 130, 255),
}
"""RGB by direction, as in all pictures of p2o: L green, R red, U yellow, B blue."""
_NONE = np.array((0, 200, 200))
_FAINT = 0.3


def drawn(example: Example) -> UInt8:
    """Return the picture (H, W, 3), dimmed, with its labels: foreground pixels of known pairs, stretches as lines.

    Stretches without an occlusion are a faint cyan; those that hold one have the colour of its direction.
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
    """Return rows v and columns u of the pixels on stretches, as far as they lie in a picture of `size` (h, w)."""
    rows = spans.rows
    first = np.ceil(rows["start"] - 0.5).astype(np.int64)
    count = np.maximum(np.floor(rows["end"] + 0.5).astype(np.int64) - first + 1, 0)
    along = np.repeat(first, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    line = np.repeat(np.rint(rows["line"]).astype(np.int64), count)
    east = np.repeat(rows["axis"] == EAST, count)
    v, u = np.where(east, line, along), np.where(east, along, line)
    inside = (v >= 0) & (u >= 0) & (v < size[0]) & (u < size[1])
    return v[inside], u[inside]
