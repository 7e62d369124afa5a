from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import pytest
import yaml
from p2o import Box, Camera, Checkerboard, HoleBoard, InputError, Sphere, UnknownNameError, se3
from p2o.calibration_files.calibration import Calibration
from p2o.frames.frame import LazyFrames
from p2o.geometry.pose_text import read_extrinsic
from p2o_datasets.folder import FolderOptions, build, read_frame_file
from p2o_formats.formats import FORMATS
from scipy.spatial.transform import Rotation

from tests.toolkit.frames.test_direction import street

from .kitti_files import HEIGHT, VELO_TO_CAM, WIDTH, sweep, write_image, write_sweep

CAMERA = {"model": "PINHOLE", "width": WIDTH, "height": HEIGHT, "params": [50.0, 50.0, 31.0, 15.5]}


def write_frame(folder: Path, **content: Any) -> Path:
    write_image(folder / "image.png")
    write_sweep(folder / "cloud.bin")
    (folder / "frame.yaml").write_text(yaml.safe_dump({"camera": CAMERA, **content}))
    return folder


def dataset(root: Path) -> LazyFrames:
    found = build(FolderOptions(root=root))
    assert isinstance(found, LazyFrames)
    return found


def test_the_smallest_folder_is_an_image_a_sweep_and_a_camera(tmp_path: Path) -> None:
    pixels = write_image(write_frame(tmp_path / "mine") / "image.png", seed=3)
    found = dataset(tmp_path / "mine")
    assert found.names == ("mine",)
    frame = found[0]
    assert np.array_equal(frame.image.rgb, pixels)
    assert np.array_equal(frame.cloud.xyz, sweep()[:, :3])
    assert frame.camera.params == (50, 50, 31, 15.5)
    assert (frame.start, frame.camera_from_lidar, frame.warnings) == (None, None, ())


def test_a_folder_of_folders_is_a_dataset_of_frames(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_frame(tmp_path / name)
    (tmp_path / "notes").mkdir()
    found = dataset(tmp_path)
    assert found.names == ("a", "b")
    assert found[1].name == "b"
    with pytest.raises(InputError, match=r"frame 'notes' is left out; .*frame\.yaml is missing"):
        found.frame("notes")


def test_poses_come_as_matrix_or_as_quaternion_and_translation(tmp_path: Path) -> None:
    quaternion = Rotation.from_matrix(VELO_TO_CAM[:3, :3]).as_quat().tolist()
    write_frame(
        tmp_path,
        start=VELO_TO_CAM.tolist(),
        truth={"rotation_xyzw": quaternion, "translation_m": VELO_TO_CAM[:3, 3].tolist()},
    )
    frame = dataset(tmp_path)[0]
    assert np.allclose(frame.start, VELO_TO_CAM, atol=1e-12)
    assert np.allclose(frame.camera_from_lidar, VELO_TO_CAM, atol=1e-12)


def test_poses_given_the_other_way_and_cameras_of_ros_are_taken(tmp_path: Path) -> None:
    quaternion = 1.004 * Rotation.from_matrix(VELO_TO_CAM[:3, :3]).as_quat()
    write_frame(
        tmp_path,
        camera={
            "width": WIDTH,
            "height": HEIGHT,
            "K": [[50.0, 0, 31.0], [0, 50.0, 15.5], [0, 0, 1]],
            "distortion_model": "plumb_bob",
            "D": [-0.01, 0.0, 0.0, 0.0, 0.0],
        },
        start={"lidar_from_camera": se3.inverse(VELO_TO_CAM)[:3].tolist()},
        truth={"rotation_xyzw": quaternion.tolist(), "translation_m": VELO_TO_CAM[:3, 3].tolist()},
    )
    frame = dataset(tmp_path)[0]
    assert (frame.camera.model, frame.camera.params) == ("OPENCV", (50, 50, 31, 15.5, -0.01, 0, 0, 0))
    assert np.allclose(frame.start, VELO_TO_CAM, atol=1e-12)
    (warning,) = frame.warnings
    assert warning.endswith("frame.yaml: the quaternion of truth has length 1.0040 and is normalised")


def test_files_may_be_named_and_have_any_kind(tmp_path: Path) -> None:
    write_frame(tmp_path, image="pictures/left.jpg", cloud="scan.npz")
    write_image(tmp_path / "pictures/left.jpg", seed=8)
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)))
    frame = dataset(tmp_path)[0]
    assert len(frame.cloud) == 3
    assert np.array_equal(frame.image.rgb, cv2.imread(str(tmp_path / "pictures/left.jpg"))[:, :, ::-1])


