"""The machine that computes a calibration: processor, cores and load, which the measured time depends on."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path

_CPU_INFO = Path("/proc/cpuinfo")


def machine_info() -> dict[str, str | int | float]:
    """Return processor, cores, load average of the last minute (-1 if unknown), system and Python version."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 0,
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else -1.0,
        "system": platform.system(),
        "python": platform.python_version(),
    }


@cache
def _processor() -> str:
    """Return the name of the processor; Linux has it in a file only."""
    try:
        lines = _CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return (next(names, "") or platform.processor() or platform.machine())[:200]
