"""Packages with compiled code that does more than it should when it is imported."""

from __future__ import annotations

import contextlib
import importlib
import signal
import sys
from typing import Any


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
