"""What datasets promise of their frames, and accumulators of the sweeps that they join."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from p2o.errors import P2OError
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.host.method import Kind
from p2o.run.fit import FRAME_CONTENT

from p2o_testing import stage
from p2o_testing.exact import nearest_m
from p2o_testing.same import Call, require_equal
from p2o_testing.subject import CheckFailed, Checks, NotApplicable, Subject, gives, lacking, require

CHECKS = Checks(Kind.DATASET)


def _some(dataset: Dataset) -> list[int]:
    """Return the first and the last index: reading all could take minutes."""
    return sorted({0, len(dataset) - 1})


def _drive(subject: Subject) -> list[Frame]:
    """Return the first frames and the last one, in order."""
    dataset = subject.built()
    return [dataset[index] for index in sorted({*range(min(3, len(dataset))), len(dataset) - 1})]


@CHECKS.of()
def names_come_before_frames(subject: Subject) -> None:
    """There is at least one frame, and each name is that of its frame."""
    dataset = subject.built()
    require(len(dataset), "the dataset has no frames")
    for index in _some(dataset):
        require(dataset[index].name == dataset.names[index], f"frame {index} is called {dataset[index].name!r}")


@CHECKS.of()
def other_folders_are_not_recognised(subject: Subject) -> None:
    """An empty folder is not recognised."""
    recognises = subject.offer.method.recognises
    with TemporaryDirectory() as folder:
        require(recognises is None or not recognises(Path(folder)), "an empty folder is recognised")


@CHECKS.of()
def frames_are_read_alike_again(subject: Subject) -> None:
    """Reading a frame twice, and from a freshly built dataset, gives the same frame, bit for bit."""
    dataset, again = subject.built(), subject.built()
    for index in _some(dataset):
        first = dataset[index]
        require_equal(first, dataset[index], f"frame {index} differs when read again")
        require_equal(first, again[index], f"frame {index} differs in a fresh dataset")


@CHECKS.of()
def datasets_are_sequences(subject: Subject) -> None:
    """Negative indices and slices work as in a list, and an index beyond the end raises IndexError."""
    dataset = subject.offer.method.build(subject.options)
    require(dataset[-1].name == dataset.names[-1], "index -1 is not the last frame")
    require([f.name for f in dataset[:1]] == list(dataset.names[:1]), "slice [:1] is not the first frame")
    try:
        dataset[len(dataset)]
    except IndexError:
        return
    raise CheckFailed("an index beyond the end raises no IndexError")


@CHECKS.of(gives(*FRAME_CONTENT))
def frames_hold_what_is_given(subject: Subject) -> None:
    """Every frame contains the content that `gives` lists."""
    for frame in subject.once(_drive):
        missing = sorted(word for word in subject.gives & FRAME_CONTENT.keys() if FRAME_CONTENT[word](frame) is None)
        require(not missing, f"{frame.name} has no {', '.join(missing)}, though `gives` lists it")


@CHECKS.of()
def times_do_not_fall_in_a_sequence(subject: Subject) -> None:
    """Frames of one sequence and one camera come in the order of their times, with a time each or none at all."""
    last: dict[tuple[str, str], Frame] = {}
    for frame in subject.once(_drive):
        drive = (frame.sequence, frame.camera_name)
        before = last.get(drive) if frame.sequence else None
        if before is not None:
            require((before.time_s is None) == (frame.time_s is None), f"{before.name} or {frame.name} has no time")
            if before.time_s is not None and frame.time_s is not None:
                require(before.time_s < frame.time_s, f"{frame.name} is not later than {before.name}, which is before")
        last[drive] = frame


@CHECKS.of()
def poses_belong_to_a_sequence(subject: Subject) -> None:
    """A frame with poses of its sensors names its sequence, because a pose is defined within a sequence only."""
    for frame in subject.once(_drive):
        posed = frame.lidar_world_from_lidar is not None or frame.camera_world_from_camera is not None
        require(frame.sequence or not posed, f"{frame.name} has a pose, but is of no sequence")


ACCUMULATORS = Checks(Kind.ACCUMULATOR)

_REFERENCE = 1


def _frames(subject: Subject) -> list[Frame]:
    """Return the frames of the drive, up to the maximum number that the method uses before and after the reference."""
    drive = stage.drive()
    missing = lacking(subject.needs, drive)
    if missing:
        raise NotApplicable(f"the drive through the stage has no {missing[0]}, which it needs")
    built = subject.built()
    first, last = max(0, _REFERENCE - built.past), min(len(drive), _REFERENCE + 1 + built.future)
    return [frame.without_truth() for frame in drive[first:last]]


def _join(subject: Subject) -> Call:
    """Return the call of the method on the frames of the drive."""
    frames = _frames(subject)
    return Call.of(subject, frames, [frame.name for frame in frames].index(stage.drive()[_REFERENCE].name))


def _joined(subject: Subject) -> Cloud:
    cloud: Cloud = subject.once(_join).answer
    return cloud


@ACCUMULATORS.of()
def joined_points_lie_on_surfaces(subject: Subject) -> None:
    """Nearly all points of three joined sweeps lie on the stage, seen from the LiDAR of their own frame.

    That is within 5 cm where the poses of the LiDAR are needed, and 15 cm where the method finds out how it moves.
    """
    cloud = _joined(subject)
    limit_m = 0.05 if "lidar-pose" in subject.needs else 0.15
    off_m = stage.distance_m(se3.apply(stage.stage_from_lidar()[_REFERENCE], cloud.xyz))
    share = float((off_m <= limit_m).mean())
    require(
        share >= 0.97,
        f"only {100 * share:.0f} % of the points are within {limit_m:g} m of a surface of the stage; half of them are "
        f"{np.median(off_m):.2f} m off or more",
    )


@ACCUMULATORS.of()
def joined_sweeps_hold_the_frames_own(subject: Subject) -> None:
    """The points of the frame itself are among the joined ones, or within a voxel of 20 cm of one."""
    missed = float((nearest_m(stage.drive()[_REFERENCE].cloud.xyz, _joined(subject).xyz) > 0.2).mean())
    require(missed <= 0.05, f"{100 * missed:.0f} % of the frame's own points are not in the joined sweep")


@ACCUMULATORS.of()
def joined_sweeps_hold_more(subject: Subject) -> None:
    """Three joined sweeps hold points that the frame's own sweep does not."""
    cloud = _joined(subject)
    if len(_frames(subject)) == 1:
        raise NotApplicable("its default options join no neighbours")
    more = int((nearest_m(cloud.xyz, stage.drive()[_REFERENCE].cloud.xyz) > 0.02).sum())
    require(more >= 100, f"only {more} of {len(cloud)} points are not of the frame's own sweep")


@ACCUMULATORS.of()
def joined_sweeps_repeat(subject: Subject) -> None:
    """The same frames give the same joined sweep, bit for bit, also from a freshly built stage."""
    subject.once(_join).require_repeated(subject, "joined sweeps")


@ACCUMULATORS.of()
def neighbours_are_unchanged(subject: Subject) -> None:
    """Neither the frame nor its neighbours are written to."""
    subject.once(_join).require_unwritten()


@ACCUMULATORS.of()
def a_frame_alone_stays_as_it_is(subject: Subject) -> None:
    """At the ends of a sequence there are fewer neighbours, and one frame alone keeps its sweep or is refused."""
    frame = _frames(subject)[0]
    try:
        cloud = subject.built()([frame], 0)
    except P2OError as problem:
        require("raised" not in str(problem), str(problem))
        return
    off_m = float(nearest_m(cloud.xyz, frame.cloud.xyz).max())
    require(off_m <= 0.05, f"a frame alone has a point {off_m:.2f} m from its own sweep")
