"""Run jobs on several processes or machines through joblib.

Libraries inside a job use one thread: results are bit-identical for any number of workers, and jobs do not compete for
cores.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
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
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, Literal

from p2o.errors import InputError, MethodUnavailable, P2OError, one_line
from p2o.runtime.native import keep_freed_memory

Backend = Literal["loky", "dask", "ray"]
BACKENDS: tuple[Backend, ...] = ("loky", "dask", "ray")

_PACKAGES = {"dask": ("distributed", "dask distributed"), "ray": ("ray", "ray")}
"""The package of a backend, and the arguments of pip to install it."""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_TRIES_ALONE = 2
"""Number of retries of a job whose worker died, without other jobs in parallel."""
_DASK_LOGGERS = ("distributed", "tornado", "asyncio")
_POLL_INTERVAL_S = 0.5
_CONNECT_S = 20.0
_ABSENT_S = 60.0
"""Duration for which a dask scheduler may have no workers or give no answer: those of a cluster may be restarted."""
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
            try:
                importlib.import_module(package)
            except ModuleNotFoundError as problem:
                text = f"--backend {self.backend} needs the package {problem.name}, which is not installed"
                raise MethodUnavailable(text, hint=f"run: pip install {installed}") from problem

    @contextlib.contextmanager
    def start(self) -> Iterator[Run]:
        """Yield `run(work, jobs, lost)`, which yields the result of `work` for each job, in the order of completion.

        Jobs are taken from the iterable on demand, possibly from another thread. Closing the generator of `run` cancels
        unfinished jobs. If a worker dies, the running jobs are repeated one by one in new workers; for a job whose
        worker dies every time, `lost(job, problem)` is yielded. Raises P2OError if the cluster is lost.
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
                    # The backend does not report which job terminated the worker: repeat each separately.
                    for number, job in waiting.under_way():
                        result = self._alone(work, number, job, lost)
                        waiting.done(number)
                        yield result
                if not waiting.under_way() and waiting.exhausted:
                    return
        except (P2OError, GeneratorExit, KeyboardInterrupt):
            raise
        except Exception as problem:
            text = f"the workers of --backend {self.backend} were lost"
            hint = "finished rows are kept: run the same command, with fewer --jobs if memory was exhausted"
            got = f"{type(problem).__name__}: {one_line(problem)}"
            if self.address is not None:
                hint = "finished rows are kept: start scheduler and workers again, then run the same command"
            if type(problem).__name__ in ("FutureCancelledError", "TimeoutError"):
                got = "the scheduler does not respond, or has no workers"
            raise P2OError(text, where=self.address, got=got, hint=hint) from problem

    def _alone(self, work: Work, number: int, job: Any, lost: Lost) -> Any:
        """Return the result of a job that was running when a worker died."""
        death: BaseException | None = None
        for _ in range(_TRIES_ALONE):
            try:
                [(_, result)] = self._attempt(work, [(number, job)])
            except _deaths(self.backend) as problem:
                death = problem
            else:
                return result
        lost_with = P2OError(
            f"the worker process died in each of {1 + _TRIES_ALONE} attempts, {_TRIES_ALONE} of them without other "
            "jobs",
            expected="a job that returns",
            # loky reports the signal.
            got=", ".join(sorted(set(re.findall(r"SIG[A-Z]+", str(death))))) or type(death).__name__,
            hint="out of memory: use fewer --jobs or smaller frames; or native code has crashed",
        )
        return lost(job, lost_with)

    def _attempt(self, work: Work, jobs: Iterable[tuple[int, Any]]) -> Generator[tuple[int, Any], None, None]:
        """Yield number and result of each numbered job until a worker dies."""
        import joblib

        done: Any = None
        batches = _Batches(jobs)
        # Only the workers of loky are children of this process.
        watch = {"initializer": _watch, "initargs": (os.getpid(),)} if self.backend == "loky" else {}
        if self.backend in _PACKAGES:
            yield from {"dask": _dask_results, "ray": _ray_results}[self.backend](work, batches)
            return
        if (submit := self._single_worker(watch)) is not None:
            for batch in batches:
                yield from batches.results_of(*submit(_numbered, work, batch).result())
            return
        try:
            with joblib.parallel_config(backend=self.backend, **watch):
                tasks = (joblib.delayed(_numbered)(work, batch) for batch in batches)
                done = joblib.Parallel(n_jobs=self.jobs, batch_size=1, return_as="generator_unordered")(tasks)
                for took_s, results in done:
                    yield from batches.results_of(took_s, results)
        finally:
            if done is not None:
                done.close()

    def _single_worker(self, watch: dict[str, Any]) -> Callable[..., Any] | None:
        """Return `submit` of the only worker of loky, None for others: joblib would run single jobs in this process."""
        submit: Callable[..., Any] | None = None
        if self.backend == "loky" and self.jobs == 1:
            from joblib.externals.loky import get_reusable_executor

            submit = get_reusable_executor(max_workers=1, timeout=_IDLE_S, **watch).submit
        return submit

    @contextlib.contextmanager
    def _cluster(self) -> Iterator[None]:
        """Connect to the cluster, or start one on this machine."""
        if self.backend == "dask":
            import distributed

            connect: Any = distributed.Client
            here = {"n_workers": self.jobs, "threads_per_worker": 1, "dashboard_address": None}
            if not _debugging():
                here["silence_logs"] = logging.CRITICAL
            # Jobs of workers that died are repeated by `_alone`.
            once = importlib.import_module("dask").config.set({"distributed.scheduler.allowed-failures": 0})
            with _silent_dask(), once:
                try:
                    client = connect(**here) if self.address is None else connect(self.address, timeout=_CONNECT_S)
                except (OSError, ValueError, TimeoutError) as problem:
                    text, expected = "the dask scheduler does not respond", "an address such as tcp://HOST:8786"
                    raise InputError(text, where=self.address or "dask", expected=expected, got=problem) from problem
                try:
                    yield
                finally:
                    # Of a cluster that is lost, also RuntimeError by asyncio: a timeout that ends while it is changed.
                    with contextlib.suppress(TimeoutError, OSError, RuntimeError):
                        client.close(timeout=_ABSENT_S)
        elif self.backend == "ray":
            ray = importlib.import_module("ray")
            level = logging.INFO if _debugging() else logging.ERROR
            cpus = None if self.address else self.jobs
            try:
                _require_listener(self.address)  # ray itself would try for minutes
                ray.init(address=self.address, num_cpus=cpus, log_to_driver=False, logging_level=level)
            except (OSError, ValueError, RuntimeError) as problem:
                text, expected = "the ray cluster does not respond", "auto, or an address such as HOST:6379"
                raise InputError(text, where=self.address or "ray", expected=expected, got=problem) from problem
            try:
                yield
            finally:
                ray.shutdown()
        else:
            ended = False
            try:
                yield
                ended = True
            finally:
                _dismiss_workers(kill=not ended)


