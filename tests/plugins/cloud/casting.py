"""Exact sweeps of boxes, poles and planes: the range of every ray in closed form."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from p2o import Cloud

HDL64 = np.r_[np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.33, 32)]
VLP16 = np.linspace(15.0, -15.0, 16)
HDL32 = np.linspace(10.67, -30.67, 32)
OS128 = np.linspace(22.5, -22.5, 128)


@dataclass(frozen=True)
class Box:
    """A box with its sides turned by `yaw_deg` about z; `centre` and `size` (3,) in metres."""

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw_deg: float = 0.0

    def hit(self, origin, rays):
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        local = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
        start, ray = local @ (origin - np.array(self.centre)), rays @ local.T
        with np.errstate(divide="ignore"):
            one, two = ((sign * np.array(self.size) / 2 - start) / ray for sign in (-1, 1))
        near, far = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        return np.where((near < far) & (near > 0), near, np.inf)


@dataclass(frozen=True)
class Pole:
    """An endless upright cylinder."""

    x: float
    y: float
    radius: float

    def hit(self, origin, rays):
        a = (rays[:, :2] ** 2).sum(axis=1)
        toward = origin[:2] - (self.x, self.y)
        b = rays[:, :2] @ toward
        inside = b * b - a * (toward @ toward - self.radius**2)
        range_m = (-b - np.sqrt(np.maximum(inside, 0))) / a
        return np.where((inside > 0) & (range_m > 0), range_m, np.inf)


@dataclass(frozen=True)
class Plane:
    """The endless plane normal . x = offset."""

    normal: tuple[float, float, float]
    offset: float

    def hit(self, origin, rays):
        with np.errstate(divide="ignore"):
            range_m = (self.offset - np.dot(self.normal, origin)) / (rays @ np.array(self.normal))
        return np.where(range_m > 0, range_m, np.inf)


GROUND = Plane((0, 0, 1), -1.73)


@dataclass(frozen=True)
class Lidar:
    """A spinning sensor at the origin, its beams crossing the axis `lift_m` above it."""

    elevations_deg: np.ndarray = field(default_factory=lambda: HDL64)
    step_deg: float = 0.18
    phase: float = 0.0
    lift_m: float = 0.0
    max_range_m: float = 120.0

    def scan(self, *things, ring=True) -> Cloud:
        """The returns ring by ring, highest first, each from azimuth 0 upwards."""
        count = round(360 / self.step_deg)
        azimuth = np.radians((np.arange(count) + self.phase) * 360 / count)
        elevation = np.radians(self.elevations_deg)
        el, az = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
        rays = np.column_stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
        origin = np.array([0, 0, self.lift_m])
        range_m = np.min([thing.hit(origin, rays) for thing in things], axis=0)
        seen = range_m < self.max_range_m
        number = np.repeat(np.arange(len(elevation)), count)[seen]
        return Cloud(origin + rays[seen] * range_m[seen, None], ring=number if ring else None)
