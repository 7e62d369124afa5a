"""Static transforms of ROS 2: the command, a Python launch file, a fixed joint of URDF or xacro.

Sources: the arguments of tf2_ros's static_transform_publisher (Humble and later; the older positional form is read
too), the launch API of ROS 2, and the joint element of URDF. A transform of ROS is parent_from_child: it takes points
of the child frame to the parent frame. URDF has no quaternions: its rpy are about fixed axes, Rz(yaw) Ry(pitch)
Rx(roll). Launch files are never run, and XML with a DOCTYPE is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.format import ONLY_EXTRINSIC, Format, Reading, both_ways, digits, plain, quaternion_xyzw, spaced
from p2o.formats.frame_names import FrameName, is_camera, is_lidar, optical_from, roles
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.pose_text import read_pose
from p2o.geometry.rpy import rpy_of
from p2o.options import Options, field

_PUBLISHER = "static_transform_publisher"
_PLACE, _QUATERNION, _ANGLES = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
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
_MOST_JOINTS = 10_000


class RosOptions(Options):
    """How a static transform is told."""

    form: Literal["command", "launch", "urdf"] = field(
        "command", help="A shell command, a Python launch file, or a fixed joint for URDF and xacro."
    )
    lidar_frame: FrameName = field("lidar", help="Name of the LiDAR's frame.")
    camera_frame: FrameName = field(
        "camera_optical_frame",
        help="Name of the camera's frame; one that ends in _link (without optical) is its body frame, x forward.",
    )
    parent: Literal["lidar", "camera"] = field("lidar", help="Which frame is the parent in the tree.")


class _Edge:
    """One transform of a file: names of both frames, and parent_from_child (4, 4) when it is asked for."""

    def __init__(self, parent: str, child: str, pose: Callable[[], tuple[Float, tuple[str, ...]]]) -> None:
        self.parent, self.child, self.pose = parent.lstrip("/"), child.lstrip("/"), pose


def write(calibration: Calibration, options: RosOptions) -> bytes:
    """Return the file; lidar_from_camera where the LiDAR is the parent, as parent_from_child."""
    optical_from_camera, axes = optical_from(options.camera_frame)
    camera_from_lidar = se3.inverse(optical_from_camera) @ calibration.extrinsic()
    by_lidar = options.parent == "lidar"
    transform = both_ways(camera_from_lidar, by_lidar)
    names = (options.lidar_frame, options.camera_frame)
    parent, child = names if by_lidar else names[::-1]
    said = (
        f"Static transform of ROS 2: {'lidar_from_camera' if by_lidar else 'camera_from_lidar'}, parent from child.",
        f"It takes points of {child} to {parent}. Metres; rotation as "
        + ("roll pitch yaw in rad about fixed axes." if options.form == "urdf" else "quaternion x y z w."),
        f"Axes of {options.camera_frame}: {axes}. Axes of {options.lidar_frame}: those of its points.",
    )
    place = [digits(value) for value in plain(transform[:3, 3])]
    words = [(f"--{key}", value) for key, value in zip(_PLACE, place, strict=True)]
    words += [(f"--{key}", digits(value)) for key, value in zip(_QUATERNION, quaternion_xyzw(transform), strict=True)]
    words += [(f"--{key}", name) for key, name in zip(_FRAMES, (parent, child), strict=True)]
    if options.form == "command":
        text = _comment(said) + f"ros2 run tf2_ros {_PUBLISHER} {' '.join(f'{k} {v}' for k, v in words)}\n"
    elif options.form == "launch":
        arguments = "".join(f'                    "{key}", "{value}",\n' for key, value in words)
        text = _comment(said) + _LAUNCH.format(arguments=arguments)
    else:
        comment = "".join(f"  <!-- {line} -->\n" for line in said)
        text = _URDF.format(
            comment=comment, parent=parent, child=child, xyz=" ".join(place), rpy=spaced(rpy_of(transform[:3, :3]))
        )
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
    """Return whether the file names the publisher, or holds joints of URDF."""
    return _PUBLISHER in source.text or _is_urdf(source)


def read(source: Source, reading: Reading) -> Calibration:
    """Return the transform between a LiDAR and a camera, whichever is the parent; told by the names of frames.

    Raises InputError where no edge joins the two, where it is not one, and for numbers that are no transform.
    """
    edges = list(_joints(source) if _is_urdf(source) else _publishers(source))
    edge = _between(edges, reading, source)
    by_lidar = roles(edge.parent, edge.child, reading.lidar_frame, reading.camera_frame, source.path)
    pose, remarks = edge.pose()
    lidar, camera = (edge.parent, edge.child) if by_lidar else (edge.child, edge.parent)
    optical_from_camera, axes = optical_from(camera)
    if "optical" not in camera.lower():
        remarks = (*remarks, f"{source.path}: frame {camera} is taken to have {axes}")
    camera_from_lidar = optical_from_camera @ (se3.inverse(pose) if by_lidar else pose)
    return Calibration(None, camera_from_lidar, lidar, camera, remarks)


def _between(edges: list[_Edge], reading: Reading, source: Source) -> _Edge:
    """Return the one edge whose frames are a LiDAR's and a camera's."""
    names = {reading.lidar_frame, reading.camera_frame} - {None}
    found = [edge for edge in edges if names <= {edge.parent, edge.child}]
    if len(found) > 1:
        found = [e for e in found if {is_lidar(e.parent), is_lidar(e.child)} == {True, False}] or found
        found = [e for e in found if is_camera(e.parent) or is_camera(e.child)] or found
    if len(found) != 1:
        raise InputError(
            f"{len(found) or 'no'} transforms join a LiDAR and a camera",
            where=source.path,
            expected="one edge of the tree with both frames",
            got=", ".join(f"{e.parent} to {e.child}" for e in edges[:6]) or "none",
            hint="say the frames: FILE?lidar_frame=NAME&camera_frame=NAME",
        )
    return found[0]


def _publishers(source: Source) -> Iterator[_Edge]:
    """Yield the transforms of a command or launch file, whose text is searched and never run."""
    text = "\n".join(source.lines).replace("\\\n", " ")
    said: dict[str, str] = {}
    found = 0
    for match in _WORD.finditer(text):
        key, value = match["key"], match["value"].strip("'\"")
        if key in said:
            raise InputError(
                f"--{key} stands twice before the frames of one transform are said",
                where=source.path,
                expected="--frame-id and --child-frame-id at each",
            )
        said[key] = value
        if set(_FRAMES) <= said.keys() and not _more_follow(text, match.end()):
            yield _edge(said, source)
            said, found = {}, found + 1
    if said:
        missing = [f"--{key}" for key in _FRAMES if key not in said]
        raise InputError("the frames of a transform are not said", where=source.path, expected=" and ".join(missing))
    for match in _POSITIONAL.finditer(text):
        numbers = match["numbers"].split()
        # Of six numbers the angles are yaw, pitch, roll, in this order.
        angles = ("yaw", "pitch", "roll") if len(numbers) == 6 else _QUATERNION
        said = dict(zip((*_PLACE, *angles), numbers, strict=True))
        yield _edge(said | dict(zip(_FRAMES, (match["parent"], match["child"]), strict=True)), source)
        found += 1
    if not found:
        raise InputError("no transform can be read from it", where=source.path, expected=f"{_PUBLISHER} --x ... --qw")


def _more_follow(text: str, end: int) -> bool:
    """Return whether another word of the same transform follows: only quotes, commas and blanks lie between."""
    match = _WORD.search(text, end)
    return match is not None and not text[end : match.start()].strip(" \t\n'\",")


def _edge(said: Mapping[str, str], source: Source) -> _Edge:
    def pose() -> tuple[Float, tuple[str, ...]]:
        place = [_float(said.get(key, "0"), f"--{key}", source) for key in _PLACE]
        quaternion, angles = (any(key in said for key in keys) for keys in (_QUATERNION, _ANGLES))
        if quaternion and angles:
            raise InputError("a rotation is told twice", where=source.path, expected="a quaternion, or roll pitch yaw")
        keys, name, defaults = (_QUATERNION, "rotation_xyzw", "0001") if quaternion else (_ANGLES, "rpy_rad", "000")
        values = [
            _float(said.get(key, default), f"--{key}", source) for key, default in zip(keys, defaults, strict=True)
        ]
        return read_pose(_PUBLISHER, {name: values, "translation_m": place}, source.path)

    return _Edge(said[_FRAMES[0]], said[_FRAMES[1]], pose)


def _float(text: str, name: str, source: Source) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{name} is no number", where=source.path, expected="a finite number", got=repr(text)[:60])
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
        # A snippet of joints and links, and perhaps of xacro, has no one root.
        text = f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>'
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as problem:
        raise InputError("this is not XML", where=source.path, expected="URDF or xacro", got=str(problem)) from problem
    joints = [element for element in root.iter() if element.tag.rpartition("}")[2] == "joint"][:_MOST_JOINTS]
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
    found = {}
    for key in ("xyz", "rpy"):
        text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
        if "${" in text:
            raise InputError(
                f"{key} of joint {name} is an expression of xacro",
                where=source.path,
                expected="numbers",
                got=text,
                hint="expand it first: ros2 run xacro xacro FILE",
            )
        found[key] = [_float(word, f"{key} of joint {name}", source) for word in text.split()]
    return read_pose(f"joint {name}", {"rpy_rad": found["rpy"], "translation_m": found["xyz"]}, source.path)


def _comment(lines: tuple[str, ...]) -> str:
    return "".join(f"# {line}\n" for line in lines)


FORMAT = Format(
    name="ros2",
    summary="Static transform of ROS 2: a command, a launch file or a URDF joint.",
    holds=ONLY_EXTRINSIC,
    needs=ONLY_EXTRINSIC,
    direction="parent from child: lidar_from_camera, or camera_from_lidar with parent=camera",
    suffix=".txt",
    options=RosOptions,
    recognises=recognises,
    read=read,
    write=write,
)
