"""Wrong starts have exactly the stated size."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.perturb import Perturbation, parse_perturbation, wrong_start, wrong_start_per_axis


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2deg 0.15m", Perturbation(2, 0.15)),
        ("2deg,15cm", Perturbation(2, 0.15)),
        ("10deg", Perturbation(10, 0)),
        ("30mm", Perturbation(0, 0.03)),
        (".5deg 1e-1m", Perturbation(0.5, 0.1)),
        ("uniform 3deg 0.15m", Perturbation(3, 0.15, uniform=True)),
        ("uniform 15cm", Perturbation(0, 0.15, uniform=True)),
    ],
)
def test_a_perturbation_is_read_with_its_units(text: str, expected: Perturbation) -> None:
    assert parse_perturbation(text) == expected
    assert parse_perturbation(str(expected)) == expected


@pytest.mark.parametrize(
    "text", ["", "2", "2 deg", "2deg 0.15", "-2deg", "200deg", "2degrees", "nan deg", "uniform", "2deg uniform"]
)
def test_anything_else_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(InputError, match="--perturb"):
        parse_perturbation(text)


def test_the_start_is_exactly_as_wrong_as_asked_and_the_error_acts_in_the_lidar_frame() -> None:
    truth = se3.exp(np.array([0.3, -1.0, 0.4, 1.0, 2.0, 3.0]))
    start = wrong_start(truth, 2.0, 0.15, np.random.default_rng(7))
    error = se3.inverse(truth) @ start
    assert se3.angle_deg(error) == pytest.approx(2.0, abs=1e-9)
    assert se3.distance_m(error) == pytest.approx(0.15, abs=1e-12)
    moved = se3.exp(np.array([0.1, 0.2, 0.3, 4.0, 5.0, 6.0]))
    again = wrong_start(moved @ truth, 2.0, 0.15, np.random.default_rng(7))
    np.testing.assert_allclose(again, moved @ start, atol=1e-12)


def test_directions_are_uniform_so_their_mean_vanishes() -> None:
    rng = np.random.default_rng(0)
    starts = np.stack([wrong_start(np.eye(4), 2.0, 0.15, rng) for _ in range(2000)])
    # Mean of n unit vectors has standard deviation 1/sqrt(3 n) an axis; five of them never happen by chance.
    assert np.abs(starts[:, :3, 3].mean(axis=0) / 0.15).max() < 5 / np.sqrt(3 * 2000)


def test_a_uniform_start_fills_the_cube_of_each_axis_and_leaves_it_nowhere() -> None:
    rng = np.random.default_rng(0)
    truth = se3.exp(np.array([0.3, -1.0, 0.4, 1.0, 2.0, 3.0]))
    errors = [se3.inverse(truth) @ wrong_start_per_axis(truth, 3.0, 0.15, rng) for _ in range(2000)]
    turns = np.degrees([se3.rotation_vector(error[:3, :3]) for error in errors])
    shifts = np.stack([error[:3, 3] for error in errors])
    for values, bound in ((turns, 3.0), (shifts, 0.15)):
        share = np.sort(values, axis=0) / bound
        assert np.abs(share).max() <= 1 + 1e-9
        # Distance of Kolmogorov and Smirnov to the uniform law; 1.95 / sqrt(n) is passed once in a thousand.
        expected = np.linspace(-1, 1, len(share))[:, None]
        assert np.abs(share - expected).max() / 2 < 1.95 / np.sqrt(len(share))


def test_the_words_decide_between_a_stated_size_and_bounds_for_each_axis() -> None:
    truth = se3.exp(np.array([0.3, -1.0, 0.4, 1.0, 2.0, 3.0]))
    for text, wrong in (("2deg 0.15m", wrong_start), ("uniform 2deg 0.15m", wrong_start_per_axis)):
        start = parse_perturbation(text).start(truth, np.random.default_rng(3))
        assert start.tobytes() == wrong(truth, 2.0, 0.15, np.random.default_rng(3)).tobytes()
