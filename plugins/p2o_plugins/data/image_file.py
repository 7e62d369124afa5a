"""Reading pictures that OpenCV knows; cut-off ones are refused, where OpenCV would silently fill what is missing."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float, UInt8
from p2o.files.input_file import read_bytes

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"


def read_rgb(path: Path) -> tuple[UInt8, tuple[str, ...]]:
    """Return a picture (H, W, 3) uint8 RGB and warnings (a grey picture is repeated on three channels).

    Rotation tags (EXIF) are ignored: a camera is calibrated on stored pixels.

    Raises InputError if the file is missing, a folder, empty, unreadable, damaged, truncated, not a picture or not
    8 bit.
    """
    import cv2

    pixels = _decode(path, "image")
    if pixels.dtype != np.uint8:
        raise InputError("the image is not 8 bit", where=path, expected="uint8", got=pixels.dtype)
    if pixels.ndim == 2:
        return np.repeat(pixels[:, :, None], 3, axis=2), (f"{path.name}: grey image, repeated on three channels",)
    if pixels.shape[2] not in (3, 4):
        raise InputError("the image is not RGB", where=path, expected="1, 3 or 4 channels", got=pixels.shape[2])
    return cv2.cvtColor(pixels[:, :, :3], cv2.COLOR_BGR2RGB), ()


def read_uint16(path: Path, what: str) -> Float:
    """Return a 16 bit one-channel PNG as values / 256, (H, W) float64 with NaN where the file says 0.

    This is KITTI's way to store disparity (px) and depth (m). Raises InputError as `read_rgb`.
    """
    pixels = _decode(path, what)
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise InputError(
            f"the {what} is not a 16 bit picture of one channel",
            where=path,
            expected="(H, W) uint16",
            got=f"{pixels.shape} {pixels.dtype}",
        )
    values: Float = pixels / 256.0
    values[pixels == 0] = np.nan
    return values


def _decode(path: Path, what: str) -> Any:
    """Return the stored pixels as OpenCV orders them; raises InputError for anything incomplete."""
    import cv2

    data = read_bytes(path, what)
    if data.startswith(_PNG):
        _check_png(data, path, what)
    # Scan data never holds FF DA or FF D9 unescaped, so an end marker must follow the last start of scan.
    elif data.startswith(_JPEG) and data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise InputError(f"the {what} is truncated", where=path, expected="a JPEG end marker", got=f"{len(data)} bytes")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as problem:
        raise InputError(f"the {what} cannot be decoded", where=path, got=problem.err or "an OpenCV error") from problem
    if pixels is None:
        raise InputError(f"the {what} is not a picture that OpenCV reads", where=path, expected="PNG or JPEG")
    return pixels


def _check_png(data: bytes, path: Path, what: str) -> None:
    """Walk the chunks of a PNG; raises InputError if one is cut off or its checksum is wrong."""
    start = len(_PNG)
    while True:
        size = int.from_bytes(data[start : start + 4], "big")
        end = start + size + 12
        if len(data) < start + 12 or len(data) < end:
            raise InputError(
                f"the {what} is truncated", where=path, expected="a PNG end (IEND)", got=f"{len(data)} bytes"
            )
        if zlib.crc32(data[start + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise InputError(f"the {what} is damaged", where=path, expected="PNG checksums that fit")
        if data[start + 4 : start + 8] == b"IEND":
            return
        start = end
