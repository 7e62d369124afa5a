"""`csc`: exact maps tell extrinsic and scale, what is open is said, what is no drive is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import p2o
import pytest
from p2o_baselines.motion import csc
from p2o_baselines.motion.hand_eye_equations import HandEye, Steps, first_guess
from p2o_baselines.motion.hand_eye_equations import solved as by_motion
from p2o_baselines.motion.moments import Moment
from p2o_baselines.motion.structure import Consistency, Stretch, SurfaceMap, searched, solved, surface_map
from p2o_baselines.motion.visual_map import Tracks, visual_map
from scipy.spatial import cKDTree

CAMERA = p2o.Camera.pinhole(700.0, 700.0, 620.0, 180.0, 1242, 375)
TRUTH = p2o.se3.exp(np.array([0.05, -0.08, 0.06, 0.0, 0.0, 0.0])) @ p2o.se3.make(
    [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [0.06, -0.35, -0.27]
)
SCALE = 0.8


def way(*, turn: float = 0.12, tilt: float = 0.05, moments: int = 9) -> np.ndarray:
    """World poses (K, 4, 4) of a LiDAR that goes ahead by 0.8 m a step, with turns of so much (rad)."""
    rng, pose, poses = np.random.default_rng(3), np.eye(4), []
    for number in range(moments):
        poses.append(pose)
        twist = np.array([*rng.uniform(-tilt, tilt, 2), turn * np.sin(number), 0.8, 0.0, 0.0])
        pose = pose @ p2o.se3.exp(twist)
    return np.array(poses)


def tiles(walls: bool) -> SurfaceMap:
    """Ground 1.7 m below, walls 6 m to either side and one across, each in tiles of half a metre."""
    along, aside = np.meshgrid(np.arange(-5, 45, 0.5), np.arange(-5.75, 6, 0.5), indexing="ij")
    parts = [(np.stack([along, aside, np.full_like(along, -1.7)], axis=-1), (0, 0, 1))]
    if walls:
        along, up = np.meshgrid(np.arange(-5, 45, 0.5), np.arange(-1.4, 6, 0.5), indexing="ij")
        parts += [(np.stack([along, np.full_like(along, side), up], axis=-1), (0, 1, 0)) for side in (-6.0, 6.0)]
        aside, up = np.meshgrid(np.arange(-5.75, 6, 0.5), np.arange(-1.4, 6, 0.5), indexing="ij")
        parts.append((np.stack([np.full_like(aside, 45.0), aside, up], axis=-1), (1, 0, 0)))
    centre = np.concatenate([xyz.reshape(-1, 3) for xyz, _ in parts])
    normal = np.concatenate([np.tile(np.array(n, float), (xyz.size // 3, 1)) for xyz, n in parts])
    return SurfaceMap(centre, normal, np.zeros(len(centre)), np.ones(len(centre), bool), cKDTree(centre))


def stretch(world_from_lidar: np.ndarray, *, walls: bool = True) -> Stretch:
    """Exact maps: landmarks near the middle of tiles, each seen at three moments."""
    surfaces, rng = tiles(walls), np.random.default_rng(0)
    first = np.flatnonzero(surfaces.centre[:, 0] > 6)[::3]
    across = rng.uniform(-0.1, 0.1, (len(first), 3))
    normal = surfaces.normal[first]
    places = surfaces.centre[first] + across - (across * normal).sum(axis=1, keepdims=True) * normal
    camera_from_world = TRUTH @ p2o.se3.inverse(world_from_lidar)
    xyz, landmark, moment = [], [], []
    for number in range(len(world_from_lidar)):
        seen = np.flatnonzero((np.arange(len(places)) + number) % 3 == 0)
        here = p2o.se3.apply(camera_from_world[number], places[seen])
        ahead = here[:, 2] > 2
        xyz.append(here[ahead] / SCALE)
        landmark.append(seen[ahead])
        moment.append(np.full(int(ahead.sum()), number))
    steps = camera_from_world[1:] @ p2o.se3.inverse(camera_from_world[:-1])
    steps[:, :3, 3] /= SCALE
    count = sum(map(len, xyz))
    back = p2o.se3.inverse(world_from_lidar[:-1]) @ world_from_lidar[1:]
    velocity = np.array([p2o.se3.log(step) for step in back]) / 0.2
    return Stretch(
        np.concatenate(xyz),
        np.tile(1e-4 * np.eye(3), (count, 1, 1)),
        np.concatenate(landmark),
        np.concatenate(moment),
        np.asarray(steps),
        world_from_lidar,
        np.concatenate([velocity, velocity[-1:]]),
        surfaces,
    )


def left_update(found: Consistency) -> np.ndarray:
    return p2o.se3.log(found.camera_from_lidar @ p2o.se3.inverse(TRUTH))


def openings(found: Consistency) -> list[str]:
    none = np.zeros(0)
    as_hand_eye = HandEye(found.camera_from_lidar, found.covariance, none, 0.0, 0.0)
    return [str(each) for each in as_hand_eye.open_directions(over_deg=2.0, over_m=0.25)]


# ---- both maps


def test_exact_maps_tell_extrinsic_and_scale() -> None:
    start = p2o.se3.exp(np.array([0.005, -0.004, 0.006, 0.05, -0.04, 0.05])) @ TRUTH
    found = solved([stretch(way())], start, [np.log(0.99 * SCALE)])
    assert found.settled
    assert np.abs(left_update(found)).max() < 1e-6
    np.testing.assert_allclose(found.scales[0], SCALE, rtol=1e-6)
    assert found.off_m < 1e-6


def test_flat_ground_leaves_the_height_open_to_motion_but_not_to_structure() -> None:
    flat = stretch(way(tilt=0.0))
    camera = flat.camera_step.copy()
    camera[:, :3, 3] /= np.linalg.norm(camera[:, :3, 3], axis=1)[:, None]
    count = len(camera)
    covariance = np.tile(np.diag([1e-7] * 3 + [1e-4] * 3), (count, 1, 1))
    steps = Steps(
        camera, flat.lidar_step, np.zeros(count, bool), covariance, np.full(count, 2e-4), np.full(count, 3e-3)
    )
    motion = by_motion(steps, first_guess(steps)[0])
    assert "along z of the LiDAR" in " ".join(map(str, motion.open_directions(over_deg=2.0, over_m=0.25)))
    higher = p2o.se3.make(translation=(0.0, 0.15, 0.0)) @ TRUTH
    found = solved([flat], higher, [np.log(SCALE)])
    assert openings(found) == []
    assert np.abs(left_update(found)).max() < 1e-6


def test_straight_ahead_over_bare_ground_the_place_is_open() -> None:
    found = solved([stretch(way(turn=0.0, tilt=0.0), walls=False)], TRUTH, [np.log(SCALE)])
    told = openings(found)
    assert told
    assert all("the place of the camera" in each for each in told)
    assert not any("along z of the LiDAR" in each for each in told)
    assert openings(solved([stretch(way(turn=0.0, tilt=0.0))], TRUTH, [np.log(SCALE)])) == [], "between walls"


def test_several_stretches_share_the_extrinsic_and_have_scales_of_their_own() -> None:
    one, other = stretch(way()), stretch(way(turn=-0.1))
    longer = other.camera_step.copy()
    longer[:, :3, 3] *= 2
    other = replace(other, xyz=2 * other.xyz, camera_step=longer)
    start = p2o.se3.exp(np.array([0.005, -0.004, 0.006, 0.05, -0.04, 0.05])) @ TRUTH
    found = solved([one, other], start, [np.log(SCALE), np.log(SCALE / 2)])
    assert np.abs(left_update(found)).max() < 1e-6
    np.testing.assert_allclose(found.scales[1], SCALE / 2, rtol=1e-6)


def test_the_search_comes_from_five_degrees_and_four_decimetres() -> None:
    exact = stretch(way())
    far = p2o.se3.exp(np.array([0.06, -0.05, 0.04, 0.0, 0.0, 0.0])) @ TRUTH
    far[:3, 3] += (0.2, -0.25, 0.2)
    half = np.array([0.12, 0.12, 0.12, 0.5, 0.5, 0.5, 0.2])
    pose, more = searched([exact], far, [np.log(SCALE) + 0.1], np.eye(3), half, seed=0, rounds=15)
    once, again = (
        searched([exact], far, [np.log(SCALE) + 0.1], np.eye(3), half, seed=0, rounds=1)[0] for _ in range(2)
    )
    np.testing.assert_array_equal(once, again)
    found = solved([exact], pose, [np.log(SCALE) + 0.1 + more])
    assert np.abs(left_update(found)).max() < 1e-6


def test_a_late_camera_is_told() -> None:
    """The pictures are of 20 ms later than the LiDAR's poses say."""
    late = stretch(way())
    early = np.array([p2o.se3.exp(-0.02 * twist) for twist in late.velocity])
    found = solved([replace(late, world_from_lidar=late.world_from_lidar @ early)], TRUTH, [np.log(SCALE)])
    assert abs(found.delay_s - 0.02) < 0.005


