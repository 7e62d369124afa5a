"""A wrong edge is the one that is named, and several are named where no edge can decide."""

from __future__ import annotations

import time

import numpy as np
import pytest
from p2o import se3
from p2o_rig.contradictions import consistent
from p2o_rig.sensor_graph import EdgeKind, solve

from tests.p2o_rig.random_rigs import displaced, measured, random_covariance, random_rig


@pytest.mark.parametrize(("seed", "angle_deg"), [(0, 2.0), (1, 10.0), (2, 90.0)])
def test_a_wrong_edge_is_named_and_excluded(seed: int, angle_deg: float) -> None:
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 3, 2)
    wrong = int(rng.integers(len(rig.edges)))
    edges = list(rig.edges)
    edges[wrong] = displaced(edges[wrong], angle_deg, 0.3, rng)
    graph = consistent(edges, "lidar0")
    [one] = graph.contradictions
    assert [edge.name for edge in one.edges] == [edges[wrong].name]
    assert one.text.startswith(f"{edges[wrong].name} disagrees with the others by ")
    assert one.text.endswith("it is excluded: without it all others agree")
    right = solve([edge for edge in edges if edge is not edges[wrong]], "lidar0")
    for name, pose in right.poses.items():
        np.testing.assert_allclose(graph.solution.poses[name], pose, atol=1e-9)
    check = graph.checks[edges[wrong].name]
    assert check.rotation_deg == pytest.approx(angle_deg, rel=0.3)
    assert check.p_value < 1e-4


def test_the_axis_and_the_size_of_a_wrong_edge_are_stated() -> None:
    rng = np.random.default_rng(4)
    rig = random_rig(rng, 3, 2, noise=0.0)
    edges = list(rig.edges)
    number = next(i for i, edge in enumerate(edges) if edge.name == "camera0-lidar1 (result)")
    pose = edges[number].parent_from_child.copy()
    pose[1, 3] += 0.5
    edges[number] = type(edges[number])("camera0", "lidar1", pose, edges[number].covariance, EdgeKind.RESULT)
    [one] = consistent(edges, "lidar0").contradictions
    assert "by 0.5 m along y, " in one.text
    assert "in the frame of camera0" in one.text


@pytest.mark.parametrize("trusted", [True, False])
def test_in_a_single_loop_every_edge_is_suspected_or_the_only_one_without_trust(trusted: bool) -> None:
    rng = np.random.default_rng(8)
    rig = random_rig(rng, 2, 1)
    edges = [displaced(rig.edges[0], 5.0, 0.3, rng, trusted=trusted), *rig.edges[1:]]
    graph = consistent(edges, "lidar0")
    [one] = graph.contradictions
    assert {edge.name for edge in one.edges} == {edge.name for edge in (edges if trusted else edges[:1])}
    begin = "one of camera0-lidar0 (result), camera0-lidar1 (result), lidar0-lidar1 (sweeps) is"
    end = "it is the only one of its loop that is not trusted on its own"
    assert one.text.startswith(begin) if trusted else one.text.endswith(end)
    assert set(graph.solution.poses) == ({"lidar0"} if trusted else set(rig.truth))


def test_a_contradictory_ring_of_a_hundred_sensors_is_decided_in_seconds() -> None:
    rng = np.random.default_rng(14)
    truth = {f"sensor{i}": se3.exp(rng.normal(size=6)) for i in range(100)}
    pairs = [(f"sensor{i}", f"sensor{(i + 1) % 100}") for i in range(100)]
    edges = [measured(truth, *pair, random_covariance(rng, 0.1, 0.01), EdgeKind.KNOWN, rng) for pair in pairs]
    edges[7] = displaced(edges[7], 30.0, 1.0, rng)
    began = time.perf_counter()
    graph = consistent(edges, "sensor0")
    assert time.perf_counter() - began < 15
    assert [len(one.edges) for one in graph.contradictions] == [100]


def test_the_check_of_an_edge_is_its_difference_from_the_solution_without_it() -> None:
    rng = np.random.default_rng(7)
    rig = random_rig(rng, 3, 1)
    graph = consistent(rig.edges, "lidar0")
    assert (graph.contradictions, set(graph.used)) == ((), set(rig.edges)), "correct edges are kept"
    for edge in rig.edges[:3]:
        without = solve([other for other in rig.edges if other is not edge], "lidar0")
        predicted, covariance = without.relative(edge.parent, edge.child)
        check = graph.checks[edge.name]
        assert check.chi_square == pytest.approx(graph.solution.chi_square - without.chi_square, rel=0.02)
        np.testing.assert_allclose(check.sigmas[:3] ** 2, np.diag(covariance + edge.covariance)[:3], rtol=0.02)
        np.testing.assert_allclose(check.step[3:], (edge.parent_from_child - predicted)[:3, 3], atol=1e-3)


def test_a_camera_with_two_edges_loses_its_pose_and_all_others_keep_theirs() -> None:
    rng = np.random.default_rng(10)
    rig = random_rig(rng, 2, 3)
    edges = list(rig.edges)
    edges[2] = displaced(edges[2], 20.0, 0.3, rng)
    graph = consistent(edges, "lidar0")
    [one] = graph.contradictions
    assert {edge.name for edge in one.edges} == {"camera1-lidar0 (result)", "camera1-lidar1 (result)"}
    assert set(graph.solution.poses) == set(rig.truth) - {"camera1"}


def test_fifteen_wrong_edges_of_many_are_found_one_by_one_in_seconds() -> None:
    rng = np.random.default_rng(15)
    edges = list(random_rig(rng, 6, 10).edges)
    wrong = rng.choice(len(edges), 15, replace=False)
    for number in wrong:
        edges[number] = displaced(edges[number], 10.0, 0.5, rng)
    began = time.perf_counter()
    graph = consistent(edges, "lidar0")
    assert time.perf_counter() - began < 15
    names = {edge.name for one in graph.contradictions for edge in one.edges}
    assert names == {edges[number].name for number in wrong}
