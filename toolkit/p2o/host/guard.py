"""Build the stages that plugins offer, and check their values: errors inside a stage name the plugin and the slot."""

from __future__ import annotations

import copy
import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from p2o.arrays import Float, checked
from p2o.calibration_files.calibration import Calibration, CalibrationReader, Source
from p2o.errors import InputError, PluginError
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.files.input_file import naming
from p2o.frames.cloud import Cloud
from p2o.frames.direction import range_remark
from p2o.frames.frame import Dataset, Frame, LazyFrames
from p2o.frames.sparse import SparseOptions, sparse
from p2o.geometry import se3
from p2o.geometry.camera import Camera, intrinsics_remark
from p2o.host.method import Kind
from p2o.host.registry import Offer, fault, watch
from p2o.host.stages import Accumulator, Calibrator, InitializerBase, Judge, JudgeBase, MatcherBase
from p2o.options import Options
from p2o.problems.distinct_views import one_per_scene, view_weights
from p2o.problems.point_to_line import PointToLine
from p2o.problems.points_on_rays import PointsOnRays
from p2o.problems.problem import LeastSquares, Objective, Problem
from p2o.results.evidence import Agreement
from p2o.results.result import Result, Solution, Status
from p2o.results.result_json import result_from_dict, result_to_dict

_T = TypeVar("_T")
_CHECKED_ON_CONSTRUCTION = (PointToLine, PointsOnRays)
"""Classes of the toolkit: their values are validated on construction, and their code is not a plugin's."""


def guarded_problem(offer: Offer, problem: Any) -> Problem:
    """Return the problem of a matcher with every later call checked.

    An exception, a wrong shape or NaN in its residuals, derivatives or costs is a PluginError that names the matcher.
    LeastSquares and Objective keep their class and attributes; any other object with `cost` becomes an Objective.
    Raises PluginError for anything else, and for weights or a Huber width that are invalid.
    """
    if type(problem) in _CHECKED_ON_CONSTRUCTION:
        return problem  # type: ignore[no-any-return]
    if isinstance(problem, LeastSquares):
        return _guarded_least_squares(offer, problem)
    if isinstance(problem, Objective):
        return _guarded_objective(offer, problem)
    if isinstance(problem, Problem):
        return _guarded_objective(offer, Objective(problem.cost))
    raise fault(offer, f"returned {type(problem).__name__}", "p2o.solving.Problem: an object with `cost(poses)`")


def _guarded_objective(offer: Offer, problem: Objective) -> Objective:
    guarded = copy.copy(problem)
    for name in ("cost", "gradient", "covariance"):
        function = getattr(problem, name)
        if function is not None:
            object.__setattr__(guarded, name, _checked_function(offer, name, function))
    return guarded


def _checked_function(offer: Offer, name: str, function: Callable[[Float], Any]) -> Callable[[Float], Float | None]:
    """Return the cost of poses (B, 4, 4), or gradient or covariance at a pose (4, 4), with its values checked."""

    def checked(poses: Float) -> Float | None:
        with watch(offer, f"computing its {name}"):
            returned = function(poses)
            if returned is None and name == "covariance":
                return None
            values = np.asarray(returned, dtype=np.float64)
        shape = {"cost": (len(poses),), "gradient": (6,), "covariance": (6, 6)}[name]
        return _require(offer, name, values, shape, finite=name != "cost")

    return checked


class _GuardedLeastSquares(LeastSquares):
    """Mixed in before the class of a plugin's problem, so that its instances stay instances of that class."""

    _offer: ClassVar[Offer]

    def residuals(self, camera_from_lidar: Float) -> Float:
        residuals = _numbers(self._offer, "computing residuals", super().residuals, camera_from_lidar)
        return _require_shape(self._offer, "residuals", residuals, (*np.shape(camera_from_lidar)[:-2], len(self)))

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        with watch(self._offer, "computing residuals and derivatives"):
            residuals, jacobian = map(_floats, super().residuals_with_jacobian(camera_from_lidar))
        _require_shape(self._offer, "residuals", residuals, (len(self),))
        _require_shape(self._offer, "the Jacobian", jacobian, (len(self), 6))
        # Measurements that are unseen (NaN) or beyond `far` are replaced by a constant: they need no derivatives.
        if not np.isfinite(jacobian[np.abs(residuals) < self.far]).all():
            raise fault(self._offer, "the Jacobian of visible measurements contains NaN or infinity", "finite numbers")
        return residuals, jacobian

    def cost(self, poses: Float) -> Float:
        costs = _numbers(self._offer, "computing its cost", super().cost, poses)
        return _require(self._offer, "cost", costs, (len(poses),))

    def loss(self, residuals: Float) -> Float:
        loss = _numbers(self._offer, "computing its loss", super().loss, residuals)
        return _require(self._offer, "loss", loss, loss.shape)

    def robust_weight(self, residuals: Float) -> Float:
        weight = _numbers(self._offer, "computing robust weights", super().robust_weight, residuals)
        return _require_shape(self._offer, "robust weights", weight, (len(self),))

    def depth_m(self, camera_from_lidar: Float) -> float:
        with watch(self._offer, "computing the mean depth"):
            return float(super().depth_m(camera_from_lidar))


