"""Inputs that are mutated by their structure: tables of bags, records, columns, documents, plugins, benchmark rows."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import struct
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tests.fuzz.bases import RUN, Bases
from tests.fuzz.mutate import NUMBERS, VALUES, WORDS, bytes_of
from tests.fuzz.surfaces import OUT, Case, bag_case, calibrations, frame_of, read_or_run, said_in

_SCHEMA = (
    "drop table {t}",
    "alter table {t} rename to other",
    "alter table {t} rename column {c} to other",
    "alter table {t} drop column {c}",
    "create table more as select * from {t}; drop table {t}; create view {t} as select * from more",
    "create trigger spoil after insert on {t} begin delete from {t}; end; insert into {t} select * from {t}",
    "delete from {t}",
    "insert into {t} select * from {t}",
    "create view endless as with recursive n(i) as (select 1 union all select i + 1 from n) select i from n",
    "drop table {t}; create view {t} as with recursive n(i) as (select 1 union all select i+1 from n) select 1 from n",
    "create index more on {t} ({c})",
    "pragma user_version = 99",
)


def bag_tables(rng: Random, bases: Bases, home: Path) -> Case:
    """A bag of SQLite with another schema, cells of other types, or messages (CDR) with wrong bytes."""
    base = next(path for path in bases.bags if path.suffix == ".db3")
    path = home / "in/drive.db3"
    shutil.copy(base, path)
    with contextlib.closing(sqlite3.connect(path)) as connection:
        for _ in range(rng.choice((1, 1, 2, 4))):
            tables = [name for (name,) in connection.execute("select name from sqlite_master where type = 'table'")]
            table = rng.choice(tables or ["messages"])
            columns = [row[1] for row in connection.execute(f"pragma table_info({table})")] or ["id"]
            with contextlib.suppress(sqlite3.Error, OverflowError, UnicodeEncodeError):
                if rng.random() < 0.3:
                    connection.executescript(rng.choice(_SCHEMA).format(t=table, c=rng.choice(columns)))
                else:
                    _spoil_cell(rng, connection, table, rng.choice(columns))
        connection.commit()
    return bag_case(rng, "in/drive.db3")


def _spoil_cell(rng: Random, connection: sqlite3.Connection, table: str, column: str) -> None:
    rows = connection.execute(f"select rowid, {column} from {table}").fetchall()
    number, value = rng.choice(rows or [(1, None)])
    if isinstance(value, bytes) and rng.random() < 0.8:
        new: Any = bytes_of(rng, value)
    else:
        new = rng.choice((rng.choice(NUMBERS), rng.choice(WORDS), None, b"\xff" * 9, "x" * 100_000, 2**63 - 1, -1))
        new = new if isinstance(new, bytes | str | float | None) else int(new)
    where = "" if rng.random() < 0.2 else f" where rowid = {number}"
    connection.execute(f"update {table} set {column} = ?{where}", (new,))


def mcap_records(rng: Random, bases: Bases, home: Path) -> Case:
    """A file of MCAP whose records are changed, doubled, removed or in another order, with lengths that fit."""
    data = next(path for path in bases.bags if path.suffix == ".mcap").read_bytes()
    magic, records, at = data[:8], [], 8
    while at + 9 <= len(data) - 8:
        (length,) = struct.unpack_from("<Q", data, at + 1)
        records.append((data[at], data[at + 9 : at + 9 + length]))
        at += 9 + length
    for _ in range(rng.choice((1, 1, 2, 4))):
        place = rng.randrange(len(records))
        operation, content = records[place]
        how = rng.randrange(7)
        if how < 3:
            records[place] = operation, bytes_of(rng, content)
        elif how == 3:
            records[place] = rng.randrange(256), content
        elif how == 4:
            records.insert(rng.randrange(len(records)), records[place])
        elif how == 5 and len(records) > 1:
            records.pop(place)
        else:
            records.insert(rng.randrange(len(records)), records.pop(place))
    spoilt = magic
    for operation, content in records:
        length = len(content) if rng.random() < 0.97 else rng.choice((0, 2**31, 2**63, 2**64 - 1, len(content) + 1))
        spoilt += struct.pack("<BQ", operation, length) + content
    (home / "in/drive.mcap").write_bytes(spoilt + magic)
    return bag_case(rng, "in/drive.mcap")


def columns(rng: Random, bases: Bases, home: Path) -> Case:
    """A table of Argoverse 2 (Feather) or Waymo (Parquet) with other columns, types or lengths."""
    import pyarrow as pa
    from pyarrow import feather, parquet

    name = rng.choice(("argoverse2", "waymo"))
    root = home / "in/data"
    shutil.copytree(bases.layouts[name], root, copy_function=os.link)
    path = rng.choice(sorted(path for path in root.rglob("*") if path.suffix in (".feather", ".parquet")))
    table = feather.read_table(path) if path.suffix == ".feather" else parquet.read_table(path)
    for _ in range(rng.choice((1, 1, 2))):
        place = rng.randrange(table.num_columns)
        field, how = table.schema.field(place), rng.randrange(7)
        if how == 0 and table.num_columns > 1:
            table = table.remove_column(place)
        elif how == 1:
            names = [rng.choice(WORDS) if i == place else n for i, n in enumerate(table.column_names)]
            with contextlib.suppress(UnicodeEncodeError):
                table = table.rename_columns(names)
        elif how == 2:
            table = table.slice(0, rng.choice((0, 1, table.num_rows // 2)))
        elif how == 3:
            table = pa.concat_tables([table] * rng.choice((2, 3)))
        elif how == 4:
            values = [rng.choice(VALUES) for _ in range(table.num_rows)]
            with contextlib.suppress(pa.ArrowException, OverflowError, UnicodeEncodeError):
                table = table.set_column(place, field.name, pa.array([None if v is None else str(v) for v in values]))
        elif how == 5:
            table = table.set_column(place, field.name, pa.nulls(table.num_rows, field.type))
        else:
            odd = np.full(table.num_rows, rng.choice((np.nan, np.inf, 1e300, -1.0, 0.0)))
            table = table.set_column(place, field.name, pa.array(odd))
    path.unlink()
    with contextlib.suppress(pa.ArrowException, UnicodeEncodeError):
        write = feather.write_feather if path.suffix == ".feather" else parquet.write_table
        write(
            table,
            path,
            compression=rng.choice(("zstd", "lz4", "uncompressed" if path.suffix == ".feather" else "snappy")),
        )
    return read_or_run(rng, f"{name}:in/data")


def document(rng: Random, bases: Bases, home: Path) -> Case:
    """A URDF or another file of XML with other elements and attributes, or entities."""
    documents = [text for text in calibrations().values() if text.lstrip().startswith(b"<")] + [_URDF]
    root = ElementTree.fromstring(rng.choice(documents))
    for _ in range(rng.choice((1, 1, 2, 3))):
        element = rng.choice(list(root.iter()))
        how = rng.randrange(6)
        if how == 0 and element.attrib:
            element.set(rng.choice(sorted(element.attrib)), rng.choice((str(rng.choice(NUMBERS)), rng.choice(WORDS))))
        elif how == 1 and element.attrib:
            del element.attrib[rng.choice(sorted(element.attrib))]
        elif how == 2 and len(element):
            element.remove(rng.choice(list(element)))
        elif how == 3 and len(element):
            element.extend([rng.choice(list(element))] * rng.choice((1, 3)))
        elif how == 4:
            element.tag = rng.choice(("link", "joint", "robot", "x", "data"))
        else:
            element.text = rng.choice((str(rng.choice(NUMBERS)), rng.choice(WORDS)))
    data = ElementTree.tostring(root, encoding="unicode").encode("utf-8", "surrogatepass")
    how = rng.random()
    if how < 0.1:
        data = _ENTITIES + data
    elif how < 0.2:
        data = b"<a>" * 100_000 + data
    elif how < 0.4:
        data = bytes_of(rng, data)
    (home / "in/calibration.xml").write_bytes(data)
    (home / "in/calibration.xml").rename(home / (name := rng.choice(("in/robot.urdf", "in/calibration.xml"))))
    word = rng.choice(("", "", "#camera", "?camera_frame=camera", "?camera_frame=camera&lidar_frame=lidar"))
    return Case(
        ("convert", f"{name}{word}", f"{OUT}/calibration", "--to", rng.choice(("json", "ros2", "kalibr", "opencv")))
    )


_URDF = b"""<robot name="car"><link name="base"/><link name="lidar"/><link name="camera"/>
<joint name="a" type="fixed"><parent link="base"/><child link="lidar"/><origin xyz="0 0 1.7" rpy="0 0 0"/></joint>
<joint name="b" type="fixed"><parent link="base"/><child link="camera"/><origin xyz="1 0 1.5" rpy="-1.57 0 0"/></joint>
</robot>"""
_ENTITIES = b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c SYSTEM "/etc/passwd">]>'


def las(rng: Random, bases: Bases, home: Path) -> Case:
    """A sweep in LAS or LAZ with a wrong header or wrong bytes."""
    import io

    import laspy

    header = laspy.LasHeader(point_format=rng.choice((1, 3, 6)), version="1.4")
    header.scales = [1e-3] * 3
    header.add_extra_dim(laspy.ExtraBytesParams(name="ring", type=np.uint16))
    file = laspy.LasData(header)
    with np.load(bases.folder / "scene-0000/cloud.npz") as cloud:
        file.x, file.y, file.z = cloud["xyz"].T
        file.ring, file.gps_time = cloud["ring"], cloud["time_s"]
    out, packed = io.BytesIO(), rng.random() < 0.2
    file.write(out, do_compress=packed, laz_backend=laspy.LazBackend.Lazrs if packed else None)
    data = bytearray(out.getvalue())
    # One in seven is correct, and a third has changed bytes only, most of them of points.
    how = rng.random()
    if how < 0.5:
        # Fields of the public header block: sizes, offsets, counts, format, scales.
        place, form = rng.choice(
            ((94, "H"), (96, "I"), (100, "I"), (104, "B"), (105, "H"), (107, "I"), (131, "d"), (247, "Q"))
        )
        size = 8 * struct.calcsize(form)
        value: Any = (
            rng.choice((float("nan"), 1e300, 0.0)) if form == "d" else rng.choice((0, 1, 2**size - 1, 2 ** (size - 1)))
        )
        struct.pack_into(f"<{form}", data, place, value)
    frame = frame_of(bases, home, without=("cloud.npz",))
    name = f"cloud{'.laz' if packed else '.las'}"
    (frame / name).write_bytes(bytes_of(rng, bytes(data)) if 0.3 < how < 0.85 else bytes(data))
    said_in(frame, cloud=name)
    return read_or_run(rng, "folder:in")


_ACTS = {
    "raise": "raise ValueError('no\\nsuch \\x1b[31mluck')",
    "exit": "raise SystemExit(0)",
    "base": "raise type('Own', (BaseException,), {})()",
    "deep": "act.__globals__['act'](where)",
    "memory": "raise MemoryError",
    "system": "open('/no/such/file')",
    "leave": "os._exit(0)",
    "crash": "os.kill(os.getpid(), 11)",
    "seed": "random.seed(0); np.random.seed(0)",
    "environment": "os.environ.clear()",
    "folder": "os.chdir('/')",
    "threads": "sys.setrecursionlimit(60)",
    "wait": "open('HANGS', 'w').close(); time.sleep(1000)",
    "spin": "open('HANGS', 'w').close()\n        while True: pass",
    "deaf": """open('HANGS', 'w').close()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        while True: time.sleep(1)""",
}
_ISOLATED = ("leave", "crash", "deaf")
"""What only a process of its own survives."""
_HANGS = f"{OUT}/hangs"
"""The file that a plugin writes when it begins to hang."""
_OUTPUTS = ("None", "3", "'x'", "[]", "np.full((4, 4), np.nan)", "lambda *a: None", "iter(())", "type", "object()")
_KINDS = ("image_extractors", "cloud_extractors", "matchers", "solvers", "initializers", "calibrators", "datasets")
_PLUGIN = """import os, random, signal, sys, time
import numpy as np
import p2o
def act(where):
    if where == "WHERE":
        ACT
