from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_plugins.data.cloud_file import read_cloud
from p2o_plugins.data.pcd_file import read_pcd, unpack_lzf

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


def header(encoding: str, count: int = 40) -> bytes:
    return (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z _ intensity ring\n"
        "SIZE 4 4 4 1 4 2\nTYPE F F F U F U\nCOUNT 1 1 1 4 1 1\n"
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
    with pytest.raises(InputError, match=r"a\.pcd: the (\.pcd file is truncated|point cloud is truncated|packed)"):
        read_cloud(tmp_path / "a.pcd")


def test_a_cut_or_wrong_header_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"a\.pcd: this is not a \.pcd file"):
        read_pcd(header("ascii")[:60], Path("a.pcd"))
    with pytest.raises(InputError, match=r"a\.pcd: the header of the \.pcd file is wrong"):
        read_pcd(header("ascii").replace(b"SIZE 4 4 4 1 4 2", b"SIZE 4 4 4"), Path("a.pcd"))
    with pytest.raises(InputError, match=r"a\.pcd: the header of the \.pcd file is wrong"):
        read_pcd(header("ascii").replace(b"POINTS 40", b"POINTS many"), Path("a.pcd"))
    with pytest.raises(InputError, match=r"a\.pcd: the header of the \.pcd file is wrong"):
        read_pcd(header("binary").replace(b"COUNT 1", b"COUNT 99999999999"), Path("a.pcd"))
    with pytest.raises(InputError, match=r"a\.pcd: unknown DATA"):
        read_pcd(header("zipped"), Path("a.pcd"))


def test_words_among_the_numbers_are_refused() -> None:
    with pytest.raises(InputError, match=r"a\.pcd: the points are not numbers"):
        read_pcd(header("ascii") + ascii_body(table()).replace(b"0.5", b"abc", 1), Path("a.pcd"))


def test_a_header_that_promises_too_much_is_refused_before_memory_is_taken() -> None:
    data = header("binary_compressed", count=10**9) + struct.pack("<II", 4, 0) + b"abcd"
    with pytest.raises(InputError, match=r"a\.pcd: the packed size"):
        read_pcd(data, Path("a.pcd"))


def test_missing_returns_written_as_nan_are_dropped(tmp_path: Path) -> None:
    body = ascii_body(table()).split(b"\n")
    body[2] = b"nan nan nan 0 0 0 0 0 1"
    (tmp_path / "a.pcd").write_bytes(header("ascii") + b"\n".join(body))
    cloud, warnings = read_cloud(tmp_path / "a.pcd")
    assert len(cloud) == 39
    assert warnings == ("a.pcd: 1 of 40 points dropped: NaN or infinite",)


def test_lzf_runs_may_overlap_what_they_write() -> None:
    # One literal "ab", then 9 bytes from 2 back: abababababa.
    assert unpack_lzf(b"\x01ab" + bytes([7 << 5, 0, 1]), 11, Path("a.pcd")) == b"abababababa"


@pytest.mark.parametrize("seed", range(5))
def test_lzf_undoes_the_packing_of_any_bytes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plain = rng.integers(0, 1 + 2**seed, 700, dtype=np.uint8).tobytes()
    assert unpack_lzf(packed_lzf(plain), len(plain), Path("a.pcd")) == plain


@pytest.mark.parametrize("packed", [bytes([32, 5]), b"\x01ab" + bytes([32, 9]), b"\x01ab" + bytes([7 << 5]), b"\x05ab"])
def test_damaged_lzf_is_refused_by_name(packed: bytes) -> None:
    with pytest.raises(InputError, match=r"a\.pcd: the packed points of the \.pcd file are damaged"):
        unpack_lzf(packed, 11, Path("a.pcd"))
