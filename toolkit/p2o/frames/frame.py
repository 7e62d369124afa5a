"""One image with its sweep and their metadata, and types of calibration targets; their poses are unknown."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, overload, runtime_checkable

import numpy as np

from p2o.arrays import Float, checked
from p2o.errors import InputError, UnknownNameError, printable
from p2o.frames.cloud import Cloud
from p2o.frames.image import Image
from p2o.geometry import se3
from p2o.geometry.camera import Camera


@dataclass(frozen=True)
class Checkerboard:
    """A flat board with a chessboard pattern in its centre.

    `columns` x `rows` inner corners, squares of `square_m`; the board is `width_m` x `height_m`. Board frame: origin in
    the centre of the pattern, x along a row of corners, y down a column, z = 0 on the front.
    """

    columns: int
    rows: int
    square_m: float
    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        _require_size("checkerboard", self.square_m, self.width_m, self.height_m)
        if min(self.columns, self.rows) < 2:
            message = "the checkerboard has too few inner corners"
            raise InputError(message, expected=">= 2 x 2", got=f"{self.columns} x {self.rows}")
        if self.width_m < (self.columns - 1) * self.square_m or self.height_m < (self.rows - 1) * self.square_m:
            text = "the checkerboard is smaller than its pattern"
            expected = f">= {(self.columns - 1) * self.square_m:g} x {(self.rows - 1) * self.square_m:g} m"
            raise InputError(text, expected=expected, got=f"{self.width_m:g} x {self.height_m:g} m")

    @property
    def corners(self) -> Float:
        """Inner corners (columns * rows, 3) m in the board frame, row by row, in the order of OpenCV's detectors."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.square_m
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.square_m
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.column_stack([grid, np.zeros(len(grid))])

    @property
    def outline(self) -> Float:
        """The four corners (4, 3) m of the board, in cyclic order."""
        return _outline(self.width_m, self.height_m)


@dataclass(frozen=True)
class HoleBoard:
    """A flat board with round holes: `holes` are (x, y, radius) m in the board frame (origin in its centre, y down)."""

    width_m: float
    height_m: float
    holes: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        _require_size("hole board", self.width_m, self.height_m)
        holes = checked("holes of the board", np.reshape(self.holes, (-1, 3)), (None, 3), np.float64)
        object.__setattr__(self, "holes", tuple((float(x), float(y), float(r)) for x, y, r in holes))
        if not len(holes) or (holes[:, 2] <= 0).any():
            text = "a hole board needs holes with a positive radius"
            raise InputError(text, expected="at least one, radius > 0", got=self.holes)
        reach = np.abs(holes[:, :2]) + holes[:, 2:]
        if (reach > np.array([self.width_m, self.height_m]) / 2).any():
            expected = f"inside {self.width_m:g} x {self.height_m:g} m"
            raise InputError("a hole extends beyond its board", expected=expected)

    @property
    def centres(self) -> Float:
        """Centres (N, 3) m of the holes in the board frame."""
        return np.array([(x, y, 0.0) for x, y, _ in self.holes])

    @property
    def outline(self) -> Float:
        """The four corners (4, 3) m of the board, in cyclic order."""
        return _outline(self.width_m, self.height_m)


@dataclass(frozen=True)
class Sphere:
    """A sphere of `radius_m`; the origin of its frame is the centre."""

    radius_m: float

    def __post_init__(self) -> None:
        _require_size("sphere", self.radius_m)

    @property
    def outline(self) -> Float:
        """The eight corners (8, 3) m of the bounding cube."""
        return _corners(self.radius_m, self.radius_m, self.radius_m)


