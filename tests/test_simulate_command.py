"""`p2o simulate`: what is written to disk is what the ordinary loaders read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o import Camera, Cloud, Frame, Image, InputError, se3
from p2o.cli import main
from p2o.frames.frame import Box, Checkerboard, HoleBoard, Sphere
from p2o.host.registry import Registry
from p2o.run.recipe import open_dataset
from p2o_sim.write import folder as write_folder
from p2o_sim.write import kitti_raw as write_kitti_raw
from p2o_sim.write import vkitti2 as write_vkitti2
from p2o_sim.write.files import write_file
from p2o_testing import stage

SMALL = ["--set", "width_px=160", "--set", "height_px=64"]
WRITERS = {"kitti-raw": write_kitti_raw, "vkitti2": write_vkitti2, "folder": write_folder}
START = se3.exp(np.array([0.01, 0.02, -0.01, 0.05, -0.02, 0.1])) @ stage.camera_from_lidar()


@cache
def staged() -> Frame:
    """The bare stage with a start, and with sky and unknown pixels in its depth."""
    frame = stage.frame()
    depth = np.array(frame.image.depth_m)
    depth[:10], depth[10:20, :30] = np.inf, np.nan
    masked = np.zeros(depth.shape, bool)
    masked[30:40, 50:90] = True
    image = replace(frame.image, depth_m=depth, masked=masked)
    return replace(frame, image=image, start=START)


def written(layout: str, root: Path, *frames: Frame) -> list[str]:
    return list(WRITERS[layout].write(iter(frames), root))


def read(layout: str, root: Path, **options: Any) -> Any:
    return open_dataset(f"{layout}:{root}", Registry.load(), options)


def in_order(cloud: Cloud) -> np.ndarray:
    """Return the rows of a sweep by ring (highest first) and azimuth counter-clockwise from straight ahead."""
    x, y = cloud.xyz.astype(np.float32).astype(np.float64).T[:2]
    return np.lexsort((np.mod(np.arctan2(y, x), 2 * np.pi), cloud.ring))


@pytest.mark.parametrize("layout", ["kitti-raw", "folder"])
def test_pictures_sweep_and_truth_come_back(tmp_path: Path, layout: str) -> None:
    frame = staged()
    names = written(layout, tmp_path, frame)
    back = read(layout, tmp_path)
    assert list(back.names) == names
    again = back[0]
    np.testing.assert_array_equal(again.image.rgb, frame.image.rgb)
    np.testing.assert_array_equal(again.image.right, frame.image.right)
    assert again.camera == frame.camera
    assert again.image.baseline_m == pytest.approx(frame.image.baseline_m, abs=1e-12)
    np.testing.assert_allclose(again.camera_from_lidar, frame.camera_from_lidar, atol=1e-12)
    rows = in_order(frame.cloud) if layout == "kitti-raw" else slice(None)
    assert again.cloud.xyz.astype(np.float32).tobytes() == frame.cloud.xyz[rows].astype(np.float32).tobytes()
    np.testing.assert_array_equal(again.cloud.ring, np.unique(frame.cloud.ring[rows], return_inverse=True)[1])
    np.testing.assert_allclose(again.cloud.intensity, frame.cloud.intensity[rows], atol=1e-7)
    if layout == "folder":
        np.testing.assert_allclose(again.start, START, atol=1e-12)
        np.testing.assert_array_equal(again.cloud.time_s, frame.cloud.time_s)
        np.testing.assert_allclose(again.image.depth_m, frame.image.depth_m, rtol=1e-7)
        entry = yaml.safe_load((tmp_path / names[0] / "frame.yaml").read_text())
        assert not {"sequence", "time_s", "lidar_world_from_lidar", "camera_world_from_camera", "targets"} & set(entry)


def test_the_folder_layout_says_when_and_where_a_frame_of_a_drive_was_and_what_boards_it_shows(tmp_path: Path) -> None:
    poses = [se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]) * scale) for scale in (1.0, -0.5)]
    targets = (
        Checkerboard(7, 4, 0.1, 0.9, 0.6),
        HoleBoard(1.0, 0.8, ((-0.2, 0.0, 0.1), (0.2, 0.1, 0.12))),
        Sphere(0.25),
        Box(0.9, 0.7, 0.5),
    )
    frame = replace(
        staged(),
        sequence="drive 1",
        time_s=2.5,
        lidar_world_from_lidar=poses[0],
        camera_world_from_camera=poses[1],
        targets=targets,
    )
    (name,) = written("folder", tmp_path, frame)
    entry = yaml.safe_load((tmp_path / name / "frame.yaml").read_text())
    assert (entry["sequence"], entry["time_s"]) == ("drive 1", 2.5)
    np.testing.assert_array_equal(entry["lidar_world_from_lidar"], frame.lidar_world_from_lidar)
    np.testing.assert_array_equal(entry["camera_world_from_camera"], frame.camera_world_from_camera)
    checkerboard = {"columns": 7, "rows": 4, "square_m": 0.1, "width_m": 0.9, "height_m": 0.6}
    holes = {"width_m": 1.0, "height_m": 0.8, "holes": [[-0.2, 0.0, 0.1], [0.2, 0.1, 0.12]]}
    bodies = [{"kind": "sphere", "radius_m": 0.25}, {"kind": "box", "width_m": 0.9, "height_m": 0.7, "depth_m": 0.5}]
    assert entry["targets"] == [{"kind": "checkerboard", **checkerboard}, {"kind": "holes", **holes}, *bodies]
    again = read("folder", tmp_path)[0]
    assert (again.sequence, again.time_s, again.targets) == ("drive 1", 2.5, targets)
    np.testing.assert_allclose(again.lidar_world_from_lidar, poses[0], atol=1e-12)
    np.testing.assert_allclose(again.camera_world_from_camera, poses[1], atol=1e-12)


@pytest.mark.parametrize(
    "camera",
    [
        Camera("OPENCV", 480, 240, (286.0, 287.0, 240.3, 118.6, -0.2, 0.05, 0.001, -0.0015)),
        Camera("OPENCV_FISHEYE", 480, 240, (200.0, 201.0, 240.3, 118.6, 0.02, -0.006, 0.001, -0.0002)),
    ],
    ids=lambda camera: camera.model,
)
def test_the_folder_layout_keeps_any_camera_and_what_is_absent(tmp_path: Path, camera: Camera) -> None:
    frame = replace(staged(), image=Image(staged().image.rgb, camera))
    written("folder", tmp_path, frame)
    again = read("folder", tmp_path)[0]
    assert again.camera == camera
    assert again.image.right is None
    assert again.image.depth_m is None
    bare = Frame("bare", Image(staged().image.rgb, staged().camera), Cloud(staged().cloud.xyz), start=START)
    written("folder", tmp_path / "bare", bare)
    cloud = read("folder", tmp_path / "bare")[0].cloud
    assert (cloud.ring, cloud.intensity, cloud.time_s) == (None,) * 3


def test_kitti_depth_comes_back_to_half_a_step_of_disparity_and_sky_is_unknown(tmp_path: Path) -> None:
    frame = staged()
    scale = frame.camera.params[0] * frame.image.baseline_m
    given = np.array(frame.image.depth_m)
    given[0, 0] = 0.9 * scale / 256  # its disparity needs more than 16 bits
    written("kitti-raw", tmp_path, replace(frame, image=replace(frame.image, depth_m=given)))
    depth = read("kitti-raw", tmp_path)[0].image.depth_m
    known = np.isfinite(frame.image.depth_m)
    np.testing.assert_array_equal(np.isfinite(depth), known)
    assert np.abs(scale / depth - scale / frame.image.depth_m)[known].max() <= 0.5 / 256 + 1e-9


def moving(twist: np.ndarray) -> Frame:
    """The stage seen by a LiDAR that turns clockwise, as KITTI's, and moves; its sweep is corrected for it."""
    frame = staged()
    return replace(frame, cloud=clockwise(frame.cloud).untwisted(twist), twist=twist)


