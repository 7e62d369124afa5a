from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from p2o import InputError, se3
from p2o_datasets.bags.messages import Header, Transform
from p2o_datasets.bags.tf import frame_tree
from p2o_formats.frame_tree import FrameTree
from scipy.spatial.transform import Rotation


def transform(parent: str, child: str, pose: Any) -> Transform:
    rotation = tuple(Rotation.from_matrix(pose[:3, :3]).as_quat().tolist())
    return Transform(Header(0, parent), child, rotation, tuple(pose[:3, 3].tolist()))


def pose(seed: int) -> Any:
    return se3.exp(np.random.default_rng(seed).normal(size=6))


@settings(max_examples=40)
@given(parents=st.lists(st.integers(0, 100), min_size=1, max_size=8), seed=st.integers(0, 1000))
def test_poses_of_a_tree_are_those_of_its_frames_in_the_world(parents: list[int], seed: int) -> None:
    world_from = [pose(seed + i) for i in range(len(parents) + 1)]
    entries = [
        transform(f"f{parent % (i + 1)}", f"/f{i + 1}", se3.inverse(world_from[parent % (i + 1)]) @ world_from[i + 1])
        for i, parent in enumerate(parents)
    ]
    tree = frame_tree(entries)
    for a in range(len(world_from)):
        found = tree.pose(f"f{a}", "f0")
        assert np.allclose(found, se3.inverse(world_from[a]) @ world_from[0], atol=1e-9)


def test_what_is_not_joined_has_no_pose_and_rings_end() -> None:
    entries = [transform("a", "b", np.eye(4)), transform("b", "a", np.eye(4)), transform("c", "d", np.eye(4))]
    tree = frame_tree(entries)
    assert tree.pose("a", "c") is None
    assert tree.moving_above("a") is None
    assert FrameTree().pose("a", "b") is None


def test_what_never_changes_in_tf_is_fixed_and_what_changes_is_not() -> None:
    still, before, after = pose(1), pose(2), pose(3)
    changing = [
        transform("base", "lidar", still),
        transform("odom", "base", before),
        transform("base", "lidar", still),
        transform("odom", "base", after),
    ]
    tree = frame_tree([], changing)
    found = tree.pose("base", "lidar")
    assert np.allclose(found, still)
    assert tree.pose("odom", "base") is None
    assert tree.moving_above("lidar") == "base"


def test_the_last_word_of_tf_static_counts_and_it_wins_over_tf() -> None:
    tree = frame_tree(
        [transform("base", "lidar", pose(1)), transform("base", "lidar", pose(2))],
        [transform("base", "lidar", pose(3))],
    )
    found = tree.pose("base", "lidar")
    assert np.allclose(found, pose(2))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, float("nan")), (9, 0, 0, 0), (1e300, 0, 0, 0)])
def test_a_rotation_that_is_none_is_refused_where_it_is_used(quaternion: Any) -> None:
    tree = frame_tree([Transform(Header(0, "base"), "lidar", quaternion, (0, 0, 0))])
    with pytest.raises(InputError, match="the transform from lidar to base is invalid"):
        tree.pose("base", "lidar")
