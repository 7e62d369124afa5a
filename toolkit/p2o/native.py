"""What is of the machine: its cores, its memory, and packages whose compiled code does too much when imported."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_LARGEST_KEPT, _KEPT = 32 << 20, 1 << 30


def keep_freed_memory() -> None:
    """Let this process use memory again that it freed, instead of asking the system for new pages each time.

    Maps of features and pictures are large enough for glibc to take each from the system and to give it back: clearing
    the pages took a fifth of a network's time. Other C libraries are left as they are.
    """
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((_MMAP_THRESHOLD, _LARGEST_KEPT), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, 64 << 20)):
            mallopt(parameter, value)


_OF_THREAD = threading.local()


@contextlib.contextmanager
def one_of_several() -> Iterator[None]:
    """Say that this thread works beside others that use the other cores: within, `cores` is 1 for it."""
    before = getattr(_OF_THREAD, "one_core", False)
    _OF_THREAD.one_core = True
    try:
        yield
    finally:
        _OF_THREAD.one_core = before


def cores() -> int:
    """Return how many cores this thread may use: those that the system leaves its process, at most OMP_NUM_THREADS.

    A thread that is `one_of_several` may use one.
    """
    if getattr(_OF_THREAD, "one_core", False):
        return 1
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(asked)) if asked.isdecimal() and int(asked) else count


def has_gpu_driver() -> bool:
    """Return whether a driver of GPUs is installed that PyTorch may compute with; whether there is a GPU, it may tell.

    NVIDIA's driver is a library, AMD's shows as a device of Linux. Looking takes less than a millisecond.
    """
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return os.path.exists("/dev/kfd")
    return True


def import_keeping_signals(name: str) -> Any:
    """Return a module that is imported without what it does to requests to end.

    pycolmap and pyceres bring the library glog, which takes SIGTERM for a crash: it prints a trace of the stack and
    ends the process, unseen by Python, whose own handler is put back here. Raises ImportError as the import does.
    """
    known = name in sys.modules
    module = importlib.import_module(name)
    if not known:
        handler = signal.getsignal(signal.SIGTERM)
        if handler is not None:  # None: not set by Python, which then cannot set it again
            with contextlib.suppress(ValueError):  # outside the main thread there are no handlers
                signal.signal(signal.SIGTERM, handler)
    return module
