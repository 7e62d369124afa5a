from __future__ import annotations

import os
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from p2o import Box, Camera, Checkerboard, Frame, HoleBoard, InputError, Sphere, se3
from p2o.calibration_files.calibration import Calibration
from p2o.geometry.pose_text import read_extrinsic
from p2o_datasets.folder import read_frame_file
from p2o_formats.formats import FORMATS
from scipy.spatial.transform import Rotation

from tests.toolkit.frames.test_direction import street

from .kitti_files import HEIGHT, VELO_TO_CAM, WIDTH, sweep, write_image, write_sweep
from .opened import opened, refused

CAMERA = {"model": "PINHOLE", "width": WIDTH, "height": HEIGHT, "params": [50.0, 50.0, 31.0, 15.5]}
QUATERNION = Rotation.from_matrix(VELO_TO_CAM[:3, :3]).as_quat()
PLACE = VELO_TO_CAM[:3, 3].tolist()
ONES = np.ones((3, 3))
dataset = partial(opened, "folder")


def write_frame(folder: Path, scan: dict[str, Any] | None = None, **content: Any) -> Path:
    """Write a frame; `scan` are the arrays of an archive that takes the place of its sweep."""
    write_image(folder / "image.png")
    write_sweep(folder / "cloud.bin")
    if scan is not None:
        np.savez(folder / "scan.npz", **{"xyz": ONES, **scan})
        content["cloud"] = "scan.npz"
    (folder / "frame.yaml").write_text(yaml.safe_dump({"camera": CAMERA, **content}))
    return folder


def frame(folder: Path, scan: dict[str, Any] | None = None, **content: Any) -> Frame:
    return dataset(write_frame(folder, scan, **content))[0]


def ahead() -> np.ndarray:
    """Return the points of the sweep in front of the camera."""
    points = sweep()
    return points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.7]


def times(*seconds: float) -> dict[str, Any]:
    return {"time_s": np.array(seconds)}


def test_the_smallest_folder_is_an_image_a_sweep_and_a_camera(tmp_path: Path) -> None:
    pixels = write_image(write_frame(tmp_path / "mine") / "image.png", seed=3)
    found = dataset(tmp_path / "mine")
    assert found.names == ("mine",)
    assert np.array_equal(found[0].image.rgb, pixels)
    assert np.array_equal(found[0].cloud.xyz, sweep()[:, :3])
    assert found[0].camera.params == (50, 50, 31, 15.5)
    none = ("start", "camera_from_lidar", "time_s", "lidar_world_from_lidar", "camera_world_from_camera")
    assert [getattr(found[0], name) for name in none] == [None] * 5
    assert (found[0].warnings, found[0].sequence, found[0].targets) == ((), "", ())