def _guarded_least_squares(offer: Offer, problem: LeastSquares) -> LeastSquares:
    with watch(offer, "describing its residuals"):
        weight = np.asarray(problem.weight, dtype=np.float64)
        count, frame, huber, far = len(problem), np.shape(problem.frame), float(problem.huber), float(problem.far)
    _require_shape(offer, "weight", weight, (count,))
    if not (np.isfinite(weight).all() and (weight >= 0).all()):
        raise fault(offer, "weight is negative, NaN or infinite", "weights >= 0")
    if frame != (count,):
        raise fault(offer, f"frame has shape {frame}", f"({count},): the view of each residual")
    if not (huber > 0 and far > 0):
        raise fault(offer, f"huber is {huber:g} and far is {far:g}", "widths above zero")
    with watch(offer, "copying its problem"):
        guarded, cls = copy.copy(problem), cast(Any, type(problem))
        object.__setattr__(guarded, "__class__", _guarded_class(offer, cls))
    return guarded


@cache
def _guarded_class(offer: Offer, cls: Any) -> type[LeastSquares]:
    """Return the subclass of a plugin's problem whose methods check what the plugin's methods return."""
    return type(cls.__name__, (_GuardedLeastSquares, cls), {"_offer": offer, "__module__": cls.__module__})


@dataclass(frozen=True, eq=False)
class GuardedJudge(JudgeBase):
    """A matcher's own judge whose costs, poses and covariances are checked; infinite costs are allowed, NaN is not."""

    offer: Offer
    judge: Judge
    name: str
    unit: str
    camera_errors: tuple[bool, bool, bool, bool]
    min_cells: int
    weights_views: bool = True

    @classmethod
    def of(cls, offer: Offer, judge: Any, *, weights_views: bool = True) -> GuardedJudge:
        """Return the judge with every later call checked; raises PluginError where it is no p2o.Judge."""
        with watch(offer, "naming its judge"):
            if not isinstance(judge, Judge):
                raise fault(
                    offer, f"judge returned {type(judge).__name__}", "p2o.Judge: name, unit, costs, lead and on"
                )
            capable = judge if isinstance(judge, JudgeBase) else JudgeBase
            name, unit = str(judge.name), str(judge.unit)
        return cls(offer, judge, name, unit, capable.camera_errors, capable.min_cells, weights_views)

    def costs(self, poses: Sequence[Float], /) -> list[float]:
        costs = _numbers(self.offer, "judging poses", self.judge.costs, poses)
        return _require(self.offer, "costs of the judge", costs, (len(poses),)).tolist()  # type: ignore[no-any-return]

    def lead(self, best: float, other: float, /) -> tuple[float, str]:
        with watch(self.offer, "comparing two costs"):
            lead, unit = self.judge.lead(best, other)
            return float(lead), str(unit)

    def on(self, views: Sequence[View], /) -> GuardedJudge:
        with watch(self.offer, "moving its judge to other views"):
            moved = self.judge.on(views if self.weights_views else one_per_scene(views))
        return GuardedJudge.of(self.offer, moved, weights_views=self.weights_views)

    def agreement(self, views: Sequence[View], pose: Float, /) -> Agreement | None:
        if not isinstance(self.judge, JudgeBase):
            return super().agreement(views, pose)
        with watch(self.offer, "computing the agreement"):
            agreement = self.judge.agreement(views, pose)
        return None if agreement is None else _typed(self.offer, agreement, Agreement)

    def covariance(self, pose: Float, /) -> Float | None:
        with watch(self.offer, "estimating the covariance"):
            value = self.judge.covariance(pose) if isinstance(self.judge, JudgeBase) else None
            covariance = None if value is None else np.asarray(value, np.float64)
        return None if covariance is None else _require(self.offer, "covariance of the judge", covariance, (6, 6))

    def maximised(self, pose: Float, /) -> Float:
        if not isinstance(self.judge, JudgeBase):
            return pose
        with watch(self.offer, "refining a pose"):
            best = self.judge.maximised(pose)
        return _pose(self.offer, best)

    def rivals(self, pose: Float, count: int, /) -> list[Float]:
        with watch(self.offer, "proposing rivals"):
            rivals = self.judge.rivals(pose, count) if isinstance(self.judge, JudgeBase) else []
        return [_pose(self.offer, rival) for rival in rivals]


