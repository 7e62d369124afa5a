"""Every method of ours keeps the contract of its slot, and the kit finds those that do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Kind, Method, UnknownNameError
from p2o.testing import CHECKS, Case, CheckFailed, checks_for, conformance_cases, reads_files, stage

SMALL = {"synthetic": {"width_px": 310, "height_px": 94}}


@pytest.mark.parametrize("check", conformance_cases("p2o-calib", SMALL))
def test_conformance(check: Case) -> None:
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


def test_every_check_has_a_promise_and_every_kind_has_checks() -> None:
    assert all(check.promise.endswith(".") for check in CHECKS)
    for kind in Kind:
        assert sum(kind in check.kinds for check in CHECKS) > 4, kind


# ---- the stage itself


def test_the_stage_is_exact() -> None:
    view, frame = stage.view(), stage.frame()
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


def test_the_sweep_of_the_stage_is_whole() -> None:
    cloud = stage.frame().cloud
    assert np.bincount(cloud.ring).tolist() == [1500] * 64
    assert pytest.approx(cloud.xyz[:, 2].min()) == p2o.testing.stage.FLOOR_M


# ---- methods that break their promise


def method(stage_: Any, **more: Any) -> Method:
    return Method(name="wrong", build=lambda options: stage_, summary="A test.", **more)


def failing(subject: Method, kind: Kind) -> set[str]:
    """Return the names of the checks that a method fails."""
    names = set()
    for case in checks_for(subject, kind):
        try:
            case()
        except (CheckFailed, p2o.P2OError):
            names.add(case.check.name)
    return names


def edges(uv: Any, side: int = -1) -> p2o.ImageFeatures:
    uv = np.asarray(uv, dtype=float).reshape(-1, 2)
    return p2o.ImageFeatures(edges=p2o.ImageEdges(uv, np.full(len(uv), side, np.int8)))


def test_an_image_extractor_that_makes_edges_up_is_found() -> None:
    found = failing(
        method(lambda image: edges([[10.0, 10.0], [900.0, 20.0]]), gives={"image-edges"}), Kind.IMAGE_EXTRACTOR
    )
    assert found == {
        "image_edges_are_in_the_image",
        "image_edges_lie_on_outlines",
        "a_featureless_image_has_no_edges",
    }


def test_undeclared_and_missing_sides_are_found() -> None:
    sided = method(lambda image: edges([[10.0, 10.0]], side=0), gives={"image-edges"})
    bare = method(lambda image: edges([[10.0, 10.0]]), gives={"image-edges", "side"})
    assert "image_sides_are_as_declared" in failing(sided, Kind.IMAGE_EXTRACTOR)
    assert "image_sides_are_as_declared" in failing(bare, Kind.IMAGE_EXTRACTOR)


def test_an_extractor_that_draws_at_random_is_found() -> None:
    rng = np.random.default_rng(0)
    found = failing(
        method(lambda image: edges(rng.uniform(1, 99, (5, 2))), gives={"image-edges"}), Kind.IMAGE_EXTRACTOR
    )
    assert "image_edges_repeat" in found


def test_a_method_that_writes_to_its_input_is_found() -> None:
    def vandal(image: p2o.Image) -> p2o.ImageFeatures:
        owner = image.rgb
        while owner.base is not None:
            owner = owner.base
        owner.flags.writeable = True
        owner[0, 0] += 1
        return edges([[10.0, 10.0]])

    try:
        assert "image_input_is_unchanged" in failing(method(vandal, gives={"image-edges"}), Kind.IMAGE_EXTRACTOR)
    finally:
        stage.frame.cache_clear()


def test_a_matcher_with_biased_lines_is_found() -> None:
    def match(views: Any, pose: Any, reach: float) -> p2o.PointToLine:
        cameras = tuple(view.camera for view in views)
        cloud = views[0].cloud_edges
        uv = views[0].camera.project(p2o.se3.apply(pose, cloud.xyz)) + 3.0
        normal = np.tile([1.0, 0.0], (len(uv), 1))
        count = len(uv)
        index = np.zeros(count, np.int64)
        return p2o.PointToLine(cloud.xyz, uv, normal, np.ones(count), cloud.side, index, cameras)

    found = failing(method(match, gives={"pairs"}), Kind.MATCHER)
    assert {"matches_fit_at_the_truth", "several_views_are_joined"} <= found
    assert "no_edges_give_no_matches" not in found


def test_solvers_that_wander_worsen_or_stay_are_found() -> None:
    def wander(problem: Any, pose: Any) -> p2o.Solution:
        return p2o.Solution(pose @ p2o.se3.make(translation=(0.5, 0, 0)), 0.0, 1)

    def stay(problem: Any, pose: Any) -> p2o.Solution:
        return p2o.Solution(pose, 0.0, 1)

    needs = {"needs": {"pairs"}}
    assert failing(method(wander, **needs), Kind.SOLVER) >= {
        "solver_stays_at_the_truth",
        "solver_returns_to_the_truth",
        "solver_never_makes_it_worse",
        "solver_says_when_nothing_is_determined",
    }
    assert failing(method(stay, **needs), Kind.SOLVER) == {
        "solver_returns_to_the_truth",
        "solver_says_when_nothing_is_determined",
    }


def test_an_initializer_that_leads_astray_is_found() -> None:
    def astray(views: Any, pose: Any) -> list[Any]:
        return [pose @ p2o.se3.exp(np.array([0, 0, 1.0, 0, 0, 0]))]

    assert failing(method(astray), Kind.INITIALIZER) == {"starts_are_no_worse", "starts_without_edges_are_no_crash"}


def test_an_exporter_that_loses_the_result_is_found() -> None:
    found = failing(method(lambda result, path: None), Kind.EXPORTER)
    assert found == {"exports_repeat", "unwritable_paths_are_errors"}


class _Changing(list[p2o.Frame]):
    """A dataset whose frames differ each time they are read."""

    names = ("stage",)

    def __init__(self) -> None:
        super().__init__([stage.frame()])
        self.reads = 0

    def __getitem__(self, index: Any) -> Any:
        self.reads += 1
        frame = super().__getitem__(index)
        return frame if isinstance(frame, list) else replace(frame, twist=np.full(6, float(self.reads)))


def test_a_dataset_that_changes_is_found() -> None:
    assert failing(Method(name="wrong", build=lambda options: _Changing(), summary="A test."), Kind.DATASET) == {
        "frames_are_read_alike_again"
    }


def test_a_calibrator_that_hides_its_start_is_found() -> None:
    def calibrate(frames: Any, start: Any) -> p2o.Result:
        return p2o.Result(("?",), np.eye(4), np.eye(4), p2o.Status.TOO_FEW_MATCHES, "")

    assert failing(method(calibrate), Kind.CALIBRATOR) == {"calibrator_answers"}


def test_options_without_help_default_or_json_are_found() -> None:
    class Poor(p2o.Options):
        size: int
        rate: float = 1.0

    subject = Method(name="wrong", build=lambda options: stay_put, summary="A test.", options=Poor)
    cases: dict[str, Callable[[], None]] = {c.check.name: c for c in checks_for(subject, Kind.SOLVER, {"size": 1})}
    with pytest.raises(CheckFailed, match="options without default: size"):
        cases["every_option_has_a_default"]()
    with pytest.raises(CheckFailed, match="options without help: size, rate"):
        cases["every_option_is_described"]()


def stay_put(problem: Any, pose: Any) -> p2o.Solution:
    return p2o.Solution(pose, 0.0, 1)


def test_building_that_opens_a_connection_is_found() -> None:
    def build(options: Any) -> Any:
        import socket

        with socket.socket() as line:
            line.connect(("127.0.0.1", 9))

    subject = Method(name="wrong", build=build, summary="A test.")
    cases = {case.check.name: case for case in checks_for(subject, Kind.SOLVER)}
    with pytest.raises((CheckFailed, p2o.PluginError), match="building opens a connection"):
        cases["builds_twice_offline"]()


def test_expected_failures_carry_their_reason_and_must_name_checks() -> None:
    subject = method(stay_put, needs={"pairs"}, expected_failures=(("solver_returns_to_the_truth", "it stays put"),))
    reasons = {case.check.name: case.expected_failure for case in checks_for(subject, Kind.SOLVER)}
    assert reasons["solver_returns_to_the_truth"] == "it stays put"
    assert reasons["solutions_repeat"] == ""
    with pytest.raises(UnknownNameError, match="unknown conformance check 'solver_returns'"):
        checks_for(method(stay_put, expected_failures=(("solver_returns", "why"),)), Kind.SOLVER)


def test_a_bare_method_must_say_its_kind() -> None:
    with pytest.raises(TypeError, match="does not know its kind"):
        checks_for(method(stay_put))
