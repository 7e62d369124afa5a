"""Convert images of ROS messages to RGB: raw pixels of the usual encodings, JPEG and PNG."""

from __future__ import annotations

from typing import Any

import numpy as np
from p2o import InputError, UInt8
from p2o.reading import MAX_PIXELS, decode_rgb, eight_bit

from p2o_datasets.bags.choice import DECODE
from p2o_datasets.bags.messages import CompressedImageMessage, ImageMessage

# Number of channels, and indices of red, green and blue. ROS does not define those of 8UC3; drivers use OpenCV's order.
_COLOURS = {
    "rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)), "8UC4": (4, (2, 1, 0)),
}  # fmt: skip
_GREY = ("mono8", "8UC1")
_GREY_16 = ("mono16", "16UC1")
# OpenCV names a Bayer pattern by its second row, ROS by the first.
_BAYER = {"bayer_rggb8": "BG", "bayer_bggr8": "RG", "bayer_gbrg8": "GR", "bayer_grbg8": "GB"}
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2"}
ENCODINGS = (*_COLOURS, *_GREY, *_GREY_16, *_BAYER, *_YUV)
_FILES = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")


def rgb_of(
    message: ImageMessage | CompressedImageMessage, where: object, name: str, size: tuple[int, int]
) -> tuple[UInt8, tuple[str, ...]]:
    """Return the image (H, W, 3) uint8 RGB of a message, and warnings that begin with `name`.

    Grey is repeated on three channels; 16 bit values are divided by the power of two that leaves 8 bit. `size` is the
    (width, height) of the camera in px.

    Raises InputError for another size, unsupported encodings, a length that contradicts the layout, and for JPEG and
    PNG as `read_rgb`.
    """
    if isinstance(message, CompressedImageMessage):
        data = bytes(message.data)
        if not data.startswith(_FILES):
            fault = "the format of the compressed image is not supported"
            raise InputError(fault, where=where, expected="jpeg or png", got=message.format or "nothing", hint=DECODE)
        return decode_rgb(data, where, name, size)
    if (message.width, message.height) != size:
        expected = f"{size[0]}x{size[1]} px"
        got = f"{message.width}x{message.height} px"
        hint = "is this the calibration of another camera or of the unrectified images?"
        raise InputError("the image size does not fit the camera", where=where, expected=expected, got=got, hint=hint)
    if message.width * message.height > MAX_PIXELS:
        raise InputError("the image is too large", where=where, expected=f"at most {MAX_PIXELS} pixels")
    return _decoded(message, where, name)


def _decoded(message: ImageMessage, where: object, name: str) -> tuple[UInt8, tuple[str, ...]]:
    encoding = message.encoding
    if encoding in _COLOURS:
        channels, order = _COLOURS[encoding]
        return np.ascontiguousarray(_rows(message, channels, where)[:, :, order]), ()
    if encoding in _GREY:
        return _repeated(_rows(message, 1, where)[:, :, 0], name)
    if encoding in _GREY_16:
        kind = ">u2" if message.is_bigendian else "<u2"
        words = np.ascontiguousarray(_rows(message, 2, where)).view(kind)[:, :, 0]
        grey, divisor = eight_bit(words)
        rgb, remarks = _repeated(grey, name)
        return rgb, (*remarks, f"{name}: 16 bit image, divided by {divisor}")
    if encoding in _BAYER:
        return _converted(_rows(message, 1, where)[:, :, 0], f"COLOR_Bayer{_BAYER[encoding]}2RGB"), ()
    if encoding in _YUV:
        if message.width % 2:
            got = f"{message.width} px"
            raise InputError("an image with chroma subsampling has an odd width", where=where, got=got)
        return _converted(_rows(message, 2, where), f"COLOR_YUV2RGB_{_YUV[encoding]}"), ()
    expected = " ".join(ENCODINGS)
    raise InputError("the encoding of the image is not supported", where=where, expected=expected, got=encoding)


def _rows(message: ImageMessage, pixel_bytes: int, where: object) -> Any:
    """Return the bytes (H, W, pixel_bytes) of the pixels; raises InputError if their number is wrong."""
    row = message.width * pixel_bytes
    if message.step < row or len(message.data) != message.step * message.height:
        least = f"at least {row} for {message.width} px {message.encoding}"
        expected, got = f"{message.height} rows of {message.step} bytes, {least}", f"{len(message.data)} bytes"
        raise InputError("the length of the image contradicts its layout", where=where, expected=expected, got=got)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    return rows[:, :row].reshape(message.height, message.width, pixel_bytes)


def _repeated(grey: UInt8, name: str) -> tuple[UInt8, tuple[str, ...]]:
    return np.repeat(grey[:, :, None], 3, axis=2), (f"{name}: grey image, repeated on three channels",)


def _converted(pixels: Any, code: str) -> UInt8:
    import cv2

    rgb: UInt8 = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, code))
    return rgb
