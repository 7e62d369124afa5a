"""Read PNG, JPEG, BMP, TIFF and WebP images; truncated and damaged files and images of a wrong size are refused."""

from __future__ import annotations

import io
import logging
import os
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float, UInt8
from p2o.errors import InputError
from p2o.files.input_file import read_bytes

MAX_PIXELS = 1 << 26
"""Largest image in pixels: above the resolution of automotive cameras, and small enough to process in memory."""
MAX_BYTES = 256 << 20
"""Largest image file in bytes."""
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
# A progressive JPEG has about ten scans; each takes as long to decode as a whole image.
_MAX_SCANS = 200
_GREY = ("1", "L", "LA")
_COLOUR = ("P", "PA", "RGB", "RGBA", "RGBX", "YCbCr")
_TIFF_PACKINGS = ("raw", "packbits", "tiff_lzw", "tiff_deflate", "tiff_adobe_deflate")
_WORDS = ("I;16", "I;16B", "I;16L", "I;16N")
_TIFF, _EXIF = (b"II", b"MM"), (b"Exif\0\0", b"eXIf", b"EXIF")
"""Marks of TIFF, whose tags include the rotation, and of the EXIF data of JPEG, PNG and WebP."""
_ORIENTATION = 0x0112
"""EXIF tag. 1 is upright; up to 4 the size is that of the stored pixels, above width and height are exchanged."""
_ROTATIONS: dict[int, Callable[[Any], Any]] = {
    5: lambda pixels: pixels.swapaxes(0, 1),
    6: lambda pixels: np.rot90(pixels, -1),
    7: lambda pixels: np.rot90(pixels.swapaxes(0, 1), 2),
    8: np.rot90,
}  # fmt: skip


def read_rgb(path: Path, size: tuple[int, int] | None = None) -> tuple[UInt8, tuple[str, ...]]:
    """Read an image as (H, W, 3) uint8 RGB, with warnings.

    A grey image is repeated on three channels, and 16 bit values are scaled to 8 bit (`eight_bit`). `size` is the
    (width, height) of the camera in px, if known. It decides whether an image with a rotation tag (EXIF) is rotated:
    programs differ in whether they calibrate on stored or on rotated pixels. Raises InputError if the file is missing,
    a folder, empty, unreadable, damaged, truncated, not an image, of another number of bits or of another size, and if
    the size does not decide about a rotation tag. The size is read from the header and checked before decoding.
    """
    return decode_rgb(read_bytes(path, "image", MAX_BYTES), path, path.name, size)


def decode_rgb(
    data: bytes, where: object, name: str, size: tuple[int, int] | None = None
) -> tuple[UInt8, tuple[str, ...]]:
    """Decode the bytes of an image file; warnings begin with `name`. See `read_rgb`."""
    pixels, remarks = _decode(data, where, "image", size)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
        remarks = (*remarks, "grey image, repeated on three channels")
    if pixels.dtype == np.uint16:
        pixels, divisor = eight_bit(pixels)
        remarks = (*remarks, f"16 bit image, divided by {divisor}")
    return pixels, tuple(f"{name}: {remark}" for remark in remarks)


def eight_bit(values: Any) -> tuple[UInt8, int]:
    """Divide 16 bit values by the power of two that leaves 8 bit for the largest one; also return the divisor."""
    shift = max(int(values.max(initial=0)).bit_length() - 8, 0)
    return (values >> shift).astype(np.uint8), 1 << shift


def read_uint16(path: Path, what: str, size: tuple[int, int] | None = None) -> Float:
    """Read a 16 bit one-channel PNG as values / 256, (H, W) float64, with NaN for 0.

    This is the KITTI format of disparity (px) and depth (m). Raises InputError as `read_rgb`.
    """
    pixels, _ = _decode(read_bytes(path, what, MAX_BYTES), path, what, size)
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        text = f"the {what} is not a 16 bit image of one channel"
        raise InputError(text, where=path, expected="(H, W) uint16", got=f"{pixels.shape} {pixels.dtype}")
    values: Float = pixels / 256.0
    values[pixels == 0] = np.nan
    return values


