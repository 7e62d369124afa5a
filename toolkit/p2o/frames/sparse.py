"""Sweeps with every n-th ring, or without rings: options of all data sets, so that LiDARs differ in nothing else."""

from __future__ import annotations

import zlib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from pydantic import create_model, field_validator

from p2o.arrays import Float, Int
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.rings import RingsUnknownError, rings_of
from p2o.options import Options
from p2o.options import field as option


class SparseOptions(Options):
    """Options of all data sets that simulate a LiDAR with fewer rings or without rings."""

    keep_rings: int = option(
        1, ge=1, le=64, help="Keep every n-th ring, from the highest (4 or 1/4: every fourth); 1 keeps all."
    )
    forget_rings: bool = option(
        False, help="Remove rings and firing columns, and shuffle the points, as in a cloud without rings."
    )

    @field_validator("keep_rings", mode="before")
    @classmethod
    def _step(cls, value: Any) -> Any:
        return value.removeprefix("1/") if isinstance(value, str) else value


@cache
def with_sparse_options(options: type[Options]) -> type[Options]:
    """Return the options of a data set with those of `SparseOptions`, unless it has options of these names itself."""
    if options.model_fields.keys() & SparseOptions.model_fields.keys():
        return options
    return create_model(options.__name__, __base__=(SparseOptions, options), __module__=options.__module__)


def sparse(frame: Frame, options: SparseOptions) -> Frame:
    """Return the frame with the sweep that the options ask for; rings that are kept are numbered from the highest.

    The order of shuffled points depends on the name of the frame only. Raises InputError if the rings to keep are
    unknown, or fewer than two.
    """
    cloud = frame.cloud
    if options.keep_rings > 1:
        cloud = _every(cloud, options.keep_rings, frame.name)
    if options.forget_rings:
        order = np.random.default_rng(zlib.crc32(frame.name.encode())).permutation(len(cloud))
        cloud = replace(cloud.select(order), ring=None, column=None)
    return frame if cloud is frame.cloud else replace(frame, cloud=cloud)


def _every(cloud: Cloud, step: int, where: str) -> Cloud:
    """Return the points of every `step`-th ring, with these rings numbered from the highest."""
    try:
        label, _ = rings_of(cloud)
    except RingsUnknownError as problem:
        text = f"cannot keep every {step}. ring: the rings of the cloud are not observable"
        raise InputError(text, where=where, got=problem.got, hint="leave out keep_rings") from problem
    count = int(label.max()) + 1
    if count <= step:
        text = f"keeping every {step}. ring leaves one ring"
        raise InputError(text, where=where, expected=f"keep_rings < {count}, the number of rings", got=step)
    rank = _from_top(label, cloud.as_measured())[label]
    chosen = rank % step == 0
    return replace(cloud.select(chosen), ring=rank[chosen] // step)


def _from_top(label: Int, xyz: Float) -> Int:
    """Return the rank (R,) of each ring from the highest, by the median elevation.

    Near objects may exchange adjacent rings, so that labels take precedence if they are monotonic nearly everywhere.
    """
    elevation = np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
    order = np.argsort(label, kind="stable")
    parts = np.split(elevation[order], np.flatnonzero(np.diff(label[order])) + 1)
    median = np.array([np.median(part) for part in parts])
    rising = np.mean(np.diff(median) > 0)
    if rising <= 0.1 or rising >= 0.9:
        median = np.arange(len(median)) * (1.0 if rising > 0.5 else -1.0)
    return np.argsort(np.argsort(-median, kind="stable"))
