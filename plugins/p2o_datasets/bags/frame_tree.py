"""Frame tree of a bag (TF): static and changing transforms, and the pose of one frame in another."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from p2o import Float, InputError, UnknownNameError, se3

from p2o_datasets.bags.bag import Bag
from p2o_datasets.bags.choice import tf_topics
from p2o_datasets.bags.messages import Transform, read_message

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class FrameTree:
    """Static transforms `parent_from_child` by child frame, and the parents of changing frames (`moving`)."""

    fixed: Mapping[str, tuple[str, Transform]]
    moving: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all frames with static transforms."""
        return tuple(sorted({*self.fixed, *(parent for parent, _ in self.fixed.values())}))

    def pose(self, to_frame: str, from_frame: str) -> Float | None:
        """Return to_from_from (4, 4) composed of the static transforms between two frames, or None if not connected.

        Raises InputError for an invalid rotation or values that are not finite.
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
        """Return the name of a frame; raises UnknownNameError with the most similar names."""
        if bare(name) not in self.names:
            raise UnknownNameError("frame of TF", name, self.names, where=option)
        return bare(name)

    def moving_above(self, frame: str) -> str | None:
        """Return the first changing frame on the path from a frame to the root, or None."""
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
    """Return the tree of the transforms of /tf_static, where the last one of a frame applies, and of /tf.

    A transform of /tf that never changes counts as static, as in bags older than /tf_static.
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
    """Read the frame tree of /tf_static, and of /tf if `moving` is true or there are no static transforms.

    Raises InputError for damaged messages.
    """
    static, changing = tf_topics(bag)
    fixed = read_transforms(bag, static)
    return frame_tree(fixed, read_transforms(bag, changing) if moving or not fixed else ())


def read_transforms(bag: Bag, topics: Sequence[str]) -> list[Transform]:
    """Return the transforms of TF topics in the order of recording; raises as `read_frame_tree`."""
    transforms: list[Transform] = []
    for message in bag.messages(topics) if topics else ():
        where = f"{bag.path}: {message.topic.name}"
        transforms += read_message(message.topic.kind, message.data, ros1=message.ros1, where=where)
    return transforms


def bare(frame_id: str) -> str:
    """Return the name of a frame without the leading slash that old drivers add."""
    return frame_id.lstrip("/")


def matrix(transform: Transform) -> Float:
    """Return parent_from_child (4, 4); raises InputError for a quaternion of zero length and values not finite."""
    from scipy.spatial.transform import Rotation

    quaternion, translation = np.array(transform.rotation_xyzw), np.array(transform.translation_m)
    # Checked before any product, which may overflow; NaN fails the comparisons, too.
    small = bool((np.abs(quaternion) < 2).all() and (np.abs(translation) <= 1e9).all())
    if not small or not 0.5 < float(np.linalg.norm(quaternion)) < 2:
        fault = f"the transform from {transform.child_frame_id} to {transform.header.frame_id} is invalid"
        got = f"{transform.rotation_xyzw}, {transform.translation_m}"
        raise InputError(fault, expected="a quaternion of length 1 and a finite translation", got=got)
    return se3.make(Rotation.from_quat(quaternion).as_matrix(), translation)


def _same(a: Transform, b: Transform) -> bool:
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.subtract((*a.rotation_xyzw, *a.translation_m), (*b.rotation_xyzw, *b.translation_m))
    return bool(np.abs(gap).max() < _SAME)