def test_a_folder_of_folders_is_a_dataset_of_frames(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_frame(tmp_path / name)
    (tmp_path / "notes").mkdir()
    with refused(r"no frames; expected frame\.yaml in it or in its sub-folders"):
        dataset(tmp_path / "notes")
    found = dataset(tmp_path)
    assert found.names == ("a", "b")
    assert found[1].name == "b"
    with refused(r"frame 'notes' is left out; .*frame\.yaml is missing"):
        found.frame("notes")


@pytest.mark.parametrize(
    ("pose", "warning"),
    [
        (VELO_TO_CAM.tolist(), ""),
        ({"rotation_xyzw": QUATERNION.tolist(), "translation_m": PLACE}, ""),
        (
            {"rotation_xyzw": (1.004 * QUATERNION).tolist(), "translation_m": PLACE},
            "has length 1.0040 and is normalised",
        ),
        ({"lidar_from_camera": se3.inverse(VELO_TO_CAM)[:3].tolist()}, ""),
    ],
)
def test_poses_are_matrices_or_quaternions_in_both_directions(tmp_path: Path, pose: Any, warning: str) -> None:
    found = frame(tmp_path, start=pose, truth=deepcopy(pose))
    assert np.allclose(found.start, VELO_TO_CAM, atol=1e-12)
    assert np.allclose(found.camera_from_lidar, VELO_TO_CAM, atol=1e-12)
    assert [warning in text for text in found.warnings] == [True] * (2 if warning else 0)


def test_a_frame_may_say_what_the_rows_of_its_sweep_hold(tmp_path: Path) -> None:
    write_frame(tmp_path, cloud_columns=["x", "y", "z", "_", "ring"])
    rows = np.column_stack([sweep(), np.arange(len(sweep())) % 64]).astype(np.float32)
    rows.tofile(tmp_path / "cloud.bin")
    cloud = dataset(tmp_path)[0].cloud
    assert np.array_equal(cloud.xyz, rows[:, :3])
    assert np.array_equal(cloud.ring, rows[:, 4])
    assert cloud.intensity is None


def test_the_only_or_the_named_picture_is_taken_and_of_several_none(tmp_path: Path) -> None:
    folder = write_frame(tmp_path / "a")
    (folder / "image.png").rename(folder / "IMG_1.png")
    assert len(dataset(folder)[0].image.rgb) == HEIGHT
    write_image(folder / "IMG_2.png")
    with refused(r"the image is ambiguous; .*got IMG_1\.png, IMG_2\.png; name it in"):
        dataset(folder)[0]
    pixels = write_image(write_frame(tmp_path / "b", {}, image="pictures/left.bmp") / "pictures/left.bmp", seed=8)
    assert np.array_equal(dataset(tmp_path / "b")[0].image.rgb, pixels)


def test_right_picture_and_depth_come_along(tmp_path: Path) -> None:
    write_frame(tmp_path, right="right.png", baseline_m=0.3, depth="depth.npy")
    right = write_image(tmp_path / "right.png", seed=2)
    depth = np.full((HEIGHT, WIDTH), 7.0)
    depth[0, 0], depth[0, 1] = 0.0, np.inf
    np.save(tmp_path / "depth.npy", depth)
    image = dataset(tmp_path)[0].image
    assert np.array_equal(image.right, right)
    assert image.baseline_m == 0.3
    assert np.isnan(image.depth_m[0, 0])
    assert (image.depth_m[0, 1], image.depth_m[5, 5]) == (np.inf, 7.0)
    write_frame(tmp_path, depth="depth.png")
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((HEIGHT, WIDTH), 12 * 256 + 64, np.uint16))
    assert (dataset(tmp_path)[0].image.depth_m == 12.25).all()


def test_an_array_called_cloud_is_the_sweep_and_others_are_not(tmp_path: Path) -> None:
    write_frame(tmp_path, depth="depth.npy")
    (tmp_path / "cloud.bin").unlink()
    np.save(tmp_path / "depth.npy", np.full((HEIGHT, WIDTH), 9.0))
    with refused(r"there is no cloud"):
        dataset(tmp_path)[0]
    np.save(tmp_path / "cloud.npy", sweep())
    assert np.array_equal(dataset(tmp_path)[0].cloud.xyz, sweep()[:, :3])


