"""LiDAR models: directions and times of the beams, and measurement noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from p2o import Float, InputError, Int


@dataclass(frozen=True, eq=False)
class Beams:
    """The pulses of one sweep in the LiDAR frame (x forward, y left, z up), in the order of its points.

    `origins` and unit `directions` (N, 3) in m; `time_s` (N,) relative to the middle of the sweep; `ring` (N,) or None,
    `column` (N,); `grid` (rings, columns) if pulses are in row-major order of a grid of spatial neighbours.
    """

    origins: Float
    directions: Float
    time_s: Float
    ring: Int | None
    column: Int
    grid: tuple[int, int] | None


@dataclass(frozen=True, kw_only=True)
class Ranging:
    """Range and noise of a LiDAR. Angles are standard deviations; the divergence is the full angle.

    A pulse returns if its energy is at least that of a surface of 10 % reflectance at `dark_range_m`. Returns closer
    than `pulse_m` merge, and the `strongest` or the `first` of several returns is reported.

    Raises InputError for an empty interval of ranges.
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
            fault = "the ranges of the LiDAR are empty"
            got = f"{self.min_range_m:g}, {self.max_range_m:g}"
            raise InputError(fault, where=self.name, expected="0 <= min_range_m < max_range_m", got=got)


@dataclass(frozen=True, kw_only=True)
class Lidar(Ranging):
    """A LiDAR whose beams rotate about z.

    Beam i, highest first, starts at height `height_m[i]` with `elevation_deg[i]` and the azimuth offset
    `azimuth_deg[i]`, counter-clockwise (default: 0): its points satisfy z = d tan(elevation) + height. The head fires
    at `columns` azimuths per revolution of `turn_s` seconds, seen from above `clockwise` or not, and along x at time 0.

    Raises InputError without beams or columns, and unless each beam has one height and offset.
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
                fault = f"a LiDAR needs one {word} for each of its beams"
                raise InputError(fault, where=self.name, expected=f"{count or 'some'} values", got=len(values))
            object.__setattr__(self, field, values or (0.0,) * count)
        if self.columns < 1:
            raise InputError("a LiDAR needs at least one column", where=self.name, got=f"{self.columns} columns")

    @property
    def points_per_s(self) -> float:
        """Number of pulses per second."""
        return len(self.elevation_deg) * self.columns / self.turn_s

    @property
    def beams(self) -> Beams:
        """Pulses ring by ring, highest first, each counter-clockwise from straight ahead, as in KITTI's files.

        `column` numbers the azimuths counter-clockwise from straight ahead, for both directions of rotation.
        """
        return _turned(self)


@dataclass(frozen=True, kw_only=True)
class Rosette(Ranging):
    """Beams behind two rotating wedge prisms, small-angle Risley model (METHODS 10.1: Livox), without rings.

    Azimuth = sum d_k cos(w_k t), elevation = sum d_k sin(w_k t), for deflections d = `deflection_deg` and speeds w =
    `rpm`, negative for reverse rotation; `points_per_s` pulses per second for `sweep_s` seconds around time 0. Beams
    fire in turn, each with its own elevation `lines_deg` added. With `spin_rpm` the whole optic also rotates about z.
    """

    deflection_deg: tuple[float, float]
    rpm: tuple[float, float]
    points_per_s: float
    sweep_s: float = 0.1
    lines_deg: tuple[float, ...] = (0.0,)
    spin_rpm: float = 0.0

    @property
    def beams(self) -> Beams:
        """Pulses in temporal order, without rings; `column` is their index."""
        return _flower(self)


@dataclass(frozen=True)
class Air:
    """Attenuation of LiDAR pulses, and false returns from drops near the sensor.

    After r metres a pulse retains exp(-extinction_per_m r) of its energy. `drops` is the share of pulses that hit a
    drop, at exponentially distributed distances with mean `drops_m` metres; they return from it if nothing is nearer.
    """

    extinction_per_m: float = 0.0
    drops: float = 0.0
    drops_m: float = 4.0


CLEAR_AIR = Air()
"""Air without attenuation and drops."""


@lru_cache(maxsize=4)
def _turned(lidar: Lidar) -> Beams:
    rings, columns = len(lidar.elevation_deg), lidar.columns
    head: Float = 2 * np.pi * np.arange(columns, dtype=np.float64) / columns
    azimuth = head + np.radians(lidar.azimuth_deg)[:, None]
    elevation = np.broadcast_to(np.radians(lidar.elevation_deg)[:, None], azimuth.shape)
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
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
    across = (deflection * np.cos(phase)).sum(axis=0) + 2 * np.pi / 60 * lidar.spin_rpm * time_s
    up = (deflection * np.sin(phase)).sum(axis=0) + np.resize(np.radians(lidar.lines_deg), count)
    directions = np.column_stack([np.cos(up) * np.cos(across), np.cos(up) * np.sin(across), np.sin(up)])
    return Beams(np.zeros((count, 3)), directions, time_s, None, np.arange(count), None)
