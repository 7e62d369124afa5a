"""The nine hooks of p2o. A plugin offers methods through them; it changes nothing global.

Every hook takes no arguments and returns or yields `Method` values. Anyone may implement any of them, in a module
named by an entry point of the group "p2o". Choosing a method by name is the user's job.
"""

from __future__ import annotations

from collections.abc import Iterable

import pluggy

from p2o.host.method import Method

PROJECT = "p2o"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def p2o_image_extractors() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Image) -> ImageFeatures`."""


@hookspec
def p2o_cloud_extractors() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Cloud) -> CloudFeatures`."""


@hookspec
def p2o_matchers() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Sequence[View], camera_from_lidar, reach_px) -> Problem`."""


@hookspec
def p2o_solvers() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Problem, camera_from_lidar) -> Solution`."""


@hookspec
def p2o_initializers() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Sequence[View], camera_from_lidar) -> list of poses, best first`."""


@hookspec
def p2o_calibrators() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns a `Calibrator`: `prepare(Frame)` and `solve(prepared, start)`.

    A plain `(Sequence[Frame], camera_from_lidar) -> Result` does as well; nothing that it prepares is kept then.
    """


@hookspec
def p2o_accumulators() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns an `Accumulator`: `(Sequence[Frame], number) -> Cloud`."""


@hookspec
def p2o_datasets() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns a `Dataset`: a lazy sequence of frames with names."""


@hookspec
def p2o_exporters() -> Iterable[Method]:  # type: ignore[empty-body]
    """Offer methods whose build(options) returns `(Result, Path) -> None`."""
