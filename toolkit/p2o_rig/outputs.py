"""Write the extrinsics of a rig as text, JSON, YAML and a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.calibration_files.number_text import quaternion_xyzw
from p2o.errors import printable
from p2o.files.whole_file import json_text, write_whole
from p2o.geometry import se3
from p2o.geometry.rpy import rpy_of
from p2o.results.figures import accuracy_text
from p2o.results.json_types import json_tree

from p2o_rig.contradictions import EdgeCheck
from p2o_rig.extrinsics import RigExtrinsics
from p2o_rig.sensor_graph import Edge

JSON, YAML, FIGURE = "rig.json", "extrinsics.yaml", "sweeps.png"
_COLOURS = ((31, 119, 180), (214, 39, 40), (44, 160, 44), (148, 103, 189), (255, 127, 14), (23, 190, 207))
_REACH_M, _HEIGHT_M, _PX_PER_M = 20.0, 1.0, 30
"""Points that the figure shows: distance from the reference and height; and its scale."""
_FROM_OPTICAL = se3.make([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def as_text(rig: RigExtrinsics) -> str:
    """Return the text of the terminal: verdict, agreement, every sensor and every edge."""
    solution = rig.graph.solution
    known = sum(sensor.reference_from_sensor is not None for sensor in rig.sensors)
    why = rig.verdict.why
    lines = [
        "rig",
        f"  {'result':<9} {known} of {len(rig.sensors)} sensors, {len(rig.graph.used)} edges, in the frame of "
        f"{rig.reference}",
        f"  {'verdict':<9} {rig.verdict.trust.value}" + (f": {why}" if why else ""),
        f"  {'agreement':<9} chi-square {solution.chi_square:.1f}, {solution.degrees} degrees of freedom, p-value "
        f"{solution.p_value:.2g}",
    ]
    lines += [f"  {'wrong':<9} {one.text}" for one in rig.graph.contradictions]
    for sensor in rig.sensors:
        lines.append(f"{sensor.kind} {sensor.name}")
        pose, trust = sensor.reference_from_sensor, sensor.verdict.trust.value
        lines.append(f"  {'verdict':<9} {trust}" + (f": {sensor.verdict.why}" if sensor.verdict.why else ""))
        if pose is not None:
            turn = np.degrees(rpy_of(pose[:3, :3]))
            lines.append(f"  {'position':<9} {_rounded(pose[:3, 3], 4)} m")
            lines.append(f"  {'attitude':<9} {_rounded(turn, 3)} deg (roll, pitch, yaw)")
            if sensor.name != rig.reference:
                lines.append(f"  {'predicted':<9} {accuracy_text(sensor.accuracy)}")
    lines.append("edges")
    for edge in rig.edges:
        lines.append(f"  {edge.name}: {_edge_text(edge, rig.graph.checks.get(edge.name))}")
    lines += [f"  {one.name}: left out: {one.reason}" for one in rig.left_out]
    lines += [f"warning: {text}" for text in rig.warnings]
    return "\n".join(map(printable, lines))


def _rounded(values: Float, digits: int) -> str:
    """Return numbers without negative zeros."""
    return " ".join(f"{value + 0.0:.{digits}f}" for value in np.round(values, digits))


def _edge_text(edge: Edge, check: EdgeCheck | None) -> str:
    origin = f"{edge.source}; " if edge.source else ""
    if not edge.trusted:
        origin += "not trusted on its own; "
    if check is None:
        return f"{origin}not checked by a loop"
    size = f"{check.rotation_deg:.3f} deg and {check.translation_m:.4f} m from all others"
    return f"{origin}{size}, at most {check.text}"


def as_dict(rig: RigExtrinsics) -> dict[str, Any]:
    """Return the JSON object of `p2o rig --json`."""
    solution, used = rig.graph.solution, {edge.name for edge in rig.graph.used}
    sensors = [
        {**_values(sensor, _OF_SENSOR), "verdict": {"trust": sensor.verdict.trust.value, "reasons": sensor.verdict.why}}
        for sensor in rig.sensors
    ]
    edges = [
        {**_values(edge, _OF_EDGE), "used": edge.name in used, "check": _check_dict(rig.graph.checks.get(edge.name))}
        for edge in rig.edges
    ]
    return {
        "reference": rig.reference,
        "verdict": {"trust": rig.verdict.trust.value, "reasons": rig.verdict.why},
        **_values(solution, ("chi_square", "degrees", "p_value")),
        "sensors": json_tree("sensors", sensors),
        "edges": json_tree("edges", edges),
        "contradictions": [
            {"edges": [edge.name for edge in one.edges], "text": one.text} for one in rig.graph.contradictions
        ],
        "left_out": [_values(one, ("name", "reason")) for one in rig.left_out],
        "warnings": list(rig.warnings),
    }


_OF_SENSOR = ("name", "kind", "reference_from_sensor", "covariance", "accuracy")
_OF_EDGE = ("name", "parent", "child", "kind", "source", "trusted", "parent_from_child", "covariance")
_OF_CHECK = ("rotation_deg", "translation_m", "chi_square", "p_value", "text")


def _values(one: Any, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(one, name) for name in names}


def _check_dict(check: EdgeCheck | None) -> dict[str, Any] | None:
    return None if check is None else _values(check, _OF_CHECK)


def write_folder(rig: RigExtrinsics, folder: Path) -> list[Path]:
    """Write JSON, YAML and, if sweeps were aligned, a figure to an existing folder; return the paths."""
    paths = [folder / JSON, folder / YAML]
    write_whole(paths[0], json_text(as_dict(rig)).encode())
    write_whole(paths[1], as_yaml(rig).encode())
    if rig.clouds:
        paths.append(folder / FIGURE)
        write_whole(paths[2], figure(rig))
    return paths


def as_yaml(rig: RigExtrinsics) -> str:
    """Return the poses in the form of rig files and frame.yaml: position and quaternion in the reference frame."""
    import yaml

    poses = {
        sensor.name: {
            "rotation_xyzw": [float(value) for value in quaternion_xyzw(sensor.reference_from_sensor)],
            "translation_m": sensor.reference_from_sensor[:3, 3].tolist(),
        }
        for sensor in rig.sensors
        if sensor.reference_from_sensor is not None
    }
    content = {"reference": rig.reference, "verdict": rig.verdict.trust.value, "reference_from_sensor": poses}
    text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return text


def figure(rig: RigExtrinsics) -> bytes:
    """Return a PNG: sweeps of one moment from above, points near the height of the reference, x ahead and y left.

    Each LiDAR has a colour, in which its name is written. The axes are those of the reference, levelled if it is a
    camera.
    """
    import cv2

    is_camera = any(sensor.name == rig.reference and sensor.kind == "camera" for sensor in rig.sensors)
    level = _FROM_OPTICAL if is_camera else np.eye(4)
    side = int(2 * _REACH_M * _PX_PER_M)
    canvas = np.full((side, side, 3), 255, np.uint8)
    names = sorted(rig.clouds, key=lambda name: -len(rig.clouds[name]))  # dense sweeps below sparse ones
    for number, name in enumerate(names):
        pose, colour = rig.pose(name), _COLOURS[number % len(_COLOURS)]
        if pose is None:
            continue
        xyz = se3.apply(level @ pose, rig.clouds[name].xyz)
        near = (np.abs(xyz[:, :2]).max(axis=1) < _REACH_M) & (np.abs(xyz[:, 2]) < _HEIGHT_M)
        row, column = np.floor((_REACH_M - xyz[near, :2]) * _PX_PER_M).astype(np.int64).T
        canvas[row, column] = colour
        cv2.putText(canvas, ascii(name)[1:-1], (20, 40 + 40 * number), cv2.FONT_HERSHEY_SIMPLEX, 1.0, colour, 2)
    return bytes(cv2.imencode(".png", canvas[..., ::-1])[1].tobytes())
