"""Read the transforms of URDF, launch files, commands, and output of `ros2 topic echo /tf_static` and `tf2_echo`.

A transform of ROS is parent_from_child: it maps points of the child frame to the parent frame. Angles are radians about
fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll). Positional arguments of static_transform_publisher are x y z, then yaw pitch
roll or qx qy qz qw, then parent and child; ROS 1 adds a period in ms. `tf2_echo A B` prints A_from_B. Launch files are
not executed, and XML with a DOCTYPE is refused.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from p2o import InputError, se3
from p2o.reading import Reading, Source, parse_yaml, read_pose

from p2o_formats.expressions import PythonFile, holds, substituted
from p2o_formats.frame_tree import Edge, Posed

PUBLISHER = "static_transform_publisher"
POSITION, QUATERNION, ANGLES = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
FRAMES = ("frame-id", "child-frame-id")
"""Names of the arguments of tf2_ros's publisher."""
_KEYS = (*POSITION, *QUATERNION, *ANGLES, *FRAMES)
_OPTIONS = frozenset(f"--{key}" for key in _KEYS)
_POSITIONAL = "x y z yaw pitch roll PARENT CHILD, or x y z qx qy qz qw PARENT CHILD"
_ENDS = ("&", "&&", "|", "||", ";", ">", ">>", "2>&1", "--ros-args")
_MAX_EDGES = 10_000
_LIST = r"\[([^\]\n]{1,200})\]"
_LINE = r"[ \t]{0,20}\n[ \t]{0,40}"
_ECHO = re.compile(
    rf"^[ \t]{{0,20}}- Translation: {_LIST}{_LINE}- Rotation: in Quaternion(?: \(xyzw\))? {_LIST}"
    rf"(?:{_LINE}(?:- Rotation: )?in RPY(?: \(radian\))? {_LIST}"
    rf"(?:{_LINE}(?:- Rotation: )?in RPY \(degree\) {_LIST})?)?",
    re.MULTILINE,
)
_ECHO_FRAMES = re.compile(
    r"(?:(?:ros2 run|rosrun) tf2?(?:_ros|_tools)? tf2?_echo(?:\.py)? +|Waiting for transform +)"
    r"(?P<parent>[^\s-]\S{0,120}) +(?:-> +)?(?P<child>[^\s-][^\s:]{0,120})"
)
_ROUNDED_DEG = 0.3
_EXPAND = "expand it first: ros2 run xacro xacro FILE"
_UNKNOWN = re.compile(r"\$\([^()]{1,100}\)")
_ASSIGNED = re.compile(r"\s*(?:export |readonly )?(\w{1,100})=('[^']{0,200}'|\"[^\"]{0,200}\"|[^\s;]{0,200})")
_DOCUMENTS = re.compile(r"^---[ \t]*$", re.MULTILINE)
_MESSAGE = re.compile(r"^(?:transforms:|header:|child_frame_id:|- |\{|\[)", re.MULTILINE)


def has_transforms(source: Source) -> bool:
    """Return whether a file looks like one of the sources of this module."""
    text = source.text
    if text.lstrip().startswith("<"):
        return PUBLISHER in text or "<joint" in text
    return PUBLISHER in text or _has_messages(text) or _ECHO.search(text) is not None


def edges(source: Source, reading: Reading) -> list[Edge]:
    """Return the transforms of a file; raises InputError for a file without any or without their frames."""
    text = source.text
    if text.lstrip().startswith("<"):
        transforms = list(_of_xml(text.strip(), source.path))
    elif _ECHO.search(text):
        transforms = list(_of_echo(text, reading, source.path))
    elif _has_messages(text):
        transforms = list(_of_messages(text, source.path))
    else:
        transforms = list(_of_python(text, source.path) or _of_yaml(source) or _of_shell(source))
    if reading.direction and not _ECHO.search(text):
        fault, expected = "the frames of the file state the direction of its transforms", "lidar_frame, camera_frame"
        raise InputError(fault, where=source.path, expected=expected, got=reading.direction, hint="omit direction")
    if not transforms:
        expected = f"{PUBLISHER} --x ... --qw, or joints"
        raise InputError("the file has no transform", where=source.path, expected=expected)
    return transforms[:_MAX_EDGES]


# ---- commands and launch files


def _of_shell(source: Source) -> list[Edge]:
    """Return the transforms of shell commands, with the values of variables that the file assigns."""
    text = "\n".join(source.lines).replace("\\\n", " ")
    values: dict[str, str] = {}
    transforms: list[Edge] = []
    for line in text.splitlines():
        if assigned := _ASSIGNED.match(line):
            values[assigned[1]] = substituted(assigned[2].strip("'\""), values)
        if PUBLISHER in line:
            words = _words(substituted(line, values))
            starts = [at for at, word in enumerate(words) if word.rpartition("/")[2].strip("`") == PUBLISHER]
            for start, stop in zip(starts, [*starts[1:], len(words)], strict=False):
                transforms += _publisher(words[start + 1 : stop], source.path)
    if not transforms:
        # Named arguments that were copied without the whole call around them.
        words = re.split(r"[\s,()\[\]'\"]+", text)
        start = next((at for at, word in enumerate(words) if word.partition("=")[0] in _OPTIONS), len(words))
        transforms += _publisher(words[start:], source.path)
    return transforms


