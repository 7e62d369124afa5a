"""Run jobs on several processes or machines, with loky, dask or ray.

Libraries inside a job use one thread: results are bit-identical for any number of workers, and jobs do not compete for
cores.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import errno
import faulthandler
import importlib
import itertools
import logging
import multiprocessing
import os
import queue
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, Literal, TypeAlias

from p2o.errors import InputError, P2OError, one_line
from p2o.runtime.native import keep_freed_memory
from p2o.runtime.packages import optional_package

Backend = Literal["loky", "dask", "ray"]

_PACKAGES = {"dask": ("distributed", "dask distributed"), "ray": ("ray", "ray")}
"""The package of a backend, and the arguments of pip to install it."""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_TRIES_ALONE = 2
"""Number of retries of a job whose worker died, without other jobs in parallel."""
_DASK_LOGGERS = ("distributed", "tornado", "asyncio")
_POLL_INTERVAL_S = 0.5
_CONNECT_S = 20.0
_ABSENT_S = 60.0
"""Duration for which a cluster may have no workers or give no answer: those of a cluster may be restarted."""
_TRANSFER_S = 10.0
"""Duration after which the presence of workers is checked while the result of a complete job is transferred."""
_IDLE_S = 300
"""Duration after which an idle worker ends, as in joblib."""
_BATCH_S, _MOST_IN_BATCH = 1.0, 64
"""Duration and maximum size of a batch of jobs: all jobs of a batch are repeated if its worker dies."""

Work = Callable[[Any], Any]
Lost = Callable[[Any, P2OError], Any]
Run = Callable[[Work, Iterable[Any], Lost], Generator[Any, None, None]]


@dataclass(frozen=True)
class Workers:
    """Configuration of workers: `jobs` processes of this machine, or a dask or ray cluster at `address`.

    Without `address`, dask and ray start `jobs` workers on this machine. One job of loky runs in this process, or with
    `isolate` in a worker, so that native code that crashes ends that worker only; None leaves it to the study. Raises
    InputError for invalid values and combinations, MethodUnavailable if the backend is not installed.
    """

    jobs: int = 1
    backend: Backend = "loky"
    address: str | None = None
    isolate: bool | None = False

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError("the number of jobs is not positive", where="--jobs", expected="at least 1", got=self.jobs)
        if self.backend == "loky" and self.address is not None:
            raise InputError("the backend loky has no address", where="--address", expected="--backend dask")
        if self.backend in _PACKAGES:
            package, installed = _PACKAGES[self.backend]
            optional_package(package, f"--backend {self.backend}", installed)

    @contextlib.contextmanager
    def start(self) -> Iterator[Run]:
        """Yield `run(work, jobs, lost)`, which yields the result of `work` for each job, in the order of completion.

        Jobs are taken from the iterable on demand. Closing the generator of `run` cancels unfinished jobs. If a worker
        dies, the running jobs are repeated one by one in new workers; for a job whose worker dies every time,
        `lost(job, problem)` is yielded. Raises P2OError if the cluster is lost.
        """
        in_process = self.backend == "loky" and self.jobs == 1 and not self.isolate
        if self.backend == "loky" and not in_process and (cause := _cannot_start()):
            text = f"worker processes cannot be started, so all jobs run in this one: {cause}"
            print(f"p2o: warning: {one_line(text)}", file=sys.stderr)
            in_process = True
        if in_process:
            with _single_threaded():
                yield lambda work, jobs, lost: (work(job) for job in jobs)
        else:
            pools: dict[str, type[_Pool]] = {"loky": _Loky, "dask": _Dask, "ray": _Ray}
            pool = pools[self.backend](self.jobs, self.address)
            with pool.connected():
                yield partial(self._run, pool)

    def _run(self, pool: _Pool, work: Work, jobs: Iterable[Any], lost: Lost) -> Generator[Any, None, None]:
        waiting, under_way = enumerate(jobs), dict[int, Any]()

        def taken() -> Iterator[tuple[int, Any]]:
            for number, job in waiting:
                under_way[number] = job
                yield number, job

        try:
            ended = False
            while not ended:
                try:
                    for number, result in _results(pool, work, taken()):
                        del under_way[number]
                        yield result
                    ended = True
                except pool.deaths:
                    # The backend does not report which job terminated the worker: repeat each separately.
                    for number, job in list(under_way.items()):
                        result = _result_alone(pool, work, job, lost)
                        del under_way[number]
                        yield result
        except (P2OError, GeneratorExit, KeyboardInterrupt):
            raise
        except Exception as problem:
            if isinstance(problem, OSError) and problem.errno in (errno.EMFILE, errno.ENFILE):
                raise  # the command names the limit
            text = f"the workers of --backend {self.backend} were lost"
            hint = "finished rows are kept: run the same command, with fewer --jobs if memory was exhausted"
            got = f"{type(problem).__name__}: {one_line(problem)}"
            if self.address is not None:
                hint = "finished rows are kept: start scheduler and workers again, then run the same command"
            if type(problem).__name__ in ("FutureCancelledError", "TimeoutError"):
                got = "the scheduler does not respond, or has no workers"
            raise P2OError(text, where=self.address, got=got, hint=hint) from problem


def _results(pool: _Pool, work: Work, jobs: Iterable[tuple[int, Any]]) -> Generator[tuple[int, Any], None, None]:
    """Yield number and result of each numbered job until a worker dies, then cancel the others."""
    waiting, running, size = iter(jobs), set[Any](), 1
    pool.prepare()
    try:
        while True:
            while len(running) < 2 * max(1, pool.processors()) and (batch := list(itertools.islice(waiting, size))):
                running.add(pool.submit(work, batch))
            if not running:
                return
            future, (took_s, results) = pool.complete(running)
            running.remove(future)
            size = _batch_size(took_s, len(results))
            yield from results
    except TimeoutError:
        running.clear()  # to cancel them would wait for the cluster
        raise
    finally:
        with contextlib.suppress(Exception):
            pool.cancel(running)


def _result_alone(pool: _Pool, work: Work, job: Any, lost: Lost) -> Any:
    """Return the result of a job that was running when a worker died."""
    death: BaseException | None = None
    for _ in range(_TRIES_ALONE):
        try:
            [(_, result)] = _results(pool, work, [(0, job)])
        except pool.deaths as problem:
            death = problem
        else:
            return result
    lost_with = P2OError(
        f"the worker process died in each of {1 + _TRIES_ALONE} attempts, {_TRIES_ALONE} of them without other jobs",
        expected="a job that returns",
        # loky reports the signal.
        got=", ".join(sorted(set(re.findall(r"SIG[A-Z]+", str(death))))) or type(death).__name__,
        hint="out of memory: use fewer --jobs or smaller frames; or native code has crashed",
    )
    return lost(job, lost_with)


@dataclass
class _Loky:
    """Processes of this machine.

    `connected` also starts a cluster on this machine, `prepare` replaces workers that died, `submit` returns the future
    of `_numbered`, and `complete` waits for a future and returns it with its result.
    """

    jobs: int
    address: str | None
    executor: Any = None
    deaths: tuple[type[BaseException], ...] = (concurrent.futures.BrokenExecutor,)

    @contextlib.contextmanager
    def connected(self) -> Iterator[None]:
        ended = False
        try:
            yield
            ended = True
        finally:
            if self.executor is not None:
                self.executor.shutdown(wait=True, kill_workers=not ended)

    def prepare(self) -> None:
        # Not the executor that loky shares in a process: who else holds that one can end its workers.
        from joblib.externals.loky import ProcessPoolExecutor

        if self.executor is not None:
            self.executor.shutdown(wait=True, kill_workers=True)
        words: dict[str, Any] = {"initializer": _watch, "initargs": (os.getpid(),)}
        self.executor = ProcessPoolExecutor(max_workers=self.jobs, timeout=_IDLE_S, **words)

    def processors(self) -> int:
        return self.jobs

    def submit(self, work: Work, batch: list[tuple[int, Any]]) -> Any:
        return self.executor.submit(_numbered, work, batch)

    def complete(self, running: Collection[Any]) -> tuple[Any, Any]:
        done, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
        future = next(iter(done))
        return future, future.result()

    def cancel(self, running: Collection[Any]) -> None:
        for future in running:
            future.cancel()


class _Dask:
    """A dask cluster, as `_Loky`. Raises TimeoutError if the scheduler is without workers or silent for `_ABSENT_S`."""

    def __init__(self, jobs: int, address: str | None) -> None:
        self.jobs, self.address = jobs, address
        self.client: Any = None
        self.done = queue.SimpleQueue[Any]()

    @property
    def deaths(self) -> tuple[type[BaseException], ...]:
        return (importlib.import_module("distributed").KilledWorker,)

    @contextlib.contextmanager
    def connected(self) -> Iterator[None]:
        connect: Any = importlib.import_module("distributed").Client
        here = {"n_workers": self.jobs, "threads_per_worker": 1, "dashboard_address": None}
        if not _debugging():
            here["silence_logs"] = logging.CRITICAL
        # Jobs of workers that died are repeated by `_result_alone`.
        once = importlib.import_module("dask").config.set({"distributed.scheduler.allowed-failures": 0})
        with _silent_dask(), once:
            try:
                self.client = connect(**here) if self.address is None else connect(self.address, timeout=_CONNECT_S)
            except (OSError, ValueError, TimeoutError) as problem:
                text, expected = "the dask scheduler does not respond", "an address such as tcp://HOST:8786"
                raise InputError(text, where=self.address or "dask", expected=expected, got=problem) from problem
            try:
                yield
            finally:
                # Of a cluster that is lost, also RuntimeError by asyncio: a timeout that ends while it is changed.
                with contextlib.suppress(TimeoutError, OSError, RuntimeError):
                    self.client.close(timeout=_ABSENT_S)

    def prepare(self) -> None:
        self.client.wait_for_workers(1, timeout=_ABSENT_S)  # a worker that died may be about to restart
        self.done = queue.SimpleQueue()

    def processors(self) -> int:
        try:
            return int(sum(self.client.ncores().values()))
        except (OSError, RuntimeError) as problem:
            raise TimeoutError("the scheduler does not respond") from problem

    def submit(self, work: Work, batch: list[tuple[int, Any]]) -> Any:
        future = self.client.submit(_numbered, work, batch, pure=False)
        future.add_done_callback(self.done.put)
        return future

    def complete(self, running: Collection[Any]) -> tuple[Any, Any]:
        # Workers that die take the results that they contain with them, and dask waits without end for others to
        # compute them again.
        future, present = None, time.monotonic()
        while True:
            try:
                future = future or self.done.get(timeout=_POLL_INTERVAL_S)
                return future, future.result(timeout=_TRANSFER_S)
            except (queue.Empty, TimeoutError):
                if future is not None and future.status == "error":
                    raise  # by the job
                with contextlib.suppress(Exception):
                    if self.client.sync(self.client.scheduler.identity, callback_timeout=_ABSENT_S)["workers"]:
                        present = time.monotonic()
                if time.monotonic() - present > _ABSENT_S:
                    raise TimeoutError("the scheduler does not respond, or has no workers") from None

    def cancel(self, running: Collection[Any]) -> None:
        self.client.cancel(list(running))


class _Ray:
    """A ray cluster, as `_Loky`. Raises TimeoutError if it is without processors for `_ABSENT_S`."""

    def __init__(self, jobs: int, address: str | None) -> None:
        self.jobs, self.address, self.ray = jobs, address, importlib.import_module("ray")

    @property
    def deaths(self) -> tuple[type[BaseException], ...]:
        problems = self.ray.exceptions
        return problems.WorkerCrashedError, problems.OutOfMemoryError, problems.NodeDiedError, problems.ObjectLostError

    @contextlib.contextmanager
    def connected(self) -> Iterator[None]:
        level = logging.INFO if _debugging() else logging.ERROR
        cpus = None if self.address else self.jobs
        # ray itself would try for minutes to connect to HOST:PORT; `auto` and no address are left to it.
        host, colon, port = (self.address or "").removeprefix("ray://").rpartition(":")
        try:
            if colon:
                socket.create_connection((host, int(port)), _CONNECT_S).close()
            self.ray.init(address=self.address, num_cpus=cpus, log_to_driver=False, logging_level=level)
        except (OSError, ValueError, RuntimeError) as problem:
            text, expected = "the ray cluster does not respond", "auto, or an address such as HOST:6379"
            raise InputError(text, where=self.address or "ray", expected=expected, got=problem) from problem
        try:
            yield
        finally:
            self.ray.shutdown()

    def prepare(self) -> None:
        # Jobs of workers that died are repeated by `_result_alone`.
        self.task = self.ray.remote(max_retries=0)(_numbered)

    def processors(self) -> int:
        return int(self.ray.cluster_resources().get("CPU", 0))

    def submit(self, work: Work, batch: list[tuple[int, Any]]) -> Any:
        return self.task.remote(work, batch)

    def complete(self, running: Collection[Any]) -> tuple[Any, Any]:
        done: list[Any] = []
        while not done:
            done, _ = self.ray.wait(list(running), timeout=_ABSENT_S)
            if not done and not self.processors():
                raise TimeoutError("the cluster has no workers")
        return done[0], self.ray.get(done[0])

    def cancel(self, running: Collection[Any]) -> None:
        for future in running:
            with contextlib.suppress(Exception):
                self.ray.cancel(future, force=True)


_Pool: TypeAlias = _Loky | _Dask | _Ray
"""The workers of a backend; `deaths` are its exceptions for a worker that died. Others: the cluster is lost."""


@contextlib.contextmanager
def _silent_dask() -> Iterator[None]:
    """Suppress the log of dask in this process: what it reports with tracebacks is a row or one line of an error.

    After an exception it remains suppressed: tasks of a lost cluster are reported when they are collected, at the
    latest at the end of the process.
    """
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in _DASK_LOGGERS]
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = logger.disabled or not _debugging()
    yield
    for logger, disabled in zip(loggers, before, strict=True):
        logger.disabled = disabled


def _cannot_start() -> str:
    """Return why loky cannot start workers, empty if it can: it needs semaphores of the operating system."""
    import joblib

    with joblib.parallel_config(backend="loky"):
        if joblib.effective_n_jobs(2) > 1:
            return ""
    try:
        multiprocessing.get_context("spawn").Lock()
    except OSError as problem:
        folder = "/dev/shm: " if sys.platform == "linux" else ""
        return f"{folder}{problem.strerror or problem}; make it writable to use several --jobs"
    return "joblib allows none here, such as inside of a worker or with JOBLIB_MULTIPROCESSING=0"


def _debugging() -> bool:
    return os.environ.get("P2O_DEBUG", "") not in ("", "0")


def _batch_size(took_s: float, count: int) -> int:
    """Return the number of jobs of a batch of about one second, after a batch of `count` jobs that took `took_s`.

    Successive jobs share cached data, and scheduling takes time.
    """
    fitting = count * _BATCH_S / max(took_s, 1e-6)
    # Later jobs may be slower than the last ones: increase gradually, decrease immediately.
    return max(1, int(min(fitting, 2 * count, _MOST_IN_BATCH)))


def _numbered(work: Work, batch: list[tuple[int, Any]]) -> tuple[float, list[tuple[int, Any]]]:
    """Run the jobs of a batch in a worker; return the duration in s and the numbered results."""
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
    # The nanny of dask sets MALLOC_TRIM_THRESHOLD_ so that memory is returned to the system at every free.
    keep_freed_memory()
    # The row of a job whose worker dies reports the signal: loky would print the stack of every thread, too.
    if not _debugging():
        faulthandler.disable()
    # Ctrl-C signals every process of the terminal: the main process terminates the workers.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _watch(parent: int) -> None:
    """Terminate this worker when its parent process ends, also before its first job; else it would wait for minutes."""

    def leave() -> None:
        while os.getppid() == parent:
            time.sleep(_POLL_INTERVAL_S)
        os._exit(1)

    threading.Thread(target=leave, daemon=True).start()


@dataclass
class _Limits:
    """The libraries limited to one thread in this process, and functions to undo it."""

    on: bool = False
    loaded: frozenset[str] = frozenset()
    undo: list[Callable[[], object]] = field(default_factory=list)


_limits = _Limits()
_LIBRARIES = ("numpy", "scipy.linalg", "cv2", "torch")


def limit_threads() -> None:
    """Limit the loaded libraries to one thread; to be called in a job after it has loaded more, no effect elsewhere."""
    loaded = frozenset(name for name in _LIBRARIES if name in sys.modules)
    if not _limits.on or loaded == _limits.loaded:
        return
    import threadpoolctl

    _limits.undo.append(threadpoolctl.threadpool_limits(1).restore_original_limits)
    for name, get, put in (("cv2", "getNumThreads", "setNumThreads"), ("torch", "get_num_threads", "set_num_threads")):
        if name in loaded - _limits.loaded:
            module = sys.modules[name]
            _limits.undo.append(partial(getattr(module, put), getattr(module, get)()))
            getattr(module, put)(1)
    _limits.loaded = loaded


@contextlib.contextmanager
def _single_threaded() -> Iterator[None]:
    """Limit this process to one thread within the context."""
    _limits.on = True
    limit_threads()
    try:
        yield
    finally:
        while _limits.undo:
            _limits.undo.pop()()
        _limits.on, _limits.loaded = False, frozenset()
