"""Does an extrinsic that is in use still hold? On some frames together, or frame after frame over a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, Unpack

import numpy as np

from p2o.arrays import Float
from p2o.calibration.audit import Evidence, Rates, audit
from p2o.calibration.edge_step import EdgeStep, edge_step
from p2o.calibration.pipeline import Pipeline
from p2o.calibration.watch import Rule, watched
from p2o.errors import InputError
from p2o.features.view import View
from p2o.frames.direction import check_direction
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.geometry.perturb import parse_perturbation
from p2o.host.registry import Registry
from p2o.results.check import Check, Holding, Slip, Watch
from p2o.run.extrinsic import given_extrinsic
from p2o.run.recipe import Plan, Recipe
from p2o.run.run import frame_at, one_camera, selected
from p2o.run.words import parse_settings

Data = str | Dataset | Sequence[Frame] | Frame
Tell = Callable[[str, int, int], None]
"""Is told the name of a frame, how many are done, and of how many."""


class Words(TypedDict, total=False):
    """What `check` and `watch` have in common: which frames are looked at, and by which methods.

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
    """Return whether an extrinsic holds on frames, all taken together; the same as `p2o check`.

    `extrinsic` is camera_from_lidar (4, 4), or `truth`, `start` or a file (`p2o.run.extrinsic`). `notice` says which
    errors have to be noticed ("0.3deg 3cm"): where the frames do not allow that, the answer is that nobody can tell.
    At most `alarm_rate` of right extrinsics are called off, and a share `power` of errors as large as an axis's limit
    is noticed. `words` are frames, extractor, matcher, options, seed and registry as in `p2o.calibrate`, and
    `on_frame`, which is told each frame (`Words`).

    Raises a P2OError for anything wrong with the words, the data or the plugins, and for an extrinsic that is the
    inverse of what it should be.
    """
    rates = _rates(notice, alarm_rate, power)
    opened = _Opened.of(data, words)
    views: list[View] = []
    read: list[Frame] = []
    for frame in opened.frames():
        views.append(opened.pipeline.prepare(frame.without_truth()))
        read.append(frame)
    one_camera(read)
    pose, said = _pose(extrinsic, read)
    warnings = (
        *said,
        *check_direction(read[0].cloud, read[0].camera, pose, name="the extrinsic", where=_named(extrinsic)),
    )
    found = audit(Evidence.of(views, pose, opened.pipeline), opened.pipeline.options, rates)
    _refuse_inverse(found.holding, warnings, extrinsic)
    return replace(found, warnings=(*warnings, *found.warnings), **opened.stamp)


def watch(
    data: Data,
    extrinsic: Float | str,
    *,
    alarms_per_hour: float = 0.1,
    rate_hz: float | None = None,
    settle: int = 20,
    **words: Unpack[Words],
) -> Watch:
    """Return when an extrinsic slipped over a drive, whose frames are taken in their order; `p2o check --watch`.

    False alarms come `alarms_per_hour` at `rate_hz` frames a second (default: as the frames' times say, else 10). The
    first `settle` frames say what is usual: a slip before them is for `check` to find. The other words are those of
    `check`.

    Raises InputError as `check`, and for fewer frames than have to settle.
    """
    opened = _Opened.of(data, words)
    count = len(opened.indices)
    if settle < 1 or count <= settle:
        raise InputError(
            "there are too few frames to watch",
            expected=f"more than the {settle} that say what is usual",
            got=count,
            hint="take more frames of the drive, or `p2o check` without --watch",
        )
    names: list[str] = []
    times: list[float | None] = []
    steps: list[EdgeStep | None] = []
    pose: Float = np.eye(4)
    warnings: tuple[str, ...] = ()
    cameras: set[str] = set()
    for done, frame in enumerate(opened.frames()):
        if done == 0:
            pose, said = _pose(extrinsic, [frame])
            told = check_direction(frame.cloud, frame.camera, pose, name="the extrinsic", where=_named(extrinsic))
            warnings = (*said, *told)
        cameras.add(frame.camera_name)
        view = opened.pipeline.prepare(frame.without_truth())
        step = edge_step([view], pose, opened.pipeline.matcher, opened.pipeline.options)
        names.append(frame.name)
        times.append(frame.time_s)
        steps.append(None if isinstance(step, str) else step)
    if len(cameras) > 1:
        raise InputError("frames of several cameras have no extrinsic in common", got=", ".join(sorted(cameras)))
    rule = Rule(alarms_per_hour, rate_hz or _rate_hz(times), settle)
    seen = watched(names, steps, rule)
    telling = sum(step is not None for step in steps)
    holding, reason = _of_drive(seen.slips, telling, count)
    _refuse_inverse(holding, warnings, extrinsic)
    return Watch(
        camera_from_lidar=pose,
        holding=holding,
        reason=reason,
        slips=seen.slips,
        frames=seen.frames,
        settled=settle,
        slack=rule.slack,
        limit=seen.limit,
        correlation=seen.correlation,
        alarms_per_hour=rule.alarms_per_hour,
        rate_hz=rule.rate_hz,
        warnings=tuple(warnings),
        **opened.stamp,
    )


