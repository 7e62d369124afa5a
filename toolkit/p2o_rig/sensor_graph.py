"""Pose graph of the sensors of a body: measured relative poses as edges, solved by least squares on SE(3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from heapq import heappop, heappush

import numpy as np
from p2o.arrays import Float, Int, checked
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.motion import adjoint_matrix

_MIN_CONDITION = 1e-14
"""Minimum ratio of the eigenvalues of a covariance whose units are rad and m."""
_MAX_STEPS, _SMALL_STEP, _MIN_DAMPING = 100, 1e-12, 1e-6
"""Largest number of steps, the step (rad, m) at which a solution has converged, and the smallest damping."""


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
        return f"{self.parent}-{self.child} ({self.kind})"

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
        return f"{self.parent}-{self.child} ({self.kind})"


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


def spanning_tree(edges: Sequence[Edge], reference: str) -> list[tuple[Edge, str, str]]:
    """Return the tree of the edges with the smallest standard deviations, from the reference on (Prim, 1957).

    Each element is an edge, its sensor that an earlier edge reaches, and its sensor that it adds.
    """
    beside: dict[str, list[tuple[Edge, str]]] = {}
    for edge in edges:
        beside.setdefault(edge.parent, []).append((edge, edge.child))
        beside.setdefault(edge.child, []).append((edge, edge.parent))
    tree: list[tuple[Edge, str, str]] = []
    queue: list[tuple[float, str, int, Edge, str, str]] = []
    reached, added = {reference}, reference
    while True:
        for edge, other in beside.get(added, ()):
            heappush(queue, (edge.size, edge.name, id(edge), edge, added, other))
        while queue and queue[0][-1] in reached:
            heappop(queue)
        if not queue:
            return tree
        *_, edge, known, added = heappop(queue)
        reached.add(added)
        tree.append((edge, known, added))


def reachable(edges: Sequence[Edge], reference: str) -> dict[str, Float]:
    """Return reference_from_sensor (4, 4) of all sensors that edges connect with the reference, by `spanning_tree`."""
    poses: dict[str, Float] = {reference: np.eye(4)}
    for edge, known, added in spanning_tree(edges, reference):
        step = edge.parent_from_child if added == edge.child else se3.inverse(edge.parent_from_child)
        poses[added] = poses[known] @ step
    return poses


def solve(edges: Sequence[Edge], reference: str) -> GraphSolution:
    """Return the poses that minimise the sum of the squared Mahalanobis distances of the edges.

    Levenberg-Marquardt on SE(3) from the poses of the spanning tree (Barfoot, State Estimation for Robotics, 2017,
    section 8.4). Edges that are not connected with the reference are ignored. Raises InputError if the covariances
    of the edges determine the poses too badly.
    """
    poses = reachable(edges, reference)
    edges = [edge for edge in edges if edge.parent in poses]
    sensors = tuple(sorted(set(poses) - {reference}))
    if not sensors:
        return GraphSolution(reference, poses, (), np.zeros((0, 0)), 0.0, 0)
    problem = _Problem.of(edges, sensors)
    x = np.stack([poses[sensor] for sensor in (*sensors, reference)])
    cost, damping = problem.cost(x), 0.0
    for _ in range(_MAX_STEPS):
        normal, gradient = problem.normal_equations(x)
        step = -_inverse(normal, damping) @ gradient
        moved = x.copy()
        moved[:-1] = se3.exp(step.reshape(-1, 6)) @ x[:-1]
        lower = problem.cost(moved)
        if lower <= cost:
            x, cost, damping = moved, lower, damping / 10 if damping > _MIN_DAMPING else 0.0
        elif np.abs(step).max() > _SMALL_STEP:
            damping = max(10 * damping, _MIN_DAMPING)
            continue
        if np.abs(step).max() <= _SMALL_STEP:
            break
    covariance = _inverse(problem.normal_equations(x)[0])
    poses = dict(zip((*sensors, reference), x, strict=True))
    return GraphSolution(reference, poses, sensors, covariance, cost, 6 * (len(edges) - len(sensors)))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The edges (E) of a graph as arrays: row numbers of their sensors, measured child_from_parent, whitening.

    Poses (n + 1, 4, 4) are those of the sensors and, last, of the reference.
    """

    parent: Int
    child: Int
    child_from_parent: Float
    whiten: Float

    @classmethod
    def of(cls, edges: Sequence[Edge], sensors: Sequence[str]) -> _Problem:
        row = {sensor: number for number, sensor in enumerate(sensors)}
        parent = np.array([row.get(edge.parent, len(sensors)) for edge in edges])
        child = np.array([row.get(edge.child, len(sensors)) for edge in edges])
        measured = np.stack([edge.parent_from_child for edge in edges])
        whiten = np.asarray(
            np.linalg.inv(np.linalg.cholesky(np.stack([edge.covariance for edge in edges]))), np.float64
        )
        return cls(parent, child, se3.inverse(measured), whiten)

    def updates(self, poses: Float) -> Float:
        """Return the left updates (E, 6) from the measured to the estimated relative poses."""
        return _log(se3.inverse(poses[self.parent]) @ poses[self.child] @ self.child_from_parent)

    def cost(self, poses: Float) -> float:
        """Return the sum of the squared Mahalanobis distances."""
        return float(np.sum(np.einsum("eij,ej->ei", self.whiten, self.updates(poses)) ** 2))

    def normal_equations(self, poses: Float) -> tuple[Float, Float]:
        """Return the normal matrix (6 n, 6 n) and the gradient (6 n,) by left updates of the poses."""
        updates, count = self.updates(poses), len(poses)
        # A left update d of the child is the update Ad(parent_from_reference) d of the relative pose, one of the
        # parent is its opposite.
        by_child = self.whiten @ _inverse_left_jacobians(updates) @ _adjoints(se3.inverse(poses[self.parent]))
        information = np.swapaxes(by_child, 1, 2) @ by_child
        slope = np.einsum("eji,ejk,ek->ei", by_child, self.whiten, updates)
        normal, gradient = np.zeros((count, count, 6, 6)), np.zeros((count, 6))
        for first, second, sign in (
            (self.child, self.child, 1.0),
            (self.parent, self.parent, 1.0),
            (self.child, self.parent, -1.0),
            (self.parent, self.child, -1.0),
        ):
            np.add.at(normal, (first, second), sign * information)
        np.add.at(gradient, self.child, slope)
        np.add.at(gradient, self.parent, -slope)
        free = 6 * (count - 1)
        return normal[:-1, :-1].transpose(0, 2, 1, 3).reshape(free, free), gradient[:-1].ravel()


