from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from p2o import InputError
from p2o_plugins.data.image_file import read_rgb, read_uint16

from .kitti_files import write_image


def test_channels_come_as_red_green_blue(tmp_path: Path) -> None:
    written = write_image(tmp_path / "a.png")
    read, warnings = read_rgb(tmp_path / "a.png")
    assert np.array_equal(read, written)
    assert warnings == ()


def test_a_jpeg_is_read_close_to_what_was_written(tmp_path: Path) -> None:
    red = np.zeros((16, 24, 3), np.uint8)
    red[:, :, 2] = 200
    cv2.imwrite(str(tmp_path / "a.jpg"), red)
    read, _ = read_rgb(tmp_path / "a.jpg")
    assert np.abs(read.astype(int) - (200, 0, 0)).max() <= 4


def test_a_grey_image_is_repeated_with_a_warning(tmp_path: Path) -> None:
    written = write_image(tmp_path / "a.png", grey=True)
    read, warnings = read_rgb(tmp_path / "a.png")
    assert all(np.array_equal(read[:, :, c], written) for c in range(3))
    assert warnings == ("a.png: grey image, repeated on three channels",)


def test_an_alpha_channel_is_left_out(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (8, 9, 4), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    assert np.array_equal(read_rgb(tmp_path / "a.png")[0], pixels[:, :, 2::-1])


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("part", [0.3, 0.6, 0.9, 0.999])
def test_a_truncated_image_is_refused_wherever_it_is_cut(tmp_path: Path, suffix: str, part: float) -> None:
    path = tmp_path / f"a.{suffix}"
    write_image(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(InputError, match=rf"a\.{suffix}: the image is truncated"):
        read_rgb(path)


def test_a_png_with_one_wrong_bit_is_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    data = bytearray((tmp_path / "a.png").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match=r"a\.png: the image is damaged"):
        read_rgb(tmp_path / "a.png")


def test_bytes_after_the_end_of_an_image_do_no_harm(tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg"):
        write_image(tmp_path / name)
        before = read_rgb(tmp_path / name)[0]
        with (tmp_path / name).open("ab") as file:
            file.write(b"maker notes")
        assert np.array_equal(read_rgb(tmp_path / name)[0], before)


@pytest.mark.parametrize("content", [b"hello, I am text", b"\x00" * 100, b"\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_no_picture_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.png: the image is (not a picture|truncated)"):
        read_rgb(tmp_path / "a.png")


def test_sixteen_bits_are_refused_as_a_picture_and_read_as_disparity(tmp_path: Path) -> None:
    stored = np.array([[0, 256, 300], [65535, 1, 0]], np.uint16)
    cv2.imwrite(str(tmp_path / "d.png"), stored)
    with pytest.raises(InputError, match=r"d\.png: the image is not 8 bit; expected uint8; got uint16"):
        read_rgb(tmp_path / "d.png")
    disparity = read_uint16(tmp_path / "d.png", "disparity")
    assert np.array_equal(np.isnan(disparity), stored == 0)
    assert np.array_equal(disparity[stored > 0], stored[stored > 0] / 256)


def test_eight_bits_are_refused_as_disparity(tmp_path: Path) -> None:
    write_image(tmp_path / "d.png", grey=True)
    with pytest.raises(InputError, match=r"d\.png: the disparity is not a 16 bit picture"):
        read_uint16(tmp_path / "d.png", "disparity")
