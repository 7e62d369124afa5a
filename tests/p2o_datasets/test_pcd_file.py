from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o_datasets.cloud_file import read_cloud
from p2o_datasets.pcd_file import read_pcd, unpack_lzf

from .opened import refused

RECORD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("_", "u1", 4), ("intensity", "<f4"), ("ring", "<u2")])


def table(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(5)
    out = np.zeros(count, RECORD)
    for name in "xyz":
        # Few different values, so that a compressor finds repeats.
        out[name] = rng.integers(-8, 8, count) + 0.5
    out["intensity"] = np.arange(count) / 8
    out["ring"] = np.arange(count) % 4
    return out


FIELDS = ("x y z _ intensity ring", "4 4 4 1 4 2", "F F F U F U", "1 1 1 4 1 1")


def header(encoding: str, count: int = 40, layout: tuple[str, str, str, str] = FIELDS) -> bytes:
    """Return a header with the words FIELDS, SIZE, TYPE and COUNT of a layout."""
    words = "FIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\n".format(*layout)
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n{words}"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {encoding}\n"
    ).encode()


def ascii_body(rows: np.ndarray) -> bytes:
    lines = [f"{r['x']} {r['y']} {r['z']} 0 0 0 0 {r['intensity']} {r['ring']}" for r in rows]
    return "\n".join(lines).encode() + b"\n"


def packed_lzf(plain: bytes) -> bytes:
    """Return LZF tokens of bytes: a greedy search for repeats, literals in between; as LibLZF's format says."""
    out, literal, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            part = literal[start : start + 32]
            out.append(len(part) - 1)
            out.extend(part)
        literal.clear()

    while at < len(plain):
        best, distance = 0, 0
        for back in range(1, min(at, 8191) + 1):
            length = 0
            while length < 264 and at + length < len(plain) and plain[at + length] == plain[at + length - back]:
                length += 1
            if length > best:
                best, distance = length, back
        if best < 3:
            literal.append(plain[at])
            at += 1
            continue
        flush()
        code = best - 2
        out.append((min(code, 7) << 5) | ((distance - 1) >> 8))
        if code >= 7:
            out.append(code - 7)
        out.append((distance - 1) & 255)
        at += best
    flush()
    return bytes(out)


def compressed_body(rows: np.ndarray) -> bytes:
    plain = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in RECORD.names)
    packed = packed_lzf(plain)
    assert len(packed) < len(plain)
    return struct.pack("<II", len(packed), len(plain)) + packed


BODIES = {"ascii": ascii_body, "binary": lambda rows: rows.tobytes(), "binary_compressed": compressed_body}


@pytest.mark.parametrize("encoding", BODIES)
def test_every_encoding_gives_the_same_points(tmp_path: Path, encoding: str) -> None:
    rows = table()
    (tmp_path / "a.pcd").write_bytes(header(encoding) + BODIES[encoding](rows))
    cloud, warnings = read_cloud(tmp_path / "a.pcd")
    assert np.array_equal(cloud.xyz, np.stack([rows[n] for n in "xyz"], axis=1))
    assert np.array_equal(cloud.intensity, rows["intensity"])
    assert np.array_equal(cloud.ring, rows["ring"])
    assert warnings == ()


@pytest.mark.parametrize("encoding", BODIES)
@pytest.mark.parametrize("part", [0.0, 0.4, 0.98])
def test_a_cut_body_is_refused_by_name(tmp_path: Path, encoding: str, part: float) -> None:
    body = BODIES[encoding](table())
    (tmp_path / "a.pcd").write_bytes(header(encoding) + body[: int(part * len(body))])
    with refused(r"a\.pcd: the (\.pcd file is truncated|point cloud is truncated|packed)"):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize("seed", range(5))
def test_lzf_undoes_the_packing_of_any_bytes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plain = rng.integers(0, 1 + 2**seed, 700, dtype=np.uint8).tobytes()
    assert unpack_lzf(packed_lzf(plain), len(plain), Path("a.pcd")) == plain


@pytest.mark.parametrize("packed", [bytes([32, 5]), b"\x01ab" + bytes([32, 9]), b"\x01ab" + bytes([7 << 5]), b"\x05ab"])
def test_damaged_lzf_is_refused_by_name(packed: bytes) -> None:
    with refused(r"a\.pcd: the compressed points of the \.pcd file are damaged"):
        unpack_lzf(packed, 11, Path("a.pcd"))


# PointXYZIRT of PCL: four floats of coordinates, then fields by their size, 32 bytes in all.
NAMES, TYPES = ["x", "y", "z", "intensity", "ring", "time"], ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"]
STRUCT = np.dtype({"names": NAMES, "formats": TYPES, "offsets": [0, 4, 8, 16, 20, 24], "itemsize": 32})


def struct_rows(record: np.dtype, count: int = 40) -> np.ndarray:
    """Return points whose padding holds bytes that are no zeros."""
    out = np.frombuffer(bytes([0x5A]) * (record.itemsize * count), record).copy()
    rng = np.random.default_rng(1)
    for name in "xyz":
        out[name] = rng.uniform(-20, 20, count)
    out["intensity"], out["ring"], out["time"] = np.arange(count) / 8, np.arange(count) % 16, np.arange(count) / 1000
    return out