def test_a_frame_may_say_what_the_rows_of_its_sweep_hold(tmp_path: Path) -> None:
    write_frame(tmp_path, cloud_columns=["x", "y", "z", "_", "ring"])
    rows = np.column_stack([sweep(), np.arange(len(sweep())) % 64]).astype(np.float32)
    rows.tofile(tmp_path / "cloud.bin")
    cloud = dataset(tmp_path)[0].cloud
    assert np.array_equal(cloud.xyz, rows[:, :3])
    assert np.array_equal(cloud.ring, rows[:, 4])
    assert cloud.intensity is None
    write_frame(tmp_path, cloud_columns=["x", "y", "z", "rung"])
    with pytest.raises(InputError, match=r"cloud\.bin: wrong cloud_columns; .*got x y z rung"):
        dataset(tmp_path)[0]


def test_the_only_picture_is_taken_and_of_several_none(tmp_path: Path) -> None:
    write_frame(tmp_path)
    (tmp_path / "image.png").rename(tmp_path / "IMG_1.png")
    assert len(dataset(tmp_path)[0].image.rgb) == HEIGHT
    write_image(tmp_path / "IMG_2.png")
    with pytest.raises(InputError, match=r"the image is ambiguous; .*got IMG_1\.png, IMG_2\.png; name it in"):
        dataset(tmp_path)[0]


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
    assert image.depth_m[0, 1] == np.inf
    assert image.depth_m[5, 5] == 7.0


def test_depth_as_a_16_bit_picture_is_metres_times_256(tmp_path: Path) -> None:
    write_frame(tmp_path, depth="depth.png")
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((HEIGHT, WIDTH), 12 * 256 + 64, np.uint16))
    assert (dataset(tmp_path)[0].image.depth_m == 12.25).all()


def test_any_camera_model_is_welcome_and_an_unknown_one_named(tmp_path: Path) -> None:
    fisheye = {**CAMERA, "model": "OPENCV_FISHEYE", "params": [50, 50, 31, 15, 0.01, 0, 0, 0]}
    write_frame(tmp_path, camera=fisheye)
    assert dataset(tmp_path)[0].camera.model == "OPENCV_FISHEYE"
    write_frame(tmp_path, camera={**CAMERA, "model": "OPENCW"})
    with pytest.raises(InputError, match=r"frame\.yaml: unknown camera model 'OPENCW'"):
        dataset(tmp_path)[0]


def test_an_image_that_does_not_fit_the_camera_is_refused_by_name(tmp_path: Path) -> None:
    write_frame(tmp_path)
    write_image(tmp_path / "image.png", size=(WIDTH, HEIGHT + 3))
    with pytest.raises(InputError, match=r"image\.png: the image size does not fit the camera"):
        dataset(tmp_path)[0]


