"""The ten hooks of p2o. A plugin offers methods through them; it changes nothing global.

Every hook takes no arguments and returns or yields `Method` values. Anyone may implement any of them, in a module
named by an entry point of the group "p2o". Choosing a method by name is the user's job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pluggy

from p2o.host.method import Kind, Method

PROJECT = "p2o"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


_RETURNED = {
    Kind.IMAGE_EXTRACTOR: "`(Image) -> ImageFeatures`",
    Kind.CLOUD_EXTRACTOR: "`(Cloud) -> CloudFeatures`",
    Kind.MATCHER: "`(Sequence[View], camera_from_lidar, reach_px) -> Problem`",
    Kind.SOLVER: "`(Problem, camera_from_lidar) -> Solution`",
    Kind.INITIALIZER: "`(Sequence[View], camera_from_lidar) -> list of poses, best first`",
    # A plain function `(Sequence[Frame], camera_from_lidar) -> Result` is enough, but nothing is cached then.
    Kind.CALIBRATOR: "a `Calibrator`: `prepare(Frame)` and `solve(prepared, start)`",
    Kind.ACCUMULATOR: "an `Accumulator`: `(Sequence[Frame], number) -> Cloud`",
    Kind.DATASET: "a `Dataset`: a lazy sequence of frames with names",
    Kind.EXPORTER: "`(Result, Path) -> None`",
    Kind.CALIBRATION_READER: "a `CalibrationReader` of one file format",
}
"""What `build(options)` of the methods returns, by their kind."""


def _hook(kind: Kind) -> Callable[[], Iterable[Method]]:
    def offer() -> Iterable[Method]:
        return ()

    offer.__name__ = offer.__qualname__ = kind.hook
    offer.__doc__ = f"Offer methods whose build(options) returns {_RETURNED[kind]}."
    return hookspec(offer)


globals().update({kind.hook: _hook(kind) for kind in Kind})