def _decode(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> tuple[Any, tuple[str, ...]]:
    """Decode the pixels, (H, W) or (H, W, 3), uint8 or uint16, and return remarks on their rotation.

    Raises InputError for incomplete files, and for a rotation tag of TIFF or about which the size does not decide.
    """
    tag = _orientation(data)
    if tag == 1:
        return _decode_stored(data, path, what, size), ()
    # Decoders of TIFF differ in whether they apply the tag.
    if tag not in _ROTATIONS or size is None or size[0] == size[1] or data.startswith(_TIFF):
        expected = "upright pixels, without this tag (1)"
        hint = "store it as the camera was calibrated: apply the rotation (mogrify -auto-orient), or remove the tag"
        raise InputError(f"the {what} has a rotation tag", where=path, expected=expected, got=f"EXIF {tag}", hint=hint)
    pixels = _decode_stored(data, path, what, None)
    stored = pixels.shape[1::-1]
    if stored == size[::-1]:
        return np.ascontiguousarray(_ROTATIONS[tag](pixels)), (f"rotated by its EXIF tag to {size[0]}x{size[1]} px",)
    _check_size(stored, path, what, size)
    return pixels, ("its EXIF tag of rotation is ignored, because the camera has the size of the stored pixels",)


def _orientation(data: bytes) -> int:
    """Return the rotation tag of an image file; 1 (upright) without a readable tag."""
    if not (data.startswith(_TIFF) or any(mark in data for mark in _EXIF)):
        return 1
    pillow = _pillow()
    try:
        with pillow.Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "TIFF", "WEBP")) as image:
            tag = int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # decoders raise any exception for damaged bytes; the pixels decide whether the file is refused
        return 1
    return tag if 1 <= tag <= 8 else 1


def _decode_stored(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Decode the stored pixels; raises InputError for incomplete files."""
    if data.startswith(_JPEG):
        return _decode_jpeg(data, path, what, size)
    if data.startswith(_PNG):
        _check_png(data, path, what)
    elif data.startswith(b"RIFF"):
        # The WebP decoder allocates the whole canvas when it opens a file.
        _check_size(_webp_size(data), path, what, size)
    return _decode_other(data, path, what, size)


def _decode_jpeg(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Decode a JPEG; any warning of the decoder is an error (OpenCV fills missing blocks with grey instead)."""
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
            raise InputError(
                f"the {what} is not RGB", where=path, expected="1 or 3 channels", got=colours, hint=_CONVERT
            )
        pixels = simplejpeg.decode_jpeg(data, "GRAY" if colours == "Gray" else "RGB", strict=True)
    except KeyError as problem:  # unknown chroma subsampling
        text, expected = f"the {what} cannot be decoded", "a common chroma subsampling"
        got = "another one, or a damaged header"
        raise InputError(text, where=path, expected=expected, got=got, hint="store it as .png") from problem
    except (ValueError, MemoryError, OverflowError) as problem:
        text, expected = f"the {what} is damaged", "a JPEG that decodes without warnings"
        hint = "copy it from its source again"
        raise InputError(text, where=path, expected=expected, got=str(problem)[:200], hint=hint) from problem
    return pixels[:, :, 0] if colours == "Gray" else pixels


@cache
def _pillow() -> Any:
    """Import Pillow, once per process, because warning filters are process-wide, and silence its log and warnings."""
    import PIL.Image

    logging.getLogger("PIL").addHandler(logging.NullHandler())  # without a handler Python prints errors
    warnings.filterwarnings("ignore", module=r"PIL\.")
    return PIL


def _decode_other(data: bytes, path: object, what: str, size: tuple[int, int] | None) -> Any:
    """Decode a PNG, BMP, TIFF or WebP image."""
    pillow = _pillow()
    try:
        with pillow.Image.open(io.BytesIO(data), formats=("PNG", "BMP", "TIFF", "WEBP")) as image:
            _check_size(image.size, path, what, size)
            wide = image.mode not in _WORDS and ";16" in str([tile[3] for tile in image.tile])
            mode, packing = image.mode, image.info.get("compression", "raw")
            if image.format == "TIFF" and packing not in _TIFF_PACKINGS:
                text, expected = f"the {what} is a TIFF with an unsupported compression", " ".join(_TIFF_PACKINGS)
                raise InputError(text, where=path, expected=expected, got=packing, hint="store it as .png")
            if wide and mode in (*_GREY, *_COLOUR):
                with _stderr_silenced():
                    image.load()
                    return _decode_wide(data)
            if not wide and mode in (*_GREY, *_COLOUR, *_WORDS):
                kept = mode if mode in _WORDS else "L" if mode in _GREY else "RGB"
                with _stderr_silenced() if image.format == "TIFF" else nullcontext():
                    pixels = np.array(image if mode == kept else image.convert(kept))
                return pixels.astype(np.uint16) if kept in _WORDS else pixels
    except InputError:
        raise
    except pillow.UnidentifiedImageError as problem:
        message = f"the {what} is not a supported image"
        raise InputError(message, where=path, expected="PNG, JPEG, BMP, TIFF or WebP") from problem
    except pillow.Image.DecompressionBombError as problem:
        raise _too_large(what, path, str(problem)[:100]) from problem
    except Exception as problem:  # decoders raise any exception for damaged bytes
        message = f"the {what} is damaged"
        raise InputError(message, where=path, expected="a decodable image", got=str(problem)[:200]) from problem
    if mode in ("I", "F"):
        raise InputError(f"the {what} is not 8 or 16 bit", where=path, expected="uint8 or uint16", got=mode)
    raise InputError(f"the {what} is not RGB", where=path, expected="1, 3 or 4 channels", got=mode, hint=_CONVERT)


def _decode_wide(data: bytes) -> Any:
    """Decode 16 bit colours, (H, W, 3) uint16, and grey values with transparency, of which Pillow keeps 8 bit."""
    import cv2

    pixels: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[:, :, 2::-1])


