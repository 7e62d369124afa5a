"""The dataset `synthetic`: exact truth that holds between its own image, depth, right image and sweep."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from p2o import Frame, InputError, se3
from p2o.geometry.perturb import parse_perturbation
from p2o_sim import synthetic
from p2o_sim.synthetic import BASELINE_M, SyntheticOptions, View, build, camera_from_lidar, camera_of, view
from p2o_sim.world.scene import Class
from pydantic import ValidationError
from scipy import ndimage

SIZE: dict[str, Any] = {"width_px": 310, "height_px": 94}
HALF: dict[str, Any] = {"width_px": 621, "height_px": 188}
SMALL: dict[str, Any] = {"width_px": 160, "height_px": 64, "lidar": "vlp-16", "right": False}
STREET: dict[str, Any] = {**SMALL, "place": "street", "right": True}
STILL: dict[str, Any] = {"noise_m": 0.0, "angle_noise_deg": 0.0, "divergence_mrad": 0.0}
CLEAN: dict[str, Any] = {"grain": 0.0, "blur_px": 0.0, "vignetting": 0.0, "jpeg_quality": 0, "exposure_ev": 0.0}


@cache
def _frame(**options: Any) -> Frame:
    """One frame, a quarter as wide as KITTI's; frames cannot be changed, so tests may share them."""
    return build(SyntheticOptions(**{**SIZE, **options}))[0]


@cache
def _drive(**options: Any) -> list[Frame]:
    """The small frames of a drive on uneven ground."""
    return list(build(SyntheticOptions(**{**SMALL, **DRIVE}, **options)))


