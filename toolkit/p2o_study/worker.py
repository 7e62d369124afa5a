"""The jobs of a study's workers: read a frame, extract features, calibrate. Each job is self-contained.

A worker process caches plugins, datasets, stages and features, which successive jobs share.
"""

from __future__ import annotations

import json
import os
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from p2o.arrays import Float, leaves
from p2o.cache import FeatureCache, content_hash
from p2o.calibration.version import ALGORITHM
from p2o.errors import InputError, P2OError, one_line
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.host.guard import GuardedDataset
from p2o.host.method import Kind
from p2o.host.registry import Registry
from p2o.host.slots import WITNESS
from p2o.results.figures import figure_values
from p2o.results.result import Result, Status
from p2o.run.assembly import INPUTS, Assembly, given
from p2o.run.fit import contents_of
from p2o.run.joined import JoinedFrames
from p2o.run.pipeline import Pipeline
from p2o.run.read_again import FrameInfo, ReadAgain
from p2o.run.recipe import Part, Plan, Recipe, open_dataset
from p2o.run.rig_motion import CameraSweeps, with_common_motions
from p2o.run.rig_solve import RigCameraFrames, solve_rig

from p2o_study.damage import Damage
from p2o_study.keys import method_content
from p2o_study.machine import machine_info
from p2o_study.parallel import limit_threads
from p2o_study.row import UNREADABLE, Row, brief_figures

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")

_DIGEST_DECIMALS = 6

_FEATURES_IN_MEMORY = 128
"""Number of features in memory: enough for the joint calibration of a few dozen frames."""
_FRAMES_BYTES = 256 * 2**20
"""Size of frames in memory, about 30 frames of KITTI: calibrators read all frames of a joint row for every seed."""


@dataclass(frozen=True)
class Plugins:
    """The plugins to load, as parameters of `Registry.load`; every worker loads them."""

    only: tuple[str, ...] | None = None
    block: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @classmethod
    def of(cls, block: Iterable[str] = (), files: Iterable[str | Path] = ()) -> Plugins:
        """Return the plugins selected by `P2O_PLUGINS` and the command line, also valid on other machines."""
        chosen = os.environ.get("P2O_PLUGINS")
        only = None if chosen is None else tuple(chosen.split(","))
        return cls(only, tuple(block), tuple(str(Path(file).resolve()) for file in files))

    def registry(self) -> Registry:
        """Return the registry of this process."""
        return _registry(self)


@dataclass(frozen=True)
class Source:
    """One frame of a dataset, not read yet. `options` is JSON.

    `accumulate` is JSON of name and options of the accumulator, or empty.
    """

    plugins: Plugins
    data: str
    options: str
    index: int
    name: str
    accumulate: str = ""


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """The data of a frame that planning needs; `inputs` are content hashes of its parts.

    `digests` are hashes of image, sweep and calibration that are equal on all machines (`portable_hash`), `contents`
    the words for its optional content, such as "rings". Hashes of a computed frame are those of its `Identity`. For a
    frame that cannot be read, `failure` is the traceback and `reason` one line. `cache_error` is the reason if features
    could not be cached.
    """

    source: Source
    inputs: Mapping[str, str]
    camera: Camera | None = None
    camera_from_lidar: Float | None = None
    start: Float | None = None
    camera_name: str = ""
    twist: Float | None = None
    warnings: tuple[str, ...] = ()
    digests: Mapping[str, str] = field(default_factory=dict)
    contents: tuple[str, ...] = ()
    reason: str = ""
    failure: str | None = None
    cache_error: str = ""

    @property
    def name(self) -> str:
        """Name of the frame."""
        return self.source.name


@dataclass(frozen=True, eq=False)
class CalibrateJob:
    """A job to compute one row: `row` has the fields known in advance, `recipe` (JSON) the methods.

    `keys` are the cache keys of the features of each frame by stage; stages without a key have no cached output.
    `damage` is applied to image features between extraction and calibration.

    `cameras` are the records of a rig by camera, that of the first frame first. The fixed transforms between the
    cameras are those of the ground truth of their frames. Features are extracted by the job: no record has `keys`.
    """

    row: Row
    recipe: str
    records: tuple[FrameRecord, ...]
    cache: Path
    keys: tuple[Mapping[str, str], ...]
    damage: Damage = field(default_factory=Damage)
    cameras: Mapping[str, tuple[FrameRecord, ...]] = field(default_factory=dict)


