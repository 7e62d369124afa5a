"""The types of what `build(options)` returns, slot by slot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from p2o.arrays import Float
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.image import Image
from p2o.problems.agreement import agreement_of
from p2o.problems.problem import Problem
from p2o.results.evidence import Agreement
from p2o.results.result import Result, Solution


class ImageExtractor(Protocol):
    """Extract features from one image."""

    def __call__(self, image: Image, /) -> ImageFeatures: ...


class CloudExtractor(Protocol):
    """Extract features from one sweep."""

    def __call__(self, cloud: Cloud, /) -> CloudFeatures: ...


class Matcher(Protocol):
    """Pose the problem of all views around camera_from_lidar (4, 4), with features matched within `reach_px` pixels.

    A plain function is enough; derive from `MatcherBase` for the optional judge.
    """

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, reach_px: float, /) -> Problem: ...


@runtime_checkable
class Judge(Protocol):
    """Compare poses by a cost. Costs of one call are comparable; costs of different calls need not be.

    Derive from `JudgeBase` for optional capabilities: agreement, covariance, local maximum, rivals.

    `name` identifies the measure in results, `unit` is the unit of its costs.
    """

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...

    def costs(self, poses: Sequence[Float], /) -> list[float]:
        """Return the cost of each pose (4, 4), lower is better."""
        ...

    def lead(self, best: float, other: float, /) -> tuple[float, str]:
        """Return the difference of two costs in a unit that a user understands, and that unit."""
        ...

    def on(self, views: Sequence[View], /) -> Judge:
        """Return the judge of the same points in `views`: the same views, moved or with other cameras."""
        ...


LogLikelihood = Callable[[Float], tuple[float, Float]]
"""The log likelihood of a pose (4, 4), and its derivatives (6,) by a left update."""


class JudgeBase(ABC):
    """Base class of judges with optional capabilities; all but `costs` and `on` have defaults."""

    name: str
    unit: str
    camera_errors: tuple[bool, bool, bool, bool] = (False, False, False, False)
    """Whether the costs reveal errors of focal length, radial distortion, and principal point x and y, and motions."""
    min_cells: int = 36
    """Fewest independent cells of the image in which edges must agree for a predicted error."""

    @abstractmethod
    def costs(self, poses: Sequence[Float], /) -> list[float]:
        """Return the cost of each pose (4, 4), lower is better."""

    @abstractmethod
    def on(self, views: Sequence[View], /) -> JudgeBase:
        """Return the judge of the same points in `views`: the same views, moved or with other cameras."""

    def lead(self, best: float, other: float, /) -> tuple[float, str]:
        """Return the difference of two costs in a unit that a user understands, and that unit."""
        return other - best, self.unit

    def agreement(self, views: Sequence[View], pose: Float, /) -> Agreement | None:
        """Return how well the directed edges of views agree at a pose (4, 4); None without edges of both sensors."""
        return agreement_of(views, pose)

    def covariance(self, pose: Float, /) -> Float | None:
        """Return the covariance (6, 6) of a left update in rad and m at a pose (4, 4) that minimises the cost.

        It contains the systematic error of edges by the beam spacing. None: it is estimated from the pairs or residuals
        of the matcher.
        """
        return None

    def maximised(self, pose: Float, /) -> Float:
        """Return the pose (4, 4) of the lowest cost near a pose, for judges that can find it; by default the pose."""
        return pose

    @property
    def log_likelihood(self) -> LogLikelihood | None:
        """The log likelihood of a pose, for judges that have one."""
        return None

    def rivals(self, pose: Float, count: int, /) -> list[Float]:
        """Return up to `count` poses (4, 4) of low cost near a pose and distinct from it; by default none."""
        return []


class MatcherBase(ABC):
    """Base class of matchers with optional capabilities; each method but `__call__` has a default."""

    @abstractmethod
    def __call__(self, views: Sequence[View], camera_from_lidar: Float, reach_px: float, /) -> Problem:
        """Return the problem of all views, as `Matcher`."""

    def judge(self, views: Sequence[View], start: Float, poses: Sequence[Float], /) -> Judge | None:
        """Return the judge that compares poses of this method, or None for the default of the pipeline.

        `start` (4, 4) is the initial guess, `poses` are the initial poses that the initializer proposed. By default
        matchers that need edges of both sensors are judged by the directed distance, others by their own cost.
        """
        return None


class Solver(Protocol):
    """Minimise a problem, starting from camera_from_lidar (4, 4)."""

    def __call__(self, problem: Problem, camera_from_lidar: Float, /) -> Solution: ...


class Initializer(Protocol):
    """Propose initial poses (4, 4) around a given one, best first.

    A plain function is enough; derive from `InitializerBase` for optional capabilities.
    """

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, /) -> list[Float]: ...


class InitializerBase(ABC):
    """Base class of initializers with optional capabilities; everything but `__call__` has a default."""

    @abstractmethod
    def __call__(self, views: Sequence[View], camera_from_lidar: Float, /) -> list[Float]:
        """Return initial poses, as `Initializer`."""

    @property
    def start_sigma(self) -> tuple[float, float] | None:
        """Standard deviation of the initial guesses about (deg) and along (m) each axis that the method is made for.

        None if it has no such range. The prior of a result is an option of the pipeline, for all methods.
        """
        return None

    @property
    def reach(self) -> tuple[float, float] | None:
        """Half sizes of the box of initial errors that the method searches, about (deg) and along (m) each camera axis.

        Among refined poses, one within the box is preferred; a result outside it by more than 10 % is doubtful. None if
        the method has no such box.
        """
        return None

    def prepare(self, frame: Frame, /) -> Any:
        """Return the inputs that the method needs of a frame in addition to its features, stored in `View.prepared`.

        The frame has no true extrinsic. The value is cached by the content of the frame, as for `Calibrator.prepare`.
        """
        return None

    @property
    def prepares(self) -> bool:
        """Whether the class defines `prepare`."""
        return type(self).prepare is not InitializerBase.prepare


@runtime_checkable
class Calibrator(Protocol):
    """A whole method: prepare each frame (without truth), then solve all of them from an initial guess (4, 4).

    What `prepare` returns is cached by the content of the frame if it consists of arrays, dataclasses, numbers, texts,
    lists and dicts: it must depend on the frame and the options only.
    """

    def prepare(self, frame: Frame, /) -> Any: ...

    def solve(self, prepared: Sequence[Any], camera_from_lidar: Float, /) -> Result: ...


@runtime_checkable
class Accumulator(Protocol):
    """Accumulate the sweeps of successive frames of a sequence in the LiDAR frame of frame `number`.

    `past` and `future` are the numbers of frames before and after it; at the ends of a sequence there are fewer.
    """

    @property
    def past(self) -> int: ...
    @property
    def future(self) -> int: ...

    def __call__(self, frames: Sequence[Frame], number: int, /) -> Cloud: ...


class Exporter(Protocol):
    """Write a result to a file of another system's format."""

    def __call__(self, result: Result, path: Path, /) -> None: ...
