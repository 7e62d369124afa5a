"""A small sequence of PandaSet's true format; its pickles are put together byte by byte as pandas 1.0 writes them."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .drive import car, mounted, picture, through, tilted, walls, wxyz

SEQUENCE = "001"
START_S = 1557539924.5
SIZE = (96, 54)
LENS = {"fx": 62.0, "fy": 63.0, "cx": 47.3, "cy": 27.1}
# The frame of the LiDAR's poses: x right, y ahead, z up.
CAR_FROM_LIDAR = mounted([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], 0.4, 0.0, 1.7)
OPTICAL = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
CAR_FROM = {
    "front_camera": mounted(OPTICAL @ tilted((0.5, 1, -0.3)), 1.0, 0.1, 1.5),
    "left_camera": mounted(tilted((0, 0, 90)) @ OPTICAL, 0.6, 0.4, 1.5),
}
LATER_S = {"front_camera": 0.045, "left_camera": 0.02}
POINTS = 600


# ---- pickles, step by step


def text(said: str) -> bytes:
    return b"X" + struct.pack("<I", len(said.encode())) + said.encode()


def whole(number: int) -> bytes:
    return b"\x8a\x08" + number.to_bytes(8, "little", signed=True)


def tuple_of(*parts: bytes) -> bytes:
    return b"(" + b"".join(parts) + b"t"


def list_of(*parts: bytes) -> bytes:
    return b"](" + b"".join(parts) + b"e"


def dict_of(pairs: Mapping[str, bytes]) -> bytes:
    return b"}(" + b"".join(text(key) + value for key, value in pairs.items()) + b"u"


def name(module: str, what: str) -> bytes:
    return f"c{module}\n{what}\n".encode()


def called(what: bytes, *args: bytes) -> bytes:
    return what + tuple_of(*args) + b"R"


def type_of(kind: str, order: str = "<") -> bytes:
    start = called(name("numpy", "dtype"), text(kind), b"\x89", b"\x88")
    flags = whole(63 if kind.startswith("O") else 0)
    return start + tuple_of(whole(3), text(order), b"N", b"N", b"N", whole(-1), whole(-1), flags) + b"b"


def array(shape: Sequence[Any], kind: bytes, raw: bytes, fortran: bool = False) -> bytes:
    start = called(
        name("numpy.core.multiarray", "_reconstruct"), name("numpy", "ndarray"), tuple_of(whole(0)), b"C\x01b"
    )
    sizes = tuple_of(*(whole(size) if isinstance(size, int) else text(size) for size in shape))
    return start + tuple_of(whole(1), sizes, kind, b"\x88" if fortran else b"\x89", raw) + b"b"


def index(labels: Sequence[str]) -> bytes:
    data = array((len(labels),), type_of("O8", "|"), list_of(*(text(label) for label in labels)))
    kind = name("pandas.core.indexes.base", "Index")
    return called(name("pandas.core.indexes.base", "_new_Index"), kind, dict_of({"data": data, "name": b"N"}))


def pickled(
    columns: Mapping[str, Any],
    *,
    order: str = "C",
    shape: Sequence[Any] | None = None,
    dtype: str | None = None,
    places: tuple[int, int, int] | None = None,
    labels: Sequence[str] | None = None,
) -> bytes:
    """Return a table as pandas 1.0 pickles it, a block a column; what is given besides is written wrong."""
    blocks = []
    count = len(next(iter(columns.values())))
    for number, values in enumerate(columns.values()):
        rows = values[None]
        raw = rows.tobytes(order="F" if order == "F" else "C")
        said = array(
            shape or (1, count),
            type_of(dtype or values.dtype.str[1:]),
            b"B" + struct.pack("<I", len(raw)) + raw,
            order == "F",
        )
        where = places or (number, number + 1, 1)
        locations = called(name("builtins", "slice"), *(whole(bound) for bound in where))
        blocks.append(dict_of({"values": said, "mgr_locs": locations}))
    rows_index = called(
        name("pandas.core.indexes.base", "_new_Index"),
        name("pandas.core.indexes.range", "RangeIndex"),
        dict_of({"name": b"N", "start": whole(0), "stop": whole(count), "step": whole(1)}),
    )
    axes = list_of(index(list(labels or columns)), rows_index)
    inner = dict_of({"axes": axes, "blocks": list_of(*blocks)})
    state = tuple_of(axes, list_of(), list_of(), dict_of({"0.14.1": inner}))
    manager = name("pandas.core.internals.managers", "BlockManager") + b")\x81" + state + b"b"
    frame = name("pandas.core.frame", "DataFrame") + b")\x81"
    said = dict_of({"_data": manager, "_typ": text("dataframe"), "_metadata": list_of(), "attrs": b"}"})
    return b"\x80\x04" + frame + said + b"b."


# ---- a sequence


def lidar(seconds: float) -> Any:
    return car(seconds) @ CAR_FROM_LIDAR


def pose(matrix: Any) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", matrix[:3, 3].tolist(), strict=True)),
        "heading": dict(zip("wxyz", wxyz(matrix), strict=True)),
    }


class Drive:
    """What the files hold; tests change it before `write`."""

    def __init__(self, root: Path, name: str = SEQUENCE) -> None:
        self.root, self.folder = root, root / name
        self.times = [0.1 * number for number in range(4)]
        self.files: dict[str, Any] = {
            "lidar/timestamps.json": [START_S + time for time in self.times],
            "lidar/poses.json": [pose(lidar(time)) for time in self.times],
        }
        for camera, mounting in CAR_FROM.items():
            seen = [time + LATER_S[camera] for time in self.times]
            self.files |= {
                f"camera/{camera}/timestamps.json": [START_S + time for time in seen],
                f"camera/{camera}/poses.json": [pose(car(time) @ mounting) for time in seen],
                f"camera/{camera}/intrinsics.json": dict(LENS),
            }

    def table(self, number: int) -> dict[str, Any]:
        """Return a sweep: points in the world, their times, and which LiDAR saw them."""
        points = walls(POINTS, seed=number)
        time = START_S + self.times[number] + np.linspace(-0.05, 0.05, POINTS)
        return {
            **dict(zip("xyz", points.T.copy(), strict=True)),
            "i": np.arange(POINTS, dtype=float) % 256,
            "t": time,
            "d": np.arange(POINTS) % 3 // 2,
        }

    def write(self) -> Path:
        for file, content in self.files.items():
            path = self.folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(content))
        for number in range(len(self.times)):
            (self.folder / f"lidar/{number:02d}.pkl.gz").write_bytes(gzip.compress(pickled(self.table(number)), 1))
            for camera in CAR_FROM:
                picture(self.folder / f"camera/{camera}/{number:02d}.jpg", *SIZE, 50 * number)
        return self.root


def measured(table: Mapping[str, Any]) -> Any:
    """Return the points of a sweep as the LiDAR measured them, each in its frame at its own time."""
    found = np.column_stack([table[axis] for axis in "xyz"])
    for row, time in enumerate(table["t"]):
        found[row] = through(np.linalg.inv(lidar(time - START_S)), found[row][None])[0]
    return found
