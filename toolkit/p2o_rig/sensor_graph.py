"""Pose graph of the sensors of a body: measured relative poses as edges, solved by Ceres (package pyceres)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from p2o.arrays import Float, checked
from p2o.errors import InputError, MethodUnavailable
from p2o.geometry import se3
from p2o.geometry.motion import adjoint_matrix
from p2o.runtime.native import import_keeping_signals

_MIN_CONDITION = 1e-14
"""Minimum ratio of the eigenvalues of a covariance whose units are rad and m."""


class EdgeKind(StrEnum):
    """Source of an edge: a result of `p2o run`, aligned sweeps of two LiDARs, or a transform that the user knows."""

    RESULT = "result"
    SWEEPS = "sweeps"
    KNOWN = "known"


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured relative pose: `parent_from_child` (4, 4) with the `covariance` (6, 6) of its left update (rad, m).

    `trusted` is whether the measurement needs no confirmation by others; `source` states where it comes from. Raises
    InputError for an edge from a sensor to itself, a pose that is not rigid, and a covariance that is not positive.
    """

    parent: str
    child: str
    parent_from_child: Float
    covariance: Float
    kind: EdgeKind
    trusted: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        if self.parent == self.child:
            raise InputError(f"an edge connects {self.parent} with itself", expected="two sensors")
        pose = se3.check_rigid(f"the pose of {self.name}", self.parent_from_child)
        covariance = checked(f"the covariance of {self.name}", self.covariance, (6, 6), np.float64)
        values = np.linalg.eigvalsh((covariance + covariance.T) / 2)
        if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=0.0) or values[0] <= _MIN_CONDITION * values[-1]:
            expected = "a symmetric matrix with positive eigenvalues"
            raise InputError(f"the covariance of {self.name} is not valid", expected=expected, got=f"{values[0]:.2g}")
        object.__setattr__(self, "parent_from_child", pose)
        object.__setattr__(self, "covariance", (covariance + covariance.T) / 2)

    @property
    def name(self) -> str:
        """Name in messages: both sensors and the kind."""
        return edge_name(self.parent, self.child, self.kind)

    @property
    def size(self) -> float:
        """Standard deviation for the comparison of edges: that of a point at a distance of 10 m, in m."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(100.0 * variances[:3].sum() + variances[3:].sum()))


@dataclass(frozen=True)
class LeftOut:
    """A measurement that gives no edge, and the reason."""

    parent: str
    child: str
    kind: EdgeKind
    reason: str

    @property
    def name(self) -> str:
        """Name in messages, as that of an edge."""
        return edge_name(self.parent, self.child, self.kind)


def edge_name(parent: str, child: str, kind: EdgeKind) -> str:
    """Return the name of an edge in messages: both sensors and the kind."""
    return f"{parent}-{child} ({kind})"


@dataclass(frozen=True, eq=False)
class GraphSolution:
    """Poses of the sensors that fit all edges best.

    `poses` maps sensors to reference_from_sensor (4, 4), the reference included. `covariance` (6 n, 6 n) is that of
    their left updates in the reference frame (rad, m), in the order of `sensors`, which leaves out the reference.
    `chi_square` is the sum over the edges, with `degrees` degrees of freedom.
    """

    reference: str
    poses: Mapping[str, Float]
    sensors: tuple[str, ...]
    covariance: Float
    chi_square: float
    degrees: int

    @property
    def p_value(self) -> float:
        """Probability of a larger chi-square if all edges are correct; 1 without loops."""
        from scipy.stats import chi2

        return float(chi2.sf(self.chi_square, self.degrees)) if self.degrees else 1.0

    def covariance_of(self, sensor: str) -> Float:
        """Return the covariance (6, 6) of the left update of a sensor's pose, zero for the reference."""
        return self._block(sensor, sensor)

    def relative(self, parent: str, child: str) -> tuple[Float, Float]:
        """Return parent_from_child (4, 4) and the covariance (6, 6) of its left update in the parent's frame."""
        parent_from_reference = se3.inverse(self.poses[parent])
        both = self._block(parent, parent) + self._block(child, child)
        cross = self._block(parent, child)
        to_parent = adjoint_matrix(parent_from_reference)
        covariance = to_parent @ (both - cross - cross.T) @ to_parent.T
        return parent_from_reference @ self.poses[child], (covariance + covariance.T) / 2

    def _block(self, first: str, second: str) -> Float:
        if self.reference in (first, second):
            return np.zeros((6, 6))
        row, column = 6 * self.sensors.index(first), 6 * self.sensors.index(second)
        return self.covariance[row : row + 6, column : column + 6]


def reachable(edges: Sequence[Edge], reference: str) -> dict[str, Float]:
    """Return reference_from_sensor (4, 4) of all sensors that edges connect with the reference.

    The poses follow from the spanning tree of the edges with the smallest standard deviations.
    """
    poses: dict[str, Float] = {reference: np.eye(4)}
    remaining = sorted(edges, key=lambda edge: (edge.size, edge.name))
    while True:
        edge = next((edge for edge in remaining if (edge.parent in poses) != (edge.child in poses)), None)
        if edge is None:
            return poses
        if edge.parent in poses:
            poses[edge.child] = poses[edge.parent] @ edge.parent_from_child
        else:
            poses[edge.parent] = poses[edge.child] @ se3.inverse(edge.parent_from_child)