@dataclass(frozen=True, eq=False)
class _Opened:
    """Frames that are to be looked at, by number, and the pipeline that finds and pairs their edges."""

    plan: Plan
    dataset: Any
    indices: Sequence[int]
    pipeline: Pipeline
    tell: Tell

    @classmethod
    def of(cls, data: Data, words: Words) -> _Opened:
        for word in words.keys() - Words.__annotations__.keys():
            raise TypeError(f"unexpected keyword argument '{word}'")
        options, settings = words.get("options"), None
        if options is not None:
            if isinstance(options, Mapping):
                settings = {k: dict(v) for k, v in options.items()}
            else:
                settings = parse_settings(options)
        recipe = Recipe.of(
            data=data if isinstance(data, str) else None,
            frames=words.get("frames"),
            extractor=words.get("extractor"),
            matcher=words.get("matcher"),
            options=settings,
            seed=words.get("seed"),
            joint=True,
        )
        registry = words.get("registry")
        plan = recipe.resolve(Registry.load() if registry is None else registry)
        method = plan.parts["matcher"].offer.method
        if "pairs" not in method.gives:
            raise InputError(
                "a check needs pairs of edges",
                where="--matcher",
                expected="a matcher that gives pairs, such as ogm",
                got=method.name,
            )
        given = [data] if isinstance(data, Frame) else data
        dataset = plan.dataset() if isinstance(data, str) else plan.joined(given)
        pipeline = plan.calibrator()
        assert isinstance(pipeline, Pipeline)
        tell = words.get("on_frame") or (lambda name, done, total: None)
        return cls(plan, dataset, selected(dataset, recipe.frames)[1], pipeline, tell)

    @property
    def stamp(self) -> dict[str, Any]:
        """What a result tells of how it was made."""
        return {"recipe": self.plan.described(), "versions": self.plan.versions()}

    def frames(self) -> Any:
        """Give the frames, one by one; raises InputError for one that lacks what the methods need."""
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
    size = parse_perturbation(notice, "--notice")
    if not size.exact or not (size.angle_deg > 0 and size.distance_m > 0):
        raise InputError(
            "what is to be noticed has two parts",
            where="--notice",
            expected='an angle and a length, "0.3deg 3cm"',
            got=repr(notice),
        )
    return Rates(alarm_rate, power, size.angle_deg, size.distance_m)


def _pose(extrinsic: Float | str, frames: Sequence[Frame]) -> tuple[Float, tuple[str, ...]]:
    if isinstance(extrinsic, str):
        return given_extrinsic(extrinsic, frames)
    return se3.check_rigid("the extrinsic", extrinsic), ()


def _named(extrinsic: Float | str) -> str | None:
    return extrinsic if isinstance(extrinsic, str) else None


def _refuse_inverse(holding: Holding, warnings: Sequence[str], extrinsic: Float | str) -> None:
    """Raise InputError where nothing fits and the world stands upright at the inverse only."""
    told = [text for text in warnings if "may be lidar_from_camera" in text]
    if told and holding is Holding.CANNOT_TELL:
        raise InputError(
            "the extrinsic looks like lidar_from_camera",
            where=_named(extrinsic),
            expected="camera_from_lidar",
            got="a pose at which no edges meet, and whose inverse stands upright",
        )


def _rate_hz(times: Sequence[float | None]) -> float:
    """Return how many frames a second there are, 10 where nobody tells."""
    known = np.array([time for time in times if time is not None], np.float64)
    steps = np.diff(known)
    usual = float(np.median(steps)) if len(known) == len(times) and len(steps) else 0.0
    return 1 / usual if usual > 0 else 10.0


def _of_drive(slips: Sequence[Slip], telling: int, count: int) -> tuple[Holding, str]:
    """Return the word for a drive, and why."""
    if slips:
        first = slips[0]
        size = f"{first.size:+.2f} deg" if first.unit == "deg" else f"{100 * first.size:+.1f} cm"
        return Holding.OFF, f"{first.axis} slipped by about {size}, noticed at {first.noticed_frame}"
    if 2 * telling < count:
        return Holding.CANNOT_TELL, f"{count - telling} of {count} frames tell nothing"
    return Holding.HOLDS, f"no slip was noticed in {count} frames"
