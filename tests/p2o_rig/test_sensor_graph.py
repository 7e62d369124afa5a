"""The graph of sensors: exact edges give exact poses, covariances are those of linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.motion import adjoint_matrix
from p2o_rig.sensor_graph import Edge, EdgeKind, solve

from tests.p2o_rig.random_rigs import measured, random_covariance, random_rig


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.mark.parametrize(("lidars", "cameras"), [(2, 1), (4, 6)])
def test_exact_edges_give_the_exact_poses(lidars: int, cameras: int, rng: np.random.Generator) -> None:
    rig = random_rig(rng, lidars, cameras, noise=0.0)
    solution = solve(rig.edges, "lidar0")
    assert set(solution.poses) == set(rig.truth)
    for name, pose in rig.truth.items():
        np.testing.assert_allclose(solution.poses[name], pose, atol=1e-12)
    assert solution.chi_square < 1e-12
    assert solution.degrees == 6 * (len(rig.edges) - len(rig.truth) + 1)
    assert solution.p_value == 1.0


def test_the_order_of_edges_and_their_direction_do_not_matter(rng: np.random.Generator) -> None:
    rig = random_rig(rng, 2, 2)
    solution = solve(rig.edges, "lidar0")
    reversed_edges = []
    for number in rng.permutation(len(rig.edges)):
        edge = rig.edges[number]
        child_from_parent = se3.inverse(edge.parent_from_child)
        to_child = adjoint_matrix(child_from_parent)
        covariance = to_child @ edge.covariance @ to_child.T
        reversed_edges.append(Edge(edge.child, edge.parent, child_from_parent, covariance, edge.kind))
    for edges in (rig.edges[::-1], reversed_edges):
        again = solve(edges, "lidar0")
        assert again.chi_square == pytest.approx(solution.chi_square, rel=1e-6)
        for name in solution.sensors:
            np.testing.assert_allclose(again.poses[name], solution.poses[name], atol=1e-8)
            np.testing.assert_allclose(again.covariance_of(name), solution.covariance_of(name), rtol=1e-4, atol=1e-12)


def test_the_covariance_of_a_chain_is_the_sum_of_those_of_its_links_in_the_frame_of_the_reference(
    rng: np.random.Generator,
) -> None:
    rig = random_rig(rng, 1, 3)
    one, two, three = (random_covariance(rng, 1.0, 0.1) for _ in range(3))
    links = [
        measured(rig.truth, "lidar0", "camera0", one, EdgeKind.KNOWN, rng),
        measured(rig.truth, "camera0", "camera1", two, EdgeKind.KNOWN, rng),
        measured(rig.truth, "camera1", "camera2", three, EdgeKind.KNOWN, rng),
    ]
    solution = solve(links, "lidar0")
    first = links[0].parent_from_child
    second = first @ links[1].parent_from_child
    np.testing.assert_allclose(solution.poses["camera2"], second @ links[2].parent_from_child, atol=1e-10)
    ends = [
        adjoint_matrix(pose) @ covariance @ adjoint_matrix(pose).T
        for pose, covariance in ((first, two), (second, three))
    ]
    np.testing.assert_allclose(solution.covariance_of("camera2"), one + ends[0] + ends[1], rtol=1e-6, atol=1e-12)
    # Seen from camera0, the link before it has no effect.
    _, relative = solution.relative("camera0", "camera1")
    np.testing.assert_allclose(relative, two, rtol=1e-6, atol=1e-12)
    assert solution.chi_square < 1e-12
    assert solution.p_value == 1.0


def test_two_parallel_edges_give_the_mean_weighted_by_their_information(rng: np.random.Generator) -> None:
    rig = random_rig(rng, 1, 1)
    first, second = (
        measured(rig.truth, "camera0", "lidar0", random_covariance(rng, 0.02, 0.002), kind, rng)
        for kind in (EdgeKind.RESULT, EdgeKind.KNOWN)
    )
    solution = solve([first, second], "camera0")
    information = [np.linalg.inv(edge.covariance) for edge in (first, second)]
    covariance = np.linalg.inv(sum(information))
    difference = se3.log(second.parent_from_child @ se3.inverse(first.parent_from_child))
    expected = se3.exp(covariance @ information[1] @ difference) @ first.parent_from_child
    np.testing.assert_allclose(solution.poses["lidar0"], expected, atol=1e-6)
    np.testing.assert_allclose(solution.covariance_of("lidar0"), covariance, rtol=1e-2, atol=1e-9)
    both = first.covariance + second.covariance
    assert solution.chi_square == pytest.approx(difference @ np.linalg.solve(both, difference), rel=1e-2)
    assert solution.degrees == 6


def test_predicted_covariances_are_those_of_the_errors(rng: np.random.Generator) -> None:
    """Squared Mahalanobis distances of 40 poses with six degrees of freedom: their mean is 6 +- 0.55."""
    squares = []
    for _ in range(20):
        rig = random_rig(rng, 1, 2)
        solution = solve(rig.edges, "lidar0")
        for name in solution.sensors:
            error = se3.log(rig.truth[name] @ se3.inverse(solution.poses[name]))
            squares.append(error @ np.linalg.solve(solution.covariance_of(name), error))
    assert 4.5 < np.mean(squares) < 7.5


def test_sensors_without_a_connection_have_no_pose(rng: np.random.Generator) -> None:
    rig = random_rig(rng, 2, 2)
    apart = [edge for edge in rig.edges if {edge.parent, edge.child} in ({"camera0", "lidar0"}, {"camera1", "lidar1"})]
    assert set(solve(apart, "lidar0").poses) == {"lidar0", "camera0"}
    alone = solve([], "lidar0")
    assert (set(alone.poses), alone.sensors, alone.degrees) == ({"lidar0"}, (), 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parent_from_child": np.diag([1.0, 1.0, -1.0, 1.0])}, "mirrors space"),
        ({"parent_from_child": np.diag([2.0, 1.0, 1.0, 1.0])}, "not orthonormal"),
        ({"covariance": np.full((6, 6), np.nan)}, "covariance of a-b"),
        ({"covariance": np.zeros((6, 6))}, "covariance of a-b .* is not valid"),
        ({"covariance": -np.eye(6)}, "is not valid"),
        ({"covariance": np.eye(6) + np.eye(6, k=1)}, "is not valid"),
        ({"covariance": np.eye(5)}, "covariance of a-b"),
        ({"child": "a"}, "connects a with itself"),
    ],
)
def test_invalid_edges_are_refused(change: dict[str, object], message: str) -> None:
    values = {"parent": "a", "child": "b", "parent_from_child": np.eye(4), "covariance": np.eye(6)}
    with pytest.raises(InputError, match=message) as caught:
        Edge(**{**values, "kind": EdgeKind.KNOWN, **change})  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
