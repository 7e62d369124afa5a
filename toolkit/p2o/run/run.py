"""Run a recipe on frames: the common implementation of the command line and the Python API."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from p2o.arrays import Float
from p2o.confidence.fusion import rig_result
from p2o.errors import InputError, P2OError, PluginError
from p2o.frames.direction import check_direction
from p2o.frames.frame import Dataset, Frame
from p2o.frames.selection import select
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import PoseError, pose_error, summarise
from p2o.geometry.start_list import StartList, parse_starts
from p2o.host.calibration_file import names_file
from p2o.host.registry import Registry
from p2o.results.result import Result, RigResult, Status
from p2o.results.result_json import result_to_dict, rig_to_dict
from p2o.results.verdict import Trust
from p2o.run.assembly import Assembly
from p2o.run.protocol import Protocol, protocol_of
from p2o.run.read_again import MAX_FRAMES_IN_MEMORY, FrameInfo, ReadAgain, frame_infos, without_truth
from p2o.run.recipe import Plan, Recipe
from p2o.run.rig_motion import CameraSweeps, with_common_motions
from p2o.run.rig_solve import RigCameraFrames, solve_rig
from p2o.run.words import parse_settings
from p2o.runtime.native import for_each
from p2o.runtime.stages import counted

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Row:
    """One result with what is known about its truth: errors are None if the truth is unknown.

    `camera` is the name of the camera of its frames, empty where they name none.
    """

    result: Result
    truth: Float | None
    start_error: PoseError | None
    error: PoseError | None
    camera: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the result object of `p2o run --json`, ready for JSON; NaN becomes null."""
        errors = {"error": _error_dict(self.error), "start_error": _error_dict(self.start_error)}
        return {"camera": self.camera, **result_to_dict(self.result), **errors}


@dataclass(frozen=True)
class FailedFrame:
    """A frame without a result, because it cannot be read or lacks what the methods need, and why in one line.

    Of a rig it is a camera, whose frames are solved together.
    """

    frame: str
    reason: str


@dataclass(frozen=True, eq=False)
class Run:
    """All results of a recipe: `rows`, one a frame, or one for all frames with `joint`; `failed` are frames without.

    A rig has a row for each camera, and in `rig` the common result if its file has the transforms between the cameras.
    """

    rows: tuple[Row, ...]
    joint: bool = False
    interrupted: bool = False
    failed: tuple[FailedFrame, ...] = ()
    protocol: Protocol | None = None
    rig: RigResult | None = None

    @property
    def result(self) -> Result:
        """Return the result of a run with one result; raises InputError for none or several."""
        if len(self.rows) != 1:
            raise InputError(f"this run has {len(self.rows)} results", expected="one", hint="look at .rows")
        return self.rows[0].result

    @property
    def solved(self) -> bool:
        """Return whether at least one calibration ran, all were solved, and no frame failed."""
        common = self.rig is None or self.rig.body_from_lidar is not None
        return bool(self.rows) and not self.failed and common and all(row.result.status.solved for row in self.rows)

    @property
    def rig_errors(self) -> dict[str, PoseError]:
        """The errors of the common result of a rig by camera, for those whose truth is known."""
        if self.rig is None:
            return {}
        truths = {row.camera: row.truth for row in self.rows if row.truth is not None}
        poses = {camera.name: camera.camera_from_lidar for camera in self.rig.cameras}
        return {n: pose_error(pose, truths[n]) for n, pose in poses.items() if pose is not None and n in truths}

    @property
    def summary(self) -> dict[str, Any]:
        """Counts by status and by trust, and means, medians and per-axis means of the errors of solved results.

        `start` summarises the errors of the starts of the same rows.
        """
        counts = Counter(row.result.status.value for row in self.rows)
        trusts = Counter(row.result.verdict.trust for row in self.rows)
        solved = [row for row in self.rows if row.result.status.solved]
        return {
            "count": len(self.rows),
            "failed": len(self.failed),
            "status": dict(sorted(counts.items())),
            "solved": len(solved),
            "trust": {trust.value: trusts[trust] for trust in Trust if trusts[trust]},
            "error": summarise([row.error for row in solved if row.error is not None]),
            "start": summarise([row.start_error for row in solved if row.start_error is not None]),
            "interrupted": self.interrupted,
            **({} if self.protocol is None else {"protocol": self._by_protocol(self.protocol)}),
        }

    def _by_protocol(self, protocol: Protocol) -> dict[str, Any]:
        """Compute the figures of a protocol; a refused calibration counts with its initial guess."""
        known = [(row.result.camera_from_lidar, row.truth) for row in self.rows if row.truth is not None]
        estimates, truths = (np.array(poses) for poses in (zip(*known, strict=True) if known else ((), ())))
        return {"name": protocol.name, "count": len(known), **protocol.figures(estimates, truths)}

    def as_dict(self) -> dict[str, Any]:
        """Return the one object of `p2o run --json`, of one schema for all runs: `results`, `failed`, `summary`.

        A rig whose cameras are fixed to each other has a fourth part, `rig`: the common result.
        """
        return {
            "results": [row.as_dict() for row in self.rows],
            "failed": [{"frame": one.frame, "reason": one.reason} for one in self.failed],
            **({} if self.rig is None else {"rig": self._rig_dict(self.rig)}),
            "summary": self.summary,
        }

    def _rig_dict(self, rig: RigResult) -> dict[str, Any]:
        """Return the common result with its errors, by camera and summarised."""
        errors, plain = self.rig_errors, rig_to_dict(rig)
        plain["cameras"] = [{**camera, "error": _error_dict(errors.get(camera["name"]))} for camera in plain["cameras"]]
        return {**plain, "error": summarise(list(errors.values()))}


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
RigCalibration = Callable[[Assembly, Sequence[RigCameraFrames], Mapping[str, Float]], RigResult]


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
    words |= {"accumulate": accumulate, "witness": witness, "perturb": starts_of(protocol, perturb)}
    words["options"] = None if options is None else parse_settings(options)
    words["start"] = start if isinstance(start, str) else None
    words["rig"] = str(rig) if isinstance(rig, Path) else dict(rig) if isinstance(rig, Mapping) else rig
    recipe = Recipe.of(**words)
    plan = recipe.resolve(Registry.load() if registry is None else registry)
    done = run(plan, given, start=None if isinstance(start, str) else start, on_progress=on_progress)
    return done if protocol is None else replace(done, protocol=protocol_of(protocol))


