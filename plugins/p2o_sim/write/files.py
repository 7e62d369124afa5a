"""Functions that the writers of the three layouts share: files in new folders, and lossless images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Frame, InputError
from p2o.reading import write_whole


def write_file(path: Path, data: bytes | str) -> None:
    """Write a file and create its folder; raises InputError if this fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        fault = "cannot make the folder"
        got = problem.strerror or str(problem)
        hint = "check the rights and the free space, or write elsewhere"
        raise InputError(fault, where=problem.filename or path.parent, got=got, hint=hint) from problem
    write_whole(path, data.encode() if isinstance(data, str) else data)


def png(pixels: Any) -> bytes:
    """Return the PNG file of pixels: (H, W, 3) uint8 RGB, or one channel (H, W) uint8 or uint16."""
    import cv2

    stored = pixels if np.ndim(pixels) == 2 else cv2.cvtColor(np.asarray(pixels), cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(".png", stored)[1].tobytes())


def numbers(values: Any) -> str:
    """Return numbers as text without loss of precision, separated by spaces."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, np.float64)))


def require(layout: str, frame: Frame, parts: Mapping[str, object]) -> None:
    """Raise InputError if the frame lacks data that the layout requires (None or False)."""
    for what, value in parts.items():
        if value is None or value is False:
            got = "a frame without it"
            hint = "write the layout folder, which accepts any frame"
            raise InputError(f"the layout {layout} needs {what}", where=frame.name, expected=what, got=got, hint=hint)
