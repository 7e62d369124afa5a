"""The work on one drive: choose frames, estimate the error of the extrinsic from their edges, return evidence only."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from typing import Any

from p2o.arrays import Float
from p2o.confidence.audit import EdgeStep, Rates, audit
from p2o.confidence.audit import Evidence as EdgeEvidence
from p2o.confidence.frame_choice import SeenEdges, choose
from p2o.errors import InputError, P2OError, one_line, printable
from p2o.features.view import View
from p2o.frames.direction import Direction, pose_direction
from p2o.frames.frame import Frame
from p2o.frames.selection import select, spread
from p2o.problems.point_to_line import PointToLine
from p2o.results.check import Check, CheckStatus
from p2o.run.check import given_extrinsic
from p2o.run.initial_guess import one_camera
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Plan, Recipe, open_dataset
from p2o.run.run import frame_at
from p2o_study.parallel import limit_threads
from p2o_study.worker import Plugins, content_digests, portable_hash

from p2o_fleet.checks import valid_estimate
from p2o_fleet.drive import Drive
from p2o_fleet.evidence import Evidence, Verdict, estimate_columns

_REACH_PX = 15.0
"""Matching distance for the choice of frames, as in a check."""
_MAX_REASON, _MAX_NAME = 300, 100


@dataclass(frozen=True)
class CheckSettings:
    """How drives are checked: `frames` frames are chosen from `candidates` that are spread in time.

    `extractor` and `options` (JSON) are those of `p2o check`.
    """

    frames: int = 8
    candidates: int = 12
    extractor: str = "p2ornet/rings"
    options: str = "{}"

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= self.candidates:
            raise InputError("wrong number of frames", expected=f"1 to {self.candidates} candidates", got=self.frames)

    @property
    def text(self) -> str:
        """Return the settings as part of the key of a check."""
        return f"{self.frames}/{self.candidates} {self.extractor} {self.options}"


@dataclass(frozen=True)
class DriveJob:
    """A drive to check, with its key."""

    drive: Drive
    key: str
    settings: CheckSettings
    plugins: Plugins


def check_drive(job: DriveJob) -> Evidence:
    """Check the extrinsic of a drive; a log that cannot be checked returns the reason as evidence."""
    began = time.perf_counter()
    try:
        evidence = _checked(job)
    except P2OError as problem:
        evidence = unreadable(job, problem)
    except Exception as problem:  # damaged logs raise anything in readers and codecs; a fleet continues
        evidence = unreadable(job, P2OError(f"{type(problem).__name__}: {one_line(problem)}"))
    return replace(evidence, seconds=time.perf_counter() - began, version=version("p2o-calib"))


def unreadable(job: DriveJob, problem: P2OError) -> Evidence:
    """Return the evidence of a drive that could not be checked."""
    return Evidence(drive=job.drive, key=job.key, verdict=Verdict.UNREADABLE, reason=one_line(problem, _MAX_REASON))


def _checked(job: DriveJob) -> Evidence:
    plan, pipeline = _built(job.plugins, job.settings)
    limit_threads()
    dataset = open_dataset(job.drive.data, plan.registry)
    skipped = getattr(dataset, "skipped", {})
    indices = spread(select(dataset.names, job.drive.frames, where="frames", skipped=skipped), job.settings.candidates)
    frames, problems = _read(plan, dataset, indices)
    if len(frames) < min(len(indices), max(1, len(indices) // 2)):
        raise problems[0] if problems else InputError("the log contains no frames", where=job.drive.data)
    one_camera(frames)
    pose = given_extrinsic(job.drive.extrinsic, frames, plan.registry, "extrinsic").camera_from_lidar
    log = hashlib.sha256(json.dumps([content_digests(frame) for frame in frames], sort_keys=True).encode()).hexdigest()
    direction = pose_direction(frames[0].cloud, frames[0].camera, pose, name="the extrinsic")
    views = [pipeline.prepare(frame.without_truth()) for frame in frames]
    chosen = _informative(frames, views, pose, pipeline, job.settings.frames)
    step, check = _audited([views[number] for number in chosen], pose, pipeline)
    reason = check.reason
    if direction is Direction.POSSIBLY_INVERSE and check.holding is CheckStatus.CANNOT_TELL:
        reason = f"the extrinsic looks like lidar_from_camera; {reason}"
    figures = {} if step is None else estimate_columns(step.error, step.covariance)
    if check.agreement is not None:
        figures |= {"odds_ratio": check.agreement.odds_ratio, "cells": check.agreement.places}
    return Evidence(
        drive=job.drive,
        key=job.key,
        verdict=Verdict(check.holding.value),
        reason=one_line(reason, _MAX_REASON),
        **figures,
        camera_from_lidar=tuple(pose[:3].ravel().tolist()),
        frames=tuple(printable(frames[number].name, _MAX_NAME) for number in chosen),
        frame_count=len(chosen),
        log=log[:32],
        extrinsic_digest=portable_hash(pose)[:32],
    )


def _read(plan: Plan, dataset: Any, indices: Sequence[int]) -> tuple[list[Frame], list[P2OError]]:
    """Return the frames that can be read and have what the methods need, and the problems of the others."""
    frames, problems = list[Frame](), list[P2OError]()
    for index in indices:
        try:
            frame = frame_at(dataset, index)
            plan.check_frame(frame)
        except P2OError as problem:
            problems.append(problem)
        else:
            frames.append(frame)
    return frames, problems


def _informative(
    frames: Sequence[Frame], views: Sequence[View], pose: Float, pipeline: Pipeline, count: int
) -> list[int]:
    """Return the numbers of the frames whose edges add most information (`p2o data suggest`), in order of time."""
    if len(frames) <= count:
        return list(range(len(frames)))
    seen = []
    for number, (frame, view) in enumerate(zip(frames, views, strict=True)):
        pairs = pipeline.matcher([view.as_seen_from(pose).without_hidden(pose)], pose, _REACH_PX)
        if isinstance(pairs, PointToLine) and len(pairs):
            seen.append(SeenEdges(str(number), pairs, pose, frame.sequence, frame.lidar_world_from_lidar))
    if len(seen) < count:
        return spread(range(len(frames)), count)
    return sorted(int(step.name) for step in choose(seen, count=count))


def _audited(views: Sequence[View], pose: Float, pipeline: Pipeline) -> tuple[EdgeStep | None, Check]:
    """Return the step from the pose to that of the edges, if they give one, and the verdict on these frames.

    Only if edges near the pose do not confirm it, a search looks for a pose farther away.
    """
    for search in (False, True):
        evidence = EdgeEvidence.of(views, pose, pipeline, search=search)
        check = audit(evidence, Rates())
        if check.estimate is not None and check.holding is not CheckStatus.OFF:
            break
    step = evidence.far if evidence.led_away else evidence.near
    if not isinstance(step, EdgeStep) or check.estimate is None:
        return None, check
    return (step if valid_estimate(step.error[None], step.covariance[None]) else None), check


@lru_cache(maxsize=2)
def _built(plugins: Plugins, settings: CheckSettings) -> tuple[Plan, Pipeline]:
    """Return the plan and the pipeline of this process; a network is loaded once."""
    recipe = Recipe.of(data=None, extractor=settings.extractor, options=json.loads(settings.options), joint=True)
    plan = recipe.resolve(plugins.registry())
    pipeline = plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    return plan, pipeline
