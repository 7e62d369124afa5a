"""Reading pictures: PNG, JPEG, BMP, TIFF and WebP; what is cut off, damaged or of another size is refused."""

from __future__ import annotations

import io
import logging
import os
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import Float, UInt8
from p2o.files.input_file import read_bytes

MAX_PIXELS = 1 << 26
"""No camera on a car has as many; what is decoded and what is made of it fit into the memory."""
MAX_BYTES = 256 << 20
"""No picture takes more."""
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
# A progressive picture has about ten; each takes the time of a whole one.
_MAX_SCANS = 200
_GREY = ("1", "L", "LA")
_COLOUR = ("P", "PA", "RGB", "RGBA", "RGBX", "YCbCr")
_TIFF_PACKINGS = ("raw", "packbits", "tiff_lzw", "tiff_deflate", "tiff_adobe_deflate")
_WORDS = ("I;16", "I;16B", "I;16L", "I;16N")


def read_rgb(path: Path, size: tuple[int, int] | None = None) -> tuple[UInt8, tuple[str, ...]]:
    """Return a picture (H, W, 3) uint8 RGB and warnings (a grey picture is repeated on three channels).

    `size` is the (width, height) in px of the camera, where it is known. Rotation tags (EXIF) are ignored: a camera is
    calibrated on stored pixels.

    Raises InputError if the file is missing, a folder, empty, unreadable, damaged, truncated, not a picture, not 8 bit
    or of another size; a size that is wrong or too large is told by the header, before anything is decoded.
    """
    return decode_rgb(read_bytes(path, "image", MAX_BYTES), path, path.name, size)


def decode_rgb(
    data: bytes, where: object, name: str, size: tuple[int, int] | None = None
) -> tuple[UInt8, tuple[str, ...]]:
    """Return the picture that the bytes of a file hold, and warnings that begin with `name`; see `read_rgb`."""
    pixels = _decode(data, where, "image", size)
    if pixels.dtype != np.uint8:
        raise InputError("the image is not 8 bit", where=where, expected="uint8", got=pixels.dtype)
    if pixels.ndim == 2:
        return np.repeat(pixels[:, :, None], 3, axis=2), (f"{name}: grey image, repeated on three channels",)
    return pixels, ()


def read_uint16(path: Path, what: str, size: tuple[int, int] | None = None) -> Float:
    """Return a 16 bit one-channel PNG as values / 256, (H, W) float64 with NaN where the file says 0.

    This is KITTI's way to store disparity (px) and depth (m). Raises InputError as `read_rgb`.
    """
    pixels = _decode(read_bytes(path, what, MAX_BYTES), path, what, size)
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