@pytest.mark.parametrize("name", ["cloud.bin", "frame.yaml"])
def test_links_that_leave_the_folder_are_refused_and_links_inside_are_not(tmp_path: Path, name: str) -> None:
    folder = write_frame(tmp_path / "data/a")
    (folder / name).rename(folder / "inside")
    (folder / name).symlink_to(folder / "inside")
    assert len(dataset(tmp_path / "data")[0].cloud) == len(sweep())
    (folder / "inside").rename(tmp_path / "outside")
    (folder / name).unlink()
    (folder / name).symlink_to(tmp_path / "outside")
    with refused(rf"the path '{name}' leaves the folder of the data set"):
        dataset(tmp_path / "data")[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("!!python/object/apply:os.getcwd []", "the frame file contains objects, which are not supported"),
        ("camera: !!python/name:os.system ''", "the frame file contains objects, which are not supported"),
        ("camera: [1, 2", "the frame file is not YAML"),
        ("just words", "the frame file has no keys"),
        ("", "the frame file is empty"),
        ("image: a.png", "camera is missing; expected camera: model, width, .* or FILE; without a calibration, use"),
        ("camera:", r"camera is missing; .*field of view / 2\), and calibrate several .*pipeline\.camera=refine"),
        ("camera: {model: PINHOLE, width: wide, height: 3, params: [1]}", r"camera\.width is not valid; .*got wide"),
        ("camera: {width: 64, height: 32, params: [50, 50, 31]}", "a different number of parameters"),
        ("camera: {width: 64, height: 32, params: [50, 50, 31, 15]}\nstrat: 3", "unknown key 'strat'.*mean start"),
    ],
)
def test_a_wrong_frame_file_says_which_key(tmp_path: Path, text: str, message: str) -> None:
    (write_frame(tmp_path) / "frame.yaml").write_text(text)
    with refused(rf"frame\.yaml: .*{message}"):
        dataset(tmp_path)[0]


