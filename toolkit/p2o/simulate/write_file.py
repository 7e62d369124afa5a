"""What the writers of the three layouts share: whole files in folders made on the way, and lossless pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from p2o.errors import InputError
from p2o.files.whole_file import write_whole
from p2o.frames.frame import Frame


def write_file(path: Path, data: bytes | str) -> None:
    """Write a file whole, making its folder; raises InputError where that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(
            "cannot make the folder",
            where=problem.filename or path.parent,
            got=problem.strerror or str(problem),
            hint="check the rights and the free space, or write elsewhere",
        ) from problem
    write_whole(path, data.encode() if isinstance(data, str) else data)


def png(pixels: Any) -> bytes:
    """Return the PNG file of pixels: (H, W, 3) uint8 RGB, or one channel (H, W) uint8 or uint16."""
    import cv2

    stored = pixels if np.ndim(pixels) == 2 else cv2.cvtColor(np.asarray(pixels), cv2.COLOR_RGB2BGR)
    return bytes(cv2.imencode(".png", stored)[1].tobytes())


def numbers(values: Any) -> str:
    """Return numbers as text that reads back exactly, separated by spaces."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, np.float64)))


def require(layout: str, frame: Frame, parts: Mapping[str, object]) -> None:
    """Raise InputError where the layout has to know something that the frame does not hold (None or False)."""
    for what, held in parts.items():
        if held is None or held is False:
            raise InputError(
                f"the layout {layout} needs {what}",
                where=frame.name,
                expected=what,
                got="a frame without",
                hint="write the layout folder, which takes any frame",
            )
