"""Directed occlusion edges of the image and of the sweep: the kinds of features that P2O-Calib matches."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.spatial import cKDTree

from p2o.arrays import Bool, Float, Int8, checked
from p2o.errors import InputError
from p2o.features.feature import CloudFeature, ImageFeature
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.geometry.motion import moved

_SIDE_NUMBERS = [int(side) for side in Side]


def _check_side(name: str, side: Any, count: int) -> Int8:
    # Checked before the cast to int8, which would convert 256 and 0.7 to L.
    raw: Float = checked(name, side, (count,), np.float64)
    unknown = raw[~np.isin(raw, _SIDE_NUMBERS)]
    if len(unknown):
        got = " ".join(f"{v:g}" for v in np.unique(unknown)[:5])
        raise InputError(f"{name} contains an unknown direction", expected="-1 (none), 0 L, 1 R, 2 U, 3 B", got=got)
    array: Int8 = checked(name, side, (count,), np.int8)
    return array


def _check_weight(name: str, weight: Any, count: int) -> Float:
    array: Float = checked(name, np.ones(count) if weight is None else weight, (count,), np.float64)
    if len(array) and array.min() < 0:
        raise InputError(f"{name} is negative", expected="weights >= 0", got=f"{array.min():g}")
    return array


@dataclass(frozen=True, eq=False)
class ImageEdges(ImageFeature):
    """Occlusion edges of one image: `uv` (N, 2) px on the foreground side, `side` (N,) int8, `weight` (N,) >= 0.

    `weight` is the confidence of an edge point, 1 where the extractor has none. Search structures are built on first
    use and cached. Raises InputError for wrong shapes, unknown sides, negative or non-finite values.
    """

    word: ClassVar[str] = "image-edges"

    uv: Float
    side: Int8
    weight: Float = field(default=None)  # type: ignore[arg-type]  # filled in below

    def __post_init__(self) -> None:
        object.__setattr__(self, "uv", checked("uv of the image edges", self.uv, (None, 2), np.float64))
        object.__setattr__(self, "side", _check_side("side of the image edges", self.side, len(self.uv)))
        object.__setattr__(self, "weight", _check_weight("weight of the image edges", self.weight, len(self.uv)))

    def __len__(self) -> int:
        return len(self.uv)

    @classmethod
    def empty(cls) -> ImageEdges:
        """Return an empty set of edges."""
        return cls(np.zeros((0, 2)), np.zeros(0, np.int8))

    @cached_property
    def sides(self) -> tuple[Side, ...]:
        """The directions that occur, including NONE, in the order of their numbers."""
        return tuple(Side(int(s)) for s in np.unique(self.side))

    @cached_property
    def index(self) -> dict[Side, Any]:
        """Indices of the edges of each occurring direction."""
        return {s: np.flatnonzero(self.side == s) for s in self.sides}

    @cached_property
    def trees(self) -> dict[Side, cKDTree]:
        """A KD-tree over the pixels of each occurring direction; rows as in `index`."""
        # Splitting cells at the middle instead of the median halves the construction time at equal search time.
        return {s: cKDTree(self.uv[rows], balanced_tree=False, compact_nodes=False) for s, rows in self.index.items()}

    def without_sides(self) -> ImageEdges:
        """Return the same edges without directions (NONE)."""
        return replace(self, side=np.full(len(self), Side.NONE, np.int8))

    def select(self, keep: Bool) -> ImageEdges:
        """Return the edges of a mask or index."""
        return ImageEdges(self.uv[keep], self.side[keep], self.weight[keep])


@dataclass(frozen=True, eq=False)
class CloudEdges(CloudFeature):
    """Occlusion edges of one sweep: `xyz` (M, 3) m in the LiDAR frame, on the nearer surface, `side` (M,) int8.

    `sigma_m` (M,) is the standard deviation in metres of the position across the edge (uniform over half the gap to
    the next beam: gap / sqrt(12)); `weight` (M,) >= 0 is the confidence. `background` (M, 3) are unit directions in the
    LiDAR frame from the edge towards its background, zero where unknown; they determine the side for any orientation
    of the sensors (`View.as_seen_from`). `time_s` (M,) is the time of an edge of a raw sweep relative to the image; 0
    without times and for motion-compensated sweeps.
    """

    word: ClassVar[str] = "cloud-edges"

    xyz: Float
    side: Int8
    weight: Float = field(default=None)  # type: ignore[arg-type]  # filled in below
    sigma_m: Float = field(default=None)  # type: ignore[arg-type]
    background: Float = field(default=None)  # type: ignore[arg-type]
    time_s: Float = field(default=None)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("xyz of the cloud edges", self.xyz, (None, 3), np.float64))
        count = len(self.xyz)
        object.__setattr__(self, "side", _check_side("side of the cloud edges", self.side, count))
        object.__setattr__(self, "weight", _check_weight("weight of the cloud edges", self.weight, count))
        sigma = np.zeros(count) if self.sigma_m is None else self.sigma_m
        object.__setattr__(self, "sigma_m", _check_weight("sigma_m of the cloud edges", sigma, count))
        background = np.zeros((count, 3)) if self.background is None else self.background
        background = checked("background of the cloud edges", background, (count, 3), np.float64)
        object.__setattr__(self, "background", background)
        time_s = np.zeros(count) if self.time_s is None else self.time_s
        object.__setattr__(self, "time_s", checked("time_s of the cloud edges", time_s, (count,), np.float64))

    def __len__(self) -> int:
        return len(self.xyz)

    @classmethod
    def empty(cls) -> CloudEdges:
        """Return an empty set of edges."""
        return cls(np.zeros((0, 3)), np.zeros(0, np.int8))

    def without_sides(self) -> CloudEdges:
        """Return the same edges without directions (NONE)."""
        return replace(self, side=np.full(len(self), Side.NONE, np.int8))

    def select(self, keep: Any) -> CloudEdges:
        """Return the edges of a mask or index."""
        rows = (self.xyz, self.side, self.weight, self.sigma_m, self.background, self.time_s)
        return CloudEdges(*(values[keep] for values in rows))

    def moved(self, b_from_lidar: Float) -> CloudEdges:
        """Return the edges in another frame b: xyz transformed by a (4, 4) rigid transform."""
        turned = self.background @ b_from_lidar[:3, :3].T
        return replace(self, xyz=se3.apply(b_from_lidar, self.xyz), background=turned)

    def untwisted(self, twist: Float) -> CloudEdges:
        """Return the edges as observed at time 0 from a LiDAR that moves with constant `twist` (6,), rad/s and m/s.

        Times are kept: calling it twice adds both motions (their commutator is far below a millimetre).
        """
        if not self.time_s.any():
            return self
        background = moved(twist, self.time_s, self.background, directions=True)
        return replace(self, xyz=moved(twist, self.time_s, self.xyz), background=background)

    @property
    def ends(self) -> tuple[Float, Float]:
        """Both ends (M, 3) m of the interval that holds each outline: from the last beam on it to the first beyond it.

        They follow from `sigma_m` and `background`; both are at `xyz` where either is unknown. The interval is centred
        at `xyz`, as cloud extractors place it by default.
        """
        half = np.sqrt(3.0) * self.sigma_m[:, None] * self.background
        return self.xyz - half, self.xyz + half

    @property
    def gap_rad(self) -> Float:
        """Angle (M,) in rad between the two beams, seen from the origin."""
        return np.asarray(np.sqrt(12.0) * self.sigma_m / np.maximum(np.linalg.norm(self.xyz, axis=1), 1e-9))

    @property
    def times_s(self) -> Float:
        """Time of each edge of a raw sweep relative to the image; 0 if unknown or compensated."""
        return self.time_s

    @property
    def places(self) -> Float:
        """The positions of the edges."""
        return self.xyz
