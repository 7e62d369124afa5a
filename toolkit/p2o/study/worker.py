"""What a worker of a study does: read a frame, extract features, calibrate. Each job says all that it needs.

A worker keeps what several jobs share (plugins, datasets, stages, features) for as long as it lives.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float, leaves, parts
from p2o.calibration.witness import witnessed
from p2o.errors import InputError, P2OError
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import AXES, pose_error
from p2o.host.method import Kind
from p2o.host.registry import Registry
from p2o.host.slots import WITNESS
from p2o.results.result import Result, Status
from p2o.results.result_json import result_to_dict
from p2o.run.assembly import INPUTS, Assembly, given
from p2o.run.joined import JoinedFrames
from p2o.run.recipe import Part, Plan, Recipe, open_dataset
from p2o.study.store import StoredRow
from p2o.work.cache import FeatureCache, content_hash, features_key
from p2o.work.parallel import limit_threads

UNREADABLE = "unreadable"
"""Stands for the content hash of a frame that cannot be read."""

# A joint calibration of a few dozen frames finds all its features in memory; longer ones read the cache again.
_FEATURES_IN_MEMORY = 128

# Whole methods see frames, in joint rows all of them for every seed: this holds about 30 frames of KITTI.
_FRAMES_BYTES = 256 * 2**20


@dataclass(frozen=True)
class Plugins:
    """Which plugins to load, as `Registry.load` takes them; every worker loads its own."""

    only: tuple[str, ...] | None = None
    block: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @classmethod
    def of(cls, block: Iterable[str] = (), files: Iterable[str | Path] = ()) -> Plugins:
        """Return the choice that `P2O_PLUGINS` and the command line make, for workers on other machines too."""
        chosen = os.environ.get("P2O_PLUGINS")
        only = None if chosen is None else tuple(chosen.split(","))
        return cls(only, tuple(block), tuple(str(Path(file).resolve()) for file in files))

    def registry(self) -> Registry:
        """Return the registry of this process."""
        return _registry(self)


@dataclass(frozen=True)
class Source:
    """One frame of a dataset: where it is, before it is read. `options` is JSON.

    `accumulate` is JSON of name and options of the method that joins sweeps, or empty.
    """

    plugins: Plugins
    data: str
    options: str
    index: int
    name: str
    accumulate: str = ""


@dataclass(frozen=True)
class Reading:
    """A frame to be read: `checks` are recipes (JSON) that it has to fit, `wanted` recipe and stage of extractors.

    The features of these are kept, so that the frame need not be read again.
    """

    source: Source
    cache: Path
    checks: tuple[str, ...] = ()
    wanted: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Facts:
    """What planning has to know about a frame; `inputs` are content hashes of its parts.

    `misfits` say by recipe of the `checks` what the frame lacks. `failure` is the traceback and `reason` one line
    where it cannot be read. `unkept` says why features could not be kept, if so.
    """

    source: Source
    inputs: Mapping[str, str]
    camera: Camera | None = None
    camera_from_lidar: Float | None = None
    start: Float | None = None
    camera_name: str = ""
    twist: Float | None = None
    warnings: tuple[str, ...] = ()
    misfits: Mapping[str, str] = field(default_factory=dict)
    reason: str = ""
    failure: str | None = None
    unkept: str = ""

    @property
    def name(self) -> str:
        """Name of the frame."""
        return self.source.name


@dataclass(frozen=True)
class Extraction:
    """What is to be prepared of one frame and kept: by key, the recipe (JSON) and the stage that names how."""

    source: Source
    cache: Path
    wanted: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class Extracted:
    """Reason and traceback by key of what could not be prepared; `unkept` says why the rest is not kept, if so."""

    failed: Mapping[str, tuple[str, str]]
    unkept: str = ""


@dataclass(frozen=True, eq=False)
class Calibration:
    """One row to compute: `row` has all fields that are known beforehand, `recipe` (JSON) the methods.

    `keys` are those of what is prepared of each frame, by stage; a stage without a key prepares nothing that is kept.
    """

    row: StoredRow
    recipe: str
    facts: tuple[Facts, ...]
    cache: Path
    keys: tuple[Mapping[str, str], ...]


def read(job: Reading) -> Facts:
    """Return the facts of a frame; a frame that cannot be read has a `failure`."""
    source, cache = job.source, _Keeper(job.cache)
    try:
        frame = _frame(source)
        hashes = _inputs(frame)
        found = {recipe: _misfit(_plan(source.plugins, recipe), frame) for recipe in job.checks}
        misfits = {recipe: misfit for recipe, misfit in found.items() if misfit}
        for recipe, stage in () if misfits else job.wanted:
            part = _plan(source.plugins, recipe).parts[stage]
            key = features_key(part, hashes[INPUTS[stage]])
            # What fails here fails again where a row needs it, and is told there.
            with contextlib.suppress(Exception, SystemExit):
                _piece(cache, key, source, part, stage)
    except (Exception, SystemExit) as problem:
        return _unread(source, _one_line(problem), traceback.format_exc())
    return Facts(
        source,
        hashes,
        frame.camera,
        frame.camera_from_lidar,
        frame.start,
        frame.camera_name,
        frame.twist,
        frame.warnings,
        misfits=misfits,
        unkept=cache.unkept,
    )


def unread(job: Reading, problem: P2OError) -> Facts:
    """Return the facts of a frame that no worker survived to read."""
    return _unread(job.source, str(problem), str(problem))


def _unread(source: Source, reason: str, failure: str) -> Facts:
    return Facts(
        source, dict.fromkeys(("image", "cloud", "frame", "sweep"), UNREADABLE), reason=reason, failure=failure
    )


def _inputs(frame: Frame) -> dict[str, str]:
    """Return content hashes of what stages look at; `frame` is all that a whole method sees, but for remarks."""
    seen = replace(frame.without_truth(), start=None, warnings=())
    cloud = content_hash(frame.cloud)
    return {
        "image": content_hash(frame.image),
        "cloud": cloud,
        "sweep": cloud if frame.sweep is None else content_hash(frame.sweep),
        "frame": content_hash(seen),
    }


def _misfit(plan: Plan, frame: Frame) -> str:
    try:
        plan.check_frame(frame)
    except InputError as problem:
        return str(problem)
    return ""


def extract(job: Extraction) -> Extracted:
    """Prepare what is not kept yet, and return what failed."""
    cache = _Keeper(job.cache)
    failed = {}
    for key, recipe, stage in job.wanted:
        if not cache.has(key):
            try:
                _piece(cache, key, job.source, _plan(job.source.plugins, recipe).parts[stage], stage)
            except (Exception, SystemExit) as problem:
                # A witness that cannot work leaves results unchecked, which their verdict says.
                if stage in WITNESS:
                    continue
                failed[key] = (_one_line(problem), traceback.format_exc())
    return Extracted(failed, cache.unkept)


def unextracted(job: Extraction, problem: P2OError) -> Extracted:
    """Return what `extract` does, where no worker survived it."""
    return Extracted({key: (str(problem), str(problem)) for key, _, _ in job.wanted})


def calibrate(job: Calibration) -> StoredRow:
    """Return the row with all that came out; what a method raises is in it, too."""
    try:
        row = _filled(job.row, _result(job))
    except (Exception, SystemExit) as problem:
        row = replace(job.row, reason=_one_line(problem), exception=traceback.format_exc())
    return replace(row, finished=now())


def uncalibrated(job: Calibration, problem: P2OError) -> StoredRow:
    """Return the row that no worker survived to compute."""
    return replace(job.row, reason=str(problem), exception=str(problem), finished=now())


def now() -> str:
    """Return the time of day in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def prepared_stages(plan: Plan) -> tuple[str, ...]:
    """Return the stages of a plan that prepare something which may be kept."""
    stages = [stage for stage in INPUTS if stage in plan.parts]
    return tuple(stage for stage in stages if _prepares(plan.parts[stage], stage))