def test_an_image_of_another_size_but_the_same_shape_comes_with_the_factor(tmp_path: Path) -> None:
    write_frame(tmp_path)
    write_image(tmp_path / "image.png", size=(WIDTH // 2, HEIGHT // 2))
    with pytest.raises(InputError, match=r"if the image was resized, scale fx, fy, cx, cy by 0\.5, and write the new"):
        dataset(tmp_path)[0]


def test_an_array_called_cloud_is_the_sweep_and_others_are_not(tmp_path: Path) -> None:
    write_frame(tmp_path, depth="depth.npy")
    (tmp_path / "cloud.bin").unlink()
    np.save(tmp_path / "depth.npy", np.full((HEIGHT, WIDTH), 9.0))
    with pytest.raises(InputError, match=r"there is no cloud"):
        dataset(tmp_path)[0]
    np.save(tmp_path / "cloud.npy", sweep())
    assert np.array_equal(dataset(tmp_path)[0].cloud.xyz, sweep()[:, :3])


def test_a_depth_map_that_does_not_fit_is_refused_by_name(tmp_path: Path) -> None:
    write_frame(tmp_path, depth="depth.npy")
    np.save(tmp_path / "depth.npy", np.ones((3, 3)))
    with pytest.raises(InputError, match=r"depth\.npy: the depth size does not fit the camera"):
        dataset(tmp_path)[0]
    np.save(tmp_path / "depth.npy", np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"depth\.npy: this is not an \.npy file of numbers"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize("name", ["../outside.png", "/etc/hostname", "a/../../outside.png"])
def test_paths_that_leave_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    write_image(tmp_path / "outside.png")
    write_frame(tmp_path / "data", image=name)
    with pytest.raises(InputError, match=r"frame\.yaml: the path '.*' leaves the folder of the data set"):
        dataset(tmp_path / "data")[0]


def test_links_that_leave_the_folder_are_refused_and_links_inside_are_not(tmp_path: Path) -> None:
    write_sweep(tmp_path / "outside.bin")
    folder = write_frame(tmp_path / "data")
    (folder / "cloud.bin").rename(folder / "sweep.dat")
    (folder / "cloud.bin").symlink_to(folder / "sweep.dat")
    assert len(dataset(folder)[0].cloud) == len(sweep())
    (folder / "cloud.bin").unlink()
    (folder / "cloud.bin").symlink_to(tmp_path / "outside.bin")
    with pytest.raises(InputError, match=r"the path 'cloud\.bin' leaves the folder of the data set"):
        dataset(folder)[0]


def test_frames_may_share_a_file_of_their_dataset(tmp_path: Path) -> None:
    write_frame(tmp_path / "a", cloud="../shared.bin")
    write_sweep(tmp_path / "shared.bin")
    assert len(dataset(tmp_path)[0].cloud) == len(sweep())


@pytest.mark.parametrize("text", ["!!python/object/apply:os.getcwd []", "camera: !!python/name:os.system ''"])
def test_python_objects_in_yaml_are_refused_and_never_built(tmp_path: Path, text: str) -> None:
    write_frame(tmp_path)
    (tmp_path / "frame.yaml").write_text(text)
    with pytest.raises(InputError, match=r"frame\.yaml: the frame file contains objects, which are not supported"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("camera: [1, 2", "the frame file is not YAML"),
        ("just words", "the frame file has no keys"),
        ("", "the frame file is empty"),
        (
            "image: a.png",
            "camera is missing; expected camera: model, width, .* or FILE; without a calibration, use model",
        ),
        (
            "camera:",
            r"camera is missing; .*field of view / 2\), and calibrate several frames .*pipeline\.camera=refine",
        ),
        (
            "camera: {model: PINHOLE, width: wide, height: 3, params: [1]}",
            r"camera\.width is not valid; .*got wide",
        ),
        ("camera: {width: 64, height: 32, params: [50, 50, 31]}", "a different number of parameters"),
        (
            "camera: {width: 64, height: 32, params: [50, 50, 31, 15]}\nstrat: 3",
            "unknown key 'strat'.*mean start",
        ),
    ],
)
def test_a_wrong_frame_file_says_which_key(tmp_path: Path, text: str, message: str) -> None:
    write_frame(tmp_path)
    (tmp_path / "frame.yaml").write_text(text)
    with pytest.raises(InputError, match=rf"frame\.yaml: {message}|frame\.yaml: .*{message}"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.diag([1.0, 1, -1, 1]).tolist(), "start mirrors space"),
        (np.diag([1.0, 2, 1, 1]).tolist(), "start is not orthonormal"),
        ({"rotation_xyzw": [0, 0, 0, 2], "translation_m": [0, 0, 0]}, "the quaternion of start is not a rotation"),
        ([[1, 0], [0, 1]], "start"),
    ],
)
def test_a_start_that_is_no_pose_is_refused_by_name(tmp_path: Path, pose: Any, message: str) -> None:
    write_frame(tmp_path, start=pose)
    with pytest.raises(InputError, match=rf"frame\.yaml: .*{message}"):
        dataset(tmp_path)[0]


def test_a_start_may_be_told_in_words_and_a_truth_may_not(tmp_path: Path) -> None:
    words = "roughly x forward, z up; camera looks forward; camera 0.27 m forward, 8 cm down of lidar"
    write_frame(tmp_path, start=words)
    expected = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27])
    assert np.allclose(dataset(tmp_path)[0].start, expected)
    write_frame(tmp_path, start="roughly ahead")
    with pytest.raises(InputError, match=r"frame.yaml.*expected two axes of x, y, z"):
        dataset(tmp_path)[0]
    write_frame(tmp_path, truth=words)
    with pytest.raises(InputError, match="truth is not a pose"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize("key", ["start", "truth"])
def test_a_pose_in_the_wrong_direction_is_refused_by_name(tmp_path: Path, key: str) -> None:
    write_frame(tmp_path, **{key: se3.inverse(VELO_TO_CAM).tolist()})
    points = sweep()
    write_sweep(tmp_path / "cloud.bin", points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.7])
    with pytest.raises(InputError, match=rf"frame\.yaml: {key} looks like lidar_from_camera"):
        dataset(tmp_path)[0]


