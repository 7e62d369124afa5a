from __future__ import annotations

import io
import logging
import os
import struct
import sys
import warnings
import zlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import pytest
from p2o import InputError
from p2o.frames import image_file
from p2o.frames.image_file import read_rgb, read_uint16

from tests.p2o_datasets.kitti_files import write_image


def test_channels_come_as_red_green_blue_grey_is_repeated_with_a_warning_and_alpha_left_out(tmp_path: Path) -> None:
    written = write_image(tmp_path / "a.png")
    read, warnings = read_rgb(tmp_path / "a.png")
    assert np.array_equal(read, written)
    assert warnings == ()
    written = write_image(tmp_path / "a.png", grey=True)
    read, warnings = read_rgb(tmp_path / "a.png")
    assert all(np.array_equal(read[:, :, c], written) for c in range(3))
    assert warnings == ("a.png: grey image, repeated on three channels",)
    with_alpha = np.random.default_rng(0).integers(0, 256, (8, 9, 4), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    assert np.array_equal(read_rgb(tmp_path / "a.png")[0], with_alpha[:, :, 2::-1])


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_an_image_is_refused_wherever_it_is_cut_and_bytes_after_its_end_do_no_harm(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_image(path)
    before, data = read_rgb(path)[0], path.read_bytes()
    path.write_bytes(data + b"maker notes")
    assert np.array_equal(read_rgb(path)[0], before)
    for part in (0.3, 0.6, 0.9, 0.999):
        path.write_bytes(data[: int(part * len(data))])
        with pytest.raises(InputError, match=rf"a\.{suffix}: the image is truncated"):
            read_rgb(path)


@pytest.mark.parametrize("content", [b"hello, I am text", b"\x00" * 100, b"\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_no_picture_or_has_one_wrong_bit_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.png: the image is (not a supported image|truncated)"):
        read_rgb(tmp_path / "a.png")
    data = bytearray(encoded(scene(48, 32), "PNG"))
    data[len(data) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match=r"a\.png: the image is damaged"):
        read_rgb(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_sixteen_bits_are_scaled_to_eight_with_a_remark(tmp_path: Path, suffix: str, channels: int, bits: int) -> None:
    stored = np.arange(6 * 8 * channels).reshape(6, 8, channels) * ((1 << bits) - 1) // (48 * channels - 1)
    path = tmp_path / f"d.{suffix}"
    cv2.imwrite(str(path), stored.astype(np.uint16))
    read, warnings = read_rgb(path, (8, 6))
    expected = (stored >> (bits - 8)).astype(np.uint8)[:, :, [2, 1, 0] if channels > 1 else [0, 0, 0]]
    if channels == 4:  # the largest value is that of the transparency
        expected = expected >> max(int(stored[:, :, :3].max()).bit_length() - bits, 0)
    assert read.dtype == np.uint8
    assert np.array_equal(read, expected)
    assert warnings[-1] == f"d.{suffix}: 16 bit image, divided by {1 << (bits - 8)}"
    assert len(warnings) == (2 if channels == 1 else 1)


def test_damaged_pngs_and_tiffs_print_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pixels = np.random.default_rng(0).integers(0, 4096, (40, 60, 3)).astype(np.uint16)
    for name in ("a.png", "a.tif"):
        data = cv2.imencode(Path(name).suffix, pixels)[1].tobytes()
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        with pytest.raises(InputError, match=r"the image is (truncated|damaged)"):
            read_rgb(tmp_path / name)
    assert capfd.readouterr() == ("", "")
    (tmp_path / "a.png").write_bytes(png(400, 300))
    with pytest.raises(InputError, match=r"a\.png: the image is damaged"):
        read_rgb(tmp_path / "a.png")
    body = b"iCCPsRGB\0\0" + zlib.compress(b"no profile")
    bad = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    good = encoded(scene(48, 32), "PNG")
    (tmp_path / "b.png").write_bytes(good[:33] + bad + good[33:])
    assert np.array_equal(read_rgb(tmp_path / "b.png")[0], scene(48, 32))
    assert capfd.readouterr() == ("", "")


def tagged(tag: int, kind: str, height: int = 32) -> bytes:
    """Return a picture with a tag of rotation."""
    exif = PIL.Image.Exif()
    exif[0x0112] = tag
    return encoded(scene(48, height), kind, exif=exif)


TURNED = {5: "TRANSPOSE", 6: "ROTATE_270", 7: "TRANSVERSE", 8: "ROTATE_90"}


@pytest.mark.parametrize("tag", TURNED)
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_the_size_of_the_camera_decides_about_a_rotation_tag(tmp_path: Path, tag: int, kind: str) -> None:
    (tmp_path / "a.img").write_bytes(tagged(tag, kind))
    (tmp_path / "b.img").write_bytes(encoded(scene(48, 32), kind))
    stored, no_remarks = read_rgb(tmp_path / "b.img", (48, 32))
    assert no_remarks == ()
    read, (remark,) = read_rgb(tmp_path / "a.img", (48, 32))
    assert np.array_equal(read, stored)
    assert remark.startswith("a.img: its EXIF tag of rotation is ignored")
    read, (remark,) = read_rgb(tmp_path / "a.img", (32, 48))
    assert np.array_equal(read, PIL.Image.fromarray(stored).transpose(getattr(PIL.Image.Transpose, TURNED[tag])))
    assert remark == "a.img: rotated by its EXIF tag to 32x48 px"
    with pytest.raises(InputError, match="has a rotation tag"):
        read_rgb(tmp_path / "a.img", (40, 40))
    with pytest.raises(InputError, match="does not fit the camera; expected 40x41 px; got 48x32 px"):
        read_rgb(tmp_path / "a.img", (40, 41))


@pytest.mark.parametrize("tag", [2, 3, 4, 6])
def test_a_rotation_tag_about_which_the_size_does_not_decide_is_refused(tmp_path: Path, tag: int) -> None:
    (tmp_path / "a.jpg").write_bytes(tagged(tag, "JPEG", 48))
    (tmp_path / "a.tif").write_bytes(tagged(tag, "TIFF"))
    with pytest.raises(InputError, match=rf"a\.tif: the image has a rotation tag; .*got EXIF {tag}"):
        read_rgb(tmp_path / "a.tif", (48, 32))
    for size in (None, (48, 48)):
        with pytest.raises(InputError, match=rf"rotation tag; .*got EXIF {tag}; .*auto-orient\), or remove the tag"):
            read_rgb(tmp_path / "a.jpg", size)
    for none in (0, 1, 9):  # tags of no rotation
        (tmp_path / "a.png").write_bytes(tagged(none, "PNG"))
        assert read_rgb(tmp_path / "a.png", (48, 32))[1] == ()


def test_sixteen_bits_are_read_as_disparity_and_eight_are_refused(tmp_path: Path) -> None:
    stored = np.array([[0, 256, 300], [65535, 1, 0]], np.uint16)
    cv2.imwrite(str(tmp_path / "d.png"), stored)
    disparity = read_uint16(tmp_path / "d.png", "disparity")
    assert np.array_equal(np.isnan(disparity), stored == 0)
    assert np.array_equal(disparity[stored > 0], stored[stored > 0] / 256)
    write_image(tmp_path / "d.png", grey=True)
    with pytest.raises(InputError, match=r"d\.png: the disparity is not a 16 bit image"):
        read_uint16(tmp_path / "d.png", "disparity")


def scene(width: int = 160, height: int = 120) -> np.ndarray:
    """Return a picture (H, W, 3) with large and small detail, so that a JPEG of it holds both."""
    rng = np.random.default_rng(4)
    coarse = cv2.resize(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), (width, height))
    return np.clip(coarse + rng.normal(0, 8, (height, width, 3)), 0, 255).astype(np.uint8)


def encoded(pixels: Any, kind: str, **options: Any) -> bytes:
    file = io.BytesIO()
    (PIL.Image.fromarray(pixels) if isinstance(pixels, np.ndarray) else pixels).save(file, kind, **options)
    return file.getvalue()


JPEGS = {
    "usual": encoded(scene(), "JPEG", quality=90),
    "progressive": encoded(scene(), "JPEG", quality=90, progressive=True),
    "full colours": encoded(scene(), "JPEG", quality=95, subsampling=0),
    "grey": encoded(scene()[:, :, 0], "JPEG"),
    "with restarts": cv2.imencode(".jpg", scene(), [cv2.IMWRITE_JPEG_RST_INTERVAL, 3])[1].tobytes(),
}


def scan_of(data: bytes) -> int:
    """Return where the data of the first scan begin."""
    at = data.index(b"\xff\xda")
    return at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")


@pytest.mark.parametrize("kind", JPEGS)
def test_every_kind_of_jpeg_has_the_pixels_that_opencv_finds_and_none_when_damaged(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str
) -> None:
    """Cut off with an end mark, with half of its scan overwritten, or with bytes left over after the last block."""
    path, data, begin = tmp_path / "a.jpg", JPEGS[kind], scan_of(JPEGS[kind])
    path.write_bytes(data)
    wanted = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert np.array_equal(read_rgb(path, (160, 120))[0], wanted)
    middle = (begin + len(data)) // 2
    damaged = [data[: begin + int(part * (len(data) - begin))] for part in (0.1, 0.5, 0.9)]
    damaged += [data[:middle] + byte * (len(data) - middle - 2) for byte in (b"\x00", b"\x55")]
    for content in damaged:
        path.write_bytes(content + b"\xff\xd9")
        with pytest.raises(InputError, match=r"a\.jpg: the image is damaged"):
            read_rgb(path)
    path.write_bytes(JPEGS["usual"][:-2] + b"\x55" * 100 + b"\xff\xd9")
    with pytest.raises(InputError, match=r"a\.jpg: the image is damaged; .*extraneous bytes"):
        read_rgb(path)
    assert capfd.readouterr() == ("", "")


def png(width: int, height: int, *, bits: int = 8, colour: int = 2, extra: bytes = b"") -> bytes:
    """Return a PNG of zeros that says this size and holds a hundredth of it."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    pixels = zlib.compress(bytes(width * height // 100))
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + extra + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def huge(kind: str) -> bytes:
    """Return a small picture whose header says 60000 x 16000 px."""
    small = np.zeros((4, 4, 3), np.uint8)
    if kind == "PNG":
        return png(60000, 16000)
    data = bytearray(encoded(small, kind, **({"lossless": True} if kind == "WEBP" else {})))
    if kind == "JPEG":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", 16000, 60000)
    elif kind == "BMP":
        data[18:26] = struct.pack("<ii", 60000, 16000)
    elif kind == "WEBP":
        data[21:25] = struct.pack("<I", 16383 | 16383 << 14)
    else:
        for tag, value in ((256, 60000), (257, 16000)):
            at = data.index(struct.pack("<HHI", tag, 4, 1)) if struct.pack("<HHI", tag, 4, 1) in data else -1
            at = at if at >= 0 else data.index(struct.pack("<HHI", tag, 3, 1))
            data[at : at + 12] = struct.pack("<HHII", tag, 4, 1, value)
    return bytes(data)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "BMP", "TIFF", "WEBP"])
def test_a_header_of_another_or_an_absurd_size_is_refused_before_anything_is_decoded(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.png").write_bytes(huge(kind))
    with pytest.raises(InputError, match=r"a\.png: the image is too large; expected at most 67108864 pixels"):
        read_rgb(tmp_path / "a.png", (60000, 16000))
    monkeypatch.setattr(image_file, "MAX_PIXELS", 1 << 40)
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", None)
    with pytest.raises(InputError, match=r"a\.png: the image size does not fit the camera; expected 640x480 px; got"):
        read_rgb(tmp_path / "a.png", (640, 480))


@pytest.mark.parametrize("size", [(160, 121), (161, 120), (120, 160)])
def test_an_image_that_differs_in_one_direction_only_is_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    (tmp_path / "a.png").write_bytes(encoded(scene(160, 120), "PNG"))
    with pytest.raises(InputError, match=rf"expected {size[0]}x{size[1]} px; got 160x120 px"):
        read_rgb(tmp_path / "a.png", size)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "BMP", "TIFF", "WEBP"])
def test_every_format_gives_its_pixels_and_none_when_cut(tmp_path: Path, kind: str) -> None:
    pixels = scene(48, 32)
    data = encoded(pixels, kind, **({"lossless": True} if kind == "WEBP" else {}))
    (tmp_path / "a.png").write_bytes(data)
    read, warnings = read_rgb(tmp_path / "a.png", (48, 32))
    assert warnings == ()
    assert np.abs(read.astype(int) - pixels).mean() <= (9 if kind == "JPEG" else 0)
    read[0, 0] = 0  # may be written to
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"a\.png: the image (is (truncated|damaged|not a supp)|cannot be decoded)"):
        read_rgb(tmp_path / "a.png")


@pytest.mark.parametrize("packing", ["tiff_lzw", "tiff_adobe_deflate", "packbits"])
def test_packed_tiffs_are_read_and_their_library_keeps_quiet(
    tmp_path: Path, packing: str, capfd: pytest.CaptureFixture[str]
) -> None:
    pixels = scene(48, 32)
    data = encoded(pixels, "TIFF", compression=packing)
    (tmp_path / "a.tif").write_bytes(data)
    assert np.array_equal(read_rgb(tmp_path / "a.tif")[0], pixels)
    (tmp_path / "a.tif").write_bytes(data[:8] + b"\xff" * 400 + data[408:])
    # Packed bits have no rule that could be broken, and nothing to say.
    with pytest.raises(InputError, match="damaged") if packing != "packbits" else nullcontext():
        read_rgb(tmp_path / "a.tif")
    print("heard", file=sys.stderr, flush=True)
    os.write(2, b"again")
    assert capfd.readouterr() == ("", "heard\nagain")


def test_tiffs_in_parallel_keep_stderr_handlers_and_filters(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.tif").write_bytes(encoded(scene(480, 320), "TIFF", compression="tiff_lzw"))
    read_rgb(tmp_path / "a.tif")
    before = list(logging.getLogger("PIL").handlers), list(warnings.filters)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: read_rgb(tmp_path / "a.tif"), range(64)))
    assert (logging.getLogger("PIL").handlers, warnings.filters) == before
    os.write(2, b"a later error")
    assert capfd.readouterr() == ("", "a later error")


def test_palettes_and_single_bits_are_read_and_pixels_that_are_not_those_of_a_camera_refused(tmp_path: Path) -> None:
    for name, data, why in (
        ("a.tif", encoded(scene(48, 32), "TIFF", compression="jpeg"), "a TIFF with an unsupported .*got jpeg"),
        ("c.jpg", encoded(PIL.Image.new("CMYK", (16, 16)), "JPEG"), "not RGB; .*got (CMYK|YCCK); store it as an RGB"),
        ("e.tif", encoded(np.zeros((4, 4), np.float32), "TIFF"), "not 8 or 16 bit"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=rf"{name}: the image is {why}"):
            read_rgb(tmp_path / name)
    pixels = np.repeat(np.repeat(scene(8, 6), 4, axis=0), 4, axis=1) // 128 * 255
    PIL.Image.fromarray(pixels).quantize(8).save(tmp_path / "a.png")
    assert np.array_equal(read_rgb(tmp_path / "a.png")[0], pixels)
    PIL.Image.fromarray(pixels[:, :, 0]).convert("1").save(tmp_path / "b.png")
    read, warnings = read_rgb(tmp_path / "b.png")
    assert np.array_equal(read[:, :, 1], pixels[:, :, 0])
    assert warnings == ("b.png: grey image, repeated on three channels",)
