"""Accumulators: sweeps of a drive fall together, whether its poses are given or found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Camera, Cloud, Frame, Image, InputError, Kind, se3
from p2o.run.recipe import open_dataset

IMAGE = Image(np.zeros((5, 7, 3), np.uint8), Camera.pinhole(5, 5, 3, 2, 7, 5))
TWIST = np.array([0.0, 0.0, 0.17, 5.0, 0.0, 0.0])
STEP = se3.exp(0.1 * TWIST)  # half a metre forward and a degree to the left from frame to frame
NAMES = ("poses", "gicp", "kiss-icp")
PACKAGES = {"gicp": "small_gicp", "kiss-icp": "kiss_icp"}


def built(name: str, **options: Any) -> Any:
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name], reason=f'needs pip install ".[{name}]"')
    method = p2o.Registry.load().find(Kind.ACCUMULATOR, name).method
    return method.build(method.options(**options))


def yard(count: int) -> np.ndarray:
    """Return points of a yard: ground, two walls that are not parallel, and posts."""
    rng = np.random.default_rng(5)
    x, y, z = rng.uniform(-20, 25, count), rng.uniform(-10, 10, count), rng.uniform(-1.7, 3, count)
    ground = np.column_stack([x, y, np.full(count, -1.7)])
    left, end = np.column_stack([x, 10 + 0.1 * x, z]), np.column_stack([25 + 0.2 * y, y, z])
    posts = [np.column_stack([px + 0.1 * y, py + 0.1 * x / 4, z])[:400] for px, py in ((5, 3), (12, -4), (-6, -7))]
    return np.vstack([ground, left, end, *posts])


def drive(frames: int = 3, *, raw: bool = False) -> list[Frame]:
    """Return frames that see the same points; `raw` sweeps are bent by the motion, which the frames know."""
    world, found = yard(8_000), []
    pose = se3.exp(np.array([0.3, -0.2, 1.0, 40.0, -7.0, 2.0]))
    time_s = np.linspace(-0.05, 0.05, len(world))
    for number in range(frames):
        cloud = Cloud(se3.apply(se3.inverse(se3.exp(0.1 * number * TWIST)), world), time_s=time_s)
        if raw:
            cloud = Cloud(replace(cloud, twist=TWIST).as_measured(), time_s=time_s)
        known = {"sequence": "yard", "lidar_world_from_lidar": pose, "twist": TWIST if raw else None}
        found.append(Frame(f"yard/{number}", IMAGE, cloud, **known))
        pose = pose @ STEP
    return found


# Points measured without noise at the same places: what is left is what odometry makes of them.
@pytest.mark.parametrize("raw", [False, True], ids=["corrected", "raw"])
@pytest.mark.parametrize(("name", "close_m"), [("poses", 1e-9), ("gicp", 0.02), ("kiss-icp", 0.1)])
def test_every_sweep_falls_on_that_of_the_frame(name: str, close_m: float, raw: bool) -> None:
    frames = drive(raw=raw)
    joined = built(name)(frames, 1)
    still = drive()[1].cloud.xyz
    assert len(joined) == 3 * len(still)
    for part in np.split(joined.xyz, 3):
        assert np.median(np.linalg.norm(part - still, axis=1)) < close_m
    assert np.allclose(joined.xyz[: len(still)], still, atol=1e-9), "the sweep of the frame itself comes first"


@pytest.mark.parametrize("name", ["gicp", "kiss-icp"])
def test_poses_that_are_found_do_not_depend_on_those_that_are_given(name: str) -> None:
    frames = drive()
    without = [replace(frame, lidar_world_from_lidar=None) for frame in frames]
    assert built(name)(frames, 0).xyz.tobytes() == built(name)(without, 0).xyz.tobytes()


@pytest.mark.parametrize("name", NAMES)
def test_the_neighbours_wanted_the_thinning_and_the_range_are_options(name: str) -> None:
    stage = built(name, past=1, future=4, voxel_m=0.5, max_range_m=15.0)
    assert (stage.past, stage.future) == (1, 4)
    xyz = stage(drive(), 1).xyz
    assert np.linalg.norm(xyz, axis=1).max() <= 15.0
    cells = np.floor(xyz / 0.5)
    assert len(np.unique(cells, axis=0)) == len(cells)


def test_frames_without_poses_are_refused_with_a_way_out() -> None:
    frames: Sequence[Frame] = [replace(frame, lidar_world_from_lidar=None) for frame in drive()]
    with pytest.raises(InputError, match=r"no LiDAR pose.*--accumulate gicp"):
        p2o.calibrate(frames, accumulate="poses", start=np.eye(4))


@pytest.mark.real
def test_sweeps_with_sixteen_rings_whose_alignment_does_not_converge_are_joined(real_data: Path) -> None:
    """Of frames 111 and 112, 98 % of the points are paired at the minimum, but small_gicp does not converge."""
    options = {"right": False, "depth": False, "keep_rings": 4}
    dataset = open_dataset(f"kitti-raw:{real_data / 'kitti_raw'}", p2o.Registry.load(environ={}), options)
    frames = [dataset[dataset.names.index(f"2011_09_26/0005/{number:010d}")] for number in range(107, 114)]
    given, found = (built(name, past=3, future=3)(frames, 3).xyz for name in ("poses", "gicp"))
    assert len(given) == sum(len(frame.cloud) for frame in frames)
    assert np.median(np.linalg.norm(given - found, axis=1)) < 0.15
