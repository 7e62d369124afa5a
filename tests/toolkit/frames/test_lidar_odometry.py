from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from p2o import Cloud, InputError, se3
from p2o.frames.lidar_odometry import poses_by_gicp, poses_by_kiss_icp
from p2o.host.registry import Registry
from p2o.run.recipe import open_dataset

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


def unconverged(monkeypatch: pytest.MonkeyPatch, step: np.ndarray) -> None:
    """Let small_gicp end each alignment `step` beside its result, without converging."""
    small_gicp = pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    align, beside = small_gicp.align, [np.eye(4), step]

    def trembling(*arguments: Any, **options: Any) -> SimpleNamespace:
        found = align(*arguments, **options)
        beside.reverse()
        pose = found.T_target_source @ beside[0]
        return SimpleNamespace(converged=False, num_inliers=found.num_inliers, T_target_source=pose)

    monkeypatch.setattr(small_gicp, "align", trembling)


def test_sweeps_may_tremble_about_their_fit_but_not_go_on_moving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairs that come and go keep small_gicp from converging: steps at the minimum stay above 0.1 mm."""
    unconverged(monkeypatch, se3.exp(np.array([0.0, 0.0, 1e-4, 1e-3, 0.0, 0.0])))
    _, pose = poses_by_gicp(drive(2))
    assert se3.distance_m(se3.inverse(STEP) @ pose) < 0.02
    monkeypatch.undo()
    unconverged(monkeypatch, se3.exp(np.array([0.0, 0.0, 0.0, 0.05, 0.0, 0.0])))
    with pytest.raises(InputError, match=r"changes by <= 0\.02 deg and 0\.005 m; got .+ deg and 0\.05 m"):
        poses_by_gicp(drive(2))


@pytest.mark.real
@pytest.mark.parametrize("first", [80, 100])
def test_thirteen_sweeps_of_sixteen_rings_of_a_real_drive_are_accumulated(real_data: Path, first: int) -> None:
    """Every fourth ring from the fourth: the alignment of frames 91 and 92 does not converge."""
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    registry = Registry.load(environ={})
    dataset = open_dataset(f"kitti-raw:{real_data / 'kitti_raw'}", registry, {"right": False})
    frames = [dataset[dataset.names.index(f"2011_09_26/0005/{n:010d}")] for n in range(first, first + 13)]
    for rest in (0, 3):
        sweeps = [frame.cloud.select(frame.cloud.ring % 4 == rest) for frame in frames]
        poses = poses_by_gicp(sweeps)
        for number, (pose, frame) in enumerate(zip(poses, frames, strict=True)):
            truth = se3.inverse(frames[0].lidar_world_from_lidar) @ frame.lidar_world_from_lidar
            error = se3.inverse(truth) @ pose
            assert se3.distance_m(error) < 0.03 + 0.04 * number
