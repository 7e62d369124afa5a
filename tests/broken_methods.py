"""Methods that break one promise each, and the names of the checks that find them out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import Kind, Method, Registry, se3
from p2o.calibration_files.calibration import Calibration, CalibrationReader, Source
from p2o.files.input_file import naming
from p2o.frames.accumulate import accumulated
from p2o.host.registry import file_module_name
from p2o.solving import Doubt, Objective, PointToLine, Reason, Verdict
from p2o_testing import exact, stage
from pydantic import field_serializer

HERE = Path(__file__).parent
REGISTRY = Registry.load(extra_files=[HERE / "kinds_plugin.py", HERE / "stage_plugin.py"], environ={})


def _loaded(name: str) -> Any:
    import sys

    return sys.modules[file_module_name(HERE / f"{name}.py")]


# The module as the registry has loaded it: what the cache keeps has to be found there again.
kinds = _loaded("kinds_plugin")
TRUTH = stage.camera_from_lidar()


@dataclass(frozen=True)
class Broken:
    """A method, the checks that it fails and no others, and what its options are said to be."""

    kind: Kind
    method: Method
    fails: frozenset[str]
    said: Any = None

    @property
    def writes(self) -> bool:
        """Whether it writes to the stage itself, which others must not see."""
        return bool({check for check in self.fails if check.endswith("unchanged")})


BROKEN: dict[str, Broken] = {}
"""Broken methods by what is wrong with them."""


def broken(what: str, kind: Kind, stage_: Any, *fails: str, said: Any = None, **more: Any) -> None:
    """Note a method that is broken in one way; `stage_` is what its build returns."""
    more.setdefault("build", lambda _: stage_)
    BROKEN[what] = Broken(kind, Method(name="wrong", summary="A test.", **more), frozenset(fails), said)


# ---- every method


def export(result: p2o.Result, path: Path) -> None:
    """Write next to nothing."""
    try:
        path.write_text(result.reason)
    except OSError as problem:
        raise p2o.InputError("cannot write", where=path) from problem


class Required(p2o.Options):
    size: int = p2o.field(..., help="How many.")


class Bare(p2o.Options):
    rate: float = 1.0


class Growing(p2o.Options):
    size: int = p2o.field(1, help="How many.")

    @field_serializer("size")
    def larger(self, size: int) -> int:
        return size + 1


def phones_home(_: Any) -> Any:
    import socket

    with suppress(OSError), socket.socket() as line:
        line.connect(("127.0.0.1", 9))
    return export


broken("no default", Kind.EXPORTER, export, "every_option_has_a_default", said={"size": 1}, options=Required)
broken("no help", Kind.EXPORTER, export, "every_option_is_described", options=Bare)
broken("options that grow", Kind.EXPORTER, export, "options_survive_json", options=Growing)
broken("a connection", Kind.EXPORTER, export, "builds_twice_offline", build=phones_home)
broken(
    "an example of files", Kind.EXPORTER, export, "the_example_needs_no_files", example=p2o.Example("folder:/nowhere")
)


# ---- extractors of kinds of their own


def spots(image: p2o.Image) -> p2o.ImageFeatures:
    return p2o.ImageFeatures(features=[kinds.spots_of(image)])


def image_method(what: str, find: Callable[[p2o.Image], p2o.ImageFeatures], *fails: str, **more: Any) -> None:
    broken(what, Kind.IMAGE_EXTRACTOR, find, *fails, **{"gives": {"image-spots"}, **more})


def marks_method(what: str, kind: Any, *fails: str, **more: Any) -> None:
    def find(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        return p2o.CloudFeatures(features=[kinds.marks_of(cloud, kind)])

    broken(what, Kind.CLOUD_EXTRACTOR, find, *fails, **{"gives": {"cloud-marks"}, **more})


RNG = np.random.default_rng(0)


def greys_too(image: p2o.Image) -> p2o.ImageFeatures:
    return p2o.ImageFeatures(features=[kinds.spots_of(image), p2o.GreyMap(image.grey.astype(float))])


def at_random(image: p2o.Image) -> p2o.ImageFeatures:
    found = kinds.spots_of(image)
    return p2o.ImageFeatures(features=[found.select(RNG.permutation(len(found)))])


def writing(found: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return an extractor that writes to its input, whatever it finds."""

    def find(data: Any) -> Any:
        owner = data.rgb if isinstance(data, p2o.Image) else data.intensity
        while owner.base is not None:
            owner = owner.base
        owner.flags.writeable = True
        owner.reshape(-1)[0] += 1
        return found(data)

    return find


