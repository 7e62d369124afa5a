"""Random search in a shrinking box: what it finds on costs with a known optimum."""

import numpy as np
import p2o
from p2o.problems.problem import pose_from_chart
from p2o.solving import Objective
from p2o_plugins.solve import random_shrink
from p2o_plugins.solve.random_shrink import RandomShrinkOptions
from p2o_testing import stage

TRUTH = stage.camera_from_lidar()
OFFSET = np.array([0.01, -0.02, 0.015, 0.05, -0.08, 0.1])


def quadratic(poses):
    """Return the squared distance (B,) from the truth, a radian counting as ten metres."""
    turn = np.trace(np.swapaxes(poses[:, :3, :3], 1, 2) @ TRUTH[:3, :3], axis1=1, axis2=2)
    return 100.0 * (3.0 - turn) + np.sum((poses[:, :3, 3] - TRUTH[:3, 3]) ** 2, axis=1)


def solved(cost=quadratic, start=None, **options):
    """Return the solution of a cost from a pose 1.5 deg and 0.14 m off."""
    start = pose_from_chart(TRUTH, OFFSET) if start is None else start
    return random_shrink.build(RandomShrinkOptions(**options))(Objective(cost), start)


def test_it_finds_the_lowest_point_of_a_quadratic():
    found = solved().camera_from_lidar @ p2o.se3.inverse(TRUTH)
    assert p2o.se3.angle_deg(found) < 0.05
    assert p2o.se3.distance_m(found) < 0.01


def test_a_seed_tells_the_draws():
    first, same, other = (solved(seed=seed).camera_from_lidar for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)


def test_no_pose_lies_outside_of_the_first_box():
    asked = []

    def downhill(poses):
        asked.append(poses)
        return -poses[:, 0, 3]

    found = solved(downhill, TRUTH, range_deg=1.0, range_m=0.1, until_deg=0.1, samples=50)
    away = np.concatenate(asked)
    assert max(p2o.se3.angle_deg(pose @ p2o.se3.inverse(TRUTH)) for pose in away) <= np.sqrt(3)
    # A cost that falls for ever along x: the best pose is at the wall of the box.
    lever_m = np.radians(np.sqrt(3)) * np.linalg.norm(TRUTH[:3, 3])
    assert 0.07 < found.camera_from_lidar[0, 3] - TRUTH[0, 3] <= 0.1 + lever_m


def test_costs_that_are_no_numbers_are_passed_over():
    def holed(poses):
        costs = quadratic(poses)
        costs[costs > 1.05 * quadratic(pose_from_chart(TRUTH, OFFSET)[None])[0]] = np.nan
        return costs

    assert solved(holed).cost < 1e-3


def test_a_start_without_a_cost_is_handed_back():
    found = solved(lambda poses: np.full(len(poses), np.nan))
    assert found.status is p2o.SolverStatus.SINGULAR
    assert np.allclose(found.camera_from_lidar, pose_from_chart(TRUTH, OFFSET))


def test_more_samples_are_counted():
    assert solved(samples=10, until_deg=3.0).iterations == 11
