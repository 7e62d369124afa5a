"""Static transforms as robots store them: URDF, launch files, commands, and output of ROS tools.

Unless a test states another pose, the camera is at (0.27, 0.06, -0.08) m in the LiDAR frame and looks along its x axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from p2o import se3

from tests.p2o_datasets.opened import refused
from tests.p2o_formats.calibrations import read_text, sample

AHEAD = se3.inverse(se3.make([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.27, 0.06, -0.08]))
Q = "-0.5 0.5 -0.5 0.5"


def urdf(*joints: tuple[str, str, str, str], kind: str = "fixed") -> str:
    """Return a robot of joints (parent, child, xyz, rpy)."""
    parts = [
        f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>'
        for parent, child, xyz, rpy in joints
    ]
    return f'<?xml version="1.0"?><robot name="rover">{"".join(parts)}</robot>'


def message(parent: str, child: str, xyz: str, xyzw: str, stamp: str = "{sec: 0, nanosec: 0}") -> str:
    (x, y, z), (qx, qy, qz, qw) = xyz.split(), xyzw.split()
    return (
        f"- header:\n    stamp: {stamp}\n    frame_id: {parent}\n  child_frame_id: {child}\n  transform:\n"
        f"    translation:\n      x: {x}\n      y: {y}\n      z: {z}\n"
        f"    rotation:\n      x: {qx}\n      y: {qy}\n      z: {qz}\n      w: {qw}\n"
    )


ROVER = (
    ("base_link", "velodyne", "0 0 1.8", "0 0 0"),
    ("base_link", "camera_link", "0.27 0.06 1.72", "0 0 0"),
    ("camera_link", "camera_optical_frame", "0 0 0", "-1.5707963267948966 0 -1.5707963267948966"),
)
XACRO = sample("robot.xacro")
MACRO = XACRO.replace(
    '<joint name="a"', '<xacro:macro name="sensor" params="*origin height:=2"><joint name="a"'
).replace('<origin xyz="0 0 ${height}"/></joint>', '<xacro:insert_block name="origin"/></joint></xacro:macro>')
LAUNCH = sample("ros1.launch")
LAUNCH_2 = sample("ros2.launch")
LAUNCH_YAML = sample("launch.yaml")
LAUNCH_PY = sample("launch_py.txt")
SHELL = sample("publishers.sh")
ECHO_STATIC = (
    "transforms:\n"
    + message("base_link", "os_lidar", "0 0 1.8", "0 0 0 1")
    + message("base_link", "imu_link", "5 5 5", "0 0 0 1")
    + "---\ntransforms:\n"
    + message('"base_link"', '"cam0"', "0.27 0.06 1.72", "0 0 0 1", "\n      secs: 0\n      nsecs: 1")
    + "---\ntransforms:\n"
    + message("cam0", "cam0_optical", "0 0 0", Q)
    + message("base_link", "os_lidar", "0 0 1.8", "0 0 0 1")
    + "---\n"
)
ECHO_1 = sample("tf_echo.txt")
ECHO_2 = sample("tf2_echo.txt")


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        (urdf(*ROVER), ("velodyne", "camera_optical_frame")),
        (urdf(*ROVER[:2]), ("velodyne", "camera_link")),
        (urdf(*ROVER, ("base_link", "imu_link", "0 0 0", "0 0 0")), ("velodyne", "camera_optical_frame")),
        (urdf(*ROVER, ("camera_link", "camera_imu_optical_frame", "1 1 1", "0 0 0")), ROVER[0][1:2] + ROVER[2][1:2]),
        (XACRO, ("hesai_lidar", "front_camera_optical")),
        (LAUNCH, ("rslidar", "camera_link")),
        (LAUNCH_2, ("livox_frame", "cam0")),
        (LAUNCH_YAML, ("pandar", "left_camera_optical")),
        (LAUNCH_PY, ("os_sensor", "camera_color_optical_frame")),
        (SHELL, ("velodyne", "left_camera_optical")),
        (f"rosrun tf static_transform_publisher 0.27 0.06 -0.08 {Q} os1_lidar cam 100", ("os1_lidar", "cam")),
        (ECHO_STATIC, ("os_lidar", "cam0_optical")),
        (f"$ rosrun tf tf_echo velodyne camera_optical\n{ECHO_1}{ECHO_1}", ("velodyne", "camera_optical")),
        (f"$ ros2 run tf2_ros tf2_echo livox_frame cam0\n{ECHO_2}", ("livox_frame", "cam0")),
        (f'[INFO] [1.2] [tf2_echo]: Waiting for transform pandar ->  cam0: Invalid\n{ECHO_2}', ("pandar", "cam0")),
    ],
)  # fmt: skip
def test_the_chain_of_a_robot_is_composed(text: str, frames: tuple[str, str]) -> None:
    found = read_text(text)
    np.testing.assert_allclose(found.extrinsic(), AHEAD, atol=1e-6)
    assert (found.lidar_frame, found.camera_frame) == frames
    assert any("axes of frame" in remark for remark in found.remarks) == ("optical" not in frames[1])


@pytest.mark.parametrize(
    "text",
    [
        "$ ros2 topic echo /tf_static\nWARNING: a: b\n" + ECHO_STATIC,
        LAUNCH_PY.replace("HEIGHT = 1.8", r"NAME, HEIGHT = '\d', 9 / 5"),
        LAUNCH_PY.replace(
            "LaunchConfiguration('camera')", "LaunchConfiguration('cam', default='cam_optical').perform(c)"
        ),
        'Node(executable="static_transform_publisher", arguments=["--x", "0.27", "--y=0.06", "--z", "-0.08", '
        '"--frame-id=rslidar", "--child-frame-id", "camera_link"],  # not closed',
        '<launch>\n<node pkg="tf2_ros" type="static_transform_publisher" name="link1" '
        f'args="0.27 0.06 -0.08 {Q} velodyne camera_optical_frame" />\n</launch>',
        '<node pkg="tf" type="static_transform_publisher" args="0.27 0.06 -0.08 0 0 0 velodyne camera_link 9"/>',
        '<launch><executable cmd="ros2 run tf2_ros static_transform_publisher --x 0.27 --y 0.06 --z -0.08 '
        '--frame-id velodyne --child-frame-id camera_link"/></launch>',
        message("os_sensor", "cam0", "0.27 0.06 -0.08", Q)[2:].replace("\n  ", "\n"),
        # Apollo sorts the keys.
        "child_frame_id: cam0\nheader: {frame_id: os_sensor}\ntransform: {rotation: {w: 0.5, x: -0.5, y: 0.5, z: -0.5},"
        " translation: {x: 0.27, y: 0.06, z: -0.08}}\n",
        # A property has the value that was set last, and branches whose condition is false do not exist.
        XACRO.replace('<joint name="b"', '<xacro:property name="height" value="${height + 1}"/><joint name="b"')
        .replace("height - 0.08", "height - 1.08"),
        XACRO.replace('<joint name="a"', '<xacro:if value="$(arg sim)"><joint name="x" type="fixed"><parent link='
                      '"base_link"/><child link="hesai_lidar"/></joint></xacro:if><joint name="a"')
        .replace("<xacro:property", '<xacro:arg name="sim" default="false"/><xacro:property', 1),
        urdf(("velodyne", "cam0", "0.27 0.06 -0.08", "")).replace('rpy=""', f'quat_xyzw="{Q}"'),
        # The arguments of included files are their own.
        LAUNCH.replace("<arg", '<include file="a.launch"><arg name="z" value="9"/></include><arg', 1),
        LAUNCH.replace("$(arg z) 0 0 0", "$(eval -0.16/2) 0 0 0"),
        LAUNCH_YAML.replace("arg: {name: parent, default: pandar}", 'let: {name: parent, value: "pandar"}'),
        LAUNCH_PY.replace("HEIGHT = 1.8", "HEIGHT: float = 1.8").replace("=OPTICAL +", "=[*OPTICAL] +"),
        LAUNCH_PY.replace("        DeclareL", "        Node(executable='static_transform_publisher', condition="
                          "IfCondition('false'), arguments='9 0 0 0 0 0 base_link os_sensor'.split()), DeclareL"),
    ],
)  # fmt: skip
def test_parts_of_files_and_of_shells_are_read(text: str) -> None:
    np.testing.assert_allclose(read_text(text).extrinsic(), AHEAD, atol=1e-6)


def test_a_condition_that_is_not_known_is_stated() -> None:
    for text in (
        LAUNCH.replace('<group ns="robot">', '<group ns="robot" if="$(arg real)">'),
        LAUNCH_PY.replace("Node(arguments=", "Node(condition=IfCondition(real), arguments="),
    ):
        found = read_text(text)
        np.testing.assert_allclose(found.extrinsic(), AHEAD, atol=1e-6)
        assert any("camera_link" in text and "condition is unknown" in text for text in found.remarks)


def test_the_angles_of_ros_1_are_yaw_pitch_roll() -> None:
    text = (
        "rosrun tf static_transform_publisher 0 0 0 -1.570796327 0 -1.570796327 rotated_stereo_camera stereo_camera 9\n"
        "rosrun tf static_transform_publisher 0.27 0.06 -0.08 0.01 0.02 -0.03 velodyne rotated_stereo_camera 100\n"
    )
    yaw, pitch, roll = 0.01, 0.02, -0.03
    cosine, sine = np.cos, np.sin
    rz = [[cosine(yaw), -sine(yaw), 0], [sine(yaw), cosine(yaw), 0], [0, 0, 1]]
    ry = [[cosine(pitch), 0, sine(pitch)], [0, 1, 0], [-sine(pitch), 0, cosine(pitch)]]
    rx = [[1, 0, 0], [0, cosine(roll), -sine(roll)], [0, sine(roll), cosine(roll)]]
    lidar_from_body = se3.make(np.array(rz) @ ry @ rx, [0.27, 0.06, -0.08])
    found = read_text(text)
    optical = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    np.testing.assert_allclose(found.extrinsic(), optical @ se3.inverse(lidar_from_body), atol=1e-9)
    assert found.camera_frame == "stereo_camera"


def test_the_axes_of_a_link_are_those_of_a_body_unless_stated() -> None:
    text = urdf(("velodyne", "camera_link", "0.27 0.06 -0.08", "-1.5707963267948966 0 -1.5707963267948966"))
    assert "x forward" in read_text(text).remarks[0]
    assert "camera_axes=optical" in read_text(text).remarks[0]
    found = read_text(text, camera_axes="optical")
    np.testing.assert_allclose(found.extrinsic(), AHEAD, atol=1e-9)
    assert found.remarks == ()
    text = urdf(("velodyne", "cam0", "0.27 0.06 -0.08", "0 0 0"))
    np.testing.assert_allclose(read_text(text, camera_axes="body").extrinsic(), AHEAD, atol=1e-9)


@pytest.mark.parametrize("text", [ECHO_1, ECHO_2])
def test_output_without_frames_needs_their_names_or_a_direction(text: str) -> None:
    with refused(r"does not name its frames.*lidar_frame=NAME&camera_frame=NAME.*tf2_echo LIDAR"):
        read_text(text)
    found = read_text(text, lidar_frame="os_sensor", camera_frame="camera_optical")
    np.testing.assert_allclose(found.extrinsic(), AHEAD, atol=1e-6)
    assert "`tf2_echo os_sensor camera_optical`: lidar_from_camera" in found.remarks[0]
    np.testing.assert_allclose(read_text(text, direction="lidar_from_camera").extrinsic(), AHEAD, atol=1e-6)
    names = {"lidar_frame": "os_sensor", "camera_frame": "camera_optical"}
    found = read_text(text, direction="camera_from_lidar", **names)
    np.testing.assert_allclose(found.extrinsic(), se3.inverse(AHEAD), atol=1e-6)


def test_output_of_tf2_echo_is_as_exact_as_its_angles_in_degrees() -> None:
    rotation = se3.exp(np.array([0.123, -0.234, 0.345, 0, 0, 0]))
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(rotation[:3, :3]).as_quat().round(3)
    degrees = Rotation.from_matrix(rotation[:3, :3]).as_euler("xyz", degrees=True).round(3)
    text = ECHO_2.replace("-0.500, 0.500, -0.500, 0.500", ", ".join(map(str, quaternion)))
    text = text.replace("-90.000, 0.000, -90.000", ", ".join(map(str, degrees)))
    found = read_text(text, direction="camera_from_lidar")
    assert se3.angle_deg(se3.inverse(rotation) @ found.extrinsic()) < 0.002


TWO_LIDARS = (*ROVER, ("base_link", "rear_livox_frame", "-1 0 1", "0 0 3"))
TWO_CAMERAS = (*ROVER, ("base_link", "rear_camera_link", "-1 0 1", "0 0 3"))
LEFT_RIGHT = ("velodyne", "left_cam_link", "0 1 0", "0 0 0"), ("left_cam_link", "right_optical", "0 1 0", "0 0 0")
REALSENSE = (
    ROVER[0],
    ROVER[1],
    ("camera_link", "camera_color_frame", "0 0.015 0", "0 0 0"),
    ("camera_color_frame", "camera_color_optical_frame", "0 0 0", ROVER[2][3]),
    ("camera_link", "camera_depth_frame", "0 0 0", "0 0 0"),
    ("camera_depth_frame", "camera_depth_optical_frame", "0 0 0", ROVER[2][3]),
)
OUSTER = (
    ("base_link", "os_sensor", "0 0 1.8", "0 0 0"),
    ("os_sensor", "os_lidar", "0 0 0.036", "0 0 3.14159265"),
    ("os_sensor", "os_imu", "0 0 0", "0 0 0"),
    *ROVER[1:],
)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (ROVER[:1], r"no frame names denote the camera.*got base_link, velodyne.*camera_frame=NAME"),
        (ROVER[1:], r"no frame names denote the LiDAR.*base_link, camera_link, camera_optical_frame"),
        (TWO_LIDARS, r"2 frame names denote the LiDAR; expected one of rear_livox_frame, velodyne.*lidar_frame=NAME"),
        (TWO_CAMERAS, r"2 frame names denote the camera; expected one of camera_optical_frame, rear_camera_link"),
        (REALSENSE, r"2 frame names denote the camera.*camera_color_optical_frame, camera_depth_optical_frame"),
        (LEFT_RIGHT, "2 frame names denote the camera; expected one of left_cam_link, right_optical"),
        (OUSTER, r"2 frame names denote the LiDAR; expected one of os_lidar, os_sensor"),
        ((("map", "velodyne", "0 0 0", "0 0 0"), ("odom", "camera_link", "0 0 0", "0 0 0")), "no transforms connect"),
        ((*ROVER, ("map", "velodyne", "0 0 0", "0 0 0")), r"frame velodyne has several parents.*base_link, map"),
        ((*ROVER, ("base_link", "velodyne", "0 0 1.9", "0 0 0")), "velodyne to base_link and its repetition are not"),
        ((*ROVER, ("camera_optical_frame", "base_link", "0 0 0", "0 0 0")), "form a cycle.*base_link > camera_link > "),
        ((("velodyne", "cam0", "1 0 0", "0 0 0"), ("cam0", "velodyne", "-1 0 0", "0 0 0")), "form a cycle"),
    ],
)  # fmt: skip
def test_what_is_not_one_lidar_and_one_camera_in_one_tree_is_refused(joints: Any, message: str) -> None:
    with refused(message):
        read_text(urdf(*joints))


@pytest.mark.parametrize(
    ("joints", "names", "frames"),
    [
        (TWO_LIDARS, {"lidar_frame": "velodyne"}, ("velodyne", "camera_optical_frame")),
        (TWO_CAMERAS, {"camera_frame": "camera_optical_frame"}, ("velodyne", "camera_optical_frame")),
        (OUSTER, {"lidar_frame": "os_sensor"}, ("os_sensor", "camera_optical_frame")),
        # A second parent above the sensors, and frames of the world with the name of a camera (LOAM).
        (
            (*ROVER, ("map", "base_link", "1 0 0", "0 0 0"), ("camera_init", "base_link", "2 0 0", "0 0 0")),
            {},
            ("velodyne", "camera_optical_frame"),
        ),
        # The same transform twice.
        ((*ROVER, ROVER[0]), {}, ("velodyne", "camera_optical_frame")),
        # The body and the sensor of the driver's own description.
        (
            (("base_link", "velodyne_base_link", "0 0 1.5", "0 0 0"), *ROVER[1:],
             ("velodyne_base_link", "velodyne", "0 0 0.3", "0 0 0")),
            {},
            ("velodyne", "camera_optical_frame"),
        ),
        # A camera without a transform to the LiDAR.
        ((*ROVER, ("world", "rear_camera_optical", "0 0 0", "0 0 0")), {}, ("velodyne", "camera_optical_frame")),
    ],
)  # fmt: skip
def test_names_and_chains_leave_one_of_each(joints: Any, names: dict[str, str], frames: tuple[str, str]) -> None:
    found = read_text(urdf(*joints), **names)
    assert (found.lidar_frame, found.camera_frame) == frames
    np.testing.assert_allclose(found.extrinsic(), AHEAD, atol=1e-6)


def test_a_joint_that_moves_matters_only_between_the_sensors() -> None:
    wheel = urdf(("base_link", "wheel", "0 0 0", "0 0 0"), kind="continuous").partition('<robot name="rover">')[2]
    text = urdf(*ROVER).replace("</robot>", wheel)
    np.testing.assert_allclose(read_text(text).extrinsic(), AHEAD, atol=1e-6)
    text = urdf(*ROVER).replace('name="camera_link_joint" type="fixed"', 'name="camera_link_joint" type="revolute"')
    with refused(r"joint camera_link_joint between LiDAR and camera is not fixed.*tf2_echo LIDAR"):
        read_text(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUNCH.replace('default="-0.08"', ""), r"--z is not a number.*\$\(arg.z\).*no default"),
        (LAUNCH_PY.replace("str(HEIGHT)", "str(read_height())"), r"--z is not a number.*read_height"),
        (LAUNCH_PY.replace("default_value='camera_color_optical_frame'", ""), "camera_link"),
        (XACRO.replace("${height}", "${heigth}"), "expression of xacro"),
        (MACRO, "joint a is a block of a macro of xacro.*expand it first"),
        (MACRO.replace('<xacro:insert_block name="origin"/>', '<origin xyz="${height} 0 0"/>'), "expression of xacro"),
        (LAUNCH_PY.replace("def gen", "HEIGHT += 1\ndef gen"), "not a transform.*HEIGHT"),
        (LAUNCH_PY.replace("generate_launch_description()", "generate(HEIGHT)"), "not a transform.*HEIGHT"),
        ("rosrun tf static_transform_publisher 1 2 3 0 0 velodyne camera 100", r"not a transform.*x y z yaw"),
        ("rosrun tf static_transform_publisher 1 2 3 0 0 0 velodyne", "not a transform"),
        ("<launch><node/></launch><!-- static_transform_publisher -->", "not XML|no transform"),
        ("transforms:\n- child_frame_id: a\n  transform: {translation: {}, rotation: {}}", "not a TransformStamped"),
        (ECHO_STATIC.replace("x: -0.5", "x: .nan"), "rotation_xyzw"),
    ],
)  # fmt: skip
def test_what_cannot_be_evaluated_is_named(text: str, message: str) -> None:
    if "camera_link" in message:
        found = read_text(text)  # Without the optical frame, whose name is unknown.
        assert found.camera_frame == "camera_link"
        return
    with refused(message):
        read_text(text)
