"""Find the edges of a sensor graph that contradict all others: leave-one-out tests ("data snooping", Baarda 1968).

The chi-square of an edge is the decrease of the sum over all edges if it is left out, with six degrees of freedom. The
edge whose omission explains a contradiction is excluded. Often several edges explain it equally well: all edges of a
single loop do, and both edges of a camera that is connected with two LiDARs and nothing else. Then all of them are
excluded, unless one is the only one that is not trusted on its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from p2o.arrays import Float
from p2o.geometry import se3
from p2o.geometry.pose_error import place_by_update

from p2o_rig.sensor_graph import Edge, GraphSolution, reachable, solve, spanning_tree

_MIN_P = 0.01
"""Edges contradict each other below this p-value, which is corrected for the number of edges."""
_MIN_DIFFERENCE = 9.21
"""Edges explain a contradiction equally well below this difference of chi-square: odds of 100 to 1."""
_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class EdgeCheck:
    """An edge compared with the pose that follows from all others.

    `step` (6,) are rotation vector and displacement of the child from the predicted to the measured pose in the
    parent's frame (rad, m), `sigmas` (6,) their standard deviations; `chi_square` has six degrees of freedom, `p_value`
    is its p-value.
    """

    step: Float
    sigmas: Float
    chi_square: float
    p_value: float

    @property
    def rotation_deg(self) -> float:
        """Difference of the orientations in degrees."""
        return float(np.degrees(np.linalg.norm(self.step[:3])))

    @property
    def translation_m(self) -> float:
        """Difference of the positions in m."""
        return float(np.linalg.norm(self.step[3:]))

    @property
    def text(self) -> str:
        """The axis with the largest difference relative to its standard deviation, in words."""
        ratios = np.abs(self.step) / self.sigmas
        axis = int(np.argmax(ratios))
        if axis < 3:
            size = f"{np.degrees(abs(self.step[axis])):.2g} deg about {_AXES[axis]}"
        else:
            size = f"{abs(self.step[axis]):.2g} m along {_AXES[axis - 3]}"
        return f"{size}, {ratios[axis]:.1f} sigma"


@dataclass(frozen=True, eq=False)
class Contradiction:
    """Excluded edges: one that contradicts all others, or several of which at least one has to be wrong."""

    edges: tuple[Edge, ...]
    text: str


@dataclass(frozen=True, eq=False)
class ConsistentGraph:
    """The solution of the edges that are `used`, the check of edges by name, and the contradictions.

    Edges in no loop have no check: nothing else measures them.
    """

    solution: GraphSolution
    used: tuple[Edge, ...]
    checks: Mapping[str, EdgeCheck]
    contradictions: tuple[Contradiction, ...]


def consistent(edges: Sequence[Edge], reference: str) -> ConsistentGraph:
    """Solve the graph and exclude edges until all others agree.

    Each exclusion takes one solution: how much chi-square decreases without an edge follows from its residual and its
    leverage. Edges that are not connected with the reference are ignored. Raises as `solve`.
    """
    used = list(edges)
    excluded: list[tuple[list[Edge], bool]] = []
    while True:
        poses = reachable(used, reference)
        used = [edge for edge in used if edge.parent in poses]
        whole, loops = solve(used, reference), _loops(used, reference)
        checks = {edge.name: _check_fitted(edge, whole) for edge in used if loops[edge]}
        least = min((check.p_value * len(checks) for check in checks.values()), default=1.0)
        if not checks or min(whole.p_value, least) >= _MIN_P:
            break
        gains = {edge: checks[edge.name].chi_square for edge in used if loops[edge]}
        best = max(gains, key=gains.__getitem__)
        limit = gains[best] - _MIN_DIFFERENCE
        rivals = [edge for edge, gain in gains.items() if loops[edge] == loops[best] or gain > limit]
        doubted = [edge for edge in rivals if not edge.trusted]
        by_trust = len(rivals) > 1 and len(doubted) == 1
        excluded.append((doubted if by_trust else rivals, by_trust))
        used = [edge for edge in used if edge not in excluded[-1][0]]
    checks |= {
        edge.name: _check(edge, whole)
        for group, _ in excluded
        for edge in group
        if edge.parent in whole.poses and edge.child in whole.poses
    }
    contradictions = tuple(Contradiction(tuple(group), _text(group, checks, by_trust)) for group, by_trust in excluded)
    return ConsistentGraph(whole, tuple(used), checks, contradictions)


def _loops(edges: Sequence[Edge], reference: str) -> dict[Edge, int]:
    """Return the set of independent loops that contain each edge, as the bits of an integer; 0 for an edge in no loop.

    Each edge outside the spanning tree closes one loop. Edges with the same loops are in series: the omission of any of
    them opens the same loops, so that all explain a contradiction equally well.
    """
    tree = spanning_tree(edges, reference)
    in_tree = {edge for edge, _, _ in tree}
    loops = {edge: 1 << number for number, edge in enumerate(edge for edge in edges if edge not in in_tree)}
    through = dict.fromkeys((reference, *(added for _, _, added in tree)), 0)
    for edge, loop in loops.items():
        through[edge.parent] ^= loop
        through[edge.child] ^= loop
    for edge, known, added in reversed(tree):
        loops[edge] = through[added]
        through[known] ^= through[added]
    return loops


def _check(edge: Edge, others: GraphSolution) -> EdgeCheck:
    """Compare an edge with the solution of others."""
    predicted, covariance = others.relative(edge.parent, edge.child)
    step = se3.log(edge.parent_from_child @ se3.inverse(predicted))
    return _edge_check(edge, step, edge.covariance + covariance)


def _check_fitted(edge: Edge, whole: GraphSolution) -> EdgeCheck:
    """Compare an edge with all others, from the solution that was fitted to it, too.

    The fitted pose is the mean of measurement and prediction, weighted by the inverse of their covariances; to first
    order the prediction follows from it. Residual and covariance are the share measured / (measured + predicted) of
    those of the difference.
    """
    fitted, covariance = whole.relative(edge.parent, edge.child)
    step = se3.log(edge.parent_from_child @ se3.inverse(fitted))
    share = edge.covariance @ np.linalg.pinv(edge.covariance - covariance, hermitian=True)
    return _edge_check(edge, share @ step, share @ edge.covariance)


def _edge_check(edge: Edge, update: Float, covariance: Float) -> EdgeCheck:
    """Return the check for a left update (6,) from the predicted to the measured pose, with its covariance (6, 6)."""
    from scipy.stats import chi2

    chi_square = float(update @ np.linalg.solve(covariance, update))
    by_update = place_by_update(edge.parent_from_child)
    step, covariance = by_update @ update, by_update @ covariance @ by_update.T
    return EdgeCheck(step, np.sqrt(np.abs(np.diag(covariance))), chi_square, float(chi2.sf(chi_square, 6)))


def _text(edges: Sequence[Edge], checks: Mapping[str, EdgeCheck], by_trust: bool) -> str:
    if len(edges) > 1:
        names = ", ".join(sorted(edge.name for edge in edges))
        return f"one of {names} is wrong, and no other edge identifies it: they are excluded"
    [edge] = edges
    check = checks.get(edge.name)
    size = "" if check is None else f" by {check.text}, in the frame of {edge.parent}"
    why = "it is the only one of its loop that is not trusted on its own" if by_trust else "without it all others agree"
    return f"{edge.name} disagrees with the others{size}; it is excluded: {why}"
