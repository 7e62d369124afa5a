"""Control native code: cores per thread, memory of freed arrays, OpenCV's use of IPP, imports with side effects."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, TypeVar

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_LARGEST_KEPT, _KEPT = 32 << 20, 1 << 30


@cache
def keep_freed_memory() -> None:
    """Make glibc reuse freed memory in this process instead of returning it to the system, up to 1 GiB.

    Feature maps and images are large enough that glibc maps and unmaps each of them; clearing the new pages took 20 %
    of the inference time of the network. Other C libraries are left unchanged. It takes precedence over MALLOC_*
    variables of the environment.
    """
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((_MMAP_THRESHOLD, _LARGEST_KEPT), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, 64 << 20)):
            mallopt(parameter, value)


_OF_THREAD = threading.local()


@contextlib.contextmanager
def single_core() -> Iterator[None]:
    """Limit `cores()` to 1 in this thread."""
    before = getattr(_OF_THREAD, "one_core", False)
    _OF_THREAD.one_core = True
    try:
        yield
    finally:
        _OF_THREAD.one_core = before


def available_cores() -> int:
    """Return the number of cores that the CPU affinity of the process allows."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores() -> int:
    """Return the number of cores this thread may use: CPU affinity of the process, at most OMP_NUM_THREADS.

    It is 1 within `single_core`.
    """
    if getattr(_OF_THREAD, "one_core", False):
        return 1
    count = available_cores()
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(asked)) if asked.isdecimal() and int(asked) else count


@contextlib.contextmanager
def ipp_disabled() -> Iterator[None]:
    """Disable Intel IPP in OpenCV for this thread, so that results do not depend on memory addresses.

    IPP's distance transform and blur differ in their last bits with the alignment of the arrays. The switch is
    thread-local in OpenCV; with several OpenCV threads its workers still use IPP.
    """
    import cv2

    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        yield
    finally:
        cv2.ipp.setUseIPP(before)


def has_gpu_driver() -> bool:
    """Return whether a GPU driver is installed that PyTorch may use, in less than a millisecond.

    NVIDIA's driver is a shared library, AMD's is a device file of Linux. Only PyTorch knows whether there is a GPU.
    """
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return os.path.exists("/dev/kfd")
    return True


_IMPORTING = threading.RLock()
"""Otherwise a thread that begins while another one imports takes the handler of glog for Python's."""


def import_keeping_signals(name: str) -> Any:
    """Import a module and restore Python's handler of SIGTERM.

    pycolmap and pyceres load glog, which treats SIGTERM as a crash: it prints a stack trace and ends the process
    without running Python's handler. Raises ImportError as the import does.
    """
    # The C functions work in every thread; signal.signal works in the main thread only.
    get_handler, set_handler = ctypes.pythonapi.PyOS_getsig, ctypes.pythonapi.PyOS_setsig
    get_handler.argtypes, get_handler.restype = (ctypes.c_int,), ctypes.c_void_p
    set_handler.argtypes, set_handler.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    with _IMPORTING:
        handler = get_handler(signal.SIGTERM)
        try:
            module = importlib.import_module(name)
        finally:
            set_handler(signal.SIGTERM, handler)
    return module


_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def for_each(function: Callable[[_Item], _Result], items: Sequence[_Item], *, parallel: bool) -> list[_Result]:
    """Return the results of `function` in the order of `items`; with `parallel` on all cores, in threads.

    The error of the first failing item is raised. Results do not depend on the number of threads. Within a thread
    `p2o.runtime.native.cores` is 1.
    """
    threads = min(len(items), cores()) if parallel else 1
    if threads < 2:
        return [function(item) for item in items]
    from concurrent.futures import ThreadPoolExecutor

    def on_one_core(item: _Item) -> _Result:
        with single_core():
            return function(item)

    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(on_one_core, items))
