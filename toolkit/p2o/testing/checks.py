"""The conformance checks: what a method of each slot promises, one small function a promise.

Every check takes a `Subject` and raises `CheckFailed` where the promise is broken. The docstring is the promise.
"""

from __future__ import annotations

import json
import socket
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from p2o.arrays import Float, leaves
from p2o.errors import P2OError
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.side import Side
from p2o.frames.frame import Dataset
from p2o.geometry import se3
from p2o.geometry.pose_error import pose_error
from p2o.host.guard import build
from p2o.host.method import Kind
from p2o.host.registry import Offer
from p2o.options import Options
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import Objective
from p2o.results.evidence import Agreement, Judged, Rival
from p2o.results.result import DIRECTED, Result, Round, SolverStatus, Status
from p2o.results.verdict import Doubt, Reason, Verdict
from p2o.testing import stage


class CheckFailed(AssertionError):  # noqa: N818  (a verdict on a plugin, not a defect here)
    """A method breaks a promise of its slot."""


@dataclass(frozen=True)
class Subject:
    """A method under test with its options."""

    offer: Offer
    options: Options

    def built(self) -> Any:
        """Return a freshly built stage."""
        return build(self.offer, self.options)

    @property
    def gives(self) -> frozenset[str]:
        """The words that the method gives."""
        return frozenset(self.offer.method.gives)

    @property
    def needs(self) -> frozenset[str]:
        """The words that the method needs."""
        return frozenset(self.offer.method.needs)


@dataclass(frozen=True)
class Check:
    """One promise: `name`, the `kinds` of method that make it, and the function that tests it."""

    name: str
    kinds: frozenset[Kind]
    function: Callable[[Subject], None]

    @property
    def promise(self) -> str:
        """The promise in a sentence."""
        return (self.function.__doc__ or "").split("\n", maxsplit=1)[0]


CHECKS: list[Check] = []
"""Every check, in the order of this file."""


def _check(*kinds: Kind) -> Callable[[Callable[[Subject], None]], Callable[[Subject], None]]:
    def note(function: Callable[[Subject], None]) -> Callable[[Subject], None]:
        CHECKS.append(Check(function.__name__, frozenset(kinds or Kind), function))
        return function

    return note


def require(condition: Any, message: str) -> None:
    """Raise CheckFailed with the message unless the condition holds."""
    if not condition:
        raise CheckFailed(message)


# ---- every method


@_check()
def every_option_has_a_default(subject: Subject) -> None:
    """Every option has a default that is within its own bounds; only a dataset's `root` may be required."""
    model = subject.offer.method.options
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    allowed = ["root"] if subject.offer.kind == Kind.DATASET else []
    require(set(required) <= set(allowed), f"options without default: {', '.join(required)}")
    if not required:
        model()


@_check()
def every_option_is_described(subject: Subject) -> None:
    """Every option has a one-sentence description."""
    bare = [n for n, f in subject.offer.method.options.model_fields.items() if not (f.description or "").strip()]
    require(not bare, f"options without help: {', '.join(bare)}")


@_check()
def options_survive_json(subject: Subject) -> None:
    """Options written to JSON and read back are equal."""
    again = type(subject.options).model_validate(json.loads(subject.options.model_dump_json()))
    require(again == subject.options, f"{subject.options!r} became {again!r}")


@_check()
def builds_twice_offline(subject: Subject) -> None:
    """Building works twice in a row and opens no connection."""
    with _offline():
        subject.built()
        subject.built()


# ---- image extractors


@_check(Kind.IMAGE_EXTRACTOR)
def image_edges_are_in_the_image(subject: Subject) -> None:
    """Edges are found on the test stage, and all of them lie inside the image."""
    image = stage.frame().image
    edges = _image_edges(subject, image)
    require(len(edges), "no edges on an image with five plates in front of a wall")
    inside = image.camera.in_image(edges.uv)
    require(inside.all(), f"{int((~inside).sum())} of {len(edges)} edges lie outside the image")


