"""Errors between poses follow their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, se3
from p2o.confidence.audit import AXES
from p2o.confidence.explanation import corrected
from p2o.geometry.pose_error import pose_error, summarise

from tests.edge_scene import TRUTH


@pytest.mark.parametrize("axis", range(6))
def test_a_turn_about_or_a_shift_along_one_camera_axis_shows_in_that_axis_only(axis: int) -> None:
    """A turn about the LiDAR origin seen along camera axes, so that no translation appears."""
    estimate, size = TRUTH.copy(), 0.5 if axis < 3 else 0.07
    if axis < 3:
        estimate[:3, :3] = se3.exp(np.radians(size) * np.eye(6)[axis])[:3, :3] @ TRUTH[:3, :3]
    else:
        estimate[axis - 3, 3] += size
    error = pose_error(estimate, TRUTH)
    found = [error.per_axis[name] for name in ("pitch_deg", "yaw_deg", "roll_deg", "x_m", "y_m", "z_m")]
    assert found == pytest.approx(size * np.eye(6)[axis], abs=1e-9)
    assert (error.rotation_deg, error.translation_m) == pytest.approx((size, 0) if axis < 3 else (0, size), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "size", "moves"),
    [("pitch", 4.0, (0, -1)), ("yaw", 4.0, (1, 0)), ("x", 0.5, (1, 0)), ("y", 0.5, (0, 1)), ("roll", 10.0, (0, 1))],
)
def test_points_move_in_the_image_as_docs_conventions_shows(name: str, size: float, moves: tuple[int, int]) -> None:
    number, unit = next((at, unit) for at, (axis, unit) in enumerate(AXES) if axis == name)
    wrong = corrected(TRUTH, number, np.array([-size]))[0]
    assert pose_error(wrong, TRUTH).per_axis[f"{name}_{unit}"] == pytest.approx(size, rel=1e-3)
    camera = Camera.pinhole(700, 700, 450, 300, 900, 600)
    # On the right of the middle, where a roll moves things down.
    xyz = se3.apply(se3.inverse(TRUTH), camera.rays(np.array([[800.0, 300]])) * 8)
    before, after = (camera.project(se3.apply(pose, xyz))[0] for pose in (TRUTH, wrong))
    moved = (after - before) / np.linalg.norm(after - before)
    assert moved @ moves > 0.95


def test_norm_and_per_axis_values_agree_and_a_summary_comes_from_the_rows() -> None:
    estimate = TRUTH @ se3.exp(np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.3]))
    error = pose_error(estimate, TRUTH)
    values = np.array(list(error.per_axis.values()))
    assert np.linalg.norm(values[:3]) == pytest.approx(error.rotation_deg)
    assert np.linalg.norm(values[3:]) == pytest.approx(error.translation_m)
    shifts = [0.05, 0.05, 0.5]
    errors = [pose_error(TRUTH @ se3.make(translation=[s, 0, 0]), TRUTH) for s in shifts]
    summary = summarise(errors)
    assert summary["translation_m_mean"] == pytest.approx(0.2)
    assert summary["translation_m_median"] == pytest.approx(0.05)
    assert summary["within_0.3deg_0.1m"] == 2
    assert summarise([]) == {"count": 0}