class Stage:
    names = ("a", "b")
    prepares = True
    def __len__(self):
        act("len")
        return 2
    def __getitem__(self, index):
        act("call")
        return OUTPUT
    def __call__(self, *arguments):
        act("call")
        return OUTPUT
    def prepare(self, frame):
        act("prepare")
        return PREPARED
    def solve(self, prepared, pose):
        act("call")
        return OUTPUT
def build(options):
    act("build")
    return Stage()
act("import")
@p2o.hookimpl
def p2o_KIND():
    act("hook")
    yield p2o.Method(name="odd", build=build, summary="Misbehaves.", gives={"image-edges", "cloud-edges", "side"})
"""
_USES = {
    "image_extractors": ("--extractor", "odd/rings"),
    "cloud_extractors": ("--extractor", "depth/odd"),
    "matchers": ("--matcher", "odd"),
    "solvers": ("--solver", "odd"),
    "initializers": ("--init", "odd"),
    "calibrators": ("--calibrator", "odd", "--witness", "none"),
    "datasets": (),
}


def plugin(rng: Random, bases: Bases, home: Path) -> Case:
    """A plugin that raises, exits, crashes, hangs until Ctrl-C, returns something else or changes the process."""
    kind, how = rng.choice(_KINDS), rng.choice(sorted(_ACTS))
    where = rng.choice(("call", "call", "prepare", "build", "hook", "import", "len"))
    if how in _ISOLATED:
        # Only a calibration is isolated; only what calibrates is.
        kind, where = rng.choice(_KINDS[:-1]), rng.choice(("call", "prepare"))
    prepared = rng.choice(("1", "frame", *_OUTPUTS))
    text = _PLUGIN.replace("WHERE", where).replace("ACT", _ACTS[how]).replace("KIND", kind).replace("HANGS", _HANGS)
    (home / "in/odd.py").write_text(text.replace("OUTPUT", rng.choice(_OUTPUTS)).replace("PREPARED", prepared))
    shutil.copytree(bases.folder / "scene-0000", home / "in/data/scene")
    words = list(RUN)
    for flag, value in zip(_USES[kind][::2], _USES[kind][1::2], strict=True):
        if flag in words:
            words[words.index(flag) + 1] = value
        else:
            words += [flag, value]
    if kind == "calibrators":
        words = list(_USES[kind])
    data = "odd:" if kind == "datasets" else "folder:in/data"
    isolate = ["--isolate"] if how in _ISOLATED or rng.random() < 0.03 else []
    more = rng.choice((["--json"], ["--json"], [], ["--out", OUT], ["--export", f"json:{OUT}/r.json"]))
    return Case(("run", "--data", data, *words, "--plugin", "in/odd.py", *isolate, *more), hangs=_HANGS)