def _numbers(offer: Offer, doing: str, function: Callable[..., Any], *given: Any) -> Float:
    """Return what a function of a plugin computes as an array of floats."""
    with watch(offer, doing):
        return _floats(function(*given))


def _floats(values: Any) -> Float:
    """Return an array of floats; float32 stays float32. Raises TypeError for complex numbers, texts and times."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiubO":
        raise TypeError(f"these are not real numbers but {array.dtype}")
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def _require_shape(offer: Offer, what: str, values: Float, shape: tuple[int, ...]) -> Float:
    if values.shape != shape:
        raise fault(offer, f"{what} returned shape {values.shape}", str(shape))
    return values


def _require(offer: Offer, what: str, values: Float, shape: tuple[int, ...], *, finite: bool = False) -> Float:
    """Return values of this shape; raises PluginError for others, and for NaN or, with `finite`, infinities in them."""
    _require_shape(offer, what, values, shape)
    if finite and not np.isfinite(values).all():
        raise fault(offer, f"{what} returned NaN or infinity", "finite numbers")
    if np.isnan(values).any():
        raise fault(offer, f"{what} returned NaN", "numbers")
    return values


def _require_covariance(offer: Offer, covariance: Float) -> None:
    """Raise PluginError for a covariance of another shape, NaN, infinities or negative variances."""
    _require(offer, "covariance", covariance, (6, 6), finite=True)
    if (np.diagonal(covariance) < 0).any():
        raise fault(offer, "covariance has a negative variance", "a diagonal >= 0, in rad^2 and m^2")


@contextmanager
def _calling(offer: Offer, doing: str) -> Iterator[None]:
    """Watch a call that returns values: an InputError without place and next step is about one of them."""
    try:
        with watch(offer, doing):
            yield
    except InputError as problem:
        if problem.where is not None or problem.hint is not None:
            raise
        raise fault(offer, f"{doing}: {problem}") from problem


def build(offer: Offer, options: Options) -> Any:
    """Return the stage of an offer, guarded; heavy packages are imported here.

    A guarded stage raises PluginError, naming plugin and stage, where the plugin raises anything but a P2OError or
    returns a wrong type, a wrong shape or NaN. Raises MethodUnavailable where a package is not installed.
    """
    # Up to Python 3.11, `isinstance` with a protocol reads properties of the plugin's class.
    with watch(offer, "building"):
        stage = offer.method.build(options)
        guarded = _GUARDS[offer.kind]
        return guarded(offer, stage, options) if offer.kind is Kind.DATASET else guarded(offer, stage)


class _Guarded:
    """A plugin's stage, and its offer, which errors name; `types` are those that it has to have, in words `wanted`."""

    types: tuple[Any, ...] = (Callable,)
    wanted = "something to call"

    def __init__(self, offer: Offer, stage: Any) -> None:
        if not isinstance(stage, self.types):
            raise fault(offer, f"build returned {type(stage).__name__}", self.wanted)
        self._offer, self._stage = offer, stage

    def _prepared(self, frame: Frame) -> Any:
        """Return what the method prepares of a frame without truth; raises PluginError for None and for code.

        A function or an iterator would be evaluated later, perhaps in another process or several times.
        """
        with watch(self._offer, f"preparing {frame.name}"):
            value = self._stage.prepare(frame.without_truth())
        if value is None or inspect.isroutine(value) or inspect.isclass(value) or isinstance(value, Iterator):
            expected = "the data of the frame that solve() needs, e.g. arrays or a dataclass"
            raise fault(self._offer, f"prepare returned {type(value).__name__} for {frame.name}", expected)
        return value


