"""Sweeps in .las and .laz files: points, intensity, times, rings; what is damaged is refused and ends nothing."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets.cloud_file import read_cloud

from tests.p2o_datasets.opened import refused

laspy = pytest.importorskip("laspy")
COUNT = 400


def _las(point_format: int = 3, *, packed: bool = False, ring: bool = True, timed: bool = True) -> bytes:
    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
    header.scales = [1e-3] * 3
    if ring:
        header.add_extra_dim(laspy.ExtraBytesParams(name="ring", type=np.uint16))
    found = laspy.LasData(header)
    rng = np.random.default_rng(0)
    found.x, found.y, found.z = rng.uniform(-20, 20, (3, COUNT))
    found.intensity = np.arange(COUNT)
    if timed:
        found.gps_time = np.linspace(5.0, 5.1, COUNT)
    if ring:
        found.ring = np.arange(COUNT) % 16
    out = io.BytesIO()
    found.write(out, do_compress=packed, laz_backend=laspy.LazBackend.Lazrs if packed else None)
    return out.getvalue()


@pytest.mark.parametrize("point_format", [1, 3, 6])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_points_intensity_times_and_rings_are_read(tmp_path: Path, suffix: str, point_format: int) -> None:
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(_las(point_format, packed=suffix == ".laz"))
    cloud, warnings = read_cloud(path, image_time_s=5.0)
    expected = np.random.default_rng(0).uniform(-20, 20, (3, COUNT)).T
    np.testing.assert_allclose(cloud.xyz, expected, atol=6e-4)  # the file counts in millimetres
    np.testing.assert_array_equal(cloud.intensity, np.arange(COUNT))
    np.testing.assert_allclose(cloud.time_s, np.linspace(0, 0.1, COUNT), atol=1e-9)
    np.testing.assert_array_equal(cloud.ring, np.arange(COUNT) % 16)
    assert warnings == ()


def test_a_file_without_rings_and_times_has_none(tmp_path: Path) -> None:
    path = tmp_path / "cloud.las"
    path.write_bytes(_las(ring=False, timed=False))
    cloud, warnings = read_cloud(path)
    assert (cloud.ring, cloud.time_s, warnings) == (None, None, ())


def _changed(data: bytes, at: int, form: str, value: int) -> bytes:
    changed = bytearray(data)
    struct.pack_into(form, changed, at, value)
    return bytes(changed)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"ply\nformat ascii", "not a LAS file"),
        (_las()[:-100], "truncated"),
        (_changed(_las(), 107, "<I", 1 << 31), "too many points"),
        (_changed(_las(6), 247, "<Q", 1 << 60), "too many points"),
        (_changed(_las(), 96, "<I", 1 << 31), "contradicts its size"),
        (_changed(_las(), 100, "<I", 1 << 31), "contradicts its size"),
        (_changed(_las(), 105, "<H", 3), "contradicts its size"),
        (_las(packed=True)[:-40], "damaged|cannot be read"),
        (_changed(_las(packed=True), 107, "<I", 1 << 22), "damaged|cannot be read"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "cloud.las"
    path.write_bytes(data)
    with refused(message):
        read_cloud(path)


@pytest.mark.parametrize("damage", ["points", "number of chunks", "position of chunks"])
def test_a_file_on_which_the_unpacker_dies_is_refused(tmp_path: Path, damage: str) -> None:
    """Bytes that send lazrs out of its memory: it runs in a process of its own."""
    data = bytearray(_las(packed=True))
    [start] = struct.unpack_from("<I", data, 96)
    [table] = struct.unpack_from("<q", data, start)
    if damage == "points":
        data[start + 300 :] = b"\xff" * (len(data) - start - 300 - 64) + data[-64:]
    elif damage == "number of chunks":
        struct.pack_into("<I", data, table + 4, (1 << 32) - 1)
    else:
        struct.pack_into("<q", data, start, 1 << 40)
    path = tmp_path / "cloud.laz"
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"cannot be read as LAS|damaged"):
        read_cloud(path)


def test_without_laspy_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cloud.las"
    path.write_bytes(_las())
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(InputError, match=r'needs laspy, which is not installed.*pip install "p2o-calib\[las\]"'):
        read_cloud(path)
