"""Tree of frames (TF) of a file or a bag: composed transforms, and the frames of LiDAR and camera by their names."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from p2o import Float, InputError, UnknownNameError, se3
from p2o.reading import Calibration, Reading

from p2o_formats import frame_names
from p2o_formats.frame_names import is_body, is_camera, is_lidar, is_optical

Posed = tuple[Float, tuple[str, ...]]
"""A transform (4, 4) and remarks on it."""

_SAME_PLACE_M, _SAME_AXES_DEG, _ANY_AXES_DEG = 1e-3, 0.1, 180.0
_MAX_NAMED, _MAX_CANDIDATES = 12, 50
_EXAMPLES = {"camera": "camera_optical_frame", "LiDAR": "velodyne"}


@dataclass(frozen=True, eq=False)
class Edge:
    """The transform between two frames of a source.

    `pose` returns parent_from_child (4, 4) and remarks, or raises InputError. It is called only for transforms between
    LiDAR and camera: the others may be expressions or joints that move. `quaternion`: its rotation was written as one.
    """

    parent: str
    child: str
    pose: Callable[[], Posed]
    quaternion: bool = False

    def __post_init__(self) -> None:
        for name in ("parent", "child"):
            object.__setattr__(self, name, bare(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class FrameTree:
    """The static transforms of a source, and the parents of frames that change (`moving`)."""

    edges: Sequence[Edge] = ()
    moving: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames with static transforms."""
        return tuple(sorted({name for edge in self.edges for name in (edge.parent, edge.child)}))

    @cached_property
    def _parents(self) -> dict[str, dict[str, list[Edge]]]:
        """The transforms by child and parent."""
        parents: dict[str, dict[str, list[Edge]]] = {}
        for edge in self.edges:
            parents.setdefault(edge.child, {}).setdefault(edge.parent, []).append(edge)
        return parents

    @cached_property
    def _neighbours(self) -> dict[str, list[str]]:
        neighbours: dict[str, list[str]] = {}
        for edge in self.edges:
            neighbours.setdefault(edge.child, []).append(edge.parent)
            neighbours.setdefault(edge.parent, []).append(edge.child)
        return neighbours

    def pose(self, to_frame: str, from_frame: str) -> Float | None:
        """Return to_from_from (4, 4) composed of the static transforms, or None; raises as `transform`."""
        posed = self.transform(to_frame, from_frame)
        return None if posed is None else posed[0]

    def transform(self, to_frame: str, from_frame: str) -> Posed | None:
        """Return to_from_from (4, 4) composed of the static transforms between two frames, or None if not connected.

        Raises InputError if one of these transforms is invalid, given twice with different values, or part of a cycle,
        and if one of the frames has two parents.
        """
        target, here = bare(to_frame), bare(from_frame)
        towards = self.connected([target])
        if here not in towards:
            return None
        path = [here]
        while path[-1] != target:
            path.append(towards[path[-1]])
        self._check_tree(path)
        pose: Float = np.eye(4)
        remarks: tuple[str, ...] = ()
        for here, other in pairwise(path):
            upwards = other in self._parents.get(here, {})
            step, more = self._step(*((other, here) if upwards else (here, other)))
            pose, remarks = (step if upwards else se3.inverse(step)) @ pose, (*remarks, *more)
        return pose, tuple(dict.fromkeys(remarks))

    def known(self, name: str, option: str) -> str:
        """Return the name of a frame; raises UnknownNameError with the most similar names."""
        if bare(name) not in self.names:
            raise UnknownNameError("frame of TF", name, self.names, where=option)
        return bare(name)

    def above(self, frame: str) -> tuple[str, ...]:
        """Return the frames from the parent of a frame to the root, or to the end of a cycle."""
        seen, here = {frame: None}, frame
        while here in self._parents and (here := next(iter(self._parents[here]))) not in seen:
            seen[here] = None
        return tuple(seen)[1:]

    @cached_property
    def cycle(self) -> tuple[str, ...]:
        """Frames that are above themselves, if there are such frames; each frame is visited once."""
        visited: set[str] = set()
        for name in self.names:
            line: dict[str, None] = {}
            while name not in visited and name in self._parents:
                visited.add(name)
                line[name] = None
                name = next(iter(self._parents[name]))
            if name in line:
                frames = tuple(line)
                return frames[frames.index(name) :]
        return ()

    def moving_above(self, frame: str) -> str | None:
        """Return the first changing frame on the path from a frame to the root, or None."""
        here = bare(frame)
        return next((name for name in (here, *self.above(here)) if name in self.moving), None)

    def connected(self, frames: Iterable[str]) -> dict[str, str]:
        """Return the frames that static transforms connect with these, each with the next frame towards them."""
        towards = {frame: frame for frame in frames}
        queue = deque(towards)
        while queue:
            here = queue.popleft()
            for other in self._neighbours.get(here, ()):
                if other not in towards:
                    towards[other] = here
                    queue.append(other)
        return towards

    def _check_tree(self, path: Sequence[str]) -> None:
        """Raise InputError if the transforms between the frames of a path are not unique."""
        for here, other in pairwise(path):
            child = here if other in self._parents.get(here, {}) else other
            if len(parents := self._parents[child]) > 1:
                got = ", ".join(sorted(parents))
                raise InputError(f"frame {child} has several parents", expected="one parent", got=got)
        self.check_acyclic(path)

    def check_acyclic(self, frames: Collection[str]) -> None:
        """Raise InputError if one of these frames is above itself."""
        if set(frames) & set(self.cycle):
            got = " > ".join((self.cycle[0], *reversed(self.cycle)))
            raise InputError("the transforms form a cycle", expected="a tree of frames", got=got)

    def _step(self, parent: str, child: str) -> Posed:
        """Return parent_from_child (4, 4) and remarks; raises InputError if it is given with different values."""
        (pose, remarks), *others = [edge.pose() for edge in self._parents[child][parent]]
        for other, _ in others:
            name = f"the transform from {child} to {parent}"
            frame_names.check_same(name, pose, "its repetition", other, None)
        return pose, remarks


