"""Estimate the extrinsics of all sensors of a body: align sweeps, solve the graph, assess every sensor."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from p2o.arrays import Float
from p2o.confidence.fusion import WIDER
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Dataset, Frame
from p2o.frames.selection import spread
from p2o.geometry import se3
from p2o.geometry.pose_error import deviations
from p2o.host.registry import Registry
from p2o.results.evidence import Accuracy
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.run.recipe import open_dataset

from p2o_rig.alignment import align_sweeps
from p2o_rig.contradictions import ConsistentGraph, consistent
from p2o_rig.sensor_graph import Edge, EdgeKind, LeftOut, reachable
from p2o_rig.sensors_file import Sensors


@dataclass(frozen=True, eq=False)
class SensorPose:
    """Pose of a sensor: `reference_from_sensor` (4, 4), None if no edge connects it with the reference.

    `covariance` (6, 6) is that of a left update in the reference frame (rad, m), `accuracy` the predicted error.
    """

    name: str
    kind: str
    verdict: Verdict
    reference_from_sensor: Float | None = None
    covariance: Float | None = None
    accuracy: Accuracy | None = None


@dataclass(frozen=True, eq=False)
class RigExtrinsics:
    """Consistent extrinsics of all sensors: poses, the graph that they result from, and the `verdict` on the whole.

    `edges` are all measurements, `left_out` those that give no edge. `clouds` are sweeps of one moment by LiDAR, for
    figures.
    """

    reference: str
    sensors: tuple[SensorPose, ...]
    edges: tuple[Edge, ...]
    graph: ConsistentGraph
    left_out: tuple[LeftOut, ...]
    verdict: Verdict
    warnings: tuple[str, ...]
    clouds: Mapping[str, Cloud]

    def pose(self, sensor: str) -> Float | None:
        """Return reference_from_sensor (4, 4) of a sensor, None if it has none."""
        return self.graph.solution.poses.get(sensor)


def estimate_extrinsics(sensors: Sensors, registry: Registry) -> RigExtrinsics:
    """Align the sweeps of LiDARs, solve the graph of all edges, and assess every sensor.

    Raises MethodUnavailable for sweeps without small_gicp, and as the data sets do.
    """
    edges, left_out = list(sensors.edges), list(sensors.left_out)
    clouds: dict[str, Cloud] = {}
    datasets = {name: open_dataset(data, registry) for name, data in sensors.sweeps.items()}
    for first, second in combinations(datasets, 2):
        guess = _guess(sensors, first, second)
        if guess is None:
            text = "there is no initial guess; expected results with common cameras, or body_from_lidar of both"
            left_out.append(LeftOut(first, second, EdgeKind.SWEEPS, text))
            continue
        try:
            pairs = simultaneous(datasets[first], datasets[second], sensors.moments)
            alignment = align_sweeps(pairs, guess)
        except InputError as problem:
            left_out.append(LeftOut(first, second, EdgeKind.SWEEPS, str(problem)))
            continue
        source = f"{alignment.used} of {alignment.moments} moments, overlap {alignment.overlap:.0%}"
        edges.append(
            Edge(first, second, alignment.first_from_second, alignment.covariance, EdgeKind.SWEEPS, source=source)
        )
        clouds = {first: pairs[0][0], second: pairs[0][1]} | clouds
    graph = consistent(edges, sensors.reference)
    poses = _assessed(sensors, graph, left_out)
    verdict = Verdict(tuple(_reasons(poses, graph)))
    return RigExtrinsics(
        sensors.reference, poses, tuple(edges), graph, tuple(left_out), verdict, sensors.warnings, clouds
    )


def simultaneous(first: Dataset, second: Dataset, most: int) -> list[tuple[Cloud, Cloud]]:
    """Return up to `most` pairs of sweeps, spread over the frames that have the same name in both data sets.

    Frames of several cameras with one sweep count once. Sweeps are motion-compensated where the velocity is known.
    Raises InputError if no names agree.
    """
    at = {name: index for index, name in enumerate(second.names)}
    common = [(index, at[name]) for index, name in enumerate(first.names) if name in at]
    if not common:
        names = f"{first.names[0]} and {second.names[0]}" if len(first) and len(second) else "no frames"
        raise InputError("no frames of the two LiDARs have the same name", expected="one name per moment", got=names)
    seen: set[bytes] = set()
    pairs: list[tuple[Cloud, Cloud]] = []
    chosen = spread(range(len(common)), most)
    for index in (*chosen, *(set(range(len(common))) - set(chosen))):
        if len(pairs) == most:
            break
        clouds = [_compensated(dataset[i]) for dataset, i in zip((first, second), common[index], strict=True)]
        key = hashlib.sha256(clouds[0].xyz.tobytes()).digest()
        if key not in seen:
            seen.add(key)
            pairs.append((clouds[0], clouds[1]))
    return pairs


def _compensated(frame: Frame) -> Cloud:
    cloud = frame.cloud if frame.sweep is None else frame.sweep
    return cloud if cloud.twist is not None or frame.twist is None else cloud.untwisted(frame.twist)


def _guess(sensors: Sensors, first: str, second: str) -> Float | None:
    """Return the initial guess of first_from_second (4, 4), None if there is none."""
    if first in sensors.guesses and second in sensors.guesses:
        return se3.inverse(sensors.guesses[first]) @ sensors.guesses[second]
    poses = reachable(sensors.edges, first)
    return poses.get(second)


def _assessed(sensors: Sensors, graph: ConsistentGraph, left_out: Sequence[LeftOut]) -> tuple[SensorPose, ...]:
    solution = graph.solution
    # If the edges scatter more than their covariances predict, inflate the covariances (Birge ratio).
    inflation = max(1.0, solution.chi_square / solution.degrees) if solution.degrees else 1.0
    trusted = [edge for edge in graph.used if edge.trusted or edge.name in graph.checks]
    confirmed = reachable(trusted, sensors.reference)
    out = []
    for name in (*sensors.lidars, *sensors.cameras):
        kind = "lidar" if name in sensors.lidars else "camera"
        if name not in solution.poses:
            text = f"no edge connects {name} with {sensors.reference}{_cause(name, graph, left_out)}"
            out.append(SensorPose(name, kind, Verdict((Reason(Doubt.NOT_SOLVED, text),))))
            continue
        reasons = []
        if name not in confirmed:
            text = f"a result that is not trusted connects {name} with {sensors.reference}, and no loop confirms it"
            reasons.append(Reason(Doubt.NOT_CHECKED, text))
        pose, covariance = solution.poses[name], inflation * solution.covariance_of(name)
        turn_deg, shift_m = deviations(covariance, pose)
        accuracy = Accuracy(turn_deg, shift_m, WIDER * turn_deg, WIDER * shift_m)
        out.append(SensorPose(name, kind, Verdict(tuple(reasons)), pose, covariance, accuracy))
    return tuple(out)


def _cause(sensor: str, graph: ConsistentGraph, left_out: Sequence[LeftOut]) -> str:
    """Return which of its edges are not used, and why."""
    excluded = [edge.name for one in graph.contradictions for edge in one.edges if sensor in (edge.parent, edge.child)]
    texts = [f"{name} is excluded" for name in excluded]
    texts += [f"{one.name} is left out" for one in left_out if sensor in (one.parent, one.child)]
    return f" ({', '.join(texts)})" if texts else ""


def _reasons(sensors: Sequence[SensorPose], graph: ConsistentGraph) -> list[Reason]:
    reasons = [Reason(Doubt.CONTRADICTION, one.text) for one in graph.contradictions if len(one.edges) > 1]
    lost = [sensor.name for sensor in sensors if sensor.reference_from_sensor is None]
    if lost:
        reasons.append(Reason(Doubt.NOT_CHECKED, f"there is no pose of {', '.join(lost)}"))
    doubted = [
        sensor.name for sensor in sensors if sensor.reference_from_sensor is not None and not sensor.verdict.trusted
    ]
    if doubted:
        reasons.append(Reason(Doubt.NOT_CHECKED, f"the poses of {', '.join(doubted)} are not confirmed"))
    return reasons
