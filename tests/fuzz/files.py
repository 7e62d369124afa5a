"""Files of every format that p2o reads, made of one small sweep and one small picture: right ones and odd ones."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from functools import cache
from random import Random
from typing import Any

import numpy as np

from tests.fuzz.mutate import bytes_of

CLOUDS = (".bin", ".pcd.bin", ".pcd", ".ply", ".npz", ".txt")
IMAGES = (".png", ".jpg", ".bmp", ".tif", ".webp")
_ODD = (np.nan, np.inf, -np.inf, 0.0, 1e30, -1e30, 1e38, 1e-40, 1e5, 255.0, -1.0)
_NAMES = ("x", "y", "z", "intensity", "ring", "time", "_", "rgb", "t", "timestamp", "label", "X", "", "normal_x")


@cache
def points() -> np.ndarray:
    """Return x y z intensity ring time (N, 6) float64: two hundred points of sixteen rings around the sensor."""
    ring, column = np.divmod(np.arange(208), 13)
    azimuth, elevation = np.radians(column * 6.0 - 36), np.radians(ring * 2.0 - 15)
    away = 8 + 3 * np.sin(7 * azimuth) + ring % 3
    xyz = away * np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return np.column_stack([*xyz, (column * 7) % 100, ring, column * 1e-3])


def cloud(rng: Random, suffix: str) -> bytes:
    """Return a sweep as a file of this format; half of them with values, fields or headers that are odd."""
    odd = rng.random() < 0.5
    table = points().copy()
    if odd and rng.random() < 0.6:
        rows = rng.choice((0, 1, 2, len(table)))
        table = table[:rows] if rng.random() < 0.3 else table
        for _ in range(rng.choice((1, 5, 300))):
            if len(table):
                table[rng.randrange(len(table)), rng.randrange(table.shape[1])] = rng.choice(_ODD)
        if rng.random() < 0.2:
            table[:, rng.randrange(table.shape[1])] = rng.choice(_ODD)
    with np.errstate(all="ignore"):
        return _CLOUD[suffix](rng, table, odd)


def _bin(rng: Random, table: np.ndarray, odd: bool) -> bytes:
    columns = rng.choice((3, 4, 5, 6)) if odd else 4
    return (
        table[:, :columns].astype(rng.choice(("<f4", ">f4", "<f8")) if odd and rng.random() < 0.2 else "<f4").tobytes()
    )


def _text(rng: Random, table: np.ndarray, odd: bool) -> bytes:
    out = io.BytesIO()
    np.savetxt(
        out, table[:, : rng.choice((3, 4, 5)) if odd else 4], rng.choice(("%.6g", "%s", "%.60e")) if odd else "%.6g"
    )
    return out.getvalue()


def _npz(rng: Random, table: np.ndarray, odd: bool) -> bytes:
    arrays: dict[str, Any] = {"xyz": table[:, :3], "ring": table[:, 4].astype(np.int16), "time_s": table[:, 5]}
    out = io.BytesIO()
    if not odd:
        np.savez(out, **arrays)
        return out.getvalue()
    name = rng.choice(("xyz", "ring", "time_s", "intensity"))
    arrays[name] = rng.choice(
        (
            table[:, :3].astype("f2"),
            table.astype(complex),
            np.array([object()] * len(table), dtype=object),
            np.array("text"),
            np.zeros((len(table), 3), "i8,f4"),
            np.zeros(0),
            np.zeros((3, len(table))),
            np.full(len(table), 2**63, np.uint64),
            np.array(["x"] * len(table)),
            np.zeros(len(table), "M8[ns]"),
        )
    )
    with zipfile.ZipFile(out, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as packed:
        for key, value in arrays.items():
            packed.writestr(f"{key}.npy", npy(rng, value, odd=rng.random() < 0.3))
        if rng.random() < 0.2:
            packed.writestr(rng.choice(("../x.npy", "a", "y.npy")), b"\0" * 5_000_000)
    return out.getvalue()


def npy(rng: Random, array: np.ndarray, *, odd: bool) -> bytes:
    """Return an array as an .npy file; an odd one has a header that lies."""
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    data = out.getvalue()
    if not odd:
        return data
    shape = rng.choice(("(10000000000000,)", "(1000000, 1000000)", "(-1,)", "()", "(3,)", "None", "(" * 50, "9" * 5000))
    kind = rng.choice(("'<f8'", "'|O'", "'<i4'", "'|V100000'", "[('a','<f8')]", "'<M8[ns]'", "'|S0'"))
    head = f"{{'descr': {kind}, 'fortran_order': {rng.choice(('True', 'False', '1'))}, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", min(len(head) + 1, 65535)) + head + b"\n" + data[128:]


def _pcd(rng: Random, table: np.ndarray, odd: bool) -> bytes:
    names = ["x", "y", "z", "intensity", "ring", "time"]
    kinds = [("F", 4)] * 4 + [("U", 2), ("F", 4)]
    counts = [1] * 6
    if odd:
        for _ in range(rng.choice((0, 1, 2))):
            at = rng.randrange(len(names) + 1)
            names.insert(at, rng.choice(_NAMES))
            kinds.insert(at, rng.choice((("U", 1), ("F", 4), ("F", 8), ("I", 8), ("U", 4))))
            counts.insert(at, rng.choice((0, 1, 2, 4, 65537, -1)))
    types = [np.dtype(f"<{ {'F': 'f', 'U': 'u', 'I': 'i'}[kind] }{size}") for kind, size in kinds]
    width = len(table)
    record = np.dtype([(f"f{i}", t, (min(max(c, 0), 8),)) for i, (t, c) in enumerate(zip(types, counts, strict=True))])
    body = np.zeros(width, record)
    columns = dict(zip(("x", "y", "z", "intensity", "ring", "time"), table.T, strict=True))
    for i, name in enumerate(names):
        if name in columns and body[f"f{i}"].shape[1:] and body[f"f{i}"].shape[1]:
            body[f"f{i}"][:, 0] = np.nan_to_num(columns[name]) if kinds[i][0] != "F" else columns[name]
    encoding = rng.choice(("ascii", "binary", "binary_compressed"))
    said = rng.choice((width, width, width, 0, width * 10**9, -1, 10**23)) if odd else width
    if odd and rng.random() < 0.3:
        counts = [rng.choice((0, 1)) if n == "_" else c for n, c in zip(names, counts, strict=True)]
    head = [
        "# .PCD v0.7",
        "VERSION 0.7",
        "FIELDS " + " ".join(names),
        "SIZE " + " ".join(str(size) for _, size in kinds),
        "TYPE " + " ".join(kind for kind, _ in kinds),
        "COUNT " + " ".join(map(str, counts)),
        f"WIDTH {said}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {said}",
        f"DATA {encoding}",
    ]
    if encoding == "ascii":
        rows = "\n".join(" ".join(str(float(v)) for f in row for v in np.atleast_1d(f)) for row in body)
        data = rows.encode()
    else:
        data = body.tobytes()
        if encoding == "binary_compressed":
            turned = b"".join(np.ascontiguousarray(body[n]).tobytes() for n in record.names or ())
            packed = b"".join(bytes([len(p) - 1]) + p for p in (turned[i : i + 32] for i in range(0, len(turned), 32)))
            sizes = (len(packed), len(turned)) if not odd or rng.random() < 0.7 else (len(packed), 2**32 - 1)
            data = struct.pack("<II", *sizes) + packed
    return ("\n".join(head) + "\n").encode() + data


def _ply(rng: Random, table: np.ndarray, odd: bool) -> bytes:
    names = ["x", "y", "z", "intensity", "ring", "time"]
    kinds = ["float"] * 4 + ["ushort", "double"]
    if odd and rng.random() < 0.5:
        at = rng.randrange(len(names) + 1)
        names.insert(at, rng.choice(_NAMES) or "q")
        kinds.insert(at, rng.choice(("uchar", "double", "int64", "list uchar int", "float32")))
    encoding = rng.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    said = rng.choice((len(table), 0, -1, 10**12, 10**23, "9" * 5000)) if odd else len(table)
    order = ">" if "big" in encoding else "<"
    codes = {"float": "f4", "float32": "f4", "double": "f8", "ushort": "u2", "uchar": "u1"}
    record = np.dtype([(f"f{i}", order + codes.get(kind, "i4")) for i, kind in enumerate(kinds)])
    body = np.zeros(len(table), record)
    columns = dict(zip(("x", "y", "z", "intensity", "ring", "time"), table.T, strict=True))
    for i, name in enumerate(names):
        if name in columns:
            values = columns[name]
            body[f"f{i}"] = values if record[i].kind == "f" else np.nan_to_num(values)
    head = ["ply", f"format {encoding} 1.0", "comment small", f"element vertex {said}"]
    head += [f"property {kind} {name}" for kind, name in zip(kinds, names, strict=True)]
    if odd and rng.random() < 0.3:
        head += ["element face 1", "property list uchar int vertex_indices"]
    head.append("end_header")
    data = "\n".join(" ".join(map(str, row)) for row in body).encode() if encoding == "ascii" else body.tobytes()
    return "\n".join(head).encode() + b"\n" + data


_CLOUD = {".bin": _bin, ".pcd.bin": _bin, ".pcd": _pcd, ".ply": _ply, ".npz": _npz, ".txt": _text}


@cache
def _picture() -> np.ndarray:
    y, x = np.mgrid[:96, :160]
    return np.stack([x + y, 2 * y, (x * y) % 251], axis=2).astype(np.uint8)


def image(rng: Random, suffix: str) -> bytes:
    """Return a picture as a file of this format; half of them of another size, depth or number of channels."""
    import cv2

    pixels = _picture()
    if rng.random() < 0.4:
        pixels = rng.choice(
            (
                pixels[:, :, 0],
                pixels[:-1],
                pixels[:1, :1],
                np.dstack([pixels, pixels[:, :, :1]]),
                pixels.astype(np.uint16) * 257,
                np.zeros_like(pixels),
            )
        )
        if pixels.dtype != np.uint8 and suffix in (".jpg", ".webp", ".bmp"):
            pixels = pixels.astype(np.uint8)
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1] if suffix == ".jpg" and rng.random() < 0.3 else []
    done, data = cv2.imencode(suffix, pixels, flags)
    found = data.tobytes() if done else b""
    return _damaged(rng, found, suffix) if rng.random() < 0.5 else found


def _damaged(rng: Random, data: bytes, suffix: str) -> bytes:
    """Return a picture whose header lies about the size, or whose pixels stop."""
    if suffix == ".png" and rng.random() < 0.7:
        size = struct.pack(">II", *(rng.choice((0, 1, 160, 96, 2**15, 2**17, 2**31 - 1)) for _ in range(2)))
        head = size + bytes([rng.choice((1, 2, 4, 8, 16)), rng.choice((0, 2, 3, 4, 6)), 0, 0, rng.choice((0, 1))])
        chunk = b"IHDR" + head
        return data[:12] + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    if suffix == ".jpg" and rng.random() < 0.7:
        scan = max(data.rfind(b"\xff\xda"), 0) + 12
        cut = rng.randint(min(scan, len(data)), len(data))
        how = rng.randrange(4)
        if how == 0:
            return data[:cut] + b"\xff\xd9"
        if how == 1:
            return data[:cut] + b"\0" * max(len(data) - cut - 2, 0) + b"\xff\xd9"
        start = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"))
        if how == 2 and start > 0:
            return (
                data[: start + 5]
                + struct.pack(">HH", *(rng.choice((0, 1, 96, 65500)) for _ in range(2)))
                + data[start + 9 :]
            )
        return data[:scan] + rng.randbytes(max(len(data) - scan - 2, 0)) + b"\xff\xd9"
    return bytes_of(rng, data)