@dataclass(frozen=True)
class Box:
    """A cuboid: `width_m` along x, `height_m` along y, `depth_m` along z of its frame, whose origin is the centre.

    It is symmetric under rotations by 180 deg about these axes, with more symmetries if two sizes are equal.
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


_LONGEST_CAMERA = 100
_GAP = re.compile(r"[\s,]")


@dataclass(frozen=True, eq=False)
class Frame:
    """One image with the sweep recorded at the same time.

    `camera_from_lidar` (4, 4) is the ground truth of the extrinsic, `start` (4, 4) an initial guess of the dataset
    (such as a mechanical drawing). `twist` (6,) is the velocity of the LiDAR in its own frame (rad/s, then m/s). All
    three are None if unknown. `warnings` are remarks of the reader, which become part of the result; `advice` are
    remarks that become part of a result only if it is not trusted: what else the data could mean. `sequence` is the
    name of the drive, empty for a single frame; `time_s` is the time of the image on a clock of the sequence.
    `lidar_world_from_lidar` and `camera_world_from_camera` (4, 4) are the poses of the sensors at that time, if known,
    in two world frames whose relation is unknown: the extrinsic is observable from their motions (hand-eye), not from a
    single pair of poses. `targets` are the types of the calibration targets in view, without their poses. `sweep` is
    the frame's own sweep if `cloud` is accumulated. `camera_name` is the name of the camera on its rig ("CAM_FRONT"),
    empty for a single camera. `unused_fields` names the fields of the points that the reader did not use. Raises
    InputError for poses that are not rigid, a twist or time that is not finite, other types of targets, and an invalid
    `camera_name`.
    """

    name: str
    image: Image
    cloud: Cloud
    camera_from_lidar: Float | None = None
    start: Float | None = None
    twist: Float | None = None
    warnings: tuple[str, ...] = ()
    sequence: str = ""
    time_s: float | None = None
    lidar_world_from_lidar: Float | None = None
    camera_world_from_camera: Float | None = None
    targets: tuple[Target, ...] = ()
    sweep: Cloud | None = None
    camera_name: str = ""
    advice: tuple[str, ...] = ()
    unused_fields: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("camera_from_lidar", "start", "lidar_world_from_lidar", "camera_world_from_camera"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, se3.check_rigid(name, getattr(self, name), where=self.name))
        if self.twist is not None:
            object.__setattr__(self, "twist", checked("twist", self.twist, (6,), np.float64))
        if self.time_s is not None:
            object.__setattr__(self, "time_s", float(checked("time_s", [self.time_s], (1,), np.float64)[0]))
        if self.camera_name:
            check_camera_name(self.camera_name, where=self.name)
        object.__setattr__(self, "targets", tuple(self.targets))
        invalid = [target for target in self.targets if not isinstance(target, Target)]
        if invalid:
            expected = "Checkerboard, HoleBoard, Sphere or Box"
            raise InputError("expected a target", where=self.name, expected=expected, got=type(invalid[0]).__name__)

    @property
    def camera(self) -> Camera:
        """The camera of the image."""
        return self.image.camera

    def without_truth(self) -> Frame:
        """Return the frame without ground truth, as input of stages."""
        return replace(self, camera_from_lidar=None)


def check_camera_name(name: object, *, where: object = None) -> str:
    """Return the name of a camera; raises InputError unless it is a printable word."""
    if isinstance(name, str) and 0 < len(name) <= _LONGEST_CAMERA and printable(name) == name and not _GAP.search(name):
        return name
    expected = f"1 to {_LONGEST_CAMERA} characters without blanks and commas, such as CAM_FRONT"
    raise InputError("the name of a camera is not valid", where=where, expected=expected, got=repr(name)[:80])


@runtime_checkable
class Dataset(Protocol):
    """A sequence of frames that are read on access; `names` are known without reading them."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all frames, in order (KITTI raw: date/drive/frame)."""
        ...

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...


@dataclass(frozen=True, eq=False)
class LazyFrames(Sequence[Frame]):
    """Frames that are read one by one with `read(entry)`; `entries` maps names, in order, to the argument of `read`.

    `skipped` maps names of excluded frames to the reason, which names the missing file. Slices are lazy, too.
    `identify(entry)` returns everything that determines a computed frame as JSON.
    """

    entries: Mapping[str, Any]
    read: Callable[[Any], Frame]
    skipped: Mapping[str, str] = field(default_factory=dict)
    identify: Callable[[Any], Any] | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, in order."""
        return tuple(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> LazyFrames: ...
    def __getitem__(self, index: int | slice) -> Frame | LazyFrames:
        names = self.names[index]
        if isinstance(names, str):
            return self.read(self.entries[names])
        return replace(self, entries={name: self.entries[name] for name in names})

    def identity(self, index: int) -> Any:
        """Return everything that determines a computed frame (JSON), None without `identify`."""
        return None if self.identify is None else self.identify(self.entries[self.names[index]])

    def frame(self, name: str) -> Frame:
        """Return the frame of a name.

        Raises InputError with the missing file for an excluded frame, UnknownNameError for any other name.
        """
        if name in self.entries:
            return self.read(self.entries[name])
        if name in self.skipped:
            raise InputError(f"frame '{name}' is left out", got=self.skipped[name])
        raise UnknownNameError("frame", name, self.names)
