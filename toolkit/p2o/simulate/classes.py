"""What a surface belongs to, as the class map of a picture says it."""

from __future__ import annotations

from enum import IntEnum


class Class(IntEnum):
    """Semantic class of a part; SKY is where a ray meets nothing."""

    SKY = 0
    ROAD = 1
    PAVEMENT = 2
    TERRAIN = 3
    BUILDING = 4
    WALL = 5
    FENCE = 6
    GUARD_RAIL = 7
    POLE = 8
    SIGN = 9
    TRAFFIC_LIGHT = 10
    FOLIAGE = 11
    TRUNK = 12
    CAR = 13
    VAN = 14
    TRUCK = 15
    BUS = 16
    PERSON = 17
    CYCLIST = 18
    FURNITURE = 19
    BOARD = 20