class GuardedDataset(_Guarded, Sequence[Frame]):
    """A plugin's dataset whose frames are checked as they are read."""

    types = (Dataset,)
    wanted = "a p2o.Dataset: names, len() and [index]"

    def __init__(self, offer: Offer, dataset: Any, options: Options) -> None:
        super().__init__(offer, dataset)
        self._sparse = options if isinstance(options, SparseOptions) else SparseOptions()
        with watch(offer, "listing frames"):
            self.names: tuple[str, ...] = tuple(dataset.names)
            count = len(dataset)
            # Names of frames that the reader left out, with the reason that a request for one is answered with.
            self.skipped: Mapping[str, str] = dataset.skipped if isinstance(dataset, LazyFrames) else {}
        if count != len(self.names) or not all(isinstance(name, str) for name in self.names):
            raise fault(offer, f"{len(self.names)} names for {count} frames", "one name for each frame")
        for name in self.names:
            try:
                name.encode()
            except UnicodeEncodeError as problem:
                # No result, row or report could hold it.
                raise InputError("the name of a frame is not UTF-8", got=name, hint="rename its files") from problem
        if len(set(self.names)) < len(self.names):
            twice = next(name for i, name in enumerate(self.names) if name in self.names[:i])
            raise fault(offer, f"two frames are called {twice!r}", "a name of its own for each frame")

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        with naming(Path(self.names[index])), watch(self._offer, f"reading frame {self.names[index]}"):
            frame = self._stage[index]
        if not isinstance(frame, Frame):
            raise fault(self._offer, f"frame {index} is {type(frame).__name__}", "p2o.Frame")
        if frame.name != self.names[index]:
            raise fault(self._offer, f"frame {index} is called {frame.name!r}", repr(self.names[index]))
        frame = sparse(frame, self._sparse)
        remark = (*intrinsics_remark(frame.camera), *range_remark(frame.cloud))
        return replace(frame, warnings=(*frame.warnings, *remark)) if remark else frame

    def identity(self, index: int) -> Any:
        """Return everything that determines a computed frame (JSON); None if its content has to be read.

        This is the optional method `identity(index)` of a dataset, with the name of the dataset and the options that
        all datasets share. Raises PluginError for a value that JSON cannot represent.
        """
        own = getattr(self._stage, "identity", None)
        with watch(self._offer, f"identifying frame {self.names[index]}"):
            identity = None if own is None else own(index)
        if identity is None:
            return None
        try:
            json.dumps(identity, allow_nan=False)
        except (TypeError, ValueError) as problem:
            raise fault(self._offer, f"identity of frame {index}: {problem}", "values of JSON, or None") from problem
        return [self._offer.full_name, identity, self._sparse.model_dump(include=set(SparseOptions.model_fields))]


def _pose(offer: Offer, value: Any) -> Float:
    try:
        return se3.check_rigid("camera_from_lidar", value)
    except InputError as problem:
        raise fault(offer, f"returned no rigid transform: {problem}") from problem


def _typed(offer: Offer, value: Any, wanted: type[_T]) -> _T:
    if not isinstance(value, wanted):
        raise fault(offer, f"returned {type(value).__name__}", f"p2o.{wanted.__name__}")
    return value


def check_features(offer: Offer, features: Any) -> None:
    """Raise PluginError where features are not what an extractor of this offer may return; other kinds return anything.

    What comes from a file is held to the same as what comes from the method.
    """
    if offer.kind in _FEATURES:
        kind, prefix = _FEATURES[offer.kind]
        _typed(offer, features, kind)
        missing = sorted(w for w in offer.method.gives if w.startswith(prefix) and w not in features.words)
        if missing:
            raise fault(offer, f"gave no {missing[0].removeprefix(prefix)}", f"{missing[0]}, as it says in `gives`")


_FEATURES = {Kind.IMAGE_EXTRACTOR: (ImageFeatures, "image-"), Kind.CLOUD_EXTRACTOR: (CloudFeatures, "cloud-")}


class _GuardedExtractor(_Guarded):
    """A plugin's extractor whose features are checked."""

    def __call__(self, image_or_cloud: Any, /) -> Any:
        with _calling(self._offer, "extracting"):
            features = self._stage(image_or_cloud)
        check_features(self._offer, features)
        return features


