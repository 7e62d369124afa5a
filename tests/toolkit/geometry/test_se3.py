"""Rigid transforms obey the laws of their group, and what is none is refused."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.pose_error import pose_error
from scipy.linalg import expm

# docs/conventions.md: x forward, y left, z up  to  x right, y down, z forward; camera 0.27 m ahead, 0.08 m below.
TRUTH = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27])


def tangents(count: int, angle: float | None = None, seed: int = 0) -> np.ndarray:
    """Tangent vectors (count, 6), of one angle or of any below pi."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angles = rng.uniform(0, 3.1, (count, 1)) if angle is None else angle
    return np.column_stack([axis * angles, rng.uniform(-5, 5, (count, 3))])


def generator(tangent: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) of se(3) that a tangent vector stands for."""
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = se3.skew(tangent[:3]), tangent[3:]
    return out


ANGLES = [0.0, 1e-12, 1e-6, 9e-4, 1.1e-3, 9.9e-3, 1.01e-2, 0.5, 3.0, np.pi - 1e-7]


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential_and_log_undoes_it_at_every_angle(angle: float) -> None:
    for tangent in tangents(5, angle):
        np.testing.assert_allclose(se3.exp(tangent), expm(generator(tangent)), rtol=0, atol=1e-12)
        np.testing.assert_allclose(se3.log(se3.exp(tangent)), tangent, rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-4, 0.0099, 0.0101, 1.0, np.pi, 5.0])
def test_one_tangent_has_the_transform_that_it_has_in_a_stack(angle: float) -> None:
    tangent = np.array([0.6 * angle, 0.0, -0.8 * angle, 3.0, -20.0, 0.5])
    np.testing.assert_allclose(se3.exp(tangent), se3.exp(tangent[None])[0], rtol=0, atol=1e-14)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_one_tangent_that_is_no_motion_gives_what_it_gives_in_a_stack(value: float) -> None:
    tangent = np.array([value, 0, 0, 0, 0, 0])
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(se3.exp(tangent), se3.exp(tangent[None])[0])


def test_exp_undoes_log_for_half_a_turn_and_small_and_large_angles_are_measured_alike() -> None:
    half = se3.make(np.diag([1.0, -1.0, -1.0]), [1, 2, 3])
    np.testing.assert_allclose(se3.exp(se3.log(half)), half, atol=1e-12)
    assert se3.angle_deg(half) == pytest.approx(180)
    # An arccos of the trace would lose angles below 1e-6 degrees.
    for angle_deg in (0.0, 1e-6, 0.01, 90.0, 179.9999):
        pose = se3.exp(tangents(1, np.radians(angle_deg))[0])
        assert se3.angle_deg(pose) == pytest.approx(angle_deg, abs=1e-9)


def test_exp_has_its_derivative_at_zero() -> None:
    """The derivative is the generator itself: finite, and without a seam where a solver starts."""
    for unit in np.eye(6):
        for step, atol in ((1e-4, 1e-6), (1e-9, 1e-6), (1e-15, 0.2)):
            slope = (se3.exp(step * unit) - se3.exp(-step * unit)) / (2 * step)
            np.testing.assert_allclose(slope, generator(unit), atol=atol)
    assert (se3.exp(np.zeros(6)) == np.eye(4)).all()


def test_half_a_motion_twice_is_the_motion_and_a_quarter_circle_bends_the_translation() -> None:
    for tangent in tangents(10):
        half = se3.exp(tangent / 2)
        np.testing.assert_allclose(half @ half, se3.exp(tangent), atol=1e-12)
        np.testing.assert_allclose(se3.exp(-tangent), se3.inverse(se3.exp(tangent)), atol=1e-12)
    motion = se3.exp(np.array([0, 0, np.pi / 2, 1, 0, 0]))
    np.testing.assert_allclose(motion[:3, 3], [2 / np.pi, 2 / np.pi, 0], atol=1e-15)
    np.testing.assert_allclose(se3.apply(motion, np.eye(3)[:1] * 0), [[2 / np.pi, 2 / np.pi, 0]], atol=1e-15)


def test_transforms_come_in_stacks_of_any_shape() -> None:
    stack = tangents(6).reshape(2, 3, 6)
    poses, xyz = se3.exp(stack), np.random.default_rng(1).normal(size=(7, 3))
    moved = se3.apply(poses, xyz)
    assert (poses.shape, moved.shape) == ((2, 3, 4, 4), (2, 3, 7, 3))
    for i, j in np.ndindex(2, 3):
        np.testing.assert_allclose(poses[i, j], se3.exp(stack[i, j]), atol=1e-15)
        np.testing.assert_allclose(moved[i, j], se3.apply(poses[i, j], xyz), atol=1e-12)
        np.testing.assert_allclose(se3.inverse(poses)[i, j] @ poses[i, j], np.eye(4), atol=1e-12)


def test_chains_cancel_and_applying_one_after_the_other_is_applying_the_product() -> None:
    b_from_a, c_from_b = se3.exp(tangents(2))
    xyz = np.random.default_rng(2).normal(size=(4, 3))
    np.testing.assert_allclose(
        se3.apply(c_from_b, se3.apply(b_from_a, xyz)), se3.apply(c_from_b @ b_from_a, xyz), atol=1e-12
    )
    np.testing.assert_allclose(
        se3.inverse(c_from_b @ b_from_a), se3.inverse(b_from_a) @ se3.inverse(c_from_b), atol=1e-12
    )


def test_skew_is_the_cross_product_and_apply_moves_the_points_of_the_page() -> None:
    a, b = np.random.default_rng(3).normal(size=(2, 3))
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(se3.apply(TRUTH, np.array([[10.27, 2.0, -1.08]])), [[-2, 1, 10]], atol=1e-12)
    np.testing.assert_allclose(se3.inverse(TRUTH)[:3, 3], [0.27, 0, -0.08], atol=1e-15)  # the camera's place


def test_angle_and_distance_of_a_wrong_start_are_those_it_was_made_of() -> None:
    turn = se3.exp(np.array([0, 0, np.radians(1), 0, 0, 0]))
    wrong = TRUTH @ se3.make(turn[:3, :3], [0.1, 0, 0])
    relative = se3.inverse(TRUTH) @ wrong
    assert se3.angle_deg(relative) == pytest.approx(1)
    assert se3.distance_m(relative) == pytest.approx(0.1)
    error = pose_error(wrong, TRUTH)
    assert (error.rotation_deg, error.translation_m) == pytest.approx((1, 0.1))
    assert error.per_axis["yaw_deg"] == pytest.approx(-1)
    assert error.per_axis["z_m"] == pytest.approx(0.1)


def test_a_rotation_printed_with_few_digits_is_made_exact_and_read_only_and_the_input_is_left_as_it_was() -> None:
    rounded = np.round(se3.exp(tangents(1)[0]), 5)
    before = rounded.copy()
    clean = se3.check_rigid("extrinsic", rounded)
    np.testing.assert_allclose(clean[:3, :3].T @ clean[:3, :3], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(clean, rounded, atol=1e-5)
    np.testing.assert_array_equal(rounded, before)
    assert rounded.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        clean[0, 0] = 2
    np.testing.assert_allclose(se3.check_rigid("camera_from_lidar", TRUTH.tolist()), TRUTH, atol=1e-15)


def broken(**entries: float) -> np.ndarray:
    out = TRUTH.copy()
    for place, value in entries.items():
        out[int(place[1]), int(place[2])] = value
    return out


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (se3.make(np.diag([1, 1, -1])), "mirrors space; expected determinant"),
        (TRUTH @ np.diag([1, 1, -1, 1]), "mirrors space"),
        (se3.make(2 * np.eye(3)), "not orthonormal"),
        (se3.make(np.zeros((3, 3))), "not orthonormal"),
        (broken(m01=-0.999), "not orthonormal"),
        (broken(m30=0.1), "last row .* expected 0 0 0 1; got 0.1 0 0 1"),
        (broken(m33=1.000005), "last row"),
        (broken(m33=0), "last row"),
        (np.eye(3), r"wrong shape; expected \(4, 4\); got \(3, 3\)"),
        (np.eye(4)[:3], "wrong shape"),
        (broken(m03=np.nan), "not finite"),
        (broken(m00=np.inf), "not finite"),
        ("identity", "not an array of numbers"),
    ],
)
def test_what_is_not_rigid_is_refused_by_name_and_place(value: object, text: str) -> None:
    with pytest.raises(InputError, match=text) as caught:
        se3.check_rigid("camera_from_lidar", value, where="calib.txt")
    assert str(caught.value).startswith("calib.txt: ")
    assert "camera_from_lidar" in str(caught.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e3, 1e160, 1e300])
def test_numbers_whose_products_are_infinite_are_refused_without_a_word_of_numpy(scale: float) -> None:
    with pytest.raises(InputError, match="is not orthonormal"):
        se3.check_rigid("pose", se3.make(scale * np.eye(3)))
    far = se3.make(translation=[0, 0, 1e7 * scale])
    with pytest.raises(InputError, match="the translation of pose is too long"):
        se3.check_rigid("pose", far)
