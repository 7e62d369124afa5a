"""Frames of one camera and rig are solved together, whichever order they come in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, se3
from p2o_study.cells import group_size, groups_of
from p2o_study.study import ALL_JOINT, BY_CAMERA, BY_RIG
from p2o_study.worker import FrameRecord, Plugins, Source

CAMERA = Camera.pinhole(700, 700, 300, 100, 600, 200)
TRUTH = se3.make(np.eye(3), [0.1, 0.2, 0.3])


def fact(name: str, **values: object) -> FrameRecord:
    found = FrameRecord(Source(Plugins(), "d:", "{}", 0, name), {}, CAMERA, TRUTH)
    return replace(found, **values)


def names(joint: int, facts: list[FrameRecord]) -> list[str]:
    return ["".join(fact.name for fact in group) for group in groups_of(joint, facts)]


@pytest.mark.parametrize(("joint", "groups"), [(0, ["a", "b", "c"]), (2, ["ab", "c"]), (ALL_JOINT, ["abc"])])
def test_frames_are_taken_in_order_the_last_group_may_be_smaller(joint: int, groups: list[str]) -> None:
    assert names(joint, [fact(name) for name in "abc"]) == groups
    assert group_size(joint, 3) == len(groups[0])


@pytest.mark.parametrize(("joint", "group"), [(ALL_JOINT, "ace"), (BY_CAMERA, "ace"), (4, "abc"), (BY_RIG, "abcdef")])
def test_a_large_group_of_one_camera_has_the_frames_that_a_run_would_use(
    monkeypatch: pytest.MonkeyPatch, joint: int, group: str
) -> None:
    monkeypatch.setattr("p2o.run.run.MOST_JOINT_FRAMES", 3)
    assert names(joint, [fact(name) for name in "abcdef"])[0] == group


def test_frames_of_one_camera_are_together_and_others_are_not() -> None:
    """b has another lens, d another name, e another place; f is rounded differently, which no calibration can tell."""
    moved, rounded = TRUTH.copy(), TRUTH.copy()
    moved[0, 3] += 0.01
    rounded[0, 3] += 1e-6
    facts = [
        fact("a"),
        fact("b", camera=Camera.pinhole(701, 700, 300, 100, 600, 200)),
        fact("c"),
        fact("d", camera_name="left"),
        fact("e", camera_from_lidar=moved),
        fact("f", camera_from_lidar=rounded),
        fact("g", camera_from_lidar=moved),
    ]
    assert names(BY_CAMERA, facts) == ["acf", "b", "d", "eg"]


def test_a_frame_that_cannot_be_read_is_alone_so_that_the_others_go_on() -> None:
    broken = fact("b", camera=None, camera_from_lidar=None, failure="Traceback")
    assert names(BY_CAMERA, [broken, fact("a"), replace(broken, source=fact("d").source), fact("c")]) == [
        "b",
        "ac",
        "d",
    ]


def test_frames_without_a_truth_are_told_apart_by_their_camera() -> None:
    wide = Camera.pinhole(300, 300, 300, 100, 600, 200)
    facts = [fact("a", camera_from_lidar=None), fact("b", camera_from_lidar=None, camera=wide), fact("c")]
    assert names(BY_CAMERA, facts) == ["ac", "b"]
