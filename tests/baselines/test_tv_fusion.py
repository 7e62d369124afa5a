"""Total variation and the cost made of it, on maps whose variation is known."""

import numpy as np
import pytest
from p2o_baselines.edges.tv_fusion import coarse, divergence, filled, gradient

ONES = np.ones((12, 16))


def variation(values, weight):
    """Return the weighted total variation of a map by `gradient`."""
    return np.sum(weight * np.hypot(*gradient(values)))


def test_a_step_counts_its_height_times_its_length():
    step = np.zeros((12, 16))
    step[:, 8:] = 2.5
    assert variation(step, ONES) == pytest.approx(12 * 2.5)
    assert variation(step, 0.1 * ONES) == pytest.approx(12 * 0.25)


def test_divergence_is_minus_the_adjoint_of_the_gradient():
    rng = np.random.default_rng(0)
    values, down, across = rng.normal(size=(3, 12, 16))
    down[-1], across[:, -1] = 0.0, 0.0
    steps = gradient(values)
    assert np.sum(steps[0] * down + steps[1] * across) == pytest.approx(-np.sum(values * divergence(down, across)))


def test_a_map_that_is_filled_costs_less_than_what_it_began_with():
    rng = np.random.default_rng(1)
    known = rng.random((12, 16)) < 0.4
    depth = rng.normal(size=(12, 16))

    def energy(psi):
        return 0.5 * np.sum((psi - depth)[known] ** 2) + 0.2 * variation(psi, ONES)

    begun = np.where(known, depth, depth[known].mean())
    few, many = (energy(filled(depth, known, ONES, 0.2, steps)) for steps in (20, 400))
    assert many <= few < energy(begun)


def test_depth_changes_where_the_weights_are_small():
    weight = np.ones((12, 16))
    weight[:, 9] = 0.01
    known = np.zeros((12, 16), bool)
    known[:, 2], known[:, 13] = True, True
    depth = np.where(np.arange(16) < 8, 1.0, 3.0) * np.ones((12, 1))
    psi = filled(depth, known, weight, 0.05, 2000)
    assert np.argmax(np.abs(np.diff(psi[6]))) == 9


def test_an_edge_anywhere_in_a_cell_is_one():
    weight = np.ones((12, 12))
    weight[4, 10] = 0.2
    assert np.array_equal(coarse(weight, 6.0), [[1.0, 0.2], [1.0, 1.0]])