def test_a_right_picture_needs_its_baseline(tmp_path: Path) -> None:
    write_frame(tmp_path, right="image.png")
    with pytest.raises(InputError, match=r"frame\.yaml: a rectified pair needs its right image and its baseline"):
        dataset(tmp_path)[0]


def test_times_of_the_sweep_are_made_relative_to_the_image(tmp_path: Path) -> None:
    write_frame(tmp_path, cloud="scan.npz", image_time_s=1.6e9)
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=1.6e9 + np.array([-0.5, 0.0, 0.25]))
    assert np.array_equal(dataset(tmp_path)[0].cloud.time_s, [-0.5, 0, 0.25])


def test_an_image_of_another_moment_than_the_sweep_is_refused(tmp_path: Path) -> None:
    write_frame(tmp_path, cloud="scan.npz", image_time_s=12.5)
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=np.array([10.0, 10.05, 10.1]))
    with pytest.raises(InputError, match=r"frame\.yaml: image and sweep are not of the same time; .* got 2\.4 s apart"):
        dataset(tmp_path)[0]


def test_times_on_no_known_clock_are_left_out(tmp_path: Path) -> None:
    """Or a sweep that some driver has corrected already would be corrected for a motion that is guessed."""
    write_frame(tmp_path, cloud="scan.npz")
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=np.array([0.0, 0.05, 0.1]))
    assert dataset(tmp_path)[0].cloud.time_s is None
    write_frame(tmp_path, cloud="scan.npz", image_time_s=0)
    assert np.array_equal(dataset(tmp_path)[0].cloud.time_s, [0.0, 0.05, 0.1])


def test_the_unit_of_points_and_of_their_times_is_stated_in_the_frame_file(tmp_path: Path) -> None:
    xyz, times = np.full((5, 3), 1500.0), np.linspace(0, 2e6, 5)
    np.savez(tmp_path / "scan.npz", xyz=xyz, time=times, colour=times)
    write_frame(tmp_path, cloud="scan.npz", image_time_s=1.0)
    with pytest.raises(InputError, match=r"scan\.npz: the unit .* is ambiguous; .*in frame\.yaml, point_times: ns"):
        dataset(tmp_path)[0]
    write_frame(tmp_path, cloud="scan.npz", image_time_s=1.0, point_times="us", cloud_scale=0.001)
    frame = dataset(tmp_path)[0]
    np.testing.assert_allclose(frame.cloud.xyz, 1.5)
    np.testing.assert_allclose(frame.cloud.time_s, np.linspace(-1, 1, 5), atol=1e-9)
    assert (frame.warnings, frame.unused_fields) == ((), ("colour",))


def test_a_sweep_is_corrected_by_the_velocity_that_is_given(tmp_path: Path) -> None:
    """At 10 m/s, what was seen half a second before and after at 10 m ahead is 5 m nearer and farther by now."""
    write_frame(tmp_path, cloud="scan.npz", twist=[0, 0, 0, 10, 0, 0])
    np.savez(tmp_path / "scan.npz", xyz=np.array([[10.0, 0, 0]] * 3), time_s=np.array([-0.5, 0.0, 0.5]))
    frame = dataset(tmp_path)[0]
    assert np.allclose(frame.cloud.xyz, [[5, 0, 0], [10, 0, 0], [15, 0, 0]])
    assert np.allclose(frame.cloud.as_measured(), [[10, 0, 0]] * 3)
    assert np.array_equal(frame.twist, [0, 0, 0, 10, 0, 0])


def test_a_velocity_without_times_and_one_that_is_no_number_are_refused(tmp_path: Path) -> None:
    write_frame(tmp_path, twist=[0, 0, 0, 10, 0, 0])
    with pytest.raises(InputError, match=r"cloud\.bin: a sweep without times cannot be compensated for motion"):
        dataset(tmp_path)[0]
    write_frame(tmp_path, twist=[0, 0, 0, 10, 0])
    with pytest.raises(InputError, match=r"frame\.yaml: twist"):
        dataset(tmp_path)[0]
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=np.zeros(3))
    write_frame(tmp_path, cloud="scan.npz", twist=[0, 0, 0, float("nan"), 0, 0])
    with pytest.raises(InputError, match=r"frame\.yaml.*twist"):
        dataset(tmp_path)[0]


