"""Residuals of several cameras over one pose of the LiDAR on the body: derivatives, costs and the exact minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o import se3
from p2o.arrays import Float
from p2o.geometry.motion import adjoint, adjoint_matrix
from p2o.problems.rig_residuals import RigResiduals
from p2o.solving import LeastSquares
from p2o_plugins.solve.lm import LmOptions, build

PLACES = (se3.exp(np.array([0.3, -2.0, 0.4, -0.6, 0.1, 0.2])), se3.exp(np.array([-1.2, 0.1, 0.8, 0.5, 0.3, -1.0])))
TRUTH = se3.exp(np.array([0.02, -0.01, 0.3, 0.9, 0.1, 1.6]))
"""body_from_lidar."""


@dataclass(frozen=True, eq=False)
class Bearings(LeastSquares):
    """Differences in m of points (N, 3), moved to the frame of a camera, from where the camera saw them."""

    xyz: Float
    seen: Float

    @property
    def weight(self) -> Float:  # type: ignore[override]
        return np.ones(3 * len(self.xyz))

    @property
    def frame(self) -> Float:  # type: ignore[override]
        return np.zeros(3 * len(self.xyz), np.int64)

    @property
    def huber(self) -> float:  # type: ignore[override]
        return 10.0

    def residuals(self, camera_from_lidar: Float) -> Float:
        moved = se3.apply(camera_from_lidar, self.xyz) - self.seen
        return moved.reshape(*moved.shape[:-2], -1)


def rig(seed: int = 0) -> RigResiduals:
    """Return the problem of two cameras that saw ten points each, without noise."""
    rng = np.random.default_rng(seed)
    parts = []
    for place in PLACES:
        xyz = rng.uniform(-10, 10, (10, 3))
        parts.append((place, Bearings(xyz, se3.apply(place @ TRUTH, xyz))))
    return RigResiduals(tuple(parts))


def test_derivatives_are_by_a_left_update_in_the_body_frame() -> None:
    problem, pose = rig(), se3.exp(np.array([0.05, 0.02, -0.03, 0.2, -0.1, 0.1])) @ TRUTH
    residuals, jacobian = problem.residuals_with_jacobian(pose)
    step = 1e-6
    for axis in range(6):
        ends = [problem.residuals(se3.exp(sign * step * np.eye(6)[axis]) @ pose) for sign in (1, -1)]
        np.testing.assert_allclose(jacobian[:, axis], (ends[0] - ends[1]) / (2 * step), atol=1e-5)
    np.testing.assert_allclose(residuals, problem.residuals(pose[None])[0])
    np.testing.assert_array_equal(np.unique(problem.frame), [0, 1])
    assert (len(problem), problem.huber, len(RigResiduals(()))) == (60, 10.0, 0)


def test_a_left_update_of_the_body_is_one_of_each_camera() -> None:
    twist = np.array([0.01, -0.02, 0.03, 0.1, 0.2, -0.3])
    for place in PLACES:
        np.testing.assert_allclose(adjoint_matrix(place) @ twist, adjoint(place, twist))
        np.testing.assert_allclose(place @ se3.exp(twist), se3.exp(adjoint_matrix(place) @ twist) @ place, atol=1e-12)


def test_the_solver_finds_the_exact_pose_that_no_camera_determines_alone() -> None:
    """A single point per camera fixes three unknowns of six: three cameras with a point each fix all of them."""
    places = (*PLACES, se3.exp(np.array([0.1, 2.0, 0.2, 1.0, 0.0, 0.4])))
    points = (np.array([[4.0, 1.0, 0.0]]), np.array([[-3.0, 5.0, 1.0]]), np.array([[1.0, -6.0, 2.0]]))
    parts = tuple(
        (place, Bearings(xyz, se3.apply(place @ TRUTH, xyz))) for place, xyz in zip(places, points, strict=True)
    )
    start = se3.exp(np.array([0.03, 0.02, -0.02, 0.1, -0.1, 0.1])) @ TRUTH
    solve = build(LmOptions())
    np.testing.assert_allclose(solve(RigResiduals(parts), start).camera_from_lidar, TRUTH, atol=1e-7)
    assert solve(RigResiduals(parts[:1]), start).status.value == "singular"
