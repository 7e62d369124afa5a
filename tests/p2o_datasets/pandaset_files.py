"""A small sequence of PandaSet's true format; its pickles are like those of pandas 1.0, without pandas."""

from __future__ import annotations

import gzip
import io
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from .drive import OPTICAL, car, mounted, picture, through, tilted, walls, wxyz

SEQUENCE = "001"
START_S = 1557539924.5
SIZE = (96, 54)
LENS = {"fx": 62.0, "fy": 63.0, "cx": 47.3, "cy": 27.1}
# The frame of the LiDAR's poses: x right, y ahead, z up.
CAR_FROM_LIDAR = mounted([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], 0.4, 0.0, 1.7)
CAR_FROM = {
    "front_camera": mounted(OPTICAL @ tilted((0.5, 1, -0.3)), 1.0, 0.1, 1.5),
    "left_camera": mounted(tilted((0, 0, 90)) @ OPTICAL, 0.6, 0.4, 1.5),
}
LATER_S = {"front_camera": 0.045, "left_camera": 0.02}
POINTS = 600


# ---- pickles


class Name(str):
    """A name with its module, pickled as what it names."""


@dataclass
class Called:
    """What a call returns, and the state that it is given."""

    name: str
    args: tuple[Any, ...] = ()
    state: Any = None


class _Pickler(pickle._Pickler):
    """Pickles what is named without having it."""

    dispatch: ClassVar[dict[type, Any]] = {**pickle._Pickler.dispatch}

    def save_name(self, name: str) -> None:
        module, _, what = name.rpartition(".")
        self.write(f"c{module}\n{what}\n".encode())

    def save_called(self, one: Called) -> None:
        self.save_name(one.name)
        self.save(one.args)
        self.write(pickle.REDUCE)
        if one.state is not None:
            self.save(one.state)
            self.write(pickle.BUILD)

    dispatch |= {Name: save_name, Called: save_called}


def array(shape: Sequence[Any], kind: str, raw: Any, fortran: bool = False) -> Called:
    plain = not kind.startswith("O")
    dtype_state = (3, "<" if plain else "|", None, None, None, -1, -1, 0 if plain else 63)
    dtype = Called("numpy.dtype", (kind, False, True), dtype_state)
    start = (Name("numpy.ndarray"), (0,), b"b")
    return Called("numpy.core.multiarray._reconstruct", start, (1, tuple(shape), dtype, fortran, raw))


def pickled(
    columns: Mapping[str, Any],
    *,
    order: Literal["C", "F"] = "C",
    shape: Sequence[Any] | None = None,
    dtype: str | None = None,
    places: tuple[int, int, int] | None = None,
    labels: Sequence[str] | None = None,
) -> bytes:
    """Return a table as pandas 1.0 pickles it, a block a column; what is given besides is written wrong."""
    blocks = []
    count, names = len(next(iter(columns.values()))), list(labels or columns)
    for number, values in enumerate(columns.values()):
        raw = values[None].tobytes(order=order)
        rows = array(shape or (1, count), dtype or values.dtype.str[1:], raw, order == "F")
        where = Called("builtins.slice", places or (number, number + 1, 1))
        blocks.append({"values": rows, "mgr_locs": where})

    def index(kind: str, state: dict[str, Any]) -> Called:
        return Called("pandas.core.indexes.base._new_Index", (Name(f"pandas.core.indexes.{kind}"), state))

    axes = [
        index("base.Index", {"data": array((len(names),), "O8", names), "name": None}),
        index("range.RangeIndex", {"name": None, "start": 0, "stop": count, "step": 1}),
    ]
    state: Any = (axes, [], [], {"0.14.1": {"axes": axes, "blocks": blocks}})
    manager = Called("pandas.core.internals.managers.BlockManager", state=state)
    content = {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
    out = io.BytesIO()
    _Pickler(out, 4).dump(Called("pandas.core.frame.DataFrame", state=content))
    return out.getvalue()


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
