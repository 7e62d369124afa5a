"""What datasets promise of their frames."""

from __future__ import annotations

from p2o.frames.frame import Dataset, Frame
from p2o.host.method import Kind
from p2o.run.fit import HELD
from p2o.testing.check import Checks, gives
from p2o.testing.same import require_equal
from p2o.testing.subject import CheckFailed, Subject, require

CHECKS = Checks(Kind.DATASET)


def _opened(subject: Subject) -> Dataset:
    dataset: Dataset = subject.built()
    return dataset


def _some(dataset: Dataset) -> list[int]:
    """Return the first and the last index: reading all could take minutes."""
    return sorted({0, len(dataset) - 1})


def _drive(subject: Subject) -> list[Frame]:
    """Return the first frames and the last one, in order."""
    dataset = _opened(subject)
    return [dataset[index] for index in sorted({*range(min(3, len(dataset))), len(dataset) - 1})]


@CHECKS.of()
def names_come_before_frames(subject: Subject) -> None:
    """There is at least one frame, and each name is that of its frame."""
    dataset = _opened(subject)
    require(len(dataset), "the dataset has no frames")
    for index in _some(dataset):
        require(dataset[index].name == dataset.names[index], f"frame {index} is called {dataset[index].name!r}")


@CHECKS.of()
def frames_are_read_alike_again(subject: Subject) -> None:
    """Reading a frame twice, and from a freshly built dataset, gives the same frame, bit for bit."""
    dataset, again = _opened(subject), _opened(subject)
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


@CHECKS.of(gives(*HELD))
def frames_hold_what_is_given(subject: Subject) -> None:
    """Every frame holds what `gives` says of all of them."""
    for frame in subject.once(_drive):
        missing = sorted(word for word in subject.gives & HELD.keys() if HELD[word](frame) is None)
        require(not missing, f"{frame.name} has no {', '.join(missing)}, though `gives` says so")


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
    """A frame whose sensors know their poses says of which sequence it is: a pose alone tells nothing."""
    for frame in subject.once(_drive):
        posed = frame.lidar_world_from_lidar is not None or frame.camera_world_from_camera is not None
        require(frame.sequence or not posed, f"{frame.name} has a pose, but is of no sequence")
