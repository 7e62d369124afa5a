"""What initializers promise of the starts that they propose."""

from __future__ import annotations

import numpy as np

from p2o.arrays import Float
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.host.method import Kind
from p2o.run.run import common_pose
from p2o.testing import stage
from p2o.testing.check import Checks
from p2o.testing.exact import around
from p2o.testing.inputs import bare_view, view
from p2o.testing.same import unchanged
from p2o.testing.subject import Subject, require

CHECKS = Checks(Kind.INITIALIZER)


@CHECKS.of()
def starts_are_no_worse(subject: Subject) -> None:
    """On exact features, from 2 deg and 10 cm, one of the proposed starts is no farther from the truth in the image."""
    views, truth = _given(subject)
    start = around(truth, 2.0, 0.1)[0]
    poses = subject.built()(views, start)
    shifts = [_shift_px(pose, truth) for pose in poses]
    require(
        min(shifts) <= 1.05 * _shift_px(start, truth) + 1e-9,
        f"the best of {len(poses)} starts is {min(shifts):.1f} px off, the given one {_shift_px(start, truth):.1f} px",
    )


@CHECKS.of()
def starts_without_edges_are_no_crash(subject: Subject) -> None:
    """Views in which nothing was found give a start near the given one, and no error."""
    truth = stage.camera_from_lidar()
    poses = subject.built()([bare_view(subject)], truth)
    require(any(pose_error(pose, truth).rotation_deg < 30 for pose in poses), "no start within 30 deg of the given one")


@CHECKS.of()
def starts_repeat(subject: Subject) -> None:
    """The same views and start give the same poses, bit for bit; the views are not written to."""
    views, truth = _given(subject)
    start = around(truth, 2.0, 0.1)[0]
    with unchanged(views):
        first, second = (subject.built()(views, start) for _ in range(2))
    require(len(first) == len(second), f"{len(first)} and {len(second)} starts")
    require(all(map(np.array_equal, first, second)), "the starts of two runs differ")


def _given(subject: Subject) -> tuple[list[View], Float]:
    """Return views to try the method on, and the truth: the stage, or what it prepares of the frames it asks for."""
    prepare = getattr(subject.built(), "prepare", None)
    if prepare is None:
        return [view(subject)], stage.camera_from_lidar()
    frames = subject.frames
    truth = common_pose(frames, "camera_from_lidar")
    require(truth is not None, f"{frames[0].name} has no truth: the frames of an example must")
    assert truth is not None
    features = view(subject)
    return [
        View(frame.name, frame.camera, features.image, features.cloud, frame.twist, prepared=prepare(frame))
        for frame in frames
    ], truth


def _shift_px(pose: Float, truth: Float) -> float:
    """Return how far apart two poses put the outlines of the stage, in pixels on average."""
    xyz = stage.view().cloud_edges.xyz
    here, there = (stage.camera().project(se3.apply(p, xyz)) for p in (pose, truth))
    return float(np.nanmean(np.linalg.norm(here - there, axis=1)))