def calibration_of(transforms: Sequence[Edge], reading: Reading, where: Path) -> Calibration:
    """Return camera_from_lidar composed of the transforms of a file between the frames of LiDAR and camera.

    Raises InputError as `sensor_frames` and `FrameTree.transform`, and if no transforms connect the two frames.
    """
    tree = FrameTree(transforms)
    lidar, camera = sensor_frames(tree, reading.lidar_frame, reading.camera_frame, where)
    posed = tree.transform(camera, lidar)
    if posed is None:
        got = f"frames {', '.join(tree.names[:_MAX_NAMED])}"
        hint = "give the file of all transforms between them: ros2 topic echo --once /tf_static"
        raise InputError(f"no transforms connect {lidar} and {camera}", expected="a chain of them", got=got, hint=hint)
    pose, remarks = posed
    optical_from_camera, _ = frame_names.optical_from(camera, reading.camera_axes)
    remarks = (*remarks, *frame_names.axes_remark(camera, reading.camera_axes, "FILE?camera_axes", where))
    quaternion = any(edge.quaternion for edge in transforms)
    return Calibration(None, optical_from_camera @ pose, lidar, camera, remarks, quaternion=quaternion)


def sensor_frames(tree: FrameTree, lidar: str | None, camera: str | None, where: object = None) -> tuple[str, str]:
    """Return the frames of LiDAR and camera: `lidar` and `camera` if given, else the only ones with such names.

    Frames in a chain of one sensor (mount, body, optical frame) count as one, of which the last one is returned, for
    cameras the optical one. Frames that are not connected to the other sensor do not count.

    Raises InputError for a given name that is not in the tree, and if no frame or several frames denote a sensor.
    """
    for option, name in (("lidar_frame", lidar), ("camera_frame", camera)):
        if name is not None:
            tree.known(name, option if where is None else f"{where}: {option}")
    if lidar is not None and camera is not None:
        if bare(lidar) == bare(camera):
            raise InputError("one frame cannot be both LiDAR and camera", got=lidar)
        return bare(lidar), bare(camera)
    lidars = [bare(lidar)] if lidar else [name for name in tree.names if is_lidar(name) and name != camera]
    cameras = [bare(camera)] if camera else [name for name in tree.names if is_camera(name) and name != lidar]
    tree.check_acyclic((*lidars, *cameras))
    with_camera, with_lidar = tree.connected(cameras), tree.connected(lidars)
    lidars = [name for name in lidars if name in with_camera] or lidars
    cameras = [name for name in cameras if name in with_lidar] or cameras
    if camera is None:
        cameras = _distinct(tree, cameras, _is_camera_body)
    if lidar is None:
        lidars = _distinct(tree, lidars, _is_lidar_body)
    return _only(tree, lidars, "LiDAR"), _only(tree, cameras, "camera")


