"""Builds the stages that plugins offer, and watches them: what goes wrong inside one names the plugin and the stage."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, MethodUnavailable, P2OError, PluginError
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.host.method import Kind
from p2o.host.registry import Offer
from p2o.host.trainer import Trainer
from p2o.options import Options
from p2o.problems.problem import LeastSquares, Objective
from p2o.results.result import Result, Solution


def build(offer: Offer, options: Options) -> Any:
    """Return the stage of an offer, guarded; heavy packages are imported here.

    A guarded stage raises PluginError, naming plugin and stage, where the plugin raises anything but a P2OError or
    returns a wrong type, a wrong shape or NaN. Raises MethodUnavailable where a package is not installed.
    """
    with _watch(offer, "building"):
        stage = offer.method.build(options)
    if offer.kind in _CLASSES:
        return _CLASSES[offer.kind](offer, stage)
    if not callable(stage):
        raise _fault(offer, f"build returned {type(stage).__name__}", "something to call")
    return _GUARDS[offer.kind](offer, stage)


def trainer_of(offer: Offer) -> Trainer:
    """Return the trainer of an offer, guarded as `build` guards a stage.

    Raises InputError where the method does not learn.
    """
    trainer = offer.method.trainer
    if trainer is None:
        raise InputError(f"{offer.kind} '{offer.name}' cannot be trained", expected="a method that learns")

    def label(frame: Frame) -> bytes:
        with _watch(offer, f"labelling {frame.name}"):
            content = trainer.label(frame)
        if not isinstance(content, bytes):
            raise _fault(offer, f"label returned {type(content).__name__}", "the bytes of a file")
        return content

    def draw(path: Path) -> Any:
        with _watch(offer, f"drawing {path}"):
            return trainer.draw(path)

    def train(*arguments: Any) -> Path:
        with _watch(offer, "training"):
            weights = trainer.train(*arguments)
        if not isinstance(weights, Path) or not weights.is_file():
            raise _fault(offer, "train returned no file", "the path of the weights")
        return weights

    return replace(trainer, label=label, draw=draw, train=train)


class GuardedDataset(Sequence[Frame]):
    """A plugin's dataset whose frames are checked as they are read."""

    def __init__(self, offer: Offer, dataset: Any) -> None:
        if not isinstance(dataset, Dataset):
            raise _fault(offer, f"build returned {type(dataset).__name__}", "a p2o.Dataset: names, len() and [index]")
        self._offer, self._dataset = offer, dataset
        with _watch(offer, "listing frames"):
            self.names: tuple[str, ...] = tuple(dataset.names)
            count = len(dataset)
            # Frames that the reader left out, with reasons: whoever asks for one is told.
            self.skipped: Mapping[str, str] = getattr(dataset, "skipped", {})
        if count != len(self.names) or not all(isinstance(name, str) for name in self.names):
            raise _fault(offer, f"{len(self.names)} names for {count} frames", "one name for each frame")
        for name in self.names:
            try:
                name.encode()
            except UnicodeEncodeError as problem:
                # No result, row or report could hold it.
                raise InputError("the name of a frame is not UTF-8", got=name, hint="rename its files") from problem
        if len(set(self.names)) < len(self.names):
            twice = next(name for i, name in enumerate(self.names) if name in self.names[:i])
            raise _fault(offer, f"two frames are called {twice!r}", "a name of its own for each frame")

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        with _watch(self._offer, f"reading frame {self.names[index]}"):
            frame = self._dataset[index]
        if not isinstance(frame, Frame):
            raise _fault(self._offer, f"frame {index} is {type(frame).__name__}", "p2o.Frame")
        if frame.name != self.names[index]:
            raise _fault(self._offer, f"frame {index} is called {frame.name!r}", repr(self.names[index]))
        return frame


def _fault(offer: Offer, what: str, expected: object = None) -> PluginError:
    return PluginError(f"plugin {offer.dist}: {offer.kind} '{offer.name}': {what}", expected=expected)


@contextmanager
def _watch(offer: Offer, doing: str) -> Iterator[None]:
    """Turn what a plugin raises into one line that names it; our own errors pass through as they are."""
    try:
        yield
    except P2OError:
        raise
    except ModuleNotFoundError as problem:
        raise _unavailable(offer, problem) from problem
    except OSError as problem:
        if offer.kind in (Kind.DATASET, Kind.EXPORTER):
            raise InputError(
                f"{offer.kind} '{offer.name}' failed while {doing}",
                where=problem.filename,
                got=problem.strerror or str(problem),
            ) from problem
        raise _raised(offer, doing, problem) from problem
    except Exception as problem:
        raise _raised(offer, doing, problem) from problem


def _raised(offer: Offer, doing: str, problem: Exception) -> PluginError:
    return PluginError(
        f"plugin {offer.dist}: {offer.kind} '{offer.name}' raised {type(problem).__name__} while {doing}",
        got=str(problem) or None,
        hint="P2O_DEBUG=1 shows where",
    )


