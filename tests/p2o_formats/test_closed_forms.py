"""What files say, by numbers known from elsewhere: directions, orders of quaternions, half pixels, other readers."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from p2o import Camera, se3
from p2o.calibration_files.calibration import Calibration
from p2o_formats.formats import FORMATS

from tests.p2o_formats.calibrations import KITTI_LIKE, PINHOLE, written

AHEAD = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, 0, -0.3])
"""camera_from_lidar of a camera 0.3 m ahead of the LiDAR that looks along its x axis."""
TURNED = se3.make([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""camera_from_lidar of a frame that is turned by +90 deg about z in the LiDAR's."""


def _words(command: str) -> dict[str, str]:
    words = shlex.split(command, comments=True)
    assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    return dict(zip(words[4::2], words[5::2], strict=True))


def _numbers(said: dict[str, str], *keys: str) -> list[float]:
    return [float(said[f"--{key}"]) for key in keys]


def test_the_static_transform_is_parent_from_child() -> None:
    """A camera 0.3 m ahead is a child at x = +0.3 of the LiDAR, turned as an optical frame is; a body is not."""
    said = _words(written("ros2", Calibration(None, AHEAD)))
    assert _numbers(said, "x", "y", "z") == [0.3, 0, 0]
    np.testing.assert_allclose(_numbers(said, "qx", "qy", "qz", "qw"), [-0.5, 0.5, -0.5, 0.5], atol=1e-15)
    assert said["--frame-id"] == "lidar"
    assert said["--child-frame-id"] == "camera_optical_frame"
    said = _words(written("ros2", Calibration(None, AHEAD), camera_frame="camera_link"))
    np.testing.assert_allclose(_numbers(said, "qx", "qy", "qz", "qw"), [0, 0, 0, 1], atol=1e-15)


def test_known_rotations_have_their_known_quaternions() -> None:
    identity = _words(written("ros2", Calibration(None, np.eye(4))))
    assert _numbers(identity, "qx", "qy", "qz", "qw") == [0, 0, 0, 1]
    half = math.sqrt(0.5)
    turned = _words(written("ros2", Calibration(None, TURNED)))
    np.testing.assert_allclose(_numbers(turned, "qx", "qy", "qz", "qw"), [0, 0, half, half], atol=1e-15)
    inverse = _words(written("ros2", Calibration(None, TURNED), parent="camera"))
    np.testing.assert_allclose(_numbers(inverse, "qx", "qy", "qz", "qw"), [0, 0, -half, half], atol=1e-15)
    assert inverse["--frame-id"] == "camera_optical_frame"


def test_the_launch_file_is_python_with_the_arguments_of_the_command() -> None:
    text = written("ros2", Calibration(None, KITTI_LIKE), form="launch")
    compile(text, "launch.py", "exec")
    command = _words(written("ros2", Calibration(None, KITTI_LIKE)))
    for key, value in command.items():
        assert f'"{key}", "{value}"' in text


def test_ros_1_gets_position_quaternion_parent_and_child_in_this_order() -> None:
    """A camera 0.3 m ahead is a child of the LiDAR: lidar_from_camera."""
    [node] = ElementTree.fromstring(written("ros2", Calibration(None, AHEAD), form="ros1-launch")).findall("node")
    assert (node.get("pkg"), node.get("type")) == ("tf2_ros", "static_transform_publisher")
    words = shlex.split(written("ros2", Calibration(None, AHEAD), form="ros1-command"), comments=True)
    assert words[:3] == ["rosrun", "tf2_ros", "static_transform_publisher"]
    assert node.get("args", "").split() == words[3:]
    np.testing.assert_allclose([float(word) for word in words[3:10]], [0.3, 0, 0, -0.5, 0.5, -0.5, 0.5], atol=1e-15)
    assert words[10:] == ["lidar", "camera_optical_frame"]


def test_the_joint_of_urdf_has_the_angles_of_an_optical_frame() -> None:
    joint = ElementTree.fromstring(written("ros2", Calibration(None, AHEAD), form="urdf")).find("joint")
    origin, parent = joint.find("origin"), joint.find("parent")
    assert parent.get("link") == "lidar"
    np.testing.assert_allclose(np.array(origin.get("xyz", "").split(), float), [0.3, 0, 0], atol=1e-15)
    np.testing.assert_allclose(np.array(origin.get("rpy", "").split(), float), [-math.pi / 2, 0, -math.pi / 2])


def test_koide_holds_the_inverse() -> None:
    results = json.loads(written("koide", Calibration(PINHOLE, AHEAD)))["results"]
    np.testing.assert_allclose(results["T_lidar_camera"], [0.3, 0, 0, -0.5, 0.5, -0.5, 0.5], atol=1e-15)


def test_autoware_holds_body_frames_on_the_kit() -> None:
    """A camera that looks ahead of a LiDAR which stands straight on the kit has no angles."""
    tree = yaml.safe_load(written("autoware", Calibration(None, AHEAD), base_from_lidar=(0, 0, 1.5, 0, 0, 0)))
    camera = tree["sensor_kit_base_link"]["camera0/camera_link"]
    np.testing.assert_allclose([camera[key] for key in ("x", "y", "z")], [0.3, 0, 1.5], atol=1e-12)
    np.testing.assert_allclose([camera[key] for key in ("roll", "pitch", "yaw")], 0, atol=1e-12)