def solve(edges: Sequence[Edge], reference: str) -> GraphSolution:
    """Return the poses that minimise the sum of the squared Mahalanobis distances of the edges.

    Edges that are not connected with the reference are ignored. Raises MethodUnavailable without pyceres.
    """
    pyceres = _pyceres()
    poses = reachable(edges, reference)
    edges = [edge for edge in edges if edge.parent in poses]
    sensors = tuple(sorted(set(poses) - {reference}))
    if not sensors:
        return GraphSolution(reference, poses, (), np.zeros((0, 0)), 0.0, 0)
    cost_class = _edge_cost(pyceres)
    for _ in range(2):  # again from the result, where derivatives by the parameters are those by left updates
        deltas = {sensor: np.zeros(6) for sensor in (*sensors, reference)}
        problem, costs = pyceres.Problem(), []
        for edge in edges:
            # Python must keep the costs alive, since Ceres holds plain pointers to them.
            costs.append(cost_class(edge, poses[edge.parent], poses[edge.child]))
            problem.add_residual_block(costs[-1], None, [deltas[edge.parent], deltas[edge.child]])
        problem.set_parameter_block_constant(deltas[reference])
        settings, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        settings.max_num_iterations = 200
        settings.function_tolerance = settings.gradient_tolerance = settings.parameter_tolerance = 1e-14
        settings.linear_solver_type = pyceres.LinearSolverType.DENSE_QR
        settings.num_threads = 1
        settings.logging_type = pyceres.LoggingType.SILENT
        pyceres.solve(settings, problem, summary)
        poses = {sensor: se3.exp(deltas[sensor]) @ pose for sensor, pose in poses.items()}
    covariance = _covariance(pyceres, problem, [deltas[sensor] for sensor in sensors])
    degrees = 6 * (len(edges) - len(sensors))
    return GraphSolution(reference, poses, sensors, covariance, 2 * float(summary.final_cost), degrees)


def _covariance(pyceres: Any, problem: Any, blocks: Sequence[Float]) -> Float:
    """Return the joint covariance (6 n, 6 n) of parameter blocks."""
    options = pyceres.CovarianceOptions()
    options.algorithm_type = pyceres.CovarianceAlgorithmType.DENSE_SVD
    options.num_threads = 1
    estimate, count = pyceres.Covariance(options), len(blocks)
    pairs = [(blocks[i], blocks[j]) for i in range(count) for j in range(i, count)]
    if not estimate.compute(pairs, problem):
        raise InputError("the poses of the sensors are not observable", hint="check the covariances of the edges")
    out = np.zeros((6 * count, 6 * count))
    for i in range(count):
        for j in range(i, count):
            block = np.asarray(estimate.get_covariance_block(blocks[i], blocks[j])).reshape(6, 6)
            out[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = block
            out[6 * j : 6 * j + 6, 6 * i : 6 * i + 6] = block.T
    return out


def _edge_cost(pyceres: Any) -> Any:
    class EdgeCost(pyceres.CostFunction):  # type: ignore[misc]
        """Whitened left update between the measured and the estimated pose of one edge.

        The parameters are left updates (6,) of reference_from_parent and reference_from_child.
        """

        def __init__(self, edge: Edge, parent: Float, child: Float) -> None:
            super().__init__()
            self.poses, self.child_from_parent = (parent, child), se3.inverse(edge.parent_from_child)
            self.whiten = np.linalg.inv(np.linalg.cholesky(edge.covariance))
            self.set_num_residuals(6)
            self.set_parameter_block_sizes([6, 6])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802 (named by Ceres)
            deltas = [np.array(parameter) for parameter in parameters]
            parent, child = (se3.exp(delta) @ pose for delta, pose in zip(deltas, self.poses, strict=True))
            parent_from_reference = se3.inverse(parent)
            update = se3.log(parent_from_reference @ child @ self.child_from_parent)
            residuals[:] = self.whiten @ update
            if jacobians is not None:
                by_left = self.whiten @ _inverse_left_jacobian(update) @ adjoint_matrix(parent_from_reference)
                for jacobian, delta, sign in zip(jacobians, deltas, (-1.0, 1.0), strict=True):
                    if jacobian is not None:
                        jacobian[:] = (sign * by_left @ np.linalg.inv(_inverse_left_jacobian(delta))).ravel()
            return True

    return EdgeCost


def _inverse_left_jacobian(tangent: Float) -> Float:
    """Return the inverse left Jacobian (6, 6) of SE(3), by its series to the fourth order (Barfoot 2017, eq. 7.84)."""
    turn, shift = se3.skew(tangent[:3]), se3.skew(tangent[3:])
    small = np.block([[turn, np.zeros((3, 3))], [shift, turn]])
    square = small @ small
    return np.asarray(np.eye(6) - small / 2 + square / 12 - square @ square / 720)


def _pyceres() -> Any:
    try:
        return import_keeping_signals("pyceres")
    except ModuleNotFoundError as problem:
        hint = 'run: pip install "p2o-calib[ceres]"'
        raise MethodUnavailable("p2o rig needs the package pyceres, which is not installed", hint=hint) from problem