def _of_python(text: str, path: Path) -> list[Edge]:
    """Return the transforms of a Python launch file: the nodes and commands that start the publisher."""
    file = PythonFile.of(text)
    transforms: list[Edge] = []
    for call in file.calls:
        keywords = {word.arg: word.value for word in call.keywords}
        program = file.text(keywords.get("executable", keywords.get("node_executable")))
        command = file.words(keywords.get("cmd"))
        condition, state = file.condition(keywords.get("condition"))
        edges: Iterable[Edge] = ()
        if state is not False and program == PUBLISHER:
            edges = _publisher(file.words(keywords.get("arguments")), path)
        elif state is not False and PUBLISHER in command:
            edges = _publisher(command[command.index(PUBLISHER) + 1 :], path)
        transforms += [_conditional(edge, "" if state else condition, path) for edge in edges]
    return transforms


def _of_yaml(source: Source) -> list[Edge]:
    """Return the transforms of a YAML launch file of ROS 2."""
    level, arguments = [source.value], []
    values: dict[str, str] = {}
    while level:
        for entry in (entry for entry in level if isinstance(entry, dict)):
            if "name" in entry and ("default" in entry or "value" in entry):
                values[str(entry["name"])] = str(entry.get("default", entry.get("value")))
            if PUBLISHER in (entry.get("exec"), entry.get("type")):
                arguments.append(str(entry.get("args", "")))
        parts = [[v for k, v in p.items() if k != "include"] if isinstance(p, dict) else p for p in level]
        level = [inner for part in parts if isinstance(part, list) for inner in part]
    return [edge for text in arguments for edge in _publisher(_words(substituted(text, values)), source.path)]


def _words(line: str) -> list[str]:
    line = _UNKNOWN.sub(lambda match: match[0].replace(" ", ":"), line)
    try:
        return shlex.split(line, comments=True)
    except ValueError:
        return line.split()


def _publisher(words: Sequence[str], path: Path) -> Iterator[Edge]:
    """Yield the transform of the arguments of the publisher; none for a mention of it without arguments."""
    end = next((at for at, word in enumerate(words) if word in _ENDS), len(words))
    end = next((at + 1 for at, word in enumerate(words[:end]) if word.endswith(";")), end)
    words = [word.rstrip(";`") for word in words[:end] if ":=" not in word]
    if not words or not (words[0].startswith("--") or _is_value(words[0])):
        return
    arguments = (_named if any(word.startswith("--") for word in words) else _positional)(words, path)
    missing = " and ".join(f"--{key}" for key in FRAMES if key not in arguments)
    if missing:
        raise InputError("a transform has no frames", where=path, expected=missing, got=" ".join(words)[:200])
    pose = partial(_posed, arguments, path)
    yield Edge(arguments[FRAMES[0]], arguments[FRAMES[1]], pose, quaternion=QUATERNION[0] in arguments)


def _named(words: Sequence[str], path: Path) -> dict[str, str]:
    arguments: dict[str, str] = {}
    rest = iter(words)
    for word in rest:
        key, equals, value = word.removeprefix("--").partition("=")
        if not word.startswith("--") or key not in _KEYS:
            continue
        if key in arguments:
            fault = f"--{key} is given twice before the frames of one transform"
            raise InputError(fault, where=path, expected="--frame-id and --child-frame-id for each transform")
        arguments[key] = value if equals else next(rest, "")
    return arguments


def _positional(words: Sequence[str], path: Path) -> dict[str, str]:
    # With six numbers, the angles are in the order yaw, pitch, roll.
    rotation = QUATERNION if len(words) > 8 and _is_value(words[6]) else tuple(reversed(ANGLES))
    keys = (*POSITION, *rotation, *FRAMES)
    period = words[len(keys) :]
    if len(words) < len(keys) or len(period) > 1 or not all(map(_is_value, (*words[: len(keys) - 2], *period))):
        fault = f"the arguments of {PUBLISHER} are not a transform"
        raise InputError(fault, where=path, expected=f"{_POSITIONAL}; ROS 1 adds a period", got=" ".join(words)[:200])
    return dict(zip(keys, words, strict=False))