@_check(Kind.IMAGE_EXTRACTOR)
def image_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the outlines of the test stage have an edge (of their side, where sides are given) near by."""
    edges, truth = _image_edges(subject, stage.frame().image), stage.view().image_edges
    if "side" not in subject.gives:
        truth = truth.without_sides()
    found = np.concatenate(
        [
            edges.trees[side].query(truth.uv[rows])[0] <= 3.0 if side in edges.index else np.zeros(len(rows), bool)
            for side, rows in truth.index.items()
        ]
    )
    require(found.mean() >= 0.5, f"only {100 * found.mean():.0f} % of the outlines have an edge within 3 px")


@_check(Kind.IMAGE_EXTRACTOR)
def image_sides_are_as_declared(subject: Subject) -> None:
    """A method that gives `side` gives one to every edge; one that does not gives none."""
    _require_sides(subject, _image_edges(subject, stage.frame().image))


@_check(Kind.IMAGE_EXTRACTOR)
def a_featureless_image_has_no_edges(subject: Subject) -> None:
    """An image of one grey and one depth gives no edges, and no error."""
    edges = _image_edges(subject, stage.featureless_image())
    require(len(edges) == 0, f"{len(edges)} edges on an image of one grey")


@_check(Kind.IMAGE_EXTRACTOR)
def image_edges_repeat(subject: Subject) -> None:
    """The same image gives the same edges, bit for bit, also from a freshly built stage."""
    image = stage.frame().image
    _require_equal(subject.built()(image), subject.built()(image), "the features of the same image differ")


@_check(Kind.IMAGE_EXTRACTOR)
def image_input_is_unchanged(subject: Subject) -> None:
    """The image is not written to."""
    image = stage.frame().image
    with _unchanged(image):
        subject.built()(image)


# ---- cloud extractors


@_check(Kind.CLOUD_EXTRACTOR)
def cloud_edges_lie_on_surfaces(subject: Subject) -> None:
    """Edges are found on the test stage, and each lies within half a metre of a measured point."""
    from scipy.spatial import cKDTree

    cloud = stage.frame().cloud
    edges = _cloud_edges(subject, cloud)
    require(len(edges), "no edges on a sweep of five plates in front of a wall")
    distance = np.asarray(cKDTree(cloud.xyz).query(edges.xyz)[0])
    require(distance.max() <= 0.5, f"an edge lies {distance.max():.2f} m from the nearest point")


@_check(Kind.CLOUD_EXTRACTOR)
def cloud_edges_lie_on_outlines(subject: Subject) -> None:
    """At least half of the edges lie within 15 cm of an outline (of their side, where sides are given)."""
    from scipy.spatial import cKDTree

    edges, truth = _cloud_edges(subject, stage.frame().cloud), stage.view().cloud_edges
    if "side" not in subject.gives:
        truth = truth.without_sides()
    near = np.zeros(len(edges), bool)
    for side in np.unique(edges.side):
        rows, known = edges.side == side, truth.side == side
        if known.any():
            near[rows] = cKDTree(truth.xyz[known]).query(edges.xyz[rows])[0] <= 0.15
    require(near.mean() >= 0.5, f"only {100 * near.mean():.0f} % of the edges are within 15 cm of an outline")


@_check(Kind.CLOUD_EXTRACTOR)
def cloud_sides_are_as_declared(subject: Subject) -> None:
    """A method that gives `side` gives one to every edge; one that does not gives none."""
    _require_sides(subject, _cloud_edges(subject, stage.frame().cloud))


@_check(Kind.CLOUD_EXTRACTOR)
def a_featureless_cloud_has_no_edges(subject: Subject) -> None:
    """A sweep of the inside of a ball gives no edges, and no error."""
    edges = _cloud_edges(subject, stage.featureless_cloud())
    require(len(edges) == 0, f"{len(edges)} edges on a sweep without any jump")


@_check(Kind.CLOUD_EXTRACTOR)
def point_order_does_not_matter(subject: Subject) -> None:
    """Shuffled points give the same edges in some order, unless the method needs `rings`."""
    if "rings" in subject.needs:
        return
    cloud = stage.frame().cloud
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    here, there = _cloud_edges(subject, cloud), _cloud_edges(subject, shuffled)
    require(len(here) == len(there), f"{len(here)} edges in order, {len(there)} shuffled")
    here_rows, there_rows = (_sorted(np.column_stack([e.xyz, e.side])) for e in (here, there))
    require(np.allclose(here_rows, there_rows, atol=1e-9), "shuffled points give other edges")


@_check(Kind.CLOUD_EXTRACTOR)
def cloud_edges_repeat(subject: Subject) -> None:
    """The same sweep gives the same edges, bit for bit, also from a freshly built stage."""
    cloud = stage.frame().cloud
    _require_equal(subject.built()(cloud), subject.built()(cloud), "the features of the same sweep differ")


@_check(Kind.CLOUD_EXTRACTOR)
def cloud_input_is_unchanged(subject: Subject) -> None:
    """The sweep is not written to."""
    cloud = stage.frame().cloud
    with _unchanged(cloud):
        subject.built()(cloud)


@_check(Kind.CLOUD_EXTRACTOR)
def a_single_point_is_no_crash(subject: Subject) -> None:
    """A sweep of one point gives no edges or is refused with a P2OError."""
    try:
        edges = subject.built()(stage.frame().cloud.select(np.array([0]))).edges
    except P2OError as problem:
        require("raised" not in str(problem), str(problem))
        return
    require(edges is None or len(edges) == 0, "edges on a sweep of one point")


# ---- matchers


@_check(Kind.MATCHER)
def matches_fit_at_the_truth(subject: Subject) -> None:
    """With exact features at the true pose, at least half of the points are matched, with nearly no residual.

    A matcher that gives an objective has its smallest cost there, compared with poses half a degree away.
    """
    problem = _matched(subject, [stage.view()])
    truth = stage.camera_from_lidar()
    if isinstance(problem, Objective):
        costs = problem.cost(np.concatenate([truth[None], _around(truth, 0.5, 0.05)]))
        require(costs[0] <= costs[1:].min(), f"cost {costs[0]:.4g} at the truth, {costs[1:].min():.4g} beside it")
        return
    share = len(problem) / len(stage.view().cloud_edges)
    require(share >= 0.5, f"only {100 * share:.0f} % of the points are matched")
    residual = float(np.median(np.abs(problem.residuals(truth))))
    require(residual <= 0.1, f"the median residual is {residual:.2f} px, with exact features at the true pose")


@_check(Kind.MATCHER)
def matches_keep_their_side(subject: Subject) -> None:
    """A matcher that needs `side` pairs points with lines across the direction of their side only."""
    problem = _matched(subject, [stage.view()])
    if "side" not in subject.needs or isinstance(problem, Objective):
        return
    for side, axis in ((Side.LEFT, 0), (Side.RIGHT, 0), (Side.UPPER, 1), (Side.BOTTOM, 1)):
        normals = np.abs(problem.normal[problem.side == side])
        require(not len(normals) or np.median(normals[:, axis]) > 0.7, f"lines of {side.name} points run the wrong way")


@_check(Kind.MATCHER)
def matches_stay_within_reach(subject: Subject) -> None:
    """No pair is farther apart than the reach, at a pose one degree off."""
    pose = _around(stage.camera_from_lidar(), 1.0, 0.0)[0]
    problem = subject.built()([_input(subject, stage.view())], pose, 6.0)
    if isinstance(problem, Objective) or not len(problem):
        return
    widest = float(np.abs(problem.residuals(pose)).max())
    require(widest <= 6.0 + 1e-6, f"a pair is {widest:.1f} px apart with a reach of 6 px")


@_check(Kind.MATCHER)
def no_edges_give_no_matches(subject: Subject) -> None:
    """Views without any edges give an empty problem, or a finite cost, and no error."""
    problem = _matched(subject, [stage.bare_view()])
    if isinstance(problem, Objective):
        require(np.isfinite(problem.cost(stage.camera_from_lidar()[None])).all(), "the cost is not finite")
    else:
        require(len(problem) == 0, f"{len(problem)} pairs out of nothing")


@_check(Kind.MATCHER)
def several_views_are_joined(subject: Subject) -> None:
    """Two views with the same features give every pair twice, or a cost with the same order of poses."""
    truth = stage.camera_from_lidar()
    one, two = (_matched(subject, [stage.view()] * n) for n in (1, 2))
    if isinstance(one, PointToLine) and isinstance(two, PointToLine):
        require(len(two) == 2 * len(one), f"{len(one)} pairs of one view, {len(two)} of two of them")
        require(set(two.frame.tolist()) <= {0, 1} and len(two.cameras) == 2, "pairs do not name the view they are of")
    elif isinstance(one, Objective) and isinstance(two, Objective):
        poses = np.concatenate([truth[None], _around(truth, 0.5, 0.05)])
        require(np.argmin(one.cost(poses)) == np.argmin(two.cost(poses)), "two equal views prefer another pose")


@_check(Kind.MATCHER)
def matches_repeat(subject: Subject) -> None:
    """The same views give the same problem, also from a freshly built stage; the views are not written to."""
    view = _input(subject, stage.view())
    with _unchanged(view):
        first, second = (_matched(subject, [view]) for _ in range(2))
    if isinstance(first, PointToLine):
        _require_equal(first, second, "the problems of the same views differ")


# ---- solvers


@_check(Kind.SOLVER)
def solver_stays_at_the_truth(subject: Subject) -> None:
    """On exact pairs, a solver that begins at the truth stays there: 0.01 deg and 5 mm."""
    truth = stage.camera_from_lidar()
    _require_near(subject.built()(_problem(subject), truth).camera_from_lidar, truth, 0.01, 0.005)


@_check(Kind.SOLVER)
def solver_returns_to_the_truth(subject: Subject) -> None:
    """On exact pairs, a solver returns from 1 deg and 5 cm: to 0.02 deg and 1 cm with pairs, 0.1 deg and 3 cm else."""
    truth = stage.camera_from_lidar()
    angle_deg, distance_m = (0.02, 0.01) if "pairs" in subject.needs else (0.1, 0.03)
    for start in _around(truth, 1.0, 0.05)[:2]:
        found = subject.built()(_problem(subject), start).camera_from_lidar
        _require_near(found, truth, angle_deg, distance_m)


@_check(Kind.SOLVER)
def solver_never_makes_it_worse(subject: Subject) -> None:
    """The cost at the solution is at most that at the start, and `Solution.cost` is finite."""
    pairs, problem = _pairs(), _problem(subject)
    for start in _around(stage.camera_from_lidar(), 1.5, 0.1)[:2]:
        solution = subject.built()(problem, start)
        before, after = pairs.cost(np.stack([start, solution.camera_from_lidar]))
        require(after <= before * (1 + 1e-9) + 1e-9, f"cost rose from {before:.4g} to {after:.4g}")
        require(np.isfinite(solution.cost), f"Solution.cost is {solution.cost}")


@_check(Kind.SOLVER)
def solver_says_when_nothing_is_determined(subject: Subject) -> None:
    """Without any pairs a solver of pairs returns its start with status "singular", and does not raise."""
    if "pairs" not in subject.needs:
        return
    truth = stage.camera_from_lidar()
    empty = PointToLine.empty((stage.camera(),))
    solution = subject.built()(empty, truth)
    require(solution.status is SolverStatus.SINGULAR, f"status is {solution.status.value!r} without any pairs")
    _require_near(solution.camera_from_lidar, truth, 1e-6, 1e-6)


@_check(Kind.SOLVER)
def covariance_is_one(subject: Subject) -> None:
    """A covariance is (6, 6), symmetric and has no negative variance."""
    covariance = subject.built()(_problem(subject), _around(stage.camera_from_lidar(), 0.5, 0.02)[0]).covariance
    if covariance is None:
        return
    require(covariance.shape == (6, 6), f"shape {covariance.shape}")
    require(np.allclose(covariance, covariance.T, atol=1e-9 * np.abs(covariance).max()), "not symmetric")
    require(np.linalg.eigvalsh(covariance).min() >= -1e-9 * np.abs(covariance).max(), "a negative variance")


@_check(Kind.SOLVER)
def solutions_repeat(subject: Subject) -> None:
    """The same problem and start give the same pose, bit for bit; the problem is not written to."""
    problem, start = _problem(subject), _around(stage.camera_from_lidar(), 1.0, 0.05)[0]
    with _unchanged(problem):
        poses = [subject.built()(problem, start).camera_from_lidar for _ in range(2)]
    require(np.array_equal(*poses), "the poses of two runs differ")


# ---- initializers


@_check(Kind.INITIALIZER)
def starts_are_no_worse(subject: Subject) -> None:
    """On exact features, from 2 deg and 10 cm, one of the proposed starts is no farther from the truth in the image."""
    truth = stage.camera_from_lidar()
    start = _around(truth, 2.0, 0.1)[0]
    poses = subject.built()([_input(subject, stage.view())], start)
    shifts = [_shift_px(pose, truth) for pose in poses]
    require(
        min(shifts) <= 1.05 * _shift_px(start, truth) + 1e-9,
        f"the best of {len(poses)} starts is {min(shifts):.1f} px off, the given one {_shift_px(start, truth):.1f} px",
    )


@_check(Kind.INITIALIZER)
def starts_without_edges_are_no_crash(subject: Subject) -> None:
    """Views without any edges give a start near the given one, and no error."""
    truth = stage.camera_from_lidar()
    poses = subject.built()([_input(subject, stage.bare_view())], truth)
    require(any(pose_error(pose, truth).rotation_deg < 30 for pose in poses), "no start within 30 deg of the given one")


@_check(Kind.INITIALIZER)
def starts_repeat(subject: Subject) -> None:
    """The same views and start give the same poses, bit for bit; the views are not written to."""
    view, start = _input(subject, stage.view()), _around(stage.camera_from_lidar(), 2.0, 0.1)[0]
    with _unchanged(view):
        first, second = (subject.built()([view], start) for _ in range(2))
    require(len(first) == len(second), f"{len(first)} and {len(second)} starts")
    require(all(map(np.array_equal, first, second)), "the starts of two runs differ")


# ---- calibrators


@_check(Kind.CALIBRATOR)
def calibrator_answers(subject: Subject) -> None:
    """A result names its frames and its start; one that is not solved returns the start with a reason."""
    frame = stage.frame().without_truth()
    start = _around(stage.camera_from_lidar(), 1.0, 0.05)[0]
    result = subject.built()([frame], start)
    require(result.frames == ("stage",), f"frames are {result.frames}")
    require(np.allclose(result.start, start), "the start in the result is another one")
    if not result.status.solved:
        require(np.allclose(result.camera_from_lidar, start), f"{result.status} does not return the start")
        require(result.reason, f"{result.status} has no reason")


@_check(Kind.CALIBRATOR)
def calibrations_repeat(subject: Subject) -> None:
    """The same frames and start give the same pose, bit for bit."""
    frame, start = stage.frame().without_truth(), _around(stage.camera_from_lidar(), 1.0, 0.05)[0]
    poses = [subject.built()([frame], start).camera_from_lidar for _ in range(2)]
    require(np.array_equal(*poses), "the poses of two runs differ")


# ---- datasets


@_check(Kind.DATASET)
def names_come_before_frames(subject: Subject) -> None:
    """There is at least one frame, and each name is that of its frame."""
    dataset = _opened(subject)
    require(len(dataset), "the dataset has no frames")
    for index in _some(dataset):
        require(dataset[index].name == dataset.names[index], f"frame {index} is called {dataset[index].name!r}")


@_check(Kind.DATASET)
def frames_are_read_alike_again(subject: Subject) -> None:
    """Reading a frame twice, and from a freshly built dataset, gives the same frame, bit for bit."""
    dataset, again = _opened(subject), _opened(subject)
    for index in _some(dataset):
        first = dataset[index]
        _require_equal(first, dataset[index], f"frame {index} differs when read again")
        _require_equal(first, again[index], f"frame {index} differs in a fresh dataset")


@_check(Kind.DATASET)
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


# ---- exporters


@_check(Kind.EXPORTER)
def exports_repeat(subject: Subject) -> None:
    """A result is written to the path that is asked for, and twice the same gives the same bytes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.out" for name in "ab"]
        for path in paths:
            subject.built()(_result(), path)
            require(path.is_file() and path.stat().st_size, "nothing was written")
        require(paths[0].read_bytes() == paths[1].read_bytes(), "the same result gives other bytes")


