"""What matchers promise of the problems that they pose, and initializers of the initial guesses that they propose."""

from __future__ import annotations

from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.features.side import Side
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import pose_error
from p2o.host.method import Kind
from p2o.host.stages import JudgeBase
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import LeastSquares, Objective
from p2o.results.verdict import Doubt

from p2o_testing import stage
from p2o_testing.exact import around, bare_view, require_near, truth_of, view
from p2o_testing.same import Call, equal, require_equal
from p2o_testing.subject import CheckFailed, Checks, Subject, both, but, gives, needs, require

CHECKS = Checks(Kind.MATCHER)

_REACH_PX = 20.0


def _posed(subject: Subject, *views: View) -> Any:
    """Return the problem of views at the truth, from a freshly built stage."""
    return subject.built()(list(views), stage.camera_from_lidar(), _REACH_PX)


def _call(subject: Subject) -> Call:
    return Call.of(subject, [view(subject)], stage.camera_from_lidar(), _REACH_PX)


def _problem(subject: Subject) -> Any:
    return subject.once(_call).answer


_pairs = gives("pairs")
_residuals = gives("residuals")


@CHECKS.of()
def problems_are_what_is_given(subject: Subject) -> None:
    """`gives` names the problem of a matcher: `pairs` a PointToLine, `residuals` a LeastSquares, `objective` a cost."""
    problem = _problem(subject)
    words = subject.gives & {"pairs", "residuals", "objective"}
    require(len(words) == 1, f"`gives` says {', '.join(sorted(words)) or 'nothing'}, one of the three is wanted")
    if words == {"pairs"}:
        require(isinstance(problem, PointToLine), f"{type(problem).__name__} is no PointToLine, `gives` says pairs")
    elif words == {"residuals"}:
        require(isinstance(problem, LeastSquares), f"{type(problem).__name__} has no residuals, as `gives` says")


@CHECKS.of(_pairs)
def matches_fit_at_the_truth(subject: Subject) -> None:
    """With exact features at the true pose, at least half of the points are matched, with nearly no residual."""
    problem = _problem(subject)
    share = len(problem) / len(stage.view().cloud_edges)
    require(share >= 0.5, f"only {100 * share:.0f} % of the points are matched")
    residual = float(np.median(np.abs(problem.residuals(stage.camera_from_lidar()))))
    require(residual <= 0.1, f"the median residual is {residual:.2f} px, with exact features at the true pose")


@CHECKS.of(but(_pairs))
def costs_are_lowest_at_the_truth(subject: Subject) -> None:
    """On the stage the true pose, or one within 0.25 deg and 2 cm of it, costs least: less than all 1 deg away."""
    truth, problem = stage.camera_from_lidar(), _problem(subject)
    near = problem.cost(np.concatenate([truth[None], around(truth, 0.1, 0.0), around(truth, 0.25, 0.02)])).min()
    far = problem.cost(np.concatenate([around(truth, 1.0, 0.0), around(truth, 1.0, 0.1)])).min()
    require(near < far, f"the least cost near the truth is {near:.6g}, one degree away it is {far:.6g}")


@CHECKS.of(both(_pairs, needs("side")))
def matches_keep_their_side(subject: Subject) -> None:
    """A matcher that needs `side` pairs points with lines across the direction of their side only."""
    problem = _problem(subject)
    for side, axis in ((Side.LEFT, 0), (Side.RIGHT, 0), (Side.UPPER, 1), (Side.BOTTOM, 1)):
        normals = np.abs(problem.normal[problem.side == side])
        require(not len(normals) or np.median(normals[:, axis]) > 0.7, f"lines of {side.name} points run the wrong way")


@CHECKS.of(_pairs)
def matches_stay_within_reach(subject: Subject) -> None:
    """No pair is farther apart than the reach, at a pose two degrees off."""
    pose = around(stage.camera_from_lidar(), 2.0, 0.0)[0]
    problem = subject.built()([view(subject)], pose, 6.0)
    if not len(problem):
        return
    widest = float(np.abs(problem.residuals(pose)).max())
    require(widest <= 6.0 + 1e-6, f"a pair is {widest:.1f} px apart with a reach of 6 px")


