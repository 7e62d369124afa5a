"""A plugin of the tests: frames of the conformance stage, and a method that answers with its start."""

import asyncio
import os
import signal
import time
import warnings
from collections.abc import Sequence
from typing import Any

import p2o
from p2o.errors import Terminated


class Own(BaseException):
    """An exception that derives from BaseException alone, as some libraries define."""


EXCEPTIONS = {
    "ValueError": ValueError("no such luck"),
    "SystemExit": SystemExit(0),
    "GeneratorExit": GeneratorExit(),
    "CancelledError": asyncio.CancelledError(),
    "Own": Own("no such luck"),
}


class FakeOptions(p2o.Options):
    """How many frames there are, what they are called, and which of them cannot be read."""

    frames: int = p2o.field(2, ge=1, help="How many.")
    names: tuple[str, ...] = p2o.field((), help="Their names, instead of how many.")
    bad: int = p2o.field(-1, help="This one cannot be read.")


class SpyOptions(p2o.Options):
    """How the method ends."""

    hang_at: int = p2o.field(-1, help="Never end with this frame, and say so.")
    warn: bool = p2o.field(False, help="Let Python warn.")
    raises: str = p2o.field("ValueError", help="What `fail_at` raises: the name of an exception.")
    fail_at: int = p2o.field(-1, help="Raise on this frame.")
    end_on: str = p2o.field("", help="End the process on the frame of this name.")
    end_by: str = p2o.field("SIGSEGV", help="The signal that ends it, or `exit`.")
    interrupt_at: int = p2o.field(-1, help="Press Ctrl-C on this frame.")
    status: str = p2o.field("converged", help="How it ends.")


class Frames(Sequence[p2o.Frame]):
    """The conformance stage under many names."""

    def __init__(self, options: FakeOptions) -> None:
        self.options = options
        self.names = options.names or tuple(f"drive/{i:04d}" for i in range(options.frames))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: Any) -> Any:
        from p2o_testing import stage

        if index == self.options.bad:
            raise p2o.InputError("the image is cut short", where="a.png")
        frame = stage.frame()
        return p2o.Frame(self.names[index], frame.image, frame.cloud, camera_from_lidar=frame.camera_from_lidar)


def build(options: SpyOptions) -> p2o.Calibrator:
    """Return a method that prints, counts its calls, and answers with its start."""
    calls = []

    def calibrate(frames: Any, start: Any) -> p2o.Result:
        print("a plugin that prints")
        calls.append(frames)
        if len(calls) - 1 == options.hang_at:
            print("hanging", flush=True)
            time.sleep(600)
        if options.warn:
            warnings.warn("a\nwarning of Python", RuntimeWarning, stacklevel=1)
        if frames[0].name == options.end_on:
            if options.end_by == "exit":
                os._exit(0)
            os.kill(os.getpid(), getattr(signal, options.end_by))
        if len(calls) - 1 == options.fail_at:
            raise EXCEPTIONS[options.raises]
        if len(calls) - 1 == options.interrupt_at:
            raise Terminated  # as Ctrl-C does
        names = tuple(frame.name for frame in frames)
        return p2o.Result(names, start, start, p2o.Status(options.status), "because it is a test")

    return calibrate


@p2o.hookimpl
def p2o_datasets():
    """Offer the frames."""
    yield p2o.Method(name="fake", build=Frames, options=FakeOptions, summary="Frames of the test stage.")


@p2o.hookimpl
def p2o_calibrators():
    """Offer the method."""
    yield p2o.Method(name="spy", build=build, options=SpyOptions, summary="Answers with its start.")