def starts_of(protocol: str | None, perturb: str | None, where: str = "protocol") -> str | None:
    """Return the perturbation that is requested directly or by a protocol.

    Beside a protocol a published list of starts may be asked for; InputError for any other, and for a list whose
    errors act in another frame than the protocol's.
    """
    if protocol is None:
        return perturb
    drawn = protocol_of(protocol, where).perturb
    if perturb is None:
        return drawn
    listed = parse_starts(perturb)
    if not isinstance(listed, StartList):
        expected = "no perturbation beside it but @FILE"
        raise InputError("a protocol draws its own starts", where=where, expected=expected, got=perturb)
    wanted = replace(listed, in_camera=parse_starts(drawn).in_camera)
    if listed != wanted:
        text = f"errors of protocol {protocol} act in the {'camera' if wanted.in_camera else 'LiDAR'}'s frame"
        raise InputError(text, where=where, expected=f'"{wanted}"', got=perturb)
    return perturb


def run(
    plan: Plan,
    frames: Sequence[Frame] | Dataset | None = None,
    *,
    start: Float | None = None,
    on_progress: OnProgress | None = None,
    on_names: OnNames | None = None,
    calibration: Calibration = Assembly.__call__,
    rig_calibration: RigCalibration = solve_rig,
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
    recipe = plan.recipe
    start, start_remarks = _initial_guess(plan, start)
    dataset: Sequence[Frame] | Dataset = plan.dataset() if frames is None else plan.joined(frames)
    names, indices = selected(dataset, recipe.frames)
    cameras: dict[int, str] = {}
    remarks: Mapping[str, tuple[str, ...]] = {"": start_remarks}
    # Sums of floating-point numbers depend on the order of the views: the order of --frames must not matter.
    if plan.rig is None:
        groups = [sorted(indices)] if recipe.joint else [[index] for index in indices]
    else:
        by_camera, remarks = plan.rig.groups(names, indices, lambda index: _camera_name(dataset, index))
        cameras, groups = dict(enumerate(by_camera)), [sorted(group) for group in by_camera.values()]
    in_memory = MAX_FRAMES_IN_MEMORY // (1 if plan.rig is None else max(1, len(groups)))
    listed = listed_errors(recipe, names, [group[0] for group in groups])
    if on_names is not None:
        on_names([names[index] for index in indices], list(cameras.values()))
    parallel = frames is None and "accumulate" not in plan.parts and plan.parts["data"].offer.method.parallel
    assembly = plan.assembly()
    stamp = {"recipe": plan.described(), "seed": recipe.seed, "versions": plan.versions(), "licences": plan.licences()}
    failed: list[FailedFrame] = []
    first: P2OError | None = None
    tell, tried = on_progress or (lambda _: None), partial(_tried, len(groups) > 1)
    with _Rows(tell, assembly, stamp, plan.rig is not None, calibration) as rows:
        for done, group in enumerate(groups):
            camera = cameras.get(done, "")
            name = camera or (names[group[0]] if len(group) == 1 else f"{len(group)} frames jointly")
            progress = Progress(done, len(groups), name, (), assembly, camera=camera)
            first_guess = start
            if plan.rig is not None and recipe.perturb is None:
                first_guess = plan.rig.start_of(camera)
            chosen = [(index, names[index]) for index in group]
            begin = tried(_Begin.of, plan, dataset, chosen, first_guess, listed, parallel, in_memory)
            row: Row | P2OError
            if isinstance(begin, P2OError):
                row = begin
            else:
                texts = (*begin.warnings, *remarks.get(camera, ()))
                begin = replace(begin, warnings=texts, camera=camera or begin.camera)
                progress = replace(progress, frames=begin.frames)
                tell(progress)
                row = tried(_calibrate_one, calibration, assembly, begin, stamp)
            if isinstance(row, P2OError) or isinstance(begin, P2OError):
                problem = begin if isinstance(begin, P2OError) else row
                assert isinstance(problem, P2OError)
                first = first or problem
                failed.append(FailedFrame(name, str(problem)))
                tell(replace(progress, done=done + 1, frames=(), failed=failed[-1]))
            else:
                rows.add(progress, begin, row)
    if first is not None and not rows.done:
        sort = "frames" if plan.rig is None else "cameras"
        raise InputError(f"none of the {len(groups)} {sort} can be calibrated", got=first) from first
    places = {} if plan.rig is None else plan.rig.camera_from_body
    common = _common_result(rig_calibration, assembly, rows, places) if places else None
    return Run(tuple(rows.done), joint=recipe.joint, failed=tuple(failed), rig=common)


def _common_result(
    rig_calibration: RigCalibration, assembly: Assembly, rows: _Rows, places: Mapping[str, Float]
) -> RigResult:
    """Return the common result of cameras with places (4, 4); the mean of their results if a plugin fails."""
    try:
        return rig_calibration(assembly, rows.cameras(places), places)
    except PluginError as problem:
        if _strict():
            raise
        mean = rig_result({row.camera: row.result for row in rows.done}, places)
        return replace(mean, reason=f"{mean.reason}; the calibration of all edges failed: {problem}")


def _initial_guess(plan: Plan, start: Float | None) -> tuple[Float | None, tuple[str, ...]]:
    """Return the initial extrinsic (4, 4) given as a pose or in words, or None, and remarks on it."""
    recipe, remarks = plan.recipe, tuple[str, ...]()
    if plan.initial_guess is not None:
        if start is not None:
            raise InputError("a start is given twice, as a pose and in words", expected="one of them")
        start, remarks, _ = plan.initial_guess
    if start is None:
        return None, remarks
    if plan.rig is not None:
        hint = "say body_from_lidar in the rig file, or the start in each frame"
        raise InputError("a start is of one camera, and a rig has several", expected="no start beside a rig", hint=hint)
    if recipe.perturb is not None:
        raise InputError("both a start and a perturbation are given", expected="one of them")
    return se3.check_rigid("start", start), remarks


def _camera_name(dataset: Sequence[Frame] | Dataset, index: int) -> str:
    """Return the camera that a frame names, without accumulating sweeps."""
    camera_name: Callable[[int], str] | None = getattr(dataset, "camera_name", None)
    return frame_at(dataset, index).camera_name if camera_name is None else camera_name(index)


def _tried(catches: bool, work: Callable[..., _T], /, *given: Any) -> _T | P2OError:
    """Return the value of `work`, or with `catches` the error that it raises for invalid frames."""
    try:
        return work(*given)
    except (InputError, PluginError) as problem:
        if not catches or (isinstance(problem, PluginError) and _strict()):
            raise
        return problem


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


def _strict() -> bool:
    return any(os.environ.get(name, "") not in ("", "0") for name in ("P2O_DEBUG", "P2O_STRICT"))


@dataclass(frozen=True, eq=False)
class _Begin:
    """Inputs of a calibration: its frames, the truth, if known, the initial guess, and remarks on it."""

    frames: Sequence[Frame]
    cameras: frozenset[Camera]
    truth: Float | None
    start: Float
    warnings: tuple[str, ...]
    camera: str = ""

    @classmethod
    def of(
        cls,
        plan: Plan,
        dataset: Sequence[Frame] | Dataset,
        chosen: Sequence[tuple[int, str]],
        start: Float | None,
        listed: Mapping[int, Float],
        parallel: bool,
        in_memory: int,
    ) -> _Begin:
        """Read the frames of these indices and names; more than `in_memory` are read again on each access.

        With `parallel` the dataset may be read by several threads.
        """
        names = dict(chosen)
        read = partial(_usable, plan, dataset, names=names)
        frames: Sequence[Frame] = ReadAgain(read, list(names))
        if len(names) <= in_memory:
            frames = tuple(for_each(counted("reading frames", read, len(names)), list(names), parallel=parallel))
        infos = frame_infos(frames)
        camera = infos[0].camera_name if plan.rig is not None else one_camera(infos)
        truth = common_pose(infos, "camera_from_lidar")
        quaternion = plan.initial_guess is not None and plan.initial_guess.quaternion
        begin = start_of(infos, truth, plan.recipe, start, chosen[0][0], listed, quaternion=quaternion)
        return cls(frames, frozenset(info.camera for info in infos), truth, *begin, camera)


def _calibrate_one(calibration: Calibration, assembly: Assembly, begin: _Begin, stamp: Mapping[str, Any]) -> Row:
    frames, truth, start = begin.frames, begin.truth, begin.start
    try:
        result = calibration(assembly, without_truth(frames), start)
    except PluginError as problem:
        if _strict():
            raise
        result = Result(tuple(f.name for f in frames), start, start, Status.STAGE_FAILED, str(problem))
    intrinsics = result.camera_of(*begin.cameras) if len(begin.cameras) == 1 else None
    warnings = (*result.warnings, *begin.warnings)
    result = replace(result, warnings=warnings, intrinsics=intrinsics, **stamp)
    if truth is None:
        return Row(result, None, None, None, begin.camera)
    return Row(result, truth, pose_error(start, truth), pose_error(result.camera_from_lidar, truth), begin.camera)


@dataclass(eq=False)
class _Rows:
    """The rows of a run, reported as soon as they are complete.

    From the first one with an estimated motion on, rows of a rig wait for those of all cameras: one sweep has one
    motion. If the run ends early, they are reported as they are.
    """

    tell: OnProgress
    assembly: Assembly
    stamp: Mapping[str, Any]
    rig: bool
    calibration: Calibration
    done: list[Row] = field(default_factory=list)
    waiting: list[tuple[Progress, _Begin, Row]] = field(default_factory=list)
    frames: dict[str, Sequence[Frame]] = field(default_factory=dict)

    def cameras(self, camera_from_body: Mapping[str, Float]) -> list[RigCameraFrames]:
        """Return the frames and results of the cameras of a rig that have a result, with their places (4, 4)."""
        results = {row.camera: row.result for row in self.done}
        return [
            RigCameraFrames(name, without_truth(self.frames[name]), place, results[name])
            for name, place in camera_from_body.items()
            if name in results
        ]

    def add(self, progress: Progress, begin: _Begin, row: Row) -> None:
        """Report a row, or let it wait."""
        if self.rig:
            self.frames[row.camera] = begin.frames
        if self.rig and (self.waiting or row.result.motions):
            self.waiting.append((progress, begin, row))
        else:
            self._report(progress, row)

    def _report(self, progress: Progress, row: Row) -> None:
        self.done.append(row)
        self.tell(replace(progress, done=progress.done + 1, row=row))

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        rows = [row for _, _, row in self.waiting]
        try:
            if kind is None:
                rows = self._with_common_motions()
        finally:
            for (progress, _, _), row in zip(self.waiting, rows, strict=True):
                self._report(progress, row)

    def _with_common_motions(self) -> list[Row]:
        def solve(number: int, assembly: Assembly) -> Result:
            return _calibrate_one(self.calibration, assembly, self.waiting[number][1], self.stamp).result

        cameras = [CameraSweeps.of(row.camera, begin.frames, row.result) for _, begin, row in self.waiting]
        rows = []
        for (_, _, row), result in zip(self.waiting, with_common_motions(cameras, self.assembly, solve), strict=True):
            error = None if row.truth is None else pose_error(result.camera_from_lidar, row.truth)
            rows.append(replace(row, result=result, error=error))
        return rows


def listed_errors(recipe: Recipe, names: Sequence[str], indices: Sequence[int]) -> dict[int, Float]:
    """Return the errors (4, 4) that a list gives the frames `indices` of a dataset, by index; none without a list.

    Raises InputError for a list that is missing, cannot be read or has no line for one of them.
    """
    starts = None if recipe.perturb is None else parse_starts(recipe.perturb)
    return starts.errors(names, indices) if isinstance(starts, StartList) else {}


def start_of(
    frames: Sequence[Frame] | Sequence[FrameInfo],
    truth: Float | None,
    recipe: Recipe,
    start: Float | None,
    index: int,
    listed: Mapping[int, Float],
    *,
    quaternion: bool = False,
) -> tuple[Float, tuple[str, ...]]:
    """Return the initial guess and remarks on it; `listed` are the `listed_errors` by index.

    `quaternion` states whether the rotation of `start` was given as a quaternion, whose order may be wrong.
    """
    if start is not None:
        if recipe.start is None or not names_file(recipe.start):
            return start, ()
        # Files of other tools often contain the inverse transform.
        frame = frames[0]
        assert frame.cloud is not None  # that of the first frame is kept
        given: dict[str, Any] = {"where": recipe.start, "quaternion": quaternion}
        return start, check_direction(frame.cloud, frame.camera, start, name="the start", **given)
    if recipe.perturb is not None:
        if truth is None:
            hint = "leave out --perturb to begin at the start that the data give"
            raise InputError("the truth is not known, so it cannot be perturbed", where=frames[0].name, hint=hint)
        size = parse_starts(recipe.perturb)
        if isinstance(size, StartList):
            return size.start(truth, listed[index]), ()
        # Seeded by the frame's own number, so that its initial guess does not depend on the other frames of the run.
        rng = np.random.default_rng([recipe.seed] if recipe.joint else [recipe.seed, index])
        return size.start(truth, rng, recipe.seed), ()
    offered = common_pose(frames, "start")
    if offered is not None:
        return offered, ()
    if truth is not None:
        return truth, ("the start is the calibration that the data give: this checks it (see --perturb)",)
    expected = "a start pose camera_from_lidar in the data"
    hint = 'give one: --start FILE, or --start "roughly x forward, z up; camera looks forward"; start= in Python'
    raise InputError("there is no start to calibrate from", where=frames[0].name, expected=expected, hint=hint)


def one_camera(frames: Sequence[Frame] | Sequence[FrameInfo]) -> str:
    """Return the name of the camera of all frames, empty if they name none; raises InputError for several."""
    named = sorted({frame.camera_name for frame in frames})
    if len(named) > 1:
        text = f"frames of {len(named)} cameras have no pose in common"
        got = ", ".join(name or "none named" for name in named)
        hint = "calibrate each camera of the rig with --rig, or choose frames of one"
        raise InputError(text, where="--joint", expected="frames of one camera", got=got, hint=hint)
    return named[0]


_SAME_DEG, _SAME_M = 1e-3, 1e-4


def common_pose(frames: Sequence[Frame] | Sequence[FrameInfo], name: str) -> Float | None:
    """Return the one pose `name` of all frames that know it, or None; raises InputError if two differ.

    Files round the pose of each frame separately: poses that no calibration can distinguish count as one.
    """
    known = [frame for frame in frames if getattr(frame, name) is not None]
    for frame in known[1:]:
        step = se3.inverse(getattr(known[0], name)) @ getattr(frame, name)
        if se3.angle_deg(step) > _SAME_DEG or se3.distance_m(step) > _SAME_M:
            label = "extrinsics" if name == "camera_from_lidar" else "starts"
            text = f"frames {known[0].name} and {frame.name} have different {label}"
            got = f"{se3.angle_deg(step):.3g} deg and {se3.distance_m(step):.3g} m apart"
            hint = "calibrate them apart, without --joint, or each camera of a rig with --rig"
            raise InputError(text, expected="one rig for --joint", got=got, hint=hint)
    return getattr(known[0], name) if known else None


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


def _error_dict(error: PoseError | None) -> dict[str, Any] | None:
    if error is None:
        return None
    return {"rotation_deg": error.rotation_deg, "translation_m": error.translation_m, "per_axis": dict(error.per_axis)}
