from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from p2o import Camera, Cloud, Frame, Image, InputError, se3
from p2o.frames.accumulate import accumulated, nearest_in_time, neighbours, one_per_voxel

IMAGE = Image(np.zeros((5, 7, 3), np.uint8), Camera.pinhole(5, 5, 3, 2, 7, 5))
# A wall of the world: x = 20 m, with a little relief so that no shift along it looks like none.
WALL = np.array([[20 + 0.3 * np.sin(y) + 0.2 * np.cos(3 * z), y, z] for y in np.arange(-5, 5, 0.5) for z in (-1, 0, 1)])
POSES = {
    "a": se3.exp(np.array([0.0, 0.0, 0.1, 1.0, 0.5, 0.0])),
    "b": se3.exp(np.array([0.05, -0.03, -0.2, 4.0, -1.0, 0.2])),
    "c": se3.exp(np.array([-0.02, 0.04, 0.3, 7.0, 2.0, -0.1])),
}


def seen(name: str, world: np.ndarray = WALL, **content: Any) -> Frame:
    """Return a frame whose sweep holds the points of the world as the LiDAR at POSES[name] sees them."""
    pose = POSES[name]
    cloud = content.pop("cloud", None) or Cloud(se3.apply(se3.inverse(pose), world))
    known = {"sequence": "drive", "time_s": 0.1 * "abc".index(name), "lidar_world_from_lidar": pose}
    return Frame(name, IMAGE, cloud, **(known | content))


def test_a_wall_that_is_seen_from_several_poses_falls_together_in_the_frame_of_the_reference() -> None:
    a, b, c = (seen(name) for name in "abc")
    moved = se3.exp(np.array([1.0, -2.0, 0.5, 1e3, -2e3, 50.0]))
    elsewhere = [replace(f, lidar_world_from_lidar=moved @ f.lidar_world_from_lidar) for f in (a, b, c)]
    for union in (
        accumulated(b, [a, c]),
        accumulated(b, [a, b, c]),  # the reference among the others counts once
        accumulated(elsewhere[1], elsewhere[::2]),  # the world of the poses is of no account
    ):
        assert len(union) == 3 * len(WALL)
        for part in np.split(union.xyz, 3):
            assert np.allclose(part, b.cloud.xyz, atol=1e-8)
    alone = replace(a, sequence="", lidar_world_from_lidar=None)
    assert np.array_equal(accumulated(alone, []).xyz, a.cloud.xyz), "alone it needs no pose"


@pytest.mark.parametrize("corrected", [False, True])
def test_each_sweep_is_corrected_to_its_own_time_first_and_only_once(corrected: bool) -> None:
    """The LiDAR moves while it sees the wall, so the raw sweep is bent; the union is straight again."""
    twist = np.array([0.1, -0.2, 0.5, 12.0, 1.0, -0.5])
    still = seen("b").cloud.xyz
    time_s = np.linspace(-0.05, 0.05, len(still))
    # At time t the LiDAR is at pose @ exp(twist t): what it measures is moved back by that.
    bent = np.array([se3.apply(se3.exp(-t * twist), point[None])[0] for t, point in zip(time_s, still, strict=True)])
    cloud = Cloud(bent, time_s=time_s)
    assert np.abs(bent - still).max() > 0.3
    b = seen("b", cloud=cloud.untwisted(twist) if corrected else cloud, twist=twist)
    a = seen("a")
    assert np.allclose(accumulated(a, [b]).xyz[len(WALL) :], a.cloud.xyz, atol=1e-9)
    assert np.allclose(accumulated(b, []).xyz, still, atol=1e-9)


def test_intensity_is_kept_where_all_have_it_and_rings_columns_and_times_are_dropped() -> None:
    count = len(WALL)
    a, b = (seen(name) for name in "ab")
    others = {"ring": np.zeros(count, int), "column": np.zeros(count, int), "time_s": np.zeros(count)}
    full = [
        replace(frame, cloud=replace(frame.cloud, intensity=np.arange(count) + shift, **others))
        for frame, shift in ((a, 0.0), (b, 0.5))
    ]
    union = accumulated(full[0], full[1:])
    assert np.array_equal(union.intensity, np.concatenate([np.arange(count), np.arange(count) + 0.5]))
    assert (union.ring, union.column, union.time_s, union.twist) == (None, None, None, None)
    assert accumulated(full[0], [b]).intensity is None