def _dask_results(work: Work, batches: _Batches) -> Generator[tuple[int, Any], None, None]:
    """Yield number and result of each job until a worker dies, then cancel the others.

    joblib waits without end if a worker dies, and runs the jobs of a single worker in this process. Raises TimeoutError
    if the cluster is lost.
    """
    client = importlib.import_module("distributed").default_client()
    client.wait_for_workers(1, timeout=_ABSENT_S)  # a worker that died may be about to restart
    running, complete, waiting = set[Any](), queue.SimpleQueue[Any](), iter(batches)
    try:
        while True:
            while len(running) < 2 * max(1, _dask_processors(client)):
                if (batch := next(waiting, None)) is None:
                    break
                running.add(future := client.submit(_numbered, work, batch, pure=False))
                future.add_done_callback(complete.put)
            if not running:
                return
            future, timed_results = _next_complete(client, complete)
            running.remove(future)
            yield from batches.results_of(*timed_results)
    except TimeoutError:
        running.clear()  # to cancel them would wait for the cluster
        raise
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(running))


def _ray_results(work: Work, batches: _Batches) -> Generator[tuple[int, Any], None, None]:
    """Yield number and result of each job until a worker dies, then cancel the others.

    The backend of joblib returns results only when all tasks of a call are complete, and starts new workers for each
    call. Raises TimeoutError if the cluster is without processors for `_ABSENT_S`.
    """
    ray = importlib.import_module("ray")
    task = ray.remote(max_retries=0)(_numbered)  # jobs of workers that died are repeated by `_alone`
    running, waiting = list[Any](), iter(batches)
    try:
        while True:
            while len(running) < 2 * max(1, _ray_processors(ray)):
                if (batch := next(waiting, None)) is None:
                    break
                running.append(task.remote(work, batch))
            if not running:
                return
            complete, running = ray.wait(running, timeout=_ABSENT_S)
            if not complete and not _ray_processors(ray):
                raise TimeoutError("the cluster has no workers")
            for timed_results in complete:
                yield from batches.results_of(*ray.get(timed_results))
    finally:
        for each in running:
            with contextlib.suppress(Exception):
                ray.cancel(each, force=True)


