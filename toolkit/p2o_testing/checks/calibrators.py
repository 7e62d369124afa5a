"""What whole methods promise, on the stage or on the frames of their example."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.perturb import Perturbation, parse_perturbation
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.host.guard import GuardedCalibrator
from p2o.host.method import Example, Kind
from p2o.host.stages import Calibrator
from p2o.results.result import Result
from p2o.results.verdict import Trust, Verdict

from p2o_testing.exact import around, require_near, size_of, truth_of
from p2o_testing.same import Snapshot, difference, require_equal, require_kept
from p2o_testing.subject import Checks, NotApplicable, Subject, require

CHECKS = Checks(Kind.CALIBRATOR)


@dataclass(frozen=True, eq=False)
class Trial:
    """One calibration from a wrong start, with its `error` and that of the start.

    `prepared` is what was made of each of the `frames`; `spoiled` names an array of it that was written to while it was
    solved, `written` one of the frames.
    """

    frames: tuple[Frame, ...]
    truth: Float
    start: Float
    prepared: list[Any]
    result: Result
    spoiled: str
    written: str
    error: PoseError
    start_error: PoseError


def trials(subject: Subject) -> tuple[Trial, ...]:
    """Return the calibrations of the frames of the method: one, or one a frame where they are not taken together."""
    frames = subject.frames
    joint = subject.example is None or subject.example.joint
    groups = [frames] if joint else [(frame,) for frame in frames]
    return tuple(_trial(subject, group, number) for number, group in enumerate(groups))


def _within(subject: Subject) -> Perturbation:
    """Return how near to the truth the method promises to come."""
    return parse_perturbation(Example("").within if subject.example is None else subject.example.within)


def _trial(subject: Subject, frames: tuple[Frame, ...], number: int) -> Trial:
    truth = truth_of(frames)
    if subject.example is None:
        start = around(truth, 1.0, 0.05)[0]
    else:
        size = parse_perturbation(subject.example.perturb)
        start = size.start(truth, np.random.default_rng([0] if subject.example.joint else [0, number]))
    seen = Snapshot(frames)
    stage: GuardedCalibrator = subject.built()
    prepared = [stage.prepare(frame) for frame in frames]
    snapshot = Snapshot(prepared)
    result = stage.solve(prepared, start)
    errors = (pose_error(pose, truth) for pose in (result.camera_from_lidar, start))
    return Trial(frames, truth, start, prepared, result, snapshot.written, seen.written, *errors)


@CHECKS.of()
def calibrator_answers(subject: Subject) -> None:
    """A result names its frames and its start; one that is not solved returns the start with a reason."""
    for trial in subject.once(trials):
        result, names = trial.result, tuple(frame.name for frame in trial.frames)
        require(result.frames == names, f"frames are {result.frames}, not {names}")
        require(np.allclose(result.start, trial.start), "the start in the result is another one")
        if not result.status.solved:
            same = np.allclose(result.camera_from_lidar, trial.start)
            require(same, f"{result.status} does not return the start")
            require(result.reason, f"{result.status} has no reason")


@CHECKS.of()
def calibrator_comes_near_the_truth(subject: Subject) -> None:
    """From a wrong start it is solved as near to the truth as its example promises: 0.3 deg and 0.1 m by default."""
    within = _within(subject)
    for trial in subject.once(trials):
        result, name = trial.result, trial.frames[0].name
        require(result.status.solved, f"{name}: {result.status.value}: {result.reason}")
        where = f"{name}, from a start {size_of(trial.start_error)} away: "
        require_near(result.camera_from_lidar, trial.truth, within.angle_deg, within.distance_m, where)


@CHECKS.of()
def what_is_solved_is_no_start(subject: Subject) -> None:
    """A result that claims to be solved is nearer to the truth than its start: handing that back is no success."""
    within = _within(subject)
    for trial in subject.once(trials):
        status = trial.result.status
        if not status.solved:
            continue
        same = np.allclose(trial.result.camera_from_lidar, trial.start, atol=1e-9)
        far, start_far = size_of(trial.error), size_of(trial.start_error)
        require(not same, f"it says {status.value} and returns its start, {start_far} from the truth")
        nearer = _wrong(trial.error, within) < _wrong(trial.start_error, within)
        require(nearer, f"it says {status.value}, {far} from the truth; the start was {start_far} away")


def repeat(subject: Subject) -> tuple[Float, str]:
    """Return the pose of the first trial from frames with a wrong truth, and what else is prepared of the last frame.

    The method is freshly built, without the guard that removes the truth. One repeat serves every check of
    repeatability: preparing can take long.
    """
    trial = subject.once(trials)[0]
    wrong = around(trial.truth, 7.0, 0.5)[0]
    frames = [replace(frame, camera_from_lidar=wrong) for frame in trial.frames]
    stage = subject.offer.method.build(subject.options)
    if isinstance(stage, Calibrator):
        prepared = [stage.prepare(frame) for frame in frames]
        other = difference(trial.prepared[-1], prepared[-1])
        result = stage.solve(prepared, trial.start)
    else:
        other, result = "", stage(frames, trial.start)
    return se3.check_rigid("camera_from_lidar", result.camera_from_lidar), other


@CHECKS.of()
def calibrations_repeat(subject: Subject) -> None:
    """The same frames and start give the same pose, bit for bit, also from a freshly built method."""
    trial = subject.once(trials)[0]
    pose = trial.result.camera_from_lidar
    if not np.array_equal(pose, subject.once(repeat)[0]):  # the wrong truth may be the reason
        again = subject.built()(trial.frames, trial.start).camera_from_lidar
        require(np.array_equal(pose, again), "the poses of two runs differ")


@CHECKS.of()
def the_truth_is_not_looked_at(subject: Subject) -> None:
    """A frame that tells a wrong truth gives the same pose as one that tells none."""
    pose = subject.once(trials)[0].result.camera_from_lidar
    same = np.array_equal(pose, subject.once(repeat)[0])
    require(same, "a wrong truth in the frame changes the pose")


@CHECKS.of()
def calibrator_input_is_unchanged(subject: Subject) -> None:
    """Neither the frames are written to, nor what was prepared of them: it may be used again."""
    for trial in subject.once(trials):
        require(not trial.written, f"{trial.written} of the frames was written to")
        require(not trial.spoiled, f"{trial.spoiled} of what was prepared was written to while it was solved")


@CHECKS.of()
def preparations_repeat(subject: Subject) -> None:
    """What is prepared of a frame is the same when it is prepared again, bit for bit, alone and by a new stage."""
    trial = subject.once(trials)[0]
    stage = _preparing(subject)
    if subject.once(repeat)[1]:  # the wrong truth may be the reason
        again = stage.prepare(trial.frames[-1])
        require_equal(trial.prepared[-1], again, "what is prepared of the same frame differs")


@CHECKS.of()
def preparations_are_kept(subject: Subject) -> None:
    """What is prepared of a frame can be kept: what is read from the cache is what was prepared."""
    _preparing(subject)
    require_kept(subject.once(trials)[0].prepared[0], "what is prepared")


def _preparing(subject: Subject) -> GuardedCalibrator:
    stage: GuardedCalibrator = subject.built()
    if not stage.prepares:
        raise NotApplicable("it is a plain function of frames, and prepares nothing")
    return stage


@CHECKS.of()
def results_have_a_verdict(subject: Subject) -> None:
    """A result that is solved is not refused, and one that is not solved is."""
    for trial in subject.once(trials):
        status, verdict = trial.result.status, trial.result.verdict
        require(isinstance(verdict, Verdict), f"the verdict is {type(verdict).__name__}")
        refused = verdict.trust is Trust.REFUSED
        require(refused != status.solved, f"the status is {status.value}, the verdict {verdict.trust.value}")


def _wrong(error: PoseError, within: Perturbation) -> float:
    """Return how wrong a pose is, in parts of what is promised."""
    return error.rotation_deg / max(within.angle_deg, 1e-9) + error.translation_m / max(within.distance_m, 1e-9)
