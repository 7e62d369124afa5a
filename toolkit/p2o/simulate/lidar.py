"""LiDARs as data: where their beams go and when, and how well they measure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from p2o.arrays import Float, Int
from p2o.errors import InputError


@dataclass(frozen=True, eq=False)
class Beams:
    """The pulses of one sweep in the LiDAR frame (x forward, y left, z up), in the order of its points.

    `origins` and unit `directions` (N, 3) m; `time_s` (N,) relative to the middle of the sweep; `ring` (N,) or None,
    `column` (N,); `grid` (rings, columns) where pulses come row by row, so that neighbours in it are neighbours in
    space.
    """

    origins: Float
    directions: Float
    time_s: Float
    ring: Int | None
    column: Int
    grid: tuple[int, int] | None


@dataclass(frozen=True, kw_only=True)
class Ranging:
    """What all LiDARs have in common: how far and how well they measure. Angles are one sigma or, divergence, full.

    A pulse returns if its reflectance and incidence leave at least the energy of a surface of 10 % at `dark_range_m`;
    returns closer than `pulse_m` melt into one, and of several the `strongest` or the `first` is kept.

    Raises InputError for ranges that are not in rising order.
    """

    name: str
    min_range_m: float = 0.9
    max_range_m: float = 120.0
    dark_range_m: float = 50.0
    range_noise_m: float = 0.02
    angle_noise_deg: float = 0.0
    divergence_mrad: float = 2.0
    pulse_m: float = 0.5
    keeps: Literal["strongest", "first"] = "strongest"

    def __post_init__(self) -> None:
        if not 0 <= self.min_range_m < self.max_range_m:
            raise InputError(
                "the ranges of the LiDAR are empty",
                where=self.name,
                expected="0 <= min_range_m < max_range_m",
                got=f"{self.min_range_m:g}, {self.max_range_m:g}",
            )


@dataclass(frozen=True, kw_only=True)
class Lidar(Ranging):
    """Beams that turn about z.

    Beam i, highest first, leaves the axis at height `height_m[i]` with `elevation_deg[i]`, `azimuth_deg[i]` ahead of
    the head counter-clockwise (empty: all 0): its points obey z = d tan(elevation) + height. The head stops at
    `columns` places a turn, `turn_s` seconds each, seen from above `clockwise` or not, and looks along x at time 0.

    Raises InputError if there are no beams, or not one height and offset a beam, or no columns.
    """

    elevation_deg: tuple[float, ...]
    height_m: tuple[float, ...] = ()
    azimuth_deg: tuple[float, ...] = ()
    columns: int
    turn_s: float = 0.1
    clockwise: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.elevation_deg)
        for word, field in (("height", "height_m"), ("azimuth offset", "azimuth_deg")):
            values = getattr(self, field)
            if count == 0 or len(values) not in (0, count):
                raise InputError(
                    f"a LiDAR needs one {word} for each of its beams",
                    where=self.name,
                    expected=f"{count or 'some'} values",
                    got=len(values),
                )
            object.__setattr__(self, field, values or (0.0,) * count)
        if self.columns < 1:
            raise InputError("a LiDAR fires at least once a turn", where=self.name, got=f"{self.columns} columns")

    @property
    def points_per_s(self) -> float:
        """Pulses a second."""
        return len(self.elevation_deg) * self.columns / self.turn_s

    @property
    def beams(self) -> Beams:
        """Pulses ring by ring, highest first, each from straight ahead counter-clockwise, as KITTI writes them.

        `column` numbers the places of the head counter-clockwise from straight ahead, whatever way it turns.
        """
        return _turned(self)


@dataclass(frozen=True, kw_only=True)
class Rosette(Ranging):
    """A beam behind two turning wedge prisms, small-angle Risley model (METHODS 10.1: Livox).

    Azimuth = sum d_k cos(w_k t), elevation = sum d_k sin(w_k t), for deflections d = `deflection_deg` and speeds w =
    `rpm`, negative backwards; `points_per_s` pulses a second for `sweep_s` seconds around time 0.
    """

    deflection_deg: tuple[float, float]
    rpm: tuple[float, float]
    points_per_s: float
    sweep_s: float = 0.1

    @property
    def beams(self) -> Beams:
        """Pulses in the order of time; there are no rings, and `column` counts them."""
        return _flower(self)


@lru_cache(maxsize=4)
def _turned(lidar: Lidar) -> Beams:
    rings, columns = len(lidar.elevation_deg), lidar.columns
    head: Float = 2 * np.pi * np.arange(columns, dtype=np.float64) / columns
    azimuth = head + np.radians(lidar.azimuth_deg)[:, None]
    elevation = np.broadcast_to(np.radians(lidar.elevation_deg)[:, None], azimuth.shape)
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    )
    origins = np.zeros((rings, columns, 3))
    origins[..., 2] = np.array(lidar.height_m)[:, None]
    column = np.tile(np.arange(columns), rings)
    share = ((column + columns // 2) % columns - columns // 2) / columns
    return Beams(
        origins.reshape(-1, 3),
        directions.reshape(-1, 3),
        np.asarray((-share if lidar.clockwise else share) * lidar.turn_s, np.float64),
        np.repeat(np.arange(rings), columns),
        column,
        (rings, columns),
    )


@lru_cache(maxsize=4)
def _flower(lidar: Rosette) -> Beams:
    count = round(lidar.points_per_s * lidar.sweep_s)
    time_s: Float = (np.arange(count, dtype=np.float64) + 0.5) / lidar.points_per_s - lidar.sweep_s / 2
    phase = 2 * np.pi / 60 * np.array(lidar.rpm)[:, None] * time_s
    deflection = np.radians(lidar.deflection_deg)[:, None]
    across, up = (deflection * np.cos(phase)).sum(axis=0), (deflection * np.sin(phase)).sum(axis=0)
    directions = np.column_stack([np.cos(up) * np.cos(across), np.cos(up) * np.sin(across), np.sin(up)])
    return Beams(np.zeros((count, 3)), directions, time_s, None, np.arange(count), None)
