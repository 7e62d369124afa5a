"""Read the file of `p2o rig`: LiDARs with results and sweeps, cameras, and known transforms.

docs/how-to/several-lidars.md describes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from p2o.arrays import Float
from p2o.confidence.fusion import Opinion
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded, naming, read_text
from p2o.files.parsed_text import parse_json, read_plain
from p2o.frames.frame import check_camera_name
from p2o.geometry.perturb import parse_accuracy
from p2o.geometry.pose_text import read_pose
from p2o.options import Options, validated
from p2o.options import field as option
from p2o.results.result_json import result_from_dict
from pydantic import Field

from p2o_rig.sensor_graph import Edge, EdgeKind, LeftOut

_MAX_SENSORS = 100
_MAX_KNOWN = 1000
_Name = Annotated[str, Field(min_length=1, max_length=1000)]


class LidarEntry(Options):
    """One LiDAR: the files of its results, the data set of its sweeps, and its approximate pose."""

    results: tuple[_Name, ...] = option(
        (), max_length=100, help="JSON files of `p2o run`, relative to this file; FILE#CAMERA names the camera."
    )
    sweeps: _Name | None = option(None, help="Data set (as --data) whose frames have the sweeps of this LiDAR.")
    body_from_lidar: Any = option(None, help="Approximate pose, for the alignment of sweeps without common cameras.")


class KnownEntry(Options):
    """A transform that is known, such as that between two cameras from the factory."""

    parent: str = option(..., help="Sensor whose frame the pose is given in.")
    child: str = option(..., help="Sensor whose pose is given.")
    pose: Any = option(..., help="parent_from_child: the pose of the child in the parent's frame.")
    sigma: str = option(..., help='Standard deviation per axis, such as "0.05deg 0.002m".')


class SensorsEntry(Options):
    """Content of the file."""

    lidars: dict[str, Any] = option(..., min_length=1, max_length=_MAX_SENSORS, help="The LiDARs by name.")
    cameras: tuple[str, ...] = option((), max_length=_MAX_SENSORS, help="Names of all cameras; none: of the results.")
    reference: str | None = option(None, help="Sensor whose frame all poses refer to; none: the first LiDAR.")
    known: tuple[Any, ...] = option((), max_length=_MAX_KNOWN, help="Transforms that are known.")
    moments: int = option(10, ge=3, le=1000, help="Maximum number of pairs of sweeps to align for two LiDARs.")


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of a body with their measured `edges`; edges of aligned sweeps are added later.

    `sweeps` maps LiDARs to data sets, `guesses` LiDARs to approximate poses (4, 4) on the body. `left_out`
    are results that are not used, `warnings` are remarks on poses.
    """

    lidars: tuple[str, ...]
    cameras: tuple[str, ...]
    reference: str
    edges: tuple[Edge, ...]
    sweeps: Mapping[str, str] = field(default_factory=dict)
    guesses: Mapping[str, Float] = field(default_factory=dict)
    moments: int = 10
    left_out: tuple[LeftOut, ...] = ()
    warnings: tuple[str, ...] = ()


def read_sensors(path: Path | str) -> Sensors:
    """Return the content of a file, YAML or JSON by its ending, with the results that it names.

    Raises UnknownNameError for unknown keys and sensors, and InputError for files that cannot be read, invalid poses,
    and two results for one camera and LiDAR.
    """
    path = expanded(path)
    content = read_plain(path, "file of sensors")
    if not isinstance(content, Mapping):
        got = type(content).__name__
        raise InputError("the file of sensors has no keys", where=path, expected="lidars: ...", got=got)
    entry = validated(SensorsEntry, content, where=path)
    lidars = {
        check_camera_name(name, where=path): validated(
            LidarEntry, {} if value is None else value, name, where=path, noun=f"key of LiDAR {name}"
        )
        for name, value in entry.lidars.items()
    }
    edges, left_out = _result_edges(lidars, entry.cameras, path)
    cameras = entry.cameras or tuple(
        dict.fromkeys([*(edge.parent for edge in edges), *(one.parent for one in left_out)])
    )
    for name in cameras:
        check_camera_name(name, where=path)
        if name in lidars:
            raise InputError(f"{name} is both a camera and a LiDAR", where=path, expected="different names")
    sensors = (*lidars, *cameras)
    known, warnings = _known_edges(entry.known, sensors, path)
    reference = next(iter(lidars)) if entry.reference is None else entry.reference
    if reference not in sensors:
        raise UnknownNameError("reference", reference, sensors, where=path)
    guesses = {}
    for name, lidar in lidars.items():
        if lidar.body_from_lidar is not None:
            guesses[name], remarks = read_pose(f"{name}.body_from_lidar", lidar.body_from_lidar, path)
            warnings.extend(remarks)
    return Sensors(
        tuple(lidars),
        tuple(cameras),
        reference,
        (*edges, *known),
        {name: lidar.sweeps for name, lidar in lidars.items() if lidar.sweeps is not None},
        guesses,
        entry.moments,
        tuple(left_out),
        tuple(warnings),
    )