def _prepares(part: Part, stage: str) -> bool:
    """Return whether a stage prepares something of frames that may be kept: extractors always do."""
    if stage == "calibrator":
        return bool(built(part).prepares)
    return stage != "init" or hasattr(built(part), "prepare")


def _filled(row: StoredRow, result: Result) -> StoredRow:
    plain = result_to_dict(result)
    row = replace(
        row,
        status=result.status.value,
        reason=result.reason,
        trust=result.verdict.trust,
        why=result.verdict.why,
        judged=plain["judged"],
        **_beside(result),
        estimate=result.camera_from_lidar,
        rounds=tuple(plain["rounds"]),
        matches=plain["matches"],
        seconds=plain["seconds"],
    )
    if row.truth is None or result.status is Status.STAGE_FAILED:
        return row
    error = pose_error(result.camera_from_lidar, row.truth)
    if not np.isfinite([error.rotation_deg, error.translation_m]).all():
        raise InputError("the error of the estimate is not finite", got=f"camera_from_lidar {row.estimate}")
    axes: dict[str, Any] = {axis: error.per_axis[axis] for axis in AXES}
    return replace(row, rotation_deg=error.rotation_deg, translation_m=error.translation_m, **axes)


def _beside(result: Result) -> dict[str, Any]:
    """Return the columns of what was found beside the pose; what is no number is None, as SQLite has it."""
    found: dict[str, Any] = {} if result.agreement is None else {"agreement": result.agreement.odds_ratio}
    for prefix, value in (("rival", result.rival), ("likely", result.accuracy)):
        found |= {f"{prefix}_{name}": part for name, part in parts(value) or () if name not in AXES}
    if result.time is not None:
        found |= {"time_offset_s": result.time.offset_s, "time_sigma_s": result.time.sigma_s}
        found["time_use"] = "used" if result.time.used else "told"
    return {name: None if value != value else value for name, value in found.items()}


