"""The types of what `build(options)` returns, slot by slot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from p2o.arrays import Float
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.image import Image
from p2o.problems.problem import Problem
from p2o.results.result import Result, Solution


class ImageExtractor(Protocol):
    """Finds features in one image."""

    def __call__(self, image: Image, /) -> ImageFeatures: ...


class CloudExtractor(Protocol):
    """Finds features in one sweep."""

    def __call__(self, cloud: Cloud, /) -> CloudFeatures: ...


class Matcher(Protocol):
    """Pairs the features of all views at the pose camera_from_lidar (4, 4), within `reach_px` pixels."""

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, reach_px: float, /) -> Problem: ...


class Solver(Protocol):
    """Improves the pose camera_from_lidar (4, 4) on a problem."""

    def __call__(self, problem: Problem, camera_from_lidar: Float, /) -> Solution: ...


class Initializer(Protocol):
    """Proposes starting poses (4, 4) around a given one, best first.

    One that takes the given start to be about right may say so with an attribute `start_sigma`: one deviation about
    (deg) and along (m) each axis. The start is then weighed in at the end (`Result.start_weight`).

    One that needs more than features (a drive's pictures, sweeps and times) may have a method `prepare(frame)` as a
    `Calibrator` has: what it returns is in `View.prepared`, and is kept alike.
    """

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, /) -> list[Float]: ...


class Calibrator(Protocol):
    """A whole method: what it prepares of each frame (without truth), and from all of it and a start (4, 4) a result.

    What `prepare` returns is kept by the content of the frame where it is made of arrays, dataclasses, numbers, texts,
    lists and dicts: it must follow from the frame and the options alone.
    """

    def prepare(self, frame: Frame, /) -> Any: ...

    def solve(self, prepared: Sequence[Any], camera_from_lidar: Float, /) -> Result: ...


class Accumulator(Protocol):
    """Joins the sweeps of successive frames of a sequence: returns that of frame `number`, with what the others saw.

    `past` and `future` say how many frames before and after it wants; at the ends of a sequence there are fewer.
    """

    @property
    def past(self) -> int: ...
    @property
    def future(self) -> int: ...

    def __call__(self, frames: Sequence[Frame], number: int, /) -> Cloud: ...


class Exporter(Protocol):
    """Writes a result to a file in some system's format."""

    def __call__(self, result: Result, path: Path, /) -> None: ...
