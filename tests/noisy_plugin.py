"""A plugin that writes to standard output by every way that code has, and fails as the environment asks."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from typing import Any

import p2o

NOISE = "noise on standard output"
FORKS = iter(("returns", "raises"))
"""How the forked child of each call ends in the mode "fork"."""


def mode() -> str:
    """Return the failure that the environment asks for."""
    return os.environ.get("NOISY_MODE", "")


class TextlessError(Exception):
    """An exception whose text raises."""

    def __str__(self) -> str:
        raise RuntimeError("no text")


def make_noise() -> None:
    """Write to descriptor 1 from Python, a child process, the system and the buffer of the C library."""
    print(NOISE)
    print(NOISE, file=sys.__stdout__)
    os.write(1, f"{NOISE}\n".encode())
    subprocess.run([sys.executable, "-c", f"print('{NOISE}')"], check=True)
    ctypes.CDLL(None).printf(f"{NOISE}\n".encode())


def calibrate(frames: Any, start: Any) -> p2o.Result:
    """Return the initial guess, after the noise and the failure of NOISY_MODE."""
    make_noise()
    if mode() == "textless":
        raise TextlessError
    if mode() == "interrupt":
        raise KeyboardInterrupt
    if mode() == "fork":
        child = next(FORKS)
        if os.fork() == 0 and child == "raises":
            raise SystemExit(0)
    return p2o.Result(tuple(frame.name for frame in frames), start, start, p2o.Status.CONVERGED, "as planned")


make_noise()
if mode() == "textless-import":
    raise TextlessError
if mode() == "interrupt-import":
    raise KeyboardInterrupt


@p2o.hookimpl
def p2o_calibrators() -> Any:
    """Offer the method."""
    yield p2o.Method(name="noisy", summary="A test.", build=lambda options: calibrate)