def _result(job: Calibration) -> Result:
    assert job.row.start is not None
    plugins, cache, took = job.facts[0].source.plugins, _Keeper(job.cache), []
    plan = _plan(plugins, job.recipe)
    assembly = Assembly.of(plan.parts, plan.pipeline, built)
    limit_threads()

    def pieces(facts: Facts, keys: Mapping[str, str], stages: Iterable[str]) -> dict[str, Any]:
        found = {}
        for stage in stages:
            if stage in keys:
                found[stage], seconds = _piece(cache, keys[stage], facts.source, plan.parts[stage], stage)
                took.append(seconds)
            else:
                found[stage] = _frame(facts.source).without_truth()
        return found

    frames = [(facts.name, _camera(facts), facts.twist) for facts in job.facts]
    own = [stage for stage in assembly.stages if stage not in WITNESS]
    each = list(zip(job.facts, job.keys, strict=True))
    result = assembly.calibrated(frames, [pieces(facts, keys, own) for facts, keys in each], job.row.start)
    # Where features came from the cache, what they took when they were extracted is what counts.
    seconds = {**result.seconds, "extract": sum(took)}
    if result.status.solved and result.agreement is None:
        views = []
        for (name, camera, twist), (facts, keys) in zip(frames, each, strict=True):
            # The witness was not asked for by name: where it cannot work, the verdict says that nothing was checked.
            with contextlib.suppress(P2OError):
                if all(stage in keys for stage in WITNESS):
                    image, cloud = pieces(facts, keys, WITNESS).values()
                    views.append(View(name, camera_at_scale(camera), image, cloud, twist))
        result = witnessed(result, views, assembly.options, assembly.witness)
    warnings = [f"{facts.name}: {text}" for facts in job.facts for text in facts.warnings]
    return replace(result, seconds=seconds, warnings=(*warnings, *result.warnings))


