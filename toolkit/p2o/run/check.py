"""Check whether an extrinsic in use is still correct: jointly on some frames, or for each frame of a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, Unpack

import numpy as np

from p2o.arrays import Float
from p2o.confidence.audit import EdgeStep, Evidence, Rates, audit, edge_step
from p2o.confidence.watch import Rule, watched
from p2o.errors import InputError
from p2o.features.view import View
from p2o.frames.direction import Direction, pose_direction, unit_remark
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.geometry.perturb import parse_accuracy
from p2o.geometry.rough_start import is_rough_start
from p2o.host.calibration_file import InitialGuess, read_calibration
from p2o.host.registry import Registry
from p2o.results.check import Check, CheckStatus, Slip, Watch, size_text
from p2o.run.initial_guess import common_pose, one_camera
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Plan
from p2o.run.run import frame_at, planned, selected
from p2o.run.words import parse_settings

Data = str | Dataset | Sequence[Frame] | Frame
Tell = Callable[[str, int, int], None]
"""Callback for progress: name of the frame, number of finished frames, total number."""


class Words(TypedDict, total=False):
    """Common parameters of `check` and `watch`: the frames to evaluate, and the methods.

    All but `on_frame` are as in `p2o.calibrate`; what is left out, or None, takes the default of `Recipe`.
    """

    frames: str | None
    extractor: str | None
    matcher: str | None
    options: Mapping[str, Mapping[str, Any]] | Sequence[str] | None
    seed: int | None
    on_frame: Tell | None
    registry: Registry | None


def check(
    data: Data,
    extrinsic: Float | str,
    *,
    notice: str | None = None,
    alarm_rate: float = 0.01,
    power: float = 0.95,
    **words: Unpack[Words],
) -> Check:
    """Check whether an extrinsic is correct on all frames jointly; the same as `p2o check`.

    `extrinsic` is camera_from_lidar (4, 4), or `truth`, `start` or a file (`given_extrinsic`). `notice` are the errors
    that must be detected ("0.3deg 3cm"); if the frames do not suffice for that, the check is undecided. `alarm_rate` is
    the false alarm rate for correct extrinsics, and `power` the detection rate of errors as large as the limit of an
    axis. `words` are frames, extractor, matcher, options, seed and registry as in `p2o.calibrate`, and `on_frame`,
    which is called for each frame (`Words`). Raises a P2OError for anything wrong with the words, the data or the
    plugins, and for an extrinsic that is the inverse of what it should be.
    """
    rates = _rates(notice, alarm_rate, power)
    opened = _Opened.of(data, words)
    views: list[View] = []
    read: list[Frame] = []
    for frame in opened.frames():
        views.append(opened.pipeline.prepare(frame.without_truth()))
        read.append(frame)
    one_camera(read)
    given = _Given.of(extrinsic, read, opened.plan.registry)
    outcome = audit(Evidence.of(views, given.camera_from_lidar, opened.pipeline), rates)
    given.refuse_inverse(outcome.holding)
    return replace(outcome, warnings=(*given.warnings, *outcome.warnings), **opened.stamp)


def watch(
    data: Data,
    extrinsic: Float | str,
    *,
    alarms_per_hour: float = 0.1,
    rate_hz: float | None = None,
    settle: int = 20,
    **words: Unpack[Words],
) -> Watch:
    """Detect when an extrinsic slipped during a drive, with frames in order; the same as `p2o check --watch`.

    False alarms come `alarms_per_hour` at `rate_hz` frames a second (default: from the times of the frames, else 10).
    The first `settle` frames define the normal level: a slip before them is for `check` to detect. The other words are
    those of `check`. Raises InputError as `check`, and for fewer frames than have to settle.
    """
    opened = _Opened.of(data, words)
    count = len(opened.indices)
    if settle < 1 or count <= settle:
        expected = f"more than the {settle} that say what is usual"
        hint = "take more frames of the drive, or `p2o check` without --watch"
        raise InputError("there are too few frames to watch", expected=expected, got=count, hint=hint)
    names: list[str] = []
    times: list[float | None] = []
    steps: list[EdgeStep | None] = []
    given: _Given | None = None
    cameras: set[str] = set()
    for frame in opened.frames():
        if given is None:
            given = _Given.of(extrinsic, [frame], opened.plan.registry)
        cameras.add(frame.camera_name)
        view = opened.pipeline.prepare(frame.without_truth())
        step = edge_step([view], given.camera_from_lidar, opened.pipeline.matcher, opened.pipeline.options)
        names.append(frame.name)
        times.append(frame.time_s)
        steps.append(None if isinstance(step, str) else step)
    if len(cameras) > 1:
        raise InputError("frames of several cameras have no extrinsic in common", got=", ".join(sorted(cameras)))
    rule = Rule(alarms_per_hour, rate_hz or _rate_hz(times), settle)
    seen = watched(names, steps, rule)
    telling = sum(step is not None for step in steps)
    holding, reason = _of_drive(seen.slips, telling, count)
    assert given is not None  # there are more frames than have to settle
    given.refuse_inverse(holding)
    pose = given.camera_from_lidar
    charts: dict[str, Any] = {
        name: getattr(seen, name) for name in ("slips", "detectable", "frames", "limit", "correlation")
    }
    charts |= {name: getattr(rule, name) for name in ("slack", "alarms_per_hour", "rate_hz")}
    return Watch(pose, holding, reason, settled=settle, warnings=given.warnings, **charts, **opened.stamp)


@dataclass(frozen=True, eq=False)
class _Opened:
    """Frames to evaluate, by index, and the pipeline that extracts and matches their edges."""

    plan: Plan
    dataset: Any
    indices: Sequence[int]
    pipeline: Pipeline
    tell: Tell

    @classmethod
    def of(cls, data: Data, words: Words) -> _Opened:
        for word in words.keys() - Words.__annotations__.keys():
            raise TypeError(f"unexpected keyword argument '{word}'")
        given: dict[str, Any] = {name: words.get(name) for name in ("frames", "extractor", "matcher", "seed")}
        if (options := words.get("options")) is not None:
            given["options"] = parse_settings(options)
        given |= {"data": data if isinstance(data, str) else None, "joint": True}
        plan = planned(given, words.get("registry") or Registry.load())
        method = plan.parts["matcher"].offer.method
        if "pairs" not in method.gives:
            expected = "a matcher that gives pairs, such as ogm"
            raise InputError("a check needs pairs of edges", where="--matcher", expected=expected, got=method.name)
        frames = [data] if isinstance(data, Frame) else data
        dataset = plan.dataset() if isinstance(data, str) else plan.joined(frames)
        pipeline = plan.calibrator()
        assert isinstance(pipeline, Pipeline)
        tell = words.get("on_frame") or (lambda name, done, total: None)
        return cls(plan, dataset, selected(dataset, plan.recipe.frames)[1], pipeline, tell)

    @property
    def stamp(self) -> dict[str, Any]:
        """Return the recipe and the versions, the provenance of a result."""
        return {"recipe": self.plan.described(), "versions": self.plan.versions()}

    def frames(self) -> Any:
        """Iterate over the frames; raises InputError for one that lacks what the methods need."""
        for done, index in enumerate(self.indices):
            frame = frame_at(self.dataset, index)
            self.plan.check_frame(frame)
            self.tell(frame.name, done, len(self.indices))
            yield frame


def _rates(notice: str | None, alarm_rate: float, power: float) -> Rates:
    for name, value in (("alarm_rate", alarm_rate), ("power", power)):
        if not 0 < value < 1:
            raise InputError(f"{name} is out of bounds", expected="a share between 0 and 1", got=value)
    if notice is None:
        return Rates(alarm_rate, power)
    size = parse_accuracy(notice, "--notice")
    return Rates(alarm_rate, power, size.angle_deg, size.distance_m)


@dataclass(frozen=True, eq=False)
class _Given:
    """The extrinsic (4, 4) under check, the text that names it, its likely direction, and warnings about it."""

    camera_from_lidar: Float
    name: str | None
    direction: Direction
    warnings: tuple[str, ...]

    @classmethod
    def of(cls, extrinsic: Float | str, frames: Sequence[Frame], registry: Registry) -> _Given:
        """Return the extrinsic, compared with the sweep of the first frame."""
        name = extrinsic if isinstance(extrinsic, str) else None
        if isinstance(extrinsic, str):
            pose, remarks, quaternion = given_extrinsic(extrinsic, frames, registry)
        else:
            pose, remarks, quaternion = InitialGuess(se3.check_rigid("the extrinsic", extrinsic))
        given: dict[str, Any] = {"where": name, "quaternion": quaternion}
        direction = pose_direction(frames[0].cloud, frames[0].camera, pose, name="the extrinsic", **given)
        remarks = (*remarks, *direction.warnings("the extrinsic", name), *unit_remark(pose, "the extrinsic", name))
        return cls(pose, name, direction, remarks)

    def refuse_inverse(self, holding: CheckStatus) -> None:
        """Raise InputError if no edges fit the pose and the scene is upright only at its inverse."""
        if self.direction is Direction.POSSIBLY_INVERSE and holding is CheckStatus.CANNOT_TELL:
            text = "the extrinsic looks like lidar_from_camera"
            got = "a pose at which no edges match, and whose inverse is upright"
            raise InputError(text, where=self.name, expected="camera_from_lidar", got=got)


def _rate_hz(times: Sequence[float | None]) -> float:
    """Return the frame rate in Hz; 10 if the times are unknown."""
    known = np.array([time for time in times if time is not None], np.float64)
    steps = np.diff(known)
    usual = float(np.median(steps)) if len(known) == len(times) and len(steps) else 0.0
    return 1 / usual if usual > 0 else 10.0


def _of_drive(slips: Sequence[Slip], telling: int, count: int) -> tuple[CheckStatus, str]:
    """Return the status of a drive, and the reason."""
    if slips:
        first = slips[0]
        size = size_text(first.unit, first.size, "+")
        return CheckStatus.OFF, f"{first.axis} slipped by about {size}, noticed at {first.noticed_frame}"
    if 2 * telling < count:
        return CheckStatus.CANNOT_TELL, f"{count - telling} of {count} frames give no estimate"
    return CheckStatus.HOLDS, f"no slip was noticed in {count} frames"


OF_DATA = {"truth": "camera_from_lidar", "start": "start"}
"""Names of the poses of a frame, and the attributes of `Frame` that hold them."""


def given_extrinsic(text: str, frames: Sequence[Frame], registry: Registry, where: str = "--extrinsic") -> InitialGuess:
    """Return camera_from_lidar (4, 4) and remarks of `truth`, `start`, "roughly ..." or a calibration file.

    The readers of `registry` read the file. Raises InputError for a file that is missing or holds no extrinsic, and if
    the frames hold no such pose.
    """
    if text in OF_DATA:
        pose = common_pose(frames, OF_DATA[text])
        if pose is None:
            message = f"the data hold no {'true extrinsic' if text == 'truth' else 'start'}"
            raise InputError(message, where=where, expected="a file with the extrinsic", got=text)
        return InitialGuess(pose)
    if is_rough_start(text):
        return InitialGuess.read(text, where, registry=registry)
    calibration = read_calibration(text, where, registry=registry)
    return InitialGuess(calibration.extrinsic(text), calibration.remarks, calibration.quaternion)
