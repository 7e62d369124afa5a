"""The tree of frames of a bag (TF): which transforms never change, and the pose of one frame in another."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from p2o.arrays import Float
from p2o.bags.bag import Bag
from p2o.bags.choice import tf_topics
from p2o.bags.messages import Transform, read_message
from p2o.errors import InputError, UnknownNameError
from p2o.geometry import se3

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class FrameTree:
    """Fixed transforms, `parent_from_child` by child; `moving` ones are known by their parent only."""

    fixed: Mapping[str, tuple[str, Transform]]
    moving: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all frames that hang on fixed transforms."""
        return tuple(sorted({*self.fixed, *(parent for parent, _ in self.fixed.values())}))

    def pose(self, to_frame: str, from_frame: str) -> Float | None:
        """Return to_from_from (4, 4) by the fixed transforms between two frames, or None where nothing joins them.

        Raises InputError where one of them has no rotation or is not finite.
        """
        target, source = bare(to_frame), bare(from_frame)
        poses: dict[str, Float] = {source: np.eye(4)}
        queue = deque([source])
        while queue and target not in poses:
            here = queue.popleft()
            for other, other_from_here in self._neighbours(here):
                if other not in poses:
                    poses[other] = other_from_here @ poses[here]
                    queue.append(other)
        return poses.get(target)

    def known(self, name: str, option: str) -> str:
        """Return the name of a frame; raises UnknownNameError with the nearest ones."""
        if bare(name) not in self.names:
            raise UnknownNameError("frame of TF", name, self.names, where=option)
        return bare(name)

    def moving_above(self, frame: str) -> str | None:
        """Return the nearest frame at or above one that moves in its parent, None where there is none."""
        here, seen = bare(frame), set()
        while here not in seen:
            if here in self.moving:
                return here
            seen.add(here)
            here = self.fixed[here][0] if here in self.fixed else here
        return None

    def _neighbours(self, here: str) -> Iterable[tuple[str, Float]]:
        for child, (parent, transform) in self.fixed.items():
            if child == here:
                yield parent, matrix(transform)
            elif parent == here:
                yield child, se3.inverse(matrix(transform))


def frame_tree(static: Iterable[Transform], changing: Iterable[Transform] = ()) -> FrameTree:
    """Return the tree of transforms of /tf_static, where the last word counts, and of those of /tf.

    What never changes in /tf is as good as static: before there was /tf_static, fixed mountings were sent there.
    """
    fixed = {bare(t.child_frame_id): (bare(t.header.frame_id), t) for t in static}
    first: dict[str, tuple[str, Transform]] = {}
    moving: dict[str, str] = {}
    for transform in changing:
        child, parent = bare(transform.child_frame_id), bare(transform.header.frame_id)
        if child in fixed or child in moving:
            continue
        before = first.setdefault(child, (parent, transform))
        if before[0] != parent or not _same(before[1], transform):
            moving[child] = parent
    return FrameTree({**{c: entry for c, entry in first.items() if c not in moving}, **fixed}, moving)


def read_frame_tree(bag: Bag, *, moving: bool = False) -> FrameTree:
    """Return the frames of a bag: those of /tf_static, and where it is asked for, or they are none, those of /tf.

    Raises InputError for messages that are damaged.
    """
    static, changing = tf_topics(bag)
    fixed = read_transforms(bag, static)
    return frame_tree(fixed, read_transforms(bag, changing) if moving or not fixed else ())


def read_transforms(bag: Bag, topics: Sequence[str]) -> list[Transform]:
    """Return the transforms of topics of TF in the order in which they were recorded; raises as `read_frame_tree`."""
    if not topics:
        return []
    return [
        transform
        for message in bag.messages(topics)
        for transform in read_message(
            message.topic.kind, message.data, ros1=message.ros1, where=f"{bag.path}: {message.topic.name}"
        )
    ]


def bare(frame_id: str) -> str:
    """Return the name of a frame without the slash that old drivers put before it."""
    return frame_id.lstrip("/")


def matrix(transform: Transform) -> Float:
    """Return parent_from_child (4, 4); raises InputError where the quaternion has no length or is not finite."""
    quaternion, translation = np.array(transform.rotation_xyzw), np.array(transform.translation_m)
    # Before anything is multiplied: the product of what some files hold is infinite. NaN is not below either.
    small = bool((np.abs(quaternion) < 2).all() and (np.abs(translation) <= 1e9).all())
    if not small or not 0.5 < float(np.linalg.norm(quaternion)) < 2:
        raise InputError(
            f"the transform from {transform.child_frame_id} to {transform.header.frame_id} is none",
            expected="a quaternion of length 1 and a finite translation",
            got=f"{transform.rotation_xyzw}, {transform.translation_m}",
        )
    return se3.make(rotation_of(quaternion), translation)


def rotation_of(quaternion: NDArray[Any]) -> Float:
    """Return the rotation (3, 3) of a quaternion x y z w of any length."""
    from scipy.spatial.transform import Rotation

    rotation: Float = Rotation.from_quat(quaternion).as_matrix()
    return rotation


def _same(a: Transform, b: Transform) -> bool:
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.subtract((*a.rotation_xyzw, *a.translation_m), (*b.rotation_xyzw, *b.translation_m))
    return bool(np.abs(gap).max() < _SAME)
