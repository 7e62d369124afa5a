"""Roll, pitch, yaw are those of ROS, and give any rotation back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from p2o.geometry.rpy import rotation_of, rpy_of
from scipy.spatial.transform import Rotation

from tests.p2o_formats.calibrations import rotations


@given(rotation=rotations())
def test_any_rotation_comes_back(rotation: np.ndarray) -> None:
    np.testing.assert_allclose(rotation_of(*rpy_of(rotation)), rotation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_it_is_about_fixed_axes_and_a_pitch_of_90_degrees_is_read_as_one(pitch: float) -> None:
    angles = (0.3, -0.5, 1.2)
    np.testing.assert_allclose(rotation_of(*angles), Rotation.from_euler("xyz", angles).as_matrix(), atol=1e-15)
    rotation = rotation_of(0.4, pitch, 0.1)
    roll, found, yaw = rpy_of(rotation)
    assert found == pytest.approx(pitch)
    # Roll and yaw turn about one axis there: only their difference, or sum, is known.
    sign = math.copysign(1, pitch)
    assert yaw - sign * roll == pytest.approx(0.1 - sign * 0.4)
