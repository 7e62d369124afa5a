"""Points of a sweep with attributes as a feature, and the selection of points by range in a reproducible order."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, ClassVar, Self

import numpy as np
import p2o
from p2o import Float, Int
from p2o.reading import moved
from p2o.solving import checked

_SHAPES: dict[str, tuple[tuple[int, ...], type]] = {"xyz": ((3,), np.float64), "normal": ((3,), np.float64)}
_KINDS: dict[str, type] = {"segment": np.int64, "kind": np.int64}


class PointFeature(p2o.CloudFeature):
    """A frozen dataclass of N points whose fields are arrays with one row per point.

    Fields are `xyz` (N, 3) in m, maybe unit vectors `normal` (N, 3), other attributes (N,), and `time_s` (N,), the
    measurement times of a raw sweep in seconds from the image, or None.
    """

    word: ClassVar[str]
    xyz: Float
    time_s: Float | None

    def __post_init__(self) -> None:
        for name, value in self._arrays().items():
            shape, kind = _SHAPES.get(name, ((), _KINDS.get(name, np.float64)))
            object.__setattr__(self, name, checked(f"{name} of {self.word}", value, (len(self.xyz), *shape), kind))

    def __len__(self) -> int:
        return len(self.xyz)

    def _arrays(self) -> dict[str, Any]:
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in arrays.items() if value is not None}

    def select(self, keep: Any) -> Self:
        """Return the points of a mask or index."""
        return replace(self, **{name: value[keep] for name, value in self._arrays().items()})  # type: ignore[type-var]

    def moved(self, b_from_lidar: Float) -> Self:
        """Return the points in another frame b, by a (4, 4) rigid transform."""
        arrays = {"xyz": p2o.se3.apply(b_from_lidar, self.xyz)}
        if "normal" in self._arrays():
            arrays["normal"] = self._arrays()["normal"] @ b_from_lidar[:3, :3].T
        return replace(self, **arrays)  # type: ignore[type-var]

    def untwisted(self, twist: Float) -> Self:
        """Return the points as if measured at time 0 by a LiDAR that moves with constant `twist` (6,)."""
        if self.time_s is None:
            return self
        arrays = {"xyz": moved(twist, self.time_s, self.xyz)}
        if "normal" in self._arrays():
            arrays["normal"] = moved(twist, self.time_s, self._arrays()["normal"], directions=True)
        return replace(self, **arrays)  # type: ignore[type-var]

    @property
    def times_s(self) -> Float | None:
        """Return the measurement times of a raw sweep."""
        return self.time_s

    @property
    def places(self) -> Float:
        """Return the points themselves."""
        return self.xyz


def rows_in_range(cloud: p2o.Cloud, max_range_m: float, min_range_m: float = 0.0) -> Int:
    """Return the indices of points within a range, sorted by coordinates: the order of a sweep has no effect."""
    range_m = np.linalg.norm(cloud.xyz, axis=1)
    rows = np.flatnonzero((range_m >= min_range_m) & (range_m <= max_range_m))
    return rows[np.lexsort(cloud.xyz[rows].T)]


def raw_times(cloud: p2o.Cloud, rows: Int) -> Float | None:
    """Return the measurement times of points of a raw sweep; None if the sweep is already deskewed or has none."""
    return None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[rows]