def _is_value(word: str) -> bool:
    """Return whether a word is a number, or an expression that may be one."""
    return "$" in word or _number(word) is not None


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _posed(arguments: Mapping[str, str], path: Path) -> Posed:
    position = [_float(arguments.get(key, "0"), f"--{key}", path) for key in POSITION]
    quaternion, angles = (any(key in arguments for key in keys) for keys in (QUATERNION, ANGLES))
    if quaternion and angles:
        raise InputError("a rotation is given twice", where=path, expected="a quaternion, or roll pitch yaw")
    keys, name, defaults = (QUATERNION, "rotation_xyzw", "0001") if quaternion else (ANGLES, "rpy_rad", "000")
    values = [_float(arguments.get(key, value), f"--{key}", path) for key, value in zip(keys, defaults, strict=True)]
    return read_pose(PUBLISHER, {name: values, "translation_m": position}, path)


def _float(text: str, name: str, path: Path) -> float:
    value = _number(text)
    if value is None or not np.isfinite(value):
        hint = "write the value into the file: it has no default in it" if "$" in text else None
        fault = f"{name} is not a number"
        raise InputError(fault, where=path, expected="a finite number", got=repr(text)[:80], hint=hint)
    return value


# ---- XML: URDF, xacro, launch files of ROS 1 and 2


def _of_xml(text: str, path: Path) -> Iterator[Edge]:
    """Yield the joints and publishers of URDF, xacro, snippets of them, and launch files."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("XML with a DOCTYPE or entities is not read", where=path, expected="plain URDF or launch file")
    if not re.match(r"<\?xml|<robot|<launch", text):
        # A snippet of joints and links, perhaps with xacro, has no single root element.
        text = f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{text}</robot>'
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as problem:
        expected = "URDF, xacro or a launch file"
        raise InputError("this is not XML", where=path, expected=expected, got=str(problem)) from problem
    for element, values, condition in _active(root):
        edges: Iterable[Edge] = ()
        if _tag(element) == "joint":
            ends = [element.find(key) for key in ("parent", "child")]
            parent, child = ("" if end is None else substituted(end.get("link", ""), values) for end in ends)
            if parent and child:
                edges = [Edge(parent, child, partial(_joint, element, _origin(element, values), path))]
        elif PUBLISHER in (element.get("type"), element.get("exec")):
            edges = _publisher(_words(substituted(element.get("args", ""), values)), path)
        elif PUBLISHER in (words := _words(substituted(element.get("cmd", ""), values))):
            edges = _publisher(words[words.index(PUBLISHER) + 1 :], path)
        yield from (_conditional(edge, condition, path) for edge in edges)


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _active(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, Mapping[str, str], str]]:
    """Yield the elements in order, without those whose condition (if, unless) is known to be false.

    With each element: the values that are defined before it, and its condition if that is unknown, else "". In a macro,
    its parameters are unknown.
    """
    values: dict[str, str] = {}
    stack = [(root, values, "")]
    while stack:
        element, values, condition = stack.pop()
        tag = _tag(element)
        texts = [(key, element.get(key, "" if tag != key else element.get("value", ""))) for key in ("if", "unless")]
        known = [(key, text, holds(substituted(text, values), key == "if")) for key, text in texts if text]
        if any(state is False for *_, state in known):
            continue
        condition = next((f"{key} {text}" for key, text, state in known if state is None), condition)
        value = element.get("value", element.get("default"))
        if tag in ("arg", "let", "property") and value is not None:
            name = element.get("name", "")
            # A property has its last value, an argument its first.
            if name not in values or (tag != "arg" and element.get("value") is not None):
                values[name] = substituted(value, values)
        elif tag == "macro":
            parameters = [word.partition(":=")[0].lstrip("*") for word in element.get("params", "").split()]
            values = {**values, **{name: f"${{{name}}}" for name in parameters}}
        yield element, values, condition
        # The arguments of an included file are its own.
        stack += [(child, values, condition) for child in reversed(element) if tag != "include"]


def _conditional(edge: Edge, condition: str, path: Path) -> Edge:
    """Return a transform whose pose has a remark on its condition, unless this is empty."""
    if not condition:
        return edge
    name = f"the transform from {edge.child} to {edge.parent}"
    remark = f"{path}: {name} is used, but its condition is unknown: {condition[:100]}"

    def pose() -> Posed:
        value, remarks = edge.pose()
        return value, (*remarks, remark)

    return replace(edge, pose=pose)


def _origin(joint: ElementTree.Element, values: Mapping[str, str]) -> dict[str, str]:
    """Return the texts of the attributes of a joint's origin."""
    origin = joint.find("origin")
    return {} if origin is None else {key: substituted(text, values) for key, text in origin.items()}