def _result_edges(
    lidars: Mapping[str, LidarEntry], cameras: Sequence[str], path: Path
) -> tuple[list[Edge], list[LeftOut]]:
    """Return the edges of all results, and results that are not used."""
    edges: list[Edge] = []
    left_out: list[LeftOut] = []
    sources: dict[tuple[str, str], str] = {}
    for lidar, entry in lidars.items():
        for reference in entry.results:
            for camera, row in _rows(reference, path):
                if cameras and camera not in cameras:
                    raise UnknownNameError(f"camera in {reference}", camera, cameras, where=path)
                if (camera, lidar) in sources:
                    text, got = f"camera {camera} and LiDAR {lidar} have two results", sources[camera, lidar]
                    hint = "calibrate their frames jointly (--rig or --joint)"
                    got = reference if got == reference else f"{got} and {reference}"
                    raise InputError(text, where=path, expected="one", got=got, hint=hint)
                sources[camera, lidar] = reference
                with naming(path.parent / reference):
                    result = result_from_dict(row)
                try:
                    own = Opinion.of(camera, result, np.eye(4))
                    trusted, pose = result.verdict.trusted, own.body_from_lidar
                    edges.append(Edge(camera, lidar, pose, own.covariance, EdgeKind.RESULT, trusted, reference))
                except InputError as problem:
                    left_out.append(LeftOut(camera, lidar, EdgeKind.RESULT, str(problem)))
    return edges, left_out


def _rows(reference: str, path: Path) -> list[tuple[str, Any]]:
    """Return camera and content of each result of FILE or FILE#CAMERA."""
    name, _, camera = reference.partition("#")
    file = path.parent / expanded(name)
    content = parse_json(read_text(file, "file of results"), "file of results", file)
    rows = content.get("results", [content]) if isinstance(content, Mapping) else None
    if not isinstance(rows, list) or not rows or not all(isinstance(row, Mapping) for row in rows):
        raise InputError("the file holds no results", where=file, expected="JSON of `p2o run`", got=repr(content)[:40])
    if camera and len(rows) > 1:
        got = f"{len(rows)} results"
        raise InputError(f"#{camera} names the camera of one result", where=file, expected="one result", got=got)
    named = [(camera or row.get("camera") or "", row) for row in rows]
    for one, _ in named:
        if not isinstance(one, str) or not one:
            hint = "calibrate with --rig, or write FILE#CAMERA"
            raise InputError("a result names no camera", where=file, expected="camera: NAME", hint=hint)
        check_camera_name(one, where=file)
    return named


def _known_edges(entries: Sequence[Any], sensors: Sequence[str], path: Path) -> tuple[list[Edge], list[str]]:
    """Return the edges of known transforms, and remarks on their poses."""
    edges: list[Edge] = []
    warnings: list[str] = []
    for number, value in enumerate(entries):
        entry = validated(KnownEntry, value, f"known.{number}", where=path, noun="key of a known transform")
        for sensor in (entry.parent, entry.child):
            if sensor not in sensors:
                raise UnknownNameError(f"sensor in known.{number}", sensor, sensors, where=path)
        pose, remarks = read_pose(f"known.{number}.pose", entry.pose, path)
        sigma = parse_accuracy(entry.sigma, f"{path}, known.{number}.sigma")
        variances = np.repeat([np.radians(sigma.angle_deg), sigma.distance_m], 3) ** 2
        with naming(path):
            edge = Edge(entry.parent, entry.child, pose, np.diag(variances), EdgeKind.KNOWN)
        if any({edge.parent, edge.child} == {other.parent, other.child} for other in edges):
            text = f"the transform between {edge.parent} and {edge.child} is given twice"
            raise InputError(text, where=path, expected="each known transform once")
        edges.append(edge)
        warnings.extend(remarks)
    return edges, warnings
