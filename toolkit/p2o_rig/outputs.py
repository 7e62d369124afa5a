"""Write the extrinsics of a rig as text, JSON, YAML and a figure."""

from __future__ import annotations

import io
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
_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")
_MAX_POINTS = 60_000
_REACH_M, _HEIGHT_M, _SLICE_M = 20.0, 1.0, 1.0
"""Points that a figure shows: distance from the reference, height, and half the thickness of the cross-section."""
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
    """Return a PNG: sweeps of one moment from above and as a cross-section, and the sensors.

    The axes are those of the reference, with x ahead, y left and z up if it is a camera.
    """
    from matplotlib.figure import Figure

    kinds = {sensor.name: sensor.kind for sensor in rig.sensors}
    level = _FROM_OPTICAL if kinds[rig.reference] == "camera" else np.eye(4)
    canvas = Figure(figsize=(13, 7), layout="constrained")
    grid = canvas.add_gridspec(2, 2, width_ratios=(1.6, 1))
    above, section, sensors = (canvas.add_subplot(place) for place in (grid[:, 0], grid[0, 1], grid[1, 1]))
    names = sorted(rig.clouds, key=lambda name: -len(rig.clouds[name]))  # dense sweeps below sparse ones
    clouds = {name: level @ pose for name in names if (pose := rig.pose(name)) is not None}
    for colour, (name, pose) in zip(np.resize(_COLOURS, len(clouds)), clouds.items(), strict=True):
        xyz = se3.apply(pose, rig.clouds[name].xyz)
        for axes, up in ((above, 1), (section, 2)):
            part = _shown(xyz, up)
            first, second = (0, 1) if up == 1 else (1, 2)
            style = {"s": 1.0, "color": colour, "linewidths": 0, "alpha": 0.6, "label": name}
            axes.scatter(part[:, first], part[:, second], **style)
    for name, pose in rig.graph.solution.poses.items():
        (x, y), ahead = (level @ pose)[:2, 3], (level @ pose)[:2, 2 if kinds[name] == "camera" else 0]
        sensors.arrow(x, y, *(0.3 * ahead), width=0.01, color="tab:gray" if kinds[name] == "camera" else "black")
        sensors.annotate(name, (x + 0.4 * ahead[0], y + 0.4 * ahead[1]), fontsize=8, ha="center", va="center")
    sensors.margins(0.3)
    for axes, title, labels in (
        (above, "from above", "xy"),
        (section, f"cross-section, |x| < {_SLICE_M:g} m", "yz"),
        (sensors, "sensors from above, arrows ahead", "xy"),
    ):
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=title, xlabel=f"{labels[0]} [m]", ylabel=f"{labels[1]} [m]")
    if clouds:
        above.legend(markerscale=10, loc="upper right")
    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _shown(xyz: Float, up: int) -> Float:
    """Return the points (M, 3) that a view shows: from above those near the height of the sensors, else a slice."""
    near = np.abs(xyz[:, :2]).max(axis=1) < _REACH_M
    near &= np.abs(xyz[:, 2]) < _HEIGHT_M if up == 1 else np.abs(xyz[:, 0]) < _SLICE_M
    rows = np.flatnonzero(near)
    return xyz[rows[:: max(1, len(rows) // _MAX_POINTS)]]
