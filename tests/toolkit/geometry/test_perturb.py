"""Wrong starts have exactly the stated size."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.perturb import DRAWS, FIBONACCI, Perturbation, fibonacci_directions, parse_perturbation, wrong_start
from scipy.spatial.transform import Rotation


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2deg 0.15m", Perturbation(2, 0.15)),
        ("2deg,15cm", Perturbation(2, 0.15)),
        ("10deg", Perturbation(10, 0)),
        ("30mm", Perturbation(0, 0.03)),
        (".5deg 1e-1m", Perturbation(0.5, 0.1)),
        ("uniform 3deg 0.15m", Perturbation(3, 0.15, "uniform")),
        ("uniform 15cm", Perturbation(0, 0.15, "uniform")),
    ],
)
def test_a_perturbation_is_read_with_its_units(text: str, expected: Perturbation) -> None:
    assert parse_perturbation(text) == expected
    assert parse_perturbation(str(expected)) == expected


@pytest.mark.parametrize(
    "text",
    [
        *("", "2", "2 deg", "2deg 0.15", "-2deg", "200deg", "2degrees", "nan deg", "uniform", "2deg uniform"),
        *("2deg 101m", "2deg 1m z=2..1m", "z=0..1m", "2deg 1m z=-200..1m", "gauss 2deg", "2deg camera"),
    ],
)
def test_anything_else_and_what_is_out_of_bounds_or_order_is_refused_with_an_example(text: str) -> None:
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
    starts = np.stack([wrong_start(np.eye(4), 2.0, 0.15, rng) for _ in range(500)])
    # Mean of n unit vectors has standard deviation 1/sqrt(3 n) an axis; five of them never happen by chance.
    assert np.abs(starts[:, :3, 3].mean(axis=0) / 0.15).max() < 5 / np.sqrt(3 * 500)


def test_a_uniform_start_fills_the_cube_of_each_axis_and_leaves_it_nowhere() -> None:
    rng = np.random.default_rng(0)
    truth = se3.exp(np.array([0.3, -1.0, 0.4, 1.0, 2.0, 3.0]))
    errors = [se3.inverse(truth) @ Perturbation(3.0, 0.15, "uniform").start(truth, rng) for _ in range(500)]
    turns = np.degrees([se3.rotation_vector(error[:3, :3]) for error in errors])
    shifts = np.stack([error[:3, 3] for error in errors])
    for values, bound in ((turns, 3.0), (shifts, 0.15)):
        share = np.sort(values, axis=0) / bound
        assert np.abs(share).max() <= 1 + 1e-9
        # Distance of Kolmogorov and Smirnov to the uniform law; 1.95 / sqrt(n) is passed once in a thousand.
        expected = np.linspace(-1, 1, len(share))[:, None]
        assert np.abs(share - expected).max() / 2 < 1.95 / np.sqrt(len(share))


@pytest.mark.parametrize("draw", list(DRAWS))
def test_no_draw_goes_beyond_its_size_in_its_own_measure(draw: str) -> None:
    rng = np.random.default_rng(1)
    size = Perturbation(10.0, 0.5, draw)
    for number in range(100):
        error = size.start(np.eye(4), rng, number)
        angles, shifts = np.degrees(se3.rotation_vector(error[:3, :3])), error[:3, 3]
        if draw == "euler":
            angles = Rotation.from_matrix(error[:3, :3]).as_euler("xyz", degrees=True)
        if draw not in ("uniform", "euler"):
            angles, shifts = np.linalg.norm(angles), np.linalg.norm(shifts)
        if draw in ("exact", "fibonacci"):
            assert (angles, shifts) == pytest.approx((10, 0.5))
        assert np.abs(angles).max() <= 10 + 1e-9
        assert np.abs(shifts).max() <= 0.5 + 1e-12


def test_the_shift_along_z_may_have_bounds_of_its_own_and_the_error_be_in_the_camera_frame() -> None:
    size = parse_perturbation("euler 20deg 1.5m z=-1.5..1m")
    assert parse_perturbation(str(size)) == size
    rng = np.random.default_rng(0)
    z = [size.start(np.eye(4), rng)[2, 3] for _ in range(500)]
    assert -1.5 <= min(z) < -1.47
    assert 0.97 < max(z) <= 1
    first, second = (se3.exp(np.array(v)) for v in ([0.3, -1.0, 0.4, 1, 2, 3], [-0.2, 0.1, 0.9, 4, 5, 6]))
    size = parse_perturbation("euler camera 10deg 0.5m")
    errors = [size.start(t, np.random.default_rng(3)) @ se3.inverse(t) for t in (first, second)]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)


def test_the_axes_of_fibonacci_are_all_different_and_evenly_spread() -> None:
    axes = fibonacci_directions(FIBONACCI)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    np.testing.assert_allclose(axes.mean(axis=0), 0, atol=0.01)
    nearest = np.sort(axes @ axes.T, axis=1)[:, -2]
    # Each of 200 caps has the area 4 pi / 200: neighbours are about 0.25 rad apart, none half as near.
    assert np.arccos(nearest).min() > 0.125
    size = Perturbation(5.0, 0.0, "fibonacci")
    starts = [size.start(np.eye(4), np.random.default_rng(0), number) for number in range(FIBONACCI)]
    np.testing.assert_allclose([se3.rotation_vector(s[:3, :3]) for s in starts], np.radians(5) * axes, atol=1e-12)