def _unavailable(offer: Offer, problem: ModuleNotFoundError) -> P2OError:
    missing = (problem.name or "").partition(".")[0]
    if missing == getattr(offer.method.build, "__module__", "").partition(".")[0]:
        return _raised(offer, "importing its own code", problem)
    return MethodUnavailable(
        f"{offer.kind} '{offer.name}' needs the package {missing}, which is not installed",
        hint=f"run: pip install {requirement(offer) or missing}",
    )


def requirement(offer: Offer) -> str:
    """Return what pip has to install for a method, such as "pyceres>=2.4"; empty where nothing more is needed.

    These are the packages that the extra of the method's distribution is made of: the distribution itself may be on no
    index.
    """
    extra = offer.method.extra
    if not extra:
        return ""
    try:
        required = requires(offer.dist) or []
    except PackageNotFoundError:
        required = []
    of_extra = re.compile(rf"""([^;]+);.*\bextra\s*==\s*['"]{re.escape(extra)}['"]""")
    packages = [match[1].strip() for text in required if (match := of_extra.fullmatch(text.strip()))]
    return " ".join(f'"{package}"' for package in packages) or extra


def _pose(offer: Offer, value: Any) -> Float:
    try:
        return se3.check_rigid("camera_from_lidar", value)
    except InputError as problem:
        raise _fault(offer, f"returned no rigid transform: {problem}") from problem


def _finite(offer: Offer, name: str, values: Any) -> None:
    if values is not None and not np.isfinite(values).all():
        raise _fault(offer, f"{name} holds NaN or infinity", "finite numbers")


def _typed(offer: Offer, value: Any, *wanted: type) -> None:
    if not isinstance(value, wanted):
        raise _fault(offer, f"returned {type(value).__name__}", " or ".join(f"p2o.{t.__name__}" for t in wanted))


def _as_said(offer: Offer, features: ImageFeatures | CloudFeatures, prefix: str) -> None:
    """Raise PluginError where a kind of feature is missing that the method says it gives."""
    missing = sorted(w for w in offer.method.gives if w.startswith(prefix) and w not in features.words)
    if missing:
        raise _fault(offer, f"gave no {missing[0].removeprefix(prefix)}", f"{missing[0]}, as it says in `gives`")


def check_features(offer: Offer, features: Any) -> None:
    """Raise PluginError where features are not what an extractor of this offer may return; other kinds return anything.

    What comes from a file is held to the same as what comes from the method.
    """
    if offer.kind in _FEATURES:
        kind, prefix = _FEATURES[offer.kind]
        _typed(offer, features, kind)
        _as_said(offer, features, prefix)


_FEATURES = {Kind.IMAGE_EXTRACTOR: (ImageFeatures, "image-"), Kind.CLOUD_EXTRACTOR: (CloudFeatures, "cloud-")}


def _extractor(offer: Offer, stage: Callable[..., Any]) -> Any:
    def extract(image_or_cloud: Any, /) -> Any:
        with _watch(offer, "extracting"):
            features = stage(image_or_cloud)
        check_features(offer, features)
        return features

    return extract


def _matcher(offer: Offer, stage: Callable[..., Any]) -> Any:
    def guarded_cost(cost: Callable[[Float], Float]) -> Callable[[Float], Float]:
        def checked_cost(poses: Float) -> Float:
            with _watch(offer, "computing its cost"):
                values = np.asarray(cost(poses), dtype=np.float64)
            if values.shape != (len(poses),) or np.isnan(values).any():
                raise _fault(offer, f"cost returned shape {values.shape}", f"({len(poses)},) without NaN")
            return values

        return checked_cost

    def guarded_gradient(gradient: Callable[[Float], Float]) -> Callable[[Float], Float]:
        def checked_gradient(pose: Float) -> Float:
            with _watch(offer, "computing its gradient"):
                values = np.asarray(gradient(pose), dtype=np.float64)
            if values.shape != (6,) or not np.isfinite(values).all():
                raise _fault(offer, f"gradient returned shape {values.shape}", "(6,), finite")
            return values

        return checked_gradient

    def match(views: Any, camera_from_lidar: Float, reach_px: float, /) -> Any:
        with _watch(offer, "matching"):
            problem = stage(views, camera_from_lidar, reach_px)
        if isinstance(problem, LeastSquares):
            return problem
        _typed(offer, problem, LeastSquares, Objective)
        gradient = None if problem.gradient is None else guarded_gradient(problem.gradient)
        return replace(problem, cost=guarded_cost(problem.cost), gradient=gradient)

    own = getattr(stage, "judge", None)
    if own is None:
        return match

    def judge(views: Any, start: Float, poses: Any, /) -> Any:
        with _watch(offer, "making its judge"):
            return own(views, start, poses)

    match.judge = judge  # type: ignore[attr-defined]
    return match