def _decode(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Return the stored pixels, (H, W) or (H, W, 3), uint8 or uint16; raises InputError for anything incomplete."""
    if data.startswith(_JPEG):
        return _decode_jpeg(data, path, what, size)
    if data.startswith(_PNG):
        _check_png(data, path, what)
    elif data.startswith(b"RIFF"):
        # Its decoder takes memory for the whole canvas when it is opened.
        _check_size(_webp_size(data), path, what, size)
    return _decode_other(data, path, what, size)


def _decode_jpeg(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Return the pixels of a JPEG; whatever its decoder complains about is damage.

    Not OpenCV: it fills what is missing with grey, and tells nobody but stderr. A flipped bit that leaves as many
    blocks as before is a fault that no decoder can see.
    """
    import simplejpeg

    # Scan data never holds FF DA or FF D9 unescaped, so an end marker must follow the last start of scan.
    if data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise InputError(f"the {what} is truncated", where=path, expected="a JPEG end marker", got=f"{len(data)} bytes")
    if data.count(b"\xff\xda") > _MAX_SCANS:
        raise InputError(f"the {what} is damaged", where=path, expected=f"at most {_MAX_SCANS} scans")
    try:
        height, width, colours, _ = simplejpeg.decode_jpeg_header(data, strict=False)
        _check_size((width, height), path, what, size)
        if colours not in ("Gray", "RGB", "YCbCr"):
            raise InputError(f"the {what} is not RGB", where=path, expected="1 or 3 channels", got=colours)
        pixels = simplejpeg.decode_jpeg(data, "GRAY" if colours == "Gray" else "RGB", strict=True)
    except KeyError as problem:  # the subsampling of its colours, which the library looks up
        raise InputError(
            f"the {what} cannot be decoded",
            where=path,
            expected="a JPEG with a usual subsampling of colours",
            got="another, or a damaged header",
            hint="store it as .png",
        ) from problem
    except (ValueError, MemoryError, OverflowError) as problem:
        raise InputError(
            f"the {what} is damaged",
            where=path,
            expected="a JPEG that decodes without complaint",
            got=str(problem)[:200],
            hint="take it from its source again",
        ) from problem
    return pixels[:, :, 0] if colours == "Gray" else pixels


def _decode_other(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Return the pixels of a PNG, BMP, TIFF or WebP picture."""
    import PIL.Image

    # What it has to say is said as an error, or of no use; without a handler Python prints it.
    logging.getLogger("PIL").addHandler(logging.NullHandler())
    try:
        with warnings.catch_warnings(action="ignore"), _quiet(data[:2] in (b"II", b"MM")):
            picture = PIL.Image.open(io.BytesIO(data), formats=("PNG", "BMP", "TIFF", "WEBP"))
            with picture:
                _check_size(picture.size, path, what, size)
                turned = picture.format == "TIFF" and picture.getexif().get(0x0112, 1) != 1
                wide = picture.mode not in _WORDS and ";16" in str([tile[3] for tile in picture.tile])
                mode, packing = picture.mode, picture.info.get("compression", "raw")
                if picture.format == "TIFF" and packing not in _TIFF_PACKINGS:
                    raise InputError(
                        f"the {what} is a TIFF of a packing that is not read",
                        where=path,
                        expected=" ".join(_TIFF_PACKINGS),
                        got=packing,
                        hint="store it as .png",
                    )
                if not turned and not wide and mode in (*_GREY, *_COLOUR, *_WORDS):
                    kept = mode if mode in _WORDS else "L" if mode in _GREY else "RGB"
                    return np.array(picture if mode == kept else picture.convert(kept))
    except InputError:
        raise
    except PIL.UnidentifiedImageError as problem:
        raise InputError(
            f"the {what} is not a picture that p2o reads", where=path, expected="PNG, JPEG, BMP, TIFF or WebP"
        ) from problem
    except PIL.Image.DecompressionBombError as problem:
        raise _too_large(what, path, str(problem)[:100]) from problem
    except Exception as problem:  # a decoder meets bytes that may say anything
        raise InputError(
            f"the {what} is damaged", where=path, expected="a picture that can be decoded", got=str(problem)[:200]
        ) from problem
    if turned:
        raise InputError(
            f"the {what} is stored turned", where=path, expected="orientation 1 (upright)", hint="store it upright"
        )
    if wide or mode in ("I", "F"):
        raise InputError(f"the {what} is not 8 bit", where=path, expected="uint8", got="uint16" if wide else mode)
    raise InputError(f"the {what} is not RGB", where=path, expected="1, 3 or 4 channels", got=mode)


@contextmanager
def _quiet(on: bool) -> Iterator[None]:
    """Keep what is written to the process's stderr away from it: libtiff prints there, and cannot be told not to."""
    try:
        kept = os.dup(2) if on else None
    except OSError:  # closed
        kept = None
    if kept is None:
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _check_size(have: tuple[int, int], path: object, what: str, size: tuple[int, int] | None) -> None:
    """Raise InputError if the size (width, height) that a header says is another than the camera's, or too large."""
    if have[0] * have[1] > MAX_PIXELS:
        raise _too_large(what, path, f"{have[0]}x{have[1]} px")
    if size is not None and have != size:
        raise InputError(
            f"the {what} size does not fit the camera",
            where=path,
            expected=f"{size[0]}x{size[1]} px",
            got=f"{have[0]}x{have[1]} px",
            hint="is this the calibration of another camera or of the unrectified images?",
        )


def _too_large(what: str, path: object, got: str) -> InputError:
    return InputError(f"the {what} is too large", where=path, expected=f"at most {MAX_PIXELS} pixels", got=got)


def _webp_size(data: bytes) -> tuple[int, int]:
    """Return the width and height of a WebP picture in px; zeros where the bytes are none."""
    kind, body = data[12:16], data[20:30].ljust(10, b"\0")
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF


def _check_png(data: bytes, path: object, what: str) -> None:
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
