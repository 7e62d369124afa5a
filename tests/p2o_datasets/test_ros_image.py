from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import PIL.Image
import pytest
from p2o import InputError
from p2o_datasets.bags.messages import CompressedImageMessage, Header, ImageMessage
from p2o_datasets.ros_image import rgb_of

RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
HEADER = Header(0, "camera")
SIZE = (8, 6)


def message(pixels: Any, encoding: str, *, padding: int = 0, big: bool = False) -> ImageMessage:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    data = memoryview(np.ascontiguousarray(rows).reshape(-1).data)
    return ImageMessage(HEADER, len(pixels), pixels.shape[1], encoding, big, rows.shape[1], data)


def read(said: Any, size: tuple[int, int] = SIZE) -> Any:
    rgb, warnings = rgb_of(said, "bag: /image", "frame/image", size)
    assert rgb.shape == (size[1], size[0], 3)
    assert rgb.dtype == np.uint8
    return rgb, warnings


ALPHA = np.full((6, 8, 1), 7, np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[:, :, ::-1]),
        ("8UC3", RGB[:, :, ::-1]),
        ("rgba8", np.concatenate([RGB, ALPHA], axis=2)),
        ("bgra8", np.concatenate([RGB[:, :, ::-1], ALPHA], axis=2)),
        ("8UC4", np.concatenate([RGB[:, :, ::-1], ALPHA], axis=2)),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_colours_come_back_bit_by_bit(encoding: str, pixels: Any, padding: int) -> None:
    rgb, warnings = read(message(pixels, encoding, padding=padding))
    assert np.array_equal(rgb, RGB)
    assert warnings == ()


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_is_repeated_with_a_remark(encoding: str) -> None:
    rgb, warnings = read(message(RGB[:, :, 0], encoding))
    assert np.array_equal(rgb, np.repeat(RGB[:, :, :1], 3, axis=2))
    assert warnings == ("frame/image: grey image, repeated on three channels",)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_16_bit_keep_their_upper_8(bits: int, big: bool) -> None:
    words = np.arange(48).reshape(6, 8) * ((1 << bits) - 1) // 47
    rgb, warnings = read(message(words.astype(">u2" if big else "<u2"), "mono16", big=big))
    assert np.array_equal(rgb[:, :, 1], words >> (bits - 8))
    assert f"divided by {1 << (bits - 8)}" in warnings[-1]


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_mosaic_of_one_colour_is_that_colour(pattern: str) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    tile = np.array([[colour[pattern[0]], colour[pattern[1]]], [colour[pattern[2]], colour[pattern[3]]]], np.uint8)
    rgb, _ = read(message(np.tile(tile, (3, 4)), f"bayer_{pattern}8"))
    assert np.abs(rgb[1:-1, 1:-1].astype(int) - [200, 120, 40]).max() <= 1


@pytest.mark.parametrize(("encoding", "luma"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)])
def test_luma_of_pairs_of_pixels_is_taken_from_its_place(encoding: str, luma: int) -> None:
    pixels = np.full((6, 8, 2), 128, np.uint8)
    pixels[:, :, luma] = np.linspace(30, 220, 48).reshape(6, 8)
    rgb, _ = read(message(pixels, encoding))
    grey = (pixels[:, :, luma].astype(float) - 16) * 255 / 219
    assert np.abs(rgb.astype(float) - grey[:, :, None]).max() <= 2
    with pytest.raises(InputError, match="odd width"):
        read(message(pixels[:, :7], encoding), (7, 6))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"data": memoryview(b"12")}, r"contradicts its layout.*got 2 bytes"),
        ({"step": 23}, "contradicts its layout"),
        ({"step": 25}, "contradicts its layout"),
        ({"encoding": "32FC1"}, r"encoding of the image is not supported.*rgb8.*got 32FC1"),
        ({"width": 9}, r"does not fit the camera.*got 9x6 px"),
    ],
)
def test_pictures_that_are_not_what_they_say_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(replace(message(RGB, "rgb8"), **change))


def test_a_size_that_fills_the_memory_is_refused_before_anything_is_made() -> None:
    huge = replace(message(RGB, "rgb8"), width=30_000, height=6_000, step=90_000)
    with pytest.raises(InputError, match="too large"):
        rgb_of(huge, "bag", "frame", (30_000, 6_000))


def file_of(pixels: Any, form: str) -> bytes:
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels).save(buffer, form)
    return buffer.getvalue()


def test_compressed_pictures_are_decoded_as_files_are() -> None:
    said = CompressedImageMessage(HEADER, "rgb8; png compressed bgr8", memoryview(file_of(RGB, "PNG")))
    assert np.array_equal(read(said)[0], RGB)
    jpeg = file_of(np.full((6, 8, 3), 90, np.uint8), "JPEG")
    said = replace(said, format="jpeg", data=memoryview(jpeg))
    assert np.abs(read(said)[0].astype(int) - 90).max() <= 2
    with pytest.raises(InputError, match=r"truncated|damaged"):
        read(replace(said, data=memoryview(jpeg[:-20])))
    with pytest.raises(InputError, match="does not fit the camera"):
        read(said, (16, 6))
    with pytest.raises(InputError, match=r"format of the compressed image is not supported.*jpeg or png.*got h264"):
        read(replace(said, format="h264", data=memoryview(b"\0\0\0\1video")))