def sees_ghosts(image: p2o.Image) -> p2o.ImageFeatures:
    found = kinds.spots_of(image)
    return p2o.ImageFeatures(features=[found if len(found) else kinds.Spots(np.ones((100_000, 2)))])


INSIDE: list[int] = []


def alone_only(image: p2o.Image) -> p2o.ImageFeatures:
    INSIDE.append(1)
    time.sleep(0.05)
    crowd = len(INSIDE)
    INSIDE.pop()
    found = kinds.spots_of(image)
    return p2o.ImageFeatures(features=[found.select(slice(None, None, crowd))])


def needs_two_points(cloud: p2o.Cloud) -> p2o.CloudFeatures:
    assert cloud.xyz[1].any()
    return p2o.CloudFeatures(features=[kinds.marks_of(cloud)])


image_method("a kind that is not told of", greys_too, "features_are_those_that_are_given")
image_method("spots at random", at_random, "features_repeat")
image_method("spots that threads share", alone_only, "calls_at_once_find_the_same", parallel=True)
image_method("spots that write", writing(spots), "extractor_input_is_unchanged")
image_method("spots out of nothing", sees_ghosts, "a_featureless_input_is_no_crash")
image_method("no frames to look at", spots, "there_are_frames_to_check_it_on", needs={"targets", "twist", "rings"})
marks_method("marks that stay", kinds.StandingMarks, "features_move_rigidly")
marks_method("marks that move backwards", kinds.BackwardMarks, "features_move_rigidly")
marks_method("headings that are shifted", kinds.StiffMarks, "features_move_rigidly")
marks_method("marks without time", kinds.TimelessMarks, "features_untwist_by_their_times")
marks_method("marks that cannot be kept", kinds.SecretMarks, "features_survive_the_cache")
marks_method("marks that come twice", kinds.TwiceMarks, "selected_features_are_some_of_them")
marks_method("marks that hide", kinds.ShyMarks, "forgetting_sides_keeps_every_feature")
broken(
    "one point is too few", Kind.CLOUD_EXTRACTOR, needs_two_points, "a_single_point_is_no_crash", gives={"cloud-marks"}
)


# ---- extractors of edges


def image_edges(image: p2o.Image, change: Callable[[p2o.ImageEdges], p2o.ImageEdges] = lambda e: e) -> Any:
    found = stage.view().image_edges if image.rgb.std() > 5 else p2o.ImageEdges.empty()
    return p2o.ImageFeatures(edges=change(found))


def cloud_edges(cloud: p2o.Cloud, change: Callable[[p2o.CloudEdges], p2o.CloudEdges] = lambda e: e) -> Any:
    flat = len(cloud) < 2 or np.ptp(np.linalg.norm(cloud.xyz, axis=1)) < 1e-6
    return p2o.CloudFeatures(edges=change(p2o.CloudEdges.empty() if flat else stage.view().cloud_edges))


def added(edges: Any, place: Any, side: int = 0) -> Any:
    """Return edges with one more at a place."""
    kind, name = type(edges), "uv" if isinstance(edges, p2o.ImageEdges) else "xyz"
    if not len(edges):
        return edges
    return kind(np.vstack([getattr(edges, name), place]), np.append(edges.side, np.int8(side)))


def edge_method(kind: Kind, what: str, change: Any, *fails: str, find: Any = None) -> None:
    image = kind is Kind.IMAGE_EXTRACTOR
    found = image_edges if image else cloud_edges
    gives = {"image-edges" if image else "cloud-edges", "side"}
    broken(f"{what} ({kind})", kind, find or (lambda data: found(data, change)), *fails, gives=gives)


