from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets.bin_file import KITTI_COLUMNS
from p2o_datasets.cloud_file import read_cloud

NAMES = ("x", "y", "z", "intensity", "ring", "time")


def rows(columns: int, count: int = 240, *, seed: int = 3) -> np.ndarray:
    """Return points all around with whole intensities, as nuScenes has them, rings, and times of one turn."""
    rng = np.random.default_rng(seed)
    points = [rng.uniform(-40, 40, (count, 2)), rng.uniform(-2, 6, count), rng.integers(0, 256, count)]
    table = np.column_stack([*points, np.arange(count) % 32, np.linspace(0, 0.1, count)])
    return table.astype("<f4")[:, :columns]


def write(path: Path, values: np.ndarray) -> Path:
    values.tofile(path)
    return path


@pytest.mark.parametrize("columns", [4, 5, 6])
@pytest.mark.parametrize("count", range(240, 252))
def test_values_tell_how_long_rows_are(tmp_path: Path, columns: int, count: int) -> None:
    written = rows(columns, count)
    written = np.random.default_rng(0).permutation(written) if count % 2 else written
    cloud, warnings = read_cloud(write(tmp_path / "a.pcd.bin", written))
    assert np.array_equal(cloud.xyz, written[:, :3])
    assert np.array_equal(cloud.intensity, written[:, 3])
    assert (cloud.ring is None) == (columns < 5)
    assert (cloud.time_s is None) == (columns < 6)
    if columns == 6:
        assert np.array_equal(cloud.ring, written[:, 4])
        assert np.array_equal(cloud.time_s, written[:, 5])
    assert warnings == ()


def test_rows_of_missing_returns_are_dropped_and_do_not_hide_the_columns(tmp_path: Path) -> None:
    written = rows(5)
    written[7:20] = np.nan
    cloud, warnings = read_cloud(write(tmp_path / "a.bin", written))
    assert np.array_equal(cloud.ring, np.delete(written, np.s_[7:20], axis=0)[:, 4])
    assert warnings == ("a.bin: 13 of 240 points dropped: NaN or infinite",)


@pytest.mark.parametrize("columns", [4, 5, 6])
@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_file_cut_inside_a_row_is_not_read_by_another_length(tmp_path: Path, columns: int, missing: int) -> None:
    path = write(tmp_path / "a.bin", rows(columns).ravel()[:-missing])
    with pytest.raises(InputError, match=rf"a\.bin: the point cloud is truncated; expected .* {4 * columns} bytes"):
        read_cloud(path)


def test_what_fits_several_ways_is_refused_and_the_option_settles_it(tmp_path: Path) -> None:
    # Whole numbers that are never negative break no rule in any reading.
    written = np.abs(np.floor(rows(4)))
    path = write(tmp_path / "a.bin", written)
    with pytest.raises(InputError, match=r"ambiguous; .*got rows of 4 or 5 or 6 fit; .*cloud_columns: \[x, y"):
        read_cloud(path)
    cloud, _ = read_cloud(path, columns=("x", "y", "z", "intensity"))
    assert np.array_equal(cloud.xyz, written[:, :3])


@pytest.mark.parametrize(
    "columns", [("x", "y", "z"), ("x", "y", "z", "intensity", "time"), ("time", "z", "y", "_", "x", "_", "ring")]
)
def test_columns_that_are_none_of_the_known_have_to_be_named(tmp_path: Path, columns: tuple[str, ...]) -> None:
    known = rows(6)
    written = np.column_stack([known[:, NAMES.index(n)] if n != "_" else -known[:, 5] for n in columns])
    path = write(tmp_path / "a.bin", written)
    with pytest.raises(InputError, match=r"a\.bin: .*'cloud_columns: \[x, y, z(, intensity, ring)?\]'"):
        read_cloud(path)
    cloud, warnings = read_cloud(path, columns=columns)
    assert np.array_equal(cloud.xyz, known[:, :3])
    assert (cloud.time_s is not None) == ("time" in columns)
    assert (cloud.ring is not None) == ("ring" in columns)
    assert warnings == ()


@pytest.mark.parametrize(
    "columns", [("x", "y"), ("x", "y", "z", "z"), ("x", "y", "z", "colour"), (), ("x", "y", "z", *"_" * 80)]
)
def test_wrong_names_of_columns_are_refused(tmp_path: Path, columns: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=r"a\.bin: wrong cloud_columns; expected x y z once each"):
        read_cloud(write(tmp_path / "a.bin", rows(4)), columns=columns)


def test_columns_of_a_file_that_names_its_own_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xyz=np.ones((3, 3)))
    with pytest.raises(InputError, match=r"a\.npz: cloud_columns given for a file with named columns; .*\.bin"):
        read_cloud(tmp_path / "a.npz", columns=("x", "y", "z"))