BALL = {"kind": "sphere", "radius_m": 0.25}
CUBOID = {"kind": "box", "width_m": 0.9, "height_m": 0.7, "depth_m": 0.5}
BOARD = {"kind": "checkerboard", "columns": 7, "rows": 5, "square_m": 0.1, "width_m": 1.0, "height_m": 0.8}
HOLES = {"kind": "holes", "width_m": 1.2, "height_m": 0.8, "holes": [[-0.4, 0.0, 0.1], [0.4, 0.1, 0.12]]}
STRETCHED = np.diag([1.0, 2, 1, 1]).tolist()
WORDS = "roughly x forward, z up; camera looks forward; camera 0.27 m forward, 8 cm down of lidar"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"start": np.diag([1.0, 1, -1, 1]).tolist()}, "start mirrors space"),
        *(
            ({key: path}, f"the path '{path.partition('#')[0]}' leaves the folder of the data set")
            for key, path in (
                *(("image", path) for path in ("../outside.png", "/etc/hostname", "a/../../outside.png")),
                ("camera", "../camchain.yaml#cam0"),
            )
        ),
        ({"start": STRETCHED}, "start is not orthonormal"),
        ({"start": {"rotation_xyzw": [0, 0, 0, 2], "translation_m": [0, 0, 0]}}, "of start is not a rotation"),
        ({"start": [[1, 0], [0, 1]]}, "start"),
        ({"start": "roughly ahead"}, "expected two axes of x, y, z"),
        ({"truth": WORDS}, "truth is not a pose"),
        ({"lidar_world_from_lidar": STRETCHED}, "the rotation of lidar_world_from_lidar is not orthonormal"),
        ({"camera_world_from_camera": STRETCHED}, "the rotation of camera_world_from_camera is not orthonormal"),
        ({"camera": {**CAMERA, "model": "OPENCW"}}, "unknown camera model 'OPENCW'"),
        ({"right": "image.png"}, "a rectified pair needs its right image and its baseline"),
        ({"twist": [0, 0, 0, 10, 0]}, "twist"),
        ({"sequence": 5}, "sequence is not valid"),
        ({"time_s": "noon"}, "time_s is not valid"),
        ({"time_s": float("nan")}, "time_s is not valid"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_refused_by_its_key(tmp_path: Path, content: dict[str, Any], message: str) -> None:
    with refused(rf"frame\.yaml: .*{message}"):
        frame(tmp_path, **content)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("scan", "content", "message"),
    [
        *(
            (times(0.0, 0.05, 0.1), wrong, r"frame\.yaml: .*(out of bounds|not valid|too large a number)")
            for wrong in (
                *(
                    {"twist": twist}
                    for twist in ([0, 0, 0, 1e300, 0, 0], [0, 0, 0, np.nan, 0, 0], [1e9, 0, 0, 0, 0, 0])
                ),
                {"image_time_s": 1e300},
                {"baseline_m": 1e300, "right": "image.png"},
                {"targets": [{**BOARD, "columns": 10**400}]},
                {"targets": [{**BOARD, "width_m": 1e300}]},
            )
        ),
        *((None, {"camera_name": name}, "the name of a camera") for name in ("front left", "a,b", "a\tb", "x" * 101)),
        (None, {"cloud_columns": ["x", "y", "z", "rung"]}, r"cloud\.bin: wrong cloud_columns; .*got x y z rung"),
        (None, {"twist": [0, 0, 0, 10, 0, 0]}, r"cloud\.bin: a sweep without times cannot be compensated for motion"),
        (None, {"start": "calib.json"}, "calib.json: the calibration file is missing"),
        (
            times(10.0, 10.05, 10.1),
            {"image_time_s": 12.5},
            r"frame\.yaml: image and sweep are not of the same time; .* got 2\.4 s apart",
        ),
        (
            {"time": np.array([0.0, 1e6, 2e6])},
            {"image_time_s": 1.0},
            r"scan\.npz: the unit .* is ambiguous; .*in frame\.yaml, point_times: ns",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(
    tmp_path: Path, scan: Any, content: dict[str, Any], message: str
) -> None:
    with refused(message):
        frame(tmp_path, scan, **content)


@pytest.mark.parametrize(
    ("name", "pixels", "message"),
    [
        ("image.png", np.zeros((HEIGHT + 3, WIDTH)), r"image\.png: the image size does not fit the camera"),
        ("image.png", np.zeros((HEIGHT // 2, WIDTH // 2)), r"scale fx, fy, cx, cy by 0\.5, and write the new"),
        ("depth.npy", ONES, r"depth\.npy: the depth size does not fit"),
        ("depth.npy", np.array([{}], object), r"depth\.npy: this is not an \.npy file of numbers"),
    ],
)
def test_images_and_depth_that_do_not_fit_are_refused(tmp_path: Path, name: str, pixels: Any, message: str) -> None:
    write_frame(tmp_path, **({"depth": name} if name == "depth.npy" else {}))
    cv2.imwrite(str(tmp_path / name), pixels) if name == "image.png" else np.save(tmp_path / name, pixels)
    with refused(message):
        dataset(tmp_path)[0]


@pytest.mark.parametrize("key", ["start", "truth"])
@pytest.mark.parametrize("form", ["rows", "npy"])
def test_a_pose_in_the_wrong_direction_is_refused_by_name(tmp_path: Path, key: str, form: str) -> None:
    inverse = se3.inverse(VELO_TO_CAM)
    np.save(tmp_path / "pose.npy", inverse)
    write_frame(tmp_path, **{key: "pose.npy" if form == "npy" else inverse.tolist()})
    write_sweep(tmp_path / "cloud.bin", ahead())
    with refused(rf"frame\.yaml: {key} looks like lidar_from_camera"):
        dataset(tmp_path)[0]
    stated = "pose.npy?direction=lidar_from_camera" if form == "npy" else {"lidar_from_camera": inverse.tolist()}
    write_frame(tmp_path, start=stated)
    np.testing.assert_allclose(dataset(tmp_path)[0].start, VELO_TO_CAM, atol=1e-9)


@pytest.mark.parametrize(
    ("scan", "content", "expected"),
    [
        (times(1.6e9 - 0.5, 1.6e9, 1.6e9 + 0.25), {"image_time_s": 1.6e9}, [-0.5, 0, 0.25]),
        (times(0.0, 0.05, 0.1), {"image_time_s": 0}, [0.0, 0.05, 0.1]),
        # Without a known clock, a sweep that some driver has corrected would be corrected for a guessed motion.
        (times(0.0, 0.05, 0.1), {}, None),
        (times(0.0, 0.05, 0.1), {"image_time_s": 0.05, "time_s": 900.0, "sequence": "yard"}, [-0.05, 0, 0.05]),
    ],
)
def test_times_are_relative_to_the_image(tmp_path: Path, scan: Any, content: dict[str, Any], expected: Any) -> None:
    found = frame(tmp_path, scan, **content)
    assert found.time_s == content.get("time_s")
    if expected is None:
        assert found.cloud.time_s is None
    else:
        assert np.allclose(found.cloud.time_s, expected, atol=1e-12)


def test_the_unit_of_points_and_of_their_times_is_stated_in_the_frame_file(tmp_path: Path) -> None:
    scan = {"xyz": np.full((5, 3), 1500.0), "time": np.linspace(0, 2e6, 5), "colour": np.ones(5)}
    found = frame(tmp_path, scan, image_time_s=1.0, point_times="us", cloud_scale=0.001)
    np.testing.assert_allclose(found.cloud.xyz, 1.5)
    np.testing.assert_allclose(found.cloud.time_s, np.linspace(-1, 1, 5), atol=1e-9)
    assert (found.warnings, found.unused_fields) == ((), ("colour",))


def test_a_sweep_is_corrected_by_the_velocity_that_is_given(tmp_path: Path) -> None:
    """At 10 m/s, what was seen half a second before and after at 10 m ahead is 5 m nearer and farther by now."""
    scan = {"xyz": np.array([[10.0, 0, 0]] * 3), **times(-0.5, 0.0, 0.5)}
    found = frame(tmp_path, scan, twist=[0, 0, 0, 10, 0, 0])
    assert np.allclose(found.cloud.xyz, [[5, 0, 0], [10, 0, 0], [15, 0, 0]])
    assert np.allclose(found.cloud.as_measured(), [[10, 0, 0]] * 3)
    assert np.array_equal(found.twist, [0, 0, 0, 10, 0, 0])


def test_sequence_time_poses_of_both_sensors_and_a_start_in_words_come_along(tmp_path: Path) -> None:
    lidar, camera = (se3.exp(np.array(v)) for v in ([0.1, 0, 0.2, 3, 4, 5.0], [0, 0.2, 0, -1, 0.5, 2.0]))
    quaternion = Rotation.from_matrix(camera[:3, :3]).as_quat().tolist()
    found = frame(
        tmp_path,
        start=WORDS,
        sequence="yard",
        time_s=12.5,
        lidar_world_from_lidar=lidar.tolist(),
        camera_world_from_camera={"rotation_xyzw": quaternion, "translation_m": camera[:3, 3].tolist()},
    )
    assert (found.sequence, found.time_s) == ("yard", 12.5)
    assert np.allclose(found.lidar_world_from_lidar, lidar, atol=1e-12)
    assert np.allclose(found.camera_world_from_camera, camera, atol=1e-12)
    assert found.camera_from_lidar is None
    np.testing.assert_allclose(found.start, se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27]))


def test_targets_are_boards_with_corners_or_holes_balls_and_boxes(tmp_path: Path) -> None:
    assert frame(tmp_path, targets=[BOARD, HOLES, BALL, CUBOID]).targets == (
        Checkerboard(7, 5, 0.1, 1.0, 0.8),
        HoleBoard(1.2, 0.8, ((-0.4, 0.0, 0.1), (0.4, 0.1, 0.12))),
        Sphere(0.25),
        Box(0.9, 0.7, 0.5),
    )


def without(target: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in target.items() if name != key}


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({**BOARD, "kind": "chekerboard"}, "unknown kind of target 'chekerboard'; .*did you mean checkerboard"),
        (without(BOARD, "kind"), r"targets\.0\.kind is missing; .*or sphere or box"),
        (without(BOARD, "square_m"), r"targets\.0\.square_m is missing"),
        (without(HOLES, "height_m"), r"targets\.0\.height_m is missing"),
        ({**BOARD, "width_m": 0}, r"targets\.0\.width_m is out of bounds; expected greater than 0; got 0"),
        ({**BOARD, "width_m": 0.3}, "the checkerboard is smaller than its pattern"),
        ({**BOARD, "size": 3}, r"unknown key of targets\.0 'size'; expected one of: columns, .* square_m"),
        ({**HOLES, "square_m": 3}, r"unknown key of targets\.0 'square_m'; expected one of: height_m, holes, width_m"),
        ({**BALL, "radius_m": -1}, r"targets\.0\.radius_m is out of bounds; expected greater than 0; got -1"),
        (without(CUBOID, "depth_m"), r"targets\.0\.depth_m is missing"),
        ({**HOLES, "holes": []}, r"targets\.0\.holes is out of bounds"),
        ({**HOLES, "holes": [[0, 0]]}, r"targets\.0\.holes\.0"),
        ({**HOLES, "holes": [[0, 0, -0.1]]}, "a hole board needs holes with a positive radius"),
        ({**HOLES, "holes": [[0.6, 0, 0.1]]}, "a hole extends beyond its board"),
        ("checkerboard", r"targets\.0 is not valid"),
    ],
)
def test_a_target_that_is_none_is_refused_by_its_key(tmp_path: Path, target: Any, message: str) -> None:
    with refused(rf"frame\.yaml: .*{message}|frame\.yaml: {message}"):
        frame(tmp_path, targets=[target])


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ([("yard", "", 1.0), ("yard", "", 1.0)], [1.0, "1 of frame 'a'; got 1"]),
        ([("yard", "", 1.0), ("yard", "", 0.5), ("yard", "", 1.5)], [1.0, "1 of frame 'a'; got 0.5", 1.5]),
        ([("yard", "", 5.0), ("road", "", 1.0), ("yard", "", 6.0), ("", "", 0.0)], [5.0, 1.0, 6.0, 0.0]),
        ([("yard", "", 1.0), ("yard", "", None)], [1.0, None]),
        (
            [("yard", "LEFT", 1.0), ("yard", "RIGHT", 1.0), ("yard", "LEFT", 1.1), ("yard", "RIGHT", 1.0)],
            [1.0, 1.0, 1.1, "1 of frame 'b'; got 1"],
        ),
    ],
)
def test_times_rise_from_frame_to_frame(
    tmp_path: Path, frames: list[tuple[str, str, float | None]], expected: list[Any]
) -> None:
    for name, (sequence, camera, time_s) in zip("abcd", frames, strict=False):
        write_frame(tmp_path / name, sequence=sequence, camera_name=camera, time_s=time_s)
    found = dataset(tmp_path)
    for number, value in enumerate(expected):
        if isinstance(value, str):
            name = found.names[number]
            with refused(rf"{name}/frame\.yaml: the times of sequence 'yard' do not increase .*time_s after {value}"):
                found[number]
        else:
            assert (found[number].time_s, found[number].camera_name) == (value, frames[number][1])


