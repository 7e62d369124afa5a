"""The picture of a ROS message as RGB: raw pixels of the usual encodings, and JPEG and PNG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from p2o import InputError
from p2o.arrays import UInt8
from p2o.bags.messages import CompressedImageMessage, ImageMessage

from p2o_plugins.data.image_file import MAX_PIXELS, decode_rgb

# Channels, and which of them are red, green and blue; ROS leaves 8UC3 open, OpenCV's order is what drivers mean.
_COLOURS: Mapping[str, tuple[int, tuple[int, int, int]]] = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8UC4": (4, (2, 1, 0)),
}
_GREY = ("mono8", "8UC1")
_WORDS = ("mono16", "16UC1")
# OpenCV names a mosaic by its second row, ROS by the first.
_BAYER = {"bayer_rggb8": "BG", "bayer_bggr8": "RG", "bayer_gbrg8": "GR", "bayer_grbg8": "GB"}
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2"}
ENCODINGS = (*_COLOURS, *_GREY, *_WORDS, *_BAYER, *_YUV)
_FILES = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")


def rgb_of(
    message: ImageMessage | CompressedImageMessage, where: object, name: str, size: tuple[int, int]
) -> tuple[UInt8, tuple[str, ...]]:
    """Return the picture (H, W, 3) uint8 RGB of a message, and warnings that begin with `name`.

    Grey is repeated on three channels; 16 bit are divided by the power of two that leaves 8. `size` is the (width,
    height) in px of the camera.

    Raises InputError for another size, encodings that are not read, bytes that are not as many as the message says,
    and JPEG and PNG as `read_rgb`.
    """
    if isinstance(message, CompressedImageMessage):
        data = bytes(message.data)
        if not data.startswith(_FILES):
            raise InputError(
                "the compressed image is of a format that is not read",
                where=where,
                expected="jpeg or png",
                got=message.format or "nothing",
            )
        return decode_rgb(data, where, name, size)
    if (message.width, message.height) != size:
        raise InputError(
            "the image size does not fit the camera",
            where=where,
            expected=f"{size[0]}x{size[1]} px",
            got=f"{message.width}x{message.height} px",
            hint="is this the calibration of another camera or of the unrectified images?",
        )
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
    if encoding in _WORDS:
        kind = ">u2" if message.is_bigendian else "<u2"
        words = np.ascontiguousarray(_rows(message, 2, where)).view(kind)[:, :, 0]
        shift = max(int(words.max(initial=0)).bit_length() - 8, 0)
        rgb, remarks = _repeated((words >> shift).astype(np.uint8), name)
        return rgb, (*remarks, f"{name}: 16 bit image, divided by {1 << shift}")
    if encoding in _BAYER:
        return _converted(_rows(message, 1, where)[:, :, 0], f"COLOR_Bayer{_BAYER[encoding]}2RGB"), ()
    if encoding in _YUV:
        if message.width % 2:
            raise InputError("an image of pairs of pixels has an odd width", where=where, got=f"{message.width} px")
        return _converted(_rows(message, 2, where), f"COLOR_YUV2RGB_{_YUV[encoding]}"), ()
    raise InputError(
        "the image is of an encoding that is not read", where=where, expected=" ".join(ENCODINGS), got=encoding
    )


def _rows(message: ImageMessage, pixel_bytes: int, where: object) -> Any:
    """Return the bytes (H, W, pixel_bytes) of the pixels; raises InputError where they are not as many."""
    row = message.width * pixel_bytes
    if message.step < row or len(message.data) != message.step * message.height:
        raise InputError(
            "the image has another length than it says",
            where=where,
            expected=f"{message.height} rows of {message.step} bytes, at least {row} for {message.width} px "
            f"{message.encoding}",
            got=f"{len(message.data)} bytes",
        )
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    return rows[:, :row].reshape(message.height, message.width, pixel_bytes)


def _repeated(grey: UInt8, name: str) -> tuple[UInt8, tuple[str, ...]]:
    return np.repeat(grey[:, :, None], 3, axis=2), (f"{name}: grey image, repeated on three channels",)


def _converted(pixels: Any, code: str) -> UInt8:
    import cv2

    rgb: UInt8 = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, code))
    return rgb
