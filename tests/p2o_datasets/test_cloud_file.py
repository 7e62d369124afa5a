from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets import cloud_file
from p2o_datasets.cloud_file import cloud_from_fields, read_cloud


def points(count: int = 50) -> np.ndarray:
    out = np.random.default_rng(1).uniform(-20, 20, (count, 4)).astype("<f4")
    out[:, 3] = np.abs(out[:, 3])
    return out


def test_a_bin_file_gives_points_and_intensity_in_its_order(tmp_path: Path) -> None:
    written = points()
    written.tofile(tmp_path / "a.bin")
    cloud, warnings = read_cloud(tmp_path / "a.bin")
    assert np.array_equal(cloud.xyz, written[:, :3])
    assert np.array_equal(cloud.intensity, written[:, 3])
    assert (cloud.ring, cloud.time_s, warnings) == (None, None, ())


def test_a_bin_file_cut_inside_a_point_is_truncated(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(points().tobytes()[:-3])
    with pytest.raises(InputError, match=r"a\.bin: the point cloud is truncated; .*16 bytes"):
        read_cloud(tmp_path / "a.bin")


@pytest.mark.parametrize(
    "content",
    [b"\xff\xd8\xff\xe0 this is a picture or text", b"# .PCD v0.7 - Point Cloud Data file"],
)
def test_a_bin_file_of_another_format_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.bin").write_bytes((content * 16)[: 16 * len(content)])
    with pytest.raises(InputError, match=r"a\.bin: this is not a point cloud in metres"):
        read_cloud(tmp_path / "a.bin")


@pytest.mark.parametrize("suffix", ["bin", "pcd", "ply", "npz", "txt"])
def test_missing_empty_and_folder_are_refused_by_name_for_every_kind(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    with pytest.raises(InputError, match=rf"a\.{suffix}: the point cloud is missing"):
        read_cloud(path)
    path.touch()
    with pytest.raises(InputError, match=rf"a\.{suffix}: the point cloud is empty"):
        read_cloud(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match=rf"a\.{suffix}: the point cloud is a folder"):
        read_cloud(path)


@pytest.mark.parametrize("suffix", ["pcd", "ply", "npz"])
def test_a_file_of_another_format_is_refused_by_name_for_every_kind(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a.{suffix}").write_bytes(b"something else entirely\n" * 10)
    with pytest.raises(InputError, match=rf"a\.{suffix}: this is not an? \.{suffix}"):
        read_cloud(tmp_path / f"a.{suffix}")


def test_text_gives_the_same_points_as_bin_and_refuses_words_and_cuts(tmp_path: Path) -> None:
    written = points()
    np.savetxt(tmp_path / "a.txt", written, fmt="%.9g")
    cloud, _ = read_cloud(tmp_path / "a.txt")
    assert np.array_equal(cloud.xyz.astype("<f4"), written[:, :3])
    assert np.array_equal(cloud.intensity.astype("<f4"), written[:, 3])
    (tmp_path / "a.txt").write_text("1 2 3 0.5\n4 5 6")
    with pytest.raises(
        InputError, match=r"a\.txt: the point cloud is truncated .*expected 4 numbers per line; got .*4 to 3"
    ):
        read_cloud(tmp_path / "a.txt")
    (tmp_path / "a.txt").write_text("see the other folder")
    with pytest.raises(InputError, match=r"a\.txt: the points are not numbers"):
        read_cloud(tmp_path / "a.txt")


def test_an_unknown_suffix_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.xyz: unknown format .* \.bin \.npy \.txt \.pcd \.ply \.npz"):
        read_cloud(tmp_path / "a.xyz")


def test_points_that_are_no_returns_are_dropped_with_counts(tmp_path: Path) -> None:
    written = points()
    written[3, 0], written[4, 1], written[5, :3] = np.nan, np.inf, 0
    written.tofile(tmp_path / "a.bin")
    cloud, warnings = read_cloud(tmp_path / "a.bin")
    assert np.array_equal(cloud.xyz, np.delete(written, [3, 4, 5], axis=0)[:, :3])
    assert warnings == (
        "a.bin: 2 of 50 points dropped: NaN or infinite",
        "a.bin: 1 of 50 points dropped: all zero",
    )


@pytest.mark.parametrize(("value", "kind"), [(np.nan, "NaN or infinite"), (0.0, "all-zero")])
def test_a_sweep_of_bad_points_only_is_refused_by_name(tmp_path: Path, value: float, kind: str) -> None:
    written = points()
    written[:, :3] = value
    written.tofile(tmp_path / "a.bin")
    with pytest.raises(InputError, match=rf"a\.bin: the cloud has no valid point; .*50 {kind}"):
        read_cloud(tmp_path / "a.bin")


def test_a_sweep_without_points_is_refused_by_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xyz=np.zeros((0, 3)))
    with pytest.raises(InputError, match=r"a\.npz: the cloud has no points"):
        read_cloud(tmp_path / "a.npz")


def test_an_npz_archive_gives_all_its_fields(tmp_path: Path) -> None:
    xyz = points()[:, :3]
    ring, time_s, intensity = np.arange(50) % 16, np.linspace(-0.05, 0.05, 50), np.arange(50) / 50
    np.savez_compressed(tmp_path / "a.npz", xyz=xyz, ring=ring, time_s=time_s, intensity=intensity)
    cloud, _ = read_cloud(tmp_path / "a.npz")
    assert np.array_equal(cloud.xyz, xyz)
    assert np.array_equal(cloud.ring, ring)
    assert np.array_equal(cloud.time_s, time_s)
    assert np.array_equal(cloud.intensity, intensity)


def test_pickled_objects_in_an_npz_archive_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xyz=np.array([{"boom": 1}], dtype=object))
    with pytest.raises(InputError, match=r"a\.npz: the \.npz archive holds pickled objects"):
        read_cloud(tmp_path / "a.npz")


def test_an_npz_archive_without_points_or_cut_off_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.zeros((4, 3)))
    with pytest.raises(InputError, match=r"a\.npz: the \.npz archive has no points; .*no xyz"):
        read_cloud(tmp_path / "a.npz")
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[:-30])
    with pytest.raises(InputError, match=r"a\.npz: this is not an \.npz archive"):
        read_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize("alias", ["intensity", "i", "reflectance"])
