"""Jobs on several processes or machines through joblib; there is no scheduler of our own.

Every library inside a job computes with one thread: the same bits on any number of workers, and two jobs do not fight
for the cores.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, Literal

from p2o.errors import InputError, MethodUnavailable, P2OError

Backend = Literal["loky", "dask", "ray"]
BACKENDS: tuple[Backend, ...] = ("loky", "dask", "ray")

_EXTRAS = {"dask": "distributed", "ray": "ray"}
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
Run = Callable[[Callable[[Any], Any], Iterable[Any]], Generator[Any, None, None]]


@dataclass(frozen=True)
class Workers:
    """Where jobs run: `jobs` processes of this machine, or a cluster of dask or ray at `address`.

    With `address` empty, dask and ray start `jobs` workers on this machine. Raises InputError for numbers and
    combinations that make no sense, MethodUnavailable where the backend is not installed.
    """

    jobs: int = 1
    backend: Backend = "loky"
    address: str | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError("there is nobody to work", where="--jobs", expected="at least 1", got=self.jobs)
        if self.backend == "loky" and self.address is not None:
            raise InputError("processes of this machine have no address", where="--address", expected="--backend dask")
        package = _EXTRAS.get(self.backend)
        if package is not None:
            try:
                importlib.import_module(package)
            except ModuleNotFoundError as problem:
                raise MethodUnavailable(
                    f"--backend {self.backend} needs the package {problem.name}, which is not installed",
                    hint=f'run: pip install "p2o-calib[{self.backend}]"',
                ) from problem

    @contextlib.contextmanager
    def hired(self) -> Iterator[Run]:
        """Yield `run(work, jobs)`, which yields what `work` returns for each job, in the order in which they finish.

        Jobs are taken from the iterable as workers become free; it may be asked from another thread. Closing what
        `run` returns gives up what is not finished. Raises P2OError where workers die of themselves (out of memory)
        or the cluster is lost.
        """
        if self.backend == "loky" and self.jobs == 1:
            with _one_thread_for_now():
                yield _in_turn
        else:
            with self._cluster():
                yield self._run

    def _run(self, work: Callable[[Any], Any], jobs: Iterable[Any]) -> Generator[Any, None, None]:
        import joblib

        done: Any = None
        try:
            with joblib.parallel_config(backend=self.backend):
                tasks = (joblib.delayed(_alone)(work, job) for job in jobs)
                if self.backend == "ray":
                    # Its joblib backend hands results back only when a batch is complete.
                    while batch := list(itertools.islice(tasks, 4 * self.jobs)):
                        yield from joblib.Parallel(n_jobs=self.jobs, batch_size=1)(batch)
                    return
                jobs_at_once = self.jobs if self.backend == "loky" else -1
                done = joblib.Parallel(n_jobs=jobs_at_once, batch_size=1, return_as="generator_unordered")(tasks)
                yield from done
        except (P2OError, GeneratorExit, KeyboardInterrupt):
            raise
        except Exception as problem:
            raise _lost(self, problem) from problem
        finally:
            if done is not None:
                done.close()

    @contextlib.contextmanager
    def _cluster(self) -> Iterator[None]:
        """Connect to the cluster, or start one on this machine."""
        if self.backend == "dask":
            import distributed

            connect: Any = distributed.Client
            here = {"n_workers": self.jobs, "threads_per_worker": 1, "dashboard_address": None}
            try:
                client = connect(**here) if self.address is None else connect(self.address, timeout=20)
            except (OSError, ValueError, TimeoutError) as problem:
                raise InputError(
                    "the dask scheduler does not answer",
                    where=self.address or "dask",
                    expected="an address such as tcp://HOST:8786",
                    got=problem,
                ) from problem
            with client:
                yield
        elif self.backend == "ray":
            ray = importlib.import_module("ray")
            importlib.import_module("ray.util.joblib").register_ray()
            if not ray.is_initialized():
                ray.init(address=self.address, num_cpus=None if self.address else self.jobs, log_to_driver=False)
            yield
        else:
            yield


def _in_turn(work: Callable[[Any], Any], jobs: Iterable[Any]) -> Generator[Any, None, None]:
    yield from map(work, jobs)


def _lost(workers: Workers, problem: Exception) -> P2OError:
    return P2OError(
        f"the workers of --backend {workers.backend} were lost",
        got=f"{type(problem).__name__}: {problem}",
        hint="what was finished is kept: start the study again, with fewer --jobs where memory ran out",
    )


def _alone(work: Callable[[Any], Any], job: Any) -> Any:
    """Do one job in a worker."""
    _set_up_worker()
    return work(job)


@cache
def _set_up_worker() -> None:
    for name in _THREAD_VARIABLES:
        os.environ[name] = "1"
    _limits.on = True
    limit_threads()
    # Ctrl-C goes to every process of the terminal: the one that keeps the results decides.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass
class _Limits:
    """What is held to one thread in this process, and how to take that back."""

    on: bool = False
    loaded: frozenset[str] = frozenset()
    undo: list[Callable[[], object]] = field(default_factory=list)


_limits = _Limits()
_LIBRARIES = ("numpy", "scipy.linalg", "cv2", "torch")


def limit_threads() -> None:
    """Hold the libraries that are loaded by now to one thread; to be called in a job after it has loaded more.

    Outside of jobs nothing is changed.
    """
    loaded = frozenset(name for name in _LIBRARIES if name in sys.modules)
    if not _limits.on or loaded == _limits.loaded:
        return
    import threadpoolctl

    _limits.undo.append(threadpoolctl.threadpool_limits(1).restore_original_limits)
    for name, get, put in (
        ("cv2", "getNumThreads", "setNumThreads"),
        ("torch", "get_num_threads", "set_num_threads"),
    ):
        if name in loaded - _limits.loaded:
            module = sys.modules[name]
            _limits.undo.append(partial(getattr(module, put), getattr(module, get)()))
            getattr(module, put)(1)
    _limits.loaded = loaded


@contextlib.contextmanager
def _one_thread_for_now() -> Iterator[None]:
    """Hold this process to one thread, and take it back."""
    _limits.on = True
    limit_threads()
    try:
        yield
    finally:
        while _limits.undo:
            _limits.undo.pop()()
        _limits.on, _limits.loaded = False, frozenset()