class GuardedMatcher(_Guarded, MatcherBase):
    """A plugin's matcher whose problems and judge are checked.

    Residuals count with the weights of their views. A cost that sums over views is made of one view per scene.
    """

    @property
    def _weights_views(self) -> bool:
        """Whether its problems have residuals, which can be weighted by view."""
        return "objective" not in self._offer.method.gives

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, reach_px: float, /) -> Problem:
        """Return the guarded problem of all views."""
        offer = self._offer
        with _calling(offer, "matching"):
            returned = self._stage(views if self._weights_views else one_per_scene(views), camera_from_lidar, reach_px)
            problem = guarded_problem(offer, returned)
        if not isinstance(problem, LeastSquares):
            return problem
        frame = np.asarray(problem.frame)
        if len(views) and frame.size and not 0 <= frame.min() <= frame.max() < len(views):
            raise fault(offer, f"frame contains {frame.min()} to {frame.max()}", f"views 0 to {len(views) - 1}")
        return problem.weighted(view_weights(views))

    def judge(self, views: Sequence[View], start: Float, poses: Sequence[Float], /) -> JudgeBase | None:
        """Return the matcher's own judge, guarded, or None."""
        if not isinstance(self._stage, MatcherBase):
            return None
        with watch(self._offer, "making its judge"):
            judge = self._stage.judge(views if self._weights_views else one_per_scene(views), start, poses)
        return None if judge is None else GuardedJudge.of(self._offer, judge, weights_views=self._weights_views)


class _GuardedSolver(_Guarded):
    """A plugin's solver whose solutions are checked."""

    def __call__(self, problem: Any, camera_from_lidar: Float, /) -> Solution:
        with _calling(self._offer, "solving"):
            solution = _typed(self._offer, self._stage(problem, camera_from_lidar), Solution)
            cost = _floats(solution.cost)
            covariance = None if solution.covariance is None else _floats(solution.covariance)
        _require(self._offer, "cost", cost, ())
        if covariance is not None:
            _require_covariance(self._offer, covariance)
        return replace(solution, camera_from_lidar=_pose(self._offer, solution.camera_from_lidar))


class GuardedInitializer(_Guarded, InitializerBase):
    """A plugin's initializer whose poses are checked."""

    def __init__(self, offer: Offer, stage: Any) -> None:
        super().__init__(offer, stage)
        self._start_sigma, self._reach = self._sizes("start_sigma"), self._sizes("reach")

    def _sizes(self, name: str) -> tuple[float, float] | None:
        """Return a property of the initializer in deg and m, or None; raises PluginError for other values."""
        if not isinstance(self._stage, InitializerBase):
            return None
        with watch(self._offer, f"reading {name}"):
            value: Any = getattr(self._stage, name)
        if value is None:
            return None
        if np.shape(value) != (2,) or not (np.isfinite(value).all() and np.all(np.asarray(value) > 0)):
            raise fault(self._offer, f"{name} is {value!r}", "degrees and metres, both above zero")
        return float(value[0]), float(value[1])

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, /) -> list[Float]:
        """Return at least one initial pose (4, 4), best first."""
        with _calling(self._offer, "looking for starts"):
            poses = list(self._stage(views, camera_from_lidar))
        if not poses:
            raise fault(self._offer, "proposed no start", "at least one pose")
        return [_pose(self._offer, pose) for pose in poses]

    @property
    def start_sigma(self) -> tuple[float, float] | None:
        return self._start_sigma

    @property
    def reach(self) -> tuple[float, float] | None:
        return self._reach

    @property
    def prepares(self) -> bool:
        if not isinstance(self._stage, InitializerBase):
            return False
        with watch(self._offer, "reading `prepares`"):
            return bool(self._stage.prepares)

    def prepare(self, frame: Frame, /) -> Any:
        """Return what the method prepares of a frame, which it receives without truth; None if it prepares nothing."""
        return self._prepared(frame) if self.prepares else None


class GuardedCalibrator(_Guarded):
    """A plugin's whole method, with what it prepares of frames; calling it does both.

    `prepares` is False for a plain function of frames: it is handed the frames themselves.
    """

    types = (Calibrator, Callable)
    wanted = "prepare() and solve(), or something to call"

    @property
    def prepares(self) -> bool:
        return isinstance(self._stage, Calibrator)

    def prepare(self, frame: Frame, /) -> Any:
        """Return what the method prepares of a frame, which it sees without its truth."""
        return self._prepared(frame) if self.prepares else frame.without_truth()

    def solve(self, prepared: Sequence[Any], camera_from_lidar: Float, /) -> Result:
        """Return the result of what was prepared, from a start (4, 4)."""
        start = checked("camera_from_lidar", camera_from_lidar, (4, 4), np.float64)
        with _calling(self._offer, "calibrating"):
            solve = self._stage.solve if self.prepares else self._stage
            # A plain function reads the frames itself: as a list, all of them would be in memory.
            result = _typed(self._offer, solve(list(prepared) if self.prepares else prepared, start), Result)
            if not isinstance(result.status, Status):
                raise fault(self._offer, f"the status is {result.status!r:.40}", "a p2o.Status")
            pose = _pose(self._offer, result.camera_from_lidar if result.status.solved else start)
            result = replace(result, start=start, camera_from_lidar=pose)
            checked_result = result_from_dict(result_to_dict(result))  # raises for a field of another type or shape
            if checked_result.covariance is not None:
                _require_covariance(self._offer, checked_result.covariance)
        return result

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        return self.solve([self.prepare(frame) for frame in frames], camera_from_lidar)


