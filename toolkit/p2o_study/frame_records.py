"""Read the records of frames: those of simulated frames are cached, so that a frame is rendered once for its digests.

The frames of a simulator depend on nothing but options, code and packages, all of which are in the key. Frames that are
files are read each time.
"""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from importlib.metadata import distributions
from typing import Any

from p2o.cache import FeatureCache, content_hash
from p2o.errors import InputError
from p2o.frames.frame import Frame
from p2o.host import guard
from p2o.host.method import Kind
from p2o.host.slots import WITNESS
from p2o.run.fit import FRAME_CONTENT
from p2o.run.joined import JoinedFrames
from p2o.run.recipe import Part, Recipe, dataset_part

from p2o_study import worker
from p2o_study.keys import method_content
from p2o_study.machine import machine_info
from p2o_study.sources import code_of, package_hash
from p2o_study.worker import FrameRecord, Plugins, ReadJob, Source

_FORMAT = 1
_SIMULATED = {"synthetic@p2o-calib": "p2o_sim"}
"""Datasets whose frames depend on options, code and packages only, with the package of the simulator."""
_OF_THE_JOB = ("source", "missing_inputs", "cache_error", "reason", "failure")
"""Fields of a record that depend on more than the frame, or describe a failure."""


def read(job: ReadJob) -> FrameRecord:
    """Return the record of a frame as `worker.read`; that of a simulated frame from the cache, if it is there."""
    key = "" if job.wanted else record_key(job.source)
    if not key:
        return worker.read(job)
    cached = FeatureCache(job.cache)
    kept = cached.get(key)
    if kept is not None:
        record = _restored(job.source, kept.features)
        if record is not None and _needed(job) <= set(record.contents):
            return record
    record = worker.read(job)
    if record.failure is None:
        values = {field.name: getattr(record, field.name) for field in fields(record)}
        try:
            cached.put(key, {name: value for name, value in values.items() if name not in _OF_THE_JOB}, 0.0)
        except InputError as problem:
            return replace(record, cache_error=str(problem))
    return record


def record_key(source: Source) -> str:
    """Return the cache key of the record of a simulated frame, an empty text for any other frame.

    It contains the options of the dataset, the code that renders, accumulates and hashes frames, all files of the
    simulator's package, the versions of all installed packages, and the processor.
    """
    registry = source.plugins.registry()
    part = dataset_part(source.data, registry, json.loads(source.options))
    package = _SIMULATED.get(part.offer.full_name)
    if package is None:
        return ""
    joins: Any = None
    if source.accumulate:
        name, options = json.loads(source.accumulate)
        offer = registry.find(Kind.ACCUMULATOR, name)
        accumulator = Part(offer, offer.method.options.model_validate(options))
        joins = [method_content(accumulator), code_of(JoinedFrames).hash]
    reading = (guard.build, Frame, FrameRecord, worker.input_hashes, worker.content_digests)
    machine = machine_info()
    return content_hash(
        {
            "format": _FORMAT,
            "frame": [source.index, source.name],
            "dataset": method_content(part),
            "package": [package_hash(package, code=is_code) for is_code in (True, False)],
            "joins": joins,
            "reading": code_of(*reading).hash,
            "packages": _packages(),
            "machine": [machine["processor"], machine["system"], machine["python"]],
        }
    )


@cache
def _packages() -> list[str]:
    """Return name and version of every installed package."""
    return sorted({f"{package.name} {package.version}" for package in distributions()})


def _restored(source: Source, values: Any) -> FrameRecord | None:
    """Return the record of values from the cache; None where they are those of another version."""
    try:
        record = FrameRecord(source, **values)
        return record if set(record.digests) == {"image", "sweep", "calibration"} else None
    except TypeError:
        return None


def _needed(job: ReadJob) -> set[str]:
    """Return the words for the content of frames that the methods of a job need."""
    return {word for recipe in job.checks for word in _needed_by(job.source.plugins, recipe)}


@cache
def _needed_by(plugins: Plugins, recipe: str) -> frozenset[str]:
    plan = Recipe.of(**json.loads(recipe)).resolve(plugins.registry())
    needs = (part.offer.method.needs for stage, part in plan.parts.items() if stage not in WITNESS)
    return frozenset().union(*needs) & FRAME_CONTENT.keys()
