"""Read and write static transforms of ROS 2: a command, a Python launch file, or a fixed joint of URDF or xacro.

Sources: the arguments of tf2_ros's static_transform_publisher (Humble and later; the older positional form is read,
too), the launch API of ROS 2, and the joint element of URDF. A transform of ROS is parent_from_child: it maps points
of the child frame to the parent frame. URDF has no quaternions; its rpy are about fixed axes, R = Rz(yaw) Ry(pitch)
Rx(roll). Launch files are not executed, and XML with a DOCTYPE is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from p2o import Float, InputError, Options, field, se3
from p2o.reading import Calibration, FrameName, Reading, Source, digits, quaternion_xyzw, read_pose, rpy_of, spaced

from p2o_formats.format import ONLY_EXTRINSIC, Format
from p2o_formats.frame_names import is_camera, is_lidar, optical_from, roles

_PUBLISHER = "static_transform_publisher"
_POSITION, _QUATERNION, _ANGLES = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
_FRAMES = ("frame-id", "child-frame-id")
_WORD = re.compile(
    r"--(?P<key>child-frame-id|frame-id|roll|pitch|yaw|q[xyzw]|[xyz])(?![\w-])['\"]?[\s,=]+(?:f|str\()?"
    r"(?P<value>'[^'\n]{1,200}'|\"[^\"\n]{1,200}\"|[^\s'\",)\]]{1,200})"
)
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_POSITIONAL = re.compile(
    rf"{_PUBLISHER}['\"]?\s+(?P<numbers>{_NUMBER}(?:\s+{_NUMBER}){{5,6}})\s+(?P<parent>/?[A-Za-z_][\w./-]{{0,119}})"
    r"\s+(?P<child>/?[A-Za-z_][\w./-]{0,119})"
)
_MAX_JOINTS = 10_000


class RosOptions(Options):
    """Form of the file, and its frames."""

    form: Literal["command", "launch", "urdf"] = field(
        "command", help="A shell command, a Python launch file, or a fixed joint for URDF and xacro."
    )
    lidar_frame: FrameName = field("lidar", help="Name of the LiDAR's frame.")
    camera_frame: FrameName = field(
        "camera_optical_frame",
        help="Name of the camera's frame; a name that ends in _link (without optical) is a body frame, x forward.",
    )
    parent: Literal["lidar", "camera"] = field("lidar", help="Which frame is the parent.")


class _Edge:
    """One transform of a file: the names of both frames, and a function that returns parent_from_child (4, 4)."""

    def __init__(self, parent: str, child: str, pose: Callable[[], tuple[Float, tuple[str, ...]]]) -> None:
        self.parent, self.child, self.pose = parent.lstrip("/"), child.lstrip("/"), pose


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
        f"Static transform of ROS 2: {'lidar_from_camera' if by_lidar else 'camera_from_lidar'}, parent from child.",
        f"It maps points of {child} to {parent}. Metres; rotation as {rotation}.",
        f"Axes of {options.camera_frame}: {axes}. Axes of {options.lidar_frame}: those of its points.",
        *filter(None, (calibration.comment,)),
    )
    xyz = spaced(transform[:3, 3])
    values = (*xyz.split(), *map(digits, quaternion_xyzw(transform)), parent, child)
    words = [(f"--{key}", value) for key, value in zip((*_POSITION, *_QUATERNION, *_FRAMES), values, strict=True)]
    comment = "".join(f"# {remark}\n" for remark in remarks)
    if options.form == "command":
        text = comment + f"ros2 run tf2_ros {_PUBLISHER} {' '.join(f'{k} {v}' for k, v in words)}\n"
    elif options.form == "launch":
        arguments = "".join(f'                    "{key}", "{value}",\n' for key, value in words)
        text = comment + _LAUNCH.format(arguments=arguments)
    else:
        comment = "".join(f"  <!-- {remark} -->\n" for remark in remarks)
        rpy = spaced(rpy_of(transform[:3, :3]))
        text = _URDF.format(comment=comment, parent=parent, child=child, xyz=xyz, rpy=rpy)
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


def recognises(source: Source) -> bool:
    """Return whether the file contains the publisher's name or joints of URDF."""
    return _PUBLISHER in source.text or _is_urdf(source)


def read(source: Source, reading: Reading) -> Calibration:
    """Return the transform between the LiDAR and the camera, which the frame names identify; either may be the parent.

    Raises InputError unless exactly one transform joins the two, and for invalid transforms.
    """
    edges = list(_joints(source) if _is_urdf(source) else _publishers(source))
    edge = _between(edges, reading, source)
    by_lidar = roles(edge.parent, edge.child, reading.lidar_frame, reading.camera_frame, source.path)
    pose, remarks = edge.pose()
    lidar, camera = (edge.parent, edge.child) if by_lidar else (edge.child, edge.parent)
    optical_from_camera, axes = optical_from(camera)
    if "optical" not in camera.lower():
        remarks = (*remarks, f"{source.path}: the axes of frame {camera} are assumed to be {axes}")
    camera_from_lidar = optical_from_camera @ (se3.inverse(pose) if by_lidar else pose)
    return Calibration(None, camera_from_lidar, lidar, camera, remarks, quaternion=not _is_urdf(source))