class _GuardedAccumulator(_Guarded):
    """A plugin's accumulator whose joined sweep is checked."""

    types = (Accumulator,)
    wanted = "something to call with `past` and `future`"

    def __init__(self, offer: Offer, stage: Any) -> None:
        super().__init__(offer, stage)
        with watch(offer, "reading `past` and `future`"):
            past, future = stage.past, stage.future
        for name, count in (("past", past), ("future", future)):
            if not isinstance(count, int) or count < 0:
                raise fault(offer, f"`{name}` is {count!r}", "a number of frames >= 0")
        self.past, self.future = past, future

    def __call__(self, frames: Sequence[Frame], number: int, /) -> Cloud:
        with watch(self._offer, f"joining the sweeps around {frames[number].name}"):
            cloud = self._stage(frames, number)
        return _typed(self._offer, cloud, Cloud)


class _GuardedExporter(_Guarded):
    """A plugin's exporter, whose errors name it."""

    def __call__(self, result: Result, path: Path, /) -> None:
        with watch(self._offer, f"writing {path}"):
            self._stage(result, path)


class GuardedReader(_Guarded):
    """A plugin's reader of calibration files, whose answers are checked."""

    types = (CalibrationReader,)
    wanted = "a CalibrationReader"

    def __init__(self, offer: Offer, reader: Any) -> None:
        super().__init__(offer, reader)
        with watch(offer, "reading its rank"):
            self.rank = reader.rank
        if not isinstance(self.rank, int):
            raise fault(offer, f"its rank is {self.rank!r}", "a whole number")

    def recognises(self, source: Source) -> bool:
        """Return whether a file has the format of the reader."""
        with watch(self._offer, f"recognising {source.path}"):
            answer = self._stage.recognises(source)
        if not isinstance(answer, bool | np.bool_):
            raise fault(self._offer, f"recognises returned {type(answer).__name__}", "True or False")
        return bool(answer)

    def read(self, source: Source) -> Calibration:
        """Return the content of a file.

        Raises InputError for wrong content, and PluginError also for an InputError that does not name the file:
        the reader has passed values on that it did not check.
        """
        try:
            with watch(self._offer, f"reading {source.path}"):
                calibration: Calibration = self._stage.read(source)
        except InputError as problem:
            if problem.where is not None:
                raise
            raise fault(self._offer, f"read {source.path} as an invalid calibration: {problem}") from problem
        except PluginError as problem:
            if isinstance(problem.__cause__, RecursionError):
                raise InputError("the calibration file is nested too deeply", where=source.path) from problem
            raise
        _typed(self._offer, calibration, Calibration)
        if calibration.camera is not None:
            _typed(self._offer, calibration.camera, Camera)
        texts = (calibration.lidar_frame, calibration.camera_frame, *calibration.remarks)
        if not (isinstance(calibration.remarks, tuple) and all(isinstance(text, str) for text in texts)):
            raise fault(self._offer, "frame names or remarks are not texts", "texts, and a tuple of texts")
        return calibration

    def example(self) -> bytes:
        """Return the content of the reader's example file."""
        with watch(self._offer, "making its example"):
            content = self._stage.example()
        if not isinstance(content, bytes) or not content:
            raise fault(self._offer, f"example returned {content!r:.40}", "the bytes of a file")
        return content


_GUARDS: dict[Kind, Callable[..., Any]] = {
    Kind.DATASET: GuardedDataset,
    Kind.IMAGE_EXTRACTOR: _GuardedExtractor,
    Kind.CLOUD_EXTRACTOR: _GuardedExtractor,
    Kind.MATCHER: GuardedMatcher,
    Kind.SOLVER: _GuardedSolver,
    Kind.INITIALIZER: GuardedInitializer,
    Kind.CALIBRATOR: GuardedCalibrator,
    Kind.ACCUMULATOR: _GuardedAccumulator,
    Kind.EXPORTER: _GuardedExporter,
    Kind.CALIBRATION_READER: GuardedReader,
}