_RECORD_FORMAT = 3
_OF_FRAME = ("camera", "camera_from_lidar", "start", "camera_name", "twist", "warnings")


def read(source: Source, cache_folder: Path) -> FrameRecord:
    """Read a frame and return its record; a frame that cannot be read has a `failure`.

    A computed frame is not rendered if the cache has its record. Frames that are files are read each time.
    """
    cache = BestEffortCache(cache_folder)
    try:
        identity = identity_of(source)
        key = "" if identity is None else content_hash([_RECORD_FORMAT, ALGORITHM, identity])
        if key and (kept := cache.get(key)) is not None:
            return FrameRecord(source, **kept.features)
        frame = _frame(source)
        values = {name: getattr(frame, name) for name in _OF_FRAME}
        values |= {
            "inputs": input_hashes(frame) if identity is None else identity.input_hashes,
            "digests": content_digests(frame) if identity is None else identity.content_digests,
            "contents": tuple(sorted(contents_of(frame))),
        }
    except KeyboardInterrupt:
        raise
    except BaseException as problem:  # also SystemExit, which would end the worker
        return _failed_record(source, _one_line(problem), traceback.format_exc())
    if key:
        cache.put(key, values, 0.0)
    return FrameRecord(source, **values, cache_error=cache.cache_error)


def read_failed(source: Source, problem: P2OError) -> FrameRecord:
    """Return the record of a frame whose reading terminated every worker."""
    return _failed_record(source, str(problem), str(problem))


def _failed_record(source: Source, reason: str, failure: str) -> FrameRecord:
    hashes = dict.fromkeys(("image", "cloud", "frame", "sweep"), UNREADABLE)
    return FrameRecord(source, hashes, reason=reason, failure=failure)


@dataclass(frozen=True)
class Identity:
    """Digests of everything that determines a computed frame: `frame` without, `joined` with an accumulated sweep.

    Arrays of such frames differ between processors in the last bits, so that their hashes are not those of arrays.
    """

    frame: str
    joined: str

    @classmethod
    def of(cls, dataset: GuardedDataset, index: int, accumulator: Part | None) -> Identity | None:
        """Return the identity of a frame, None for frames that are read; `dataset` has no accumulated sweeps."""
        identity = dataset.identity(index)
        if identity is None:
            return None
        frame = content_hash(identity)
        if accumulator is None:
            return cls(frame, frame)
        # The neighbours of a frame are unknown until they are computed: all frames of the dataset count.
        return cls(frame, content_hash([frame, _all_identities(dataset), method_content(accumulator)]))

    @property
    def input_hashes(self) -> dict[str, str]:
        """The hashes of `input_hashes`."""
        words = {"image": (self.frame, "image"), "cloud": (self.joined, "cloud"), "sweep": (self.frame, "cloud")}
        return {name: content_hash(word) for name, word in {**words, "frame": (self.joined, "frame")}.items()}

    @property
    def content_digests(self) -> dict[str, str]:
        """The hashes of `content_digests`."""
        words = {"image": "image", "sweep": "cloud", "calibration": "calibration"}
        return {name: content_hash((self.frame, word)) for name, word in words.items()}


@lru_cache(maxsize=8)
def _all_identities(dataset: GuardedDataset) -> str:
    return content_hash([dataset.identity(index) for index in range(len(dataset))])


def identity_of(source: Source) -> Identity | None:
    """Return the identity of a computed frame, None for one that is read; the frame is not computed."""
    return Identity.of(_opened(replace(source, index=0, name="", accumulate="")), source.index, _accumulator(source))


def input_hashes(frame: Frame) -> dict[str, str]:
    """Return content hashes of the inputs of stages; "frame" is the input of a calibrator without its warnings."""
    seen = replace(frame.without_truth(), start=None, warnings=())
    cloud = content_hash(frame.cloud)
    return {
        "image": content_hash(frame.image),
        "cloud": cloud,
        "sweep": cloud if frame.sweep is None else content_hash(frame.sweep),
        "frame": content_hash(seen),
    }