def test_intensity_has_several_names(alias: str) -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    cloud, _ = cloud_from_fields({**axes, alias: np.arange(50.0)}, Path("a"))
    assert np.array_equal(cloud.intensity, np.arange(50.0))


def test_the_unit_of_times_is_that_in_which_the_sweep_has_a_plausible_duration() -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    nanoseconds, _ = cloud_from_fields({**axes, "t": np.arange(50) * 2_000_000}, Path("a"), image_time_s=0.05)
    seconds, _ = cloud_from_fields({**axes, "time": np.arange(50) * 0.002}, Path("a"), image_time_s=0.05)
    assert np.allclose(nanoseconds.time_s, np.arange(50) * 0.002 - 0.05, atol=1e-12)
    assert np.allclose(seconds.time_s, nanoseconds.time_s, atol=1e-12)


def test_times_of_another_clock_are_dropped_with_a_warning() -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    stamps = 1.6e9 + np.arange(50) * 0.002
    cloud, warnings = cloud_from_fields({**axes, "timestamp": stamps}, Path("a.pcd"))
    assert cloud.time_s is None
    assert warnings == ("a.pcd: field timestamp ignored: not relative to the image; give image_time_s",)
    cloud, warnings = cloud_from_fields({**axes, "timestamp": stamps}, Path("a.pcd"), image_time_s=1.6e9)
    assert np.allclose(cloud.time_s, np.arange(50) * 0.002, atol=1e-6)
    assert warnings == ()