@CHECKS.of()
def no_edges_give_no_matches(subject: Subject) -> None:
    """Views in which nothing was found give an empty problem, or a finite cost, and no error."""
    problem = _posed(subject, bare_view(subject))
    if isinstance(problem, LeastSquares):
        require(len(problem) == 0, f"{len(problem)} matches out of nothing")
    else:
        require(np.isfinite(problem.cost(stage.camera_from_lidar()[None])).all(), "the cost is not finite")


@CHECKS.of()
def several_views_are_joined(subject: Subject) -> None:
    """Two views with the same features give every residual twice, or a cost with the same order of poses."""
    truth = stage.camera_from_lidar()
    one, two = _problem(subject), _posed(subject, view(subject), view(subject))
    if isinstance(one, LeastSquares):
        require(len(two) == 2 * len(one), f"{len(one)} matches in one view, {len(two)} in two of them")
        require(set(np.ravel(two.frame).tolist()) <= {0, 1}, "matches do not name the view they are of")
        if isinstance(two, PointToLine):
            require(len(two.cameras) == 2, "there is not one camera a view")
    else:
        poses = np.concatenate([truth[None], around(truth, 1.0, 0.05)])
        require(np.argmin(one.cost(poses)) == np.argmin(two.cost(poses)), "two equal views prefer another pose")


@CHECKS.of()
def a_bare_view_adds_nothing(subject: Subject) -> None:
    """A view in which nothing was found, beside another one, adds no residuals and leaves the cost finite."""
    one, two = _problem(subject), _posed(subject, view(subject), bare_view(subject))
    if isinstance(one, LeastSquares):
        require(len(two) == len(one), f"{len(one)} matches, {len(two)} with a bare view beside them")
        require(set(np.ravel(two.frame).tolist()) <= {0}, "matches are said to be of the bare view")
    require(np.isfinite(two.cost(stage.camera_from_lidar()[None])).all(), "the cost is not finite")


@CHECKS.of()
def matches_repeat(subject: Subject) -> None:
    """The same views give the same problem, also from a freshly built stage; the views are not written to."""
    call = subject.once(_call)
    call.require_unwritten()
    first, second = call.answer, subject.built()(*call.given)
    if isinstance(first, PointToLine):
        require_equal(first, second, "the problems of the same views differ")
    poses = around(stage.camera_from_lidar(), 0.5, 0.05)
    require(equal(first.cost(poses), second.cost(poses)), "the costs of the same views differ")


@CHECKS.of()
def costs_are_one_a_pose(subject: Subject) -> None:
    """The cost of poses (B, 4, 4) is (B,), finite, and that of each pose for itself, asked twice as well."""
    problem, poses = _problem(subject), around(stage.camera_from_lidar(), 1.0, 0.05)
    costs = problem.cost(poses)
    require(np.shape(costs) == (8,), f"the cost of 8 poses has shape {np.shape(costs)}")
    require(np.isfinite(costs).all(), "a cost one degree from the truth is not finite")
    require(equal(costs, problem.cost(poses)), "the same problem gives other costs when asked again")
    alone = np.concatenate([problem.cost(pose[None]) for pose in poses])
    require(np.allclose(costs, alone, rtol=1e-5), "poses cost other when asked for alone")


