"""Names of the fields of points in every format, and the units of their times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets.bags.messages import read_message
from p2o_datasets.bags.point_columns import columns_of
from p2o_datasets.cloud_file import ReadPoints, read_fields, read_points
from p2o_datasets.point_fields import PointClock, Unit, usable_points

from tests.bag_files import cloud, serialized, store_of

STAMP_NS = 1_700_000_000_123_456_789
FORMATS = ("pcd-ascii", "pcd", "ply-ascii", "ply", "npz", "npy", "las", "bag")


def after(times: Any, image_ns: int = STAMP_NS, unit: Unit = "auto", usable: Any = None) -> tuple[Any, Any]:
    """Return the times of a bag in seconds after its image."""
    clock = PointClock(unit, image_ns, STAMP_NS, setting="--set data.point_times=")
    return clock.after_image(times, np.ones(len(times), bool) if usable is None else usable)


def points(count: int = 960) -> dict[str, Any]:
    """Coordinates on 16 rings, turn by turn."""
    azimuth, ring = np.linspace(0, 2 * np.pi, count // 16, endpoint=False), np.repeat(np.arange(16), count // 16)
    turn = np.tile(azimuth, 16)
    columns = {"x": 10 * np.cos(turn), "y": 10 * np.sin(turn), "z": 0.3 * (ring - 8.0)}
    return {name: column.astype(np.float32) for name, column in columns.items()}


def written(folder: Path, form: str, columns: dict[str, Any]) -> Path:
    """Write a file with named columns (N,), and return its path."""
    folder.mkdir(exist_ok=True)
    kind, _, text = form.partition("-")
    path = folder / f"a.{kind}"
    table = np.rec.fromarrays(list(columns.values()), names=list(columns))
    rows = "\n".join(" ".join(repr(value) for value in row) for row in table.tolist())
    if kind == "pcd":
        codes = [column.dtype for column in columns.values()]
        types = " ".join({"f": "F", "u": "U", "i": "I"}[code.kind] for code in codes)
        sizes = " ".join(str(code.itemsize) for code in codes)
        head = f"VERSION 0.7\nFIELDS {' '.join(columns)}\nSIZE {sizes}\nTYPE {types}\n"
        head += f"WIDTH {len(table)}\nHEIGHT 1\nPOINTS {len(table)}\nDATA {'ascii' if text else 'binary'}\n"
        path.write_bytes(head.encode() + (rows.encode() if text else table.tobytes()))
    elif kind == "ply":
        words = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "u4": "uint", "i4": "int"}
        lines = [f"property {words[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
        start = f"ply\nformat {'ascii' if text else 'binary_little_endian'} 1.0\nelement vertex {len(table)}"
        head = "\n".join([start, *lines])
        path.write_bytes(f"{head}\nend_header\n".encode() + (rows.encode() if text else table.tobytes()))
    elif kind == "npz":
        np.savez(path, xyz=np.stack([columns[axis] for axis in "xyz"], axis=1), **without_axes(columns))
    elif kind == "npy":
        np.save(path, np.array(table.tolist(), table.dtype.descr))
    else:
        laspy = pytest.importorskip("laspy")
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales = [1e-4] * 3
        extra = {name: column for name, column in without_axes(columns).items() if name != "intensity"}
        for name, column in extra.items():
            header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=column.dtype))
        las = laspy.LasData(header)
        for name, column in columns.items():
            setattr(las, name, column)
        with path.open("wb") as file:
            las.write(file)
    return path


def without_axes(columns: dict[str, Any]) -> dict[str, Any]:
    return {name: column for name, column in columns.items() if name not in "xyz"}


def read(folder: Path, form: str, columns: dict[str, Any], clock: PointClock | None = None) -> ReadPoints:
    """Return the sweep of columns that were written in a format."""
    if form == "bag":
        message = cloud("/points", STAMP_NS, columns)
        fields = columns_of(read_message(message.kind, serialized(store_of("mcap"), message, "mcap"), ros1=False))
        return read_points(fields, folder, clock or PointClock(image_ns=STAMP_NS, sweep_ns=STAMP_NS))
    path = written(folder, form, columns)
    return read_points(read_fields(path), path, clock or PointClock.of_image(0.0))


NAMES = {
    "ring": ("ring", "laser_id", "line", "row", "channel", "laser", "scalar_Ring"),
    "intensity": ("intensity", "intensities", "reflectivity", "i", "scalar_Intensity"),
    "time_s": ("time", "t", "timestamp", "offset_time", "time_offset", "scalar_Time_Stamp"),
}


@pytest.mark.parametrize(
    ("form", "name", "target"),
    [
        *(("npz", name, target) for target, names in NAMES.items() for name in names),
        *((form, names[0], target) for target, names in NAMES.items() for form in FORMATS if form != "npz"),
    ],
)
def test_fields_are_found_by_all_names_in_every_format(tmp_path: Path, form: str, name: str, target: str) -> None:
    columns = points()
    ring = np.repeat(np.arange(16), len(columns["x"]) // 16).astype(np.uint16)
    values = {
        "ring": ring,
        "intensity": (ring * 3).astype(np.float32),
        "time_s": np.linspace(0, 1e8, len(ring)).astype(np.uint32),
    }
    found = read(tmp_path, form, {**columns, name: values[target], "label": ring})
    expected = values[target] * 1e-9 if target == "time_s" else values[target]
    np.testing.assert_allclose(getattr(found.cloud, target), expected, atol=1e-9)
    assert found.warnings == ()
    assert "label" in found.unused
    assert name not in found.unused


@pytest.mark.parametrize(
    ("form", "per", "start_s"),
    [
        *(("npz", per, start_s) for per in (1, 1e3, 1e6, 1e9) for start_s in (0.0, -0.05, 1.7e9)),
        *((form, 1e9, 1.7e9) for form in FORMATS if form != "npz"),
    ],
)
def test_times_of_any_unit_are_seconds_after_the_image(tmp_path: Path, form: str, per: float, start_s: float) -> None:
    columns = points()
    turn_s = np.linspace(0, 0.1, len(columns["x"]))
    times = (start_s + turn_s) * per if per < 1e9 else (start_s * 1e9 + np.rint(turn_s * 1e9))
    clock = PointClock.of_image(start_s + 0.02)
    found = read(tmp_path, form, {**columns, "timestamp": times.astype(np.float64)}, clock)
    np.testing.assert_allclose(found.cloud.time_s, turn_s - 0.02, atol=1e-6)
    assert found.warnings == ()


def test_a_time_of_the_image_in_the_unit_of_the_points_is_understood_with_a_warning(tmp_path: Path) -> None:
    columns = {**points(), "time": np.linspace(0, 99.9, 960).astype(np.float32)}
    found = read(tmp_path, "pcd", columns, PointClock.of_image(49.9))
    np.testing.assert_allclose(found.cloud.time_s, np.linspace(-0.0499, 0.05, 960), atol=1e-7)
    assert found.warnings == ("a.pcd: image_time_s 49.9 is taken as ms, as the times of the points: write 0.0499",)


@pytest.mark.parametrize("span", [2.0, 1e-3, 1e12])
def test_times_without_a_unit_are_refused_if_the_image_has_a_time(tmp_path: Path, span: float) -> None:
    columns = {**points(), "time": np.linspace(0, span, 960)}
    with pytest.raises(InputError, match=r"a\.pcd: the unit of the points' times is ambiguous; .*point_times: ns"):
        read(tmp_path, "pcd", columns)
    stated = read(tmp_path, "pcd", columns, PointClock.of_image(0.0, "us")).cloud
    assert stated.time_s.max() == pytest.approx(span * 1e-6)
    assert read(tmp_path, "pcd", columns, PointClock.of_image(0.0, "none")).cloud.time_s is None
    found = read(tmp_path, "pcd", columns, PointClock.of_image(None))
    assert found.cloud.time_s is None
    assert "field time ignored: the unit of the points' times is ambiguous" in found.warnings[0]


@pytest.mark.parametrize(("name", "per"), [("time_s", 1), ("offset_time_ns", 1e9), ("t_us", 1e6)])
def test_a_unit_in_the_name_counts_whatever_the_duration(tmp_path: Path, name: str, per: float) -> None:
    found = read(tmp_path, "npz", {**points(), name: np.linspace(0, 3, 960) * per})
    np.testing.assert_allclose(found.cloud.time_s, np.linspace(0, 3, 960), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("channel", np.linspace(0, 1, 960)),
        ("channel", np.ones(960)),
        ("line", np.full(960, 3, np.uint8)),
        ("channel", np.tile([0, 1], 480)),
        ("row", np.arange(960) * 4),
    ],
)
def test_a_channel_or_line_that_is_no_ring_is_not_used(tmp_path: Path, name: str, values: Any) -> None:
    found = read(tmp_path, "npz", {**points(), name: values})
    assert found.cloud.ring is None
    assert (found.warnings, found.unused) == ((), (name,))
    ring = np.repeat(np.arange(16), 60)
    assert read(tmp_path, "npz", {**points(), name: values, "scan_line": ring}).cloud.ring.tolist() == ring.tolist()


def test_an_intensity_takes_precedence_over_a_reflectivity(tmp_path: Path) -> None:
    found = read(tmp_path, "npz", {**points(), "reflectivity": np.zeros(960), "intensity": np.ones(960)})
    assert found.cloud.intensity.all()
    assert found.unused == ("reflectivity",)


TURN_S = np.linspace(0, 0.0998, 500)


@pytest.mark.parametrize(
    ("times", "accuracy_s"),
    [
        (TURN_S.astype(np.float32), 1e-7),
        (TURN_S, 1e-9),
        ((TURN_S * 1e3).astype(np.float32), 1e-7),
        ((TURN_S * 1e6).astype(np.float32), 1e-7),
        ((TURN_S * 1e6).round().astype(np.uint32), 1e-6),
        ((TURN_S * 1e9).round().astype(np.uint32), 1e-8),
        (STAMP_NS * 1e-9 + TURN_S, 5e-7),
        ((STAMP_NS + TURN_S * 1e9).astype(np.float64), 5e-7),
        (STAMP_NS + (TURN_S * 1e9).round().astype(np.uint64), 1e-8),
        ((STAMP_NS // 1000 + (TURN_S * 1e6).round().astype(np.int64)), 3e-6),
    ],
    ids=["s-f4", "s", "ms", "us-f4", "us", "ns", "since-1970", "ns-f8", "ns-u8", "us-i8"],
)
def test_the_unit_of_times_is_told_by_how_long_a_sweep_takes(times: Any, accuracy_s: float) -> None:
    image_ns = STAMP_NS + 40_000_000
    found, remark = after(times, image_ns)
    assert remark is None
    assert np.abs(found - (TURN_S - 0.04)).max() < accuracy_s


def test_times_of_missing_returns_do_not_count() -> None:
    times = (TURN_S * 1e9).round().astype(np.uint32) + 5_000_000
    times[::7] = 0
    usable = usable_points(np.where(times[:, None] == 0, np.nan, [1.0, 1.0, 1.0]))
    assert usable.sum() == np.count_nonzero(times)
    found, _ = after(times, usable=usable)
    assert np.allclose(found[usable], TURN_S[usable] + 0.005, atol=1e-8)


@pytest.mark.parametrize(
    "times", [5.0 + TURN_S, 1e9 + TURN_S, -7.0 + TURN_S, np.array([1e300, np.nextafter(1e300, 2e300)])]
)
def test_times_on_another_clock_are_refused(times: Any) -> None:
    with pytest.raises(InputError, match=r"on different clocks.*data.point_times=none"):
        after(times, unit="s")


@pytest.mark.parametrize(("times", "why"), [(np.zeros(9), "all are the same"), (np.full(9, np.nan), "not finite")])
def test_times_that_say_nothing_are_left_out_with_a_remark(times: Any, why: str) -> None:
    found, remark = after(times)
    assert found is None
    assert why in remark