def shuffled(edges: Any) -> Any:
    return edges.select(RNG.permutation(len(edges)))


def in_a_corner(edges: p2o.ImageEdges) -> p2o.ImageEdges:
    return p2o.ImageEdges(np.ones((len(edges), 2)), edges.side)


def on_the_wall(edges: p2o.CloudEdges) -> p2o.CloudEdges:
    xyz = stage.frame().cloud.xyz
    rows = np.flatnonzero(xyz[:, 0] > 21.9)[: len(edges)]
    return p2o.CloudEdges(xyz[rows], np.zeros(len(rows)))


def by_the_first_ring(cloud: p2o.Cloud) -> Any:
    every = 2 if cloud.ring is None or cloud.ring[0] == 0 else 3
    return cloud_edges(cloud, lambda edges: edges.select(np.arange(0, len(edges), every)))


IMAGE, CLOUD = Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR
edge_method(IMAGE, "an edge outside", lambda e: added(e, [900.0, 20.0]), "image_edges_are_in_the_image")
edge_method(IMAGE, "edges elsewhere", in_a_corner, "image_edges_lie_on_outlines")
edge_method(IMAGE, "an edge without side", lambda e: added(e, [9.0, 9.0], -1), "image_sides_are_as_declared")
edge_method(
    IMAGE,
    "edges of nothing",
    lambda e: e if len(e) else in_a_corner(stage.view().image_edges),
    "a_featureless_image_has_no_edges",
)
edge_method(IMAGE, "edges at random", shuffled, "image_edges_repeat")
edge_method(IMAGE, "edges that write", None, "image_input_is_unchanged", find=writing(image_edges))
edge_method(CLOUD, "an edge in the air", lambda e: added(e, [3.0, 0.0, 5.0]), "cloud_edges_lie_on_surfaces")
edge_method(CLOUD, "edges elsewhere", on_the_wall, "cloud_edges_lie_on_outlines")
edge_method(CLOUD, "an edge without side", lambda e: added(e, [22.0, 0.0, 0.0], -1), "cloud_sides_are_as_declared")
edge_method(
    CLOUD,
    "edges of nothing",
    None,
    "a_featureless_cloud_has_no_edges",
    find=lambda cloud: p2o.CloudFeatures(edges=stage.view().cloud_edges) if len(cloud) > 1 else cloud_edges(cloud),
)
edge_method(CLOUD, "edges by the order of points", None, "point_order_does_not_matter", find=by_the_first_ring)
edge_method(CLOUD, "edges at random", shuffled, "cloud_edges_repeat")
edge_method(CLOUD, "edges that write", None, "cloud_input_is_unchanged", find=writing(cloud_edges))


# ---- matchers


def pairs(views: Sequence[p2o.View], pose: Any, reach_px: float, rows: Any = None, turn: bool = False) -> Any:
    """Return the exact pairs of every view that has edges."""
    one = exact.pairs()
    if turn:
        one = replace(one, normal=one.normal[:, ::-1] * [1, -1])
    keep = np.abs(one.residuals(pose)) <= reach_px
    if rows is not None:
        keep &= np.isin(np.arange(len(one)), np.arange(len(one))[rows])
    full = [number for number, view in enumerate(views) if len(view.cloud_edges)]

    def each(values: Any) -> Any:
        return np.concatenate([values[:0], *(values[keep] for _ in full)])

    frame = np.concatenate([np.zeros(0, np.int64), *(np.full(keep.sum(), number) for number in full)])
    cameras = tuple(view.camera for view in views)
    lines = (each(values) for values in (one.xyz, one.centre, one.normal, one.weight, one.side))
    return PointToLine(*lines, frame, cameras)


EDGES = {"image-edges", "cloud-edges"}


def pairs_method(what: str, match: Callable[..., Any], *fails: str, **more: Any) -> None:
    broken(what, Kind.MATCHER, match, *fails, **{"gives": {"pairs"}, "needs": EDGES | {"side"}, **more})


def all_if_bare(views: Any, pose: Any, reach_px: float) -> Any:
    bare = not any(len(view.cloud_edges) for view in views)
    return pairs([stage.view()] if bare else views, pose, reach_px)


