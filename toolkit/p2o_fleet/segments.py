"""Segments of the checks of a vehicle: one pair of sensors, one extrinsic, between two services."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from p2o_fleet.checks import Checks

Pair = tuple[str, str, str]
"""Vehicle type, camera, LiDAR."""
_MIN_CHECKS = 2
"""Number of consecutive checks with which a new extrinsic or service begins: a single row may be an error of input."""


@dataclass(frozen=True, kw_only=True)
class Extrinsic:
    """One extrinsic of a vehicle between two services: its text in the table of drives, and `digest` of its values."""

    vehicle: str
    vehicle_type: str
    camera: str
    lidar: str
    extrinsic: str
    digest: str
    service: str

    @property
    def pair(self) -> Pair:
        """Return vehicle type, camera and LiDAR."""
        return self.vehicle_type, self.camera, self.lidar


def segments_of(checks: Checks, now: float = math.inf) -> Iterator[tuple[Extrinsic, Checks]]:
    """Yield the extrinsics of a vehicle with the checks of each: a new extrinsic or service begins another segment.

    Single checks with another extrinsic or service than those before and after, and checks after `now` (s since 1970)
    with another one than the last, are in no segment, unless there are no others. Checks without a readable extrinsic
    belong to the segment before, or to the first one after.
    """
    texts = checks.texts
    pairs = np.char.add(np.char.add(texts["camera"].astype(str), "\0"), texts["lidar"].astype(str))
    for pair in np.unique(pairs):
        rows = np.flatnonzero(pairs == pair)
        digests = _filled(texts["extrinsic_digest"][rows].astype(str))
        names = np.char.add(np.char.add(digests, "\0"), texts["service"][rows].astype(str))
        runs = np.cumsum(_changes(names)) - 1
        certain = np.bincount(runs, weights=checks.time[rows] <= now) >= _MIN_CHECKS
        kept = np.flatnonzero(certain[runs] if certain.any() else np.full(len(rows), True))
        starts = np.flatnonzero(_changes(names[kept]))
        for begin, end in zip(starts, [*starts[1:], len(kept)], strict=True):
            own = checks.take(rows[kept[begin:end]])
            types, counts = np.unique(own.texts["vehicle_type"].astype(str), return_counts=True)
            last = {name: str(own.texts[name][-1]) for name in ("camera", "lidar", "extrinsic", "service")}
            last |= {"digest": str(digests[kept[begin]]), "vehicle_type": str(types[counts.argmax()])}
            yield Extrinsic(vehicle=checks.vehicle, **last), own


def _changes(names: Any) -> Any:
    """Return which names (N,) differ from the one before; the first one does."""
    return np.concatenate([[True], names[1:] != names[:-1]])


def _filled(values: Any) -> Any:
    """Return texts with empty ones replaced by the last one before, or the first one after."""
    known = np.flatnonzero(values != "")
    if not len(known):
        return values
    at = np.searchsorted(known, np.arange(len(values)), side="right") - 1
    return values[known[np.maximum(at, 0)]]
