"""Lanes and poles: what is found on roads where they are known, and the cost that lays them upon each other."""

import numpy as np
import p2o
import pytest
from p2o.problems.problem import pose_from_chart
from p2o_baselines.segments import crlf, lane_pole_cloud, lane_pole_image
from p2o_baselines.segments.cloud_segments import ground_of
from p2o_baselines.segments.lane_pole_cloud import LANE, POLE, LanePoleCloudOptions, LanePolePoints
from p2o_baselines.segments.lane_pole_image import FAR_PX, LanePoleMap

CAMERA = p2o.Camera.pinhole(400.0, 400.0, 300.0, 100.0, 600, 250)
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
TRUTH = p2o.se3.make(AXES, (0.1, -0.1, -0.3))


def road(lanes=(), poles=()):
    """Return a sweep (Cloud) of a flat road 1.7 m below the LiDAR, with lanes at y and poles at (x, y), metres."""
    x, y = np.meshgrid(np.arange(4.0, 30.0, 0.1), np.arange(-9.0, 9.0, 0.1))
    flat = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.7)])
    strength = np.full(len(flat), 0.2)
    for lane in lanes:
        strength[np.abs(flat[:, 1] - lane) < 0.09] = 0.8
    upright = [np.column_stack([np.full(30, px), np.full(30, py), np.linspace(-1.7, 1.2, 30)]) for px, py in poles]
    xyz = np.concatenate([flat, *upright])
    return p2o.Cloud(xyz, intensity=np.concatenate([strength, np.full(len(xyz) - len(flat), 0.3)]))


def picture(lanes=(), poles=()):
    """Return the picture of the same road."""
    import cv2

    rgb = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    for lane in lanes:
        ends = CAMERA.project(p2o.se3.apply(TRUTH, np.array([[4.0, lane, -1.7], [29.0, lane, -1.7]])))
        cv2.line(rgb, *(tuple(np.rint(end).astype(int).tolist()) for end in ends), (220, 220, 220), 5)
    for px, py in poles:
        ends = CAMERA.project(p2o.se3.apply(TRUTH, np.array([[px, py, -1.7], [px, py, 1.2]])))
        cv2.line(rgb, *(tuple(np.rint(end).astype(int).tolist()) for end in ends), (30, 30, 30), 6)
    return p2o.Image(rgb, CAMERA)


def test_the_ground_is_found_exactly():
    normal = np.array([0.05, -0.02, 1.0])
    normal /= np.linalg.norm(normal)
    rng = np.random.default_rng(0)
    xy = rng.uniform(-20, 20, (3000, 2))
    flat = np.column_stack([xy, (-1.8 - xy @ normal[:2]) / normal[2]])
    clutter = rng.uniform([-20, -20, 0], [20, 20, 6], (1500, 3))
    found = ground_of(np.concatenate([flat, clutter]), rng)
    assert np.allclose(found, [*normal, 1.8], atol=1e-3)


def test_a_ceiling_is_no_ground():
    xy = np.random.default_rng(0).uniform(-20, 20, (3000, 2))
    assert ground_of(np.column_stack([xy, np.full(3000, 4.0)]), np.random.default_rng(0)) is None


def test_lanes_are_what_reflects_on_the_road():
    extract = lane_pole_cloud.METHOD.build(LanePoleCloudOptions())
    assert len(extract(road()).get("cloud-lane-pole")) == 0
    found = extract(road(lanes=(-2.0, 2.0))).get("cloud-lane-pole")
    lane = found.xyz[found.kind == LANE]
    assert len(lane) > 100
    assert (np.abs(np.abs(lane[:, 1]) - 2.0) < 0.1).all()


def test_poles_stand_alone_and_walls_are_none():
    cloud = road(poles=[(12.0, 3.0)])
    y, z = np.meshgrid(np.arange(-8.0, -4.0, 0.1), np.arange(-1.7, 2.0, 0.1))
    wall = np.column_stack([np.full(y.size, 20.0), y.ravel(), z.ravel()])
    both = p2o.Cloud(np.concatenate([cloud.xyz, wall]), intensity=np.append(cloud.intensity, np.full(len(wall), 0.3)))
    found = lane_pole_cloud.METHOD.build(LanePoleCloudOptions())(both).get("cloud-lane-pole")
    pole = found.xyz[found.kind == POLE]
    assert len(pole) >= 20
    assert np.allclose(pole[:, :2], [12.0, 3.0])


def test_lanes_and_poles_of_a_picture_are_told_apart():
    assert (lane_pole_image.build(p2o.Options())(picture()).get("image-lane-pole").values == FAR_PX).all()
    away = lane_pole_image.build(p2o.Options())(picture((2.0,), [(12.0, -3.0)])).get("image-lane-pole")
    lane, pole = CAMERA.project(p2o.se3.apply(TRUTH, np.array([[8.0, 2.0, -1.7], [12.0, -3.0, 0.0]])))
    at = [away.values[tuple(np.rint(uv[::-1]).astype(int))] for uv in (lane, pole)]
    assert at[0][LANE] <= 1
    assert at[0][POLE] > 10
    assert at[1][POLE] <= 1
    assert at[1][LANE] > 10


@pytest.mark.parametrize(("away_px", "share"), [(0.0, 1.0), (3.0, 0.5), (6.0, 0.0), (50.0, 0.0)])
def test_a_point_counts_by_its_distance_from_the_mask(away_px, share):
    values = np.full((CAMERA.height, CAMERA.width, 2), FAR_PX)
    values[..., LANE] = away_px
    points = LanePolePoints(np.array([[10.0, 0.0, -1.7]]), np.array([LANE]))
    view = p2o.View(
        "a", CAMERA, p2o.ImageFeatures(features=[LanePoleMap(values)]), p2o.CloudFeatures(features=[points])
    )
    problem = crlf.build(crlf.METHOD.options())([view], TRUTH, 10.0)
    assert problem.cost(TRUTH[None])[0] == pytest.approx(-share)


def test_it_solves_a_road_with_lanes_and_poles():
    lanes, poles = (-3.5, 0.5, 3.5), [(9.0, 4.5), (12.0, -5.0), (16.0, 6.0), (20.0, -7.0)]
    image = lane_pole_image.build(p2o.Options())(picture(lanes, poles))
    cloud = lane_pole_cloud.METHOD.build(LanePoleCloudOptions())(road(lanes, poles))
    problem = crlf.build(crlf.METHOD.options())([p2o.View("road", CAMERA, image, cloud)], TRUTH, 10.0)
    from p2o_plugins.solve import random_shrink

    start = pose_from_chart(TRUTH, np.array([0.01, -0.012, 0.008, 0.03, -0.02, 0.03]))
    options = random_shrink.RandomShrinkOptions(range_deg=1.5, range_m=0.08, samples=120)
    found = random_shrink.build(options)(problem, start).camera_from_lidar @ p2o.se3.inverse(TRUTH)
    # Lines of 5 px are 0.7 deg wide: the middle is not told any better by a share of points on them.
    assert p2o.se3.angle_deg(found) < 0.5
    assert p2o.se3.distance_m(found) < 0.2