def optical_below(tree: FrameTree, frame: str) -> str | None:
    """Return the only optical frame below the body frame of a camera, or None."""
    below = [name for name in tree.names if is_optical(name) and is_camera(name) and frame in tree.above(name)]
    return below[0] if len(below) == 1 else None


def bare(frame_id: str) -> str:
    """Return the name of a frame without the leading slash that old drivers add."""
    return frame_id.lstrip("/")


def _distinct(tree: FrameTree, names: Collection[str], is_body_of: Callable[[FrameTree, str, str], bool]) -> list[str]:
    """Return the frames of different sensors: without frames that are the body of another frame."""
    if len(names) > _MAX_CANDIDATES:
        return list(names)
    pairs = [
        (name, other) for name in names for other in names if name != other and frame_names.may_be_body_of(name, other)
    ]
    bodies = {name for name, other in pairs if is_body_of(tree, name, other)}
    kept = [name for name in names if name not in bodies]
    return kept or list(names)


def _is_camera_body(tree: FrameTree, name: str, other: str) -> bool:
    """Return whether `other` is the frame of the camera whose body is `name`."""
    if is_optical(other) and not is_optical(name) and other in tree.above(name):
        return _coincide(tree, name, other)
    if name not in tree.above(other):
        return False
    if not is_optical(name) and (is_optical(other) or is_body(name)):
        return True
    # Without an optical frame in the names, a rotation about one point changes the axes of one camera.
    return _coincide(tree, name, other, _SAME_AXES_DEG if is_optical(name) else _ANY_AXES_DEG)


def _is_lidar_body(tree: FrameTree, name: str, other: str) -> bool:
    """Return whether `other` is the frame of the LiDAR whose body is `name`; frames that coincide are one."""
    return name in tree.above(other) and (is_body(name) or _coincide(tree, name, other, _SAME_AXES_DEG))


def _coincide(tree: FrameTree, name: str, other: str, most_deg: float = _ANY_AXES_DEG) -> bool:
    """Return whether two frames have the same origin, and axes within `most_deg` of each other."""
    try:
        pose = tree.pose(name, other)
    except InputError:
        return False
    return pose is not None and se3.distance_m(pose) < _SAME_PLACE_M and se3.angle_deg(pose) <= most_deg + 1e-6


def _only(tree: FrameTree, names: Sequence[str], sensor: str) -> str:
    if len(names) == 1:
        return names[0]
    known = names or tree.names
    listed = ", ".join(known[:_MAX_NAMED]) + (", ..." if len(known) > _MAX_NAMED else "")
    fault = f"{len(names) or 'no'} frame names denote the {sensor}"
    expected = f"one of {listed}" if names else f"a name such as {_EXAMPLES[sensor]}"
    hint = "name them: FILE?lidar_frame=NAME&camera_frame=NAME"
    if any("$" in name for name in tree.names):
        hint += "; expand expressions first: xacro FILE > robot.urdf"
    raise InputError(fault, expected=expected, got=None if names else listed, hint=hint)