def test_planes_of_a_map_are_those_of_its_sweeps() -> None:
    rng = np.random.default_rng(0)
    xyz = np.stack([rng.uniform(3, 9, 20000), rng.uniform(-3, 3, 20000), np.full(20000, -1.7)], axis=1)
    leaves = rng.uniform(10, 12, (4000, 3))
    found = surface_map([np.concatenate([xyz, leaves])], np.eye(4)[None])
    near, cube = found.near(np.array([[6.0, 0.1, -1.6], [11.0, 11.0, 11.0]]), 0.4)
    np.testing.assert_array_equal(near, [True, False])
    np.testing.assert_allclose(np.abs(found.normal[cube[0]]), [0, 0, 1], atol=1e-6)
    assert surface_map([np.zeros((3, 3))], np.eye(4)[None]) is None


# ---- the visual map


def sights(world_from_lidar: np.ndarray) -> Tracks:
    """Exact tracks of things to all sides of the way."""
    rng = np.random.default_rng(4)
    things = np.stack([rng.uniform(6, 40, 400), rng.uniform(-8, 8, 400), rng.uniform(-1.7, 4, 400)], axis=1)
    track, picture, ray = [], [], []
    for number, pose in enumerate(world_from_lidar):
        here = p2o.se3.apply(TRUTH @ p2o.se3.inverse(pose), things)
        seen = np.flatnonzero(CAMERA.in_image(CAMERA.project(here)) & (here[:, 2] > 1))
        track.append(seen)
        picture.append(np.full(len(seen), number))
        ray.append(here[seen] / here[seen, 2:])
    return Tracks(np.concatenate(track), np.concatenate(picture), np.concatenate(ray))


