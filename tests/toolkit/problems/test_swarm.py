"""A swarm finds the lowest place of its box, never leaves it, and never returns worse than it was given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from p2o.problems.problem import swarmed

HALF = np.array([1.0, 2.0, 0.5])
AIM = np.array([0.3, -0.5, 0.1])


def bowl(places: np.ndarray) -> np.ndarray:
    return np.asarray(((places - AIM) ** 2).sum(axis=1))


def run(cost: Any = bowl, seed: int = 0, **more: Any) -> tuple[np.ndarray, float, int]:
    words = {"first": np.zeros(3), "particles": 30, "moves": 80, **more}
    return swarmed(cost, -HALF, HALF, np.random.default_rng(seed), **words)


def test_the_lowest_place_is_found_with_its_cost_and_a_seed_repeats_to_the_bit() -> None:
    found, least, moves = run()
    assert found == pytest.approx(AIM, abs=1e-3)
    assert least == pytest.approx(bowl(found[None])[0])
    assert moves == 80
    assert (run()[0] == found).all()
    assert (run(seed=2)[0] != found).any()


def test_no_particle_leaves_the_box_and_a_corner_can_be_reached() -> None:
    asked: list[np.ndarray] = []

    def slope(places: np.ndarray) -> np.ndarray:
        asked.append(places)
        return np.asarray(places.sum(axis=1))

    assert run(slope)[0] == pytest.approx(-HALF)
    assert all((np.abs(places) <= HALF).all() for places in asked)
    assert {len(places) for places in asked} == {30}


def test_a_good_first_place_is_never_lost_and_a_swarm_that_is_narrow_stops() -> None:
    found, least, _ = run(lambda places: np.where((places == AIM).all(axis=1), 0.0, 1.0), first=AIM, moves=5)
    assert (found == AIM).all()
    assert least == 0.0
    _, least, moves = run(moves=1000, narrow=0.01)
    assert moves < 200
    assert least < 0.01**2
    assert run(moves=0)[2] == 0