@_check(Kind.EXPORTER)
def unwritable_paths_are_errors(subject: Subject) -> None:
    """A path that cannot be written raises a P2OError instead of losing the result."""
    with tempfile.NamedTemporaryFile() as file:
        try:
            subject.built()(_result(), Path(file.name) / "below" / "a-file.out")
        except P2OError as problem:
            require("raised" not in str(problem), str(problem))
            return
    raise CheckFailed("a path below a file was written without an error")


# ---- what the checks share


@contextmanager
def _offline() -> Iterator[None]:
    """Make every connection an error."""

    def refuse(*_: Any) -> None:
        raise CheckFailed("building opens a connection")

    kept = socket.socket.connect
    socket.socket.connect = refuse  # type: ignore[method-assign]
    try:
        yield
    finally:
        socket.socket.connect = kept  # type: ignore[method-assign]


def _arrays(value: Any) -> dict[str, Any]:
    """Return every array inside of a value by its name."""
    return {name: leaf for name, leaf in leaves(value) if isinstance(leaf, np.ndarray)}


@contextmanager
def _unchanged(value: Any) -> Iterator[None]:
    """Fail if an array inside of `value` changes."""
    before = {name: array.copy() for name, array in _arrays(value).items()}
    yield
    for name, array in _arrays(value).items():
        require(np.array_equal(before[name], array, equal_nan=array.dtype.kind == "f"), f"{name} was written to")


