"""Algorithm 1 finds exact truth, is never worse than its start, and says why when it stops."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from p2o import (
    CloudEdges,
    CloudFeatures,
    ImageEdges,
    ImageFeatures,
    Result,
    Side,
    Solution,
    SolverStatus,
    Status,
    View,
    se3,
)
from p2o.calibration.options import PipelineOptions
from p2o.geometry.motion import EgoMotion, moved, pose_at
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import deviations, pose_error
from p2o.reading import RadialError
from p2o.results.result import DIRECTED, INTERVALS
from p2o.results.verdict import Doubt, Trust, Verdict
from p2o.run.pipeline import Pipeline
from p2o_baselines.edges import nearest
from p2o_plugins.initialize import given, grid, search
from p2o_plugins.match import ogm
from p2o_plugins.solve import lm, nelder_mead

from tests import edge_scene
from tests.edge_scene import TRUTH
from tests.sparse_scene import sparse_view


def built(method, **options):
    return method.METHOD.build(method.METHOD.options(**options))


def pipeline(matcher=ogm, solver=lm, initializer=search, directed=True, **options) -> Pipeline:
    """The pipeline on views made elsewhere: its extractors are never called."""
    return Pipeline(
        image_extractor=lambda image: ImageFeatures(),
        cloud_extractor=lambda cloud: CloudFeatures(),
        matcher=built(matcher),
        solver=built(solver),
        initializer=search.build(search.SearchOptions()) if initializer is search else built(initializer),
        options=PipelineOptions(**options),
        directed=directed,
    )


def start(seed: int = 0, angle_deg: float = 2.0) -> np.ndarray:
    return wrong_start(TRUTH, angle_deg, 0.15, np.random.default_rng(seed))


@pytest.mark.parametrize(
    "camera", [edge_scene.PINHOLE, edge_scene.FISHEYE, edge_scene.DISTORTED], ids=lambda c: c.model
)
def test_exact_edges_give_the_exact_pose_with_every_camera_model(camera) -> None:
    result = pipeline().solve([edge_scene.view(camera)], start())
    error = pose_error(result.camera_from_lidar, TRUTH)
    assert result.status.solved
    # The eight pixels of a line are spaced 0.3 px and straight within the distortion: hundredths of a pixel remain.
    assert error.rotation_deg < 0.01
    assert error.translation_m < 0.01
    if camera is edge_scene.PINHOLE:
        again = pipeline().solve([edge_scene.view()], start())
        assert again.camera_from_lidar.tobytes() == result.camera_from_lidar.tobytes(), "the same seed"


def test_several_frames_are_solved_jointly_and_better_than_one() -> None:
    views = [edge_scene.view(seed=i, noise_px=1.0, boxes=8) for i in range(6)]
    singles = [pose_error(pipeline(camera="trust").solve([view], start()).camera_from_lidar, TRUTH) for view in views]
    joint = pose_error(pipeline(camera="trust").solve(views, start()).camera_from_lidar, TRUTH)
    # One frame may be lucky; the mean of all may not.
    assert joint.translation_m < np.mean([error.translation_m for error in singles])
    assert joint.rotation_deg < 0.05


def test_a_wide_start_needs_the_grid_and_the_grid_finds_it() -> None:
    result = pipeline(initializer=grid, camera="trust").solve(
        [edge_scene.view(seed=i) for i in range(2)], start(3, 10.0)
    )
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 0.02


def test_what_the_camera_sees_is_told_anew_where_the_pose_was_found_far_from_the_start() -> None:
    view = edge_scene.view()
    begin = se3.make(None, [1.5, 0.0, 0.0]) @ TRUTH
    # A wall right before the camera of the start; from where the camera is, it stands to the right of the image.
    wall = np.array([[x, y, 1.5] for x in np.arange(-1, 1, 0.01) for y in np.arange(-0.4, 0.4, 0.01)])
    view = replace(view, cloud=replace(view.cloud, points=se3.apply(se3.inverse(begin), wall)))
    from_start, from_truth = (len(view.without_hidden(pose).cloud_edges) for pose in (begin, TRUTH))
    assert from_start < 0.7 * from_truth
    seen = []

    def watched(views, pose, reach_px):
        seen.append(len(views[0].cloud_edges))
        return built(ogm)(views, pose, reach_px)

    finds = replace(pipeline(camera="trust"), matcher=watched, initializer=lambda views, pose: [start(0, 0.3)])
    result = finds.solve([view], begin)
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 0.02
    assert seen[0] == from_start
    assert seen[-1] == pytest.approx(from_truth, rel=0.02)


def test_moving_the_lidar_frame_moves_the_answer_by_exactly_that() -> None:
    view, begin = edge_scene.view(noise_px=0.5), start()
    move = se3.exp(np.array([0.4, -0.9, 1.2, 1.0, 2.0, -3.0]))
    here = pipeline(camera="trust").solve([view], begin)
    there = pipeline(camera="trust").solve([view.moved(move)], begin @ se3.inverse(move))
    difference = se3.inverse(there.camera_from_lidar @ move) @ here.camera_from_lidar
    assert se3.angle_deg(difference) < 1e-3
    assert se3.distance_m(difference) < 1e-3


def test_every_round_is_recorded_with_a_shrinking_reach() -> None:
    result = pipeline(initializer=given, camera="trust").solve([edge_scene.view()], start())
    reaches = [r.reach_px for r in result.rounds]
    assert reaches[0] == 50.0
    assert all(b < a or b == 5.0 for a, b in itertools.pairwise(reaches))
    refined = [record for record in result.rounds if record.stage == "refine"]
    assert refined[-1].mean_residual < refined[0].mean_residual
    assert set(result.matches) == {"L", "R", "U", "B"}


def test_a_solver_that_walks_away_is_not_believed() -> None:
    begin = se3.exp(np.array([0.002, 0.002, 0, 0, 0, 0])) @ TRUTH

    def away(problem, pose):
        return Solution(se3.exp(np.array([0.01, 0.01, 0, 0, 0, 0])) @ TRUTH, 0.0, 1)

    result = replace(pipeline(initializer=given), solver=away).solve([edge_scene.view()], begin)
    assert result.status is Status.NO_IMPROVEMENT
    assert "initial guess" in result.reason
    np.testing.assert_array_equal(result.camera_from_lidar, result.start)
    np.testing.assert_allclose(result.start, begin, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"image": ImageFeatures(ImageEdges.empty())}, "no edges were found in the image"),
        ({"cloud": CloudFeatures(CloudEdges.empty())}, "no edges were found in the sweep"),
    ],
)
def test_no_edges_of_a_sensor_are_a_status_with_a_reason(change: dict[str, Any], reason: str) -> None:
    result = pipeline().solve([replace(edge_scene.view(), **change)], start())
    assert (result.status, result.reason) == (Status.NO_EDGES, reason)


def test_a_start_that_looks_away_is_refused_and_edges_behind_the_camera_are_named() -> None:
    view = edge_scene.view()
    result = pipeline().solve([view], se3.inverse(TRUTH) @ se3.exp(np.array([0, np.pi, 0, 0, 0, 0])))
    assert result.status in (Status.NO_EDGES, Status.TOO_FEW_MATCHES)
    behind = view.moved(se3.inverse(TRUTH) @ se3.make(translation=[0, 0, -100.0]) @ TRUTH)
    result = pipeline().solve([behind], TRUTH)
    assert result.status is Status.NO_EDGES
    assert "behind the camera" in result.reason


def test_too_few_pairs_is_a_status_that_counts_them_also_at_a_better_pose() -> None:
    view = edge_scene.view()
    few = replace(view, cloud=CloudFeatures(view.cloud_edges.select(np.arange(10))))
    result = pipeline(initializer=given).solve([few], start())
    assert result.status is Status.TOO_FEW_MATCHES
    assert "at least 30 are needed" in result.reason
    assert (result.accuracy, result.covariance) == (None, None)
    np.testing.assert_array_equal(result.camera_from_lidar, result.start)
    # A wrong start finds pairs far away; at the pose they lead to, hardly one is left.
    view = edge_scene.view(boxes=4, noise_px=6.0, seed=3)
    result = pipeline(initializer=given, min_matches=60).solve([view], start(1))
    assert result.status is Status.TOO_FEW_MATCHES
    assert any(turn.accepted for turn in result.rounds)
    np.testing.assert_array_equal(result.camera_from_lidar, result.start)


def test_edges_of_one_direction_at_one_depth_are_not_observable() -> None:
    depth = 10.0
    v = np.linspace(-1.5, 1.5, 200)
    points = np.column_stack([np.zeros(200), v, np.full(200, depth)])
    longer = np.column_stack([np.zeros(2000), np.linspace(-1.6, 1.6, 2000), np.full(2000, depth)])
    image = ImageEdges(edge_scene.PINHOLE.project(longer), np.full(2000, Side.LEFT))
    cloud = CloudEdges(points, np.full(200, Side.LEFT))
    view = View("pole", edge_scene.PINHOLE, ImageFeatures(image), CloudFeatures(cloud))
    result = pipeline(initializer=given).solve([view], se3.make(translation=[0.1, 0, 0]))
    assert result.status is Status.NOT_OBSERVABLE
    assert result.reason


def singular_at(*calls: int):
    """A solver that is `lm` but for these calls, in which it says that the pairs do not determine the roll."""
    solve, number = built(lm), itertools.count()

    def one(problem, pose):
        if next(number) in calls:
            return Solution(pose, 0.0, 1, SolverStatus.SINGULAR, None, "the pairs do not determine roll")
        return solve(problem, pose)

    return one


def test_a_better_pose_that_its_own_pairs_do_not_determine_is_refused_but_not_one_before_a_round_that_fails() -> None:
    result = replace(pipeline(initializer=given), solver=singular_at(1, 2)).solve([edge_scene.view()], start())
    assert (result.status, result.reason) == (Status.NOT_OBSERVABLE, "the pairs do not determine roll")
    assert result.rounds[0].accepted
    assert result.verdict.trust is Trust.REFUSED
    np.testing.assert_array_equal(result.camera_from_lidar, result.start)
    # A later round that fails does not take back a pose that its pairs determine.
    result = replace(pipeline(initializer=given), solver=singular_at(1)).solve([edge_scene.view()], start())
    assert result.status is Status.ROUNDS_SPENT
    assert result.reason == "the rounds ended early: the pairs do not determine roll"
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < pose_error(start(), TRUTH).rotation_deg


def test_without_directions_no_stage_profits_from_them() -> None:
    """The initializer, the matcher and the judge of an undirected run must not change when labels are scrambled."""
    view = edge_scene.view(noise_px=0.5)
    rng = np.random.default_rng(1)
    scrambled = replace(
        view,
        image=ImageFeatures(replace(view.image_edges, side=rng.permutation(view.image_edges.side))),
        cloud=CloudFeatures(replace(view.cloud_edges, side=rng.permutation(view.cloud_edges.side))),
    )
    undirected = pipeline(matcher=nearest, directed=False, camera="trust")
    poses = [undirected.solve([v.without_sides()], start()).camera_from_lidar for v in (view, scrambled)]
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)


def test_an_image_and_a_sweep_of_different_moments_are_called_doubtful_and_a_right_pair_is_not() -> None:
    """The edges of one place are matched with those of another: whatever pose comes out is flagged."""
    for seed in range(2):
        right, other = edge_scene.view(seed=seed), edge_scene.view(seed=seed + 10)
        good = pipeline().solve([right], start(seed))
        assert good.verdict == Verdict()
        assert good.agreement.odds_ratio > 100
        bad = pipeline().solve([replace(right, cloud=other.cloud)], start(seed))
        assert bad.verdict.trust in (Trust.DOUBTFUL, Trust.REFUSED)


def in_doubt(result: Result) -> bool:
    """Return whether the calibration of a camera is."""
    return any(reason.doubt is Doubt.CAMERA for reason in result.verdict.reasons)


@cache
def solved(views: Callable[[], list[View]], **options: object) -> Result:
    """The result on several views; it cannot be changed, so tests share it."""
    return pipeline(**options).solve(views(), start())


MISCALIBRATED = RadialError(-0.003, 0.02)


@cache
def wrongly_calibrated() -> list[View]:
    """Views whose camera lacks the distortion that the picture has."""
    true = MISCALIBRATED.corrected(edge_scene.PINHOLE)
    views = [edge_scene.view(true, seed=i, boxes=60, noise_px=0.3) for i in range(4)]
    return [replace(view, camera=edge_scene.PINHOLE) for view in views]


def test_a_wrong_calibration_of_the_camera_is_told() -> None:
    trusted = solved(wrongly_calibrated, camera="trust")
    checked = solved(wrongly_calibrated)
    assert trusted.cameras == ()
    assert not in_doubt(trusted)
    assert all(result.accuracy.rotation_deg >= 0.02 for result in (trusted, checked))
    assert np.array_equal(checked.camera_from_lidar, trusted.camera_from_lidar)
    (check,) = checked.cameras
    assert check.frames == 4
    assert not check.corrected
    assert check.radial == pytest.approx(MISCALIBRATED.radial, rel=0.3)
    assert in_doubt(checked)


def test_refining_the_camera_finds_its_error_and_a_better_pose() -> None:
    trusted = solved(wrongly_calibrated, camera="trust")
    refined = solved(wrongly_calibrated, camera="refine")
    (check,) = refined.cameras
    assert check.corrected
    better = RadialError(check.focal, check.radial).corrected(edge_scene.PINHOLE)
    assert refined.camera_of(edge_scene.PINHOLE) == check.better == better
    assert trusted.camera_of(edge_scene.PINHOLE) == edge_scene.PINHOLE
    assert check.focal == pytest.approx(MISCALIBRATED.focal, abs=2e-4)
    assert check.radial == pytest.approx(MISCALIBRATED.radial, abs=5e-4)
    before, after = (pose_error(result.camera_from_lidar, TRUTH) for result in (trusted, refined))
    assert after.rotation_deg < 0.02
    assert after.translation_m < 0.005
    assert after.translation_m < 0.5 * before.translation_m
    assert refined.directed_cost_px[1] < trusted.directed_cost_px[1]
    assert refined.accuracy.rotation_deg >= 0.02
    assert not in_doubt(refined)


@pytest.mark.parametrize(("camera", "noise_px", "shift_px"), [("check", 0.3, 0.3), ("refine", 0.0, 0.1)])
def test_a_right_camera_is_not_doubted_nor_changed_nor_the_pose(camera: str, noise_px: float, shift_px: float) -> None:
    views = [edge_scene.view(seed=i, boxes=60, noise_px=noise_px) for i in range(3)]
    result = pipeline(camera=camera).solve(views, start())
    assert result.cameras[0].shift_px < shift_px
    assert not in_doubt(result)
    assert pose_error(result.camera_from_lidar, TRUTH).translation_m < (0.005 if camera == "refine" else 0.02)


def as_measured(view: View, motion: EgoMotion) -> View:
    """The view of a LiDAR that turns ten times a second and moves, the picture taken 4 ms after straight ahead."""
    edges = view.cloud_edges
    time_s = -np.arctan2(edges.xyz[:, 1], edges.xyz[:, 0]) / (2 * np.pi) * 0.1 - 0.004
    xyz = moved(motion.twist, -time_s, edges.xyz)
    return replace(view, cloud=CloudFeatures(replace(edges, xyz=xyz, time_s=time_s)))


MOTIONS = [EgoMotion(speed, turn) for speed, turn in ((16.0, 0.0), (0.0, 0.0), (9.0, 0.15), (5.0, -0.1))]


@cache
def driven() -> list[View]:
    return [
        as_measured(edge_scene.view(seed=i, boxes=30, name=f"at {m.speed_m_s:g}"), m) for i, m in enumerate(MOTIONS)
    ]


def test_the_motion_of_the_car_is_found_along_with_the_pose() -> None:
    trusted = solved(driven, motion="trust", camera="trust")
    found = solved(driven)
    assert trusted.motions == ()
    assert trusted.twist_of("at 16") is None
    before, after = (pose_error(result.camera_from_lidar, TRUTH) for result in (trusted, found))
    assert after.translation_m < 0.01
    assert after.translation_m < 0.3 * before.translation_m
    assert after.rotation_deg < 0.03
    assert [motion.frame for motion in found.motions] == ["at 16", "at 0", "at 9", "at 5"]
    for motion, true in zip(found.motions, MOTIONS, strict=True):
        assert motion.speed_m_s == pytest.approx(true.speed_m_s, abs=1.0)
        assert motion.turn_deg_s == pytest.approx(np.degrees(true.turn_rad_s), abs=1.0)
        assert found.twist_of(motion.frame) == pytest.approx(motion.twist)
    assert found.directed_cost_px[1] < trusted.directed_cost_px[1]


def test_motion_of_the_car_does_not_look_like_a_wrong_camera() -> None:
    checked = solved(driven)
    refined = solved(driven, camera="refine")
    for result in (checked, refined):
        assert result.cameras[0].shift_px < 0.4
        assert pose_error(result.camera_from_lidar, TRUTH).translation_m < 0.01


@pytest.mark.parametrize("seed", range(2))
def test_motion_is_taken_only_where_the_edges_fit_better_with_it(seed: int) -> None:
    view = as_measured(edge_scene.view(seed=seed, boxes=8, noise_px=1.5), EgoMotion())
    estimated, trusted = (
        pipeline(motion=word, speed_m_s=0.0, camera="trust").solve([view], start(seed))
        for word in ("estimate", "trust")
    )
    assert estimated.directed_cost_px[1] <= trusted.directed_cost_px[1]
    if not np.array_equal(estimated.camera_from_lidar, trusted.camera_from_lidar):
        assert estimated.directed_cost_px[1] < trusted.directed_cost_px[1]
        assert estimated.rounds[len(trusted.rounds)].stage == "adjust"
    else:
        assert estimated.motions[0].speed_m_s == 0.0


def test_too_few_pairs_leave_the_motion_as_it_is_expected() -> None:
    rows = np.arange(0, len(driven()[1].cloud_edges), 30)
    view = driven()[1]
    few = replace(view, cloud=CloudFeatures(view.cloud_edges.select(rows)))
    result = pipeline(speed_m_s=1.0, speed_sigma_m_s=2.0).solve([few], start(0, 0.5))
    (motion,) = result.motions
    assert (motion.speed_m_s, motion.speed_sigma, motion.turn_deg_s) == pytest.approx((1.0, 2.0, 0.0))


def test_the_direction_of_travel_is_an_option() -> None:
    sideways = EgoMotion(12.0, 0.0, (0.0, 1.0, 0.0))
    views = [as_measured(edge_scene.view(seed=i, boxes=30), sideways) for i in range(2)]
    views.append(edge_scene.view(seed=9, boxes=30, name="corrected"))  # has no motion to find
    result = pipeline(forward=(0, 1, 0), camera="trust").solve(views, start())
    assert [motion.speed_m_s for motion in result.motions] == pytest.approx([12.0, 12.0], abs=1.0)
    assert result.motions[0].twist[4] == pytest.approx(12.0, abs=1.0)
    for way in ((0, 0, 0), (1, float("nan"), 0), (1, 0)):
        with pytest.raises(ValueError, match="forward"):
            PipelineOptions(forward=way)


def test_the_predicted_error_by_axis_contains_what_a_wrong_focal_length_did_to_the_pose() -> None:
    true = RadialError(focal=0.03).corrected(edge_scene.PINHOLE)
    views = [edge_scene.view(true, seed=i, boxes=60, noise_px=0.5) for i in range(3)]
    result = pipeline().solve([replace(view, camera=edge_scene.PINHOLE) for view in views], start())
    error, accuracy = pose_error(result.camera_from_lidar, TRUTH), result.accuracy
    assert result.cameras[0].wrong == ("focal length",)
    assert accuracy.z_m == pytest.approx(abs(error.per_axis["z_m"]), rel=0.3)
    assert accuracy.translation_m == pytest.approx(np.linalg.norm([accuracy.x_m, accuracy.y_m, accuracy.z_m]))
    assert deviations(result.covariance, result.camera_from_lidar)[1] == pytest.approx(accuracy.translation_m)


def test_a_matcher_without_pairs_tells_nothing_of_the_camera() -> None:
    def match(views, pose, reach_px):
        return built(ogm)(views, pose, reach_px).as_objective()

    begin = start(0, 0.2)
    result = replace(pipeline(solver=nelder_mead, initializer=given, camera="refine"), matcher=match).solve(
        [edge_scene.view()], begin
    )
    # The pose is found by the objective alone ...
    assert result.status.solved
    before, after = (pose_error(pose, TRUTH) for pose in (begin, result.camera_from_lidar))
    assert after.rotation_deg < 0.01 < before.rotation_deg
    assert after.translation_m < 0.01 < before.translation_m
    assert result.directed_cost_px[1] < result.directed_cost_px[0]
    # ... and what only pairs tell stays untold.
    assert (result.cameras, result.motions, result.matches) == ((), (), {})
    assert (result.accuracy, result.covariance) == (None, None)


def test_a_result_says_how_wrong_it_may_be() -> None:
    # Edges at random off their place: one frame, four of the same kind, and one that is sharper.
    views = [edge_scene.view(seed=i, noise_px=1.5, boxes=25) for i in range(4)]
    one, four = (pipeline(camera="trust").solve(chosen, start()) for chosen in (views[:1], views))
    sharp = pipeline(camera="trust").solve([edge_scene.view(seed=0, noise_px=0.3, boxes=25)], start())
    for better in (four, sharp):
        assert better.accuracy.rotation_deg < one.accuracy.rotation_deg
        # The width of beams is common to all frames.
        assert better.accuracy.translation_m < 1.2 * one.accuracy.translation_m
    for result in (one, four, sharp):
        predicted = (result.accuracy.rotation_deg, result.accuracy.translation_m)
        assert deviations(result.covariance, result.camera_from_lidar) == pytest.approx(predicted)
        error = pose_error(result.camera_from_lidar, TRUTH)
        assert error.rotation_deg < result.accuracy.rotation_deg_95
        assert error.translation_m < result.accuracy.translation_m_95
        assert np.linalg.eigvalsh(result.covariance).min() > 0


def test_pairs_from_a_handful_of_places_do_not_tell_the_accuracy() -> None:
    # One box: four outlines, so that four places are all that there is.
    view = edge_scene.view(boxes=1)
    near = replace(pipeline(initializer=given, min_matches=6), solver=lambda problem, pose: Solution(TRUTH, 0.0, 1))
    result = near.solve([view], start(0, 0.2))
    assert result.status.solved
    assert result.accuracy is None


def test_a_scene_that_fits_in_two_places_is_called_ambiguous_and_a_clear_one_is_not() -> None:
    # The same outlines twice, three degrees apart: which of the two the sweep belongs to cannot be told.
    away = se3.exp(np.array([0.0, np.radians(3.0), 0.0, 0, 0, 0]))
    view = edge_scene.view(boxes=12, seed=4)
    edges, camera = view.image_edges, view.camera
    turned = camera.project(camera.rays(edges.uv) @ away[:3, :3].T)
    twice = ImageEdges(np.vstack([edges.uv, turned]), np.concatenate([edges.side, edges.side]))
    view = replace(view, image=ImageFeatures(twice))
    plan = replace(pipeline(camera="trust"), initializer=lambda views, start: [TRUTH, away @ TRUTH])
    result = plan.solve([view], start(0, 1.0))
    assert (result.rival.unit, result.rival.lead < 1.5) == ("edges", True)
    assert result.rival.rotation_deg == pytest.approx(3.0, abs=0.1)
    assert result.verdict.trust is Trust.AMBIGUOUS
    # However sharp the edges: which place is right cannot be told, and the predicted error contains both.
    assert result.accuracy.rotation_deg > 1.0
    assert not result.reaches(1.5, 1.0)
    plan = replace(pipeline(), initializer=lambda views, start: [away @ TRUTH, TRUTH])
    result = plan.solve([edge_scene.view()], start(0, 1.0))
    assert pose_error(result.camera_from_lidar, TRUTH).rotation_deg < 0.02
    assert result.verdict.trusted
    assert result.rival is None or result.rival.lead > 10


TWISTS = [np.array([0, 0, turn, speed, 0, 0]) for speed, turn in ((15.0, 0.0), (2.0, 0.1), (9.0, -0.1), (6.0, 0.0))]
LATER_S = 0.015


@cache
def told_too_early() -> list[View]:
    """Views of four speeds whose sweeps are corrected to a moment 15 ms before the picture was taken."""
    views = [edge_scene.view(seed=i, boxes=30, name=f"{t[3]:g}") for i, t in enumerate(TWISTS)]
    return [replace(v.moved(pose_at(t, LATER_S)), twist=t) for v, t in zip(views, TWISTS, strict=True)]


def test_an_offset_in_time_is_found_along_with_the_pose_and_used() -> None:
    trusted, found = (solved(told_too_early, time=word, camera="trust") for word in ("trust", "estimate"))
    assert trusted.time is None
    assert trusted.later_s == 0.0
    assert found.time.used
    assert found.later_s == found.time.offset_s == pytest.approx(LATER_S, abs=1e-3)
    assert found.time.sigma_s < 2e-3
    before, after = (pose_error(result.camera_from_lidar, TRUTH) for result in (trusted, found))
    assert before.translation_m > 0.05
    assert after.translation_m < 0.01
    assert found.directed_cost_px[1] < trusted.directed_cost_px[1]


def test_frames_that_are_of_one_moment_keep_their_pose_and_raw_sweeps_tell_no_offset() -> None:
    views = [replace(edge_scene.view(seed=i, boxes=30), twist=t) for i, t in enumerate(TWISTS)]
    trusted, asked = (pipeline(time=word, camera="trust").solve(views, start()) for word in ("trust", "estimate"))
    assert abs(asked.time.offset_s) < 5e-4
    assert not asked.time.used
    assert np.array_equal(asked.camera_from_lidar, trusted.camera_from_lidar)
    assert np.array_equal(asked.covariance, trusted.covariance)
    solve = pipeline(time="estimate", camera="trust", initializer=given).solve
    assert solve([replace(v, twist=t) for v, t in zip(driven(), TWISTS, strict=True)], start()).time is None


def test_rings_that_are_far_apart_are_calibrated_by_their_intervals_and_the_result_is_trusted() -> None:
    """By three views of a LiDAR whose rings are 1.7 deg apart."""
    views = [sparse_view(seed) for seed in range(3)]
    result, by_middle = (pipeline(interval_deg=angle).solve(views, start()) for angle in (0.75, 90.0))
    assert (result.judged.judge, by_middle.judged.judge) == (INTERVALS, DIRECTED)
    error = pose_error(result.camera_from_lidar, TRUTH)
    assert error.rotation_deg < 0.15
    assert error.translation_m < 0.04
    assert error.translation_m < 0.5 * pose_error(by_middle.camera_from_lidar, TRUTH).translation_m
    assert any(record.stage == "interval-likelihood" for record in result.rounds)
    assert result.verdict.trusted
    assert error.rotation_deg < result.accuracy.rotation_deg_95 < 0.7
    assert error.translation_m < result.accuracy.translation_m_95 < 0.2


def test_dense_rings_give_the_same_bytes_with_and_without_the_option_and_no_edge_without_direction_is_an_interval() -> (
    None
):
    view = sparse_view(0, 0.4)
    results = [pipeline(interval_deg=angle).solve([view], start()) for angle in (0.75, 90.0)]
    np.testing.assert_array_equal(results[0].camera_from_lidar, results[1].camera_from_lidar)
    assert results[0].accuracy == results[1].accuracy
    view = sparse_view(0).without_sides()
    result = pipeline(directed=False, matcher=nearest).solve([view], start())
    assert result.judged is None or result.judged.judge == DIRECTED