def all_beside_bare(views: Any, pose: Any, reach_px: float) -> Any:
    some = any(len(view.cloud_edges) for view in views)
    return pairs([stage.view()] * len(views) if some else views, pose, reach_px)


pairs_method("few pairs", lambda *given: pairs(*given, rows=slice(None, None, 3)), "matches_fit_at_the_truth")
pairs_method("lines along", lambda *given: pairs(*given, turn=True), "matches_keep_their_side")
pairs_method("no reach", lambda views, pose, _: pairs(views, pose, 1e9), "matches_stay_within_reach")
pairs_method("pairs of nothing", all_if_bare, "no_edges_give_no_matches")
pairs_method("the first view only", lambda views, *more: pairs(views[:1], *more), "several_views_are_joined")
pairs_method("pairs of a bare view", all_beside_bare, "a_bare_view_adds_nothing")
pairs_method("residuals for pairs", kinds.spots_matched, "problems_are_what_is_given", needs=EDGES)
pairs_method(
    "an example that is not solved",
    pairs,
    "the_example_is_solved",
    example=p2o.Example("fake:?frames=1", perturb="40deg", extractor="depth/rings", init="given"),
)


def residuals_method(what: str, kind: Any, *fails: str) -> None:
    def match(views: Any, pose: Any, reach_px: float) -> Any:
        good = kinds.spots_matched(views, pose, reach_px)
        return kind(good.xyz, good.uv, good.weight, good.frame, good.camera)

    broken(what, Kind.MATCHER, match, *fails, gives={"residuals"}, needs=EDGES)


class Infinite(kinds.PointsToSpots):
    """One residual has no end."""

    def residuals(self, camera_from_lidar: Any) -> Any:
        found = super().residuals(camera_from_lidar)
        found[..., :1] = np.inf
        return found


class Steep(kinds.PointsToSpots):
    """Derivatives are twice what they are."""

    def residuals_with_jacobian(self, camera_from_lidar: Any) -> Any:
        residuals, jacobian = super().residuals_with_jacobian(camera_from_lidar)
        return residuals, 2 * jacobian


class Dear(kinds.PointsToSpots):
    """Costs are twice the sum of the residuals."""

    def cost(self, poses: Any) -> Any:
        return 2 * super().cost(poses)


residuals_method("a residual without end", Infinite, "residuals_have_their_shape")
residuals_method("steep derivatives", Steep, "jacobians_agree_with_differences")
residuals_method("costs of their own", Dear, "costs_are_those_of_the_residuals")


def cost_method(what: str, cost: Callable[[Any, int], Any], *fails: str) -> None:
    """Note a matcher whose cost is given poses, and the number of times that it was called."""
    calls = iter(range(10**6))

    def match(views: Any, pose: Any, reach_px: float) -> Any:
        number = next(calls)
        return Objective(lambda poses: cost(poses, number))

    broken(what, Kind.MATCHER, match, *fails, gives={"objective"}, needs=EDGES)


def away(poses: Any, place: Any = TRUTH) -> Any:
    return np.square(poses - place).sum(axis=(1, 2))


cost_method("a lowest cost elsewhere", lambda poses, _: away(poses, stage_off(2.0)), "costs_are_lowest_at_the_truth")
cost_method("costs that change", lambda poses, number: away(poses) + 1e-3 * number, "matches_repeat")
cost_method("costs by their number", lambda poses, _: away(poses) + 1e-6 * len(poses), "costs_are_one_a_pose")
broken(
    "a gradient that is none",
    Kind.MATCHER,
    lambda views, pose, reach_px: Objective(away, gradient=lambda place: np.zeros(6)),
    "gradients_agree_with_differences",
    gives={"objective"},
    needs=EDGES,
)


def stage_off(angle_deg: float, distance_m: float = 0.0) -> Any:
    """Return a pose that is so far from the truth."""
    return exact.around(TRUTH, angle_deg, distance_m)[0]


# ---- solvers


def lm(problem: Any, pose: Any) -> p2o.Solution:
    from p2o_plugins.solve import lm as good

    return good.build(good.LmOptions())(problem, pose)


