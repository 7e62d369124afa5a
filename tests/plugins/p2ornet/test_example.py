"""Examples: kept in files that run nothing, and made of what a frame knows."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError
from p2o.frames.scale import LONGEST_FOCAL_PX
from p2o_datasets.kitti_raw import KittiRawOptions
from p2o_datasets.kitti_raw import build as build_raw
from p2o_plugins.p2ornet.example import UNKNOWN, Example, example_of
from p2o_plugins.p2ornet.spans import EAST, SOUTH, Spans
from p2o_testing import stage

from tests.plugins.p2ornet.bomb import Bomb

TRAIN = "2011_09_26/0009/0000000354"


def example(classes: bool = True) -> Example:
    rng = np.random.default_rng(0)
    ends = rng.uniform(0, 9, (3, 5))
    spans = Spans.joined(Spans.of(EAST, 1, *ends, 0.5), Spans.of(SOUTH, 0, *ends))
    orders = rng.integers(-1, 3, (2, 6, 8)).astype(np.int8) if classes else None
    return Example("drive/7", rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), orders, spans)


def saved(tmp_path: Path, **other: Any) -> Path:
    """Write an example whose arrays are replaced by others."""
    one = example()
    arrays = {"name": one.name, "rgb": one.rgb, "classes": one.classes, "spans": one.spans.rows}
    path = tmp_path / "other.npz"
    np.savez(path, **{name: value for name, value in {**arrays, **other}.items() if value is not None})
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        Example.load(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: a label file cannot be read")
    assert "\n" not in text
    return text


@pytest.mark.parametrize("classes", [True, False])
def test_an_example_comes_back_as_it_was_saved(classes: bool, tmp_path: Path) -> None:
    one = example(classes)
    one.save(tmp_path / "one.npz")
    back = Example.load(tmp_path / "one.npz")
    assert back.name == one.name
    np.testing.assert_array_equal(back.rgb, one.rgb)
    np.testing.assert_array_equal(back.spans.rows, one.spans.rows)
    assert back.spans.rows.dtype == one.spans.rows.dtype
    if classes:
        assert one.classes is not None
        assert back.classes is not None
        np.testing.assert_array_equal(back.classes, one.classes)
        assert back.classes.dtype == np.int8
    else:
        assert back.classes is None


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    example().save(tmp_path / "whole.npz")
    whole = (tmp_path / "whole.npz").read_bytes()
    path = tmp_path / "damaged.npz"
    middle = whole.index(b"rgb.npy") + 200
    for content in (
        b"",
        b"PK",
        b"no labels",
        whole[:50],
        whole[:-30],
        whole[:middle] + b"\xff\x00" + whole[middle + 2 :],
    ):
        path.write_bytes(content)
        refusal(path)
    np.save(tmp_path / "single.npy", np.zeros(3))
    with zipfile.ZipFile(tmp_path / "text.npz", "w") as file:
        file.writestr("rgb.npy", "text")
    for name in ("missing.npz", ".", "single.npy", "text.npz"):
        refusal(tmp_path / name)
    refusal(saved(tmp_path, rgb=None))
    refusal(saved(tmp_path, spans=None))


@pytest.mark.parametrize("name", ["name", "rgb", "classes", "spans"])
def test_pickled_objects_are_refused_and_nothing_in_them_runs(name: str, tmp_path: Path) -> None:
    trace = tmp_path / "it-ran"
    path = saved(tmp_path, **{name: np.array([Bomb(trace)], dtype=object)})
    assert "pickle" in refusal(path)
    assert not trace.exists()


@pytest.mark.parametrize(
    "other",
    [
        {"rgb": np.zeros((6, 8), np.uint8)},
        {"rgb": np.zeros((6, 8, 3))},
        {"classes": np.zeros((2, 6, 9), np.int8)},
        {"classes": np.zeros((2, 6, 8))},
        {"spans": np.zeros((4, 6))},
        {"spans": np.zeros((2, 2), Spans.joined().rows.dtype)},
    ],
    ids=["grey", "float", "size", "wide", "plain", "matrix"],
)
def test_arrays_of_another_kind_are_refused(other: dict[str, Any], tmp_path: Path) -> None:
    refusal(saved(tmp_path, **other))


def test_a_frame_that_knows_neither_depth_nor_extrinsic_teaches_nothing() -> None:
    frame = stage.frame()
    bare = replace(frame, image=replace(frame.image, depth_m=None), camera_from_lidar=None)
    with pytest.raises(InputError, match=r"^stage: the frame cannot be used for training; expected a dense depth map"):
        example_of(bare)


def test_sparse_depth_and_the_sweep_are_joined_and_dense_depth_decides_alone() -> None:
    frame = stage.frame()
    dense = example_of(frame)
    assert dense.classes is not None
    assert set(np.unique(dense.classes).tolist()) == {UNKNOWN, 0, 1, 2}
    assert len(dense.spans) == 0
    depth = frame.image.depth_m
    assert depth is not None
    sparse = np.where(np.random.default_rng(0).random(depth.shape) < 0.7, depth, np.nan)
    only_sweep = example_of(replace(frame, image=replace(frame.image, depth_m=None)))
    only_depth = example_of(replace(frame, image=replace(frame.image, depth_m=sparse), camera_from_lidar=None))
    both = example_of(replace(frame, image=replace(frame.image, depth_m=sparse)))
    assert both.classes is None
    assert len(both.spans) == len(only_sweep.spans) + len(only_depth.spans)
    assert min(len(only_sweep.spans), len(only_depth.spans)) > 100


def test_pictures_of_long_focal_lengths_teach_at_the_size_that_a_calibration_looks_at() -> None:
    frame = stage.frame()
    camera = frame.image.camera
    tele = replace(camera, params=(2000.0, 2000.0, *camera.params[-2:]))
    image = replace(frame.image, camera=tele)
    example = example_of(replace(frame, image=image))
    share = LONGEST_FOCAL_PX / tele.focal_px
    assert share < 1
    np.testing.assert_allclose(example.rgb.shape[:2], share * np.array(image.rgb.shape[:2]), atol=1)


def test_a_sweep_without_times_counts_as_corrected() -> None:
    frame = stage.frame()
    bare = replace(frame, image=replace(frame.image, depth_m=None), twist=None)
    known, unknown = (
        example_of(replace(bare, cloud=replace(bare.cloud, time_s=time_s, twist=None)))
        for time_s in (None, np.zeros(len(bare.cloud.xyz)))
    )
    lengths = [(rows["end"] - rows["start"])[rows["order"] != 0] for rows in (known.spans.rows, unknown.spans.rows)]
    assert np.median(lengths[0]) < np.median(lengths[1])


@pytest.mark.real
def test_a_real_frame_gives_stretches_of_all_four_directions_every_time_the_same(kitti_raw: Path) -> None:
    frame = build_raw(KittiRawOptions(root=kitti_raw, right=False)).frame(TRAIN)  # type: ignore[attr-defined]
    first, again = example_of(frame), example_of(frame)
    np.testing.assert_array_equal(first.spans.rows, again.spans.rows)
    assert first.classes is None
    assert first.name == TRAIN
    rows = first.spans.rows
    for axis in (EAST, SOUTH):
        for order in (-1, 0, 1):
            assert ((rows["axis"] == axis) & (rows["order"] == order)).sum() > 30, (axis, order)
    assert np.isfinite([rows[name] for name in ("line", "start", "end", "weight")]).all()
    assert (rows["start"] <= rows["end"]).all()
    # Nearly everything that is said lies in the picture, which the sweep covers up to its uppermost beam.
    u = np.where(rows["axis"] == EAST, rows["start"], rows["line"])
    assert np.mean((u > -1) & (u < first.rgb.shape[1])) > 0.9
    assert np.where(rows["axis"] == EAST, rows["line"], rows["start"]).min() > 50


def test_a_file_of_labels_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", rgb=np.zeros((1 << 27, 3), np.uint8))
    with pytest.raises(InputError, match=r"a\.npz: a label file cannot be read; .*unpacked .* too large"):
        Example.load(tmp_path / "a.npz")
