"""What accumulators promise of the sweeps that they join, on a drive through the stage."""

from __future__ import annotations

from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import P2OError
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.host.method import Kind
from p2o.testing import stage
from p2o.testing.check import Checks
from p2o.testing.same import Snapshot, require_equal
from p2o.testing.subject import NotApplicable, Subject, lacking, require

CHECKS = Checks(Kind.ACCUMULATOR)

_REFERENCE = 1


def _frames(subject: Subject) -> list[Frame]:
    """Return the frames of the drive, as many before and after the reference as the method wants at most."""
    drive = stage.drive()
    missing = lacking(subject.needs, drive)
    if missing:
        raise NotApplicable(f"the drive through the stage has no {missing[0]}, which it needs")
    built = subject.built()
    first, last = max(0, _REFERENCE - built.past), min(len(drive), _REFERENCE + 1 + built.future)
    return [frame.without_truth() for frame in drive[first:last]]


def _reference(frames: list[Frame]) -> int:
    return [frame.name for frame in frames].index(stage.drive()[_REFERENCE].name)


def _join(subject: Subject) -> tuple[Cloud, str]:
    """Return the joined cloud, and the name of an array of the frames that was written to."""
    frames = _frames(subject)
    snapshot = Snapshot(frames)
    cloud: Cloud = subject.built()(frames, _reference(frames))
    return cloud, snapshot.written


def _gap_m(xyz: Float, others: Float) -> Any:
    """Return how far each point (N, 3) is from the nearest of the others, in metres."""
    from scipy.spatial import cKDTree

    return cKDTree(others).query(xyz)[0]


@CHECKS.of()
def joined_points_lie_on_surfaces(subject: Subject) -> None:
    """Nearly all points of three joined sweeps lie on the stage, seen from the LiDAR of their own frame.

    That is within 5 cm where the poses of the LiDAR are needed, and 15 cm where the method finds out how it moves.
    """
    cloud, _ = subject.once(_join)
    limit_m = 0.05 if "lidar-pose" in subject.needs else 0.15
    off_m = stage.distance_m(se3.apply(stage.stage_from_lidar()[_REFERENCE], cloud.xyz))
    share = float((off_m <= limit_m).mean())
    require(
        share >= 0.97,
        f"only {100 * share:.0f} % of the points are within {limit_m:g} m of a surface of the stage; half of them are "
        f"{np.median(off_m):.2f} m off or more",
    )


@CHECKS.of()
def joined_sweeps_hold_the_frames_own(subject: Subject) -> None:
    """The points of the frame itself are among the joined ones, or within a voxel of 20 cm of one."""
    cloud, _ = subject.once(_join)
    missed = float((_gap_m(stage.drive()[_REFERENCE].cloud.xyz, cloud.xyz) > 0.2).mean())
    require(missed <= 0.05, f"{100 * missed:.0f} % of the frame's own points are not in the joined sweep")


@CHECKS.of()
def joined_sweeps_hold_more(subject: Subject) -> None:
    """Three joined sweeps hold points that the frame's own sweep does not."""
    cloud, _ = subject.once(_join)
    if len(_frames(subject)) == 1:
        raise NotApplicable("its default options join no neighbours")
    more = int((_gap_m(cloud.xyz, stage.drive()[_REFERENCE].cloud.xyz) > 0.02).sum())
    require(more >= 100, f"only {more} of {len(cloud)} points are not of the frame's own sweep")


@CHECKS.of()
def joined_sweeps_repeat(subject: Subject) -> None:
    """The same frames give the same joined sweep, bit for bit, also from a freshly built stage."""
    frames = _frames(subject)
    cloud, _ = subject.once(_join)
    require_equal(cloud, subject.built()(frames, _reference(frames)), "the joined sweeps of the same frames differ")


@CHECKS.of()
def neighbours_are_unchanged(subject: Subject) -> None:
    """Neither the frame nor its neighbours are written to."""
    _, written = subject.once(_join)
    require(not written, f"{written} of the frames was written to")


@CHECKS.of()
def a_frame_alone_stays_as_it_is(subject: Subject) -> None:
    """At the ends of a sequence there are fewer neighbours, and one frame alone keeps its sweep or is refused."""
    frame = _frames(subject)[0]
    try:
        cloud = subject.built()([frame], 0)
    except P2OError as problem:
        require("raised" not in str(problem), str(problem))
        return
    off_m = float(_gap_m(cloud.xyz, frame.cloud.xyz).max())
    require(off_m <= 0.05, f"a frame alone has a point {off_m:.2f} m from its own sweep")