def test_a_damaged_frame_of_a_sequence_is_refused_when_it_is_read_and_not_before(tmp_path: Path) -> None:
    write_frame(tmp_path / "a", sequence="yard", time_s=1.0)
    write_frame(tmp_path / "b", sequence="yard", time_s=2.0, strat=3)
    found = dataset(tmp_path)
    assert found[0].time_s == 1.0
    with refused("strat"):
        found[1]


def test_folders_that_cannot_be_read_are_left_out_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        write_frame(tmp_path / name)
    listed = Path.iterdir

    def refuse(folder: Path) -> Any:
        if folder.name == "b":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", refuse)
    found = dataset(tmp_path)
    assert found.names == ("a",)
    with refused(r"frame 'b' is left out; got .*cannot be read; got Permission denied"):
        found.frame("b")
    with refused(r"b: the folder of frames cannot be read; got Permission denied"):
        dataset(tmp_path / "b")


@pytest.mark.parametrize("name", [b"new\nline", b"\x1b[31mred", b"latin-\xe9", "\u202e\u00b2".encode()])
def test_folders_may_be_called_anything(tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    write_frame(tmp_path / "plain").rename(folder)
    found = dataset(tmp_path)
    assert found.names == (folder.name,)
    assert found[0].name == folder.name
    (folder / "cloud.bin").unlink()
    with pytest.raises(InputError):
        found[0]


def test_the_poses_that_the_documentation_shows_look_ahead_along_the_lidars_x() -> None:
    text = (Path(__file__).parents[2] / "docs/datasets.md").read_text()
    entries = [yaml.safe_load(block.split("```")[0]) for block in text.split("```yaml\n")[1:]]
    starts = [entry["start"] for entry in entries if "start" in entry]
    assert len(starts) == 2
    for start in starts:
        camera_from_lidar, _ = read_extrinsic("start", start, Path("datasets.md"))
        assert np.allclose(camera_from_lidar[:3, :3], [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-12)


def test_camera_start_and_truth_may_be_calibration_files(tmp_path: Path) -> None:
    """Files of other tools lie beside the frame, or above it within the dataset; their direction is their own."""
    home = tmp_path / "yard"
    write_frame(home, camera="../camchain.yaml#cam0", start="calib.json", truth="pose.yaml")
    assert read_frame_file(home / "frame.yaml").camera == "../camchain.yaml#cam0"
    pose = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27])
    camera = Camera.pinhole(50, 50, 31, 15.5, WIDTH, HEIGHT)
    places = {"kalibr": tmp_path / "camchain.yaml", "koide": home / "calib.json", "text": home / "pose.yaml"}
    for name, path in places.items():
        path.write_bytes(FORMATS[name].written(Calibration(camera, pose)))
    [found] = dataset(tmp_path)
    assert found.camera == camera
    np.testing.assert_allclose(found.start, pose, atol=1e-12)
    np.testing.assert_allclose(found.camera_from_lidar, pose, atol=1e-12)


