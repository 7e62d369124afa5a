"""Methods of known spread on the tiny frames of `study_plugin`, and the same frames without truth."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import p2o
from p2o import se3

from tests.study_plugin import TRUTH, Frames, TinyOptions


class Blind(Frames):
    """The tiny frames with an initial guess in place of the truth."""

    def __getitem__(self, index: Any) -> Any:
        return replace(super().__getitem__(index), camera_from_lidar=None, start=TRUTH)


def noise_of(names: Sequence[str], size: float) -> np.ndarray:
    """Return a tangent (6,) that depends on the frames only."""
    rng = np.random.default_rng(zlib.crc32(" ".join(names).encode()))
    return size * rng.normal(size=6)


def scattering(size: float) -> Callable[[Any], p2o.Calibrator]:
    """Return a method that is off by noise of this size (rad, m)."""

    def calibrate(frames: Any, start: Any) -> p2o.Result:
        names = tuple(frame.name for frame in frames)
        pose = TRUTH @ se3.exp(noise_of(names, size))
        return p2o.Result(names, start, pose, p2o.Status.CONVERGED, "as planned")

    return lambda options: calibrate


def staying(status: p2o.Status) -> Callable[[Any], p2o.Calibrator]:
    """Return a method that returns its initial guess."""

    def calibrate(frames: Any, start: Any) -> p2o.Result:
        return p2o.Result(tuple(frame.name for frame in frames), start, start, status, "it stays")

    return lambda options: calibrate


def elsewhere(options: Any) -> p2o.Calibrator:
    """Return a method that is right, and states the process in which it runs."""

    def calibrate(frames: Any, start: Any) -> p2o.Result:
        names = tuple(frame.name for frame in frames)
        return p2o.Result(names, start, TRUTH, p2o.Status.CONVERGED, f"process {os.getpid()}")

    return calibrate


METHODS = {
    "elsewhere": elsewhere,
    "sharp": scattering(0.001),
    "loose": scattering(0.01),
    "stuck": staying(p2o.Status.CONVERGED),
    "refusing": staying(p2o.Status.NO_EDGES),
}


@p2o.hookimpl
def p2o_datasets():
    yield p2o.Method(name="blind", build=Blind, options=TinyOptions, summary="Frames without truth.")


@p2o.hookimpl
def p2o_calibrators():
    for name, build in METHODS.items():
        yield p2o.Method(name=name, build=build, summary=f"A method that is {name}.")