def content_digests(frame: Frame) -> dict[str, str]:
    """Return the hashes of image, sweep and calibration of a frame (`portable_hash`)."""
    parts = {"image": frame.image, "sweep": frame.cloud if frame.sweep is None else frame.sweep}
    return {**{name: portable_hash(part) for name, part in parts.items()}, "calibration": portable_hash(frame.camera)}


def portable_hash(value: Any) -> str:
    """Return the hash of arrays and numbers rounded to 6 decimals: machines differ in the last bits of functions."""

    def rounded(leaf: Any) -> Any:
        if isinstance(leaf, np.ndarray) and leaf.dtype.kind == "f":
            return np.round(leaf.astype(np.float64), _DIGEST_DECIMALS) + 0.0  # without negative zeros
        return round(leaf, _DIGEST_DECIMALS) + 0.0 if isinstance(leaf, float) else leaf

    return content_hash(
        [[list(path) if isinstance(path, tuple) else path, rounded(leaf)] for path, leaf in leaves(value)]
    )


def extract(job: tuple[Source, Sequence[tuple[str, str, str]]], cache_folder: Path) -> str:
    """Extract features of a frame, each a key, a recipe (JSON) and a stage, unless they are cached.

    Return the reason if they could not be cached, else an empty text. An extractor that raises here raises again in the
    rows that need it, which report the error.
    """
    (source, wanted), cache = job, BestEffortCache(cache_folder)
    for key, recipe, stage in wanted:
        if not cache.has(key):
            try:
                prepared(cache, key, source, plan_of(source.plugins, recipe).parts[stage], stage)
            except KeyboardInterrupt:
                raise
            except BaseException:
                continue
    return cache.cache_error


def calibrate(job: CalibrateJob) -> Row:
    """Calibrate the frames of one camera, or of a rig, and return the complete row, also of an exception."""
    try:
        row = _filled(job.row, _rig_result(job) if job.cameras else _result(job))
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        row = replace(job.row, reason=_one_line(problem), exception=traceback.format_exc())
    machine = machine_info()
    environment = replace(row.environment, machine={name: v for name, v in machine.items() if name != "load"})
    return replace(row, environment=environment, load=float(machine["load"]), finished=now())


def calibration_failed(job: CalibrateJob, problem: P2OError) -> Row:
    """Return the row of a calibration that terminated every worker."""
    return replace(job.row, reason=str(problem), exception=str(problem), finished=now())