ALIGNED = np.dtype([(name, STRUCT[name]) for name in STRUCT.names], align=True)


@pytest.mark.parametrize(
    "layout",
    [
        ("x y z intensity ring _ time", "4 4 4 4 2 1 4", "F F F F U U F", "1 1 1 1 1 0 1"),
        ("x y z _ intensity ring _ time _", "4 4 4 1 4 2 1 4 1", "F F F U F U U F U", "1 1 1 4 1 1 2 1 4"),
        ("x y z _ intensity ring _ time", "4 4 4 1 4 2 1 4", "F F F U F U U F", "1 1 1 0 1 1 0 1"),
        ("x y z _ intensity ring _ time _", "4 4 4 1 4 2 1 4 1", "F F F U F U U F U", "1 1 1 4 1 1 0 1 4"),
        ("x y z intensity ring time", "4 4 4 4 2 4", "F F F F U F", "1 1 1 1 1 1"),
    ],
    ids=["aligned by a compiler alone", "right", "count 0", "one wrong", "left out"],
)
def test_padded_structs_are_read_whatever_the_header_says_of_their_padding(tmp_path: Path, layout: Any) -> None:
    rows = struct_rows(ALIGNED if layout[0] == "x y z intensity ring _ time" else STRUCT)
    (tmp_path / "a.pcd").write_bytes(header("binary", layout=layout) + rows.tobytes())
    cloud, warnings = read_cloud(tmp_path / "a.pcd")
    assert np.array_equal(cloud.xyz, np.stack([rows[n] for n in "xyz"], axis=1))
    assert np.array_equal(cloud.intensity, rows["intensity"])
    assert np.array_equal(cloud.ring, rows["ring"])
    assert np.array_equal(cloud.time_s, rows["time"])
    assert warnings == ()


def test_a_line_end_after_the_points_does_no_harm() -> None:
    rows = table()
    fields = read_pcd(header("binary") + rows.tobytes() + b"\n", Path("a.pcd"))
    assert np.array_equal(fields["ring"], rows["ring"])


def test_packed_points_without_the_padding_of_their_header_are_read(tmp_path: Path) -> None:
    rows = table()
    plain = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in RECORD.names if name != "_")
    packed = packed_lzf(plain)
    data = header("binary_compressed") + struct.pack("<II", len(packed), len(plain)) + packed
    (tmp_path / "a.pcd").write_bytes(data)
    cloud, _ = read_cloud(tmp_path / "a.pcd")
    assert np.array_equal(cloud.ring, rows["ring"])
    assert np.array_equal(cloud.intensity, rows["intensity"])


def ascii_file(old: bytes = b"", new: bytes = b"", count: int = -1) -> bytes:
    return header("ascii") + ascii_body(table()).replace(old, new, count)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (header("ascii")[:60], r"this is not a \.pcd file"),
        (header("zipped"), "unknown DATA"),
        (ascii_file(b"0.5", b"abc", 1), "the points are not numbers"),
        (ascii_file(b"\n", b" 7\n"), ".*other columns; expected 9 numbers per line; got 10 numbers"),
        # More than the memory, before it is taken.
        (header("binary_compressed", 10**9) + struct.pack("<II", 4, 0) + b"abcd", "the compressed size"),
        (
            header("binary", layout=("x y z _ intensity", "4 4 4 1 4", "F F F U F", "1 1 1 0 1")) + bytes(40 * 57),
            r"the fields of the \.pcd file do not fill its points; .*16 bytes",
        ),
    ],
)
def test_a_damaged_file_is_refused_by_name(data: bytes, message: str) -> None:
    with refused(rf"a\.pcd: {message}"):
        read_pcd(data, Path("a.pcd"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"POINTS 40", b"POINTS many"),
        (b"POINTS 40", b"POINTS " + b"9" * 5000),
        (b"POINTS 40", b"POINTS 1e23"),
        (b"SIZE 4 4 4 1 4 2", b"SIZE 4 4 4"),
        (b"SIZE 4 4 4", b"SIZE 4,f4 4 4"),
        (b"SIZE 4 4 4", b"SIZE 16 4 4"),
        (b"COUNT 1 1 1 4 1 1", b"COUNT 0 0 0 0 0 0"),
        (b"COUNT 1", b"COUNT 99999999999"),
        (b"COUNT 1", b"COUNT " + b"9" * 3000),
    ],
)
@pytest.mark.parametrize("encoding", BODIES)
def test_a_wrong_header_is_refused_by_name(encoding: str, old: bytes, new: bytes) -> None:
    data = (header(encoding) + BODIES[encoding](table())).replace(old, new, 1)
    with refused(r"a\.pcd: (the header of the \.pcd file is wrong|this is not a \.pcd file)"):
        read_pcd(data, Path("a.pcd"))