def _require_equal(first: Any, second: Any, message: str) -> None:
    here, there = _arrays(first), _arrays(second)
    require(here.keys() == there.keys(), message)
    for name, array in here.items():
        same = np.array_equal(array, there[name], equal_nan=array.dtype.kind == "f")
        require(same, f"{message}: {name}")


def _image_edges(subject: Subject, image: Any) -> ImageEdges:
    features = subject.built()(image)
    require(features.edges is not None, "the features hold no edges")
    edges: ImageEdges = features.edges
    return edges


def _cloud_edges(subject: Subject, cloud: Any) -> CloudEdges:
    features = subject.built()(cloud)
    require(features.edges is not None, "the features hold no edges")
    edges: CloudEdges = features.edges
    return edges


def _require_sides(subject: Subject, edges: ImageEdges | CloudEdges) -> None:
    without = int((edges.side == Side.NONE).sum())
    if "side" in subject.gives:
        require(without == 0, f"{without} of {len(edges)} edges have no side, though `gives` says side")
    else:
        require(without == len(edges), "edges have sides, though `gives` does not say side")


def _input(subject: Subject, view: Any) -> Any:
    """Return the view as the pipeline would hand it over: without sides where the method does not ask for them."""
    return view if "side" in subject.needs or subject.offer.kind == Kind.INITIALIZER else view.without_sides()


