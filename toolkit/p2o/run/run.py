"""Run a recipe on frames: the common implementation of the command line and the Python API."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, P2OError, PluginError
from p2o.frames.frame import Dataset, Frame
from p2o.frames.selection import select
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import pose_error
from p2o.host.registry import Registry
from p2o.problems.distinct_views import evenly_chosen
from p2o.results.result import Result, RigResult, Status
from p2o.run.assembly import Assembly
from p2o.run.initial_guess import common_pose, given_guess, listed_errors, one_camera, start_of, starts_of
from p2o.run.outcome import FailedFrame, Row, Run
from p2o.run.presets import preset_of
from p2o.run.protocol import protocol_of
from p2o.run.read_again import MAX_FRAMES_IN_MEMORY, ReadAgain, frame_infos, without_truth
from p2o.run.recipe import Plan, Recipe
from p2o.run.words import parse_settings
from p2o.runtime.native import for_each
from p2o.runtime.stages import counted

if TYPE_CHECKING:
    from p2o.run.rig_solve import RigCameraFrames

_T = TypeVar("_T")
Frames = Sequence[Frame] | Dataset


@dataclass(frozen=True, eq=False)
class Progress:
    """Argument of `on_progress`: before each calibration with `row` None, and after it with its row.

    A frame that cannot be calibrated is reported once, with `failed` and without frames. `camera` is the camera of a
    rig whose frames these are, empty in runs without a rig.
    """

    done: int
    total: int
    name: str
    frames: Sequence[Frame]
    assembly: Assembly
    row: Row | None = None
    failed: FailedFrame | None = None
    camera: str = ""


OnProgress = Callable[[Progress], None]
OnNames = Callable[[Sequence[str], Sequence[str]], None]
Calibration = Callable[[Assembly, Sequence[Frame], Float], Result]
RigCalibration = Callable[[Assembly, Sequence["RigCameraFrames"], Mapping[str, Float]], RigResult]


def calibrate(
    data: str | Dataset | Sequence[Frame] | Frame | None = "synthetic:",
    *,
    frames: str | None = None,
    extractor: str | None = None,
    matcher: str | None = None,
    solver: str | None = None,
    init: str | None = None,
    calibrator: str | None = None,
    options: Mapping[str, Mapping[str, Any]] | Sequence[str] | None = None,
    perturb: str | None = None,
    protocol: str | None = None,
    seed: int | None = None,
    joint: bool | None = None,
    rig: bool | str | Path | Mapping[str, Any] | None = None,
    accumulate: str | None = None,
    witness: str | None = None,
    start: Float | str | None = None,
    on_progress: OnProgress | None = None,
    registry: Registry | None = None,
) -> Run:
    """Calibrate frames and return a `Run`; the same as `p2o run`, whose help explains the words.

    `data` is a text DATASET:PATH, a dataset, frames or one frame. `start` is camera_from_lidar (4, 4) to begin with, or
    describes it in words (`p2o.geometry.rough_start`) or names a calibration file; without it and without `perturb`
    each frame's own start is used. `options` maps stage to field to value, or lists texts STAGE.FIELD=VALUE. `protocol`
    names a publication's (`p2o.run.protocol`): its starts are drawn, and its figures are in `Run.summary`. `rig` gives
    a row for each camera: True if frames name theirs, else a rig file or its content, and `Run.rig` if that contains
    the fixed transforms between the cameras. Omitted arguments have the defaults of `Recipe`. Raises a P2OError for
    anything wrong with the words, the data or the plugins. Too few matches and the like are no errors but a status of
    the result, and a bad frame among good ones is in `Run.failed`.
    """
    given: Sequence[Frame] | Dataset | None = None
    if isinstance(data, Frame):
        given, data = [data], None
    elif data is not None and not isinstance(data, str):
        given, data = data, None
    elif data is None:
        raise InputError("there are no data", expected="DATASET:PATH, a dataset or frames", got=None)
    words: dict[str, Any] = {"data": data, "frames": frames, "extractor": extractor, "matcher": matcher}
    words |= {"solver": solver, "init": init, "calibrator": calibrator, "seed": seed, "joint": joint}
    words |= {"accumulate": accumulate, "witness": witness, "perturb": perturb, "protocol": protocol}
    words["options"] = None if options is None else parse_settings(options)
    words["start"] = start if isinstance(start, str) else None
    words["rig"] = str(rig) if isinstance(rig, Path) else dict(rig) if isinstance(rig, Mapping) else rig
    plan = planned(words, Registry.load() if registry is None else registry)
    done = run(plan, given, start=None if isinstance(start, str) else start, on_progress=on_progress)
    return done if protocol is None else replace(done, protocol=protocol_of(protocol))


def planned(words: Mapping[str, Any], registry: Registry, where: str = "protocol") -> Plan:
    """Return the plan of words of a recipe, without those that are None, and of the words `method` and `protocol`.

    `method` names a preset (`p2o.run.presets`), `protocol` that of a publication, named `where` in errors.
    """
    given = {name: value for name, value in words.items() if value is not None or name == "data"}
    if (protocol := given.pop("protocol", None)) is not None:
        given["perturb"] = starts_of(protocol, given.get("perturb"), where)
    if (method := given.pop("method", None)) is not None:
        given = preset_of(method, registry).merged(given)
    return Recipe.of(**given).resolve(registry)


def run(
    plan: Plan,
    frames: Frames | None = None,
    *,
    start: Float | None = None,
    on_progress: OnProgress | None = None,
    on_names: OnNames | None = None,
    calibration: Calibration = Assembly.__call__,
    rig_calibration: RigCalibration | None = None,
) -> Run:
    """Run a resolved recipe on its own dataset, or on `frames`; frames are read one at a time unless joint.

    A plugin that fails on a frame ends that frame with status stage-failed and its reason (`P2O_DEBUG=1` or
    `P2O_STRICT=1`: it raises). A frame that cannot be read or used, or a camera of a rig with such a frame, is in
    `Run.failed`; the others go on. A joint calibration and its result have the frames in the order of the dataset,
    whatever the order of `recipe.frames`. Raises InputError where no frame can be used, and for the first bad one with
    `joint`. `on_names` receives the names of all frames, and of the cameras of a rig, before any of them is calibrated.
    `calibration` and `rig_calibration` call the built methods, by default in this process (`p2o.run.isolated`: in
    another one).
    """
    guess = given_guess(plan, start)
    dataset = plan.dataset() if frames is None else plan.joined(frames)
    groups = _groups(plan, dataset, *guess)
    if on_names is not None:
        on_names([name for group in groups for name in group.names], [g.camera for g in groups if plan.rig is not None])
    parallel = frames is None and "accumulate" not in plan.parts and plan.parts["data"].offer.method.parallel
    read = partial(_read, plan, dataset, parallel, MAX_FRAMES_IN_MEMORY // (1 if plan.rig is None else len(groups)))
    with _Calibrations(plan, plan.assembly(), len(groups), on_progress or (lambda _: None), calibration) as done:
        for number, group in enumerate(groups):
            done.add(number, group, read)
    return Run(
        tuple(done.rows),
        joint=plan.recipe.joint,
        failed=tuple(done.failed),
        rig=None if plan.rig is None else done.common_result(plan.rig.camera_from_body, rig_calibration),
    )


MOST_JOINT_FRAMES = 128
"""Joint calibrations of one camera use at most this many frames, which bounds their time and memory."""


def used_jointly(frames: Sequence[_T]) -> list[_T]:
    """Return the frames that a joint calibration uses: at most `MOST_JOINT_FRAMES` of them, evenly spaced."""
    return [frames[number] for number in evenly_chosen(np.ones(len(frames)), MOST_JOINT_FRAMES)]


@dataclass(frozen=True, eq=False)
class _Group:
    """Frames that are calibrated together: their indices in the order of the dataset, and their names.

    `camera` is that of a rig, `start` (4, 4) a given initial guess, `error` (4, 4) that of a list of starts. Results
    repeat the `remarks`.
    """

    indices: Sequence[int]
    camera: str = ""
    start: Float | None = None
    remarks: tuple[str, ...] = ()
    names: Sequence[str] = ()
    error: Float | None = None

    @property
    def name(self) -> str:
        return self.camera or (self.names[0] if len(self.names) == 1 else f"{len(self.names)} frames jointly")


def _groups(plan: Plan, dataset: Frames, start: Float | None, remarks: tuple[str, ...]) -> list[_Group]:
    """Return the chosen frames by camera of a rig, all of a joint calibration, or each separately."""
    names, indices = selected(dataset, plan.recipe.frames)
    # Sums of floating-point numbers depend on the order of the views: the order of --frames must not matter.
    if plan.rig is not None:
        by_camera, own_remarks = plan.rig.groups(names, indices, lambda index: _camera_name(dataset, index))
        starts = {camera: plan.rig.start_of(camera) for camera in by_camera if plan.recipe.perturb is None}
        groups = [_Group(sorted(g), c, starts.get(c), own_remarks.get(c, ())) for c, g in by_camera.items()]
    elif plan.recipe.joint:
        chosen = used_jointly(sorted(indices))
        if len(chosen) < len(indices):
            text = f"{len(indices) - len(chosen)} of {len(indices)} frames are not used"
            remarks = (*remarks, f"{text}: a joint calibration takes {MOST_JOINT_FRAMES} at most, evenly spaced")
        groups = [_Group(chosen, start=start, remarks=remarks)]
    else:
        groups = [_Group([index], start=start, remarks=remarks) for index in indices]
    errors = listed_errors(plan.recipe, names, [group.indices[0] for group in groups])
    return [replace(g, names=[names[i] for i in g.indices], error=errors.get(g.indices[0])) for g in groups]


def _camera_name(dataset: Sequence[Frame] | Dataset, index: int) -> str:
    """Return the camera that a frame names, without accumulating sweeps."""
    camera_name: Callable[[int], str] | None = getattr(dataset, "camera_name", None)
    return frame_at(dataset, index).camera_name if camera_name is None else camera_name(index)


@dataclass(frozen=True, eq=False)
class _Begin:
    """Inputs of a calibration: its frames, the truth, if known, the initial guess, and remarks on it."""

    frames: Sequence[Frame]
    cameras: frozenset[Camera]
    truth: Float | None
    start: Float
    warnings: tuple[str, ...]
    camera: str


def _read(plan: Plan, dataset: Frames, parallel: bool, in_memory: int, group: _Group) -> _Begin:
    """Read the frames of a group; more than `in_memory` are read again on each access.

    With `parallel` the dataset may be read by several threads.
    """
    read = partial(_usable, plan, dataset, names=dict(zip(group.indices, group.names, strict=True)))
    frames: Sequence[Frame] = ReadAgain(read, group.indices)
    if len(group.indices) <= in_memory:
        frames = tuple(for_each(counted("reading frames", read, len(frames)), group.indices, parallel=parallel))
    infos = frame_infos(frames)
    camera = one_camera(infos) if plan.rig is None else group.camera or infos[0].camera_name
    truth = common_pose(infos, "camera_from_lidar")
    quaternion = plan.initial_guess is not None and plan.initial_guess.quaternion
    index = group.indices[0]
    listed = {} if group.error is None else {index: group.error}
    start, remarks = start_of(infos, truth, plan.recipe, group.start, index, listed, quaternion=quaternion)
    cameras = frozenset(info.camera for info in infos)
    return _Begin(frames, cameras, truth, start, (*remarks, *group.remarks), camera)


def _usable(plan: Plan, dataset: Sequence[Frame] | Dataset, index: int, *, names: Mapping[int, str]) -> Frame:
    """Return a frame that was read and has what the methods need; `names` are of all that are calibrated together."""
    try:
        frame = frame_at(dataset, index)
        plan.check_frame(frame)
    except InputError as problem:
        if len(names) == 1:
            raise
        hint = f"a joint calibration needs every frame: leave {names[index]} out of --frames, or repair it"
        where, expected = problem.where, problem.expected
        advice = hint if problem.hint is None else f"{problem.hint}; {hint}"
        raise InputError(problem.what, where=where, expected=expected, got=problem.got, hint=advice) from problem
    return frame


@dataclass(eq=False)
class _Calibrations:
    """Calibrates groups of frames, and reports each row as soon as it is complete.

    From the first one with an estimated motion on, rows of a rig wait for those of all cameras: one sweep has one
    motion. If the run ends early, they are reported as they are. Raises InputError in the end if every group failed.
    """

    plan: Plan
    assembly: Assembly
    total: int
    tell: OnProgress
    calibration: Calibration
    rows: list[Row] = field(default_factory=list)
    failed: list[FailedFrame] = field(default_factory=list)
    first_problem: P2OError | None = None
    waiting: list[tuple[Progress, _Begin, Row]] = field(default_factory=list)
    frames: dict[str, Sequence[Frame]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        plan = self.plan
        self._stamp: dict[str, Any] = {"recipe": plan.described(), "seed": plan.recipe.seed}
        self._stamp |= {"versions": plan.versions(), "licences": plan.licences()}

    def add(self, number: int, group: _Group, read: Callable[[_Group], _Begin]) -> None:
        """Read a group and calibrate it; its row, or the reason why there is none, is reported."""
        progress = Progress(number, self.total, group.name, (), self.assembly, camera=group.camera)
        begin = self._tried(read, group)
        if isinstance(begin, P2OError):
            return self._fail(progress, begin)
        progress = replace(progress, frames=begin.frames)
        self.tell(progress)
        row = self._tried(self._row, begin)
        if isinstance(row, P2OError):
            return self._fail(progress, row)
        if self.plan.rig is not None:
            self.frames[row.camera] = begin.frames
        if self.plan.rig is not None and (self.waiting or row.result.motions):
            return self.waiting.append((progress, begin, row))
        return self._report(progress, row)

    def _tried(self, work: Callable[..., _T], given: Any) -> _T | P2OError:
        """Return the value of `work`, or the error that it raises for one of several groups with invalid frames."""
        try:
            return work(given)
        except (InputError, PluginError) as problem:
            if self.total == 1 or (isinstance(problem, PluginError) and _strict()):
                raise
            return problem

    def _row(self, begin: _Begin, assembly: Assembly | None = None) -> Row:
        frames, truth, start = begin.frames, begin.truth, begin.start
        try:
            result = self.calibration(self.assembly if assembly is None else assembly, without_truth(frames), start)
        except PluginError as problem:
            if _strict():
                raise
            result = Result(tuple(f.name for f in frames), start, start, Status.STAGE_FAILED, str(problem))
        intrinsics = result.camera_of(*begin.cameras) if len(begin.cameras) == 1 else None
        warnings = (*result.warnings, *begin.warnings)
        result = replace(result, warnings=warnings, intrinsics=intrinsics, **self._stamp)
        if truth is None:
            return Row(result, None, None, None, begin.camera)
        return Row(result, truth, pose_error(start, truth), pose_error(result.camera_from_lidar, truth), begin.camera)

    def _fail(self, progress: Progress, problem: P2OError) -> None:
        self.first_problem = self.first_problem or problem
        self.failed.append(FailedFrame(progress.name, str(problem)))
        self.tell(replace(progress, done=progress.done + 1, frames=(), failed=self.failed[-1]))

    def _report(self, progress: Progress, row: Row) -> None:
        self.rows.append(row)
        self.tell(replace(progress, done=progress.done + 1, row=row))

    def __enter__(self) -> _Calibrations:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        rows = [row for _, _, row in self.waiting]
        try:
            if kind is None:
                rows = self._with_common_motions()
        finally:
            for (progress, _, _), row in zip(self.waiting, rows, strict=True):
                self._report(progress, row)
        if kind is None and self.first_problem is not None and not self.rows:
            text = f"none of the {self.total} {'frames' if self.plan.rig is None else 'cameras'} can be calibrated"
            raise InputError(text, got=self.first_problem) from self.first_problem

    def _with_common_motions(self) -> list[Row]:
        if not self.waiting:
            return []
        from p2o.run.rig_motion import CameraSweeps, with_common_motions

        def solve(number: int, assembly: Assembly) -> Result:
            return self._row(self.waiting[number][1], assembly).result

        cameras = [CameraSweeps.of(row.camera, begin.frames, row.result) for _, begin, row in self.waiting]
        rows = []
        for (_, _, row), result in zip(self.waiting, with_common_motions(cameras, self.assembly, solve), strict=True):
            error = None if row.truth is None else pose_error(result.camera_from_lidar, row.truth)
            rows.append(replace(row, result=result, error=error))
        return rows

    def common_result(self, camera_from_body: Mapping[str, Float], solve: RigCalibration | None) -> RigResult | None:
        """Return the common result of the cameras of a rig with places (4, 4); the mean if a plugin fails.

        None for a rig without places.
        """
        if not camera_from_body:
            return None
        from p2o.confidence.fusion import rig_result
        from p2o.run.rig_solve import RigCameraFrames, solve_rig

        results = {row.camera: row.result for row in self.rows}
        cameras = [
            RigCameraFrames(name, without_truth(self.frames[name]), place, results[name])
            for name, place in camera_from_body.items()
            if name in results
        ]
        try:
            return (solve or solve_rig)(self.assembly, cameras, camera_from_body)
        except PluginError as problem:
            if _strict():
                raise
            mean = rig_result(results, camera_from_body)
            return replace(mean, reason=f"{mean.reason}; the calibration of all edges failed: {problem}")


def _strict() -> bool:
    return any(os.environ.get(name, "") not in ("", "0") for name in ("P2O_DEBUG", "P2O_STRICT"))


def selected(dataset: Sequence[Frame] | Dataset, spec: str) -> tuple[Sequence[str], list[int]]:
    """Return the names of all frames, and the indices of those that are chosen."""
    count = len(dataset)
    if count == 0:
        raise InputError("there are no frames", expected="at least one")
    names = getattr(dataset, "names", None)
    if names is None:
        names = [frame_at(dataset, index).name for index in range(count)]
    return names, select(names, spec, where="--frames", skipped=getattr(dataset, "skipped", None))


def frame_at(dataset: Sequence[Frame] | Dataset, index: int) -> Frame:
    """Return the frame of an index; raises InputError if the data contain another type."""
    frame = dataset[index]
    if not isinstance(frame, Frame):
        raise InputError(f"entry {index} of the frames is not a frame", expected="p2o.Frame", got=type(frame).__name__)
    return frame
