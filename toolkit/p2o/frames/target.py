"""Calibration targets that a frame shows: what they are, never where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float, checked
from p2o.errors import InputError


@dataclass(frozen=True)
class Checkerboard:
    """A flat board with a chessboard pattern in its middle.

    `columns` x `rows` inner corners, squares of `square_m`; the board itself is `width_m` x `height_m`. Board frame:
    origin in the middle of the pattern, x along a row of corners, y down a column, z = 0 on the front.
    """

    columns: int
    rows: int
    square_m: float
    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        _require_size("checkerboard", self.square_m, self.width_m, self.height_m)
        if min(self.columns, self.rows) < 2:
            raise InputError(
                "the checkerboard has too few inner corners", expected=">= 2 x 2", got=f"{self.columns} x {self.rows}"
            )
        if self.width_m < (self.columns - 1) * self.square_m or self.height_m < (self.rows - 1) * self.square_m:
            raise InputError(
                "the checkerboard is smaller than its pattern",
                expected=f">= {(self.columns - 1) * self.square_m:g} x {(self.rows - 1) * self.square_m:g} m",
                got=f"{self.width_m:g} x {self.height_m:g} m",
            )

    @property
    def corners(self) -> Float:
        """Inner corners (columns * rows, 3) m in the board frame, row by row, as OpenCV's detectors give them."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.square_m
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.square_m
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    @property
    def outline(self) -> Float:
        """The four corners (4, 3) m of the board itself, in turn."""
        return _outline(self.width_m, self.height_m)


@dataclass(frozen=True)
class HoleBoard:
    """A flat board with round holes: `holes` are (x, y, radius) m in the board frame (origin in its middle, y down)."""

    width_m: float
    height_m: float
    holes: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        _require_size("hole board", self.width_m, self.height_m)
        holes = checked("holes of the board", np.reshape(self.holes, (-1, 3)), (None, 3), np.float64)
        object.__setattr__(self, "holes", tuple((float(x), float(y), float(r)) for x, y, r in holes))
        if not len(holes) or (holes[:, 2] <= 0).any():
            raise InputError("a hole board has holes of some size", expected="at least one, radius > 0", got=self.holes)
        reach = np.abs(holes[:, :2]) + holes[:, 2:]
        if (reach > np.array([self.width_m, self.height_m]) / 2).any():
            raise InputError(
                "a hole reaches beyond its board", expected=f"inside {self.width_m:g} x {self.height_m:g} m"
            )

    @property
    def centres(self) -> Float:
        """Centres (N, 3) m of the holes in the board frame."""
        return np.array([(x, y, 0.0) for x, y, _ in self.holes])

    @property
    def outline(self) -> Float:
        """The four corners (4, 3) m of the board itself, in turn."""
        return _outline(self.width_m, self.height_m)


@dataclass(frozen=True)
class Sphere:
    """A ball of `radius_m`; its frame has the origin in the middle."""

    radius_m: float

    def __post_init__(self) -> None:
        _require_size("sphere", self.radius_m)

    @property
    def outline(self) -> Float:
        """The eight corners (8, 3) m of the cube around it."""
        return _corners(self.radius_m, self.radius_m, self.radius_m)


@dataclass(frozen=True)
class Box:
    """A cuboid: `width_m` along x, `height_m` along y, `depth_m` along z of its frame, whose origin is in the middle.

    Half turns about these axes leave it as it is; where two sizes are equal so do more.
    """

    width_m: float
    height_m: float
    depth_m: float

    def __post_init__(self) -> None:
        _require_size("box", self.width_m, self.height_m, self.depth_m)

    @property
    def size_m(self) -> Float:
        """Width, height and depth (3,) m."""
        return np.array([self.width_m, self.height_m, self.depth_m])

    @property
    def outline(self) -> Float:
        """The eight corners (8, 3) m; corner i lies at +x where bit 0 of i is set, at +y for bit 1, at +z for bit 2."""
        return _corners(self.width_m / 2, self.height_m / 2, self.depth_m / 2)


Target = Checkerboard | HoleBoard | Sphere | Box


def _corners(x: float, y: float, z: float) -> Float:
    signs = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) * 2.0 - 1.0
    return np.asarray(signs * [x, y, z])


def _outline(width_m: float, height_m: float) -> Float:
    x, y = width_m / 2, height_m / 2
    return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])


def _require_size(kind: str, *sizes_m: float) -> None:
    if not (np.isfinite(sizes_m).all() and min(sizes_m) > 0):
        raise InputError(f"a size of the {kind} is not positive", expected="metres > 0", got=min(sizes_m))
