"""Solvers of scalar costs: on a bowl whose lowest place is known, within boxes, by given and numeric gradients."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.problems.problem import pose_from_chart
from p2o.solving import Objective
from p2o_plugins.solve import barzilai_borwein, bfgs, cma_es, particle_swarm, random_shrink

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import apart

METHODS = {m.METHOD.name: m.METHOD for m in (barzilai_borwein, bfgs, cma_es, particle_swarm)}
every = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
boxed = pytest.mark.parametrize(
    "method", [bfgs.METHOD, cma_es.METHOD, particle_swarm.METHOD], ids=lambda method: method.name
)
drawn = pytest.mark.parametrize(
    "method", [cma_es.METHOD, particle_swarm.METHOD, random_shrink.METHOD], ids=lambda method: method.name
)
START = pose_from_chart(TRUTH, np.array([0.01, -0.015, 0.008, 0.08, -0.1, 0.05]))


def off(poses: np.ndarray) -> np.ndarray:
    """Return how far poses (B, 4, 4) are from the truth, (B, 6): degrees (of small turns) and tenths of metres."""
    turn = poses[:, :3, :3] @ TRUTH[:3, :3].T
    axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1)
    return np.concatenate([np.degrees(axis / 2), 10 * (poses[:, :3, 3] - TRUTH[:3, 3])], axis=1)


@dataclass
class Bowl:
    """The squared distance from the truth; degrees weigh as tenths of metres."""

    scale: float = 1.0
    offset: float = 0.0
    asked: list[int] = field(default_factory=list)

    def cost(self, poses: np.ndarray) -> np.ndarray:
        self.asked.append(len(poses))
        return self.offset + self.scale * (off(poses) ** 2).sum(axis=1)


def built(method: p2o.Method, **options: Any) -> p2o.Solver:
    if method.extra:
        pytest.importorskip(method.extra)
    return method.build(method.options(**options))


@every
@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_a_cost_in_other_units_leads_to_the_same_place(method: p2o.Method, scale: float) -> None:
    solution = built(method)(Bowl(scale, offset=-scale), START)
    assert max(apart(solution.camera_from_lidar, TRUTH)) < 0.02


@boxed
def test_no_unknown_leaves_the_box(method: p2o.Method) -> None:
    solution = built(method, box_deg=0.3, box_m=0.02)(Bowl(), START)
    turn = np.degrees(se3.rotation_vector(solution.camera_from_lidar[:3, :3] @ START[:3, :3].T))
    shift = solution.camera_from_lidar[:3, 3] - pose_from_chart(START, np.r_[np.radians(turn), 0, 0, 0])[:3, 3]
    assert np.abs(turn).max() < 0.3 + 1e-9
    assert np.abs(shift).max() < 0.02 + 1e-9
    assert np.abs(turn).max() > 0.29
    assert np.abs(shift).max() > 0.019


@every
def test_the_covariance_of_the_problem_is_handed_on(method: p2o.Method) -> None:
    sure = Objective(Bowl().cost, covariance=lambda pose: np.eye(6) * se3.angle_deg(pose))
    solution = built(method)(sure, START)
    assert solution.covariance == pytest.approx(np.eye(6) * se3.angle_deg(solution.camera_from_lidar))
    assert built(method)(Bowl(), START).covariance is None


@drawn
def test_a_seed_tells_the_draws_and_the_common_generator_is_left_alone(method: p2o.Method) -> None:
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    once, other = (built(method, seed=seed)(Bowl(), START).camera_from_lidar for seed in (1, 2))
    assert (once != other).any()
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_random_shrink_draws_no_pose_outside_of_its_first_box_and_counts_its_samples() -> None:
    asked = []

    def downhill(poses: np.ndarray) -> np.ndarray:
        asked.append(poses)
        return -poses[:, 0, 3]

    options = {"range_deg": 1.0, "range_m": 0.1, "until_deg": 0.1, "samples": 50}
    found = built(random_shrink.METHOD, **options)(Objective(downhill), TRUTH)
    assert max(apart(pose, TRUTH)[0] for pose in np.concatenate(asked)) <= np.sqrt(3)
    # A cost that falls for ever along x: the best pose is at the wall of the box.
    lever_m = np.radians(np.sqrt(3)) * np.linalg.norm(TRUTH[:3, 3])
    assert 0.07 < found.camera_from_lidar[0, 3] - TRUTH[0, 3] <= 0.1 + lever_m
    assert built(random_shrink.METHOD, samples=10, until_deg=3.0)(Bowl(), START).iterations == 11


def test_a_swarm_is_asked_for_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(particle_swarm, "_COLLAPSED", 0.0)
    bowl = Bowl()
    built(particle_swarm.METHOD, particles=50, iterations=20)(bowl, START)
    # Moves, and the first places in each box; a box may be the last one when the moves are spent.
    assert 20 < bowl.asked.count(50) <= 20 + 4
    assert set(bowl.asked) == {1, 50}


def test_a_swarm_finds_the_lowest_of_many_hollows() -> None:
    def cost(poses: np.ndarray) -> np.ndarray:
        return (off(poses) ** 2 + 0.5 * (1 - np.cos(3 * np.pi * off(poses)))).sum(axis=1)

    by_swarm = built(particle_swarm.METHOD)(Objective(cost), START)
    by_slope = built(bfgs.METHOD)(Objective(cost), START)
    assert max(apart(by_swarm.camera_from_lidar, TRUTH)) < 0.05
    assert by_slope.cost > by_swarm.cost + 0.5


def test_coarse_differences_lead_over_ripples_that_stop_the_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    def cost(poses: np.ndarray) -> np.ndarray:
        return (off(poses) ** 2 + 0.05 * (1 - np.cos(40 * np.pi * off(poses)))).sum(axis=1)

    solve = built(barzilai_borwein.METHOD)
    by_schedule = solve(Objective(cost), START).camera_from_lidar
    monkeypatch.setattr(barzilai_borwein, "_SCHEDULE", ())
    by_gradient = solve(Objective(cost), START).camera_from_lidar
    assert max(apart(by_gradient, TRUTH)) > 3 * max(apart(by_schedule, TRUTH))
    assert max(apart(by_schedule, TRUTH)) < 0.1