def test_a_folder_without_frames_says_what_it_should_hold(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no frames; expected frame\.yaml in it or in its sub-folders"):
        dataset(tmp_path)


BALL = {"kind": "sphere", "radius_m": 0.25}
CUBOID = {"kind": "box", "width_m": 0.9, "height_m": 0.7, "depth_m": 0.5}
BOARD = {"kind": "checkerboard", "columns": 7, "rows": 5, "square_m": 0.1, "width_m": 1.0, "height_m": 0.8}
HOLES = {"kind": "holes", "width_m": 1.2, "height_m": 0.8, "holes": [[-0.4, 0.0, 0.1], [0.4, 0.1, 0.12]]}


def test_sequence_time_and_poses_of_both_sensors_come_along(tmp_path: Path) -> None:
    lidar, camera = (se3.exp(np.array(v)) for v in ([0.1, 0, 0.2, 3, 4, 5.0], [0, 0.2, 0, -1, 0.5, 2.0]))
    quaternion = Rotation.from_matrix(camera[:3, :3]).as_quat().tolist()
    write_frame(
        tmp_path,
        sequence="yard",
        time_s=12.5,
        lidar_world_from_lidar=lidar.tolist(),
        camera_world_from_camera={"rotation_xyzw": quaternion, "translation_m": camera[:3, 3].tolist()},
    )
    frame = dataset(tmp_path)[0]
    assert (frame.sequence, frame.time_s) == ("yard", 12.5)
    assert np.allclose(frame.lidar_world_from_lidar, lidar, atol=1e-12)
    assert np.allclose(frame.camera_world_from_camera, camera, atol=1e-12)
    assert frame.camera_from_lidar is None


def test_a_frame_that_says_nothing_of_them_stands_alone(tmp_path: Path) -> None:
    frame = dataset(write_frame(tmp_path))[0]
    assert (frame.sequence, frame.time_s, frame.targets) == ("", None, ())
    assert (frame.lidar_world_from_lidar, frame.camera_world_from_camera) == (None, None)


def test_the_time_of_the_frame_and_that_of_the_image_among_the_points_are_two_things(tmp_path: Path) -> None:
    write_frame(tmp_path, cloud="scan.npz", image_time_s=0.05, time_s=900.0, sequence="yard")
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=np.array([0.0, 0.05, 0.1]))
    frame = dataset(tmp_path)[0]
    assert np.allclose(frame.cloud.time_s, [-0.05, 0, 0.05])
    assert frame.time_s == 900.0
    write_frame(tmp_path, cloud="scan.npz", image_time_s=0.05)
    assert dataset(tmp_path)[0].time_s is None


def test_targets_are_boards_with_corners_or_holes_balls_and_boxes(tmp_path: Path) -> None:
    write_frame(tmp_path, targets=[BOARD, HOLES, BALL, CUBOID])
    assert dataset(tmp_path)[0].targets == (
        Checkerboard(7, 5, 0.1, 1.0, 0.8),
        HoleBoard(1.2, 0.8, ((-0.4, 0.0, 0.1), (0.4, 0.1, 0.12))),
        Sphere(0.25),
        Box(0.9, 0.7, 0.5),
    )


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({**BOARD, "kind": "chekerboard"}, "unknown kind of target 'chekerboard'; .*did you mean checkerboard"),
        (
            {k: v for k, v in BOARD.items() if k != "kind"},
            r"targets\.0\.kind is missing; .*or sphere or box",
        ),
        ({k: v for k, v in BOARD.items() if k != "square_m"}, r"targets\.0\.square_m is missing"),
        ({k: v for k, v in HOLES.items() if k != "height_m"}, r"targets\.0\.height_m is missing"),
        ({**BOARD, "width_m": 0}, r"targets\.0\.width_m is out of bounds; expected greater than 0; got 0"),
        ({**BOARD, "width_m": 0.3}, "the checkerboard is smaller than its pattern"),
        ({**BOARD, "size": 3}, r"unknown key of targets\.0 'size'; expected one of: columns, .* square_m"),
        ({**HOLES, "square_m": 3}, r"unknown key of targets\.0 'square_m'; expected one of: height_m, holes, width_m"),
        ({**BALL, "radius_m": -1}, r"targets\.0\.radius_m is out of bounds; expected greater than 0; got -1"),
        ({k: v for k, v in CUBOID.items() if k != "depth_m"}, r"targets\.0\.depth_m is missing"),
        ({**HOLES, "holes": []}, r"targets\.0\.holes is out of bounds"),
        ({**HOLES, "holes": [[0, 0]]}, r"targets\.0\.holes\.0"),
        ({**HOLES, "holes": [[0, 0, -0.1]]}, "a hole board needs holes with a positive radius"),
        ({**HOLES, "holes": [[0.6, 0, 0.1]]}, "a hole extends beyond its board"),
        ("checkerboard", r"targets\.0 is not valid"),
    ],
)
def test_a_target_that_is_none_is_refused_by_its_key(tmp_path: Path, target: Any, message: str) -> None:
    write_frame(tmp_path, targets=[target])
    with pytest.raises(InputError, match=rf"frame\.yaml: .*{message}|frame\.yaml: {message}") as caught:
        dataset(tmp_path)[0]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["lidar_world_from_lidar", "camera_world_from_camera"])