def clockwise(cloud: Cloud) -> Cloud:
    """Return the cloud with times by azimuth, turned so far that no beam looks just backwards, where a turn begins."""
    xyz = cloud.xyz @ se3.exp(np.array([0, 0, 1e-3, 0, 0, 0]))[:3, :3].T
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    return replace(cloud, xyz=xyz, time_s=-azimuth / (2 * np.pi) * 0.1)


def test_a_moving_sweep_is_written_as_measured_and_read_corrected_with_its_velocity(tmp_path: Path) -> None:
    twist = np.array([0.02, -0.03, 0.4, 14.0, 0.3, -0.1])
    frame = moving(twist)
    written("kitti-raw", tmp_path, frame)
    again = read("kitti-raw", tmp_path)[0]
    np.testing.assert_allclose(again.twist, twist, atol=1e-9)
    assert again.warnings == ()
    # The moved points keep the order in which they were measured.
    measured = clockwise(staged().cloud)
    rows = in_order(measured)
    np.testing.assert_allclose(again.cloud.time_s, frame.cloud.time_s[rows], atol=1e-6)
    np.testing.assert_allclose(again.cloud.xyz, frame.cloud.xyz[rows], atol=2e-5)
    raw = read("kitti-raw", tmp_path, deskew=False)[0]
    np.testing.assert_allclose(raw.cloud.xyz, measured.xyz[rows], atol=2e-5)
    assert np.abs(raw.cloud.xyz - again.cloud.xyz).max() > 0.3


