"""Segments of the checks of a vehicle: one pair of sensors, one extrinsic, between two services."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from p2o_fleet.schema import Checks

Pair = tuple[str, str, str]
"""Vehicle type, camera, LiDAR."""


@dataclass(frozen=True, eq=False)
class Segment:
    """The checks of one extrinsic between two services; `current` if it is the last one of its sensors."""

    checks: Checks
    camera: str
    lidar: str
    vehicle_type: str
    service: str
    digest: str
    current: bool

    @property
    def pair(self) -> Pair:
        """Return vehicle type, camera and LiDAR."""
        return self.vehicle_type, self.camera, self.lidar


def segments_of(checks: Checks) -> Iterator[Segment]:
    """Yield the segments of a vehicle: a new extrinsic or a new service begins another one.

    Checks without a readable extrinsic belong to the segment before, or to the first one after.
    """
    texts = checks.texts
    pairs = np.char.add(np.char.add(texts["camera"].astype(str), "\0"), texts["lidar"].astype(str))
    for pair in np.unique(pairs):
        rows = np.flatnonzero(pairs == pair)
        digests = _filled(texts["extrinsic_digest"][rows].astype(str))
        names = np.char.add(np.char.add(digests, "\0"), texts["service"][rows].astype(str))
        starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
        for begin, end in zip(starts, [*starts[1:], len(rows)], strict=True):
            own = checks.take(rows[begin:end])
            last = {name: str(own.texts[name][-1]) for name in ("camera", "lidar", "vehicle_type", "service")}
            yield Segment(own, **last, digest=str(digests[begin]), current=bool(end == len(rows)))


def _filled(values: Any) -> Any:
    """Return texts with empty ones replaced by the last one before, or the first one after."""
    known = np.flatnonzero(values != "")
    if not len(known):
        return values
    at = np.searchsorted(known, np.arange(len(values)), side="right") - 1
    return values[known[np.maximum(at, 0)]]