def test_a_pose_of_a_sensor_that_is_not_rigid_is_refused_by_name(tmp_path: Path, key: str) -> None:
    write_frame(tmp_path, **{key: np.diag([1.0, 2, 1, 1]).tolist()})
    with pytest.raises(InputError, match=rf"frame\.yaml: the rotation of {key} is not orthonormal"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize(("key", "value"), [("sequence", 5), ("time_s", "noon"), ("time_s", float("nan"))])
def test_a_sequence_that_is_no_text_and_a_time_that_is_no_number_are_refused(
    tmp_path: Path, key: str, value: object
) -> None:
    write_frame(tmp_path, **{key: value})
    with pytest.raises(InputError, match=rf"frame\.yaml: {key} is not valid"):
        dataset(tmp_path)[0]


@pytest.mark.parametrize("later_s", [1.0, 0.5])
def test_frames_of_a_sequence_with_the_same_or_a_falling_time_are_refused(tmp_path: Path, later_s: float) -> None:
    write_frame(tmp_path / "a", sequence="yard", time_s=1.0)
    write_frame(tmp_path / "b", sequence="yard", time_s=later_s)
    with pytest.raises(
        InputError,
        match=rf"b/frame\.yaml: the times of sequence 'yard' do not increase .*1 of frame 'a'; got {later_s:g}",
    ):
        dataset(tmp_path)[1]


def test_times_of_several_sequences_rise_each_on_its_own_clock(tmp_path: Path) -> None:
    for name, sequence, time_s in (("a", "yard", 5.0), ("b", "road", 1.0), ("c", "yard", 6.0), ("d", "", 0.0)):
        write_frame(tmp_path / name, sequence=sequence, time_s=time_s)
    write_frame(tmp_path / "e", sequence="road")
    assert [frame.time_s for frame in dataset(tmp_path)] == [5.0, 1.0, 6.0, 0.0, None]


def test_a_damaged_frame_of_a_sequence_is_refused_when_it_is_read_and_not_before(tmp_path: Path) -> None:
    write_frame(tmp_path / "a", sequence="yard", time_s=1.0)
    write_frame(tmp_path / "b", sequence="yard", time_s=2.0, strat=3)
    found = dataset(tmp_path)
    assert found[0].time_s == 1.0
    with pytest.raises(InputError, match="strat"):
        found[1]


def test_an_unknown_kind_of_target_is_an_unknown_name(tmp_path: Path) -> None:
    write_frame(tmp_path, targets=[{**HOLES, "kind": "hole"}])
    with pytest.raises(UnknownNameError, match="one of: box, checkerboard, holes, sphere; did you mean holes"):
        dataset(tmp_path)[0]


def test_the_other_frames_of_a_sequence_with_a_falling_time_are_read(tmp_path: Path) -> None:
    for name, time_s in (("a", 1.0), ("b", 0.5), ("c", 1.5)):
        write_frame(tmp_path / name, sequence="yard", time_s=time_s)
    found = dataset(tmp_path)
    assert [found[number].time_s for number in (0, 2)] == [1.0, 1.5]
    with pytest.raises(InputError, match="do not increase"):
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
    with pytest.raises(InputError, match=r"frame 'b' is left out; got .*cannot be read; got Permission denied"):
        found.frame("b")
    with pytest.raises(InputError, match=r"b: the folder of frames cannot be read; got Permission denied"):
        dataset(tmp_path / "b")


@pytest.mark.parametrize("name", ["image.png", "cloud.bin", "frame.yaml"])
def test_a_folder_where_a_file_should_be_is_named(tmp_path: Path, name: str) -> None:
    write_frame(tmp_path)
    (tmp_path / name).unlink()
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=rf"{name}: the .* is a folder"):
        dataset(tmp_path)[0]