def test_a_moving_lidar_that_turns_the_other_way_does_not_fit_kitti(tmp_path: Path) -> None:
    frame = moving(np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]))
    other = replace(frame, cloud=replace(frame.cloud, time_s=-frame.cloud.time_s))
    with pytest.raises(InputError, match="rotates clockwise"):
        written("kitti-raw", tmp_path, other)


def test_kitti_sweeps_come_ring_by_ring_from_the_top_whatever_order_the_sensor_has(tmp_path: Path) -> None:
    frame = staged()
    shuffled = frame.cloud.select(np.random.default_rng(0).permutation(len(frame.cloud)))
    upwards = replace(shuffled, ring=63 - shuffled.ring)
    for name, cloud in (("a", frame.cloud), ("b", upwards)):
        written("kitti-raw", tmp_path / name, replace(frame, cloud=cloud))
    first, second = (next((tmp_path / name).rglob("*.bin")).read_bytes() for name in "ab")
    assert first == second
    x, y, z, _ = np.frombuffer(first, "<f4").reshape(-1, 4).T.astype(float)
    turn = np.mod(np.arctan2(y, x), 2 * np.pi)
    starts = np.append(0, np.flatnonzero(np.diff(turn) < -np.pi) + 1)
    assert len(starts) == 64
    assert (np.diff(turn)[np.setdiff1d(np.arange(len(turn) - 1), starts[1:] - 1)] >= 0).all()
    slope = [np.mean(part) for part in np.split(z / np.hypot(x, y), starts[1:])]
    assert (np.diff(slope) < 0).all()


def test_another_rig_is_another_day_and_another_drive_a_drive(tmp_path: Path) -> None:
    frame = staged()
    drift = replace(frame, camera_from_lidar=START)
    frames = [replace(f, name=n) for f, n in ((frame, "a/0"), (frame, "a/1"), (frame, "b/0"), (drift, "b/1"))]
    names = written("kitti-raw", tmp_path, *frames)
    assert names == [
        "2026_01_01/0001/0000000000",
        "2026_01_01/0001/0000000001",
        "2026_01_01/0002/0000000000",
        "2026_01_02/0001/0000000000",
    ]
    back = read("kitti-raw", tmp_path)
    assert list(back.names) == names
    for again, own in zip(back, frames, strict=True):
        np.testing.assert_allclose(again.camera_from_lidar, own.camera_from_lidar, atol=1e-12)


@pytest.mark.parametrize(
    ("layout", "change", "text"),
    [
        ("kitti-raw", {"camera_from_lidar": None}, "needs the ground truth"),
        ("kitti-raw", {"cloud": Cloud(stage.frame().cloud.xyz)}, "needs a ring for every point"),
        ("kitti-raw", {"cloud": stage.frame().cloud.select(stage.frame().cloud.ring < 16)}, "32 to 64 rings"),
        (
            "kitti-raw",
            {"image": Image(stage.frame().image.rgb, Camera("SIMPLE_RADIAL", 480, 240, (286, 240, 119, 0.1)))},
            "needs a pinhole camera",
        ),
        ("vkitti2", {"image": Image(stage.frame().image.rgb, stage.camera())}, "needs depth"),
    ],
)
def test_frames_that_a_layout_cannot_hold_are_refused_with_the_one_that_can(
    tmp_path: Path, layout: str, change: dict[str, Any], text: str
) -> None:
    with pytest.raises(InputError, match=text) as caught:
        written(layout, tmp_path, replace(staged(), **change))
    assert "folder" in str(caught.value)