def test_points_far_from_the_reference_are_left_out_and_thinning_keeps_measured_ones_no_two_in_one_cube() -> None:
    a, b = seen("a"), seen("b", world=np.vstack([WALL, [[200.0, 0, 0]]]))
    union = accumulated(a, [b], max_range_m=25)
    assert len(union) == 2 * len(WALL)
    assert np.linalg.norm(union.xyz, axis=1).max() < 25
    with pytest.raises(InputError, match=r"^a: no point is within the range limit; expected within 1 m"):
        accumulated(a, [b], max_range_m=1)
    a, b = seen("a"), seen("b")
    full, thin = accumulated(a, [b]), accumulated(a, [b], voxel_m=0.7)
    assert 0 < len(thin) < len(full)
    cells = np.floor(thin.xyz / 0.7)
    assert len(np.unique(cells, axis=0)) == len(thin) == len(np.unique(np.floor(full.xyz / 0.7), axis=0))
    assert {tuple(point) for point in thin.xyz} <= {tuple(point) for point in full.xyz}


def test_thinning_leaves_one_point_in_each_cube_the_one_nearest_to_its_centre() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.6, 0.5, 0.5], [0.9, 0.9, 0.9], [-0.1, 0.5, 0.5], [1.4, 0.5, 0.5]])
    assert one_per_voxel(xyz, 1.0).tolist() == [1, 3, 4]
    assert one_per_voxel(xyz[::-1], 1.0).tolist() == [0, 1, 3]
    # Equally near: the first.
    assert one_per_voxel(np.array([[0.4, 0.5, 0.5], [0.6, 0.5, 0.5]]), 1.0).tolist() == [0]
    with pytest.raises(InputError, match="the voxel size is not positive"):
        one_per_voxel(xyz, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sequence": "other"}, "^b: sweeps of different sequences have no common .*; expected sequence 'drive'; got"),
        ({"sequence": ""}, "^b: sweeps of different sequences .* got none"),
        ({"lidar_world_from_lidar": None}, "^b: the frame has no LiDAR pose"),
    ],
)
def test_frames_that_cannot_be_joined_are_refused_by_name(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        accumulated(seen("a"), [replace(seen("b"), **change)])
    with pytest.raises(InputError, match="have no common world frame; expected frames of one sequence"):
        accumulated(seen("a", sequence=""), [seen("b", sequence="")])


@pytest.mark.parametrize(("direction", "chosen"), [("past", [1, 2]), ("future", [4, 0]), ("both", [2, 4])])
def test_the_nearest_times_are_chosen_on_the_side_that_is_asked_for(direction: Any, chosen: list[int]) -> None:
    times_s = np.array([0.7, 0.1, 0.4, 0.5, 0.55])
    assert nearest_in_time(times_s, 0.5, 2, direction).tolist() == chosen
    # Of two equally near times the earlier counts first, and too many are all.
    assert nearest_in_time(np.array([2.0, 0.0, 1.0]), 1.0, 1).tolist() == [1]
    assert nearest_in_time(np.array([2.0, 0.0, 1.0]), 1.0, 9).tolist() == [1, 0]
    assert nearest_in_time(np.array([2.0]), 1.0, 0).tolist() == []


def test_neighbours_are_of_the_same_drive_and_in_order_of_time() -> None:
    a, b, c = (seen(name) for name in "abc")
    other = replace(seen("a"), name="x", sequence="other", time_s=0.11)
    timeless = replace(seen("a"), name="y", time_s=None)
    frames = [c, other, timeless, b, a]
    assert [frame.name for frame in neighbours(b, frames, sweeps=5)] == ["a", "c"]
    assert [frame.name for frame in neighbours(c, frames, sweeps=1, direction="past")] == ["b"]
    assert neighbours(c, frames, sweeps=1, direction="future") == ()
    with pytest.raises(InputError, match=r"^y: the frame has no time"):
        neighbours(timeless, frames, sweeps=1)
    with pytest.raises(InputError, match=r"^a: the frame has no sequence"):
        neighbours(seen("a", sequence=""), frames, sweeps=1)