def _matched(subject: Subject, views: Sequence[Any]) -> Any:
    return subject.built()([_input(subject, view) for view in views], stage.camera_from_lidar(), 20.0)


def _pairs() -> PointToLine:
    """Return exact pairs: every outline point of the stage with the line through its own projection."""
    edges, truth = stage.view().cloud_edges, stage.camera_from_lidar()
    xyz = se3.apply(truth, edges.xyz)
    uv = stage.camera().project(xyz)
    # The outline runs along y for upper and bottom edges, along z for the others.
    along = np.where(np.isin(edges.side, [Side.UPPER, Side.BOTTOM])[:, None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ahead = stage.camera().project(se3.apply(truth, edges.xyz + 0.01 * along)) - uv
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
    count = len(edges)
    return PointToLine(
        edges.xyz, uv, normal, np.ones(count), edges.side, np.zeros(count, np.int64), (stage.camera(),), huber_px=1.0
    )


def _problem(subject: Subject) -> Any:
    return _pairs() if "pairs" in subject.needs else _pairs().as_objective()


def _around(truth: Float, angle_deg: float, distance_m: float) -> Float:
    """Return eight poses (8, 4, 4) at an angle and a distance from the truth, in fixed directions."""
    axes = np.array(
        [[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1], [1, 1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, -1]]
    )
    unit = axes / np.sqrt(3.0)
    return np.asarray(truth @ se3.exp(np.column_stack([np.radians(angle_deg) * unit, distance_m * unit[::-1]])))


def _require_near(pose: Float, truth: Float, angle_deg: float, distance_m: float) -> None:
    error = pose_error(pose, truth)
    require(
        error.rotation_deg <= angle_deg and error.translation_m <= distance_m,
        f"{error.rotation_deg:.4f} deg and {error.translation_m:.4f} m from the truth, "
        f"at most {angle_deg:g} deg and {distance_m:g} m are promised",
    )


def _shift_px(pose: Float, truth: Float) -> float:
    """Return how far apart two poses put the outlines of the stage, in pixels on average."""
    xyz = stage.view().cloud_edges.xyz
    here, there = (stage.camera().project(se3.apply(p, xyz)) for p in (pose, truth))
    return float(np.nanmean(np.linalg.norm(here - there, axis=1)))


def _opened(subject: Subject) -> Dataset:
    dataset: Dataset = subject.built()
    return dataset


def _some(dataset: Dataset) -> list[int]:
    """Return the first and the last index: reading all could take minutes."""
    return sorted({0, len(dataset) - 1})


def _sorted(rows: Float) -> Float:
    return rows[np.lexsort(np.round(rows, 6).T)]


def _result() -> Result:
    truth = stage.camera_from_lidar()
    turn = Round("refine", 50.0, {"L": 40, "R": 38}, 1.25, 2.5, 0.1, 0.01, True)
    return Result(
        ("stage",),
        _around(truth, 1.0, 0.05)[0],
        truth,
        Status.CONVERGED,
        "the last round moved the pose by less than the tolerance",
        (turn,),
        covariance=1e-6 * np.eye(6),
        matches={"L": 40, "R": 38},
        residual_px={"L": 0.5, "R": 0.75},
        judged=Judged(DIRECTED, "px", 3.0, 1.0),
        agreement=Agreement(0.5, 0.1, 78),
        rival=Rival(1.0, "edges", 1.5, 0.2),
        verdict=Verdict((Reason(Doubt.RIVAL_POSE, "another pose fits as well"),)),
        seconds={"extract": 0.5},
        recipe={"matcher": "ogm"},
        seed=0,
        versions={"p2o-calib": "0"},
    )