def test_exact_tracks_make_the_map_up_to_scale() -> None:
    poses = way(moments=6)
    found = visual_map(sights(poses), CAMERA.focal_px)
    camera = TRUTH @ p2o.se3.inverse(poses)
    for first in range(5):
        told = found.camera_from_world[first + 1] @ p2o.se3.inverse(found.camera_from_world[first])
        true = camera[first + 1] @ p2o.se3.inverse(camera[first])
        assert p2o.se3.angle_deg(told @ p2o.se3.inverse(true)) < 0.01
        told, true = told[:3, 3], true[:3, 3]
        assert np.linalg.norm(told / np.linalg.norm(told) - true / np.linalg.norm(true)) < 1e-3
    assert found.off_px < 0.05
    assert visual_map(sights(np.tile(np.eye(4), (5, 1, 1))), CAMERA.focal_px) is None, "a camera that stands still"


# ---- what is refused


def method(**options: object) -> csc.CscCalibration:
    return csc.CscCalibration(csc.CscOptions(**{"lidar": "given", **options}))


def moments(poses: np.ndarray, period_s: float = 0.2) -> list[Moment]:
    grey = np.zeros((375, 1242), np.uint8)
    return [
        Moment(f"drive/{number}", "drive", period_s * number, CAMERA, grey, None, np.ones((5, 3)), pose)
        for number, pose in enumerate(poses)
    ]


@pytest.mark.parametrize(
    ("poses", "period_s", "status", "reason"),
    [
        (way(), 3.0, p2o.Status.TOO_FEW_MATCHES, "0 steps between consecutive frames, of 9 frames"),
        (np.tile(np.eye(4), (9, 1, 1)), 0.2, p2o.Status.NOT_OBSERVABLE, "is static"),
        (way(), 0.2, p2o.Status.TOO_FEW_MATCHES, "the images make no map"),
    ],
    ids=["frames far apart", "a standing car", "images without corners"],
)
def test_a_drive_that_does_not_determine_the_pose_is_refused_with_the_reason(
    poses: np.ndarray, period_s: float, status: p2o.Status, reason: str
) -> None:
    result = method().solve(moments(poses, period_s), TRUTH)
    assert result.status is status
    assert reason in result.reason
    np.testing.assert_array_equal(result.camera_from_lidar, TRUTH)


def test_a_map_without_planes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = way(moments=6)
    known = visual_map(sights(poses), CAMERA.focal_px)
    monkeypatch.setattr(csc, "visual_map_of", lambda *_: known)
    result = method().solve(moments(poses), TRUTH)
    assert result.status is p2o.Status.TOO_FEW_MATCHES
    assert "the sweeps have no planes" in result.reason


def test_pictures_in_another_order_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sweeps drive the way backwards: one rig cannot."""
    poses = way(moments=6)
    known = visual_map(sights(poses), CAMERA.focal_px)
    surfaces = tiles(walls=True)
    monkeypatch.setattr(csc, "visual_map_of", lambda *_: known)
    monkeypatch.setattr(csc, "surface_map", lambda *_, **__: surfaces)
    shuffled = poses[[3, 0, 5, 1, 4, 2]]
    monkeypatch.setattr(csc, "_LEAST_LANDMARKS", 10)
    monkeypatch.setattr(csc, "_SEARCH", 1)
    result = method().solve(moments(shuffled), TRUTH)
    assert not result.status.solved
    assert "move differently" in result.reason or "lie next to a plane" in result.reason


def test_long_drives_are_cut_into_stretches_that_meet() -> None:
    found = csc.windows(moments(way(moments=20)), 8)
    assert [len(part) for part in found] == [7, 8, 7]
    assert all(before[-1] is after[0] for before, after in pairwise(found))