_CONVERT = "store it as an RGB or grey .png"
_stderr_lock = threading.Lock()


@contextmanager
def _stderr_silenced() -> Iterator[None]:
    """Redirect file descriptor 2 to /dev/null, in one thread at a time: libtiff prints errors there."""
    with _stderr_lock:
        try:
            stderr = os.dup(2)
        except OSError:  # closed
            yield
            return
        try:
            with open(os.devnull, "wb") as null:
                os.dup2(null.fileno(), 2)
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


def _check_size(have: tuple[int, int], path: object, what: str, size: tuple[int, int] | None) -> None:
    """Raise InputError if the size (width, height) of a header is too large or differs from the camera's size."""
    if have[0] * have[1] > MAX_PIXELS:
        raise _too_large(what, path, f"{have[0]}x{have[1]} px")
    if size is not None and have != size:
        text = f"the {what} size does not fit the camera"
        hint = "is this the calibration of another camera or of the unrectified images?"
        if abs(have[0] * size[1] - have[1] * size[0]) <= max(*have, *size):  # the same shape, within rounding
            hint = f"if the image was resized, scale fx, fy, cx, cy by {have[0] / size[0]:.4g}, and write the new size"
        raise InputError(text, where=path, expected=f"{size[0]}x{size[1]} px", got=f"{have[0]}x{have[1]} px", hint=hint)


def _too_large(what: str, path: object, got: str) -> InputError:
    return InputError(f"the {what} is too large", where=path, expected=f"at most {MAX_PIXELS} pixels", got=got)


def _webp_size(data: bytes) -> tuple[int, int]:
    """Return the width and height of a WebP image in px; zeros if the header is incomplete."""
    kind, body = data[12:16], data[20:30].ljust(10, b"\0")
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF


def _check_png(data: bytes, path: object, what: str) -> None:
    """Check the chunks of a PNG; raises InputError if one is truncated or its checksum is wrong."""
    start = len(_PNG)
    while True:
        size = int.from_bytes(data[start : start + 4], "big")
        end = start + size + 12
        if len(data) < start + 12 or len(data) < end:
            text = f"the {what} is truncated"
            raise InputError(text, where=path, expected="a PNG end (IEND)", got=f"{len(data)} bytes")
        if zlib.crc32(data[start + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise InputError(f"the {what} is damaged", where=path, expected="valid PNG checksums")
        if data[start + 4 : start + 8] == b"IEND":
            return
        start = end