def _inverse(normal: Float, damping: float = 0.0) -> Float:
    """Return the inverse of a normal matrix, with its diagonal enlarged by the share `damping` (Marquardt)."""
    scale = 1 / np.sqrt(np.diag(normal))
    scaled = normal * scale[:, None] * scale + damping * np.eye(len(normal))
    try:
        lower = np.linalg.inv(np.linalg.cholesky(scaled))
    except np.linalg.LinAlgError as problem:
        text = "the poses of the sensors are not observable"
        raise InputError(text, hint="check the covariances of the edges") from problem
    return np.asarray(lower.T @ lower * scale[:, None] * scale)


def _log(transforms: Float) -> Float:
    """Return the tangent vectors (E, 6) of transforms (E, 4, 4), as `se3.log` of each."""
    omega = se3.rotation_vector(transforms[:, :3, :3])
    angle, cross = np.linalg.norm(omega, axis=1), se3.skew(omega)
    safe = np.maximum(angle, 1e-3)
    factor = np.where(angle < 1e-3, 1 / 12 + angle**2 / 720, 1 / safe**2 - 1 / (2 * safe * np.tan(safe / 2)))
    inverse_v = np.eye(3) - 0.5 * cross + factor[:, None, None] * (cross @ cross)
    return np.concatenate([omega, np.einsum("eij,ej->ei", inverse_v, transforms[:, :3, 3])], axis=1)


def _adjoints(transforms: Float) -> Float:
    """Return the adjoints (E, 6, 6) of transforms (E, 4, 4)."""
    rotation = transforms[:, :3, :3]
    out = np.zeros((len(transforms), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = rotation
    out[:, 3:, :3] = se3.skew(transforms[:, :3, 3]) @ rotation
    return out


def _inverse_left_jacobians(tangents: Float) -> Float:
    """Return the inverse left Jacobians (E, 6, 6) of SE(3), to the fourth order (Barfoot 2017, eq. 7.84)."""
    small = np.zeros((len(tangents), 6, 6))
    small[:, :3, :3] = small[:, 3:, 3:] = se3.skew(tangents[:, :3])
    small[:, 3:, :3] = se3.skew(tangents[:, 3:])
    square = small @ small
    return np.asarray(np.eye(6) - small / 2 + square / 12 - square @ square / 720)
