"""Every method of ours keeps the contract of its slot, and the kit finds those that do not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Kind, Method, UnknownNameError
from p2o.solving import Objective
from p2o_testing import CHECKS, Case, CheckFailed, NotApplicable, checks_for, conformance_cases, reads_files, stage

from tests.broken_methods import BROKEN, REGISTRY
from tests.rendered_frames import all_rendered

SMALL = {"synthetic": {"width_px": 310, "height_px": 94, "lidar": "vlp-16"}}


SOLVED = "the_example_is_solved"
"""The check that solves the example of a matcher, some 10 s each."""

SOLVE_DRIVES = {
    *("csc", "hand-eye"),
    *("acsc", "cues", "domhof", "geiger", "gong", "koo", "kuemmerle", "matches", "mirzaei", "velas", "velo2cam"),
    "zhou",
}
"""Methods whose example is a drive or many poses of a target; what needs its frames is a system test."""

WITHOUT_FRAMES = {
    "every_option_has_a_default",
    "every_option_is_described",
    "options_survive_json",
    "builds_twice_offline",
    "the_example_needs_no_files",
}
"""The checks that read no frame."""


def groups() -> list[Any]:
    """Return all other checks of our methods; those of methods that share an example are one group, in one process."""
    found: dict[tuple[str, bool], list[Case]] = {}
    for parameter in conformance_cases("p2o-calib", SMALL):
        case, offer = parameter.values[0], parameter.values[0].subject.offer
        if case.check.name != SOLVED:
            shared = offer.method.example.data if offer.method.example else f"{offer.kind.value} {offer.name}"
            system = offer.name in SOLVE_DRIVES and case.check.name not in WITHOUT_FRAMES
            found.setdefault((shared, system), []).append(case)
    return [
        pytest.param(
            cases,
            id=",".join(sorted({c.subject.offer.name for c in cases})) + " solved" * system,
            marks=[pytest.mark.system] * system,
        )
        for (_, system), cases in found.items()
    ]


@pytest.mark.parametrize("cases", groups())
def test_conformance(cases: list[Case]) -> None:
    simulator = any(case.subject.offer.kind is Kind.DATASET for case in cases)
    with all_rendered() if simulator else nullcontext():
        broken = [broken_promise(case) for case in cases]
    assert not any(broken), "\n".join(filter(None, broken))


def broken_promise(case: Case) -> str:
    """Return what a check found, empty if it passes, fails as expected, or cannot be made."""
    try:
        case()
    except NotApplicable:
        return ""
    except (CheckFailed, p2o.P2OError) as problem:
        return "" if case.expected_failure else f"{case.name}: {problem}"
    return f"{case.name} passes: {case.expected_failure} is no longer true" if case.expected_failure else ""


@pytest.mark.system
@pytest.mark.parametrize("check", [case for case in conformance_cases("p2o-calib", SMALL) if case.id.endswith(SOLVED)])
def test_examples_of_matchers_are_solved(check: Case) -> None:
    check()


def test_every_method_of_ours_is_checked_but_datasets_that_read_files() -> None:
    checked = {case.values[0].subject.offer for case in conformance_cases("p2o-calib")}
    ours = {offer for offer in p2o.Registry.load().offers if offer.dist == "p2o-calib"}
    assert ours - checked == {offer for offer in ours if reads_files(offer)}
    assert {offer.name for offer in ours - checked} >= {"folder", "kitti-object", "kitti-odometry", "kitti-raw"}


@pytest.mark.real
@pytest.mark.parametrize("name", ["kitti-raw", "kitti-object"])
def test_datasets_of_real_frames_keep_their_contract(name: str, request: pytest.FixtureRequest) -> None:
    root = request.getfixturevalue(name.replace("-", "_"))
    for case in checks_for(p2o.Registry.load().find(Kind.DATASET, name), options={"root": str(root)}):
        case()


def test_the_names_of_checks_and_methods_are_those_of_the_kit() -> None:
    assert {SOLVED, *WITHOUT_FRAMES} <= {check.name for check in CHECKS}
    assert {offer.name for offer in p2o.Registry.load().offers} >= SOLVE_DRIVES


def test_every_check_has_a_promise_and_every_kind_has_checks() -> None:
    assert all(check.promise.endswith(".") for check in CHECKS)
    for kind in Kind:
        assert sum(kind in check.kinds for check in CHECKS) > 4, kind


# ---- the stage itself


def test_the_stage_is_exact() -> None:
    view, frame = stage.view(), stage.frame()
    assert np.bincount(frame.cloud.ring).tolist() == [1500] * 64
    # Image edges are the projection of the same outlines that the cloud edges are sampled from.
    uv = frame.camera.project(p2o.se3.apply(stage.camera_from_lidar(), view.cloud_edges.xyz))
    for side, tree in view.image_edges.trees.items():
        assert tree.query(uv[view.cloud_edges.side == side])[0].max() < 0.5
    # The picture shows a plate just inside of its outline, and what lies behind it just outside.
    du, dv = np.array([p2o.Side(int(s)).background for s in view.image_edges.side]).T
    u, v = view.image_edges.uv.T
    depth = frame.image.depth_m
    inside = depth[np.rint(v - 2 * dv).astype(int), np.rint(u - 2 * du).astype(int)]
    outside = depth[np.rint(v + 2 * dv).astype(int), np.rint(u + 2 * du).astype(int)]
    assert np.mean(outside > inside + 1.0) > 0.97  # all but the ends of outlines, next to corners


# ---- methods that break their promise


def outcomes(cases: Iterable[Case]) -> dict[str, set[str]]:
    """Return the names of the checks that were failed and passed, and of those that could not be made."""
    found: dict[str, set[str]] = {"failed": set(), "passed": set(), "skipped": set()}
    for case in cases:
        try:
            case()
        except NotApplicable:
            found["skipped"].add(case.check.name)
        except (CheckFailed, p2o.P2OError):
            found["failed"].add(case.check.name)
        else:
            found["passed"].add(case.check.name)
    return found


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_promise_is_found_and_no_other_one_is_blamed(what: str) -> None:
    wrong = BROKEN[what]
    with a_stage_of_its_own() if wrong.writes else nullcontext():
        assert outcomes(checks_for(wrong.method, wrong.kind, wrong.said, REGISTRY))["failed"] == wrong.fails


@contextmanager
def a_stage_of_its_own() -> Iterator[None]:
    """Replace the stage by copies of it: what is written to here is nothing that others have."""
    with pytest.MonkeyPatch.context() as patch:
        for make in (stage.frame, stage.drive, stage.view):
            patch.setattr(stage, make.__name__, partial(lambda copied: copied, deepcopy(make())))
        yield


def test_every_check_can_fail() -> None:
    assert {check.name for check in CHECKS} == {name for wrong in BROKEN.values() for name in wrong.fails}


def test_a_word_without_features_is_found() -> None:
    empty = method(lambda image: p2o.ImageFeatures(), gives={"image-spots"})
    [case] = [c for c in checks_for(empty, Kind.IMAGE_EXTRACTOR) if c.check.name == "features_are_those_that_are_given"]
    with pytest.raises(p2o.PluginError, match="gave no spots; expected image-spots, as it says in `gives`"):
        case()


def method(stage_: Any, **more: Any) -> Method:
    return Method(name="wrong", build=lambda options: stage_, summary="A test.", **more)


# ---- which checks a method gets


def names(subject: Method, kind: Kind) -> set[str]:
    return {case.check.name for case in checks_for(subject, kind)}


def test_pairs_are_asked_for_residuals_too_a_cost_for_neither_and_examples_where_there_are_some() -> None:
    pairs, residuals, cost = (
        names(method(None, gives={word}), Kind.MATCHER) for word in ("pairs", "residuals", "objective")
    )
    assert {"residuals_have_their_shape", "jacobians_agree_with_differences"} <= pairs & residuals
    assert "matches_fit_at_the_truth" in pairs - residuals
    assert "costs_are_lowest_at_the_truth" in residuals & cost
    assert not {name for name in cost if "residual" in name or "jacobian" in name}
    asked, example = "the_example_is_solved", p2o.Example("synthetic:")
    assert asked not in pairs
    assert asked in names(method(None, gives={"pairs"}, example=example), Kind.MATCHER)
    edges, parallel = (
        names(method(None, gives={"image-edges"}, parallel=each), Kind.IMAGE_EXTRACTOR) for each in (False, True)
    )
    assert parallel - edges == {"calls_at_once_find_the_same"}


# ---- kinds of features that only a plugin knows


def test_a_plugin_with_kinds_of_its_own_keeps_every_promise() -> None:
    ours = [offer for offer in REGISTRY.offers if offer.dist == "kinds_plugin.py"]
    assert {offer.name for offer in ours} == {"spots", "marks", "marked", "to-spots"}
    for offer in ours:
        found = outcomes(checks_for(offer, registry=REGISTRY))
        assert found["failed"] == found["skipped"] == set(), offer.name


def test_matchers_see_only_what_they_need() -> None:
    words = []

    def match(views: Any, pose: Any, reach_px: float) -> Objective:
        words.append((views[0].image.words, views[0].cloud.words))
        return Objective(lambda poses: np.zeros(len(poses)))

    reflecting = method(match, needs={"image-grey", "cloud-points"}, gives={"objective"})
    outcomes(checks_for(reflecting, Kind.MATCHER))
    assert set(words) == {(frozenset({"image-grey"}), frozenset({"cloud-points"}))}


# ---- calibrators that hand back their start


def test_a_calibrator_that_gives_up_has_to_say_why_and_reaches_nothing() -> None:
    def calibrate(frames: Any, start: Any) -> p2o.Result:
        return p2o.Result(("stage",), start, start, p2o.Status.TOO_FEW_MATCHES, "there is nothing to go by")

    found = outcomes(checks_for(method(calibrate), Kind.CALIBRATOR))
    assert found["failed"] == {"calibrator_comes_near_the_truth"}
    assert found["skipped"] == {"preparations_repeat", "preparations_are_kept"}


# ---- the rest of the kit


def test_expected_failures_carry_their_reason_and_must_name_checks() -> None:
    subject = method(stay_put, needs={"pairs"}, expected_failures=(("solver_returns_to_the_truth", "it stays put"),))
    reasons = {case.check.name: case.expected_failure for case in checks_for(subject, Kind.SOLVER)}
    assert reasons["solver_returns_to_the_truth"] == "it stays put"
    assert reasons["solutions_repeat"] == ""
    with pytest.raises(UnknownNameError, match="unknown conformance check 'solver_returns'"):
        checks_for(method(stay_put, expected_failures=(("solver_returns", "why"),)), Kind.SOLVER)


def stay_put(problem: Any, pose: Any) -> p2o.Solution:
    return p2o.Solution(pose, 0.0, 1)


def test_a_bare_method_must_say_its_kind() -> None:
    with pytest.raises(TypeError, match="does not know its kind"):
        checks_for(method(stay_put))
