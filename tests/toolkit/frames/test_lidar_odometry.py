from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from p2o import Cloud, InputError, se3
from p2o.frames.lidar_odometry import poses_by_gicp, poses_by_kiss_icp

# Half a metre forward and a degree to the left from sweep to sweep.
STEP = se3.exp(np.array([0.0, 0.0, np.radians(1), 0.5, 0.0, 0.0]))


def by_gicp(clouds: Sequence[Cloud]) -> Sequence[np.ndarray]:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    return poses_by_gicp(clouds)


def by_kiss_icp(clouds: Sequence[Cloud]) -> Sequence[np.ndarray]:
    pytest.importorskip("kiss_icp", reason='needs pip install ".[kiss-icp]"')
    return poses_by_kiss_icp(clouds)


def yard() -> np.ndarray:
    """Return points of a yard: ground, two walls that are not parallel, and posts."""
    rng = np.random.default_rng(5)
    x, y, z = rng.uniform(-20, 25, 20_000), rng.uniform(-10, 10, 20_000), rng.uniform(-1.7, 3, 20_000)
    ground = np.column_stack([x, y, np.full(len(x), -1.7)])
    left, end = np.column_stack([x, 10 + 0.1 * x, z]), np.column_stack([25 + 0.2 * y, y, z])
    posts = [np.column_stack([px + 0.1 * y, py + 0.1 * x / 4, z])[:400] for px, py in ((5, 3), (12, -4), (-6, -7))]
    return np.vstack([ground, left, end, *posts])


def drive(count: int) -> list[Cloud]:
    """Return what a LiDAR sees of the yard along a drive, each sweep with points of its own and 1 cm of noise."""
    world, clouds, pose = yard(), [], np.eye(4)
    for number in range(count):
        rng = np.random.default_rng(number)
        some = world[rng.random(len(world)) < 0.7]
        clouds.append(Cloud(se3.apply(se3.inverse(pose), some) + rng.normal(0, 0.01, some.shape)))
        pose = pose @ STEP
    return clouds


# A centimetre of noise on thousands of points leaves millimetres; the map of KISS-ICP has cubes of a metre.
@pytest.mark.parametrize(("estimate", "close_m", "close_deg"), [(by_gicp, 0.02, 0.05), (by_kiss_icp, 0.1, 0.2)])
def test_a_drive_is_found_from_its_sweeps_in_the_world_of_the_first(
    estimate: Callable[[Sequence[Cloud]], Sequence[np.ndarray]], close_m: float, close_deg: float
) -> None:
    poses = estimate(drive(5))
    assert np.allclose(poses[0], np.eye(4), atol=1e-9)
    truth = np.eye(4)
    for pose in poses:
        error = se3.inverse(truth) @ pose
        assert se3.distance_m(error) < close_m
        assert se3.angle_deg(error) < close_deg
        truth = truth @ STEP


@pytest.mark.parametrize("estimate", [by_gicp, by_kiss_icp])
def test_the_same_sweeps_give_the_same_bits(estimate: Callable[[Sequence[Cloud]], Sequence[np.ndarray]]) -> None:
    clouds = drive(3)
    assert np.array(estimate(clouds)).tobytes() == np.array(estimate(clouds)).tobytes()


def test_sweeps_of_different_places_are_refused() -> None:
    here = drive(1)[0]
    there = Cloud(np.random.default_rng(0).uniform(-8, 8, (2_000, 3)))
    with pytest.raises(InputError, match="sweeps 0 and 1 of the sequence cannot be aligned"):
        by_gicp([here, there])


def test_sweeps_that_only_tremble_about_their_fit_are_one_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairs that come and go keep small_gicp from standing still to a hundredth of a millimetre."""
    small_gicp = pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    align = small_gicp.align

    def trembling(*arguments: Any, **options: Any) -> SimpleNamespace:
        found = align(*arguments, **options)
        still = found.converged and options["rotation_epsilon"] > 1e-5
        return SimpleNamespace(converged=still, num_inliers=found.num_inliers, T_target_source=found.T_target_source)

    monkeypatch.setattr(small_gicp, "align", trembling)
    _, pose = poses_by_gicp(drive(2))
    assert se3.distance_m(se3.inverse(STEP) @ pose) < 0.02