def test_a_frame_file_that_lies_elsewhere_is_refused(tmp_path: Path) -> None:
    write_frame(tmp_path / "data/a")
    (tmp_path / "data/a/frame.yaml").rename(tmp_path / "outside.yaml")
    (tmp_path / "data/a/frame.yaml").symlink_to(tmp_path / "outside.yaml")
    with pytest.raises(InputError, match=r"the path 'frame\.yaml' leaves the folder of the data set"):
        dataset(tmp_path / "data")[0]


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


@pytest.mark.parametrize("root", ["~nosuch", "a\0b", "x" * 300])
def test_a_root_that_no_folder_can_be_is_refused_in_one_line(root: str) -> None:
    with pytest.raises(InputError) as caught:
        dataset(Path(root))
    assert "\n" not in str(caught.value)


def test_the_poses_that_the_documentation_shows_look_ahead_along_the_lidars_x() -> None:
    text = (Path(__file__).parents[2] / "docs/datasets.md").read_text()
    entries = [yaml.safe_load(block.split("```")[0]) for block in text.split("```yaml\n")[1:]]
    starts = [entry["start"] for entry in entries if "start" in entry]
    assert len(starts) == 2
    for start in starts:
        camera_from_lidar, _ = read_extrinsic("start", start, Path("datasets.md"))
        assert np.allclose(camera_from_lidar[:3, :3], [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "wrong",
    [
        {"twist": [0, 0, 0, 1e300, 0, 0]},
        {"twist": [1e9, 0, 0, 0, 0, 0]},
        {"image_time_s": 1e300},
        {"baseline_m": 1e300, "right": "image.png"},
        {"targets": [{**BOARD, "columns": 10**400}]},
        {"targets": [{**BOARD, "width_m": 1e300}]},
    ],
)
def test_numbers_that_nothing_has_are_refused(tmp_path: Path, wrong: dict[str, Any]) -> None:
    write_frame(tmp_path, cloud="scan.npz", **wrong)
    np.savez(tmp_path / "scan.npz", xyz=np.ones((3, 3)), time_s=np.array([0.0, 0.05, 0.1]))
    with pytest.raises(InputError, match=r"frame\.yaml: .*(out of bounds|not valid|too large a number)"):
        dataset(tmp_path)[0]


def test_frames_name_their_camera_and_times_rise_from_frame_to_frame_of_one_camera(tmp_path: Path) -> None:
    for name, camera, time_s in (("a", "LEFT", 1.0), ("b", "RIGHT", 1.0), ("c", "LEFT", 1.1), ("d", "RIGHT", 1.0)):
        write_frame(tmp_path / name, sequence="yard", time_s=time_s, camera_name=camera)
    found = dataset(tmp_path)
    assert [found[number].camera_name for number in range(3)] == ["LEFT", "RIGHT", "LEFT"]
    with pytest.raises(InputError, match="do not increase from frame to frame; expected time_s after 1 of frame 'b'"):
        found[3]


@pytest.mark.parametrize("name", ["front left", "front,left", "a\tb", "x" * 101])
def test_a_name_of_a_camera_that_is_no_word_is_refused(tmp_path: Path, name: str) -> None:
    write_frame(tmp_path, camera_name=name)
    with pytest.raises(InputError, match="the name of a camera is not valid"):
        dataset(tmp_path)[0]


def test_camera_start_and_truth_may_be_calibration_files(tmp_path: Path) -> None:
    """Files of other tools lie beside the frame, or above it within the dataset; their direction is their own."""
    home = tmp_path / "yard"
    home.mkdir()
    write_frame(home, camera="../camchain.yaml#cam0", start="calib.json", truth="pose.yaml")
    entry = read_frame_file(home / "frame.yaml")
    assert entry.camera == "../camchain.yaml#cam0"
    pose = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27])
    camera = Camera.pinhole(50, 50, 31, 15.5, WIDTH, HEIGHT)
    given = Calibration(camera, pose)
    places = {"kalibr": tmp_path / "camchain.yaml", "koide": home / "calib.json", "text": home / "pose.yaml"}
    for name, path in places.items():
        path.write_bytes(FORMATS[name].written(given))
    [frame] = dataset(tmp_path)
    assert frame.camera == camera
    np.testing.assert_allclose(frame.start, pose, atol=1e-12)
    np.testing.assert_allclose(frame.camera_from_lidar, pose, atol=1e-12)


