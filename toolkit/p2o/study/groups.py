"""Which frames of a row are solved together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from p2o.errors import InputError
from p2o.run.run import common_pose
from p2o.study.study import ALL_JOINT, BY_CAMERA
from p2o.study.worker import Facts


def group_size(joint: int, frames: int) -> int:
    """Return how many of so many frames are solved together; where that hangs on their cameras, 1."""
    return {0: 1, ALL_JOINT: frames, BY_CAMERA: 1}.get(joint, joint)


def groups_of(joint: int, facts: Sequence[Facts]) -> list[tuple[Facts, ...]]:
    """Return the frames in groups that are solved together, in their order; `joint` is that of a `StudyRow`."""
    if joint == BY_CAMERA:
        return _by_camera(facts)
    size = group_size(joint, len(facts))
    return [tuple(facts[first : first + size]) for first in range(0, len(facts), size)]


def _by_camera(facts: Sequence[Facts]) -> list[tuple[Facts, ...]]:
    """Return the frames of each camera; what cannot be read is alone, so that the others need not do without."""
    groups: list[list[Facts]] = []
    for fact in facts:
        own = None if fact.failure is not None else next((g for g in groups if _of_one_camera(g[0], fact)), None)
        if own is None:
            groups.append([fact])
        else:
            own.append(fact)
    return [tuple(group) for group in groups]


def _of_one_camera(first: Facts, other: Facts) -> bool:
    if first.failure is not None or (first.camera_name, first.camera) != (other.camera_name, other.camera):
        return False
    try:
        # Facts know the poses of a frame by the same names as the frame.
        poses: Any = (first, other)
        common_pose(poses, "camera_from_lidar")
    except InputError:
        return False
    return True
