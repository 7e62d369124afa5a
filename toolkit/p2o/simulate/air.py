"""The air that a LiDAR looks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Air:
    """What is in the air for a LiDAR: light lost to either way, and pulses that come back from near by.

    After r metres a pulse keeps exp(-extinction_per_m r); `drops` is the share of pulses that meet a drop, at distances
    that fall off exponentially with `drops_m` metres, and come back from it where nothing is nearer.
    """

    extinction_per_m: float = 0.0
    drops: float = 0.0
    drops_m: float = 4.0


CLEAR_AIR = Air()
"""Air that takes nothing away and adds nothing."""
