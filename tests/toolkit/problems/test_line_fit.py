"""Lines through a handful of pixels, and the two gates, on cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.problems.pairing import Lines, faces, fit_lines, straight


def one(points: list[tuple[float, float]]) -> Lines:
    return fit_lines(np.array([points], dtype=float))


@pytest.mark.parametrize("angle_deg", [0, 30, 45, 90, 135, 179])
def test_a_straight_row_gives_its_middle_and_its_normal(angle_deg: float) -> None:
    direction = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    lines = one([tuple(np.array([100.0, 50.0]) + t * direction) for t in range(8)])
    assert lines.centre[0] == pytest.approx([100, 50] + 3.5 * direction)
    assert lines.normal[0] @ direction == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(lines.normal[0]) == pytest.approx(1)
    assert lines.along[0] == pytest.approx((8**2 - 1) / 12)  # variance of eight steps of one pixel
    assert lines.across[0] == pytest.approx(0, abs=1e-12)


def test_the_closed_form_is_the_eigenvector_of_least_spread_and_of_nothing_nothing() -> None:
    points = np.random.default_rng(0).normal(size=(200, 8, 2)) * [3.0, 1.0] @ [[0.8, 0.6], [-0.6, 0.8]]
    lines = fit_lines(points)
    offset = points - points.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("kni,knj->kij", offset, offset) / 8)
    assert np.abs(np.einsum("ki,ki->k", vectors[:, :, 0], lines.normal)) == pytest.approx(1)
    assert np.column_stack([lines.across, lines.along]) == pytest.approx(values)
    lines = fit_lines(np.zeros((0, 8, 2)))
    assert lines.centre.shape == lines.normal.shape == (0, 2)
    assert len(straight(lines, 10.0)) == len(faces(lines, np.zeros((0, 2)), 50.0, 2.0)) == 0


def test_a_block_two_pixels_wide_has_a_ratio_of_five_a_corner_is_no_line_and_a_gentle_bend_is() -> None:
    lines = one([(u, v) for u in range(2) for v in range(4)])  # variances 15/12 and 3/12
    assert straight(lines, 4.999).tolist() == [True]
    assert straight(lines, 5.001).tolist() == [False]
    corner = one([(t, 0) for t in range(4)] + [(0, t) for t in range(1, 5)])
    arc = one([(50 * np.sin(t / 50), 50 * np.cos(t / 50)) for t in range(8)])
    assert straight(corner, 10.0).tolist() == [False]
    assert straight(arc, 10.0).tolist() == [True]
    equal = one([(3.0, 4.0)] * 8)
    assert np.isfinite(equal.normal).all()
    assert straight(equal, 1.0).tolist() == [False]


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_angle_gate_opens_at_its_limit_on_both_sides_of_the_line(sign: int) -> None:
    upright = one([(0.0, v) for v in range(-4, 4)])  # centre (0, -0.5), normal along u
    angle = np.radians([0, 49, 51, 90])
    uv = upright.centre + 10 * np.column_stack([sign * np.cos(angle), np.sin(angle)])
    lines = Lines(*(np.repeat(getattr(upright, n), 4, axis=0) for n in ("centre", "normal", "along", "across")))
    assert faces(lines, uv, 50.0, free_px=0.0).tolist() == [True, True, False, False]
    assert faces(lines, uv, 90.0, free_px=0.0).all()
    assert faces(lines, uv, 50.0, free_px=10.5).all()
