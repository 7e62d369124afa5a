"""Read and write static transforms of ROS 1 and 2: commands, launch files, or a fixed joint of URDF or xacro.

Written are the arguments of tf2_ros's static_transform_publisher (Humble and later), the launch API of ROS 2, the
positional arguments of ROS 1 with a quaternion, and the joint element of URDF. A transform of ROS is parent_from_child:
it maps points of the child frame to the parent frame. URDF has no quaternions; its rpy are about fixed axes,
R = Rz(yaw) Ry(pitch) Rx(roll). `tf_sources` lists what is read.
"""

from __future__ import annotations

from typing import Literal

from p2o import Options, field, se3
from p2o.reading import Calibration, FrameName, Reading, Source, digits, quaternion_xyzw, rpy_of, spaced

from p2o_formats.format import FRAMES as FRAME_FIELDS
from p2o_formats.format import ONLY_EXTRINSIC, Format
from p2o_formats.frame_names import optical_from
from p2o_formats.frame_tree import calibration_of
from p2o_formats.tf_sources import FRAMES, POSITION, PUBLISHER, QUATERNION, edges, has_transforms


class RosOptions(Options):
    """Form of the file, and its frames."""

    form: Literal["command", "launch", "ros1-command", "ros1-launch", "urdf"] = field(
        "command",
        help="A shell command or a Python launch file, those of ROS 1 (launch file in XML), or a fixed joint for URDF "
        "and xacro.",
    )
    lidar_frame: FrameName = field("lidar", help="Name of the LiDAR's frame.")
    camera_frame: FrameName = field(
        "camera_optical_frame",
        help="Name of the camera's frame; a name that ends in _link (without optical) is a body frame, x forward.",
    )
    parent: Literal["lidar", "camera"] = field("lidar", help="Which frame is the parent.")


def write(calibration: Calibration, options: RosOptions) -> bytes:
    """Return the file with parent_from_child: lidar_from_camera if the LiDAR is the parent."""
    optical_from_camera, axes = optical_from(options.camera_frame)
    camera_from_lidar = se3.inverse(optical_from_camera) @ calibration.extrinsic()
    by_lidar = options.parent == "lidar"
    transform = se3.inverse(camera_from_lidar) if by_lidar else camera_from_lidar
    names = (options.lidar_frame, options.camera_frame)
    parent, child = names if by_lidar else names[::-1]
    rotation = "roll pitch yaw in rad about fixed axes" if options.form == "urdf" else "quaternion x y z w"
    remarks = (
        f"Static transform of ROS: {'lidar_from_camera' if by_lidar else 'camera_from_lidar'}, parent from child.",
        f"It maps points of {child} to {parent}. Metres; rotation as {rotation}.",
        f"Axes of {options.camera_frame}: {axes}. Axes of {options.lidar_frame}: those of its points.",
        *filter(None, (calibration.comment,)),
    )
    xyz = spaced(transform[:3, 3])
    values = (*xyz.split(), *map(digits, quaternion_xyzw(transform)), parent, child)
    words = [(f"--{key}", value) for key, value in zip((*POSITION, *QUATERNION, *FRAMES), values, strict=True)]
    comment = "".join(f"# {remark}\n" for remark in remarks)
    in_xml = "".join(f"  <!-- {remark} -->\n" for remark in remarks)
    if options.form == "command":
        text = comment + f"ros2 run tf2_ros {PUBLISHER} {' '.join(f'{k} {v}' for k, v in words)}\n"
    elif options.form == "launch":
        arguments = "".join(f'                    "{key}", "{value}",\n' for key, value in words)
        text = comment + _LAUNCH.format(arguments=arguments)
    elif options.form == "ros1-command":
        text = comment + f"rosrun tf2_ros {PUBLISHER} {' '.join(values)}\n"
    elif options.form == "ros1-launch":
        text = _ROS_1_LAUNCH.format(comment=in_xml, child=child.replace("/", "_"), arguments=" ".join(values))
    else:
        rpy = spaced(rpy_of(transform[:3, :3]))
        text = _URDF.format(comment=in_xml, parent=parent, child=child, xyz=xyz, rpy=rpy)
    return text.encode()


_LAUNCH = """\
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=[
{arguments}                ],
            )
        ]
    )
"""

_ROS_1_LAUNCH = """\
<launch>
{comment}  <node pkg="tf2_ros" type="static_transform_publisher" name="{child}_publisher" args="{arguments}"/>
</launch>
"""

_URDF = """\
<?xml version="1.0"?>
<robot name="camera_lidar" xmlns:xacro="http://www.ros.org/wiki/xacro">
{comment}  <link name="{child}"/>
  <joint name="{parent}_to_{child}" type="fixed">
    <parent link="{parent}"/>
    <child link="{child}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/>
  </joint>
</robot>
"""


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera_from_lidar, composed of the transforms between the frames of LiDAR and camera.

    Raises InputError unless the frames are named or their names denote one LiDAR and one camera, if they are not
    connected, and for invalid transforms.
    """
    return calibration_of(edges(source, reading), reading, source.path)


FORMAT = Format(
    name="ros2",
    summary="Static transforms of ROS: commands, launch files, URDF; reads tf2_echo and `ros2 topic echo`, too.",
    rank=10,
    holds=ONLY_EXTRINSIC,
    direction="parent from child: lidar_from_camera, or camera_from_lidar with parent=camera",
    suffix=".txt",
    options=RosOptions,
    fields=FRAME_FIELDS | {"camera_axes", "direction"},
    recognises=has_transforms,
    read=read,
    write=write,
)
