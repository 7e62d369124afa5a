"""Rotations and poses of boards in closed form, also from directions in a plane, which fit a mirror image as well."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o_baselines.boards.pairing import from_middles, from_planes, from_points, turned

RNG = np.random.default_rng(3)
POSES = se3.exp(RNG.normal(0, [1.5, 1.5, 1.5, 2, 2, 2], (8, 6)))
each_pose = pytest.mark.parametrize("pose", POSES, ids=range(len(POSES)))


def directions(count: int) -> np.ndarray:
    unit = RNG.normal(size=(count, 3))
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


@each_pose
@pytest.mark.parametrize("flat", [False, True])
def test_a_rotation_is_found_exactly_and_is_no_mirror_image(pose: np.ndarray, flat: bool) -> None:
    of = directions(5) * ([1.0, 1.0, 0.0] if flat else 1.0)
    rotation = turned(of @ pose[:3, :3].T, of, np.linspace(1, 3, 5))
    np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@each_pose
def test_a_pose_is_found_from_points_from_planes_and_from_middles_with_normals(pose: np.ndarray) -> None:
    points, normal = RNG.normal(0, 4, (4, 3)), directions(4)
    to, to_normal = se3.apply(pose, points), normal @ pose[:3, :3].T
    offset, to_offset = np.sum(normal * points, axis=1), np.sum(to_normal * to, axis=1)
    in_plane = points * [1.0, 1.0, 0.0]
    for found in (
        from_points(to, points),
        from_points(se3.apply(pose, in_plane), in_plane),
        from_planes(to_normal, to_offset, normal, offset),
        from_middles(to, points, to_normal, normal),
    ):
        np.testing.assert_allclose(found, pose, atol=1e-9)