def now() -> str:
    """Return date and time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def prepared_stages(plan: Plan) -> tuple[str, ...]:
    """Return the stages of a plan whose output can be cached: extractors, and others that have `prepares`."""
    stages = [stage for stage in INPUTS if stage in plan.parts]
    return tuple(s for s in stages if s not in ("calibrator", "init") or built(plan.parts[s]).prepares)


def _filled(row: Row, result: Result) -> Row:
    row = replace(
        row,
        status=result.status,
        reason=result.reason,
        trust=result.verdict.trust,
        why=result.verdict.why or None,
        figures=brief_figures(figure_values(result)),
        estimate=result.camera_from_lidar if result.status.solved else None,
        rounds=result.rounds,
        matches=result.matches,
        seconds=result.seconds,
    )
    if row.error is not None and not np.isfinite([row.error.rotation_deg, row.error.translation_m]).all():
        raise InputError("the error of the estimate is not finite", got=f"camera_from_lidar {row.estimate}")
    return row


def _result(job: CalibrateJob) -> Result:
    assert job.row.case.start is not None
    plugins, cache, took = job.records[0].source.plugins, BestEffortCache(job.cache), []
    plan = plan_of(plugins, job.recipe)
    assembly = Assembly.of(plan.parts, plan.pipeline, built)
    limit_threads()

    def pieces(records: FrameRecord, keys: Mapping[str, str], stages: Iterable[str]) -> dict[str, Any]:
        values = {}
        for stage in stages:
            values[stage], seconds = prepared(cache, keys[stage], records.source, plan.parts[stage], stage)
            took.append(seconds)
        return values

    def features(info: FrameInfo, records: FrameRecord, keys: Mapping[str, str]) -> dict[str, Any]:
        values = pieces(records, keys, (stage for stage in assembly.stages if stage not in WITNESS))
        if "extractor" in values:
            values["extractor"] = job.damage.image_features(values["extractor"], info.camera, info.name)
        return values

    infos = [FrameInfo(r.name, r.camera, twist=r.twist) for r in job.records if r.camera is not None]
    each = list(zip(job.records, job.keys, strict=True))
    given_pieces: Sequence[Any]
    if assembly.reads_frames:
        given_pieces = ReadAgain(lambda number: _frame(job.records[number].source), range(len(each)), truth=False)
    else:
        given_pieces = [features(info, records, keys) for info, (records, keys) in zip(infos, each, strict=True)]
    result = assembly.calibrated(infos, given_pieces, job.row.case.start)
    result = with_cost_of_truth(assembly, infos, given_pieces, result, job.row.case.truth)
    # For cached features, the time of their extraction counts.
    seconds = {**result.seconds, "extract": sum(took)}
    result = assembly.checked(result, infos, lambda number: pieces(*each[number], WITNESS))
    warnings = [f"{records.name}: {text}" for records in job.records for text in records.warnings]
    return replace(result, seconds=seconds, warnings=(*warnings, *result.warnings))


def _rig_result(job: CalibrateJob) -> Result:
    """Return the common result of a rig as that of its first camera, which is the body: the other ones follow from it.

    As in `p2o run --rig`, each camera is calibrated alone, then all of them together.
    """
    start, plan = job.row.case.start, plan_of(job.records[0].source.plugins, job.recipe)
    assert start is not None
    assembly = Assembly.of(plan.parts, plan.pipeline, built)
    places, frames = {}, {}
    for name, records in job.cameras.items():
        pose, body = records[0].camera_from_lidar, job.records[0].camera_from_lidar
        assert pose is not None
        assert body is not None
        places[name] = pose @ se3.inverse(body)
        frames[name] = frames_of(records)
    limit_threads()
    began, names = time.perf_counter(), list(job.cameras)

    def solve(number: int, methods: Assembly) -> Result:
        return methods(frames[names[number]], places[names[number]] @ start)

    own = [solve(number, assembly) for number in range(len(names))]
    sweeps = [CameraSweeps.of(name, frames[name], result) for name, result in zip(names, own, strict=True)]
    own = with_common_motions(sweeps, assembly, solve)
    cameras = [RigCameraFrames(n, frames[n], places[n], result) for n, result in zip(names, own, strict=True)]
    common = solve_rig(assembly, cameras, places)
    unsolved = next((result.status for result in own if not result.status.solved), Status.NOT_OBSERVABLE)
    return Result(
        job.row.frames,
        start,
        start if common.body_from_lidar is None else common.body_from_lidar,
        unsolved if common.body_from_lidar is None else Status.CONVERGED,
        common.reason,
        covariance=common.covariance,
        accuracy=common.accuracy,
        verdict=common.verdict,
        seconds={"rig": time.perf_counter() - began},
    )


def frames_of(records: Sequence[FrameRecord]) -> Sequence[Frame]:
    """Return frames without ground truth; those that memory cannot hold are read again at each access."""
    for record in records:
        _frame(record.source)
    return ReadAgain(lambda number: _frame(records[number].source), range(len(records)), truth=False)


def with_cost_of_truth(
    assembly: Assembly, infos: Sequence[FrameInfo], pieces: Sequence[Any], result: Result, truth: Float | None
) -> Result:
    """Return the result with the cost of the true extrinsic (4, 4) minus that of the estimate, where both are known.

    Both poses are judged on the same points, with the motions that are expected before the calibration. A negative
    value is a failed search, a positive one a cost that prefers a wrong pose.
    """
    pipeline = assembly.calibrator
    if truth is None or result.judged is None or not isinstance(pipeline, Pipeline):
        return result
    views = pipeline.visible(assembly.views(pipeline, infos, pieces), result.start).corrected
    poses = [truth, result.camera_from_lidar]
    at_truth, at_result = pipeline.judge(views, result.start, poses).costs(poses)
    return replace(result, judged=replace(result.judged, excess_truth=at_truth - at_result))


@lru_cache(maxsize=4)
def _registry(plugins: Plugins) -> Registry:
    environ = {name: value for name, value in os.environ.items() if name != "P2O_PLUGINS"}
    return Registry.load(plugins.only, plugins.block, plugins.files, environ)


@lru_cache(maxsize=256)
def plan_of(plugins: Plugins, recipe: str) -> Plan:
    """Return the plan of a recipe (JSON), resolved once in this process."""
    return Recipe.of(**json.loads(recipe)).resolve(_registry(plugins))


@lru_cache(maxsize=8)
def _opened(source: Source) -> GuardedDataset:
    """Return the dataset of a source without index, name and accumulator."""
    return open_dataset(source.data, _registry(source.plugins), json.loads(source.options))


@lru_cache(maxsize=8)
def _dataset(source: Source) -> Any:
    """Return the dataset of a source without index and name, with accumulated sweeps if it has an accumulator."""
    dataset, accumulator = _opened(replace(source, accumulate="")), _accumulator(source)
    return dataset if accumulator is None else JoinedFrames(dataset, accumulator.build())


def _accumulator(source: Source) -> Part | None:
    if not source.accumulate:
        return None
    name, options = json.loads(source.accumulate)
    offer = _registry(source.plugins).find(Kind.ACCUMULATOR, name)
    return Part(offer, offer.method.options.model_validate(options))


class _Recent(Generic[_Key, _Value]):
    """The most recently used values of this process, up to a total size; at least one. Thread-safe."""

    def __init__(self, most: int, size: Callable[[_Value], int]) -> None:
        self.most, self.size = most, size
        self.values: OrderedDict[_Key, tuple[_Value, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _Key, make: Callable[[], _Value]) -> _Value:
        """Return the value of a key, which is made if it is not in memory."""
        with self._lock:
            if key in self.values:
                self.values.move_to_end(key)
                return self.values[key][0]
        value = make()
        with self._lock:
            self.values[key] = value, self.size(value)
            while len(self.values) > 1 and sum(size for _, size in self.values.values()) > self.most:
                self.values.popitem(last=False)
        return value


def _size(value: Any) -> int:
    """Return the size in bytes of all arrays in a value."""
    return sum(leaf.nbytes for _, leaf in leaves(value) if isinstance(leaf, np.ndarray))


_frames: _Recent[Source, Frame] = _Recent(_FRAMES_BYTES, _size)
_features: _Recent[str, tuple[Any, float]] = _Recent(_FEATURES_IN_MEMORY, lambda features: 1)


def _frame(source: Source) -> Frame:
    """Return a frame; the last ones stay in memory, because successive jobs use the same frames."""

    def read_frame() -> Frame:
        frame: Frame = _dataset(replace(source, index=0, name=""))[source.index]
        limit_threads()
        return frame

    return _frames.get(source, read_frame)


def part_name(part: Part) -> str:
    """Return a name that is equal for parts with the same method and options."""
    return f"{part.offer.kind} {part.offer.full_name} {part.options.model_dump_json()}"


_stages: dict[str, Any] = {}


def built(part: Part) -> Any:
    """Return the stage of a part, built once per method and options."""
    name = part_name(part)
    if name not in _stages:
        _stages[name] = part.build()
        limit_threads()
    return _stages[name]


class BestEffortCache(FeatureCache):
    """A cache whose write errors are recorded but not raised: a full disk costs time only."""

    cache_error: str = ""

    def put(self, key: str, features: Any, seconds: float) -> bool:
        try:
            return super().put(key, features, seconds)
        except InputError as problem:
            object.__setattr__(self, "cache_error", str(problem))
            return False


def prepared(cache: FeatureCache, key: str, source: Source, part: Part, stage: str) -> tuple[Any, float]:
    """Return the output of a stage for a frame and its time in s, from memory, the cache or the stage."""

    def find_or_compute() -> tuple[Any, float]:
        kept = cache.get(key, part.offer)
        if kept is not None:
            return kept.features, kept.seconds
        frame, method = _frame(source), built(part)
        prepare = method.prepare if stage in ("calibrator", "init") else method
        began = time.perf_counter()
        features = prepare(given(frame, stage))
        seconds = time.perf_counter() - began
        cache.put(key, features, seconds)
        return features, seconds

    return _features.get(key, find_or_compute)


def _one_line(problem: BaseException) -> str:
    text = one_line(problem)
    return text if isinstance(problem, P2OError) else f"{type(problem).__name__}: {text}"