def test_text_has_the_columns_of_its_first_line(tmp_path: Path) -> None:
    written = rows(6)
    np.savetxt(tmp_path / "a.txt", written, fmt="%.9g")
    cloud, _ = read_cloud(tmp_path / "a.txt")
    assert np.array_equal(cloud.ring, written[:, 4])
    assert np.array_equal(cloud.time_s.astype("<f4"), written[:, 5])
    np.savetxt(tmp_path / "a.txt", written[:, :3], fmt="%.9g")
    assert len(read_cloud(tmp_path / "a.txt")[0]) == len(written)
    np.savetxt(tmp_path / "a.txt", written[:, :2], fmt="%.9g")
    with pytest.raises(InputError, match=r"other columns; expected 4 numbers per line; got 2 numbers"):
        read_cloud(tmp_path / "a.txt")


@pytest.mark.parametrize("empty", [0.0, np.nan])
def test_every_second_row_may_be_without_a_return(tmp_path: Path, empty: float) -> None:
    written = rows(4, 2400)
    written[1::2] = empty
    path = write(tmp_path / "a.bin", written)
    for columns in (None, ("x", "y", "z", "intensity")):
        xyz = read_cloud(path, columns=columns)[0].xyz
        assert np.array_equal(xyz[np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)], written[::2, :3])


@pytest.mark.parametrize("width", [5, 7, 8, 9, 10, 12])
def test_rows_of_another_length_are_no_points(tmp_path: Path, width: int) -> None:
    known = rows(6, 2400)
    written = np.column_stack([known[:, :4], *[known[:, 5] + number for number in range(width - 4)]])
    path = write(tmp_path / "a.bin", written)
    with pytest.raises(InputError, match="columns"):
        read_cloud(path)
    with pytest.raises(InputError, match=r"the rows do not have 3 numbers; .*cloud_columns: x y z"):
        read_cloud(path, columns=("x", "y", "z"))
    cloud, _ = read_cloud(path, columns=("x", "y", "z", "intensity", *["_"] * (width - 4)))
    assert np.array_equal(cloud.xyz, known[:, :3])


@pytest.mark.parametrize("count", [240, 241, 242, 243])
def test_coordinates_alone_are_not_called_truncated(tmp_path: Path, count: int) -> None:
    path = write(tmp_path / "a.bin", rows(4, count)[:, :3].copy())
    with pytest.raises(InputError, match=r"no intensity; .*'cloud_columns: \[x, y, z\]'"):
        read_cloud(path)
    cloud, warnings = read_cloud(path, columns=("x", "y", "z"))
    assert (len(cloud), cloud.intensity, warnings) == (count, None, ())
    with pytest.raises(InputError, match=r"other columns, or is truncated; .*three numbers \(x y z\) fit"):
        read_cloud(path, columns=KITTI_COLUMNS)


@pytest.mark.parametrize("dtype", ["<f4", "<f8", ">f4"])
@pytest.mark.parametrize("columns", [3, 4, 5, 6])
@pytest.mark.parametrize("order", ["C", "F"])
def test_an_npy_array_has_the_columns_of_its_width(tmp_path: Path, dtype: str, columns: int, order: Any) -> None:
    written = rows(6)[:, :columns]
    np.save(tmp_path / "a.npy", np.asarray(written, dtype, order=order))
    cloud, warnings = read_cloud(tmp_path / "a.npy")
    assert np.array_equal(cloud.xyz, written[:, :3])
    told = cloud.intensity is not None, cloud.ring is not None, cloud.time_s is not None
    assert (told, warnings) == ((columns > 3, columns > 4, columns > 5), ())


def test_columns_of_an_npy_array_can_be_named(tmp_path: Path) -> None:
    written = rows(5)
    np.save(tmp_path / "a.npy", written[:, [4, 0, 1, 2]])
    cloud, _ = read_cloud(tmp_path / "a.npy", columns=("ring", "x", "y", "z"))
    assert np.array_equal(cloud.xyz, written[:, :3])
    assert np.array_equal(cloud.ring, written[:, 4])
    with pytest.raises(InputError, match=r"the \.npy file is no sweep; expected numbers of shape \(N, 3\); got .*4"):
        read_cloud(tmp_path / "a.npy", columns=("x", "y", "z"))


@pytest.mark.parametrize(
    "array", [np.zeros((3, 240)), np.zeros(240), np.zeros((4, 3, 2)), np.zeros((5, 2)), np.zeros((5, 3), complex)]
)
def test_other_npy_arrays_are_no_sweep(tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(InputError, match=r"a\.npy: the \.npy file is no sweep; expected numbers of shape \(N, 3\) to"):
        read_cloud(tmp_path / "a.npy")
