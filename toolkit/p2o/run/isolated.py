"""Calibrate in a worker process: a plugin that crashes ends the worker, not the command."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from p2o.arrays import Float
from p2o.errors import P2OError, PluginError
from p2o.frames.frame import Frame
from p2o.host.calibration_file import names_file
from p2o.host.registry import Registry, reported_calls
from p2o.results.result import Result, RigResult
from p2o.run.assembly import Assembly
from p2o.run.recipe import Recipe
from p2o.run.rig_solve import RigCameraFrames, solve_rig


@dataclass(eq=False)
class IsolatedCalibration:
    """Calibrate frames in a worker process, which is replaced if it ends.

    The worker loads the plugins (`block`, `files`) and resolves the recipe (`words`) itself. A call raises PluginError
    if the process ends, and what the calibration raises.
    """

    words: dict[str, Any]
    block: Sequence[str] = ()
    files: Sequence[str] = ()
    _worker: _Worker | None = None

    def __call__(self, assembly: Assembly, frames: Sequence[Frame], camera_from_lidar: Float) -> Result:
        result: Result = self._done(assembly, Assembly.__call__, tuple(frames), camera_from_lidar)
        return result

    def rig(
        self, assembly: Assembly, cameras: Sequence[RigCameraFrames], camera_from_body: Mapping[str, Float]
    ) -> RigResult:
        """Return the common result of the cameras of a rig, as `solve_rig`."""
        sent = [replace(camera, frames=tuple(camera.frames)) for camera in cameras]
        result: RigResult = self._done(assembly, solve_rig, sent, dict(camera_from_body))
        return result

    def _done(self, assembly: Assembly, work: Callable[..., Any], *given: Any) -> Any:
        """Return the outcome of a function of the assembly and what is given, called in the worker."""
        if self._worker is None:
            self._worker = _Worker.start((json.dumps(self.words), tuple(self.block), tuple(self.files)))
        job = work, given, assembly.options, assembly.twists
        try:
            outcome = self._worker.answer(job)
        except PluginError:
            self.close()
            raise
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    def close(self) -> None:
        """Terminate the worker."""
        if self._worker is not None:
            self._worker.process.kill()
            self._worker.process.join()
            self._worker = None


@dataclass(eq=False)
class _Worker:
    """A process and the connection to it, over which it sends the call of a plugin that it runs, and outcomes."""

    process: Any
    connection: Any

    @classmethod
    def start(cls, setup: tuple[str, tuple[str, ...], tuple[str, ...]]) -> _Worker:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, *setup), daemon=True)
        process.start()
        # Only the worker keeps its end: it is closed when the worker ends.
        theirs.close()
        return cls(process, ours)

    def answer(self, job: Any) -> Any:
        """Return the outcome of a job; raises PluginError if the process ends."""
        call = ""
        try:
            self.connection.send(job)
            while isinstance(answer := self.connection.recv(), str):
                call = answer
        except (EOFError, OSError) as problem:
            self.process.join()
            code = self.process.exitcode
            name = signal.Signals(-code).name if code < 0 else f"exit status {code}"
            text = call or "the worker process ended outside of any plugin"
            hint = "use another method, or report it to the author of the plugin"
            if name == "SIGKILL":
                hint = "use fewer or smaller frames if memory was exhausted"
            raise PluginError(text, got=name, hint=hint) from problem
        return answer


def _serve(connection: Any, words: str, block: tuple[str, ...], files: tuple[str, ...]) -> None:
    """Run the jobs that arrive at a connection until it is closed."""
    faulthandler.disable()  # the error names the signal
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C signals all processes; the command terminates this one
    assembly: Assembly | None = None
    with contextlib.suppress(EOFError, BrokenPipeError), reported_calls(connection.send):
        while True:
            work, given, options, twists = connection.recv()
            outcome: Any
            try:
                if assembly is None:
                    registry = Registry.load(block=block, extra_files=files)
                    assembly = Recipe.of(**json.loads(words)).resolve(registry).assembly()
                outcome = work(_with(assembly, options, twists), *given)
            except P2OError as problem:
                outcome = problem
            connection.send(outcome)


def _with(assembly: Assembly, options: Any, twists: Any) -> Assembly:
    """Return the assembly with the options and velocities of the one in the main process."""
    calibrator: Any = assembly.calibrator
    if hasattr(calibrator, "options"):
        calibrator = replace(calibrator, options=options)
    return replace(assembly, calibrator=calibrator, options=options, twists=twists)


@contextlib.contextmanager
def isolated(recipe: Recipe, block: Sequence[str], files: Sequence[str]) -> Iterator[IsolatedCalibration]:
    """Yield the calibration of a recipe in a worker process, which is terminated in the end."""
    # The worker receives the initial guess of each calibration: it need not read the file again.
    start = {"start"} if recipe.start is not None and names_file(recipe.start) else set()
    words = recipe.model_dump(mode="json", exclude_unset=True, exclude=start)
    calibration = IsolatedCalibration(words, tuple(block), tuple(files))
    try:
        yield calibration
    finally:
        calibration.close()