def _between(edges: list[_Edge], reading: Reading, source: Source) -> _Edge:
    """Return the only transform between a LiDAR and a camera."""
    names = {reading.lidar_frame, reading.camera_frame} - {None}
    joining = [edge for edge in edges if names <= {edge.parent, edge.child}]
    if len(joining) > 1:
        joining = [e for e in joining if {is_lidar(e.parent), is_lidar(e.child)} == {True, False}] or joining
        joining = [e for e in joining if is_camera(e.parent) or is_camera(e.child)] or joining
    if len(joining) != 1:
        fault = f"{len(joining) or 'no'} transforms join a LiDAR and a camera"
        got = ", ".join(f"{e.parent} to {e.child}" for e in edges[:6]) or "none"
        expected, hint = "exactly one transform with both frames", "FILE?lidar_frame=NAME&camera_frame=NAME"
        raise InputError(fault, where=source.path, expected=expected, got=got, hint=f"name the frames: {hint}")
    return joining[0]


def _publishers(source: Source) -> Iterator[_Edge]:
    """Yield the transforms of a command or launch file, whose text is searched but not executed."""
    text = "\n".join(source.lines).replace("\\\n", " ")
    arguments: dict[str, str] = {}
    count = 0
    for match in _WORD.finditer(text):
        key, value = match["key"], match["value"].strip("'\"")
        if key in arguments:
            fault = f"--{key} is given twice before the frames of one transform"
            raise InputError(fault, where=source.path, expected="--frame-id and --child-frame-id for each transform")
        arguments[key] = value
        if set(_FRAMES) <= arguments.keys() and not _more_follow(text, match.end()):
            yield _edge(arguments, source)
            arguments, count = {}, count + 1
    if arguments:
        missing = [f"--{key}" for key in _FRAMES if key not in arguments]
        raise InputError("a transform has no frames", where=source.path, expected=" and ".join(missing))
    for match in _POSITIONAL.finditer(text):
        numbers = match["numbers"].split()
        # With six numbers, the angles are in the order yaw, pitch, roll.
        angles = ("yaw", "pitch", "roll") if len(numbers) == 6 else _QUATERNION
        arguments = dict(zip((*_POSITION, *angles), numbers, strict=True))
        yield _edge(arguments | dict(zip(_FRAMES, (match["parent"], match["child"]), strict=True)), source)
        count += 1
    if not count:
        raise InputError("the file has no transform", where=source.path, expected=f"{_PUBLISHER} --x ... --qw")


def _more_follow(text: str, end: int) -> bool:
    """Return whether another argument of the same transform follows, after quotes, commas and blanks only."""
    match = _WORD.search(text, end)
    return match is not None and not text[end : match.start()].strip(" \t\n'\",")


def _edge(arguments: Mapping[str, str], source: Source) -> _Edge:
    def pose() -> tuple[Float, tuple[str, ...]]:
        position = [_float(arguments.get(key, "0"), f"--{key}", source) for key in _POSITION]
        quaternion, angles = (any(key in arguments for key in keys) for keys in (_QUATERNION, _ANGLES))
        if quaternion and angles:
            raise InputError("a rotation is given twice", where=source.path, expected="a quaternion, or roll pitch yaw")
        keys, name, defaults = (_QUATERNION, "rotation_xyzw", "0001") if quaternion else (_ANGLES, "rpy_rad", "000")
        texts = [(key, arguments.get(key, default)) for key, default in zip(keys, defaults, strict=True)]
        values = [_float(text, f"--{key}", source) for key, text in texts]
        return read_pose(_PUBLISHER, {name: values, "translation_m": position}, source.path)

    return _Edge(arguments[_FRAMES[0]], arguments[_FRAMES[1]], pose)


def _float(text: str, name: str, source: Source) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{name} is not a number", where=source.path, expected="a finite number", got=repr(text)[:60])
    return value


def _is_urdf(source: Source) -> bool:
    head = source.text.lstrip()
    return head.startswith("<") and "<joint" in head


def _joints(source: Source) -> Iterator[_Edge]:
    """Yield the joints of a URDF file or snippet."""
    text = source.text.strip()
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("XML with a DOCTYPE or entities is not read", where=source.path, expected="plain URDF")
    if not re.match(r"<\?xml|<robot", text):
        # A snippet of joints and links, perhaps with xacro, has no single root element.
        text = f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>'
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as problem:
        raise InputError("this is not XML", where=source.path, expected="URDF or xacro", got=str(problem)) from problem
    joints = [element for element in root.iter() if element.tag.rpartition("}")[2] == "joint"][:_MAX_JOINTS]
    for joint in joints:
        ends = [joint.find(key) for key in ("parent", "child")]
        parent, child = ("" if end is None else end.get("link", "") for end in ends)
        if parent and child:
            yield _Edge(parent, child, lambda joint=joint: _origin(joint, source))  # type: ignore[misc]


def _origin(joint: Any, source: Source) -> tuple[Float, tuple[str, ...]]:
    name = joint.get("name", "joint")
    if joint.get("type", "fixed") != "fixed":
        raise InputError(f"joint {name} is not fixed", where=source.path, expected="fixed", got=joint.get("type"))
    origin = joint.find("origin")
    numbers = {}
    for key in ("xyz", "rpy"):
        text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
        if "${" in text:
            fault = f"{key} of joint {name} is an expression of xacro"
            hint = "expand it first: ros2 run xacro xacro FILE"
            raise InputError(fault, where=source.path, expected="numbers", got=text, hint=hint)
        numbers[key] = [_float(word, f"{key} of joint {name}", source) for word in text.split()]
    return read_pose(f"joint {name}", {"rpy_rad": numbers["rpy"], "translation_m": numbers["xyz"]}, source.path)


FORMAT = Format(
    name="ros2",
    summary="Static transform of ROS 2: a command, a launch file or a URDF joint.",
    rank=10,
    holds=ONLY_EXTRINSIC,
    direction="parent from child: lidar_from_camera, or camera_from_lidar with parent=camera",
    suffix=".txt",
    options=RosOptions,
    recognises=recognises,
    read=read,
    write=write,
)