def test_a_calibration_file_that_leaves_the_dataset_is_not_read(tmp_path: Path) -> None:
    write_frame(tmp_path, camera="../camchain.yaml#cam0")
    with pytest.raises(InputError, match=r"'../camchain.yaml' leaves the folder of the data set"):
        dataset(tmp_path)[0]


def test_a_calibration_file_that_is_missing_is_named(tmp_path: Path) -> None:
    write_frame(tmp_path, start="calib.json")
    with pytest.raises(InputError, match=r"calib.json: the calibration file is missing"):
        dataset(tmp_path)[0]


def test_a_calibration_file_in_the_wrong_direction_is_noticed(tmp_path: Path) -> None:
    write_frame(tmp_path, start="pose.npy")
    np.save(tmp_path / "pose.npy", se3.inverse(VELO_TO_CAM))
    points = sweep()
    write_sweep(tmp_path / "cloud.bin", points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.7])
    with pytest.raises(InputError, match=r"frame\.yaml: start looks like lidar_from_camera"):
        dataset(tmp_path)[0]
    write_frame(tmp_path, start="pose.npy?direction=lidar_from_camera")
    np.testing.assert_allclose(dataset(tmp_path)[0].start, VELO_TO_CAM, atol=1e-9)


def test_16_bit_images_of_cameras_are_read_with_a_remark(tmp_path: Path) -> None:
    write_frame(tmp_path, start=VELO_TO_CAM.tolist())
    grey = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) * 4095 // (HEIGHT * WIDTH - 1)
    cv2.imwrite(str(tmp_path / "image.png"), grey.astype(np.uint16))
    frame = dataset(tmp_path)[0]
    assert np.array_equal(frame.image.rgb[:, :, 1], grey >> 4)
    assert "image.png: 16 bit image, divided by 16" in frame.warnings


@pytest.mark.parametrize("stored", [True, False])
def test_an_image_with_a_rotation_tag_fits_the_camera(tmp_path: Path, stored: bool) -> None:
    write_frame(tmp_path)
    pixels = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    PIL.Image.fromarray(pixels if stored else np.rot90(pixels)).save(tmp_path / "image.png", exif=exif)
    frame = dataset(tmp_path)[0]
    assert np.array_equal(frame.image.rgb, pixels)
    (remark,) = (warning for warning in frame.warnings if "EXIF" in warning)
    assert ("is ignored" if stored else "rotated by its EXIF tag") in remark


@pytest.mark.parametrize("form", ["entry", "file"])
def test_the_skew_of_a_camera_is_a_warning_of_the_frame(tmp_path: Path, form: str) -> None:
    camera = {"width": WIDTH, "height": HEIGHT, "K": [[50.0, 0.5, 31.0], [0, 50.0, 15.5], [0, 0, 1]]}
    if form == "file":
        (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    write_frame(tmp_path, camera="camera.yaml" if form == "file" else camera)
    (warning,) = (text for text in dataset(tmp_path)[0].warnings if "skew" in text)
    assert "the skew 0.5 of camera.K is neglected; its largest effect in the image is 0.1" in warning


@pytest.mark.parametrize("form", ["matrix", "quaternion", "npy", "koide"])
def test_only_quaternions_are_doubted_for_their_order(tmp_path: Path, form: str) -> None:
    """The start is upright only if the numbers of its quaternion are read as w x y z."""
    body = Rotation.from_euler("zyx", [60, 2, -3], degrees=True)
    x, y, z, w = (Rotation.from_matrix(VELO_TO_CAM[:3, :3]) * body.inv()).as_quat().tolist()
    swapped = [w, x, y, z]
    pose = se3.make(Rotation.from_quat(swapped).as_matrix(), VELO_TO_CAM[:3, 3])
    start: Any = pose.tolist()
    if form == "quaternion":
        start = {"rotation_xyzw": swapped, "translation_m": VELO_TO_CAM[:3, 3].tolist()}
    elif form in ("npy", "koide"):
        start = "start.npy" if form == "npy" else "start.json"
        given = Calibration(Camera.pinhole(50, 50, 31, 15.5, WIDTH, HEIGHT), pose)
        (tmp_path / start).write_bytes(FORMATS[form].written(given))
    write_frame(tmp_path, start=start)
    np.save(tmp_path / "cloud.npy", street().xyz.astype(np.float32))
    (tmp_path / "cloud.bin").unlink()
    try:
        text = " ".join(dataset(tmp_path)[0].warnings)
    except InputError as problem:
        text = str(problem)
    assert ("w x y z" in text) == (form in ("quaternion", "koide"))
