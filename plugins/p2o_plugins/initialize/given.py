"""Initializer `given`: use the initial guess of the user."""

from __future__ import annotations

from collections.abc import Sequence

from p2o import Float, Initializer, Method, Options, View


def build(options: Options) -> Initializer:
    """Return an initializer that proposes only the given pose."""

    def initialize(views: Sequence[View], camera_from_lidar: Float) -> list[Float]:
        return [camera_from_lidar]

    return initialize


METHOD = Method(
    name="given",
    build=build,
    summary="Starts at the given pose (the paper's own procedure).",
    needs=frozenset(),
    cite="P2O-Calib, Sec. III-D",
)