def test_a_field_that_is_not_finite_is_left_out_with_a_warning() -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    cloud, warnings = cloud_from_fields({**axes, "ring": np.full(50, np.nan)}, Path("a.pcd"))
    assert cloud.ring is None
    assert warnings == ("a.pcd: field ring ignored: not finite numbers",)


def test_a_ring_that_is_no_ring_is_left_out_with_a_warning() -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    cloud, warnings = cloud_from_fields({**axes, "ring": np.full(50, 1e300)}, Path("a.pcd"))
    assert cloud.ring is None
    assert warnings == ("a.pcd: field ring ignored: numbers from 1e+300 to 1e+300 are not rings",)


@pytest.mark.parametrize(
    ("ring", "why"),
    [
        (np.full(50, 58790), "numbers from 58790 to 58790 are not rings"),
        (np.arange(50) * 100, "numbers from 0 to 4900 are not rings"),
        (np.arange(50) - 1, "numbers from -1 to 48 are not rings"),
        (np.full(50, 7), "all 50 points have ring 7"),
        (np.arange(50) / 4, "rings are not integers"),
    ],
)
def test_rings_that_are_all_equal_too_many_or_no_numbers_of_rings_are_left_out(ring: np.ndarray, why: str) -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    for dtype in {ring.dtype, np.dtype(np.float32)}:
        cloud, warnings = cloud_from_fields({**axes, "ring": ring.astype(dtype)}, Path("a.pcd"))
        assert cloud.ring is None
        assert warnings == (f"a.pcd: field ring ignored: {why}",)


def test_times_that_are_not_finite_are_left_out_with_a_warning() -> None:
    axes = dict(zip("xyz", points()[:, :3].T, strict=True))
    times = np.linspace(0, 0.1, 50)
    times[3] = np.nan
    cloud, warnings = cloud_from_fields({**axes, "time": times}, Path("a.pcd"))
    assert cloud.time_s is None
    assert warnings == ("a.pcd: field time ignored: not finite numbers",)


def test_fields_of_points_that_are_dropped_may_be_anything() -> None:
    axes = dict(zip("xyz", points()[:, :3].T.copy(), strict=True))
    times, ring = np.linspace(0, 0.1, 50), np.arange(50.0) % 4
    axes["y"][3], times[3], ring[3] = np.inf, np.nan, np.nan
    cloud, _ = cloud_from_fields({**axes, "time": times, "ring": ring}, Path("a.pcd"))
    assert np.array_equal(cloud.time_s, np.delete(times, 3))
    assert np.array_equal(cloud.ring, np.delete(ring, 3))


def test_too_many_points_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points().tofile(tmp_path / "a.bin")
    monkeypatch.setattr(cloud_file, "MAX_POINTS", 49)
    with pytest.raises(InputError, match=r"a\.bin: the point cloud has too many points; expected at most 49; got 50"):
        read_cloud(tmp_path / "a.bin")


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "a.bin").open("wb") as file:
        file.truncate(1 << 36)
    with pytest.raises(InputError, match=r"a\.bin: the point cloud is too large"):
        read_cloud(tmp_path / "a.bin")


def test_a_field_of_another_length_is_refused_by_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xyz=np.ones((4, 3)), ring=np.arange(5))
    with pytest.raises(InputError, match=r"a\.npz: field ring has another length .*\(4,\); got \(5,\)"):
        read_cloud(tmp_path / "a.npz")


def test_bytes_that_are_signalling_nan_are_dropped_without_a_stir(tmp_path: Path) -> None:
    written = points()
    written.view("<u4")[7, 0] = 0x7F800001
    written.tofile(tmp_path / "a.bin")
    assert len(read_cloud(tmp_path / "a.bin")[0]) == 49


def test_missing_coordinates_are_named() -> None:
    with pytest.raises(InputError, match=r"a\.pcd: the points have no coordinates; .*got x y intensity"):
        cloud_from_fields({"x": [1.0], "y": [1.0], "intensity": [1.0]}, Path("a.pcd"))