def error_deg(pose: Any) -> float:
    return float(p2o.pose_error(pose, TRUTH).rotation_deg)


def at(problem: Any, pose: Any) -> p2o.Solution:
    """Return a pose as the solution."""
    return p2o.Solution(pose, float(problem.cost(pose[None])[0]), 1)


def solver(what: str, solve: Callable[[Any, Any], p2o.Solution], *fails: str) -> None:
    broken(what, Kind.SOLVER, solve, *fails, needs={"residuals"})


def stays_where(unit: str) -> Callable[[Any, Any], p2o.Solution]:
    """Return a solver that solves no problems of a unit."""
    return lambda problem, pose: at(problem, pose) if len(problem) and problem.unit == unit else lm(problem, pose)


def goes(angle_deg: float, at_error: Callable[[float], bool]) -> Callable[[Any, Any], p2o.Solution]:
    """Return a solver that ends so far from the truth where its start has some error in degrees."""

    def solve(problem: Any, pose: Any) -> p2o.Solution:
        wrong = len(problem) and at_error(error_deg(pose))
        return at(problem, stage_off(angle_deg)) if wrong else lm(problem, pose)

    return solve


def sure_of_itself(problem: Any, pose: Any) -> p2o.Solution:
    return lm(problem, pose) if len(problem) else p2o.Solution(pose, 0.0, 1)


def lopsided(problem: Any, pose: Any) -> p2o.Solution:
    return replace(lm(problem, pose), covariance=np.triu(np.ones((6, 6))))


def trembling(problem: Any, pose: Any) -> p2o.Solution:
    found = lm(problem, pose)
    if not len(problem):
        return found
    return at(problem, se3.exp(RNG.normal(scale=1e-10, size=6)) @ found.camera_from_lidar)


solver("leaves the truth", goes(0.05, lambda error: error < 1e-6), "solver_stays_at_the_truth")
solver("stays in pixels", stays_where("px"), "solver_returns_to_the_truth")
solver("knows pixels only", stays_where("m"), "solver_solves_problems_in_metres")
solver("runs away", goes(5.0, lambda error: error > 1.2), "solver_never_makes_it_worse")
solver("tells another cost", lambda *given: replace(lm(*given), cost=1e3), "solutions_say_how_they_ended")
solver("is sure of nothing", sure_of_itself, "solver_says_when_nothing_is_determined")
solver("a lopsided covariance", lopsided, "covariance_is_one")
solver("trembles", trembling, "solutions_repeat")


# ---- initializers


def stage_turn(angle_deg: float) -> Any:
    return se3.exp(np.radians([0.0, 0.0, angle_deg, 0.0, 0.0, 0.0]))


broken(
    "leads astray",
    Kind.INITIALIZER,
    lambda views, pose: [pose if not len(views[0].cloud_edges) else pose @ stage_turn(40.0)],
    "starts_are_no_worse",
)
broken("wants edges", Kind.INITIALIZER, lambda views, pose: [pose][: len(views[0].cloud_edges)],
       "starts_without_edges_are_no_crash")  # fmt: skip
broken(
    "starts at random",
    Kind.INITIALIZER,
    lambda views, pose: [pose, pose @ se3.exp(RNG.normal(scale=1e-3, size=6))],
    "starts_repeat",
)


# ---- calibrators


@dataclass
class Knowing:
    """A method that knows the truth of the stage; what is wrong with it is changed."""

    off: Any = (0.01, 0.001)
    extra: Callable[[], Any] = dict
    name: str = ""
    verdict: Verdict | None = None
    tremble: bool = False
    peek: bool = False
    write: bool = False
    stay: bool = False

    def prepare(self, frame: p2o.Frame) -> Any:
        truth = frame.camera_from_lidar if self.peek else None
        greys = np.bincount(frame.image.grey.ravel())
        return {"name": frame.name, "greys": greys, "truth": truth, "more": self.extra()}

    def solve(self, prepared: Sequence[Any], start: Any) -> p2o.Result:
        pose = start if self.stay else stage_off(*self.off)
        told = [one["truth"] for one in prepared if one["truth"] is not None]
        pose = told[0] if told else pose
        if self.tremble:
            pose = se3.exp(RNG.normal(scale=1e-10, size=6)) @ pose
        if self.write:
            prepared[0]["greys"][0] += 1
        names = tuple(self.name or one["name"] for one in prepared)
        return p2o.Result(names, start, pose, p2o.Status.CONVERGED, "it knows", verdict=self.verdict)


