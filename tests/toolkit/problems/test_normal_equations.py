"""Covariance and observability of a solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import se3
from p2o.problems.normal_equations import AXES, covariance, linearise, normal_equations, why_singular
from p2o_plugins.solve import lm

from tests.edge_scene import TRUTH
from tests.plugins.solve.exact_pairs import NEAR, pairs

SOLVE = lm.METHOD.build(lm.LmOptions())


@pytest.mark.parametrize("outliers", [0.0, 0.15])
def test_the_covariance_foretells_the_scatter_of_repeated_solutions(outliers: float) -> None:
    squares = []
    for seed in range(40):
        problem = pairs(seed, noise_px=0.7, outliers=outliers)
        problem = replace(problem, weight=np.ones(len(problem)))
        solution = SOLVE(problem, NEAR)
        error = se3.log(TRUTH @ se3.inverse(solution.camera_from_lidar))
        squares.append(error @ np.linalg.solve(solution.covariance, error))
    # Squared errors in units of the covariance follow chi-square of 6; the mean of 40 has a deviation of 0.55.
    assert np.mean(squares) == pytest.approx(6.0, abs=1.6)


def test_half_the_noise_gives_half_the_deviations_and_residuals_beyond_an_image_are_constant() -> None:
    one = pairs(noise_px=0.4)
    wide = replace(one, huber_px=100.0)  # no residual reaches the kernel, so everything scales
    # A scaled shift of every line: the residuals at the truth are halved exactly.
    shifted = one.centre + (0.5 * one.residuals(TRUTH))[:, None] * one.normal
    half = replace(wide, centre=shifted)
    full, less = (covariance(p, *linearise(p, TRUTH)) for p in (wide, half))
    assert np.sqrt(np.diag(less)) == pytest.approx(0.5 * np.sqrt(np.diag(full)), rel=1e-9)
    problem = pairs(count=5)
    problem = replace(problem, centre=problem.centre + 5000.0 * problem.normal)
    residuals, jacobian = linearise(problem, TRUTH)
    assert residuals == pytest.approx(-problem.far_px)
    assert not jacobian.any()


def test_the_gradient_is_the_derivative_of_the_cost_and_both_hessians_agree_within_the_kernel() -> None:
    problem, step = pairs(noise_px=1.0, outliers=0.3), 1e-6
    for newton in (False, True):
        _, gradient = normal_equations(problem, *linearise(problem, NEAR), newton=newton)
        change = problem.cost(se3.exp(step * np.eye(6)) @ NEAR) - problem.cost(se3.exp(-step * np.eye(6)) @ NEAR)
        assert gradient == pytest.approx(change / (2 * step), rel=1e-4)
    problem = pairs()
    rows = linearise(problem, TRUTH)
    bounding, exact = (normal_equations(problem, *rows, newton=newton)[0] for newton in (False, True))
    assert bounding == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("axis", range(6))
def test_a_direction_without_effect_is_named(axis: int) -> None:
    problem = pairs()
    residuals, jacobian = linearise(problem, TRUTH)
    jacobian[:, axis] = 0.0
    hessian, _ = normal_equations(problem, residuals, jacobian)
    assert why_singular(problem, TRUTH, residuals, hessian, 1e5) == f"the pairs do not determine {AXES[axis]}"


def test_two_unknowns_that_undo_each_other_are_named_together() -> None:
    problem = pairs()
    residuals, jacobian = linearise(problem, TRUTH)
    depth = se3.apply(TRUTH, problem.xyz)[:, 2].mean()
    jacobian[:, 1] = depth * jacobian[:, 3]  # yaw now looks just like a shift sideways
    hessian, _ = normal_equations(problem, residuals, jacobian)
    reason = why_singular(problem, TRUTH, residuals, hessian, 1e5)
    assert "rotation about the camera's y axis (yaw)" in reason
    assert " with " in reason
    assert "translation sideways (camera x)" in reason