def test_autoware_tells_a_turn_to_the_left_as_positive_yaw() -> None:
    left = AHEAD @ se3.inverse(se3.exp(np.array([0, 0, np.radians(30), 0, 0, 0])))
    tree = yaml.safe_load(written("autoware", Calibration(None, left)))
    assert tree["sensor_kit_base_link"]["camera0/camera_link"]["yaw"] == pytest.approx(np.radians(30))


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("opencalib", lambda t: t["top_center_lidar-to-center_camera-extrinsic"]["param"]["sensor_calib"]["data"]),
        ("kalibr", lambda t: t["cam0"]["T_cam_lidar"]),
        ("text", lambda t: t["camera_from_lidar"]["matrix"]),
    ],
)
def test_matrices_that_take_points_of_the_lidar_to_the_camera(name: str, found) -> None:
    tree = yaml.safe_load(written(name, Calibration(PINHOLE, KITTI_LIKE)))
    np.testing.assert_array_equal(found(tree), KITTI_LIKE)


def test_the_text_tells_both_directions_in_three_forms() -> None:
    tree = yaml.safe_load(written("text", Calibration(PINHOLE, AHEAD)))
    assert tree["lidar_from_camera"]["translation_m"] == [0.3, 0, 0]
    np.testing.assert_allclose(tree["lidar_from_camera"]["rotation_xyzw"], [-0.5, 0.5, -0.5, 0.5])
    np.testing.assert_allclose(tree["lidar_from_camera"]["rpy_deg"], [-90, 0, -90], atol=1e-12)


def test_colmap_puts_principal_points_half_a_pixel_further() -> None:
    text = written("colmap-cameras", Calibration(PINHOLE))
    assert text.splitlines()[-1] == "1 PINHOLE 640 240 700.0 701.0 320.75 120.25"
    camera = json.loads(written("colmap", Calibration(PINHOLE, TURNED)))[0]["cameras"][1]
    assert camera["camera_params"] == [700.0, 701.0, 320.75, 120.25]
    half = math.sqrt(0.5)  # w first
    np.testing.assert_allclose(camera["cam_from_rig_rotation"], [half, 0, 0, -half], atol=1e-15)


def test_pycolmap_reads_the_cameras(tmp_path: Path) -> None:
    import pycolmap

    camera = Camera("OPENCV", 640, 240, (700.0, 701.0, 320.25, 119.75, -0.1, 0.01, 1e-12, -2e-17))
    (tmp_path / "cameras.txt").write_text(written("colmap-cameras", Calibration(camera)))
    for name in ("images.txt", "points3D.txt", "rigs.txt", "frames.txt"):
        (tmp_path / name).write_text("")
    scene = pycolmap.Reconstruction()
    scene.read_text(tmp_path)
    theirs = scene.cameras[1]
    ours = camera.project(np.array([[0.1, 0.2, 1.0]]))
    np.testing.assert_allclose(theirs.img_from_cam(np.array([[0.1, 0.2, 1.0]])), ours + 0.5, atol=1e-9)


def test_opencv_reads_its_yaml(tmp_path: Path) -> None:
    import cv2

    camera = Camera("FULL_OPENCV", 640, 240, (700.0, 701.0, 320.25, 119.75, -0.1, 1e-17, 1e-3, 2e-3, 3e-3, 0.1, 0, 0))
    path = tmp_path / "camera.yaml"
    path.write_text(written("opencv", Calibration(camera, KITTI_LIKE)))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_from_lidar").mat(), KITTI_LIKE)
    assert storage.getNode("image_width").real() == 640
    matrix, d = (storage.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients"))
    uv, _ = cv2.projectPoints(np.array([[[0.1, 0.2, 1.0]]]), np.zeros(3), np.zeros(3), matrix, d)
    np.testing.assert_allclose(uv[0], camera.project(np.array([[0.1, 0.2, 1.0]])), atol=1e-9)


def test_yaml_readers_see_numbers_however_small() -> None:
    pose = se3.exp(np.array([1e-17, 0, 0, 1e-300, 2, 3]))
    rows = yaml.safe_load(written("kalibr", Calibration(PINHOLE, pose)))["cam0"]["T_cam_lidar"]
    assert all(isinstance(value, float) for row in rows for value in row)


@pytest.mark.parametrize("name", [name for name, form in FORMATS.items() if form.write and "extrinsic" in form.holds])
def test_every_text_says_its_direction(name: str) -> None:
    if name in ("npy", "kitti"):
        return  # No room for it; docs/how-to/export.md says so.
    text = written(name, Calibration(PINHOLE, KITTI_LIKE))
    assert any(word in text for word in ("aps points of", "T_cam_lidar", "from child", "direction"))
    assert any(word in text.lower() for word in ("metres", "; m,"))