def _camera(facts: Facts) -> Camera:
    assert facts.camera is not None
    return facts.camera


@lru_cache(maxsize=4)
def _registry(plugins: Plugins) -> Registry:
    environ = {name: value for name, value in os.environ.items() if name != "P2O_PLUGINS"}
    return Registry.load(plugins.only, plugins.block, plugins.files, environ)


@lru_cache(maxsize=256)
def _plan(plugins: Plugins, recipe: str) -> Plan:
    return Recipe.of(**json.loads(recipe)).resolve(_registry(plugins))


@lru_cache(maxsize=8)
def _dataset(source: Source) -> Any:
    """Return the dataset of a source without index and name, its sweeps joined where the source says so."""
    registry = _registry(source.plugins)
    dataset = open_dataset(source.data, registry, json.loads(source.options))
    if not source.accumulate:
        return dataset
    name, options = json.loads(source.accumulate)
    offer = registry.find(Kind.ACCUMULATOR, name)
    return JoinedFrames(dataset, Part(offer, offer.method.options.model_validate(options)).build())


_frames: OrderedDict[Source, tuple[Frame, int]] = OrderedDict()
_frames_lock = threading.Lock()


def _frame(source: Source) -> Frame:
    """Return a frame; the last ones stay in memory, as a row runs through its frames seed by seed."""
    with _frames_lock:
        if source in _frames:
            _frames.move_to_end(source)
            return _frames[source][0]
    frame: Frame = _dataset(replace(source, index=0, name=""))[source.index]
    limit_threads()
    with _frames_lock:
        _frames[source] = frame, _size(frame)
        while len(_frames) > 1 and sum(size for _, size in _frames.values()) > _FRAMES_BYTES:
            _frames.popitem(last=False)
    return frame


def _size(value: Any) -> int:
    """Return the bytes of all arrays in a value."""
    return sum(leaf.nbytes for _, leaf in leaves(value) if isinstance(leaf, np.ndarray))


def part_name(part: Part) -> str:
    """Return a name that two parts share exactly if they are the same method with the same options."""
    return f"{part.offer.kind} {part.offer.full_name} {part.options.model_dump_json()}"


_stages: dict[str, Any] = {}


def built(part: Part) -> Any:
    """Return the stage of a part; one of the same method and options is built once."""
    name = part_name(part)
    if name not in _stages:
        _stages[name] = part.build()
        limit_threads()
    return _stages[name]


_memory: OrderedDict[str, tuple[Any, float]] = OrderedDict()
_memory_lock = threading.Lock()


class _Keeper(FeatureCache):
    """A cache that goes on without being kept: a full disk costs time, but no row."""

    unkept: str = ""

    def put(self, key: str, features: Any, seconds: float) -> bool:
        try:
            return super().put(key, features, seconds)
        except InputError as problem:
            object.__setattr__(self, "unkept", str(problem))
            return False


def _piece(cache: FeatureCache, key: str, source: Source, part: Part, stage: str) -> tuple[Any, float]:
    """Return what a stage prepares of a frame and the seconds that it took: from memory, the cache, or the stage."""
    with _memory_lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    kept = cache.get(key, part.offer)
    if kept is not None:
        features, seconds = kept.features, kept.seconds
    else:
        frame, method = _frame(source), built(part)
        prepare = method.prepare if stage in ("calibrator", "init") else method
        began = time.perf_counter()
        features = prepare(given(frame, stage))
        seconds = time.perf_counter() - began
        cache.put(key, features, seconds)
    with _memory_lock:
        _memory[key] = features, seconds
        while len(_memory) > _FEATURES_IN_MEMORY:
            _memory.popitem(last=False)
    return features, seconds


def _one_line(problem: BaseException) -> str:
    text = " ".join(str(problem).split())
    return text if isinstance(problem, P2OError) else f"{type(problem).__name__}: {text}"