REFUSED = Verdict((Reason(Doubt.NOT_SOLVED, "it is so"),))
LAX = p2o.Example("fake:?frames=2", within="9deg 9m")


def calibrator(what: str, stage_: Any, *fails: str, **more: Any) -> None:
    broken(what, Kind.CALIBRATOR, stage_, *fails, **more)


calibrator("other names", Knowing(name="?"), "calibrator_answers")
calibrator("half way", Knowing(off=(0.5, 0.02)), "calibrator_comes_near_the_truth")
calibrator(
    "the start as a success", Knowing(stay=True), "calibrator_comes_near_the_truth", "what_is_solved_is_no_start"
)
calibrator("the start, and little promised", Knowing(stay=True), "what_is_solved_is_no_start", example=LAX)
calibrator("farther away", Knowing(off=(2.0, 0.1)), "what_is_solved_is_no_start", example=LAX)
# Whoever gives another pose each time gives one for a wrong truth as well.
calibrator("trembles at the end", Knowing(tremble=True), "calibrations_repeat", "the_truth_is_not_looked_at")
calibrator("peeks", Knowing(peek=True), "the_truth_is_not_looked_at")
# What is prepared anew is not what was kept and written to.
calibrator("writes to what it prepared", Knowing(write=True), "calibrator_input_is_unchanged", "preparations_repeat")
calibrator("prepares at random", Knowing(extra=lambda: RNG.random(3)), "preparations_repeat")
calibrator("prepares what cannot be kept", Knowing(extra=lambda: {1, 2}), "preparations_are_kept")
calibrator("refuses what it solved", Knowing(verdict=REFUSED), "results_have_a_verdict")
calibrator("no frames of this kind", Knowing(), "there_are_frames_to_check_it_on", needs={"targets"})


# ---- accumulators


