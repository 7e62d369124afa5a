"""Frame tree of a bag: the static transforms of /tf_static, and those of /tf that never change."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from p2o import InputError
from p2o.reading import read_pose
from p2o_formats.frame_tree import Edge, FrameTree, Posed, bare

from p2o_datasets.bags.bag import Bag
from p2o_datasets.bags.choice import tf_topics
from p2o_datasets.bags.messages import Transform, read_message

_SAME = 1e-9


def frame_tree(static: Iterable[Transform], changing: Iterable[Transform] = ()) -> FrameTree:
    """Return the tree of the transforms of /tf_static, where the last one of two frames applies, and of /tf.

    A transform of /tf that never changes counts as static, as in bags older than /tf_static.
    """
    fixed = {(bare(t.child_frame_id), bare(t.header.frame_id)): t for t in static}
    children = {child for child, _ in fixed}
    first: dict[str, tuple[str, Transform]] = {}
    moving: dict[str, str] = {}
    for transform in changing:
        child, parent = bare(transform.child_frame_id), bare(transform.header.frame_id)
        if child in children or child in moving:
            continue
        before = first.setdefault(child, (parent, transform))
        if before[0] != parent or not _same(before[1], transform):
            moving[child] = parent
    kept = [transform for child, (_, transform) in first.items() if child not in moving]
    edges = [Edge(t.header.frame_id, t.child_frame_id, partial(_posed, t)) for t in (*kept, *fixed.values())]
    return FrameTree(edges, moving)


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


def _posed(transform: Transform) -> Posed:
    """Return parent_from_child (4, 4) and remarks; raises InputError for values that are no rigid transform."""
    frames = f"the transform from {transform.child_frame_id} to {transform.header.frame_id}"
    value = {"rotation_xyzw": transform.rotation_xyzw, "translation_m": transform.translation_m}
    try:
        return read_pose(frames, value, Path("/tf_static"))
    except InputError as problem:
        raise InputError(f"{frames} is invalid", expected=problem.expected, got=problem.got) from problem


def _same(a: Transform, b: Transform) -> bool:
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.subtract((*a.rotation_xyzw, *a.translation_m), (*b.rotation_xyzw, *b.translation_m))
    return bool(np.abs(gap).max() < _SAME)