@CHECKS.of(but(_residuals))
def gradients_agree_with_differences(subject: Subject) -> None:
    """Where an objective gives a gradient, differences of its cost point the same way."""
    problem = _problem(subject)
    if not isinstance(problem, Objective) or problem.gradient is None:
        return
    pose = around(stage.camera_from_lidar(), 0.3, 0.03)[1]
    step = np.repeat([np.radians(0.02), 0.004], 3)
    ahead, behind = problem.cost(se3.exp(np.concatenate([np.diag(step), -np.diag(step)])) @ pose).reshape(2, 6)
    gradient, differences = problem.gradient(pose) * step, (ahead - behind) / 2
    require(np.shape(gradient) == (6,), f"the gradient has shape {np.shape(gradient)}, not (6,)")
    # Costs of images and points are not smooth: points enter and leave the view.
    norms = float(np.linalg.norm(gradient) * np.linalg.norm(differences))
    cosine = float(gradient @ differences) / max(norms, 1e-300)
    require(cosine > 0.9, f"the gradient points elsewhere than differences of the cost (cosine {cosine:.2f})")


@CHECKS.of(_residuals)
def residuals_have_their_shape(subject: Subject) -> None:
    """Residuals are (K,) for one pose and (B, K) for several, equal, finite or NaN; weights and frames are (K,)."""
    problem, poses = _problem(subject), around(stage.camera_from_lidar(), 0.5, 0.05)
    count = len(problem)
    require(np.shape(problem.weight) == (count,), f"{count} residuals, weights of shape {np.shape(problem.weight)}")
    require(np.shape(problem.frame) == (count,), f"{count} residuals, frames of shape {np.shape(problem.frame)}")
    require(count and problem.weight.min() >= 0, "there are no residuals" if not count else "a weight is negative")
    require(0 < problem.huber < problem.far, f"huber is {problem.huber:g}, far is {problem.far:g}")
    many, one = problem.residuals(poses), problem.residuals(poses[0])
    require(np.shape(one) == (count,), f"residuals of one pose have shape {np.shape(one)}, not ({count},)")
    require(np.shape(many) == (8, count), f"residuals of 8 poses have shape {np.shape(many)}, not (8, {count})")
    require(not np.isinf(many).any(), "a residual is infinite: NaN is what cannot be seen")
    require(np.isfinite(many).any(), "no residual is a number")
    require(np.allclose(many[0], one, rtol=1e-6, atol=1e-9, equal_nan=True), "a pose has other residuals among others")


@CHECKS.of(_residuals)
def jacobians_agree_with_differences(subject: Subject) -> None:
    """Derivatives (K, 6) for a left update are those of the residuals, in all but a few rows."""
    problem, pose = _problem(subject), around(stage.camera_from_lidar(), 0.3, 0.03)[1]
    with np.errstate(invalid="ignore"):  # where a residual is not finite
        residuals, jacobian = problem.residuals_with_jacobian(pose)
        _, differences = LeastSquares.residuals_with_jacobian(problem, pose)
    require(np.shape(jacobian) == (len(problem), 6), f"derivatives have shape {np.shape(jacobian)}")
    equal_residuals = np.allclose(residuals, problem.residuals(pose), rtol=1e-6, atol=1e-9, equal_nan=True)
    require(equal_residuals, "residuals with derivatives are others than without")
    rows = np.isfinite(differences).all(axis=1)
    size = np.abs(differences[rows]).max(axis=1, keepdims=True)
    off = np.abs(jacobian[rows] - differences[rows]) > 1e-3 * np.maximum(size, 1e-6)
    # Residuals that are looked up in maps have kinks, which some differences step over.
    wrong = float(off.any(axis=1).mean())
    require(wrong <= 0.1, f"{100 * wrong:.0f} % of the derivatives are not those of their residuals")


@CHECKS.of(_residuals)
def costs_are_those_of_the_residuals(subject: Subject) -> None:
    """The cost of a least squares is its robust sum: that of `loss` for `residuals`."""
    problem, poses = _problem(subject), around(stage.camera_from_lidar(), 1.0, 0.05)
    costs, sums = problem.cost(poses), problem.loss(problem.residuals(poses))
    require(np.allclose(costs, sums, rtol=1e-6), f"a pose costs {costs[0]:.6g}, its residuals sum to {sums[0]:.6g}")


