"""Jobs on several processes or machines through joblib; there is no scheduler of our own.

Every library inside a job computes with one thread: the same bits on any number of workers, and two jobs do not fight
for the cores.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import importlib
import itertools
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, Literal

from p2o.errors import InputError, MethodUnavailable, P2OError

Backend = Literal["loky", "dask", "ray"]
BACKENDS: tuple[Backend, ...] = ("loky", "dask", "ray")

_PACKAGES = {"dask": ("distributed", "dask distributed"), "ray": ("ray", "ray")}
"""The package of a backend, and what pip installs for it."""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_TRIES_ALONE = 2
"""How often a job whose worker died is tried again, with no other job beside it."""
_LOOK_EVERY_S = 0.5
_BATCH_S, _MOST_IN_BATCH = 1.0, 64
"""A worker gets so many seconds of jobs at once: it takes them with it where it dies, and they are done again."""

Work = Callable[[Any], Any]
Lost = Callable[[Any, P2OError], Any]
Run = Callable[[Work, Iterable[Any], Lost], Generator[Any, None, None]]


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
        if self.backend in _PACKAGES:
            package, installed = _PACKAGES[self.backend]
            try:
                importlib.import_module(package)
            except ModuleNotFoundError as problem:
                raise MethodUnavailable(
                    f"--backend {self.backend} needs the package {problem.name}, which is not installed",
                    hint=f"run: pip install {installed}",
                ) from problem

    @contextlib.contextmanager
    def hired(self) -> Iterator[Run]:
        """Yield `run(work, jobs, lost)`, which yields what `work` returns for each job, as the jobs finish.

        Jobs are taken from the iterable as workers become free; it may be asked from another thread. Closing what
        `run` returns gives up what is not finished. Where a worker dies (killed, out of memory, a crash in native
        code), the jobs under way are tried again one by one in fresh workers; for one whose worker dies every time,
        `lost(job, problem)` is yielded instead. Raises P2OError where the cluster itself is lost.
        """
        if self.backend == "loky" and self.jobs == 1:
            with _one_thread_for_now():
                yield _in_turn
        else:
            with self._cluster():
                yield self._run

    def _run(self, work: Work, jobs: Iterable[Any], lost: Lost) -> Generator[Any, None, None]:
        waiting = _Waiting(jobs)
        try:
            while True:
                try:
                    for number, result in self._attempt(work, waiting):
                        waiting.done(number)
                        yield result
                except _deaths(self.backend):
                    # Nobody says which of the jobs under way was it: alone, each answers for itself.
                    for number, job in waiting.under_way():
                        result = self._alone(work, number, job, lost)
                        waiting.done(number)
                        yield result
                if not waiting.under_way() and waiting.exhausted:
                    return
        except (P2OError, GeneratorExit, KeyboardInterrupt):
            raise
        except Exception as problem:
            raise _cluster_lost(self, problem) from problem

    def _alone(self, work: Work, number: int, job: Any, lost: Lost) -> Any:
        """Return what a job gives that was under way when a worker died."""
        death: BaseException | None = None
        for _ in range(_TRIES_ALONE):
            try:
                [(_, result)] = self._attempt(work, [(number, job)])
            except _deaths(self.backend) as problem:
                death = problem
            else:
                return result
        lost_with = P2OError(
            f"the worker process died in each of {1 + _TRIES_ALONE} tries, {_TRIES_ALONE} of them with nothing else "
            "to do",
            expected="a job that ends",
            got=_how(death),
            hint="did memory run out? Fewer --jobs or smaller frames need less; native code may have crashed",
        )
        return lost(job, lost_with)

    def _attempt(self, work: Work, jobs: Iterable[tuple[int, Any]]) -> Generator[tuple[int, Any], None, None]:
        """Yield number and result of each numbered job, until a worker dies."""
        import joblib

        done: Any = None
        batches = _Batches(jobs)
        try:
            # Workers of this machine are children of this process, those of a cluster are not.
            watch = {"initializer": _watch, "initargs": (os.getpid(),)} if self.backend == "loky" else {}
            with joblib.parallel_config(backend=self.backend, **watch):
                tasks = (joblib.delayed(_numbered)(work, batch) for batch in batches)
                if self.backend == "ray":
                    # Its joblib backend hands results back only when a batch is complete.
                    while some := list(itertools.islice(tasks, 4 * self.jobs)):
                        for took_s, results in joblib.Parallel(n_jobs=self.jobs, batch_size=1)(some):
                            yield from batches.told(took_s, results)
                    return
                jobs_at_once = self.jobs if self.backend == "loky" else -1
                done = joblib.Parallel(n_jobs=jobs_at_once, batch_size=1, return_as="generator_unordered")(tasks)
                for took_s, results in done:
                    yield from batches.told(took_s, results)
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
            ended = False
            try:
                yield
                ended = True
            finally:
                _dismiss_workers(kill=not ended)


def _dismiss_workers(kill: bool) -> None:
    """End the worker processes of this process; `kill` those that are at work, too.

    joblib keeps them for five minutes, and hands jobs to them that nobody does if these five minutes end just then: a
    second study in one process would wait for ever.
    """
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor(kill_workers=kill).shutdown(wait=True, kill_workers=kill)


class _Waiting:
    """Numbers jobs as they are taken, and knows those that were taken and are not done.

    Iterating it again takes what is under way first. Backends take jobs from threads of their own.
    """

    def __init__(self, jobs: Iterable[Any]) -> None:
        self.exhausted = False
        self._jobs = enumerate(jobs)
        self._taken: dict[int, Any] = {}
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        return itertools.chain(self.under_way(), iter(self._take, None))

    def _take(self) -> tuple[int, Any] | None:
        with self._lock:
            for number, job in self._jobs:
                self._taken[number] = job
                return number, job
            self.exhausted = True
            return None

    def under_way(self) -> list[tuple[int, Any]]:
        with self._lock:
            return list(self._taken.items())

    def done(self, number: int) -> None:
        with self._lock:
            del self._taken[number]


class _Batches:
    """Numbered jobs in lists, each of which goes to a worker as one: as many as a worker does in about a second.

    Jobs that follow each other often need the same, and handing one out takes a scheduler milliseconds. How long jobs
    take is told by those that are done; joblib knows that, too, but makes no batches of jobs of a quarter of a second.
    """

    def __init__(self, jobs: Iterable[tuple[int, Any]]) -> None:
        self._jobs = iter(jobs)
        self._size = 1

    def __iter__(self) -> Iterator[list[tuple[int, Any]]]:
        while batch := list(itertools.islice(self._jobs, self._size)):
            yield batch

    def told(self, took_s: float, results: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
        """Return the results of a batch, having learnt from the time that they took."""
        fitting = len(results) * _BATCH_S / max(took_s, 1e-6)
        # A job of a row may take longer than the last ones did: grow by steps, shrink at once.
        self._size = max(1, int(min(fitting, 2 * len(results), _MOST_IN_BATCH)))
        return results


def _deaths(backend: Backend) -> tuple[type[BaseException], ...]:
    """Return what a backend raises where a worker died, and not the work itself."""
    if backend == "dask":
        return (importlib.import_module("distributed").KilledWorker,)
    if backend == "ray":
        return (importlib.import_module("ray").exceptions.RayActorError,)
    return (concurrent.futures.BrokenExecutor,)


def _how(death: BaseException | None) -> str:
    """Return how a worker ended, in few words: loky knows the signal."""
    signals = sorted(set(re.findall(r"SIG[A-Z]+", str(death))))
    return ", ".join(signals) or type(death).__name__


def _in_turn(work: Work, jobs: Iterable[Any], lost: Lost) -> Generator[Any, None, None]:
    yield from map(work, jobs)


def _cluster_lost(workers: Workers, problem: Exception) -> P2OError:
    return P2OError(
        f"the workers of --backend {workers.backend} were lost",
        got=f"{type(problem).__name__}: {problem}",
        hint="what was finished is kept: start the study again, with fewer --jobs where memory ran out",
    )


def _numbered(work: Work, batch: list[tuple[int, Any]]) -> tuple[float, list[tuple[int, Any]]]:
    """Do the jobs of a batch in a worker; return how many seconds they took, and what each came to."""
    _set_up_worker()
    began = time.perf_counter()
    results = [(number, work(job)) for number, job in batch]
    return time.perf_counter() - began, results


@cache
def _set_up_worker() -> None:
    for name in _THREAD_VARIABLES:
        os.environ[name] = "1"
    _limits.on = True
    limit_threads()
    # Ctrl-C goes to every process of the terminal: the one that keeps the results decides.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _watch(boss: int) -> None:
    """Let a worker end with its parent process `boss`: nobody else takes what it does, and it would wait for minutes.

    It begins before the first job, which may come late or never.
    """
    threading.Thread(target=_leave_with, args=(boss,), daemon=True).start()


def _leave_with(boss: int) -> None:
    while os.getppid() == boss:
        time.sleep(_LOOK_EVERY_S)
    os._exit(1)


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
