"""Read rig files: the frames of each camera, and the poses of the cameras on the body (docs/how-to/rig.md)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded, naming
from p2o.files.parsed_text import read_plain
from p2o.frames.frame import check_camera_name
from p2o.geometry import se3
from p2o.geometry.motion import pose_at
from p2o.geometry.pose_text import read_pose
from p2o.host.calibration_file import read_extrinsic_file
from p2o.host.registry import Registry
from p2o.options import Options, validated
from p2o.options import field as option

_PLACES = ("camera_from_body", "body_from_camera", "camera_from_camera", "camera_from_lidar")
_MOST_CAMERAS = 100
_STILL_S = 1e-3
"""Time tolerance: a vehicle at 20 m/s moves 2 cm in this time."""

_Pattern = Annotated[str, Field(min_length=1, max_length=200)]


class CameraEntry(Options):
    """One camera of a rig file: its frames, and its pose in one of four forms, the same form for all cameras."""

    frames: tuple[_Pattern, ...] = option((), max_length=1000, help="Names of its frames, with * and ? as wildcards.")
    camera_from_body: Any = option(None, help="Place of the body in the camera.")
    body_from_camera: Any = option(None, help="Place of the camera on the body.")
    camera_from_camera: Any = option(None, help="Place of the `reference` camera in this one.")
    camera_from_lidar: Any = option(
        None, help="Place of the LiDAR as known before, or a calibration file: the body is that LiDAR."
    )
    image_before_sweep_s: float = option(
        0.0, ge=-1, le=1, help="How long before the time of the sweep the image was taken, in seconds."
    )

    @property
    def place(self) -> str:
        """Return the key that gives the pose, empty without one; raises InputError for several."""
        given = [name for name in _PLACES if getattr(self, name) is not None]
        if len(given) > 1:
            expected = "one of " + ", ".join(_PLACES)
            raise InputError("a camera has several places", expected=expected, got=", ".join(given))
        return given[0] if given else ""


_Rate = Annotated[float, Field(ge=-100, le=100)]
_Speed = Annotated[float, Field(ge=-1000, le=1000)]


class RigEntry(Options):
    """Content of a rig file."""

    cameras: dict[str, Any] = option(..., min_length=1, max_length=_MOST_CAMERAS, help="The cameras by name.")
    reference: str | None = option(None, help="The camera that camera_from_camera of the others counts from.")
    body_from_lidar: Any = option(None, help="First guess of where the LiDAR is on the body.")
    twist: tuple[_Rate, _Rate, _Rate, _Speed, _Speed, _Speed] | None = option(
        None, help="Velocity of the body in its own frame, about x y z in rad/s, then along x y z in m/s."
    )


@dataclass(frozen=True, eq=False)
class Rig:
    """The cameras of a rig: `patterns` of their frames' names, and their places (4, 4) on the body, if known of all.

    Without a file there are no `cameras`: frames say themselves which one they are of. `start` is a first guess of
    body_from_lidar. `warnings` by camera are remarks that results repeat; `source` is named in errors.
    """

    cameras: tuple[str, ...] = ()
    patterns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    camera_from_body: Mapping[str, Float] = field(default_factory=dict)
    start: Float | None = None
    warnings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    source: str = "--rig"

    @classmethod
    def of(cls, value: bool | str | Mapping[str, Any], registry: Registry | None = None) -> Rig | None:
        """Return the rig that a word of a recipe means: a file, its content, or True for what frames say themselves.

        Raises as `parse_rig`, whose `registry` it is, and InputError where the file cannot be read.
        """
        if isinstance(value, bool):
            return cls() if value else None
        if isinstance(value, Mapping):
            return parse_rig(value, "rig", registry)
        if not value:
            raise InputError("the rig file has no name", where="--rig", expected="a file, or no word for none")
        path = expanded(value)
        return parse_rig(read_plain(path, "rig file"), path, registry)

    def start_of(self, camera: str) -> Float | None:
        """Return the initial guess of camera_from_lidar (4, 4) of a camera, or None."""
        return None if self.start is None else self.camera_from_body[camera] @ self.start

    def groups(
        self, names: Sequence[str], indices: Sequence[int], camera_of: Callable[[int], str]
    ) -> tuple[dict[str, list[int]], dict[str, tuple[str, ...]]]:
        """Return the chosen frames by camera, in the order of the file or of the frames, and remarks by camera.

        A frame belongs to the camera with a pattern that matches its name, else to the camera that it names (read by
        `camera_of`), else to that at the end of its name, with a remark. Raises InputError for a frame of no camera or
        of several and a camera without frames, UnknownNameError for a camera that the file does not hold.
        """
        groups: dict[str, list[int]] = {camera: [] for camera in self.cameras}
        remarks = dict(self.warnings)
        for index in indices:
            name = names[index]
            camera = self._by_pattern(name) or camera_of(index)
            if camera and self.cameras and camera not in self.cameras:
                raise UnknownNameError(f"camera of frame {name}", camera, self.cameras, where=self.source)
            if not camera:
                camera = self._by_ending(name)
                remark = f"{self.source}: frames of {camera} are assigned by the ends of their names"
                if remark not in remarks.get(camera, ()):
                    remarks[camera] = (*remarks.get(camera, ()), remark)
            groups.setdefault(camera, []).append(index)
        for camera, chosen in groups.items():
            if not chosen:
                text, expected = f"camera {camera} has no frames", "frames of every camera among those that are chosen"
                got = f"{len(indices)} frames of others"
                hint = "choose its frames, too, or leave the camera out of the rig file"
                raise InputError(text, where=self.source, expected=expected, got=got, hint=hint)
        return groups, remarks

    def _by_pattern(self, name: str) -> str:
        matching = [
            camera for camera, patterns in self.patterns.items() if any(fnmatchcase(name, one) for one in patterns)
        ]
        if len(matching) > 1:
            text = f"frame {name} matches the patterns of several cameras"
            raise InputError(text, where=self.source, expected="one camera for each frame", got=", ".join(matching))
        return matching[0] if matching else ""

    def _by_ending(self, name: str) -> str:
        ending = [one for one in self.cameras if re.search(rf"(?<!\w){re.escape(one)}$", name)]
        if len(ending) == 1:
            return ending[0]
        hint = "give `frames: [PATTERN]` at the camera in the rig file, or `camera_name` in frame.yaml"
        text = f"frame {name} is of no camera" if self.cameras else f"frame {name} names no camera"
        expected = "one of " + ", ".join(self.cameras) if self.cameras else "a camera_name, or a rig file"
        raise InputError(text, where=self.source, expected=expected, hint=hint)


def parse_rig(content: Any, where: Path | str, registry: Registry | None = None) -> Rig:
    """Return the rig of the content of a file; `where` names the file in errors.

    A mapping of cameras alone, each with its place, is taken as `cameras`. The readers of `registry` (default:
    `Registry.of_process()`) read the calibration files that it names. Raises UnknownNameError for unknown keys and
    InputError for invalid names, poses and references.
    """
    if not isinstance(content, Mapping):
        raise InputError("the rig file has no keys", where=where, expected="cameras: ...", got=type(content).__name__)
    if "cameras" not in content and content:
        placed = (isinstance(value, Mapping) and any(word in value for word in _PLACES) for value in content.values())
        content = {"cameras": content} if all(placed) else content
    entry = validated(RigEntry, content, where=where)
    cameras: dict[str, CameraEntry] = {}
    for name, value in entry.cameras.items():
        check_camera_name(name, where=where)
        entries = {} if value is None else value
        cameras[name] = validated(CameraEntry, entries, name, where=where, noun=f"key of camera {name}")
    places, warnings = _places(entry, cameras, where, registry)
    start = np.eye(4) if places and any(camera.camera_from_lidar is not None for camera in cameras.values()) else None
    if entry.body_from_lidar is not None:
        if not places:
            text = "body_from_lidar is of no use without the places of the cameras"
            raise InputError(text, where=where, expected="camera_from_body of every camera")
        start, remarks = read_pose("body_from_lidar", entry.body_from_lidar, Path(where))
        warnings |= {name: (*warnings.get(name, ()), *remarks) for name in cameras if remarks}
    patterns = {name: camera.frames for name, camera in cameras.items() if camera.frames}
    return Rig(tuple(cameras), patterns, places, start, warnings, str(where))


def _places(
    entry: RigEntry, cameras: Mapping[str, CameraEntry], where: Path | str, registry: Registry | None
) -> tuple[dict[str, Float], dict[str, tuple[str, ...]]]:
    """Return camera_from_body (4, 4) of each camera when its image was taken, or none at all, and remarks."""
    words = {}
    for name, camera in cameras.items():
        with naming(Path(f"{where}, {name}")):
            words[name] = camera.place
    used = {word for word in words.values() if word}
    if len(used) > 1:
        text = "the places of the cameras have several forms"
        raise InputError(text, where=where, expected="the same for all", got=sorted(used))
    if not used:
        if entry.reference is not None or entry.twist is not None:
            text = f"{'reference' if entry.twist is None else 'twist'} is of no use without the places of the cameras"
            raise InputError(text, where=where, expected="one of " + ", ".join(_PLACES) + " for every camera")
        return {}, {}
    [word] = used
    _check_reference(entry, cameras, word, where)
    missing = [name for name in cameras if not words[name] and name != entry.reference]
    if missing:
        message = f"the place of {', '.join(missing)} is missing"
        raise InputError(message, where=where, expected=f"{word} of every camera, or of none")
    places, remarks = {}, {}
    for name, camera in cameras.items():
        value = getattr(camera, word)
        pose, texts = _place(f"{name}.{word}", word, value, Path(where), registry)
        pose = se3.inverse(pose) if word == "body_from_camera" else pose
        early_s = camera.image_before_sweep_s
        if entry.twist is not None:
            pose = pose @ pose_at(np.array(entry.twist), early_s)
        elif abs(early_s) > _STILL_S:
            still = f"{where}: the image of {name} is {1000 * early_s:.0f} ms before its sweep; without `twist` the rig"
            texts = (*texts, f"{still} is taken to stand still")
        places[name] = pose
        if texts:
            remarks[name] = tuple(texts)
    return places, remarks


def _place(name: str, word: str, value: Any, where: Path, registry: Registry | None) -> tuple[Float, tuple[str, ...]]:
    """Return the pose (4, 4) of a key, identity for None, and warnings; a text names a file beside the rig file."""
    if value is None:
        return np.eye(4), ()
    if word == "camera_from_lidar" and isinstance(value, str):
        return read_extrinsic_file(value, where, lambda file: where.parent / expanded(file), registry)
    return read_pose(name, value, where)


def _check_reference(entry: RigEntry, cameras: Mapping[str, CameraEntry], word: str, where: Path | str) -> None:
    """Raise InputError unless a reference camera is given exactly if poses are relative to a camera."""
    counts = word == "camera_from_camera"
    if counts and entry.reference is None:
        message = "camera_from_camera counts from no camera"
        raise InputError(message, where=where, expected="reference: one of " + ", ".join(cameras))
    if entry.reference is None:
        return
    if not counts:
        raise InputError(f"reference is of no use beside {word}", where=where, expected="camera_from_camera")
    if entry.reference not in cameras:
        raise UnknownNameError("reference camera", entry.reference, cameras, where=where)
    if cameras[entry.reference].camera_from_camera is not None:
        text = f"the reference camera {entry.reference} has a place of its own"
        raise InputError(text, where=where, expected="none: it is the body")
