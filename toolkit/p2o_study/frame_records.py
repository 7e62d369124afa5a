"""Read the records of frames: those of computed frames are cached, so that a frame is not rendered for its record.

A computed frame is identified by its recipe (`worker.Identity`). Frames that are files are read each time.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import fields, replace
from functools import cache
from typing import Any

from p2o.cache import FeatureCache, content_hash
from p2o.calibration.version import ALGORITHM
from p2o.errors import InputError, P2OError
from p2o.host.slots import WITNESS
from p2o.run.assembly import INPUTS
from p2o.run.fit import FRAME_CONTENT
from p2o.run.recipe import Plan, Recipe

from p2o_study import worker
from p2o_study.keys import features_key
from p2o_study.worker import FrameRecord, Plugins, ReadJob, Source

_FORMAT = 2
_OF_THE_JOB = ("source", "missing_inputs", "cache_error", "reason", "failure")
"""Fields of a record that depend on more than the frame, or describe a failure."""


def read(job: ReadJob) -> FrameRecord:
    """Return the record of a frame as `worker.read`.

    A computed frame is not rendered if the cache has its record and the features that are wanted.
    """
    key = record_key(job.source)
    if not key:
        return worker.read(job)
    cached = FeatureCache(job.cache)
    kept = cached.get(key)
    record = None if kept is None else _restored(job.source, kept.features)
    if record is not None and _needed(job) <= set(record.contents) and _are_cached(job, record):
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
    """Return the cache key of the record of a computed frame, an empty text for any other frame."""
    identity = None
    # A dataset that cannot be opened is a failure of `worker.read`.
    with contextlib.suppress(P2OError):
        identity = worker.identity_of(source)
    return "" if identity is None else content_hash([_FORMAT, ALGORITHM, identity])


def _restored(source: Source, values: Any) -> FrameRecord | None:
    """Return the record of values from the cache; None where they are those of another version."""
    try:
        record = FrameRecord(source, **values)
        return record if set(record.digests) == {"image", "sweep", "calibration"} else None
    except TypeError:
        return None


def _are_cached(job: ReadJob, record: FrameRecord) -> bool:
    """Return whether the cache has all features that a job wants."""
    wanted = ((stage, _plan(job.source.plugins, recipe).parts[stage]) for recipe, stage in job.wanted)
    keys = (features_key(part, record.inputs[INPUTS[stage]]) for stage, part in wanted)
    return all(map(FeatureCache(job.cache).has, keys))


def _needed(job: ReadJob) -> set[str]:
    """Return the words for the content of frames that the methods of a job need."""
    return {word for recipe in job.checks for word in _needed_by(job.source.plugins, recipe)}


@cache
def _needed_by(plugins: Plugins, recipe: str) -> frozenset[str]:
    parts = _plan(plugins, recipe).parts.items()
    needs = (part.offer.method.needs for stage, part in parts if stage not in WITNESS)
    return frozenset().union(*needs) & FRAME_CONTENT.keys()


@cache
def _plan(plugins: Plugins, recipe: str) -> Plan:
    return Recipe.of(**json.loads(recipe)).resolve(plugins.registry())
