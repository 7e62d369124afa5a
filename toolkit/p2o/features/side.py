"""The direction of an occlusion edge: the side of the foreground object on which the background is."""

from __future__ import annotations

from enum import IntEnum


class Side(IntEnum):
    """The side of the foreground object on which its background lies (paper Sec. III-A; docs/conventions.md).

    Image axes: u to the right, v down. NONE marks edges without a direction (Canny).
    """

    NONE = -1
    LEFT = 0
    RIGHT = 1
    UPPER = 2
    BOTTOM = 3

    @property
    def letter(self) -> str:
        """L, R, U or B as in the paper; '-' for NONE."""
        return "-LRUB"[self + 1]

    @property
    def background(self) -> tuple[int, int]:
        """Unit step (du, dv) in pixels from the foreground to the background."""
        return ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))[self + 1]

    @property
    def mirrored(self) -> Side:
        """The side after a horizontal flip of the image: left and right change places."""
        return {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT}.get(self, self)


SIDES = (Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM)
"""The four directions in the order of their numbers."""