@CHECKS.of(lambda method: method.example is not None)
def the_example_is_solved(subject: Subject) -> None:
    """A calibration of the frames of the example, with the methods it names, comes as near as it promises.

    Trust is not refused for the kind of its problem: where its edges agree in enough cells of the image, a problem
    without pairs is no reason for doubt.
    """
    from p2o.run.run import calibrate
    from p2o.run.words import parse_settings

    example, offer = subject.example, subject.offer
    assert example is not None
    run = calibrate(
        example.data,
        extractor=example.extractor or None,
        matcher=offer.full_name,
        solver=example.solver or None,
        init=example.init or None,
        options={**parse_settings(example.settings), "matcher": subject.options.model_dump()},
        perturb=example.perturb,
        joint=example.joint,
        accumulate=example.accumulate or None,
        witness="none",
        registry=subject.registry,
    )
    within = parse_perturbation(example.within)
    for row in run.rows:
        result = row.result
        name = ", ".join(result.frames)
        require(result.status.solved, f"{name}: {result.status.value}: {result.reason}")
        if row.truth is None:
            raise CheckFailed(f"{name} has no truth to compare with")
        require_near(result.camera_from_lidar, row.truth, within.angle_deg, within.distance_m, f"{name}: ")
        doubts = {reason.doubt for reason in result.verdict.reasons}
        many = result.agreement is not None and result.agreement.places >= JudgeBase.min_cells
        require(
            not (many and Doubt.TOO_FEW_PLACES in doubts), f"{name}: edges agree in many places, and trust is refused"
        )


INITIALIZERS = Checks(Kind.INITIALIZER)


@INITIALIZERS.of()
def starts_are_no_worse(subject: Subject) -> None:
    """On exact features, from 2 deg and 10 cm, one of the proposed starts is no farther from the truth in the image."""
    (_, truth), call = subject.once(_given), subject.once(_proposed)
    shifts = [_shift_px(pose, truth) for pose in call.answer]
    at_start = _shift_px(call.given[1], truth)
    require(
        min(shifts) <= 1.05 * at_start + 1e-9,
        f"the best of {len(shifts)} starts is {min(shifts):.1f} px off, the given one {at_start:.1f} px",
    )


@INITIALIZERS.of()
def starts_without_edges_are_no_crash(subject: Subject) -> None:
    """Views in which nothing was found give a start near the given one, and no error."""
    truth = stage.camera_from_lidar()
    poses = subject.built()([bare_view(subject)], truth)
    require(any(pose_error(pose, truth).rotation_deg < 30 for pose in poses), "no start within 30 deg of the given one")


@INITIALIZERS.of()
def starts_repeat(subject: Subject) -> None:
    """The same views and start give the same poses, bit for bit; the views are not written to."""
    call = subject.once(_proposed)
    call.require_unwritten()
    call.require_repeated(subject, "starts")


def _proposed(subject: Subject) -> Call:
    """Return a first proposal from 2 deg and 10 cm, which serves all checks: initializers by motion can take long."""
    views, truth = subject.once(_given)
    return Call.of(subject, views, around(truth, 2.0, 0.1)[0])


def _given(subject: Subject) -> tuple[list[View], Float]:
    """Return views to try the method on, and the truth: the stage, or what it prepares of the frames it asks for."""
    initializer = subject.built()
    if not initializer.prepares:
        return [view(subject)], stage.camera_from_lidar()
    frames = subject.frames
    features = view(subject)
    views = [
        View(frame.name, frame.camera, features.image, features.cloud, frame.twist, prepared=initializer.prepare(frame))
        for frame in frames
    ]
    return views, truth_of(frames)


def _shift_px(pose: Float, truth: Float) -> float:
    """Return how far apart two poses put the outlines of the stage, in pixels on average."""
    xyz = stage.view().cloud_edges.xyz
    first, second = (stage.camera().project(se3.apply(p, xyz)) for p in (pose, truth))
    return float(np.nanmean(np.linalg.norm(first - second, axis=1)))
