from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o_datasets.cloud_file import read_cloud
from p2o_datasets.ply_file import read_ply

from .opened import refused

TYPES = {"x": "double", "y": "double", "z": "double", "reflectance": "float", "channel": "uchar"}


def header(encoding: str, count: int = 20) -> bytes:
    properties = "".join(f"property {kind} {name}\n" for name, kind in TYPES.items())
    return (
        f"ply\nformat {encoding} 1.0\ncomment made up\nelement vertex {count}\n{properties}"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()


def table(order: str, count: int = 20) -> np.ndarray:
    rng = np.random.default_rng(2)
    out = np.zeros(count, [(n, order + {"double": "f8", "float": "f4", "uchar": "u1"}[t]) for n, t in TYPES.items()])
    for name in "xyz":
        out[name] = rng.uniform(-9, 9, count)
    out["reflectance"] = np.arange(count) / 4
    out["channel"] = np.arange(count)
    return out


def body(encoding: str) -> bytes:
    rows = table(">" if "big" in encoding else "<")
    if encoding != "ascii":
        return rows.tobytes() + b"\x03" + b"\0" * 12
    lines = [
        " ".join(str(float(v)) if n != "channel" else str(int(v)) for n, v in zip(TYPES, r, strict=True)) for r in rows
    ]
    return ("\n".join(lines) + "\n3 0 1 2\n").encode()


ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_gives_the_same_points_and_faces_are_left_out(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.ply").write_bytes(header(encoding) + body(encoding))
    cloud, _ = read_cloud(tmp_path / "a.ply")
    rows = table("<")
    assert np.array_equal(cloud.xyz, np.stack([rows[n] for n in "xyz"], axis=1))
    assert np.array_equal(cloud.intensity, rows["reflectance"])
    assert np.array_equal(cloud.ring, rows["channel"])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_cut_body_is_refused_by_name(encoding: str) -> None:
    data = body(encoding)
    with refused(r"a\.ply: the (\.ply file|point cloud) is truncated"):
        read_ply(header(encoding) + data[: len(data) // 2], Path("a.ply"))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count", ["1e23", "9" * 22, "9" * 5000, "-3", "4294967296", "99999999"])
def test_more_vertices_than_the_file_has_are_refused_before_memory_is_taken(encoding: str, count: str) -> None:
    data = header(encoding).replace(b"vertex 20", b"vertex " + count.encode()) + body(encoding)
    with refused(r"a\.ply: the (header of the )?\.ply file is (wrong|truncated)"):
        read_ply(data, Path("a.ply"))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        *(
            (header("ascii").replace(old, new) + body("ascii"), r"the header of the \.ply file is wrong")
            for old, new in (
                *((b"vertex 20", b"vertex many"), (b"element vertex", b"element camera")),
                *((b"ascii", b"utf8"), (b"double", b"real")),
            )
        ),
        (header("ascii") + b"a b c d e\n" * 20, "the points are not numbers"),
        (
            header("ascii") + body("ascii").replace(b"\n", b" 7\n"),
            ".*other columns; expected 5 numbers per line; got 6 numbers",
        ),
    ],
)
def test_a_damaged_file_is_refused_by_name(data: bytes, message: str) -> None:
    with refused(rf"a\.ply: {message}"):
        read_ply(data, Path("a.ply"))
