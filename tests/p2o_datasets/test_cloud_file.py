from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o_datasets import cloud_file
from p2o_datasets.cloud_file import cloud_from_fields, read_cloud

from .opened import refused


def points(count: int = 50) -> np.ndarray:
    out = np.random.default_rng(1).uniform(-20, 20, (count, 4)).astype("<f4")
    out[:, 3] = np.abs(out[:, 3])
    return out


def axes() -> dict[str, Any]:
    return dict(zip("xyz", points()[:, :3].T.copy(), strict=True))


@pytest.mark.filterwarnings("error")
def test_a_bin_file_gives_points_and_intensity_in_its_order_without_what_are_no_returns(tmp_path: Path) -> None:
    written = points()
    written[3, 0], written[4, 1], written[5, :3] = np.nan, np.inf, 0
    # A signalling NaN is dropped without a warning of NumPy.
    written.view("<u4")[7, 0] = 0x7F800001
    written.tofile(tmp_path / "a.bin")
    cloud, warnings = read_cloud(tmp_path / "a.bin")
    valid = np.delete(written, [3, 4, 5, 7], axis=0)
    assert np.array_equal(cloud.xyz, valid[:, :3])
    assert np.array_equal(cloud.intensity, valid[:, 3])
    assert (cloud.ring, cloud.time_s) == (None, None)
    assert warnings == ("a.bin: 3 of 50 points dropped: NaN or infinite", "a.bin: 1 of 50 points dropped: all zero")


def test_an_npz_archive_gives_all_its_fields(tmp_path: Path) -> None:
    fields = {"ring": np.arange(50) % 16, "time_s": np.linspace(-0.05, 0.05, 50), "intensity": np.arange(50) / 50}
    np.savez_compressed(tmp_path / "a.npz", xyz=points()[:, :3], **fields)
    cloud, _ = read_cloud(tmp_path / "a.npz")
    assert np.array_equal(cloud.xyz, points()[:, :3])
    for name, values in fields.items():
        assert np.array_equal(getattr(cloud, name), values)


@pytest.mark.parametrize("suffix", ["bin", "pcd", "ply", "npz", "txt"])
def test_missing_empty_and_folder_are_refused_by_name_for_every_kind(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    with refused(rf"a\.{suffix}: the point cloud is missing"):
        read_cloud(path)
    path.touch()
    with refused(rf"a\.{suffix}: the point cloud is empty"):
        read_cloud(path)
    path.unlink()
    path.mkdir()
    with refused(rf"a\.{suffix}: the point cloud is a folder"):
        read_cloud(path)


def archive(**arrays: Any) -> Any:
    return lambda path: np.savez(path, **arrays)


NONE = points() * [np.nan, np.nan, np.nan, 1]
ZERO = points() * np.float32([0, 0, 0, 1])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bin", points().tobytes()[:-3], "the point cloud is truncated; .*16 bytes"),
        ("a.bin", b"\xff\xd8\xff\xe0 this is a picture or text" * 16, "this is not a point cloud in metres"),
        ("a.bin", b"# .PCD v0.7 - Point Cloud Data file " * 16, "this is not a point cloud in metres"),
        ("a.bin", NONE.astype("<f4").tobytes(), "the cloud has no valid point; .*50 NaN or infinite"),
        ("a.bin", ZERO.tobytes(), "the cloud has no valid point; .*50 all-zero"),
        *((f"a.{kind}", b"something else\n" * 10, rf"this is not an? \.{kind}") for kind in ("pcd", "ply", "npz")),
        ("a.txt", b"1 2 3 0.5\n4 5 6", "the point cloud is truncated .*expected 4 numbers per line; got .*4 to 3"),
        ("a.txt", b"see the other folder", "the points are not numbers"),
        ("a.xyz", b"1 2 3", r"unknown format .* \.bin \.npy \.txt \.pcd \.ply \.npz"),
        ("a.npz", archive(xyz=np.zeros((0, 3))), "the cloud has no points"),
        ("a.npz", archive(xyz=np.array([{"boom": 1}], dtype=object)), r"the \.npz archive holds pickled objects"),
        ("a.npz", archive(points=np.zeros((4, 3))), r"the \.npz archive has no points; .*no xyz"),
        ("a.npz", archive(xyz=np.ones((4, 3)), ring=np.arange(5)), r"field ring .*length .*\(4,\); got \(5,\)"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_sweep_is_refused_by_name(tmp_path: Path, name: str, content: Any, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    with refused(f"{name}: {message}"):
        read_cloud(path)


def test_a_cut_archive_and_what_is_too_large_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez(tmp_path / "a.npz", xyz=points()[:, :3])
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-30])
    with refused(r"a\.npz: this is not an \.npz archive"):
        read_cloud(tmp_path / "a.npz")
    with (tmp_path / "large.bin").open("wb") as file:
        file.truncate(1 << 36)
    with refused(r"large\.bin: the point cloud is too large"):
        read_cloud(tmp_path / "large.bin")
    points().tofile(tmp_path / "a.bin")
    monkeypatch.setattr(cloud_file, "MAX_POINTS", 49)
    with refused(r"a\.bin: the point cloud has too many points; expected at most 49; got 50"):
        read_cloud(tmp_path / "a.bin")


NAN_AT_3 = np.where(np.arange(50) == 3, np.nan, np.linspace(0, 0.1, 50))


@pytest.mark.parametrize(
    ("name", "values", "why"),
    [
        ("ring", np.full(50, np.nan), "not finite numbers"),
        ("ring", np.full(50, 1e300), "numbers from 1e+300 to 1e+300 are not rings"),
        ("ring", np.full(50, 58790), "numbers from 58790 to 58790 are not rings"),
        ("ring", (np.arange(50) * 100).astype(np.float32), "numbers from 0 to 4900 are not rings"),
        ("ring", np.arange(50) - 1, "numbers from -1 to 48 are not rings"),
        ("ring", np.full(50, 7), "all 50 points have ring 7"),
        ("ring", np.full(50, 7, np.float32), "all 50 points have ring 7"),
        ("ring", np.arange(50) / 4, "rings are not integers"),
        ("time", NAN_AT_3, "not finite numbers"),
        ("timestamp", 1.6e9 + np.arange(50) * 0.002, "not relative to the image; give image_time_s"),
    ],
)
def test_a_field_that_is_none_is_left_out_with_a_warning(name: str, values: Any, why: str) -> None:
    cloud, warnings = cloud_from_fields({**axes(), name: values}, Path("a.pcd"))
    assert (cloud.ring, cloud.time_s) == (None, None)
    assert warnings == (f"a.pcd: field {name} ignored: {why}",)


def test_fields_of_points_that_are_dropped_may_be_anything() -> None:
    columns, times, ring = axes(), NAN_AT_3, np.where(np.arange(50) == 3, np.nan, np.arange(50.0) % 4)
    columns["y"][3] = np.inf
    cloud, _ = cloud_from_fields({**columns, "time": times, "ring": ring}, Path("a.pcd"))
    assert np.array_equal(cloud.time_s, np.delete(times, 3))
    assert np.array_equal(cloud.ring, np.delete(ring, 3))


def test_missing_coordinates_are_named() -> None:
    with refused(r"a\.pcd: the points have no coordinates; .*got x y intensity"):
        cloud_from_fields({"x": [1.0], "y": [1.0], "intensity": [1.0]}, Path("a.pcd"))