def _require_listener(address: str | None) -> None:
    """Raise OSError or ValueError if nothing listens at HOST:PORT; `auto` and no address are left to ray."""
    host, colon, port = (address or "").removeprefix("ray://").rpartition(":")
    if colon:
        socket.create_connection((host, int(port)), _CONNECT_S).close()


def _dask_processors(client: Any) -> int:
    """Return the number of processors of the workers. Raises TimeoutError if the cluster is lost."""
    try:
        return int(sum(client.ncores().values()))
    except (OSError, RuntimeError) as problem:
        raise TimeoutError("the scheduler does not respond") from problem


def _ray_processors(ray: Any) -> int:
    return int(ray.cluster_resources().get("CPU", 0))


def _next_complete(client: Any, complete: queue.SimpleQueue[Any]) -> tuple[Any, Any]:
    """Return the next complete job and its result.

    Workers that die take the results that they hold with them, and dask waits without end for others to compute them
    again. Raises TimeoutError if the scheduler is without workers or silent for `_ABSENT_S`.
    """
    future, present = None, time.monotonic()
    while True:
        try:
            future = future or complete.get(timeout=_POLL_INTERVAL_S)
            return future, future.result(timeout=_TRANSFER_S)
        except (queue.Empty, TimeoutError):
            if future is not None and future.status == "error":
                raise  # by the job
            with contextlib.suppress(Exception):
                if client.sync(client.scheduler.identity, callback_timeout=_ABSENT_S)["workers"]:
                    present = time.monotonic()
            if time.monotonic() - present > _ABSENT_S:
                raise TimeoutError("the scheduler does not respond, or has no workers") from None


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


def _dismiss_workers(kill: bool) -> None:
    """Terminate the workers of this process, with `kill` also busy ones: joblib may use one that terminates."""
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor(kill_workers=kill).shutdown(wait=True, kill_workers=kill)


class _Waiting:
    """Numbers jobs as they are taken, in threads of backends, and keeps those not done, with which iteration begins."""

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
    """Batches of numbered jobs, each of about one second: successive jobs share cached data, scheduling takes time."""

    def __init__(self, jobs: Iterable[tuple[int, Any]]) -> None:
        self._jobs = iter(jobs)
        self._size = 1

    def __iter__(self) -> Iterator[list[tuple[int, Any]]]:
        while batch := list(itertools.islice(self._jobs, self._size)):
            yield batch

    def results_of(self, took_s: float, results: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
        """Return the results of a batch and adapt the batch size to its duration."""
        fitting = len(results) * _BATCH_S / max(took_s, 1e-6)
        # Later jobs may be slower than the last ones: increase gradually, decrease immediately.
        self._size = max(1, int(min(fitting, 2 * len(results), _MOST_IN_BATCH)))
        return results


def _deaths(backend: Backend) -> tuple[type[BaseException], ...]:
    """Return the exceptions of a backend for a worker that died."""
    if backend == "dask":
        return (importlib.import_module("distributed").KilledWorker,)
    if backend == "ray":
        problems = importlib.import_module("ray").exceptions
        return problems.WorkerCrashedError, problems.OutOfMemoryError, problems.NodeDiedError, problems.ObjectLostError
    return (concurrent.futures.BrokenExecutor,)


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