def _joint(joint: ElementTree.Element, origin: Mapping[str, str], path: Path) -> Posed:
    name = joint.get("name", "joint")
    if any(_tag(part) == "insert_block" for part in joint):
        fault, expected = f"the origin of joint {name} is a block of a macro of xacro", "an origin with numbers"
        raise InputError(fault, where=path, expected=expected, hint=_EXPAND)
    if joint.get("type", "fixed") != "fixed":
        fault = f"joint {name} between LiDAR and camera is not fixed"
        hint = "write the transform at its position in the recording to a file: ros2 run tf2_ros tf2_echo LIDAR CAMERA"
        raise InputError(fault, where=path, expected="fixed joints", got=joint.get("type"), hint=hint)
    rotation = "quat_xyzw" if "quat_xyzw" in origin else "rpy"
    numbers = {}
    for key, text in ((key, origin.get(key, "0 0 0")) for key in ("xyz", rotation)):
        if "$" in text:
            fault = f"{key} of joint {name} is an expression of xacro"
            raise InputError(fault, where=path, expected="numbers", got=text, hint=_EXPAND)
        numbers[key] = [_float(word, f"{key} of joint {name}", path) for word in text.split()]
    form = "rpy_rad" if rotation == "rpy" else "rotation_xyzw"
    return read_pose(f"joint {name}", {form: numbers[rotation], "translation_m": numbers["xyz"]}, path)


# ---- output of ROS tools


def _has_messages(text: str) -> bool:
    return "child_frame_id" in text and "rotation" in text and "translation" in text


def _of_messages(text: str, path: Path) -> Iterator[Edge]:
    """Yield the transforms of messages of `ros2 topic echo` or `rostopic echo`, separated by ---."""
    for document in _DOCUMENTS.split(text):
        # Lines before the message are those of the shell, or warnings.
        start = _MESSAGE.search(document) if _has_messages(document) else None
        value = None if start is None else parse_yaml(document[start.start() :], "message of TF", path)
        for message in value if isinstance(value, list) else [value]:
            if isinstance(message, dict):
                transforms = message.get("transforms", [message])
                yield from map(partial(_of_message, path), transforms if isinstance(transforms, list) else [])


def _of_message(path: Path, message: Any) -> Edge:
    try:
        parent, child = message["header"]["frame_id"], message["child_frame_id"]
        part = message["transform"]
        position = [part["translation"][key] for key in "xyz"]
        quaternion = [part["rotation"][key] for key in "xyzw"]
    except (KeyError, TypeError, IndexError) as problem:
        expected = "header.frame_id, child_frame_id, transform.translation and transform.rotation"
        got = str(message)[:100]
        raise InputError("a message is not a TransformStamped", where=path, expected=expected, got=got) from problem
    name = f"the transform from {child} to {parent}"
    value = {"rotation_xyzw": quaternion, "translation_m": position}
    return Edge(str(parent), str(child), partial(read_pose, name, value, path))


def _of_echo(text: str, reading: Reading, path: Path) -> Iterator[Edge]:
    """Yield the transforms of the output of tf_echo or tf2_echo.

    Their frames are those of the command, if it is in the file, else the named frames of the LiDAR and the camera.
    """
    commands = list(_ECHO_FRAMES.finditer(text))
    for match in _ECHO.finditer(text):
        before = [command for command in commands if command.start() < match.start()]
        if before:
            yield Edge(before[-1]["parent"], before[-1]["child"], partial(_echoed, match, (), path))
            continue
        lidar, camera, direction = reading.lidar_frame, reading.camera_frame, reading.direction
        if direction is None and (lidar is None or camera is None):
            fault = "the output of tf2_echo does not name its frames"
            expected = "FILE?lidar_frame=NAME&camera_frame=NAME for the command `tf2_echo LIDAR CAMERA`"
            hint = "after `tf2_echo CAMERA LIDAR`, add direction=camera_from_lidar"
            raise InputError(fault, where=path, expected=expected, hint=hint)
        names = [lidar or "lidar", camera or "camera_optical_frame"]
        remarks: tuple[str, ...] = ()
        if direction is None:
            remarks = (f"{path}: read as the output of `tf2_echo {lidar} {camera}`: lidar_from_camera",)
        parent, child = names[::-1] if direction == "camera_from_lidar" else names
        yield Edge(parent, child, partial(_echoed, match, remarks, path))


def _echoed(match: re.Match[str], remarks: Iterable[str], path: Path) -> Posed:
    """Return the transform of one output of tf2_echo, from its angles in degrees: they have the most digits."""
    position, quaternion, _, degrees = ([w for w in (t or "").split(",") if w.strip()] for t in match.groups())
    value = {"translation_m": position, "rotation_xyzw": quaternion}
    pose, more = read_pose("the transform of tf2_echo", value, path)
    if degrees:
        value = {"translation_m": position, "rpy_deg": degrees}
        finer, _ = read_pose("the transform of tf2_echo", value, path)
        pose = finer if se3.angle_deg(se3.inverse(pose) @ finer) < _ROUNDED_DEG else pose
    return pose, (*remarks, *more)