@dataclass
class Joining:
    """Joins sweeps by the poses of the LiDAR, and is changed in one way."""

    join: Callable[[Sequence[p2o.Frame], int], p2o.Cloud]
    past: int = 1
    future: int = 1

    def __call__(self, frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
        return self.join(frames, number)


def joined(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    return accumulated(frames[number], frames)


def as_they_are(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    return p2o.Cloud(np.concatenate([frame.cloud.xyz for frame in frames]))


def the_others(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    cloud = joined(frames, number)
    return cloud.select(np.arange(len(frames[number].cloud), len(cloud))) if len(frames) > 1 else cloud


def some_of_them(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    cloud = joined(frames, number)
    return cloud.select(RNG.random(len(cloud)) < 0.9)


def scribbled(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    for frame in frames[:number]:
        writing(lambda cloud: cloud)(frame.cloud)
    return p2o.Cloud(joined(frames, number).xyz)


def astray_when_alone(frames: Sequence[p2o.Frame], number: int) -> p2o.Cloud:
    return joined(frames, number) if len(frames) > 1 else p2o.Cloud(frames[0].cloud.xyz + [0.0, 0.0, 1.0])


def accumulator(what: str, join: Any, *fails: str) -> None:
    needs = {"sequence", "lidar-pose"}
    broken(what, Kind.ACCUMULATOR, Joining(join), *fails, needs=needs)


accumulator("sweeps as they are", as_they_are, "joined_points_lie_on_surfaces")
accumulator("neighbours alone", the_others, "joined_sweeps_hold_the_frames_own")
accumulator("nothing joined", lambda frames, number: frames[number].cloud, "joined_sweeps_hold_more")
accumulator("points at random", some_of_them, "joined_sweeps_repeat")
accumulator("neighbours scribbled on", scribbled, "neighbours_are_unchanged")
accumulator("astray when alone", astray_when_alone, "a_frame_alone_stays_as_it_is")


# ---- datasets


class Frames(list[p2o.Frame]):
    """Frames with their names."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(frame.name for frame in self.whole)

    @property
    def whole(self) -> Iterator[p2o.Frame]:
        return iter(self)


class Misnamed(Frames):
    """Called by numbers, while its frames are not."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(map(str, range(len(self))))


class Changing(Frames):
    """Frames differ each time they are read."""

    reads = 0

    def __getitem__(self, index: Any) -> Any:
        self.reads += 1
        frame = super().__getitem__(index)
        return frame if isinstance(frame, list) else replace(frame, twist=np.full(6, float(self.reads)))


class Forward(Frames):
    """The end cannot be counted from."""

    def __getitem__(self, index: Any) -> Any:
        return super().__getitem__(0 if index == -1 else index)


def dataset(what: str, kind: type[Frames], frames: Sequence[p2o.Frame], *fails: str, **more: Any) -> None:
    broken(what, Kind.DATASET, None, *fails, build=lambda _: kind(frames), **more)


def drive(**changes: Any) -> list[p2o.Frame]:
    return [replace(frame, **changes) for frame in stage.drive()]


dataset(
    "frames of other names",
    Misnamed,
    drive(),
    "names_come_before_frames",
    "frames_are_read_alike_again",
    "datasets_are_sequences",
    "times_do_not_fall_in_a_sequence",
    "poses_belong_to_a_sequence",
)
dataset("frames that change", Changing, drive(), "frames_are_read_alike_again")
dataset("any folder", Frames, drive(), "other_folders_are_not_recognised", recognises=lambda path: True)
dataset("no counting from the end", Forward, drive(), "datasets_are_sequences")
dataset("what is not held", Frames, [stage.frame()], "frames_hold_what_is_given", gives={"rings", "twist"})
dataset("time runs back", Frames, drive()[::-1], "times_do_not_fall_in_a_sequence")
dataset("a pose in no sequence", Frames, drive(sequence=""), "poses_belong_to_a_sequence")


# ---- readers of calibration files


class Reader(CalibrationReader):
    """Reads pickled poses, after a head that others do not have."""

    head = b"POSE"

    def recognises(self, source: Source) -> bool:
        return source.data.startswith(self.head)

    def read(self, source: Source) -> Calibration:
        try:
            numbers = np.frombuffer(source.data[len(self.head) :]).reshape(4, 4)
        except ValueError as problem:
            raise p2o.InputError("this is not a pose", where=source.path) from problem
        with naming(source.path):
            return Calibration(camera_from_lidar=numbers)

    def example(self) -> bytes:
        return self.head + TRUTH.tobytes()


def reader(what: str, *fails: str, **changes: Any) -> None:
    """Note a reader with other methods."""
    broken(what, Kind.CALIBRATION_READER, type("Changed", (Reader,), changes)(), *fails)


def restless(self: Reader, source: Source) -> Calibration:
    """Read another pose each time."""
    Reader.read(self, source)
    return Calibration(camera_from_lidar=se3.exp(RNG.normal(size=6)))


def unchecked(self: Reader, source: Source) -> Calibration:
    """Raise whatever NumPy raises."""
    return Calibration(camera_from_lidar=np.frombuffer(source.data[len(self.head) :]).reshape(4, 4))


reader("a reader of any file", "other_files_are_not_recognised", recognises=lambda self, source: True)
reader("an example of another format", "the_example_is_recognised", recognises=lambda self, source: False)
reader("an empty calibration", "the_example_holds_a_calibration", read=lambda self, source: Calibration())
reader("another pose each time", "reading_repeats", read=restless)
reader("files that break off", "incomplete_files_are_errors_of_the_file", read=unchecked)


# ---- exporters


def export_anew(result: p2o.Result, path: Path) -> None:
    export(replace(result, reason=str(RNG.random())), path)


def export_if_possible(result: p2o.Result, path: Path) -> None:
    with suppress(p2o.InputError):
        export(result, path)


broken("another file each time", Kind.EXPORTER, export_anew, "exports_repeat")
broken("results that are lost", Kind.EXPORTER, export_if_possible, "unwritable_paths_are_errors")