def _solver(offer: Offer, stage: Callable[..., Any]) -> Any:
    def solve(problem: Any, camera_from_lidar: Float, /) -> Any:
        with _watch(offer, "solving"):
            solution = stage(problem, camera_from_lidar)
        _typed(offer, solution, Solution)
        if np.isnan(solution.cost):
            raise _fault(offer, "cost is NaN", "a number")
        if solution.covariance is not None:
            if np.shape(solution.covariance) != (6, 6):
                raise _fault(offer, f"covariance has shape {np.shape(solution.covariance)}", "(6, 6)")
            _finite(offer, "covariance", solution.covariance)
        return replace(solution, camera_from_lidar=_pose(offer, solution.camera_from_lidar))

    return solve


def _initializer(offer: Offer, stage: Callable[..., Any]) -> Any:
    def propose(views: Any, camera_from_lidar: Float, /) -> Any:
        with _watch(offer, "looking for starts"):
            poses = list(stage(views, camera_from_lidar))
        if not poses:
            raise _fault(offer, "proposed no start", "at least one pose")
        return [_pose(offer, pose) for pose in poses]

    sigma = getattr(stage, "start_sigma", None)
    if sigma is not None:
        if np.shape(sigma) != (2,) or not (np.isfinite(sigma).all() and np.all(np.asarray(sigma) > 0)):
            raise _fault(offer, f"start_sigma is {sigma!r}", "degrees and metres, both above zero")
        propose.start_sigma = tuple(map(float, sigma))  # type: ignore[attr-defined]
    own = getattr(stage, "prepare", None)
    if own is not None:

        def prepare(frame: Frame, /) -> Any:
            with _watch(offer, f"preparing {frame.name}"):
                return own(frame.without_truth())

        propose.prepare = prepare  # type: ignore[attr-defined]
    return propose


class GuardedCalibrator:
    """A plugin's whole method, with what it prepares of frames; calling it does both.

    `prepares` is False for a plain function of frames: it is handed the frames themselves.
    """

    def __init__(self, offer: Offer, stage: Any) -> None:
        self._offer, self._stage = offer, stage
        self.prepares = callable(getattr(stage, "prepare", None)) and callable(getattr(stage, "solve", None))
        if not self.prepares and not callable(stage):
            raise _fault(offer, f"build returned {type(stage).__name__}", "prepare() and solve(), or something to call")

    def prepare(self, frame: Frame, /) -> Any:
        """Return what the method prepares of a frame, which it sees without its truth."""
        frame = frame.without_truth()
        if not self.prepares:
            return frame
        with _watch(self._offer, f"preparing {frame.name}"):
            return self._stage.prepare(frame)

    def solve(self, prepared: Sequence[Any], camera_from_lidar: Float, /) -> Result:
        """Return the result of what was prepared, from a start (4, 4)."""
        with _watch(self._offer, "calibrating"):
            solve = self._stage.solve if self.prepares else self._stage
            result: Result = solve(list(prepared), camera_from_lidar)
        _typed(self._offer, result, Result)
        return replace(result, camera_from_lidar=_pose(self._offer, result.camera_from_lidar))

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        return self.solve([self.prepare(frame) for frame in frames], camera_from_lidar)


class GuardedAccumulator:
    """A plugin's accumulator whose joined sweep is checked."""

    def __init__(self, offer: Offer, stage: Any) -> None:
        if not callable(stage):
            raise _fault(offer, f"build returned {type(stage).__name__}", "something to call")
        self._offer, self._stage = offer, stage
        self.past, self.future = (self._wanted(name) for name in ("past", "future"))

    def _wanted(self, name: str) -> int:
        count = getattr(self._stage, name, None)
        if not isinstance(count, int) or count < 0:
            raise _fault(self._offer, f"`{name}` is {count!r}", "how many frames it wants, a number >= 0")
        return count

    def __call__(self, frames: Sequence[Frame], number: int, /) -> Cloud:
        with _watch(self._offer, f"joining the sweeps around {frames[number].name}"):
            cloud = self._stage(frames, number)
        _typed(self._offer, cloud, Cloud)
        joined: Cloud = cloud
        return joined


def _exporter(offer: Offer, stage: Callable[..., Any]) -> Any:
    def export(result: Result, path: Path, /) -> None:
        with _watch(offer, f"writing {path}"):
            stage(result, path)

    return export


_GUARDS: dict[Kind, Callable[[Offer, Callable[..., Any]], Any]] = {
    Kind.IMAGE_EXTRACTOR: _extractor,
    Kind.CLOUD_EXTRACTOR: _extractor,
    Kind.MATCHER: _matcher,
    Kind.SOLVER: _solver,
    Kind.INITIALIZER: _initializer,
    Kind.EXPORTER: _exporter,
}

_CLASSES: dict[Kind, Callable[[Offer, Any], Any]] = {
    Kind.DATASET: GuardedDataset,
    Kind.CALIBRATOR: GuardedCalibrator,
    Kind.ACCUMULATOR: GuardedAccumulator,
}