def test_an_interrupted_frame_is_left_out_by_every_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for layout, last in (("kitti-raw", ".bin"), ("vkitti2", "clone/frames/depth"), ("folder", ".yaml")):
        root = tmp_path / layout
        module = WRITERS[layout]
        seen: list[Path] = []

        def stopping(path: Path, data: Any, last: str = last, seen: list[Path] = seen) -> None:
            if last in path.as_posix():
                seen.append(path)
            if len(seen) == 2:
                raise KeyboardInterrupt
            write_file(path, data)

        monkeypatch.setattr(module, "write_file", stopping)
        with pytest.raises(KeyboardInterrupt):
            written(layout, root, replace(staged(), name="first"), replace(staged(), name="second"))
        assert len(read(layout, root)) == 1


@pytest.mark.parametrize("layout", list(WRITERS))
def test_the_command_writes_what_the_synthetic_dataset_shows(
    tmp_path: Path, layout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "made"
    lidar = "hdl-64e" if layout == "kitti-raw" else "vlp-16"
    words = ["--layout", layout, *SMALL, "--set", "scenes=2", "--set", f"lidar={lidar}", "--seed", "4"]
    assert main(["simulate", str(out), *words]) == 0
    said = capsys.readouterr()
    back = read(layout, out)
    assert said.out.splitlines() == list(back.names)
    assert "2 frames written" in said.err
    shown = open_dataset(f"synthetic:?width_px=160&height_px=64&lidar={lidar}&scenes=2&seed=4", Registry.load())
    for again, frame in zip(back, shown, strict=True):
        np.testing.assert_array_equal(again.image.rgb, frame.image.rgb)
        np.testing.assert_array_equal(again.image.right, frame.image.right)
        if layout == "vkitti2":
            continue
        np.testing.assert_allclose(again.camera_from_lidar, frame.camera_from_lidar, atol=1e-6)
        assert len(again.cloud) == len(frame.cloud)
        # Frames of `synthetic` come as KITTI writes them, and move: each is twisted for the file and corrected again.
        np.testing.assert_allclose(again.cloud.xyz, frame.cloud.xyz, atol=1e-4)
        np.testing.assert_array_equal(again.cloud.ring, np.unique(frame.cloud.ring, return_inverse=True)[1])
        np.testing.assert_allclose(again.cloud.time_s, frame.cloud.time_s, atol=1e-5)
        if layout == "kitti-raw":
            np.testing.assert_allclose(again.twist, frame.twist, atol=1e-9)
        else:
            np.testing.assert_allclose(again.start, frame.start, atol=1e-9)


def test_a_folder_in_use_is_left_alone_unless_forced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    words = ["simulate", str(tmp_path), "--layout", "folder", *SMALL]
    assert main(words) == 2
    assert "not empty" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
    assert main([*words, "--force"]) == 0
    assert (tmp_path / "mine.txt").read_text() == "keep"
    assert len(read("folder", tmp_path)) == 1


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--layout", "kitti-raw", "--set", "colour=red"], "unknown data option 'colour'"),
        (["--layout", "kitti-raw", "--set", "scenes=0"], "scenes is out of bounds"),
        (["--layout", "kitti-raw", "--set", "scenes"], "FIELD=VALUE"),
        (["--layout", "kitti-raw", "--set", "deskew=false"], "always written raw"),
        (["--layout", "nuscenes"], "kitti-raw"),
        ([], "--layout"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_written(
    tmp_path: Path, words: list[str], text: str, refused: Callable[..., str]
) -> None:
    assert text in refused(["simulate", str(tmp_path / "out"), *words])
    assert not (tmp_path / "out").exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        error = refused(["simulate", str(out), "--layout", "folder", *SMALL])
        assert "cannot write the data set" in error
        assert str(tmp_path / "file") in error