@pytest.mark.parametrize("form", ["entry", "file"])
def test_the_skew_of_a_camera_is_a_warning_of_the_frame(tmp_path: Path, form: str) -> None:
    camera = {"width": WIDTH, "height": HEIGHT, "K": [[50.0, 0.5, 31.0], [0, 50.0, 15.5], [0, 0, 1]]}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    found = frame(tmp_path, camera="camera.yaml" if form == "file" else camera)
    (warning,) = (text for text in found.warnings if "skew" in text)
    assert "the skew 0.5 of camera.K is neglected; its largest effect in the image is 0.1" in warning


@pytest.mark.parametrize("form", ["matrix", "quaternion", "npy", "koide"])
def test_only_quaternions_are_doubted_for_their_order(tmp_path: Path, form: str) -> None:
    """The start is upright only if the numbers of its quaternion are read as w x y z."""
    body = Rotation.from_euler("zyx", [60, 2, -3], degrees=True)
    x, y, z, w = (Rotation.from_matrix(VELO_TO_CAM[:3, :3]) * body.inv()).as_quat().tolist()
    swapped = [w, x, y, z]
    pose = se3.make(Rotation.from_quat(swapped).as_matrix(), VELO_TO_CAM[:3, 3])
    given = Calibration(Camera.pinhole(50, 50, 31, 15.5, WIDTH, HEIGHT), pose)
    start: Any = {"rotation_xyzw": swapped, "translation_m": PLACE} if form == "quaternion" else pose.tolist()
    if form in ("npy", "koide"):
        start = f"start{FORMATS[form].suffix}"
        (tmp_path / start).write_bytes(FORMATS[form].written(given))
    write_frame(tmp_path, start=start)
    np.save(tmp_path / "cloud.npy", street().xyz.astype(np.float32))
    (tmp_path / "cloud.bin").unlink()
    try:
        text = " ".join(dataset(tmp_path)[0].warnings)
    except InputError as problem:
        text = str(problem)
    assert ("w x y z" in text) == (form in ("quaternion", "koide"))