@pytest.fixture(autouse=True, scope="module")
def _scenes_are_kept() -> Iterator[None]:
    """Keep more scenes than the last two: most tests here look at one of a few."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "_drive", lru_cache(maxsize=8)(synthetic._drive.__wrapped__))
        yield


def _depth_errors(frame: Frame, camera_from_lidar: np.ndarray, least_points: int = 2000) -> np.ndarray:
    """Return |z - depth| of projected points, depth interpolated (1/depth is linear on planes), away from edges."""
    xyz = se3.apply(camera_from_lidar, frame.cloud.xyz)
    uv = frame.camera.project(xyz)
    inner = frame.camera.in_image(uv, margin_px=-3.0)
    uv, z = uv[inner], xyz[inner, 2]
    inverse = 1 / frame.image.depth_m
    most, least = (f(inverse, size=5) for f in (ndimage.maximum_filter, ndimage.minimum_filter))
    smooth = ndimage.map_coordinates((most - least < 0.15 * least).astype(float), uv[:, ::-1].T, order=0) > 0
    assert smooth.sum() > least_points
    return np.abs(z[smooth] - 1 / ndimage.map_coordinates(inverse, uv[smooth, ::-1].T, order=1))


@pytest.mark.parametrize(
    "options",
    [
        *({"camera": camera, "place": "street", **HALF} for camera in ("pinhole", "opencv-distorted", "fisheye")),
        *({"place": place, "lidar": "os1-64"} for place in ("hall", "room")),
    ],
    ids=str,
)
def test_a_sweep_without_noise_agrees_with_the_depth_map_at_the_true_pose(options: dict[str, Any]) -> None:
    frame = _frame(**options, **STILL)
    errors = _depth_errors(frame, frame.camera_from_lidar)
    assert np.median(errors) < 1e-3
    assert not np.isnan(frame.image.depth_m).any()
    wrong = se3.exp(np.radians([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])) @ frame.camera_from_lidar
    assert np.median(_depth_errors(frame, wrong)) > 5e-3
    if options["place"] == "street":
        assert np.percentile(errors, 90) < 0.02


def test_the_truth_is_the_documented_rig() -> None:
    truth = camera_from_lidar()
    np.testing.assert_allclose(se3.apply(se3.inverse(truth), np.zeros((1, 3)))[0], [0.27, 0.06, -0.08], atol=1e-12)
    forward = truth[:3, :3] @ [1.0, 0.0, 0.0]
    tilt = se3.make(truth[:3, :3] @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T)
    assert se3.angle_deg(tilt) == pytest.approx(0.85, abs=0.01)
    assert forward[2] > 0.99


def test_the_right_picture_shows_the_same_surfaces_at_the_disparity_of_their_depth() -> None:
    frame = _frame(place="street", **HALF, **CLEAN)
    image = frame.image
    focal = frame.camera.params[0]
    v, u = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
    disparity = focal * BASELINE_M / image.depth_m
    flat = ndimage.maximum_filter(disparity, 5) - ndimage.minimum_filter(disparity, 5) < 1.0
    inside = flat & np.isfinite(image.depth_m) & (u - disparity > 4) & (disparity > 2)
    left, right = (p.mean(axis=2)[inside] if p is image.rgb else p.mean(axis=2) for p in (image.rgb, image.right))

    def likeness(shift: float) -> float:
        seen = ndimage.map_coordinates(
            right, [v[inside], u[inside] - disparity[inside] - shift], order=1, mode="nearest"
        )
        return float(np.corrcoef(seen, left)[0, 1])

    assert image.baseline_m == BASELINE_M
    assert likeness(0.0) > 0.95
    assert likeness(0.0) > likeness(2.0)
    assert likeness(0.0) > likeness(-2.0)


def _bytes(frame: Frame) -> tuple[bytes, ...]:
    image = frame.image
    return tuple(a.tobytes() for a in (image.rgb, image.right, image.depth_m, frame.cloud.xyz, frame.start))


def test_the_same_options_give_the_same_bytes_and_another_seed_or_scene_others() -> None:
    first = _bytes(build(SyntheticOptions(scenes=2, **STREET))[0])
    synthetic._drive.cache_clear()
    again = _bytes(build(SyntheticOptions(scenes=2, **STREET))[0])
    other_scene = _bytes(build(SyntheticOptions(scenes=2, **STREET))[1])
    other_seed = _bytes(build(SyntheticOptions(seed=1, **STREET))[0])
    assert first == again
    assert all(a != b for a, b in zip(first[:4], other_scene[:4], strict=True))
    assert all(a != b for a, b in zip(first, other_seed, strict=True))


def test_noise_and_camera_leave_the_place_as_it_is() -> None:
    quiet, noisy = (_frame(**{**CLEAN, **STILL, "right": False, "noise_m": noise}) for noise in (0.0, 0.05))
    assert quiet.image.rgb.tobytes() == noisy.image.rgb.tobytes()
    assert np.linalg.norm(quiet.cloud.xyz - noisy.cloud.xyz, axis=1).std() > 0.01
    fisheye = _frame(**{**CLEAN, **STILL, "right": False, "camera": "fisheye"})
    assert fisheye.cloud.xyz.tobytes() == quiet.cloud.xyz.tobytes()


def test_frames_of_a_drive_show_one_place_from_a_moving_car() -> None:
    options = SyntheticOptions(frames_per_scene=3, scenes=2, speed_m_s=10.0, place="street", **SMALL)
    dataset = build(options)
    assert dataset.names[:4] == ("scene-0000/0000", "scene-0000/0001", "scene-0000/0002", "scene-0001/0000")
    views = [view(options, 0, number) for number in range(3)]
    assert views[0].scene is views[2].scene
    places = np.stack([v.moment.world_from_lidar[:3, 3] for v in views])
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), 1.0, atol=0.3)
    assert not np.array_equal(views[0].frame.image.depth_m, views[1].frame.image.depth_m)


def test_the_mounting_slips_exactly_at_its_frame_by_exactly_its_size() -> None:
    dataset = build(SyntheticOptions(frames_per_scene=4, drift_at_frame=2, drift="1deg 0.05m", place="room", **SMALL))
    truths = [frame.camera_from_lidar for frame in dataset]
    np.testing.assert_array_equal(truths[0], truths[1])
    np.testing.assert_array_equal(truths[2], truths[3])
    slip = se3.inverse(truths[1]) @ truths[2]
    assert se3.angle_deg(slip) == pytest.approx(1.0)
    assert se3.distance_m(slip) == pytest.approx(0.05)


@pytest.mark.parametrize("size", ["2deg 0.15m", "0deg 0m"])
def test_the_start_is_wrong_by_exactly_its_size(size: str) -> None:
    frame = build(SyntheticOptions(start_error=size, **SMALL))[0]
    off = se3.inverse(frame.camera_from_lidar) @ frame.start
    wanted = parse_perturbation(size)
    assert se3.angle_deg(off) == pytest.approx(wanted.angle_deg, abs=1e-6)
    assert se3.distance_m(off) == pytest.approx(wanted.distance_m, abs=1e-9)


YARD: dict[str, Any] = {"place": "yard", "width_px": 621, "height_px": 240, "right": False, "lidar": "vlp-16"}
LIT: dict[str, Any] = {"exposure_ev": -0.5, "grain": 1.0, "jpeg_quality": 0}


def _corners(seen: View) -> np.ndarray:
    """Return the true pixels (N, 2) of the corners of the first board."""
    board = seen.boards[0]
    lidar_from_board = se3.inverse(seen.moment.world_from_lidar) @ board.world_from_board
    frame = seen.frame
    return frame.camera.project(se3.apply(frame.camera_from_lidar @ lidar_from_board, board.target.corners))


@pytest.mark.parametrize(("holder", "number"), [("person", 0), ("person", 1), ("stand", 2)])
def test_a_detector_finds_the_corners_of_the_board_where_its_true_pose_puts_them(holder: str, number: int) -> None:
    import cv2

    options = SyntheticOptions(targets="checkerboard", holder=holder, frames_per_scene=3, **YARD, **LIT)
    seen = view(options, 0, number)
    board = seen.frame.targets[0]
    grey = cv2.cvtColor(seen.frame.image.rgb, cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCornersSB(
        grey, (board.columns, board.rows), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    assert found
    true = _corners(seen)
    # The detector may count from the other end.
    off = min((c - true for c in (corners.reshape(-1, 2), corners.reshape(-1, 2)[::-1])), key=np.linalg.norm)
    assert np.linalg.norm(off, axis=1).max() < 1 / 3
    assert np.abs(off.mean(axis=0)).max() < 0.1


def test_the_board_stands_elsewhere_in_each_frame_of_a_car_that_stands() -> None:
    options = SyntheticOptions(targets="checkerboard", frames_per_scene=3, **{**YARD, **SMALL})
    views = [view(options, 0, number) for number in range(3)]
    places = np.array([v.boards[0].centre for v in views])
    assert min(np.linalg.norm(places[a] - places[b]) for a, b in ((0, 1), (0, 2), (1, 2))) > 0.1
    for seen in views:
        np.testing.assert_array_equal(seen.moment.world_from_lidar, views[0].moment.world_from_lidar)
        np.testing.assert_array_equal(seen.frame.twist, np.zeros(6))


def test_several_boards_stand_apart_and_each_is_in_the_frame() -> None:
    options = SyntheticOptions(targets="holes", board="a1", boards=3, holder="stand", **YARD)
    seen = view(options, 0)
    assert len(seen.frame.targets) == len(seen.boards) == 3
    shown = np.unique(seen.rendered.instance[seen.rendered.classes == Class.BOARD])
    assert len(shown) == 3
    across = np.sort([board.centre[1] for board in seen.boards])
    assert np.diff(across).min() > 0.8


def test_the_true_mounting_shows_in_the_picture_and_nowhere_else() -> None:
    tilted = (0.35, 0.0, -0.12, 1.5, 0.5, -1.0)
    drive = {"frames_per_scene": 2, "speed_m_s": 3.0, "swing_deg": 20.0, "tilt_deg": 3.0}
    options = {**YARD, **SMALL, **drive, "targets": "checkerboard"}
    one, other = (view(SyntheticOptions(**options, **mount), 0, 1) for mount in ({}, {"mount": tilted}))
    assert one.frame.targets == other.frame.targets
    assert one.boards[0].world_from_board.tobytes() == other.boards[0].world_from_board.tobytes()
    np.testing.assert_allclose(se3.inverse(other.frame.camera_from_lidar)[:3, 3], tilted[:3], atol=1e-12)
    for name in ("lidar_world_from_lidar", "twist"):
        assert getattr(one.frame, name).tobytes() == getattr(other.frame, name).tobytes()
    assert (one.frame.sequence, one.frame.time_s) == (other.frame.sequence, other.frame.time_s)
    assert one.frame.cloud.xyz.tobytes() == other.frame.cloud.xyz.tobytes()
    assert not np.array_equal(one.frame.image.rgb, other.frame.image.rgb)


DRIVE: dict[str, Any] = {
    "frames_per_scene": 5, "place": "yard", "speed_m_s": 2.5, "period_s": 1.0, "swing_deg": 30.0, "tilt_deg": 4.0,
    "right": True,
}  # fmt: skip


def _steps(frames: list[Frame], name: str) -> list[np.ndarray]:
    """Return the motion from each frame to the next in the frame of the sensor."""
    poses = [getattr(frame, name) for frame in frames]
    return [se3.inverse(a) @ b for a, b in pairwise(poses)]


def test_the_poses_of_both_sensors_tell_the_mounting_by_how_they_move_and_only_so() -> None:
    frames = _drive()
    assert [frame.sequence for frame in frames] == ["scene-0000"] * 5
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])
    # Each world begins at its own sensor, so the first pose says nothing of the other.
    np.testing.assert_array_equal(frames[0].lidar_world_from_lidar, np.eye(4))
    np.testing.assert_array_equal(frames[0].camera_world_from_camera, np.eye(4))
    truth = frames[0].camera_from_lidar
    moves = _steps(frames, "lidar_world_from_lidar")
    for lidar, camera in zip(moves, _steps(frames, "camera_world_from_camera"), strict=True):
        np.testing.assert_allclose(camera @ truth, truth @ lidar, atol=1e-9)
    # Turns about more than one axis: without them the mounting would be open along that one.
    turns = np.degrees([se3.rotation_vector(move[:3, :3]) for move in moves])
    assert np.linalg.svd(turns)[1][1] > 4.0
    assert np.linalg.norm(turns, axis=1).max() > 15.0


def test_the_odometry_of_the_camera_shows_the_mounting_slip_and_that_of_the_lidar_does_not() -> None:
    slipped = {"drift_at_frame": 2, "drift": "1deg 0.05m"}
    straight, slips = (_drive(**options) for options in ({}, slipped))

    def added_deg(name: str) -> list[float]:
        pairs = zip(_steps(straight, name)[:2], _steps(slips, name)[:2], strict=True)
        return [se3.angle_deg(se3.inverse(a) @ b) for a, b in pairs]

    assert added_deg("lidar_world_from_lidar") == pytest.approx([0.0, 0.0], abs=1e-6)
    assert added_deg("camera_world_from_camera") == pytest.approx([0.0, 1.0], abs=1e-6)


def test_noise_of_the_odometry_is_that_of_its_steps_and_leaves_all_else_as_it_is() -> None:
    noise = {"odometry_noise_deg": 0.2, "odometry_noise_m": 0.05}
    exact, noisy = (_drive(**options) for options in ({}, noise))
    for name in ("lidar_world_from_lidar", "camera_world_from_camera"):
        errors = [se3.inverse(a) @ b for a, b in zip(_steps(exact, name), _steps(noisy, name), strict=True)]
        assert 0.05 < np.median([se3.angle_deg(error) for error in errors]) < 1.0
        assert 0.01 < np.median([se3.distance_m(error) for error in errors]) < 0.25
    for a, b in zip(exact, noisy, strict=True):
        assert _bytes(a) == _bytes(b)
        assert a.twist.tobytes() == b.twist.tobytes()


def test_a_frame_that_stands_alone_has_no_sequence_and_no_targets_unless_asked() -> None:
    frame = _frame()
    assert (frame.sequence, frame.time_s, frame.targets) == ("", None, ())
    assert frame.lidar_world_from_lidar is None
    assert frame.camera_world_from_camera is None


def test_foliage_is_masked_on_request_and_only_foliage() -> None:
    options = SyntheticOptions(mask_foliage=True, place="trees", **SMALL)
    seen = view(options, 0)
    np.testing.assert_array_equal(seen.frame.image.masked, seen.rendered.foliage)
    assert 0.1 < seen.rendered.foliage.mean() < 0.95
    assert _frame().image.masked is None


@pytest.mark.parametrize(
    ("camera", "focal_px"), [("pinhole", 110.0), ("pinhole", 600.0), ("opencv-distorted", 600.0), ("fisheye", 110.0)]
)
def test_a_given_focal_length_is_that_of_the_picture_whatever_its_width(camera: str, focal_px: float) -> None:
    frame = _frame(camera=camera, focal_px=focal_px, place="street", **STILL)
    ahead = np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0]])
    here, beside = frame.camera.project(ahead)
    assert (beside - here)[0] / 0.01 == pytest.approx(focal_px, rel=1e-3)
    assert frame.camera.focal_px == pytest.approx(focal_px, rel=1e-3)
    errors = _depth_errors(frame, frame.camera_from_lidar, 500)
    assert np.median(errors) < 2e-3
    assert (frame.image.right is not None) == (camera == "pinhole")


@pytest.mark.parametrize("place", ["hall", "room"])
def test_in_a_building_the_rig_is_slow_and_low_unless_told(place: str) -> None:
    seen = [view(SyntheticOptions(place=place, scenes=3, **SMALL), number) for number in range(3)]
    heights = [v.moment.world_from_lidar[2, 3] for v in seen]
    assert 0.5 < min(heights) < max(heights) < 1.5
    assert np.linalg.norm(seen[0].moment.twist[3:]) == pytest.approx({"hall": 1.0, "room": 0.5}[place])
    told = view(SyntheticOptions(place=place, speed_m_s=2.0, lidar_height_m=1.9, sway=0.0, **SMALL), 0)
    assert told.moment.world_from_lidar[2, 3] == pytest.approx(1.9)
    assert np.linalg.norm(told.moment.twist[3:]) == pytest.approx(2.0)


RANDOM: dict[str, Any] = {"rig": "random-rings", "megapixels": 0.03, "scenes": 2, "place": "anywhere", "weather": "any"}


def test_each_scene_of_random_rigs_has_its_own_one_and_a_start_as_wrong_as_asked() -> None:
    frames = list(build(SyntheticOptions(**RANDOM, start_error="3deg 0.2m")))
    assert len({frame.camera for frame in frames}) == 2
    assert len({frame.camera_from_lidar.tobytes() for frame in frames}) == 2
    off = [se3.inverse(frame.camera_from_lidar) @ frame.start for frame in frames]
    assert [se3.angle_deg(error) for error in off] == pytest.approx([3.0] * 2, abs=1e-6)
    assert [se3.distance_m(error) for error in off] == pytest.approx([0.2] * 2, abs=1e-9)
    assert se3.angle_deg(se3.inverse(off[0]) @ off[1]) > 0.1
    again = build(SyntheticOptions(**RANDOM, start_error="3deg 0.2m"))[1]
    assert again.cloud.xyz.tobytes() == frames[1].cloud.xyz.tobytes()


def test_a_random_rig_sees_in_its_sweep_what_its_depth_map_says() -> None:
    options = SyntheticOptions(rig="random-rings", megapixels=0.05, place="room", speed_m_s=0.0, **STILL)
    frame = view(options, 1).frame
    assert np.median(_depth_errors(frame, frame.camera_from_lidar, 100)) < 2e-3


@pytest.mark.parametrize(
    "camera", [{}, {"focal_px": 400.0}, {"camera": "opencv-distorted"}, {"camera": "fisheye", "focal_px": 200.0}]
)
def test_megapixels_reduce_image_and_focal_length_of_all_cameras_of_a_fixed_rig(camera: dict[str, Any]) -> None:
    full = SyntheticOptions(**(STILL | {"width_px": 640, "height_px": 160, "place": "room", "speed_m_s": 0.0} | camera))
    small = full.model_copy(update={"megapixels": 0.0256, "cameras": ("front", "left"), "right": False})
    points = np.random.default_rng(0).uniform([-2, -0.5, 5], [2, 0.5, 9], (20, 3))
    expected = (camera_of(full).project(points) + 0.5) / 2 - 0.5
    for frame in build(small):
        assert frame.image.rgb.shape == (80, 320, 3)
        np.testing.assert_allclose(frame.camera.project(points), expected, atol=1e-6)
        assert np.median(_depth_errors(frame, frame.camera_from_lidar, 100)) < 2e-3


def test_megapixels_enlarge_no_image_and_bound_the_memory_of_a_fixed_rig() -> None:
    options = SyntheticOptions(**SMALL, megapixels=1)
    assert view(options, 0).frame.camera == camera_of(options)
    assert len(build(SyntheticOptions(width_px=8192, height_px=8192, megapixels=1))) == 1


def test_frames_of_a_drive_share_the_random_rig_of_their_scene() -> None:
    options = SyntheticOptions(rig="random", frames_per_scene=2, megapixels=0.05, place="yard", scenes=2)
    frames = list(build(options))
    for first, second in (frames[:2], frames[2:]):
        assert first.camera == second.camera
        assert first.start.tobytes() == second.start.tobytes()
        step = se3.inverse(first.camera_world_from_camera) @ second.camera_world_from_camera
        moved = se3.inverse(first.lidar_world_from_lidar) @ second.lidar_world_from_lidar
        np.testing.assert_allclose(step @ first.camera_from_lidar, first.camera_from_lidar @ moved, atol=1e-9)
    assert frames[0].camera != frames[2].camera


@pytest.mark.parametrize(
    "wrong",
    [
        {"targets": "cube"},
        {"noise_m": -0.1},
        {"weather": "hail"},
        {"megapixels": 0},
        {"colour": "red"},
        {"place": "moon"},
        {"seed": 10**40},
        {"mount": (1e300, 0, 0, 0, 0, 0)},
        {"mount": (0, 0, 0, 1e9, 0, 0)},
        {"scenes": 10**9},
        *({"lidar_at": place} for place in ("1,2,3", "0,0,0,0,0,400", "a,0,0,0,0,0")),
    ],
)
def test_options_out_of_bounds_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        SyntheticOptions(**wrong)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(
            ({"sweep_s": 2.0, **lidar}, r"sweep_s: the duration .* expected lidar=mid-40, avia or mid-360")
            for lidar in ({"lidar": "vlp-16"}, {"lidar": "mid-40", "rig": "random"})
        ),
        ({"frames_per_scene": 4, "drift_at_frame": 4}, "changes after the end of the drive"),
        ({"targets": "checkerboard", "swing_deg": 20.0}, "does not turn"),
        ({"rig": "random", "targets": "holes"}, "may not observe the boards"),
        ({"cameras": ("left", "left")}, "named twice"),
        ({"scenes": 1000, "frames_per_scene": 1000}, "too many frames"),
        ({"width_px": 8192, "height_px": 8192}, "would take too much memory; expected at most 1500 MB"),
        ({"frames_per_scene": 1000, "speed_m_s": 60, "period_s": 60}, "would take too much memory"),
    ],
)
def test_options_that_contradict_each_other_or_fill_the_memory_are_refused_before_a_frame_is_made(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        build(SyntheticOptions(**options))


RIG: dict[str, Any] = {**SMALL, "cameras": "front,left", "frames_per_scene": 2, "period_s": 1.0}


def test_cameras_of_a_rig_see_one_sweep_from_a_mounting_turned_about_the_lidar() -> None:
    dataset = build(SyntheticOptions(**RIG))
    assert dataset.names == (
        "scene-0000/0000/front",
        "scene-0000/0000/left",
        "scene-0000/0001/front",
        "scene-0000/0001/left",
    )
    front, left = dataset[0], dataset[1]
    assert (front.camera_name, left.camera_name) == ("front", "left")
    np.testing.assert_array_equal(front.cloud.xyz, left.cloud.xyz)
    assert front.time_s == left.time_s
    np.testing.assert_allclose(front.camera_from_lidar, camera_from_lidar(), atol=1e-15)
    # The left camera looks 60 degrees to the left of where the front one looks.
    np.testing.assert_allclose(
        se3.apply(left.camera_from_lidar, np.array([[2.5, 2.5 * 3**0.5, 0]])),
        se3.apply(front.camera_from_lidar, np.array([[5.0, 0, 0]])),
        atol=1e-9,
    )
    for frame in (front, left):
        assert np.median(_depth_errors(frame, frame.camera_from_lidar, 200)) < 0.05
    # One LiDAR that is off: both starts are wrong by the same step in its frame.
    off = [se3.inverse(frame.camera_from_lidar) @ frame.start for frame in (front, left)]
    np.testing.assert_allclose(off[0], off[1], atol=1e-9)


def test_a_rig_of_one_camera_is_the_same_picture_under_another_name() -> None:
    alone, named = (
        build(SyntheticOptions(**{**SMALL, "grain": 0.0}, **more))[0] for more in ({}, {"cameras": "front"})
    )
    np.testing.assert_array_equal(alone.image.rgb, named.image.rgb)
    assert (alone.camera_name, named.camera_name, named.name) == ("", "front", "scene-0000/front")


PLACE = (-0.8, 0.6, -0.3, 10.0, -5.0, 70.0)


def test_another_place_of_the_lidar_changes_the_sweep_and_the_truth_only() -> None:
    options: dict[str, Any] = {**SMALL, "place": "street", "noise_m": 0.0}
    nominal, moved = build(SyntheticOptions(**options))[0], build(SyntheticOptions(**options, lidar_at=PLACE))[0]
    assert nominal.image.rgb.tobytes() == moved.image.rgb.tobytes()
    assert nominal.image.depth_m.tobytes() == moved.image.depth_m.tobytes()
    body_from_lidar = synthetic.body_from_lidar(SyntheticOptions(lidar_at=PLACE))
    np.testing.assert_allclose(body_from_lidar[:3, 3], PLACE[:3])
    # Yaw, then pitch, then roll, about fixed axes in reverse order: the x axis of the LiDAR turns to the left, and up.
    np.testing.assert_allclose(
        body_from_lidar[:3, 0],
        [np.cos(np.radians(5)) * np.cos(np.radians(70)), np.cos(np.radians(5)) * np.sin(np.radians(70)),
         np.sin(np.radians(5))],
    )  # fmt: skip
    np.testing.assert_allclose(moved.camera_from_lidar, nominal.camera_from_lidar @ body_from_lidar, atol=1e-12)
    # The car drives at 8 m/s: the sweep is compensated for the velocity of the LiDAR at its own place.
    assert np.median(_depth_errors(moved, moved.camera_from_lidar, 100)) < 0.05
    raw = build(SyntheticOptions(**options, lidar_at=PLACE, deskew=False))[0]
    np.testing.assert_array_equal(raw.cloud.untwisted(raw.twist).xyz, moved.cloud.xyz)


def test_six_cameras_look_in_six_directions() -> None:
    names = ("front", "left", "back-left", "back", "back-right", "right")
    yaws = [synthetic.truth_at(SyntheticOptions(), 0, 0, name)[2, :2] for name in names]
    ahead = np.unwrap([np.arctan2(y, x) for x, y in yaws])
    np.testing.assert_allclose(np.degrees(np.diff(ahead)), 60.0, atol=0.5)
